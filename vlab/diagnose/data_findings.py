"""What recordings show without any law of physics fitted, and without their model: limits, steps, hum, damage."""

from dataclasses import dataclass, replace

import numpy as np

from vlab.diagnose.data.command_limit import CommandLimit, find_limit
from vlab.diagnose.data.mains_interference import MainsInterference
from vlab.diagnose.data.noise import noise_levels
from vlab.diagnose.data.quality import DataQuality, SensorLimit, sensor_limits
from vlab.diagnose.data.quantisation import SensorStep, sensor_steps
from vlab.diagnose.diagnosis import Finding
from vlab.diagnose.findings import (
    finding_of_interference,
    finding_of_limit,
    finding_of_offset,
    finding_of_step,
    finding_of_stop,
)
from vlab.diagnose.inference.sensor_offset import SensorOffset
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import DATA_FINDINGS
from vlab.diagnose.validation.simulation import ExtendedModel


@dataclass(frozen=True, kw_only=True, eq=False)
class DataFindings:
    """What recordings show without any law of physics fitted.

    Parameters
    ----------
    limit : CommandLimit or None
        Of the commands of a law in the loop.
    stops : tuple of SensorLimit
        Of sensors, where they matter.
    steps : tuple of SensorStep
        Of sensors whose readings are coarse.
    hums, benign_interferences : tuple of Hum
        On sensors: where it matters, and elsewhere.
    damage : Damage
        Of the recordings.
    zeros : tuple of Zero
        Of channels that are far off, as the last fit has them.
    """

    limit: CommandLimit | None
    stops: tuple[SensorLimit, ...]
    steps: tuple[SensorStep, ...]
    interferences: tuple[MainsInterference, ...]
    benign_interferences: tuple[MainsInterference, ...]
    damage: DataQuality
    zeros: tuple[SensorOffset, ...] = ()

    @property
    def is_missing(self) -> bool:
        """Whether any of it is physics that the model lacks."""
        return (
            self.limit is not None
            or bool(self.stops)
            or bool(self.steps)
            or bool(self.interferences)
            or bool(self.zeros)
        )

    def on(self, model: ExtendedModel) -> ExtendedModel:
        """Return a model with it."""
        return replace(model, limit=self.limit, stops=self.stops, steps=self.steps, interferences=self.interferences)

    def of_law(self, problem: Problem) -> list[Finding]:
        """Return the limit of the commands as a finding: the law is known, so nothing is surer."""
        return [] if self.limit is None else [finding_of_limit(self.limit, problem)]

    def of_sensors(self, problem: Problem) -> list[Finding]:
        """Return what sensors show as findings."""
        units = {c.name: c.unit for c in problem.runs[0].measured.channels}
        out = [finding_of_stop(stop, units[stop.channel]) for stop in self.stops]
        out += [finding_of_step(step, units[step.channel]) for step in self.steps]
        out += [
            finding_of_interference(interference, units[interference.channel]) for interference in self.interferences
        ]
        return out + [finding_of_offset(offset, units[offset.channel]) for offset in self.zeros]


def look_at_data(problem: Problem, damage: DataQuality) -> DataFindings:
    """Look at the recordings to fit of a case without its model; the law in the loop aside, whose commands are replayed."""
    runs = problem.runs
    big: list[MainsInterference] = []
    small: list[MainsInterference] = []
    for interference in problem.interferences:
        noise = float(np.median([noise_levels(run, [interference.channel]) for run in runs]))
        matters = (
            interference.share > DATA_FINDINGS.benign_interference
            and interference.rms > DATA_FINDINGS.interference_over_noise * noise
        )
        (big if matters else small).append(interference)
    stops = tuple(
        stop
        for stop in sensor_limits(runs)
        if stop.share > DATA_FINDINGS.benign_stop
        or stop.tops >= DATA_FINDINGS.same_tops
        or stop.beyond > DATA_FINDINGS.beyond
    )
    limit = find_limit(problem.case.plant, runs)
    steps = tuple(step for step in sensor_steps(runs) if step.channel not in {stop.channel for stop in stops})
    return DataFindings(
        limit=limit,
        stops=stops,
        steps=steps,
        interferences=tuple(big),
        benign_interferences=tuple(small),
        damage=damage,
    )
