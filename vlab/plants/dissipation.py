"""Prescribed modal damping in MuJoCo.

The damping C = sum over modes of (M phi)(2 zeta omega)(M phi)^T couples no modes and is full in joint coordinates.
MuJoCo carries it natively as one fixed tendon a mode, with coefficients phi^T M and damping 2 zeta omega; the model that
a plant writes out has these tendons. Dense tendons cost as much as all the rest of a step, so while a plant runs in the
laboratory the same matrix acts as a generalised force -C qvel instead; a test holds the two against each other.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from vlab.errors import BadStructure
from vlab.fe.second_order import SecondOrderModel
from vlab.signals import Array


@dataclass(frozen=True)
class DampingTendon:
    """A damper on a linear combination of joint velocities.

    Parameters
    ----------
    row : (nv,) array
        Coefficients.
    damping : float
        Damper [N s/m in the unit of the combination].
    """

    name: str
    row: Array
    damping: float


def modal_dampers(linear: SecondOrderModel, zeta: Array) -> list[DampingTendon]:
    """Return the dampers that give a model's modes their ratios: rows phi^T M, damping 2 zeta omega."""
    omega, shapes = linear.eigen
    rows = shapes.T @ linear.M
    return [DampingTendon(f"damping:{j + 1}", rows[j], 2 * zeta[j] * omega[j]) for j in range(linear.n) if zeta[j] > 0]


def dissipation_matrix(dampers: list[DampingTendon]) -> Array | None:
    """Return the damping matrix that the dampers add up to, (nv, nv); None without any."""
    if not dampers:
        return None
    rows = np.array([damper.row for damper in dampers])
    return np.asarray(rows.T * [damper.damping for damper in dampers] @ rows)


def with_damping_tendons(spec: Any, tendons: list[DampingTendon]) -> Any:
    """Return a copy of a spec whose joints carry the dampers as native fixed tendons.

    Raises
    ------
    BadStructure
        A joint has several degrees of freedom, which a fixed tendon cannot take.
    """
    copy = spec.copy()
    names = [joint.name for joint in copy.joints]
    for tendon in tendons:
        if len(names) != tendon.row.size:
            raise BadStructure("prescribed modal damping needs one degree of freedom a joint")
        added = copy.add_tendon(name=tendon.name)
        added.damping[0] = tendon.damping
        largest = np.abs(tendon.row).max()
        for name, coefficient in zip(names, tendon.row, strict=True):
            if abs(coefficient) > 1e-12 * largest:
                added.wrap_joint(name, coefficient)
    return copy
