"""Law module of a model: laws, places, values, running part."""

import pprint
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import mujoco
import numpy as np

from vlab.files.text import one_line
from vlab.physics.attach import Attached
from vlab.physics.attached import AtActuator, AtPort, AtSensor
from vlab.physics.effect import LinearPortEffect
from vlab.plants.base import Port
from vlab.plants.mjcf import AXES, MjcfPlant
from vlab.standalone.law_source import CannotWrite, LawCode

MARKER = "# ---- running ----\n"
"""MARKER: line of the running part after which its text is copied."""
HEAD = '''"""{title}

Written by vlab from a diagnosis. The module needs {needs}, and nothing of vlab. Units are SI: N, m, rad, s.

{found}

Use:

    import mujoco

    import law

    model = mujoco.MjModel.from_xml_path("{model}")
    law.install(model)
    data = mujoco.MjData(model)
    while data.time < 1.0:
        {command}
        mujoco.mj_step(model, data){read}

The states of the laws belong to an MjData and start from rest when its time goes back. They are no part of MuJoCo's own
state, so `mj_copyData` and state vectors leave them behind.
"""
'''


class _Raw(str):
    """Code that a table shows as written."""

    def __repr__(self) -> str:
        return str(self)


@dataclass(frozen=True, kw_only=True)
class LawModule:
    """Text of a law module.

    Parameters
    ----------
    text : str
        Python code; "" if nothing is left for a module.
    refused : dict of str to str
        Why an effect could not be written, by name of the effect.
    uses : tuple of str
        Functions of the module that a simulation must call: ``install``, ``command``, ``read``.
    lines : list of dict
        Forces at ports, see `vlab.standalone.runtime`.
    """

    text: str
    refused: dict[str, str]
    uses: tuple[str, ...]
    lines: list[dict[str, Any]]


def law_module(
    plant: MjcfPlant,
    *,
    model: str,
    title: str,
    sample: float,
    numbers: Sequence[tuple[str, tuple[int, ...], float]] = (),
    shown: Sequence[Attached] = (),
) -> LawModule:
    """Write the module of a plant's running physics.

    Parameters
    ----------
    plant : MjcfPlant
        Plant with the effects that have no MuJoCo element.
    model : str
        Name of the model's file.
    title : str
        First line of the module.
    sample : float
        Sample period of readings and of clocked commands [s].
    numbers : sequence of tuple of (str, tuple of int, float)
        Numbers of the compiled model that the file does not hold: field, index and value.
    shown : sequence of Attached
        Effects that the first lines list.

    Returns
    -------
    LawModule
        Text, and what could not be written.
    """
    code, refused = LawCode(), dict[str, str]()
    lines, commands, readings = list[dict[str, Any]](), list[dict[str, Any]](), list[dict[str, Any]]()
    ports = [a for a in plant.physics if isinstance(a, AtPort)]
    for a in sorted(ports, key=lambda a: (a.effect.is_force, a.effect.traits.is_dry_friction)):
        _written(code, a, refused, lines, _lines(a, plant))
    for a in plant.physics:
        if isinstance(a, AtActuator):
            line: dict[str, Any] = {"control": int(plant.actuators[a.index].controls[0])}
            _written(code, a, refused, commands, [line | ({"is_clocked": True} if a.effect.is_clocked else {})])
        elif isinstance(a, AtSensor):
            _written(code, a, refused, readings, [{"name": a.name, **_picked(plant, a)}])
        elif not isinstance(a, AtPort):
            refused[a.effect.name] = "it acts neither at a coordinate nor on a command nor on a reading"
    uses = tuple(
        name
        for name, used in (
            ("install", bool(lines or commands or readings or numbers)),
            ("command", bool(commands)),
            ("read", bool(readings)),
        )
        if used
    )
    if not uses:
        return LawModule(text="", refused=refused, uses=(), lines=[])
    tables = {
        "REST": np.asarray(plant.rest).tolist() if lines else [],
        "SAMPLE": sample,
        "NUMBERS": list(numbers),
        "LINES": lines,
        "COMMANDS": commands,
        "READINGS": readings,
    }
    imports = sorted({"import mujoco", "import numpy as np", *code.imports} - {"from typing import Any, NamedTuple"})
    values = (f"{k} = {pprint.pformat(v, width=116, sort_dicts=False)}{_WORDS[k]}" for k, v in tables.items())
    has_scipy = any("scipy" in line for line in imports)
    parts = [_head(title, model, shown, uses, has_scipy=has_scipy) + _imports(imports), code.text, "\n".join(values)]
    text = "\n\n\n".join(part for part in parts if part) + "\n" + _running()
    return LawModule(text=text, refused=refused, uses=uses, lines=lines)


def _head(title: str, model: str, shown: Sequence[Attached], uses: Sequence[str], *, has_scipy: bool) -> str:
    """Return the docstring of the module."""
    return HEAD.format(
        title=_quoted(title),
        needs="mujoco, numpy and scipy" if has_scipy else "mujoco and numpy",
        model=_quoted(model),
        found="\n".join(_quoted(f"{e.label}: {e.effect.law}") for e in shown) or "The model needs no law.",
        command="data.ctrl[:] = law.command(model, data, u)  # u: your commands"
        if "command" in uses
        else "...  # your controls",
        read="\n        y = law.read(model, data)  # once a sample" if "read" in uses else "",
    )


def _imports(lines: Sequence[str]) -> str:
    """Return imports in their order: standard library, then installed packages."""
    standard = ["from typing import Any, NamedTuple", "from weakref import WeakKeyDictionary"]
    first = [line for line in lines if line.split()[1].split(".")[0] not in ("mujoco", "numpy", "scipy")]
    other = [line for line in lines if line not in first]
    return "\n" + "\n".join(sorted([*standard, *first])) + "\n\n" + "\n".join(other)


_WORDS = {
    "REST": '\n"""Configuration from which displacements count (qpos)."""',
    "SAMPLE": '\n"""Sample period of readings and clocked commands [s]."""',
    "NUMBERS": '\n"""Numbers that the model file cannot hold: field of the compiled model, index, value."""',
    "LINES": '\n"""Forces along coordinates. An impedance is mass, damping and stiffness."""',
    "COMMANDS": '\n"""Effects between command and actuator, in order; ``control`` is the index in ``data.ctrl``."""',
    "READINGS": '\n"""Effects between motion and reading, in order."""',
}


def _quoted(text: str) -> str:
    """Return a text that cannot end a docstring."""
    return one_line(text).replace("\\", "/").replace('"', "'")


def _running() -> str:
    text = resources.files("vlab.standalone").joinpath("runtime.py").read_text(encoding="utf-8")
    return text.partition(MARKER)[2]


def _written(
    code: LawCode, a: Any, refused: dict[str, str], table: list[dict[str, Any]], lines: list[dict[str, Any]]
) -> None:
    """Add an effect to a table, or the reason why not."""
    if isinstance(a.effect, LinearPortEffect):
        impedance = tuple(float(x) for x in a.effect.impedance(a.values, a.stiffness))
        table += [{**line, "impedance": impedance} for line in lines]
        return
    try:
        law = code.add(a.effect)
    except CannotWrite as error:
        refused[a.effect.name] = str(error)
        return
    values = {k: float(v) for k, v in a.values.items()}
    table += [{**line, "law": _Raw(law), "values": values} for line in lines]


def _lines(a: AtPort, plant: MjcfPlant) -> list[dict[str, Any]]:
    """Return the coordinates of a port, one a line."""
    control: dict[str, Any] = {}
    if a.coil is not None:
        control = {"control": int(plant.actuators[a.coil].controls[0])}
        state = int(plant.model.actuator_actadr[control["control"]])
        if a.effect.is_in_servo and state >= 0:
            control["state"] = state
    return [{**_coordinate(a.port, port, k, plant), **control} for k, port in enumerate((a.port, *a.port.more))]


def _coordinate(first: Port, port: Port, index: int, plant: MjcfPlant) -> dict[str, Any]:
    if first.tag == "floor":
        return {"kind": "floor", "row": np.asarray(port.row(plant.new_data())).tolist()}
    kind, _, name = first.name.partition(":")
    if kind == "actuator":
        model, control = plant.model, int(plant.actuators[plant.actuator_index(name)].controls[0])
        spans = "joint" if model.actuator_trntype[control] == mujoco.mjtTrn.mjTRN_JOINT else "tendon"
        of = getattr(model, spans)(int(model.actuator_trnid[control, 0])).name
        return {"kind": spans, "name": of, "gear": float(model.actuator_gear[control, 0])}
    if first.tag == "body":
        return {"kind": kind, "name": name, "axis": index}
    if kind == "site":
        name, _, axis = name.rpartition(".")
        return {"kind": kind, "name": name, "axis": AXES.index(axis)}
    return {"kind": kind, "name": name}


def _picked(plant: MjcfPlant, a: AtSensor) -> dict[str, Any]:
    """Return the signal that a sensor picks up."""
    if not a.other:
        return {}
    if "command" in a.effect.needs:
        return {"control": int(plant.actuators[plant.actuator_index(a.other)].controls[0])}
    return {"sensor": str(plant.sensors[plant.sensor_index(a.other)].name)}
