"""Two small rigs with integrators of their own, for what a case says of its files: two masses and a pendulum on a servo.

Both are integrated by Runge-Kutta steps of 1 ms from their own equations of motion, inputs held over a sample.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from vlab.cases.case import Case, load_case

STEP, EVERY = 1e-3, 5
"""Step of the integrators [s], and steps in a sample."""
NOISE = 0.002
"""White noise of every sensor, as a share of its rms."""

MASSES = """<mujoco model="two masses">
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody>
    <body name="one"><joint name="x1" type="slide" axis="1 0 0" stiffness="400" damping="1"/>
      <geom size="0.05" mass="1"/>
      <body name="two"><joint name="d2" type="slide" axis="1 0 0" stiffness="150" damping="0.4"/>
        <geom size="0.05" mass="0.5"/></body></body>
  </worldbody>
  <actuator><motor name="motor" joint="x1"/></actuator>
  <sensor><jointpos name="x1" joint="x1"/><jointpos name="d2" joint="d2"/></sensor>
</mujoco>"""
SERVO = """<mujoco model="servo">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="arm"><inertial pos="0 0 -0.2" mass="0.5" diaginertia="1e-3 1e-3 1e-4"/>
      <joint name="hinge" axis="0 1 0" damping="0.05"/></body>
  </worldbody>
  <actuator><position name="servo" joint="hinge" kp="12" kv="0.6"/></actuator>
</mujoco>"""
Recorded = Mapping[str, dict[str, np.ndarray]]
"""Columns by recording."""
Accelerations = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Thing:
    """The thing that stands beside the model of two masses.

    Parameters
    ----------
    softer, damping, payload : float
        Factor of the first spring, of both dampers, and mass on the second body [kg].
    friction : float
        Dry friction of the first mass [N].
    gain : float
        Of the motor.
    """

    softer: float = 1.0
    damping: float = 1.0
    payload: float = 0.0
    friction: float = 0.0
    gain: float = 1.0

    def accelerations(self, q: np.ndarray, v: np.ndarray, u: float) -> np.ndarray:
        """Return those of the first mass and of the second beside it."""
        spring = 150.0 * q[1] + 0.4 * self.damping * v[1]
        first = self.gain * u - 400.0 * self.softer * q[0] - self.damping * v[0] + spring
        first -= self.friction * np.tanh(v[0] / 1e-3)
        return np.array([first, -spring / (0.5 + self.payload) - first])


def pendulum(q: np.ndarray, v: np.ndarray, u: float, gain: float = 1.0) -> np.ndarray:
    """Return the acceleration of the arm under its servo's command [rad]."""
    torque = gain * 12.0 * (u - q[0]) - 0.6 * v[0] - 0.05 * v[0] - 0.5 * 9.81 * 0.2 * np.sin(q[0])
    return np.array([torque / (1e-3 + 0.5 * 0.2**2)])


def integrate(accelerations: Accelerations, u: np.ndarray, dof: int, start: np.ndarray | None = None) -> np.ndarray:
    """Return positions at the samples of an input that is held, (n, dof)."""
    state = np.zeros(2 * dof) if start is None else np.concatenate([start, np.zeros(dof)])
    out = np.zeros((len(u), dof))

    def slope(x: np.ndarray, force: float) -> np.ndarray:
        return np.concatenate([x[dof:], accelerations(x[:dof], x[dof:], force)])

    for k, force in enumerate(u):
        out[k] = state[:dof]
        for _ in range(EVERY):
            a = slope(state, force)
            b = slope(state + 0.5 * STEP * a, force)
            c = slope(state + 0.5 * STEP * b, force)
            state = state + STEP / 6.0 * (a + 2.0 * b + 2.0 * c + slope(state + STEP * c, force))
    return out


def noise_input(rng: np.random.Generator, seconds: float, low_hz: float, high_hz: float) -> np.ndarray:
    """Return noise in a band, of unit rms, that begins and ends at nothing."""
    n = round(seconds / (EVERY * STEP))
    freq = np.fft.rfftfreq(n, EVERY * STEP)
    lines = rng.standard_normal(len(freq)) + 1j * rng.standard_normal(len(freq))
    u = np.fft.irfft(np.where((freq >= low_hz) & (freq <= high_hz), lines, 0.0), n)
    u *= np.minimum(1.0, np.minimum(np.arange(n), np.arange(n)[::-1]) / (0.1 * n))
    return u / u.std()


@dataclass(frozen=True, kw_only=True, eq=False)
class Written:
    """A case as it is written.

    Parameters
    ----------
    columns : mapping
        By recording, its columns; without time. Channels of other columns are left out there.
    said : mapping
        By column, keys of its channel that differ from the rig's.
    time, clock : str
        The column of the stamps, and what the case says of them.
    times : float
        What the stamps are multiplied by.
    """

    folder: Path
    model: str
    channels: Mapping[str, Mapping[str, object]]
    columns: Recorded
    said: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    time: str = "t"
    clock: str = 'time = "t"'
    times: float = 1.0

    def load(self) -> Case:
        """Write the case and load it; the last recording is held out."""
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / "rig.xml").write_text(self.model, encoding="utf-8")
        lines = ["[model]", 'mjcf = "rig.xml"']
        for i, (name, columns) in enumerate(self.columns.items()):
            n = len(next(iter(columns.values())))
            np.savez(self.folder / f"{name}.npz", **{self.time: self.times * EVERY * STEP * np.arange(n)}, **columns)
            role = "holdout" if i == len(self.columns) - 1 else "fit"
            lines += ["[[recording]]", f'file = "{name}.npz"', f'name = "{name}"', f'role = "{role}"', self.clock]
            for column, keys in ((c, k) for c, k in self.channels.items() if c in columns):
                merged = {**keys, **self.said.get(column, {})}
                lines += ["[[recording.channel]]", f'column = "{column}"']
                lines += [f"{key} = {_toml(value)}" for key, value in merged.items()]
        (self.folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
        return load_case(self.folder)


def _toml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else f'"{value}"' if isinstance(value, str) else repr(value)


MASS_CHANNELS = {
    "force": {"at": "motor", "kind": "force", "unit": "N", "input": True, "hold": "zero"},
    "one": {"at": "x1", "kind": "displacement", "unit": "m"},
    "two": {"at": "d2", "kind": "displacement", "unit": "m"},
}
SERVO_CHANNELS = {
    "command": {"at": "servo", "kind": "command", "unit": "rad", "input": True, "hold": "zero"},
    "angle": {"at": "joint:hinge", "kind": "angle", "unit": "rad"},
}


def recorded_masses(thing: Thing | None = None, seed: int = 1, noise: float = NOISE) -> Recorded:
    """Return three recordings of two masses under noise."""
    rng = np.random.default_rng(seed)
    out = {}
    for k in range(3):
        u = 2.0 * noise_input(rng, 6.0, 0.7, 12.0)
        q = integrate((thing or Thing()).accelerations, u, 2)
        q += noise * q.std(axis=0) * rng.standard_normal(q.shape)
        out[f"run{k + 1}"] = {"force": u, "one": q[:, 0].copy(), "two": q[:, 1].copy()}
    return out


def recorded_servo(gain: float = 1.0, seed: int = 2) -> Recorded:
    """Return three recordings of an arm that is moved about a bent pose by its servo."""
    rng = np.random.default_rng(seed)
    out = {}
    for k in range(3):
        u = 0.6 + 0.3 * noise_input(rng, 6.0, 0.3, 4.0)
        start = np.array([0.5])
        q = integrate(lambda q, v, force: pendulum(q, v, force, gain), u, 1, start)
        q += NOISE * q.std() * rng.standard_normal(q.shape)
        out[f"run{k + 1}"] = {"command": u, "angle": q[:, 0].copy()}
    return out


def masses_case(folder: Path, columns: Recorded, **more: Any) -> Case:
    """Return a case of two masses with some columns."""
    given = {"model": MASSES, "channels": MASS_CHANNELS, **more}
    return Written(folder=folder, columns=columns, **given).load()


def servo_case(folder: Path, columns: Recorded, **more: Any) -> Case:
    """Return a case of the arm with some columns."""
    given = {"model": SERVO, "channels": SERVO_CHANNELS, **more}
    return Written(folder=folder, columns=columns, **given).load()


def changed(columns: Recorded, change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]) -> Recorded:
    """Return recordings with some columns changed in each."""
    return {name: {**run, **change(run)} for name, run in columns.items()}
