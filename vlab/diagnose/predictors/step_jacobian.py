"""Jacobians of MuJoCo's step and of the channels."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from vlab.cases.channel_map import Compared
from vlab.cases.initial_state import joint_of
from vlab.diagnose.predictors.actuator_states import lags_of
from vlab.diagnose.settings import STEP_JACOBIAN
from vlab.plants.base import Plant, Port
from vlab.plants.effort_sensors import effort_rows
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class Substeps:
    """Integration of a sample interval.

    Parameters
    ----------
    count : int
        Steps of an interval.
    is_implicit : bool
        Whether the steps are implicit in the velocity instead of Runge-Kutta's.
    """

    count: int = 1
    is_implicit: bool = False


class Stepper:
    """Plant stepped from sample to sample.

    The method is Runge-Kutta's, or implicit in the velocity where the plant is too stiff for it.

    Parameters
    ----------
    plant : Plant
        Plant.
    channels : sequence of Compared
        Channels without commands.
    load_ports : sequence of str
        Directly driven ports.
    """

    def __init__(self, plant: Plant, channels: Sequence[Compared], load_ports: Sequence[str] = ()) -> None:
        self.plant, self.channels = plant, tuple(channels)
        self.model = copy.copy(plant.model)
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.data = mujoco.MjData(self.model)
        self.nq, self.nv = int(self.model.nq), int(self.model.nv)
        self.is_flat = self.nq == self.nv
        self.take(Substeps())
        self.lags = lags_of(plant)
        self._loads = [plant.port(name) for name in load_ports]
        self._readers = [_reader(plant, c) for c in self.channels]
        self.at_state = _constant_rows(plant, self.channels)
        """Channels per position and velocity, (p, 2 nv), where all of them are joint motions; else None."""
        self._address = self.model.jnt_qposadr[self.model.dof_jntid] if self.at_state is not None else np.zeros(0, int)
        self._taps = _sensor_rows(plant, self.channels)
        self.efforts = _effort_rows(plant, self.channels)
        """Readings (p, nv) per generalised force of the actuators; zero for channels other than efforts."""
        self._sees_forces = any(
            c.order == 2 or (c.sensor is not None and _needs_acceleration(self.model, plant, c.sensor))
            for c in self.channels
        )
        self._short = copy.copy(self.model)
        self._short.opt.integrator, self._short.opt.timestep = mujoco.mjtIntegrator.mjINT_EULER, STEP_JACOBIAN.short
        self._short.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
        self._short_data = mujoco.MjData(self._short)
        size = 2 * self.nv + int(self.model.na)
        self._A, self._B = np.zeros((size, size)), np.zeros((size, int(self.model.nu)))
        self._C, self._one = np.zeros((int(self.model.nsensordata), size)), np.eye(self.nv)

    def take(self, substeps: Substeps) -> None:
        """Integrate intervals in these substeps from now on."""
        self.substeps = substeps
        methods = mujoco.mjtIntegrator
        self.model.opt.integrator = methods.mjINT_IMPLICITFAST if substeps.is_implicit else methods.mjINT_RK4

    def _set(self, q: Array, v: Array, u: Array, load: Array, act: Array | None, push: Array | None) -> None:
        d = self.data
        d.qpos[:], d.qvel[:], d.time = q, v, 0.0
        d.ctrl[:] = self.plant.control_matrix @ u
        if act is not None:
            d.act[:] = act
        d.qfrc_applied[:] = 0.0 if push is None else push
        if self._loads:
            mujoco.mj_kinematics(self.model, d)
            mujoco.mj_comPos(self.model, d)
            for port, force in zip(self._loads, load, strict=True):
                d.qfrc_applied[:] += port.row(d) * force

    def advance(
        self,
        q: Array,
        v: Array,
        u: Array,
        load: Array,
        h: float,
        act: Array | None = None,
        push: Array | None = None,
    ) -> tuple[Array, Array]:
        """Return the state after an interval with held inputs.

        Parameters
        ----------
        q, v : (nq,), (nv,) array
            Configuration and velocity.
        u, load : (n_actuators,), (n_ports,) array
            Commands and direct forces.
        h : float
            Interval [s].
        act : (na,) array or None
            Actuator states.
        push : (nv,) array or None
            Generalised forces.

        Returns
        -------
        q, v : (nq,), (nv,) array
            State at the end.
        """
        self._set(q, v, u, load, act, push)
        self.model.opt.timestep = h / self.substeps.count
        mujoco.mj_step(self.model, self.data, self.substeps.count)
        return self.data.qpos.copy(), self.data.qvel.copy()

    def read(
        self, q: Array, v: Array, u: Array, load: Array, act: Array | None = None, push: Array | None = None
    ) -> Array:
        """Return the channels (p,) at a state."""
        self._set(q, v, u, load, act, push)
        mujoco.mj_forward(self.model, self.data)
        return np.array([reader(self.data) for reader in self._readers])

    def moved(self, q: Array, change: Array) -> Array:
        """Return a configuration displaced in its tangent space.

        Parameters
        ----------
        q : (nq,) array
            Configuration.
        change : (nv,) array
            Displacement.

        Returns
        -------
        (nq,) array
            Configuration.
        """
        if self.is_flat:
            return q + change
        out = q.copy()
        mujoco.mj_integratePos(self.model, out, change, 1.0)
        return out

    def between(self, a: Array, b: Array) -> Array:
        """Return the displacement between two configurations.

        Parameters
        ----------
        a, b : (nq,) array
            Configurations.

        Returns
        -------
        (nv,) array
            Displacement from a to b.
        """
        if self.is_flat:
            return b - a
        out = np.zeros(self.nv)
        mujoco.mj_differentiatePos(self.model, out, 1.0, a, b)
        return out

    def slopes(
        self, q: Array, v: Array, u: Array, load: Array, act: Array | None = None
    ) -> tuple[Array, Array, Array, Array]:
        """Return the Jacobians of a state's rate.

        The Jacobians come from finite differences of one short semi-implicit step, v+ = v + h a and q+ = q + h v+.

        Parameters
        ----------
        q, v : (nq,), (nv,) array
            Configuration and velocity.
        u, load : (n_actuators,), (n_ports,) array
            Commands and direct forces.
        act : (na,) array or None
            Actuator states.

        Returns
        -------
        L : (2 nv, 2 nv) array
            Derivative of the rate by the state.
        M : (nv, nv) array
            Mass matrix.
        by_control : (nv, nu) array
            Derivative of the accelerations by controls, or by actuator states.
        sensors : (nsensordata, 2 nv) array
            Derivative of MuJoCo's sensors by the state.
        """
        nv, h = self.nv, STEP_JACOBIAN.short
        self._set(q, v, u, load, act, None)
        d, model, mine = self._short_data, self._short, self.data
        d.qpos[:], d.qvel[:], d.ctrl[:], d.qfrc_applied[:] = mine.qpos, mine.qvel, mine.ctrl, mine.qfrc_applied
        if act is not None:
            d.act[:] = act
        mujoco.mjd_transitionFD(model, d, STEP_JACOBIAN.step, False, self._A, self._B, self._C, None)
        L = np.zeros((2 * nv, 2 * nv))
        at_q, at_v = self._A[nv : 2 * nv, :nv], self._A[nv : 2 * nv, nv : 2 * nv]
        L[nv:, :nv] = at_q / h
        L[nv:, nv:] = (at_v - self._one) / h
        if not self.is_flat:  # quaternion tangents rotate with the body
            L[:nv, :nv] = (self._A[:nv, :nv] - self._one - h * at_q) / h
        L[:nv, nv:] = self._one
        M = np.zeros((nv, nv))
        mujoco.mj_fullM(model, d, M)
        by_control = self._B[nv : 2 * nv] / h
        for lag in self.lags.values():
            by_control[:, lag.control] = self._A[nv : 2 * nv, 2 * nv + lag.address] / h
        return L, M, by_control, self._C[:, : 2 * nv]

    def _difference(self, q0: Array, v0: Array, q1: Array, v1: Array) -> Array:
        return np.concatenate([self.between(q0, q1), v1 - v0])

    def reading(
        self, q: Array, v: Array, u: Array, load: Array, act: Array | None, M: Array, sensors: Array
    ) -> tuple[Array, Array, Array]:
        """Return the channels and their Jacobians.

        Parameters
        ----------
        q, v : (nq,), (nv,) array
            Configuration and velocity.
        u, load : (n_actuators,), (n_ports,) array
            Commands and direct forces.
        act : (na,) array or None
            Actuator states.
        M, sensors : array
            Mass matrix and sensor derivatives of `slopes`.

        Returns
        -------
        channels : (p,) array
            Channels.
        C : (p, 2 nv) array
            Derivative by the state.
        D : (p, nv) array
            Derivative by generalised forces.
        """
        nv = self.nv
        if self.at_state is not None:
            here = self.at_state @ np.concatenate([q[self._address], v])
            return here, self.at_state, np.zeros((len(here), nv))
        here = self.read(q, v, u, load, act)
        D = np.zeros((len(here), nv))
        if self._taps is not None:
            C = self._taps @ sensors
        else:
            C = np.zeros((len(here), 2 * nv))
            for i in range(nv):
                change = np.zeros(nv)
                change[i] = STEP_JACOBIAN.step
                C[:, i] = (self.read(self.moved(q, change), v, u, load, act) - here) / STEP_JACOBIAN.step
                C[:, nv + i] = (self.read(q, v + change, u, load, act) - here) / STEP_JACOBIAN.step
        if self._sees_forces:
            force = np.maximum(np.diag(M), 1e-300)  # sensors are linear in accelerations, so any step is exact
            for i in range(nv):
                push = np.zeros(nv)
                push[i] = force[i]
                D[:, i] = (self.read(q, v, u, load, act, push) - here) / force[i]
        return here, C, D

    def find_substeps(self, states: Sequence[tuple[Array, Array, Array, Array, float]]) -> Substeps:
        """Select the fewest substeps that match the model's own step.

        Runge-Kutta steps are short enough to be stable. Where that takes too many, the steps are implicit.

        Parameters
        ----------
        states : sequence of (q, v, u, load, h)
            Test states.

        Returns
        -------
        Substeps
            Substeps, also taken from now on.
        """
        most = STEP_JACOBIAN.most_substeps
        largest = max(h for *_, h in states)
        decay = largest * max(self._fastest_decay(q, v, u, load) for q, v, u, load, _ in states)
        least = decay / STEP_JACOBIAN.stable
        is_implicit = least > most
        own = int(np.ceil(largest / self.plant.timestep - 1e-9))
        resolved = 1 if is_implicit else int(np.ceil(decay / STEP_JACOBIAN.resolved))
        finest = Substeps(count=min(max(1, own, resolved), most), is_implicit=is_implicit)
        self.take(finest)
        exact = [self.advance(q, v, u, load, h) for q, v, u, load, h in states]
        size = np.array([np.abs(self._difference(s[0], s[1], *e)) for s, e in zip(states, exact, strict=True)])
        scale = np.maximum(size.max(axis=0), 1e-12)
        for count in (c for c in STEP_JACOBIAN.trial_substeps if least <= c < finest.count):
            self.take(Substeps(count=count))
            tried = [self.advance(q, v, u, load, h) for q, v, u, load, h in states]
            off = [np.abs(self._difference(*e, *t)) / scale for e, t in zip(exact, tried, strict=True)]
            if np.max(off) <= STEP_JACOBIAN.accurate:
                return self.substeps
        self.take(finest)
        return finest

    def _fastest_decay(self, q: Array, v: Array, u: Array, load: Array) -> float:
        """Return the fastest decay rate of deviations from a state [1/s]."""
        L = self.slopes(q, v, u, load, None)[0]
        return float(max(0.0, -np.linalg.eigvals(L).real.min())) if np.all(np.isfinite(L)) else np.inf


def _reader(plant: Plant, channel: Compared) -> Callable[[Any], float]:
    if channel.sensor is not None:
        addresses = list(plant.sensors[channel.sensor].addresses)
        if len(addresses) == 1:
            only = addresses[0]
            return lambda data: float(data.sensordata[only])
        return lambda data: float(data.sensordata[addresses].sum())
    port: Port = plant.port(channel.port)
    if channel.order == 0:
        return port.position
    if channel.order == 1:
        return lambda data: float(port.row(data) @ data.qvel)
    return lambda data: float(port.row(data) @ data.qacc)


def _sensor_rows(plant: Plant, channels: Sequence[Compared]) -> Array | None:
    """Return the channels per MuJoCo sensor value."""
    out = np.zeros((len(channels), plant.model.nsensordata))
    for i, channel in enumerate(channels):
        if channel.sensor is None:
            return None
        out[i, list(plant.sensors[channel.sensor].addresses)] = 1.0
    return out


def _effort_rows(plant: Plant, channels: Sequence[Compared]) -> Array:
    rows, out = effort_rows(plant.model), np.zeros((len(channels), plant.model.nv))
    for i, channel in enumerate(channels):
        if channel.sensor is not None:
            out[i] = rows[list(plant.sensors[channel.sensor].addresses)].sum(axis=0)
    return out


def _needs_acceleration(model: Any, plant: Plant, sensor: int) -> bool:
    ends = np.append(model.sensor_adr[1:], model.nsensordata)
    owners = [int(np.searchsorted(ends, a, side="right")) for a in plant.sensors[sensor].addresses]
    return any(model.sensor_needstage[i] == mujoco.mjtStage.mjSTAGE_ACC for i in owners)


def _constant_rows(plant: Plant, channels: Sequence[Compared]) -> Array | None:
    out = np.zeros((len(channels), 2 * plant.model.nv))
    for i, channel in enumerate(channels):
        joint = joint_of(plant, channel)
        if joint is None:
            return None
        out[i, joint[0] + joint[1] * plant.model.nv] = 1.0
    return out
