"""Modal damping and frequency tuning prescribed mode by mode in MuJoCo.

The damping C = sum over modes of (M phi)(2 zeta omega)(M phi)^T couples no modes and is full in joint coordinates. In
MuJoCo one fixed tendon a mode, with coefficients phi^T M and damping 2 zeta omega, represents C. An exported model has
such tendons. The stiffness for frequency tuning has the same form with (f^2 - 1) omega^2, negative for a lowered
frequency. The correction of a coarse mesh's modes also has the same form.

Dense tendons cost as much as the rest of a step. In the laboratory the same matrices therefore act as a generalised
force -C qvel - K (qpos - qpos0). A test compares both forms.
"""

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from vlab.errors import BadStructure
from vlab.fe.damping import modal_factors, modal_ratios
from vlab.fe.second_order import SecondOrderModel
from vlab.plants.base import Plant
from vlab.plants.fe_modes import FeModes, measured_modes_of
from vlab.signals import Array
from vlab.structure.model import Structure

P = TypeVar("P", bound=Plant)
"""Type of a plant."""


@dataclass(frozen=True)
class ModalTendon:
    """Damper and spring on a linear combination of coordinates.

    Parameters
    ----------
    row : (nv,) array
        Coefficients.
    damping, stiffness : float
        Damper [N s/m in the unit of the combination] and spring [N/m], relaxed in the initial configuration.
    """

    name: str
    row: Array
    damping: float = 0.0
    stiffness: float = 0.0


def with_prescribed(plant: P, structure: Structure, variant: str, *, damped: bool = True) -> P:
    """Return a plant with modal damping and tuned modes.

    Parameters
    ----------
    plant : P
        Plant with its ports and transducers.
    structure : Structure
        Structure with its points, bars and transducers.
    variant : str
        Name of the structure's variant.
    damped : bool
        Whether to prescribe damping.

    Returns
    -------
    P
        Plant with dissipation and restoring matrices.

    Raises
    ------
    BadStructure
        The tuning has more modes than the plant or the FE model.
    """
    linear = plant.linearise()

    def measured(linear: SecondOrderModel) -> Array:
        return measured_modes_of(plant, structure, variant, *linear.eigen)

    restoring = dissipation = None
    if structure.tuning is not None:
        restoring = np.zeros((linear.n, linear.n))
        if structure.tuning.of_fe:
            modes = FeModes.of(plant, linear, structure, variant)
            restoring += modes.stiffness
            plant = modes.seen_at_places(plant)
        meshed = replace(linear, K=linear.K + restoring)
        restoring += meshed.tuning_stiffness(modal_factors(structure.tuning, measured(meshed), meshed.n))
        linear = replace(linear, K=linear.K + restoring)
    dampers = modal_dampers(linear, modal_ratios(structure.damping, measured(linear), linear.n)) if damped else []
    if dampers:
        rows = np.array([damper.row for damper in dampers])
        dissipation = np.asarray(rows.T * [damper.damping for damper in dampers] @ rows)
    springs = [] if restoring is None else tuning_springs(restoring)
    spec = with_modal_tendons(plant.spec, [*springs, *dampers])
    return replace(plant, spec=spec, dissipation=dissipation, restoring=restoring)


def modal_dampers(linear: SecondOrderModel, zeta: Array) -> list[ModalTendon]:
    """Return the dampers for given modal damping ratios.

    The rows are phi^T M, the dampings 2 zeta omega.

    Parameters
    ----------
    linear : SecondOrderModel
        Linear model.
    zeta : (n,) array
        Damping ratios.

    Returns
    -------
    list of ModalTendon
        One damper a damped mode.
    """
    omega, shapes = linear.eigen
    rows = shapes.T @ linear.M
    return [
        ModalTendon(f"damping:{j + 1}", rows[j], damping=2 * zeta[j] * omega[j]) for j in range(linear.n) if zeta[j] > 0
    ]


def tuning_springs(restoring: Array) -> list[ModalTendon]:
    """Return the springs of a tuning stiffness."""
    return [ModalTendon(f"tuning:{k}", row, stiffness=value) for k, (value, row) in enumerate(rank_one(restoring), 1)]


def rank_one(matrix: Array) -> list[tuple[float, Array]]:
    """Return the rank-one terms of a symmetric matrix.

    The matrix is the sum of value row^T row over the pairs.
    """
    values, vectors = np.linalg.eigh(matrix)
    keep = np.abs(values) > 1e-12 * max(np.abs(values).max(), 1e-300)
    return [(float(v), x) for v, x in zip(values[keep], vectors.T[keep], strict=True)]


def with_modal_tendons(spec: Any, tendons: list[ModalTendon]) -> Any:
    """Return a copy of a spec with dampers and springs.

    Both are native fixed tendons on the joints.

    Parameters
    ----------
    spec : object
        MjSpec of the plant.
    tendons : list of ModalTendon
        Dampers and springs.

    Returns
    -------
    object
        Copy of the spec.

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
