"""Model of a draft: file, uncertain numbers, missing names."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from vlab.errors import BadCase
from vlab.files.text import one_line
from vlab.plants.base import Plant
from vlab.plants.build import build_plant
from vlab.plants.mjcf import build_mjcf
from vlab.structure.reader import BUILT_IN, load_structure

UNCERTAIN = {
    "mass": (0.03, "parts weighed, or from a drawing"),
    "stiffness": (0.05, "springs from a data sheet"),
    "damping": (0.3, "damping is seldom known better"),
    "friction": (0.3, "friction that the model has already"),
    "armature": (0.05, "rotor inertia and gear ratio from a data sheet"),
    "gain": (0.05, "gains of actuators and servos"),
    "sensor": (0.01, "calibration of the sensors"),
}
"""UNCERTAIN [1]: relative standard deviation by kind, with its meaning; those of a diagnosis without any statement."""
ONE_WAY = {int(mujoco.mjtJoint.mjJNT_HINGE): "hinge", int(mujoco.mjtJoint.mjJNT_SLIDE): "slide"}
"""ONE_WAY: joints that a column can show."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DraftModel:
    """Model of a draft.

    Parameters
    ----------
    plant : Plant
        Model.
    key, value : str
        Line of ``[model]`` in the case.
    title : str
        Title of the case.
    is_outside : bool
        Whether the file lies outside the folder of the case.
    hints : tuple of str
        Names that the model lacks, with the text to add.
    """

    plant: Plant
    key: str
    value: str
    title: str
    is_outside: bool
    hints: tuple[str, ...] = ()


def open_model(model: str, folder: Path) -> DraftModel:
    """Open the model of a draft.

    Parameters
    ----------
    model : str
        MJCF file, structure file, or built-in structure.
    folder : Path
        Folder of the case.

    Returns
    -------
    DraftModel
        Model with its line in the case.

    Raises
    ------
    BadCase
        The name is no model, or a structure file lies outside the folder.
    BadStructure
        The model cannot be built.
    """
    if model in BUILT_IN:
        plant = build_plant(load_structure(model), "composite", "published")
        return DraftModel(plant=plant, key="structure", value=model, title=model, is_outside=False)
    path = Path(model)
    if not path.is_file():
        what = "the folder is no model" if path.is_dir() else "there is no such model file"
        raise BadCase(f"{model}: {what}; give an MJCF file, then the logs: vlab init MODEL.xml LOG...")
    value, is_outside = relative(path, folder)
    if path.suffix.lower() == ".toml":
        if is_outside:
            raise BadCase(
                f"{model}: a structure file must lie in the folder of the case, {folder}; copy the file there"
            )
        plant = build_plant(load_structure(path), "composite", "published")
        return DraftModel(plant=plant, key="structure", value=value, title=path.stem, is_outside=False)
    if path.suffix.lower() not in (".xml", ".mjcf"):
        raise BadCase(
            f"{model}: this is no model (accepted: an MJCF file .xml, a structure file .toml, {', '.join(BUILT_IN)}); "
            "give the model first, then its logs"
        )
    plant = build_mjcf(path)
    return DraftModel(
        plant=plant,
        key="mjcf",
        value=value,
        title=path.stem,
        is_outside=is_outside,
        hints=tuple(missing_names(plant.model)),
    )


def relative(path: Path, folder: Path) -> tuple[str, bool]:
    """Return a path relative to the folder of a case.

    Parameters
    ----------
    path, folder : Path
        File and folder.

    Returns
    -------
    tuple of (str, bool)
        Relative path, and whether the path leaves the folder.
    """
    real, base = path.resolve(), folder.resolve()
    name = Path(os.path.relpath(real, base)).as_posix()
    return name, not real.is_relative_to(base)


def uncertain_kinds(plant: Plant) -> dict[str, tuple[float, str]]:
    """Return the kinds of uncertain numbers that a model has.

    Parameters
    ----------
    plant : Plant
        Model.

    Returns
    -------
    dict of str to (float, str)
        Relative standard deviation and meaning by kind.
    """
    model: Any = plant.model
    present = {
        "mass": bool(np.any(model.body_mass > 0.0)),
        "stiffness": bool(np.any(model.jnt_stiffness > 0.0) or np.any(model.tendon_stiffness > 0.0)),
        "damping": bool(np.any(model.dof_damping > 0.0) or np.any(model.tendon_damping > 0.0)),
        "friction": bool(np.any(model.dof_frictionloss > 0.0) or np.any(model.tendon_frictionloss > 0.0)),
        "armature": bool(np.any(model.dof_armature > 0.0)),
        "gain": bool(model.nu),
        "sensor": True,
    }
    return {kind: known for kind, known in UNCERTAIN.items() if present[kind]}


def missing_names(model: Any) -> list[str]:
    """Return hints on joints and actuators without a name.

    Parameters
    ----------
    model : mujoco.MjModel
        Compiled model.

    Returns
    -------
    list of str
        One hint an element, with the text to add.
    """
    out = []
    for i in range(model.njnt):
        kind = ONE_WAY.get(int(model.jnt_type[i]))
        if kind is not None and not model.joint(i).name:
            body = one_line(model.body(int(model.jnt_bodyid[i])).name or f"number {int(model.jnt_bodyid[i])}")
            out.append(
                f'the {kind} of body {body!r} has no name, so no column can show its motion; write <joint name="{body}_joint" ...>'
            )
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    for i in range(model.nu):
        if not model.actuator(i).name:
            target = ""
            if int(model.actuator_trntype[i]) in kinds:
                target = one_line(model.joint(int(model.actuator_trnid[i, 0])).name)
            where = f" on joint {target!r}" if target else ""
            out.append(
                f'actuator number {i + 1}{where} has no name, so no column can drive it; add name="{target or f"actuator{i + 1}"}"'
            )
    return out


def without_column(names: Sequence[str]) -> list[str]:
    """Return remarks on actuators and joints without a column.

    Parameters
    ----------
    names : sequence of str
        Elements, such as ``actuator 'elbow'``.
    """
    return [
        f"{name} has no column: its command is zero" if name.startswith("actuator") else f"{name} has no column"
        for name in names
    ]


def feedback_of(plant: Plant, name: str) -> str:
    """Return what an actuator follows.

    Parameters
    ----------
    plant : Plant
        Model.
    name : str
        Name of the actuator.

    Returns
    -------
    str
        ``"position"`` or ``"velocity"`` of a servo, else an empty text.
    """
    model = plant.model
    numbers = [i for i in range(model.nu) if model.actuator(i).name == name]
    if not numbers or model.actuator_biastype[numbers[0]] != mujoco.mjtBias.mjBIAS_AFFINE:
        return ""
    (_, position, velocity), gain = model.actuator_biasprm[numbers[0], :3], model.actuator_gainprm[numbers[0], 0]
    if position < 0.0:
        return "position"
    return "velocity" if velocity < 0.0 and gain == -velocity else ""  # a motor with back-EMF has another gain
