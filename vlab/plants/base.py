"""What every plant offers: a MuJoCo model, named actuators and sensors, and ports.

A port is a named scalar coordinate of the structure, such as the deflection along y at a place. It has a position and a
row of the Jacobian, so physics can be measured at it and act on it, whatever the generalised coordinates are.

Time. MuJoCo's semi-implicit Euler step staggers the two halves of the state: the velocity at index n belongs to the time
t_n when a force held from t_n to t_(n+1) acts in between, and the position then belongs to t_n + h/2. Displacement
sensors of the structure plants undo this half step with the velocity at hand, so that all channels of a recording share
their time stamps to second order.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import mujoco
import numpy as np

from vlab.errors import BadExperiment, Diverged, unknown_name
from vlab.fe.second_order import SecondOrderModel
from vlab.plants.linearise import linearise
from vlab.signals import Array
from vlab.structure.model import Sensor, Structure


@dataclass(frozen=True, kw_only=True)
class ActuatorTap:
    """An actuator: its channel name, where it acts, and the SI unit of its command.

    Parameters
    ----------
    controls : tuple of int
        The MuJoCo controls that take this command, all alike.
    """

    name: str
    at: str
    kind: str = "force"
    unit: str = "N"
    controls: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class SensorTap:
    """A sensor: which of MuJoCo's sensor values add up to it.

    Parameters
    ----------
    addresses : tuple of int
        Indices of the values in ``sensordata`` whose sum it is.
    rates : tuple of int
        Indices of the velocities of the same coordinate, where the half-step stagger of a position is undone.
    """

    name: str
    at: str
    kind: str
    unit: str
    addresses: tuple[int, ...]
    rates: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Port:
    """A named scalar coordinate of a plant.

    Parameters
    ----------
    row : callable
        MjData -> (nv,) Jacobian row of the coordinate at the present configuration.
    position : callable
        MjData -> value [m or rad].
    stiffness : float
        Of the elastic element that the coordinate is the deflection of [N/m or N m/rad]; 0 without one.
    is_constant : bool
        Whether the row is the same in every configuration.
    more : sequence of Port
        Other coordinates on which an effect at this place acts in the same way: three directions of a body, the elements
        of a stretched bar.
    tag : str
        What the place is besides a coordinate: ``"tension"`` for the rows of a stretched bar, ``"floor"``, ``"body"``.
    """

    name: str
    unit: str
    row: Callable[[Any], Array]
    position: Callable[[Any], float]
    stiffness: float = 0.0
    is_constant: bool = False
    more: tuple["Port", ...] = ()
    tag: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plant:
    """A structure in MuJoCo.

    Parameters
    ----------
    name : str
        ``"composite"``, ``"modal"`` or ``"mjcf"``.
    model : mujoco.MjModel
        Compiled; its initial configuration is the equilibrium.
    actuators, sensors : sequence
        In channel order.
    ports : mapping of str to Port
        Named coordinates; a structure plant has one at every point of the drawing.
    spec : mujoco.MjSpec
        The whole plant as it is written out, its dissipation as native tendons.
    dissipation, restoring : (nv, nv) array or None
        Damping and stiffness matrix that act as -C qvel - K (qpos - qpos0) while the plant runs; see
        `vlab.plants.mode_by_mode`.
    travel : slice
        Where the displacements of the velocity sensors' coils stand in ``sensordata``, in the order of those sensors;
        empty where a plant does not know them.
    left_out : sequence of str
        What this plant does not carry of the structure, in words.
    physics : sequence
        Effects that MuJoCo has no element for and that act while the plant runs; see `vlab.physics.attach`.
    impedance : tuple of (nv, nv) array, or None
        Mass, damping and stiffness that those effects add for small motion.
    """

    name: str
    model: Any
    spec: Any
    actuators: tuple[ActuatorTap, ...]
    sensors: tuple[SensorTap, ...]
    ports: Mapping[str, Port] = field(default_factory=dict)
    dissipation: Array | None = None
    restoring: Array | None = None
    travel: slice = field(default_factory=lambda: slice(0, 0))
    left_out: tuple[str, ...] = ()
    physics: tuple[Any, ...] = ()
    impedance: tuple[Array, Array, Array] | None = None

    @property
    def timestep(self) -> float:
        """Integration step [s]."""
        return float(self.model.opt.timestep)

    def linearise(self) -> SecondOrderModel:
        """Return M, C and K about the equilibrium, what is prescribed mode by mode included."""
        return self._with_added(linearise(self.model))

    def _with_added(self, linear: SecondOrderModel) -> SecondOrderModel:
        """Return a linearisation of the bare model with what acts on it as generalised forces."""
        if self.dissipation is not None:
            linear = replace(linear, C=linear.C + self.dissipation)
        if self.restoring is not None:
            linear = replace(linear, K=linear.K + self.restoring)
        if self.impedance is None:
            return linear
        M, C, K = self.impedance
        return replace(linear, M=linear.M + M, C=linear.C + C, K=linear.K + K)

    @cached_property
    def prescribed(self) -> Callable[[Array, Array, Array], Any] | None:
        """What writes the generalised force of dissipation and restoring, given qpos, qvel and where to; None without any."""
        if self.restoring is None:
            if self.dissipation is None:
                return None
            damp = (-self.dissipation).dot
            return lambda qpos, qvel, out: damp(qvel, out)
        restore, rest = (-self.restoring).dot, self.model.qpos0.copy()
        loss = np.zeros_like(self.restoring) if self.dissipation is None else -self.dissipation

        def write(qpos: Array, qvel: Array, out: Array) -> None:
            np.dot(loss, qvel, out)
            out += restore(qpos - rest)

        return write

    def own_stiffness(self, name: str) -> float:
        """Return the stiffness of the elastic element whose deflection a port is; 0 without one."""
        return self.port(name).stiffness

    def with_physics_of(self, other: "Plant") -> Self:
        """Return this plant with the physics that is attached to another one of the same make."""
        return replace(self, physics=other.physics, impedance=other.impedance)

    def port_rows(self, names: Sequence[str] | None = None) -> Array:
        """Return the Jacobian rows of ports at equilibrium, (n_ports, nv); all of them by default."""
        data = self.new_data()
        rows = [self.port(name).row(data) for name in (self.ports if names is None else names)]
        return np.array(rows).reshape(-1, self.model.nv)

    def port(self, name: str) -> Port:
        """Return a port, or raise `UnknownName` with the ones there are."""
        if name not in self.ports:
            raise unknown_name("port", name, self.ports, where=f"plant {self.name!r}")
        return self.ports[name]

    def new_data(self) -> Any:
        """Return fresh `MjData` at equilibrium."""
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        return data

    def substeps(self, rate_hz: float) -> int:
        """Return the integration steps per sample, or refuse a rate that is not a whole multiple of the step.

        Raises
        ------
        BadExperiment
            The sample period is not an integer number of steps.
        """
        if not (np.isfinite(rate_hz) and rate_hz > 0):
            raise BadExperiment(f"the rate {rate_hz} Hz is not a positive number")
        steps = 1.0 / (rate_hz * self.timestep)
        count = round(steps)
        if count < 1 or abs(steps - count) > 1e-6 * steps:
            fitting = [1.0 / (self.timestep * k) for k in (max(1, int(steps)), int(steps) + 1)]
            raise BadExperiment(
                f"a rate of {rate_hz:g} Hz is {steps:.4g} steps of {self.timestep:g} s a sample, not a whole number; "
                f"rates that fit are {' or '.join(f'{f:g} Hz' for f in dict.fromkeys(fitting))}"
            )
        return count

    def actuator_index(self, name: str) -> int:
        """Return the index of an actuator by channel name or place."""
        return self._index("actuator", name, self.actuators)

    def sensor_index(self, name: str) -> int:
        """Return the index of a sensor by channel name or place."""
        return self._index("sensor", name, self.sensors)

    def _index(self, kind: str, name: str, taps: tuple[Any, ...]) -> int:
        for i, tap in enumerate(taps):
            if name in (tap.name, tap.at):
                return i
        raise unknown_name(kind, name, [tap.name for tap in taps], where=f"plant {self.name!r}")

    @cached_property
    def sensor_matrix(self) -> Array:
        """What gives the sensor values from MuJoCo's ``sensordata``, (n_sensors, n_sensordata)."""
        matrix = np.zeros((len(self.sensors), self.model.nsensordata))
        for i, tap in enumerate(self.sensors):
            matrix[i, list(tap.addresses)] = 1.0
            matrix[i, list(tap.rates)] -= self.timestep / 2
        return matrix

    @cached_property
    def control_matrix(self) -> Array:
        """What gives MuJoCo's controls from the actuators' commands, (nu, n_actuators)."""
        matrix = np.zeros((self.model.nu, len(self.actuators)))
        for i, tap in enumerate(self.actuators):
            matrix[list(tap.controls), i] = 1.0
        return matrix

    def read(self, data: Any) -> Array:
        """Return all sensor values at the present state, (n_sensors,)."""
        return np.asarray(self.sensor_matrix @ data.sensordata)

    def deflections(self, data: Any) -> Array:
        """Return the positions of all ports at the present state."""
        return np.array([port.position(data) for port in self.ports.values()])


SENSOR_UNITS = {"velocity": "m/s", "displacement": "m"}
"""SI unit of what a structure's sensors measure."""


def named_sensors(structure: Structure) -> list[tuple[str, Sensor]]:
    """Return a structure's coil sensors and probes with their channel names, in channel order."""
    return [(f"sensor:{s.name}", s) for s in structure.sensor] + [(f"probe:{s.name}", s) for s in structure.probe]


def travel_name(sensor: Sensor) -> str:
    """Return the name of the value that says how far a coil sensor is from its centre."""
    return f"sensor:{sensor.name}:travel"


def sensor_taps(structure: Structure, addresses: Callable[[str], tuple[int, ...]]) -> tuple[SensorTap, ...]:
    """Return the taps of a structure's sensors and probes, in channel order.

    Parameters
    ----------
    addresses : callable
        Name of a sensor, or of the velocity beside a displacement (``NAME:rate``) -> where its values stand.
    """
    return tuple(
        SensorTap(
            name=name,
            at=sensor.name,
            kind=sensor.kind,
            unit=SENSOR_UNITS[sensor.kind],
            addresses=addresses(name),
            rates=addresses(f"{name}:rate") if sensor.kind == "displacement" else (),
        )
        for name, sensor in named_sensors(structure)
    )


def set_options(spec: Any, title: str, *, gravity: float = 0.0) -> None:
    """Name a spec and set what all structure plants share: semi-implicit Euler, gravity along -z, no contacts."""
    spec.modelname = title
    spec.option.gravity = [0.0, 0.0, -gravity]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)


def without_limits(plant: Plant) -> Plant:
    """Return a plant whose actuators have no limits: a unit command may be far outside of them."""
    model = copy.copy(plant.model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    model.actuator_forcelimited[:] = 0
    model.jnt_actfrclimited[:] = 0
    model.tendon_actfrclimited[:] = 0
    return replace(plant, model=model)


_DIVERGED = ("mjWARN_BADQPOS", "mjWARN_BADQVEL", "mjWARN_BADQACC", "mjWARN_BADCTRL")


def has_diverged(data: Any) -> list[str]:
    """Return the names of MuJoCo's warnings of states or controls beyond what it takes for sane, with which it begins anew."""
    return [name for name in _DIVERGED if data.warning[getattr(mujoco.mjtWarning, name)].number]


def check_run(model: Any, data: Any, expected_time: float) -> None:
    """Refuse the state of a run that diverged or that MuJoCo reset on its own.

    Raises
    ------
    Diverged
        A BADQPOS, BADQVEL or BADQACC warning was counted, the clock is not where it must be, or a number is not finite.
    """
    bad = has_diverged(data)
    if bad or abs(data.time - expected_time) > 0.5 * model.opt.timestep or not np.all(np.isfinite(data.qpos)):
        raise Diverged(
            f"the simulation diverged before t = {expected_time:.4g} s ({', '.join(bad) or 'the clock was reset'}): "
            f"the loop is unstable or the step of {model.opt.timestep:g} s is too long for this model"
        )
