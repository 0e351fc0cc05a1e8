"""Findings from the data alone: limits, quantisation, interference, data quality, offsets."""

from dataclasses import dataclass, replace

import numpy as np

from vlab.diagnose.data.command_limit import CommandLimit, find_limit
from vlab.diagnose.data.mains_interference import MainsInterference
from vlab.diagnose.data.noise import noise_levels, noise_notes
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
    """Findings without any fitted law.

    Parameters
    ----------
    limit : CommandLimit or None
        Limit of a law's commands.
    stops : tuple of SensorLimit
        Significant range limits of sensors.
    steps : tuple of SensorStep
        Coarse quantisation of sensors.
    interferences, benign_interferences : tuple of MainsInterference
        Significant and benign mains interference.
    damage : DataQuality
        Data quality of the recordings.
    zeros : tuple of SensorOffset
        Large sensor offsets of the last fit.
    noise : tuple of str
        Noise of every channel and its source.
    """

    limit: CommandLimit | None
    stops: tuple[SensorLimit, ...]
    steps: tuple[SensorStep, ...]
    interferences: tuple[MainsInterference, ...]
    benign_interferences: tuple[MainsInterference, ...]
    damage: DataQuality
    zeros: tuple[SensorOffset, ...] = ()
    noise: tuple[str, ...] = ()

    @property
    def is_missing(self) -> bool:
        """Whether any finding is physics missing in the model."""
        return (
            self.limit is not None
            or bool(self.stops)
            or bool(self.steps)
            or bool(self.interferences)
            or bool(self.zeros)
        )

    def on(self, model: ExtendedModel) -> ExtendedModel:
        """Return a model with the findings."""
        return replace(model, limit=self.limit, stops=self.stops, steps=self.steps, interferences=self.interferences)

    def of_law(self, problem: Problem) -> list[Finding]:
        """Return the command limit as a finding.

        The law is known, so the limit is the most certain finding.
        """
        return [] if self.limit is None else [finding_of_limit(self.limit, problem)]

    def of_sensors(self, problem: Problem) -> list[Finding]:
        """Return the sensor findings.

        Parameters
        ----------
        problem : Problem
            Problem with the recordings.

        Returns
        -------
        list of Finding
            Limits, quantisation, interference and offsets.
        """
        units = {c.name: c.unit for c in problem.runs[0].measured.channels}
        out = [finding_of_stop(stop, units[stop.channel]) for stop in self.stops]
        out += [finding_of_step(step, units[step.channel]) for step in self.steps]
        out += [
            finding_of_interference(interference, units[interference.channel]) for interference in self.interferences
        ]
        return out + [finding_of_offset(offset, units[offset.channel]) for offset in self.zeros]


def look_at_data(problem: Problem, damage: DataQuality) -> DataFindings:
    """Examine the fitted recordings without their model.

    Only commands of a control law are replayed.

    Parameters
    ----------
    problem : Problem
        Problem with the recordings.
    damage : DataQuality
        Data quality.

    Returns
    -------
    DataFindings
        Findings.
    """
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
        noise=tuple(noise_notes(runs, problem.names)),
    )
