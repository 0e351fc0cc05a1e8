"""What recordings show without any law of physics fitted, and without their model: limits, steps, hum, damage."""

from dataclasses import dataclass, replace

import numpy as np

from vlab.diagnose.data.command_limit import CommandLimit, find_limit
from vlab.diagnose.data.mains_interference import Hum
from vlab.diagnose.data.noise import noise_levels
from vlab.diagnose.data.quality import Damage, SensorLimit, sensor_limits
from vlab.diagnose.data.quantisation import SensorStep, sensor_steps
from vlab.diagnose.diagnosis import Finding
from vlab.diagnose.findings import of_hum, of_limit, of_step, of_stop, of_zero
from vlab.diagnose.inference.sensor_offset import Zero
from vlab.diagnose.problem import Problem
from vlab.diagnose.validation.simulation import Amended

BENIGN_HUM, HUM_OVER_NOISE = 0.03, 2.0
"""Hum below this share of its channel's rms, or this multiple of its noise, is what every laboratory has."""
BENIGN_STOP, SAME_TOPS, BEYOND = 0.002, 2, 10.0
"""A sensor that stands at its limit for a smaller share of the samples is said among the recordings' defects only, unless that many ends
of recordings stand at exactly the same, or the signal came and went so fast that it would have gone that many steps further: a single
flat top may be a coarse reading of a smooth one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """What recordings show without any law of physics fitted.

    Parameters
    ----------
    limit : CommandLimit or None
        Of the commands of a law in the loop.
    stops : tuple of SensorLimit
        Of sensors, where they matter.
    steps : tuple of SensorStep
        Of sensors whose readings are coarse.
    hums, benign_hums : tuple of Hum
        On sensors: where it matters, and elsewhere.
    damage : Damage
        Of the recordings.
    zeros : tuple of Zero
        Of channels that are far off, as the last fit has them.
    """

    limit: CommandLimit | None
    stops: tuple[SensorLimit, ...]
    steps: tuple[SensorStep, ...]
    hums: tuple[Hum, ...]
    benign_hums: tuple[Hum, ...]
    damage: Damage
    zeros: tuple[Zero, ...] = ()

    @property
    def is_missing(self) -> bool:
        """Whether any of it is physics that the model lacks."""
        return self.limit is not None or bool(self.stops) or bool(self.steps) or bool(self.hums) or bool(self.zeros)

    def on(self, model: Amended) -> Amended:
        """Return a model with it."""
        return replace(model, limit=self.limit, stops=self.stops, steps=self.steps, hums=self.hums)

    def of_law(self, problem: Problem) -> list[Finding]:
        """Return the limit of the commands as a finding: the law is known, so nothing is surer."""
        return [] if self.limit is None else [of_limit(self.limit, problem)]

    def of_sensors(self, problem: Problem) -> list[Finding]:
        """Return what sensors show as findings."""
        units = {c.name: c.unit for c in problem.runs[0].measured.channels}
        out = [of_stop(stop, units[stop.channel]) for stop in self.stops]
        out += [of_step(step, units[step.channel]) for step in self.steps]
        out += [of_hum(hum, units[hum.channel]) for hum in self.hums]
        return out + [of_zero(zero, units[zero.channel]) for zero in self.zeros]


def look(problem: Problem, damage: Damage) -> Seen:
    """Look at the recordings to fit of a case without its model; the law in the loop aside, whose commands are replayed."""
    runs = problem.runs
    big: list[Hum] = []
    small: list[Hum] = []
    for hum in problem.hums:
        noise = float(np.median([noise_levels(run, [hum.channel]) for run in runs]))
        matters = hum.share > BENIGN_HUM and hum.rms > HUM_OVER_NOISE * noise
        (big if matters else small).append(hum)
    stops = tuple(
        stop
        for stop in sensor_limits(runs)
        if stop.share > BENIGN_STOP or stop.tops >= SAME_TOPS or stop.beyond > BEYOND
    )
    limit = find_limit(problem.case.plant, runs)
    steps = tuple(step for step in sensor_steps(runs) if step.channel not in {stop.channel for stop in stops})
    return Seen(limit=limit, stops=stops, steps=steps, hums=tuple(big), benign_hums=tuple(small), damage=damage)
