"""Plant of a replay, with its readings at true states.

MuJoCo's semi-implicit steps keep the position half a step ahead of the velocity (see `vlab.plants.base`). A state here holds
position and velocity at the same time.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from vlab.cases.channel_map import Compared, Run
from vlab.cases.open_loop import motion_of, run_open_loop
from vlab.hardware.sensing import coil_gain
from vlab.physics.port_lines import STAGGERED
from vlab.physics.running import Running
from vlab.plants.base import Plant, Port
from vlab.signals import Array

Loads = Sequence[tuple[Port, float]]
"""Forces [N or N m] on ports."""


@dataclass(frozen=True)
class State:
    """True state: position and velocity at the same time."""

    qpos: Array
    qvel: Array


class NotSafe(Exception):
    """A run that may need more memory than the model has."""


class Bench:
    """Plant with its readings.

    Parameters
    ----------
    plant : Plant
        Plant with the timestep of the run.
    linear_range : float or None
        Travel in which coil sensors are linear [m]; None for hardware outside the laboratory.
    """

    def __init__(self, plant: Plant, linear_range: float | None = None) -> None:
        self.plant, self.model = plant, plant.model
        self.data, self._copy = plant.new_data(), plant.new_data()
        self.rest = State(self.data.qpos.copy(), np.zeros(self.model.nv))
        self.ahead = self.model.opt.timestep / 2 if self.model.opt.integrator in STAGGERED else 0.0
        """Time by which positions are ahead of velocities in `data` [s]."""
        self._sum = np.zeros((len(plant.sensors), self.model.nsensordata))
        for i, tap in enumerate(plant.sensors):
            self._sum[i, list(tap.addresses)] = 1.0
        self.applied = np.zeros(self.model.nv)
        """Generalised external forces of the present step, without attached physics."""
        self._range = linear_range
        self._coils = [i for i, tap in enumerate(plant.sensors) if tap.kind == "velocity"]

    def start(self, state: State) -> None:
        """Set the plant to a true state at time zero."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = state.qpos, state.qvel
        if self.ahead:
            mujoco.mj_integratePos(self.model, self.data.qpos, state.qvel, self.ahead)
        mujoco.mj_forward(self.model, self.data)

    def open_loop(
        self, run: Run, state: State, controls: Array, present: Array, progress: Callable[[float], None]
    ) -> Array:
        """Simulate a run without a law, port loads or attached effects.

        Parameters
        ----------
        run : Run
            Recording with mapped channels.
        state : State
            Initial state.
        controls, present : (n_steps, nu) and (n_readings, nu) array
            Controls of every step and at the readings.
        progress : callable
            Receives the completed share of the run.

        Returns
        -------
        (n_readings, n_channels) array
            Compared channels; zeros for commands.
        """
        self.start(state)
        states, raw = run_open_loop(self.model, self.data, controls, present, ahead=self.ahead, progress=progress)
        out = np.zeros((len(raw), len(run.compared)))
        sensors = self.sensors(raw)
        copy_sensors(run.compared, sensors, out)
        self.copy_ports(run.compared, motion_of(self.model, states), out)
        return out

    @property
    def pair(self) -> tuple[mujoco.MjData, mujoco.MjData]:
        """State of the run, and its copy for readings."""
        return self.data, self._copy

    def copy_ports(self, compared: Sequence[Compared], motion: Sequence[Array], out: Array) -> None:
        """Copy the columns of compared ports along a motion.

        Parameters
        ----------
        compared : sequence of Compared
            Compared channels.
        motion : sequence of array
            Positions (n, nq) and velocities (n, nv) at true states; accelerations (n, nv) where a channel needs them.
        out : (n, n_channels) array
            Compared channels, overwritten where a channel is a port.
        """
        of_ports, data = [(i, c) for i, c in enumerate(compared) if c.sensor is None and c.port], self._copy
        ports = [(self.plant.port(c.port), c.order) for _, c in of_ports]
        moves = not all(port.is_constant and (order > 0 or port.is_joint) for port, order in ports)
        for k in range(len(out)) if of_ports else ():
            for array, values in zip((data.qpos, data.qvel, data.qacc), motion, strict=False):
                array[:] = values[k]
            if moves:
                mujoco.mj_fwdPosition(self.model, data)
            for i, c in of_ports:
                out[k, i] = self._port_value(c)

    def reads_forces(self, compared: tuple[Compared, ...]) -> bool:
        """Return whether compared values depend on forces."""
        return any(c.order == 2 for c in compared) or bool(
            np.any(self.model.sensor_needstage == int(mujoco.mjtStage.mjSTAGE_ACC))
        )

    @property
    def addresses(self) -> set[int]:
        """Sensor values of MuJoCo that the plant's sensors read."""
        return {*np.flatnonzero(self._sum.any(axis=0)).tolist(), *np.arange(self.model.nsensordata)[self.plant.travel]}

    def look(
        self, ctrl: Array, physics: Running | None = None, loads: Loads | None = None, seen: Array | None = None
    ) -> None:
        """Evaluate the present true state in the copy.

        Attached physics acts there without updating its memory.

        Parameters
        ----------
        ctrl : array
            Commands, (n_actuators,).
        physics : Running or None
            Attached physics.
        loads : sequence of (Port, float) or None
            Present forces on ports; None keeps those of the last step.
        seen : array or None
            Commands that laws see, (n_actuators,); those of the last step by default.
        """
        data, model = self._at_present(), self.model
        if loads is not None:
            if not all(port.is_constant for port, _ in loads):  # rows at the present configuration
                mujoco.mj_fwdPosition(model, data)
            self.apply(data, loads)
        data.ctrl[:] = ctrl
        mujoco.mj_forward(model, data)
        if physics is not None and physics.ports is not None:
            data.qfrc_applied[:] = self.applied
            readings = physics.ports.look(data, physics.force if seen is None else seen)
            mujoco.mj_forwardSkip(model, data, int(mujoco.mjtStage.mjSTAGE_VEL), 0)
            data.sensordata += readings

    def apply(self, data: mujoco.MjData, loads: Loads) -> None:
        """Apply port forces and prescribed motion at the state of some data."""
        applied = self.applied
        if self.plant.prescribed is None:
            applied[:] = 0.0
        else:
            self.plant.prescribed(data.qpos, data.qvel, applied)
        for port, load in loads:
            applied += port.row(data) * load
        data.qfrc_applied[:] = applied

    def look_at_motion(self) -> None:
        """Evaluate the present motion in the copy, without forces."""
        data, model = self._at_present(), self.model
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_sensorPos(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_sensorVel(model, data)

    def _at_present(self) -> mujoco.MjData:
        """Return the copy at the present true state."""
        data, model = self._copy, self.model
        mujoco.mj_copyState(model, self.data, data, int(mujoco.mjtState.mjSTATE_INTEGRATION))
        if self.ahead:
            mujoco.mj_integratePos(model, data.qpos, data.qvel, -self.ahead)
        return data

    @property
    def acceleration(self) -> Array:
        """Generalised acceleration of the last `look`, (nv,)."""
        return np.asarray(self._copy.qacc)

    @property
    def raw(self) -> Array:
        """Sensor values of MuJoCo at the last `look`, (nsensordata,)."""
        return np.asarray(self._copy.sensordata)

    def sensors(self, raw: Array | None = None) -> Array:
        """Return the plant's sensor values, (..., n_sensors), from raw values.

        Parameters
        ----------
        raw : array or None
            Sensor values of MuJoCo, (..., nsensordata); those of the last `look` by default.

        Returns
        -------
        array
            Sensor values of the plant, (..., n_sensors).
        """
        raw = self.raw if raw is None else raw
        values = raw @ self._sum.T
        travel = raw[..., self.plant.travel]
        if self._range is not None and travel.shape[-1] == len(self._coils):
            values[..., self._coils] *= coil_gain(travel, self._range)
        return np.asarray(values)

    def values(self, compared: tuple[Compared, ...], sensors: Array) -> Array:
        """Return compared channels at the last `look`, with zeros for commands."""
        return np.array([self._value(c, sensors) for c in compared])

    def _value(self, compared: Compared, sensors: Array) -> float:
        if compared.sensor is not None:
            return float(sensors[compared.sensor])
        return self._port_value(compared) if compared.port else 0.0

    def _port_value(self, compared: Compared) -> float:
        port, data = self.plant.port(compared.port), self._copy
        if compared.order == 0:
            return port.position(data)
        return float(port.row(data) @ (data.qvel if compared.order == 1 else data.qacc))

    def rest_values(self, compared: tuple[Compared, ...]) -> Array:
        """Return the values of compared channels at rest."""
        self.start(self.rest)
        self.look(np.zeros(self.model.nu))
        return self.values(compared, self.sensors())


def at_timestep(plant: Plant, timestep: float) -> Plant:
    """Return the plant with another integration step.

    Parameters
    ----------
    plant : Plant
        Plant.
    timestep : float
        Integration step [s].

    Returns
    -------
    Plant
        Plant with that step.
    """
    if plant.timestep == timestep:
        return plant
    model = copy.copy(plant.model)
    model.opt.timestep = timestep
    return replace(plant, model=model)


def bench_for(plant: Plant, run: Run) -> Bench:
    """Return the bench for a run of a plant."""
    return Bench(plant, None if run.hardware is None else run.hardware.velocity_sensor.linear_range)


def copy_sensors(compared: Sequence[Compared], sensors: Array, out: Array) -> None:
    """Copy the columns of compared sensors.

    Parameters
    ----------
    compared : sequence of Compared
        Compared channels.
    sensors : (n, n_sensors) array
        Sensors of the plant.
    out : (n, n_channels) array
        Compared channels, overwritten where a channel is a sensor.
    """
    for i, c in enumerate(compared):
        if c.sensor is not None:
            out[:, i] = sensors[:, c.sensor]
