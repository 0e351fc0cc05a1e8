"""Planned recordings of a case: signals, levels, actuators, roles."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vlab.proof.generator.bench import Blueprint
from vlab.proof.generator.excite import CLASSES, excite
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Planned recording: signal class, relative level, actuator."""

    signal: str
    level: float
    actuator: str
    role: Literal["fit", "holdout"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """All recordings of a case.

    Parameters
    ----------
    commands : (n_samples, n_actuators, runs) array
        Commands at the sample rate of the recordings.
    """

    recordings: tuple[Recording, ...]
    commands: Array

    @property
    def fit(self) -> list[int]:
        """Indices of the fit recordings."""
        return [i for i, r in enumerate(self.recordings) if r.role == "fit"]

    @property
    def loudest(self) -> int:
        """Index of the loudest fit recording."""
        return max(self.fit, key=lambda i: self.recordings[i].level)

    @property
    def middle(self) -> int:
        """Index of the fit recording with the median level."""
        order = sorted(self.fit, key=lambda i: self.recordings[i].level)
        return order[len(order) // 2]

    @property
    def driven(self) -> tuple[str, ...]:
        """Used actuators, the most used first."""
        return tuple(dict.fromkeys(r.actuator for r in self.recordings))


def plan(blueprint: Blueprint, rng: np.random.Generator, *, one_level: bool = False) -> Plan:
    """Draw the recordings of a case.

    Three to five fit recordings, or those of the blueprint, have one signal class and at least three levels. Two or three held-out recordings
    follow. The first has the same class at another level, the second another class.

    Parameters
    ----------
    blueprint : Blueprint
        Kind of bench.
    rng : Generator
        Random numbers.
    one_level : bool
        Whether levels of the fit recordings differ by at most a tenth, which makes level dependence look linear.

    Returns
    -------
    Plan
        Recordings with commands.
    """
    main = str(rng.choice(blueprint.exciters))
    usual = str(rng.choice(["multisine", "noise"], p=[0.8, 0.2]))
    other = str(rng.choice([c for c in CLASSES if c not in (usual, "noise", "multisine")]))
    count = blueprint.fits or int(rng.integers(3, 6))
    base = np.geomspace(0.5, 2.0, count) if not one_level else np.linspace(0.95, 1.05, count)
    levels = base * np.exp(rng.uniform(-0.1, 0.1))
    recordings = [Recording(signal=usual, level=float(x), actuator=main, role="fit") for x in levels]
    if len(blueprint.exciters) > 1 and count > 3 and rng.random() < 0.5:
        second = str(rng.choice([e for e in blueprint.exciters if e != main]))
        old = recordings[1]
        recordings[1] = Recording(signal=usual, level=old.level, actuator=second, role="fit")
    held = float(np.exp(rng.uniform(np.log(0.7), np.log(1.6))))
    recordings.append(Recording(signal=usual, level=held, actuator=main, role="holdout"))
    recordings.append(Recording(signal=other, level=float(rng.uniform(0.8, 1.5)), actuator=main, role="holdout"))
    if rng.random() < 0.3:
        recordings.append(
            Recording(signal="multisine", level=float(rng.uniform(0.6, 1.6)), actuator=main, role="holdout")
        )
    time = np.arange(round(blueprint.seconds * blueprint.rate_hz)) / blueprint.rate_hz
    commands = np.zeros((time.size, len(blueprint.exciters), len(recordings)))
    for i, r in enumerate(recordings):
        signal = excite(r.signal, rng, time, blueprint.band_hz)
        commands[:, blueprint.exciters.index(r.actuator), i] = r.level * blueprint.force * signal
    return Plan(recordings=tuple(recordings), commands=commands)
