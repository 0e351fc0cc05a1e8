"""True outputs of a bench with hidden effects, and signal sizes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.proof.generator.bench import Bench
from vlab.proof.generator.hardware import Output
from vlab.proof.generator.hidden import Hidden, Scale, Signals
from vlab.proof.generator.integration import Feedback, Poles, integrate, port_rows
from vlab.signals import Array, rms


@dataclass(frozen=True, kw_only=True, eq=False)
class Setup:
    """Bench with output hardware and clock.

    Parameters
    ----------
    feedback : Feedback or None
        Law in the loop, with its sensor noise.
    seed : int
        Seed of changes from sample to sample.
    """

    bench: Bench
    output: Output
    rate_hz: float
    substeps: int
    feedback: Feedback | None = None
    seed: int = 0

    def run(self, commands: Array, hidden: Sequence[Hidden]) -> Array:
        """Return samples without noise, from rest.

        Parameters
        ----------
        commands : array
            Commands, (n_samples, n_actuators, runs).
        hidden : sequence of Hidden
            Hidden effects.

        Returns
        -------
        array
            Samples, (n_samples, n_sensors, runs).
        """
        return self.read(self.sensed(commands, hidden), hidden)

    def read(self, y: Array, hidden: Sequence[Hidden]) -> Array:
        """Return samples as hidden converters read them.

        Parameters
        ----------
        y : array
            Samples, (n_samples, n_sensors, runs), with or without noise.
        hidden : sequence of Hidden
            Hidden effects.

        Returns
        -------
        array
            Converted samples.
        """
        for x in hidden:
            change = x.action.reading
            if change is not None:
                context = Signals(h=1.0 / self.rate_hz, rng=np.random.default_rng(self.seed))
                y = _changed(y, _sensor(self.bench, x.place), change, context)
        return y

    def sensed(self, commands: Array, hidden: Sequence[Hidden]) -> Array:
        """Return sensor samples before noise and converters.

        Parameters
        ----------
        commands : array
            Commands, (n_samples, n_actuators, runs).
        hidden : sequence of Hidden
            Hidden effects.

        Returns
        -------
        array
            Samples, (n_samples, n_sensors, runs).
        """
        bench, h = self.bench, 1.0 / self.rate_hz
        step = h / self.substeps
        rng = np.random.default_rng(self.seed)
        acts = [(x, x.action) for x in hidden]
        given = commands
        for x, action in acts:
            if action.command is not None:
                given = _changed(given, _index(bench, x.place), action.command, Signals(h=h, rng=rng))
        forces = self.output.forces(given, step, self.substeps)
        for x, action in acts:
            if action.force is not None:
                forces = _changed(forces, _index(bench, x.place), action.force, Signals(h=step, rng=rng))
        for x, action in acts:
            if action.bench is not None:
                bench = action.bench(bench, x.place)
        laws = [(x.place, action.law) for x, action in acts if action.law is not None]
        feedback = None if self.feedback is None else replace(self.feedback, output=self.output)
        y = integrate(bench, forces, laws, step=step, substeps=self.substeps, feedback=feedback)
        for x, action in acts:
            if action.sensor is not None:
                name, _, second = x.place.partition("/")
                other = None
                if second.startswith("coil:"):
                    other = commands[:, list(bench.actuators).index(second.removeprefix("coil:"))]
                elif second:
                    other = y[:, _sensor(bench, f"sensor:{second}")]
                y = _changed(y, _sensor(bench, name), action.sensor, Signals(h=h, rng=rng, other=other))
        return y


def _changed(signals: Array, index: int, change: object, context: Signals) -> Array:
    out = signals.copy()
    out[:, index] = change(signals[:, index], context)  # type: ignore[operator]
    return out


def _index(bench: Bench, place: str) -> int:
    return list(bench.actuators).index(place.removeprefix("actuator:"))


def _sensor(bench: Bench, place: str) -> int:
    wanted = place.removeprefix("sensor:")
    return next(i for i, name in enumerate(bench.sensors) if (name.partition(":")[2] or name) == wanted)


def scale_at(setup: Setup, commands: Array, place: str, outputs: Array, band_hz: tuple[float, float]) -> Scale:
    """Return the signal sizes at a place in one recording.

    Parameters
    ----------
    setup : Setup
        Bench with its clock.
    commands : array
        Commands, (n_samples, n_actuators).
    place : str
        Name of the place.
    outputs : array
        Outputs of the recording, (n_samples, n_sensors).
    band_hz : tuple
        Band of the excitation [Hz].

    Returns
    -------
    Scale
        Sizes at the place.
    """
    bench, h = setup.bench, 1.0 / setup.rate_hz
    common = {"h": h, "T": len(commands) * h, "low_hz": band_hz[0], "high_hz": band_hz[1]}
    which = int(np.argmax(np.abs(commands).sum(axis=0)))
    used = commands[:, which]
    if place.startswith("actuator:"):
        u = commands[:, _index(bench, place)]
        slope = float(np.abs(np.diff(u)).max() / h)
        return Scale(u=rms(u), peak=float(np.abs(u).max()), slope=slope, **common)
    if place.startswith("sensor:"):
        name, _, second = place.partition("/")
        y = outputs[:, _sensor(bench, name)]
        if second.startswith("coil:"):
            used = commands[:, list(bench.actuators).index(second.removeprefix("coil:"))]
        return Scale(z=rms(y), peak=float(np.abs(y).max()), u=rms(used) or 1.0, **common)
    row = bench.places[place].row
    rows = np.array([port_rows(row, 0), port_rows(row, 1)])
    forces = setup.output.forces(commands[:, :, None], h, 1)
    motion = Poles.of(bench).response(bench.loads, forces, rows, h)[:, :, 0]
    return Scale(
        z=rms(motion[:, 0]),
        v=rms(motion[:, 1]),
        peak=float(np.abs(motion[:, 0]).max()),
        k=float(1.0 / (row @ np.linalg.solve(bench.K, row))),
        m=float(1.0 / (row @ np.linalg.solve(bench.M, row))),
        own=bench.places[place].stiffness,
        u=rms(used),
        **common,
    )
