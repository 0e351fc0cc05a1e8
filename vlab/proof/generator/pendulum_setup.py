"""Pendulum or cart with clock and log, and its signals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlab.errors import Diverged
from vlab.proof.generator.arm_commands import WAY, received
from vlab.proof.generator.hardware import filtered, moved
from vlab.proof.generator.hidden import Hidden, Kind, Scale
from vlab.proof.generator.pendulum_models import Pendulum, built
from vlab.proof.generator.pendulum_motion import Swinging
from vlab.signals import Array, rms

WILD = 30.0
"""WILD [rad, m]: coordinate beyond which a march counts as diverged."""
MOTOR: dict[str, float] = {
    **WAY,
    "dead_zone": 0.0,
    "soft_zone": 0.0,
    "limit": np.inf,
    "soft_limit": np.inf,
    "sway": 0.0,
    "sway_omega": 0.0,
    "sway_phase": 0.0,
    "loss": 0.0,
    "loss_time": 1.0,
}
"""MOTOR: numbers of the way of a command to the force of a motor, with their values in an ideal one. Commands in N."""
SENSOR = {"gain": 0.0, "offset": 0.0, "drift": 0.0, "delay": 0.0, "lag": 0.0, "curve": 0.0}
"""SENSOR: numbers of an encoder with their values in an ideal one, in the unit of its channel and in s."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SwingLog:
    """Pendulum with the clock of its log.

    Parameters
    ----------
    motor : mapping of str to float
        Numbers of `MOTOR`.
    sensors : tuple of mapping of str to float
        Numbers of `SENSOR` by coordinate.
    starts : mapping of str to float
        Deviations of the states at the releases, see `vlab.proof.generator.pendulum_models.starts_of`.
    lead : int
        Samples from a release to the beginning of its recording.
    """

    pendulum: Pendulum
    machine: Swinging
    motor: Mapping[str, float]
    sensors: tuple[Mapping[str, float], ...]
    starts: Mapping[str, float]
    lead: int
    rate_hz: float
    substeps: int

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.machine.n

    def coordinate(self, place: str) -> int:
        """Return the coordinate of a place."""
        if place == "site:tip":
            return self.n - 1
        return 0 if place.startswith("actuator:") else self.pendulum.joints.index(place.rpartition(":")[2])

    def places(self, kind: Kind) -> list[str]:
        """Return the possible places of a kind.

        One rod alone has none for masses: all of them change its period alone, as the benign parameters do.

        Parameters
        ----------
        kind : Kind
            Kind of hidden effect.

        Returns
        -------
        list of str
            Names of the places.
        """
        if kind.family == "mass" and self.n == 1:
            return []
        joints = [name for name in self.pendulum.joints if kind.angular is None or kind.angular == (name != "slide")]
        return {
            "actuator": ["actuator:motor"] if self.pendulum.cart is not None else [],
            "joint": [f"joint:{name}" for name in joints],
            "sensor": [f"sensor:{name}" for name in joints],
            "tip": ["site:tip"],
        }[kind.on]

    def stepped(self, substeps: int) -> "SwingLog":
        """Return the log with another number of steps per sample."""
        return replace(self, substeps=substeps)

    def rebuilt(self, factors: Mapping[str, float]) -> "SwingLog":
        """Return the log with other log-factors and states at release."""
        return replace(self, machine=built(self.pendulum, factors), starts=factors)

    def with_numbers(self, place: str, **numbers: float) -> "SwingLog":
        """Return the log with other numbers of one joint."""
        return replace(self, machine=self.machine.with_numbers(self.coordinate(place), **numbers))

    def with_motor(self, **numbers: float) -> "SwingLog":
        """Return the log with other numbers of the motor."""
        return replace(self, motor={**self.motor, **numbers})

    def with_sensor(self, place: str, **numbers: float) -> "SwingLog":
        """Return the log with other numbers of one encoder."""
        sensors = list(self.sensors)
        i = self.coordinate(place)
        sensors[i] = {**sensors[i], **numbers}
        return replace(self, sensors=tuple(sensors))

    def march(self, commands: Array, run: int) -> Array:
        """Return coordinates and rates from release, or from rest.

        Parameters
        ----------
        commands : (n_samples, inputs) array
            Commands of the motor [N]; without one, angles of the release in the first row [rad].
        run : int
            Index of the recording in `starts`.

        Returns
        -------
        (lead + n_samples, 2, n) array
            Coordinates and rates.

        Raises
        ------
        Diverged
            The motion ran away.
        """
        step = 1.0 / (self.rate_hz * self.substeps)
        first = self._first(commands, run)
        forces = np.zeros((self.lead + len(commands)) * self.substeps)
        if self.pendulum.cart is not None:
            forces = self._forces(commands[:, 0], step)
        out = self.machine.march(forces, step, self.substeps, first, -self.lead / self.rate_hz)
        return _checked(out)

    def _first(self, commands: Array, run: int) -> Array:
        """Return the state at the beginning, (2, n)."""
        first = np.zeros((2, self.n))
        if self.pendulum.cart is None:
            first[0] = commands[0]
            for k, what in enumerate(("angle", "rate")):
                first[k] += [self.starts.get(f"{what}:{run}:{j}", 0.0) for j in range(self.n)]
        return first

    def _forces(self, u: Array, step: float) -> Array:
        """Return the motor's force before its gain, on the fine clock."""
        m = self.motor
        u = u - np.clip(u, -m["dead_zone"], m["dead_zone"])
        if m["soft_zone"]:
            u = u - m["soft_zone"] * np.tanh(u / m["soft_zone"])
        u = np.clip(u, -m["limit"], m["limit"])
        if np.isfinite(m["soft_limit"]):
            u = m["soft_limit"] * np.tanh(u / m["soft_limit"])
        ways = {name: np.array([m[name]]) for name in WAY}
        fine = received(u[:, None], ways, step=step, substeps=self.substeps, before=0)[:, 0]
        time = (np.arange(len(fine)) + 0.5) * step
        if m["loss"]:
            heat = np.zeros(len(fine))
            left = np.exp(-step / m["loss_time"])
            for i in range(1, len(fine)):
                heat[i] = heat[i - 1] * left + fine[i - 1] ** 2 * (1.0 - left)
            fine = fine / (1.0 + m["loss"] * heat)
        return np.asarray(fine * (1.0 + m["sway"] * np.sin(m["sway_omega"] * time + m["sway_phase"])))

    def run(self, commands: Array, hidden: Sequence[Hidden] = ()) -> Array:
        """Return the logged coordinates without noise.

        Parameters
        ----------
        commands : (n_samples, inputs, runs) array
            See `march`; recordings to fit come first.
        hidden : sequence of Hidden
            Hidden effects.

        Returns
        -------
        (n_samples, n, runs) array
            Readings [m, rad].
        """
        log = self
        for x in hidden:
            change = x.action.machine
            assert change is not None
            log = change(log, x.place)
        runs = [log._read(log.march(commands[:, :, i], i)[:, 0]) for i in range(commands.shape[2])]
        return np.stack(runs, axis=-1)

    def _read(self, q: Array) -> Array:
        """Return the readings of the encoders without the lead, (n_samples, n)."""
        h, out = 1.0 / self.rate_hz, q.copy()
        time = (np.arange(len(q)) - self.lead) * h
        for j, d in enumerate(self.sensors):
            y = q[:, j]
            if d["delay"]:
                y = moved(y, d["delay"], h)
            if d["lag"]:
                y = y[0] + filtered(y - y[0], [1.0], [d["lag"], 1.0], h)
            out[:, j] = (1.0 + d["gain"]) * y + d["curve"] * y * y + d["offset"] + d["drift"] * time
        return out[self.lead :]

    def nominal_readings(self, commands: Array, timestep: float, *, is_fourth_order: bool) -> Array:
        """Return the readings with the step of the nominal model.

        Parameters
        ----------
        commands : (n_samples, inputs, runs) array
            See `march`.
        timestep : float
            Step of the nominal model [s]; whole steps fit into a sample.
        is_fourth_order : bool
            See `vlab.proof.generator.pendulum_motion.Swinging.march_coarsely`.

        Returns
        -------
        (n_samples, n, runs) array
            Readings [m, rad].
        """
        substeps = int(np.ceil(1.0 / (self.rate_hz * timestep) - 1e-9))
        step, out = 1.0 / (self.rate_hz * substeps), []
        for i in range(commands.shape[2]):
            held = np.zeros(self.lead + len(commands))
            if self.pendulum.cart is not None:
                held = commands[:, 0, i]
            first = self._first(commands[:, :, i], i)
            fine = np.repeat(held, substeps)
            marched = self.machine.march_coarsely(fine, step, substeps, first, is_fourth_order=is_fourth_order)
            out.append(_checked(marched)[self.lead :, 0])
        return np.stack(out, axis=-1)

    def scales(self, commands: Array) -> tuple["SwingScale", ...]:
        """Return the signal sizes of all coordinates.

        Parameters
        ----------
        commands : (n_samples, inputs, runs) array
            Inputs of the fit recordings, see `march`.

        Returns
        -------
        tuple of SwingScale
            Sizes by coordinate, over all recordings.
        """
        marched = np.concatenate([self.march(commands[:, :, i], i) for i in range(commands.shape[2])])
        u = commands[:, 0].ravel() if self.pendulum.cart is not None else np.zeros(1)
        slope = float(np.abs(np.diff(commands[:, 0], axis=0)).max()) * self.rate_hz if len(u) > 1 else 0.0
        states = marched[:: max(1, len(marched) // STATES)]
        each = [self.machine.equations(q, v) for q, v in states]
        out = []
        for j, name in enumerate(self.pendulum.joints):
            q, v = marched[:, 0, j], marched[:, 1, j]
            z, inertia = float(np.std(q)), float(np.mean([M[j, j] for M, _, _ in each]))
            force = rms(u) if name == "slide" else rms(np.array([b[j] for _, b, _ in each]))
            out.append(
                SwingScale(
                    z=z, v=rms(v), peak=float(np.abs(q).max()), k=force / z, m=inertia, u=rms(u), slope=slope,
                    h=1.0 / self.rate_hz, T=len(commands) / self.rate_hz, force=force,
                    load=float(np.mean([load[j] for _, _, load in each])),
                    damping=float(self.machine.number("damping")[j]), payload=self.pendulum.payload,
                    most_u=float(np.abs(u).max()),
                )
            )  # fmt: skip
        return tuple(out)

    def scale_at(self, place: str, scales: tuple[Any, ...]) -> Scale:
        """Return the signal sizes at a place."""
        found: Scale = scales[self.coordinate(place)]
        return found

    def alike(self, x: Hidden) -> dict[str, Any]:
        """Return other names of an effect's place, and places near.

        Parameters
        ----------
        x : Hidden
            Hidden effect.

        Returns
        -------
        dict
            Entries of the truth: ``places_alike``, ``places_near`` and ``at_actuator``.
        """
        joints, bodies, j = self.pendulum.joints, self.pendulum.bodies, self.coordinate(x.place)
        is_driven = joints[j] == "slide"
        if x.kind.on == "sensor":
            return {"places_alike": [f"sensor:joint:{joints[j]}"], "places_near": [], "at_actuator": False}
        alike = [f"joint:{joints[j]}", f"body:{bodies[j]}", *(["actuator:motor"] if is_driven else [])]
        near = [f"{kind}:{names[k]}" for k in (j - 1, j + 1) if 0 <= k < self.n
                for kind, names in (("joint", joints), ("body", bodies))]  # fmt: skip
        tips = [f"site:tip{axis}" for axis in (".x", ".y", ".z")]
        if x.place == "site:tip":
            return {"places_alike": [*tips, f"body:{bodies[j]}"], "places_near": [f"joint:{joints[j]}", *near],
                    "at_actuator": False}  # fmt: skip
        near += tips if j == self.n - 1 else []
        return {"places_alike": alike, "places_near": near, "at_actuator": is_driven}


STATES = 200
"""STATES [-]: states of the motion that give mean inertia and load."""


def _checked(out: Array) -> Array:
    if not np.all(np.isfinite(out)) or np.abs(out[:, 0]).max() > WILD:
        raise Diverged("the pendulum ran away")
    return out


@dataclass(frozen=True, kw_only=True)
class SwingScale(Scale):
    """Signal sizes at a coordinate in the fit recordings, without hidden effects.

    Of the fields of `Scale`, `z` is the rms travel from its mean, `k` the rms force over it, `m` the mean inertia.

    Parameters
    ----------
    force : float
        Rms force of gravity at a hinge, or of the motor on the rail [N m, N].
    load : float
        Mean normal force [N].
    damping : float
        Damping of the joint.
    payload : float
        Mass of a usual body at the tip [kg].
    most_u : float
        Largest command [N].
    """

    force: float = 0.0
    load: float = 0.0
    damping: float = 0.0
    payload: float = 0.0
    most_u: float = 0.0


def ideal(pendulum: Pendulum, factors: Mapping[str, float], *, rate_hz: float, substeps: int, lead: int) -> SwingLog:
    """Return the log of a pendulum as built, without hidden effects.

    Parameters
    ----------
    pendulum : Pendulum
        Pendulum.
    factors : mapping of str to float
        Log-factors of its parameters.
    rate_hz : float
        Rate of the log [Hz].
    substeps : int
        Steps per sample.
    lead : int
        Samples from a release to the recording.

    Returns
    -------
    SwingLog
        Log.
    """
    machine = built(pendulum, factors)
    return SwingLog(
        pendulum=pendulum, machine=machine, motor=MOTOR, sensors=(SENSOR,) * machine.n, starts={}, lead=lead,
        rate_hz=rate_hz, substeps=substeps,
    )  # fmt: skip
