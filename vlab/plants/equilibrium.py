"""Equilibrium of a MuJoCo model."""

from typing import Any

import mujoco
import numpy as np

from vlab.errors import BadStructure
from vlab.plants.base import has_diverged
from vlab.plants.computable import check_numbers, computable
from vlab.signals import Array

RELAXING_STEPS, SMALL = 60_000, 300
"""RELAXING_STEPS [1]: largest number of integration steps of dynamic relaxation.
SMALL [1]: degrees of freedom and constraints up to which a step counts once. A step of a larger model counts more,
in proportion to its cost."""


def settle(model: Any, near: Array | None = None) -> tuple[Array, list[str]]:
    """Return the equilibrium configuration and notes.

    The search starts at the keyframe ``rest``, or else the first keyframe, or else ``qpos0``. If the forces do not
    balance there, dynamic relaxation removes the kinetic energy at every peak [1]_. Newton's method then refines the
    result.

    Parameters
    ----------
    model : object
        Compiled MuJoCo model.
    near : (nq,) array or None
        Equilibrium of a similar model, from which Newton's method is tried first.

    Returns
    -------
    tuple of (nq,) array and list of str
        Configuration and notes.

    Raises
    ------
    BadStructure
        The forces at the start are not finite, or MuJoCo lacks memory.

    References
    ----------
    .. [1] P. Underwood, Dynamic relaxation, in T. Belytschko and T. J. R. Hughes (eds.), Computational Methods for
           Transient Analysis, North-Holland, 1983, ch. 5.
    """
    with computable("the model where it starts"):
        forces = Forces(model)
        if near is not None and forces.is_balanced(rest := _newton(forces, near)):
            return rest, []
        return _settled(forces, model)


def _settled(forces: "Forces", model: Any) -> tuple[Array, list[str]]:
    names = [model.key(i).name for i in range(model.nkey)]
    key = names.index("rest") if "rest" in names else 0
    start = model.key_qpos[key].copy() if names else model.qpos0.copy()
    left, tolerance = forces.left(start)
    check_numbers(left, "a force on the model where it starts")
    forces.check_memory()
    if np.abs(left).max() <= tolerance:
        return start, _free_motion(forces, start)
    rest = _newton(forces, _relax(forces, start))
    if not forces.is_balanced(rest):
        left = np.abs(forces.left(rest)[0]).max()
        return start, [
            f"no equilibrium was found (a force of {left:.3g} is left over): the model falls or slides "
            "freely, or rests on contacts; it starts from its initial configuration and has no linearisation"
        ]
    moved = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, moved, 1.0, start, rest)
    note = f"the initial configuration is no equilibrium: settled, moving joints by up to {np.abs(moved).max():.4g} (m or rad)"
    return rest, [note, *_free_motion(forces, rest)]


class Forces:
    """Residual forces of a model at rest."""

    def __init__(self, model: Any) -> None:
        self.model = model
        self._data = mujoco.MjData(model)

    def left(self, qpos: Array) -> tuple[Array, float]:
        """Return the residual forces and their tolerance.

        The tolerance is the one of `linearise`.

        Parameters
        ----------
        qpos : array
            Configuration, (nq,).

        Returns
        -------
        tuple of (array, float)
            Forces (nv,) and tolerance.
        """
        data = self._data
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = qpos
        mujoco.mj_forward(self.model, data)
        scale = np.abs(data.qfrc_bias).max() + np.abs(data.qfrc_passive).max()
        return np.array(data.qfrc_smooth + data.qfrc_constraint), 1e-6 * scale + 1e-9

    def is_balanced(self, qpos: Array) -> bool:
        """Return whether the residual forces are within their tolerance."""
        left, tolerance = self.left(qpos)
        return bool(np.abs(left).max() <= tolerance)

    def check_memory(self) -> None:
        """Refuse a model with omitted contacts or constraints.

        MuJoCo omits contacts and constraints that exceed its memory.

        Raises
        ------
        BadStructure
            The last evaluation ran out of memory; MuJoCo itself only warns.
        """
        full = (mujoco.mjtWarning.mjWARN_CONTACTFULL, mujoco.mjtWarning.mjWARN_CNSTRFULL)
        if any(self._data.warning[kind].number for kind in full):
            raise BadStructure(
                f"the model where it starts: MuJoCo cannot compute it: the memory of the model ({self.model.narena / 1e6:.3g} MB) "
                "does not hold its contacts and constraints; make <size memory> larger, or let fewer bodies touch"
            )


def _relax(forces: Forces, start: Array) -> Array:
    model = forces.model
    data = mujoco.MjData(model)
    data.qpos[:] = start
    kinetic, steps = 0.0, 0.0
    while steps < RELAXING_STEPS:
        mujoco.mj_step(model, data)
        steps += max(1.0, (model.nv + data.nefc) / SMALL)
        if has_diverged(data):  # MuJoCo reset the state and would again
            return start
        mujoco.mj_energyVel(model, data)
        if data.energy[1] < kinetic:
            data.qvel[:] = 0.0
            left, tolerance = forces.left(data.qpos)
            if np.abs(left).max() <= 1e3 * tolerance:
                break
            kinetic = 0.0
        else:
            kinetic = float(data.energy[1])
    return np.array(data.qpos) if np.all(np.isfinite(data.qpos)) else start


def _stiffness(forces: Forces, qpos: Array) -> Array:
    step, model = 1e-6, forces.model
    K = np.zeros((model.nv, model.nv))
    for i in range(model.nv):
        sides = []
        for sign in (1.0, -1.0):
            moved, unit = qpos.copy(), np.zeros(model.nv)
            unit[i] = 1.0
            mujoco.mj_integratePos(model, moved, unit, sign * step)
            sides.append(forces.left(moved)[0])
        with np.errstate(over="ignore", invalid="ignore"):  # a check follows
            K[:, i] = (sides[1] - sides[0]) / (2 * step)
    check_numbers(K, "a stiffness of the model where it starts")
    return K


def _newton(forces: Forces, qpos: Array) -> Array:
    left, tolerance = forces.left(qpos)
    for _ in range(30):
        if np.abs(left).max() <= 1e-3 * tolerance:
            break
        step = np.linalg.lstsq(_stiffness(forces, qpos), left, rcond=1e-10)[0]
        for fraction in 0.5 ** np.arange(8):
            moved = qpos.copy()
            mujoco.mj_integratePos(forces.model, moved, step, fraction)
            trial = forces.left(moved)[0]
            if np.abs(trial).max() < np.abs(left).max():
                qpos, left = moved, trial
                break
        else:
            break
    return qpos


def _free_motion(forces: Forces, rest: Array) -> list[str]:
    """Return notes on motions without restoring force."""
    K = _stiffness(forces, rest)
    stiffness = np.linalg.eigvalsh((K + K.T) / 2)
    largest = np.abs(stiffness).max()
    loose, unstable = int(np.sum(np.abs(stiffness) <= 1e-9 * largest)), int(np.sum(stiffness < -1e-9 * largest))
    notes = []
    if largest == 0.0 or loose:
        count = len(K) if largest == 0.0 else loose
        notes.append(
            f"{count} direction{'s are' if count > 1 else ' is'} free to move: no spring holds {'them' if count > 1 else 'it'}"
        )
    if unstable:
        notes.append(f"the equilibrium is unstable in {unstable} direction{'s' if unstable > 1 else ''}")
    return notes
