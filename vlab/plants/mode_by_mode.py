"""What is prescribed mode by mode in MuJoCo: damping, and frequencies that a structure is tuned to.

The damping C = sum over modes of (M phi)(2 zeta omega)(M phi)^T couples no modes and is full in joint coordinates.
MuJoCo carries it natively as one fixed tendon a mode, with coefficients phi^T M and damping 2 zeta omega; the model that
a plant writes out has these tendons. The stiffness that tunes frequencies is of the same form with (f^2 - 1) omega^2,
negative where a frequency is lowered, and so is the one that turns a coarse mesh's modes into those of the FE model.
Dense tendons cost as much as all the rest of a step, so while a plant runs in the laboratory the same matrices act as a
generalised force -C qvel - K (qpos - qpos0) instead; a test holds the two against each other.
"""

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from vlab.errors import BadStructure
from vlab.fe.damping import modal_factors, modal_ratios
from vlab.fe.second_order import SecondOrderModel
from vlab.plants.base import Plant
from vlab.plants.fe_modes import FeModes
from vlab.signals import Array
from vlab.structure.model import Structure

P = TypeVar("P", bound=Plant)


@dataclass(frozen=True)
class ModalTendon:
    """A damper and a spring on a linear combination of joint coordinates.

    Parameters
    ----------
    row : (nv,) array
        Coefficients.
    damping, stiffness : float
        Damper [N s/m in the unit of the combination] and spring [N/m], which is relaxed in the initial configuration.
    """

    name: str
    row: Array
    damping: float = 0.0
    stiffness: float = 0.0


def with_prescribed(plant: P, structure: Structure, variant: str, *, damped: bool = True) -> P:
    """Return a bare plant with the structure's modal damping ratios, and with the modes that it is tuned to.

    Parameters
    ----------
    damped : bool
        Whether to prescribe damping.

    Raises
    ------
    BadStructure
        It is tuned to more modes than the plant and the FE model have.
    """
    linear = plant.linearise()
    coils = plant.port_rows(structure.coil_places)
    restoring = dissipation = None
    if structure.tuning is not None:
        restoring = np.zeros((linear.n, linear.n))
        if structure.tuning.of_fe:
            modes = FeModes.of(plant, linear, structure, variant)
            restoring += modes.stiffness
            plant = modes.seen_at_places(plant)
            coils = plant.port_rows(structure.coil_places)
        meshed = replace(linear, K=linear.K + restoring)
        restoring += meshed.tuning_stiffness(modal_factors(structure.tuning, coils @ meshed.eigen[1]))
        linear = replace(linear, K=linear.K + restoring)
    dampers = modal_dampers(linear, modal_ratios(structure.damping, coils @ linear.eigen[1])) if damped else []
    if dampers:
        rows = np.array([damper.row for damper in dampers])
        dissipation = np.asarray(rows.T * [damper.damping for damper in dampers] @ rows)
    springs = [] if restoring is None else tuning_springs(restoring)
    spec = with_modal_tendons(plant.spec, [*springs, *dampers])
    return replace(plant, spec=spec, dissipation=dissipation, restoring=restoring)


def modal_dampers(linear: SecondOrderModel, zeta: Array) -> list[ModalTendon]:
    """Return the dampers that give a model's modes their ratios: rows phi^T M, damping 2 zeta omega."""
    omega, shapes = linear.eigen
    rows = shapes.T @ linear.M
    return [
        ModalTendon(f"damping:{j + 1}", rows[j], damping=2 * zeta[j] * omega[j]) for j in range(linear.n) if zeta[j] > 0
    ]


def tuning_springs(restoring: Array) -> list[ModalTendon]:
    """Return the springs that add up to the stiffness which tunes a plant."""
    return [ModalTendon(f"tuning:{k}", row, stiffness=value) for k, (value, row) in enumerate(rank_one(restoring), 1)]


def rank_one(matrix: Array) -> list[tuple[float, Array]]:
    """Return values and rows with matrix = sum of value row^T row, for a symmetric matrix."""
    values, vectors = np.linalg.eigh(matrix)
    keep = np.abs(values) > 1e-12 * max(np.abs(values).max(), 1e-300)
    return [(float(v), x) for v, x in zip(values[keep], vectors.T[keep], strict=True)]


def with_modal_tendons(spec: Any, tendons: list[ModalTendon]) -> Any:
    """Return a copy of a spec whose joints carry the dampers and springs as native fixed tendons.

    Raises
    ------
    BadStructure
        A joint has several degrees of freedom, which a fixed tendon cannot take.
    """
    copy = spec.copy()
    names = [joint.name for joint in copy.joints]
    for tendon in tendons:
        if len(names) != tendon.row.size:
            raise BadStructure("what is prescribed mode by mode needs one degree of freedom a joint")
        added = copy.add_tendon(name=tendon.name)
        added.damping[0], added.stiffness[0] = tendon.damping, tendon.stiffness
        largest = np.abs(tendon.row).max()
        for name, coefficient in zip(names, tendon.row, strict=True):
            if abs(coefficient) > 1e-12 * largest:
                added.wrap_joint(name, coefficient)
    return copy
