"""Forces of a model's own nonlinearity, as modal loads.

Examples are a cable that stretches as a beam swings, or a pendulum at ten degrees. A frequency error of a thousandth
exceeds the noise many times over long lightly damped records. The states are smoothed from the recordings, and inverse
dynamics gives the generalised forces. Their difference from the linear model is a known modal load.
"""

import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import mujoco
import numpy as np

from vlab.diagnose.kernels.recursion import states_of
from vlab.diagnose.parameters.discrete import discretise
from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.predictors.kalman import smoothed_states
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import OWN_NONLINEARITY
from vlab.parallel import side_by_side
from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True, eq=False)
class ModalMotion:
    """Smoothed modal displacements, velocities and accelerations, (n, m)."""

    q: Array
    v: Array
    a: Array


def with_own_nonlinearity(problem: Problem) -> Problem:
    """Return a problem with nonlinear modal loads.

    Parameters
    ----------
    problem : Problem
        Problem.

    Returns
    -------
    Problem
        Problem with loads on every mode and run.
    """
    reduced_model, own = problem.reduced_model, Inverse(problem.plant, problem.reduced_model.shapes)
    signals, intensity = list(problem.signals), {}
    for h in sorted({run.h for run in signals}):
        index = [i for i, run in enumerate(signals) if run.h == h]
        states, intensity[h] = smoothed_states(reduced_model.at_start, [signals[i] for i in index])
        loads = side_by_side(partial(_loads, own, h), states)
        for i, load in zip(index, loads, strict=True):
            signals[i] = replace(signals[i], load=np.hstack([signals[i].load, load]))
    return replace(
        problem,
        reduced_model=reduced_model.with_loads(np.eye(reduced_model.m)),
        signals=tuple(signals),
        intensity=intensity,
        bare=problem,
    )


def _loads(own: "Inverse", h: float, states: Array) -> Array:
    """Return the nonlinear modal loads (n, m) along smoothed states (n, 2m)."""
    m = own.shapes.shape[1]
    v = states[:, m:]
    motion, slaves = ModalMotion(states[:, :m], v, np.gradient(v, h, axis=0)), np.zeros((len(v), own.slaves.shape[1]))
    for _ in range(OWN_NONLINEARITY.passes):
        extra = own.extra(motion, slaves, h)
        slaves = own.followed(extra[:, m:], h)
    return -_held(extra[:, :m])


class Inverse:
    """Nonlinear part of a plant's inverse dynamics in modal coordinates.

    Parameters
    ----------
    plant : Plant
        Plant.
    shapes : (nv, m) array
        Dynamic modes. Other modes are `slaves` driven by the nonlinearity, as a beam's sag is by its squared
        deflection.
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
        smooth = copy.copy(self.model)  # as in `linearise`, where a stop at rest is no spring
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
        """Return the nonlinear forces on modes and slaves.

        Parameters
        ----------
        motion : ModalMotion
            Motion of the dynamic modes.
        slaves : (n, n_slaves) array
            Modal displacements of the slaves.
        h : float
            Sample period [s].

        Returns
        -------
        (n, m + n_slaves) array
            Modal forces.
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
        """Return the slaves' displacements under reversed nonlinear forces.

        Parameters
        ----------
        force : (n, n_slaves) array
            Nonlinear forces on the slaves.
        h : float
            Sample period [s].

        Returns
        -------
        (n, n_slaves) array
            Modal displacements.
        """
        count, one = len(self.omega), np.ones((1, 1))
        M, C, K = (np.reshape(part, (count, 1, 1)) for part in (np.ones(count), self.damping, self.omega**2))
        rows = ChannelRows(at_q=one, at_v=0 * one, at_a=0 * one, rest=np.zeros(1))
        system = discretise(M, C, K, one, rows, h)
        drive = -force[:, :, None, None] * system.B.transpose(0, 2, 1)  # (n, n_slaves, 1, 2)
        moved = states_of(np.swapaxes(system.A, 1, 2), drive, np.zeros((count, 1, 2)))
        return np.asarray(moved[:, :, 0, 0])


def _held(force: Array) -> Array:
    """Return samples as means over the following step."""
    return 0.5 * (force + np.vstack([force[1:], force[-1:]]))
