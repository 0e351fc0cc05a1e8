"""The recordings of a case: which signals at which levels, through which actuator, to fit or held out."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vlab.proof.generator.bench import Blueprint
from vlab.proof.generator.excite import CLASSES, excite
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class Recording:
    """One recording that is planned: its signal's class, its level in multiples of the middle one, its actuator."""

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
        At the rate of the recordings.
    """

    recordings: tuple[Recording, ...]
    commands: Array

    @property
    def fit(self) -> list[int]:
        """Indices of the recordings to fit."""
        return [i for i, r in enumerate(self.recordings) if r.role == "fit"]

    @property
    def loudest(self) -> int:
        """Index of the loudest recording to fit."""
        return max(self.fit, key=lambda i: self.recordings[i].level)

    @property
    def middle(self) -> int:
        """Index of the recording to fit whose level is the median."""
        order = sorted(self.fit, key=lambda i: self.recordings[i].level)
        return order[len(order) // 2]

    @property
    def driven(self) -> tuple[str, ...]:
        """The actuators that are used, the most used one first."""
        return tuple(dict.fromkeys(r.actuator for r in self.recordings))


def plan(blueprint: Blueprint, rng: np.random.Generator, *, one_level: bool = False) -> Plan:
    """Draw the recordings of a case.

    Three to five recordings to fit of one signal class at three levels at least, then two or three held out, the first of
    the same class at another level, the second of another class.

    Parameters
    ----------
    one_level : bool
        The recordings to fit lie within a tenth of one level: what depends on the level looks like something linear.
    """
    main = str(rng.choice(blueprint.exciters))
    usual = str(rng.choice(["multisine", "noise"], p=[0.8, 0.2]))
    other = str(rng.choice([c for c in CLASSES if c not in (usual, "noise", "multisine")]))
    count = int(rng.integers(3, 6))
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
