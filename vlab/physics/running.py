"""Effects in a running plant: port forces, command changes, sample changes.

A port force joins MuJoCo's applied forces once an integration step. All forces of a step come from one solution. Mass
and damping at ports are implicit, as in the matrices; every other law uses the port motion under them.

With the ports' rows R, the compliance is G = R M^-1 R^T. Mass m and damping c at a port give D = m + c h/2. The port
acceleration is (I + G D)^-1 (R M^-1 f + G g), with the explicit forces g.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from vlab.physics.attached import AtActuator, AtPort, AtSensor
from vlab.physics.effect import (
    ActuatorStep,
    LinearPortEffect,
    SensorStep,
    Step,
    Values,
)
from vlab.physics.port_lines import PortLines, command_of
from vlab.plants.base import Plant
from vlab.signals import Array

_Source = Callable[[Any, Array], float]
"""MjData and commands to the command that a law sees."""


def _source(plant: Plant, a: AtPort) -> _Source:
    """Return the source of the command that a law sees."""
    coil, state = command_of(plant, a)
    if coil < 0:
        return lambda data, commands: 0.0
    return lambda data, commands: float(data.act[state] if state >= 0 else commands[coil])


class PortForces:
    """Port forces of one run, with their memory.

    Parameters
    ----------
    plant : Plant
        Plant of the run.
    attached : sequence of AtPort
        Effects in any order.
    """

    def __init__(self, plant: Plant, attached: Sequence[AtPort]) -> None:
        data = plant.new_data()
        self._model, self._h, self.lines = plant.model, plant.timestep, PortLines.of(plant, attached, data)
        lines = self.lines
        self._rows, self._solved = lines.rows.copy(), np.zeros_like(lines.rows)
        self._solve(data)
        self._moving = [i for i, port in enumerate(lines.ports) if not port.is_constant]
        self._laws: list[tuple[int, Any, Values, _Source]] = [
            (i, a.effect, {k: float(v) for k, v in a.values.items()}, _source(plant, a)) for i, a in lines.laws
        ]
        self._memory: list[Any] = [law.memory(()) for _, law, _, _ in self._laws]
        self._last = np.zeros(len(lines.ports))
        """Forces of the laws in the last step. A force changes little in a step, so the last force stands for an
        unknown present one."""
        self._is_linear, self._has_inertia = len(self._laws) < len(lines.ports), bool(np.any(lines.added))

    def push(self, data: Any, commands: Array) -> None:
        """Add the port forces of a step and update the memory.

        Kinematics and controls must be up to date, as in MuJoCo's control callback.
        """
        self._memory, self._last = self._add(data, commands)

    def look(self, data: Any, commands: Array) -> Array:
        """Add the port forces and leave the memory unchanged.

        Parameters
        ----------
        data : MjData
            State with kinematics and controls.
        commands : array
            Commands, (n_actuators,).

        Returns
        -------
        (nsensordata,) array
            What sensors of actuator forces read of them: laws within a drive act as port forces here.
        """
        forces = self._add(data, commands)[1] * self.lines.in_drive
        return np.asarray(self.lines.efforts @ (forces @ self._rows))

    def _solve(self, data: Any) -> None:
        """Solve for the motion per force of every row.

        The result is M^-1 r. With implicit joint dampers the result is (M + h D)^-1 r to first order.
        """
        mujoco.mj_solveM(self._model, data, self._solved, self._rows)
        if self.lines.damping is not None:
            correction = np.zeros_like(self._solved)
            mujoco.mj_solveM(self._model, data, correction, self._solved * self.lines.damping)
            self._solved -= correction

    def _add(self, data: Any, commands: Array) -> tuple[list[Any], Array]:
        model = self._model
        for i in self._moving:
            self._rows[i] = self.lines.ports[i].row(data)
        mujoco.mj_fwdActuation(model, data)
        mujoco.mj_fwdAcceleration(model, data)  # without port forces and constraint forces
        if not self.lines.is_fixed:
            self._solve(data)
        return self._add_one(data, commands) if len(self._rows) == 1 else self._add_all(data, commands)

    def _add_one(self, data: Any, commands: Array) -> tuple[list[Any], Array]:
        """Add the force of a single port.

        Plain numbers make this path several times as fast as `_add_all`.
        """
        row, solved, h = self._rows[0], self._solved[0], self._h
        v, a = float(row.dot(data.qvel)), float(solved.dot(data.qfrc_smooth))
        z = self.lines.ports[0].position(data) - self.lines.rest[0]
        G = float(row.dot(solved))
        own = G * float(self._last[0])
        if not self.lines.is_staggered:
            z += h / 2 * (v + h / 4 * (a + own))
        memory: list[Any] = []
        if self._laws:
            (_, law, p, source), after = self._laws[0], v + h * a
            step = Step(h, data.time + h / 2, h * G, after, source(data, commands), v, self.lines.damped)
            force, now = law.force(z, 0.5 * (v + after + h * own), p, step, self._memory[0])
            memory.append(now)
        else:
            added = float(self.lines.added[0])
            force = -float(self.lines.viscous[0]) * v - float(self.lines.spring[0]) * z
            force -= added * (a + G * force) / (1.0 + G * added)
        data.qfrc_applied += row * force
        return memory, np.array([force if self._laws else 0.0])

    def _add_all(self, data: Any, commands: Array) -> tuple[list[Any], Array]:
        rows, h = self._rows, self._h
        v, a, G = rows @ data.qvel, self._solved @ data.qfrc_smooth, rows @ self._solved.T
        z = np.array([port.position(data) - rest for port, rest in zip(self.lines.ports, self.lines.rest, strict=True)])
        if not self.lines.is_staggered:
            z += h / 2 * (v + h / 4 * (a + G @ self._last))
        push = np.zeros(len(v))
        if self._is_linear:
            push = -self.lines.viscous * v - self.lines.spring * z
            a = a + G @ push
            if self._has_inertia:
                shared = np.linalg.inv(np.eye(len(v)) + G * self.lines.added)
                a, G = shared @ a, shared @ G
        memory, t, expected = [], data.time + h / 2, self._last.copy()
        for (i, law, p, source), past in zip(self._laws, self._memory, strict=True):
            before = float(v[i])
            after = before + h * float(a[i])
            step = Step(h, t, h * float(G[i, i]), after, source(data, commands), before, self.lines.damped)
            own = h * float(G[i] @ expected)
            force, now = law.force(float(z[i]), 0.5 * (before + after + own), p, step, past)
            memory.append(now)
            push[i], expected[i] = force, 0.0
            a += G[:, i] * force
        of_laws = np.zeros(len(v))
        of_laws[[i for i, *_ in self._laws]] = [push[i] for i, *_ in self._laws]
        if self._has_inertia:
            push = push - self.lines.added * a
        data.qfrc_applied += push @ rows
        return memory, of_laws


def small_motion(plant: Plant, attached: Sequence[AtPort]) -> tuple[Array, Array, Array] | None:
    """Return the added matrices of linear effects at rest.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.
    attached : sequence of AtPort
        Effects at ports.

    Returns
    -------
    tuple of (array, array, array) or None
        Mass, damping and stiffness, (nv, nv) each; None without linear effects.
    """
    linear = [(a, a.effect) for a in attached if isinstance(a.effect, LinearPortEffect)]
    if not linear:
        return None
    data, nv = plant.new_data(), plant.model.nv
    out = (np.zeros((nv, nv)), np.zeros((nv, nv)), np.zeros((nv, nv)))
    for a, effect in linear:
        for port in (a.port, *a.port.more):
            row = port.row(data)
            for matrix, value in zip(out, effect.impedance(a.values, a.stiffness), strict=True):
                matrix += value * np.outer(row, row)
    return out


def _stepper(a: AtActuator, timestep: float, sample: float, before: float) -> ActuatorStep:
    """Return an actuator effect as a step of integration."""
    if not a.effect.is_clocked:
        return a.effect.follower(a.values, timestep, before)
    once, every = a.effect.follower(a.values, sample, before), max(1, round(sample / timestep))
    k, held = 0, 0.0

    def step(u: float) -> float:
        nonlocal k, held
        if k % every == 0:
            held = once(u)
        k += 1
        return held

    return step


class Running:
    """Effects of one run without a MuJoCo element.

    Parameters
    ----------
    plant : Plant
        Plant with its effects.
    sample : float
        Sample period of the sensors [s].
    channels : mapping of str to str
        Plant sensor or port of each channel name.
    readings : mapping of str to float, optional
        First recorded value of each channel, for a run that starts in the middle of a motion.
    commands : array, optional
        Commands before the start, (n_actuators,); zero by default.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        sample: float,
        channels: Mapping[str, str] | None = None,
        readings: Mapping[str, float] | None = None,
        commands: Array | None = None,
    ) -> None:
        ports = [a for a in plant.physics if isinstance(a, AtPort)]
        self.ports = PortForces(plant, ports) if ports else None
        self.force = np.zeros(len(plant.actuators))
        """Actuator forces of the present step."""
        self._actuators: list[tuple[int, ActuatorStep]] = [
            (a.index, _stepper(a, plant.timestep, sample, 0.0 if commands is None else float(commands[a.index])))
            for a in plant.physics
            if isinstance(a, AtActuator)
        ]
        self.is_due = False
        """Whether a new step awaits its port forces, see `callback`."""
        self._change = np.zeros(len(plant.actuators))
        self._sensors: list[tuple[int, SensorStep, Callable[[Array], float]]] = []
        self._readings: dict[str, list[SensorStep]] = {}
        for a in plant.physics:
            if not isinstance(a, AtSensor):
                continue
            first = (readings or {}).get(a.name)
            step = a.effect.stepper(a.values, sample) if first is None else a.effect.resumed(a.values, sample, first)
            index = tap_index(plant.sensors, (channels or {}).get(a.name, a.name))
            if index is not None:
                self._sensors.append((index, step, self._picked(plant, a)))
            else:
                self._readings.setdefault(a.name, []).append(step)

    def callback(self, model: Any, data: Any) -> None:
        """Add the port forces once a step.

        MuJoCo's control callback may run several times in a step.
        """
        if self.is_due and self.ports is not None:
            self.is_due = False
            self.ports.push(data, self.force)

    @property
    def has_actuators(self) -> bool:
        """Whether actuator effects act."""
        return bool(self._actuators)

    @property
    def has_sensors(self) -> bool:
        """Whether sensor effects act."""
        return bool(self._sensors)

    def actuate(self, force: Array) -> None:
        """Change the actuator forces of a step in place.

        The change comes after every actuator element of the model.
        """
        self._change[:] = -force
        for i, step in self._actuators:
            force[i] = step(float(force[i]))
        self._change += force

    @property
    def is_read(self) -> bool:
        """Whether sensor or channel effects act."""
        return bool(self._sensors or self._readings)

    @property
    def last_change(self) -> Array:
        """Change of the forces by the last `actuate`."""
        return self._change

    def sense(self, values: Array, t: float) -> None:
        """Change the sensor values of a sample in place."""
        for i, step, other in self._sensors:
            values[i] = step(float(values[i]), t, other(values))

    def read(self, channel: str, value: float, t: float) -> float:
        """Return the changed value of a port channel."""
        for step in self._readings.get(channel, ()):
            value = step(value, t, 0.0)
        return value

    def _picked(self, plant: Plant, a: AtSensor) -> Callable[[Array], float]:
        if not a.other:
            return lambda values: 0.0
        if "command" in a.effect.needs:
            actuator = plant.actuator_index(a.other)
            return lambda values: float(self.force[actuator])
        sensor = plant.sensor_index(a.other)
        return lambda values: float(values[sensor])


def tap_index(taps: Sequence[Any], name: str) -> int | None:
    """Return the index of a tap by name or place.

    Parameters
    ----------
    taps : sequence of object
        Taps in channel order.
    name : str
        Name of a tap or place, with or without its kind.

    Returns
    -------
    int or None
        None without such a tap.
    """
    bare = name.partition(":")[2] if name.startswith(("sensor:", "actuator:", "coil:", "amplifier:")) else name
    return next((i for i, tap in enumerate(taps) if name in (tap.name, tap.at) or bare in (tap.name, tap.at)), None)
