"""What a model's own nonlinearity adds to its linear twin, along the recorded motion.

A cable that stretches as a beam swings, or a pendulum at ten degrees: the model knows it, its linear twin does not, and over
a long lightly damped record a frequency that is off by a thousandth is worth many times the noise. So the states are
smoothed from the recordings, the model's inverse dynamics is asked for the generalised forces there, and what these have
that the linear model's have not is a known load on the twin's modes.
"""

import copy
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from vlab.diagnose.kernels.recursion import states_of
from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.parameters.reduced_model import discretise
from vlab.diagnose.predictors.kalman import smoothed_states
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import OWN_NONLINEARITY
from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True, eq=False)
class ModalMotion:
    """Smoothed motion of a run: modal displacements, velocities and accelerations, (n, m) each."""

    q: Array
    v: Array
    a: Array


def with_own_nonlinearity(problem: Problem) -> Problem:
    """Return a problem whose twin carries a load on every mode: what its model's own nonlinearity adds to each of its runs."""
    reduced_model, own = problem.reduced_model, Inverse(problem.plant, problem.reduced_model.shapes)
    signals, intensity = list(problem.signals), {}
    for h in sorted({run.h for run in signals}):
        index = [i for i, run in enumerate(signals) if run.h == h]
        states, intensity[h] = smoothed_states(reduced_model, [signals[i] for i in index])
        for i, x in zip(index, states, strict=True):
            q, v = x[:, : reduced_model.m], x[:, reduced_model.m :]
            motion = ModalMotion(q, v, np.gradient(v, h, axis=0))
            slaves = np.zeros((len(x), own.slaves.shape[1]))
            for _ in range(OWN_NONLINEARITY.passes):
                extra = own.extra(motion, slaves, h)
                slaves = own.followed(extra[:, reduced_model.m :], h)
            signals[i] = replace(signals[i], load=np.hstack([signals[i].load, -_held(extra[:, : reduced_model.m])]))
    return replace(
        problem,
        reduced_model=replace(reduced_model, loads=np.hstack([reduced_model.loads, np.eye(reduced_model.m)])),
        signals=tuple(signals),
        intensity=intensity,
        bare=problem,
    )


class Inverse:
    """The inverse dynamics of a plant on its modes, without what is proportional to the motion.

    Parameters
    ----------
    plant : Plant
        The model.
    shapes : (nv, m) array
        Its modes that are kept; the others are `slaves`: they follow what the nonlinearity drives them by, as the sag of a
        beam follows the square of its deflection.
    """

    def __init__(self, plant: Plant, shapes: Array) -> None:
        self.model, self.rest = plant.model, plant.new_data().qpos.copy()
        self.data = mujoco.MjData(self.model)
        linear = plant.linearise()
        omega, every = linear.eigen
        is_kept = np.abs(every.T @ linear.M @ shapes).max(axis=1) > 0.5
        chosen = ~is_kept & (omega > OWN_NONLINEARITY.least_omega)
        self.shapes, self.slaves, self.omega = shapes, every[:, chosen], omega[chosen]
        self.damping = np.einsum("ij,ik,kj->j", self.slaves, linear.C, self.slaves)
        self.basis = np.hstack([shapes, self.slaves])
        nv = self.model.nv
        self._still = self._forces(self.model, *np.zeros((3, nv)))
        units, none = OWN_NONLINEARITY.small * np.eye(nv), np.zeros(nv)
        smooth = copy.copy(self.model)  # as `linearise` has it: a stop at rest is no spring
        smooth.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self._linear = [
            np.array([self._forces(smooth, *there) - self._forces(smooth, *back) for there, back in motions])
            / (2.0 * OWN_NONLINEARITY.small)
            for motions in (
                [((u, none, none), (-u, none, none)) for u in units],
                [((none, u, none), (none, -u, none)) for u in units],
                [((none, none, u), (none, none, -u)) for u in units],
            )
        ]

    def _forces(self, model: Any, q: Array, v: Array, a: Array) -> Array:
        data = self.data
        data.qpos[:] = self.rest
        mujoco.mj_integratePos(model, data.qpos, q, 1.0)
        data.qvel[:], data.qacc[:] = v, a
        mujoco.mj_inverse(model, data)
        return np.array(data.qfrc_inverse)

    def extra(self, motion: ModalMotion, slaves: Array, h: float) -> Array:
        """Return the extra forces on the modes and the slaves, (n, m + n_slaves).

        Parameters
        ----------
        slaves : (n, n_slaves) array
            Modal displacements of the slaves.
        h : float
            Sample period [s].
        """
        rate = np.gradient(slaves, h, axis=0)
        parts = (
            motion.q @ self.shapes.T + slaves @ self.slaves.T,
            motion.v @ self.shapes.T + rate @ self.slaves.T,
            motion.a @ self.shapes.T + np.gradient(rate, h, axis=0) @ self.slaves.T,
        )
        whole = np.array([self._forces(self.model, *now) for now in zip(*parts, strict=True)]) - self._still
        for part, slope in zip(parts, self._linear, strict=True):
            whole -= part @ slope
        return np.asarray(whole @ self.basis)

    def followed(self, force: Array, h: float) -> Array:
        """Return the modal displacements of the slaves under the reverse of extra forces (n, n_slaves)."""
        count, one = len(self.omega), np.ones((1, 1))
        M, C, K = (np.reshape(part, (count, 1, 1)) for part in (np.ones(count), self.damping, self.omega**2))
        rows = ChannelRows(at_q=one, at_v=0 * one, at_a=0 * one, rest=np.zeros(1))
        system = discretise(M, C, K, one, rows, h)
        drive = -force[:, :, None, None] * system.B.transpose(0, 2, 1)  # (n, n_slaves, 1, 2)
        moved = states_of(np.swapaxes(system.A, 1, 2), drive, np.zeros((count, 1, 2)))
        return np.asarray(moved[:, :, 0, 0])


def _held(force: Array) -> Array:
    """Return a series of samples as means over the step that follows each."""
    return 0.5 * (force + np.vstack([force[1:], force[-1:]]))
