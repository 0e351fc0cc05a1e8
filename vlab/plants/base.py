"""Interface of a plant: a MuJoCo model with actuators, sensors and ports.

A port is a named scalar coordinate of the structure, such as the deflection along y at a place. A port has a position
and a Jacobian row. Physics can be measured at a port and act on it, whatever the generalised coordinates.

Time stamps: MuJoCo's semi-implicit Euler step staggers the state. The velocity at index n belongs to t_n if a force is
held from t_n to t_(n+1). The position at index n belongs to t_n + h/2. Displacement sensors of the structure plants
undo the half step with the present velocity. All channels then share their time stamps to second order.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
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
    """An actuator with channel name, place and SI unit.

    Parameters
    ----------
    controls : tuple of int
        MuJoCo controls that take the command, all alike.
    """

    name: str
    at: str
    kind: str = "force"
    unit: str = "N"
    controls: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class SensorTap:
    """A sensor as a sum of MuJoCo sensor values.

    Parameters
    ----------
    addresses : tuple of int
        Indices in ``sensordata`` of the summed values.
    rates : tuple of int
        Indices of the velocities of the same coordinate, for undoing the half-step stagger of a position.
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
        Stiffness of the elastic element with the coordinate as deflection [N/m or N m/rad]; 0 without an element.
    is_constant : bool
        Whether the row is independent of the configuration.
    more : sequence of Port
        Further coordinates with the same effect: three directions of a body, the elements of a stretched bar.
    tag : str
        Additional meaning of the place: ``"tension"`` for the rows of a stretched bar, ``"floor"``, ``"body"``.
    """

    name: str
    unit: str
    row: Callable[[Any], Array]
    position: Callable[[Any], float]
    stiffness: float = 0.0
    is_constant: bool = False
    more: tuple["Port", ...] = ()
    tag: str = ""

    @property
    def is_joint(self) -> bool:
        """Whether the coordinate is that of a joint, which `qpos` holds."""
        return self.name.startswith("joint:")


@dataclass(frozen=True, kw_only=True, eq=False)
class Plant:
    """A structure in MuJoCo.

    Parameters
    ----------
    name : str
        ``"composite"``, ``"fe"``, ``"linear"``, ``"modal"`` or ``"mjcf"``.
    model : mujoco.MjModel
        Compiled model; its initial configuration is the equilibrium.
    spec : mujoco.MjSpec
        Complete plant for export, with its dissipation as native tendons.
    actuators, sensors : sequence
        In channel order.
    ports : mapping of str to Port
        Named coordinates; a structure plant has one at every point of the drawing.
    dissipation, restoring : (nv, nv) array or None
        Damping and stiffness matrix of the running plant, acting as -C qvel - K (qpos - qpos0); see
        `vlab.plants.mode_by_mode`.
    travel : slice
        Indices in ``sensordata`` of the displacements of the velocity sensors' coils, in sensor order; empty if
        unknown.
    left_out : sequence of str
        Properties of the structure that the plant lacks.
    physics : sequence
        Effects without a MuJoCo element, active while the plant runs; see `vlab.physics.attach`.
    impedance : tuple of (nv, nv) array, or None
        Mass, damping and stiffness of `physics` for small motion.
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
        """Return M, C and K about the equilibrium.

        The matrices include the prescribed modal damping and tuning.
        """
        return self._with_added(linearise(self.model))

    def _with_added(self, linear: SecondOrderModel) -> SecondOrderModel:
        """Return a linearisation with the added generalised forces."""
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
        """Writer of the prescribed dissipation and restoring force.

        The arguments are qpos, qvel and the output array. None without such forces.
        """
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
        """Return the stiffness of a port's elastic element.

        The result is 0 without an element.
        """
        return self.port(name).stiffness

    def with_physics_of(self, other: "Plant") -> Self:
        """Return the plant with the effects of a similar plant."""
        return replace(self, physics=other.physics, impedance=other.impedance)

    def points_of(self, structure: Structure) -> list[str]:
        """Return the points of a structure that are ports."""
        return [point.name for point in structure.point if point.name in self.ports]

    def port_rows(self, names: Sequence[str] | None = None) -> Array:
        """Return the Jacobian rows of ports, (n_ports, nv).

        The rows belong to equilibrium; the default is all ports.
        """
        data = self.new_data()
        rows = [self.port(name).row(data) for name in (self.ports if names is None else names)]
        return np.array(rows).reshape(-1, self.model.nv)

    def actuator_forces(self) -> Array:
        """Return the generalised forces of unit commands, (nv, n_actuators).

        Each is half the difference between a command and its opposite at equilibrium, without limits
        [N or N m per unit command].
        """
        plant = without_limits(self)
        data = plant.new_data()
        out = np.zeros((plant.model.nv, len(plant.actuators)))
        for i, sign in product(range(len(plant.actuators)), (1.0, -1.0)):
            data.ctrl[:] = sign * plant.control_matrix[:, i]
            mujoco.mj_forward(plant.model, data)
            out[:, i] += 0.5 * sign * data.qfrc_actuator
        return out

    def port(self, name: str) -> Port:
        """Return a port by name.

        Parameters
        ----------
        name : str
            Name of the port.

        Raises
        ------
        UnknownName
            No such port.
        """
        if name not in self.ports:
            raise unknown_name("port", name, self.ports, where=f"plant {self.name!r}")
        return self.ports[name]

    def new_data(self) -> Any:
        """Return fresh `MjData` at equilibrium."""
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        return data

    def substeps(self, rate_hz: float) -> int:
        """Return the number of integration steps per sample.

        Parameters
        ----------
        rate_hz : float
            Sample rate [Hz].

        Returns
        -------
        int
            Steps per sample.

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
        """Return an actuator's index by channel name or place."""
        return self._index("actuator", name, self.actuators)

    def sensor_index(self, name: str) -> int:
        """Return a sensor's index by channel name or place."""
        return self._index("sensor", name, self.sensors)

    def _index(self, kind: str, name: str, taps: tuple[Any, ...]) -> int:
        for i, tap in enumerate(taps):
            if name in (tap.name, tap.at):
                return i
        raise unknown_name(kind, name, [tap.name for tap in taps], where=f"plant {self.name!r}")

    @cached_property
    def sensor_matrix(self) -> Array:
        """Matrix from ``sensordata`` to sensor values, (n_sensors, n_sensordata)."""
        matrix = np.zeros((len(self.sensors), self.model.nsensordata))
        for i, tap in enumerate(self.sensors):
            matrix[i, list(tap.addresses)] = 1.0
            matrix[i, list(tap.rates)] -= self.timestep / 2
        return matrix

    @cached_property
    def control_matrix(self) -> Array:
        """Matrix from actuator commands to controls, (nu, n_actuators)."""
        matrix = np.zeros((self.model.nu, len(self.actuators)))
        for i, tap in enumerate(self.actuators):
            matrix[list(tap.controls), i] = 1.0
        return matrix

    def read(self, data: Any) -> Array:
        """Return all sensor values at the present state, (n_sensors,)."""
        return np.asarray(self.sensor_matrix @ data.sensordata)

    def deflections(self, data: Any) -> Array:
        """Return the present positions of all ports."""
        return np.array([port.position(data) for port in self.ports.values()])


SENSOR_UNITS = {"velocity": "m/s", "displacement": "m"}
"""SI unit by kind of structure sensor."""


def named_sensors(structure: Structure) -> list[tuple[str, Sensor]]:
    """Return a structure's sensors and probes in channel order.

    Each comes with its channel name.
    """
    return [(f"sensor:{s.name}", s) for s in structure.sensor] + [(f"probe:{s.name}", s) for s in structure.probe]


def travel_name(sensor: Sensor) -> str:
    """Return the name of a coil sensor's travel value.

    The travel is the distance from the coil's centre.
    """
    return f"sensor:{sensor.name}:travel"


def sensor_taps(structure: Structure, addresses: Callable[[str], tuple[int, ...]]) -> tuple[SensorTap, ...]:
    """Return a structure's sensor taps in channel order.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    addresses : callable
        Name of a sensor, or of the velocity beside a displacement (``NAME:rate``), to its indices in ``sensordata``.

    Returns
    -------
    tuple of SensorTap
        One tap a sensor or probe.
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
    """Set a spec's name and the options common to structure plants.

    The options are semi-implicit Euler, gravity along -z, no contacts.
    """
    spec.modelname = title
    spec.option.gravity = [0.0, 0.0, -gravity]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)


def without_limits(plant: Plant) -> Plant:
    """Return a plant without actuator limits.

    A unit command may exceed the limits.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.

    Returns
    -------
    Plant
        Copy with unlimited actuators.
    """
    model = copy.copy(plant.model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    model.actuator_forcelimited[:] = 0
    model.jnt_actfrclimited[:] = 0
    model.tendon_actfrclimited[:] = 0
    return replace(plant, model=model)


ONE_WAY = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
"""ONE_WAY [-]: joint types with one degree of freedom, whose position is the integral of their velocity."""
_DIVERGED = ("mjWARN_BADQPOS", "mjWARN_BADQVEL", "mjWARN_BADQACC", "mjWARN_BADCTRL")


def has_diverged(data: Any) -> list[str]:
    """Return the names of MuJoCo's divergence warnings.

    MuJoCo resets a state or control beyond its limits and counts a warning.
    """
    counts = data.warning.number
    return [name for name in _DIVERGED if counts[getattr(mujoco.mjtWarning, name)]] if counts.any() else []


def check_run(model: Any, data: Any, expected_time: float) -> None:
    """Refuse the state of a diverged or reset run.

    Parameters
    ----------
    model : object
        Compiled MuJoCo model.
    data : object
        State of the run.
    expected_time : float
        Simulated time that the clock must have [s].

    Raises
    ------
    Diverged
        A BADQPOS, BADQVEL or BADQACC warning was counted, the clock differs from the expected time, or a number is not
        finite.
    """
    bad = has_diverged(data)
    if bad or abs(data.time - expected_time) > 0.5 * model.opt.timestep or not np.isfinite(data.qpos).all():
        raise Diverged(
            f"the simulation diverged before t = {expected_time:.4g} s ({', '.join(bad) or 'the clock was reset'}): "
            f"the loop is unstable or the step of {model.opt.timestep:g} s is too long for this model"
        )
