"""Findings from the data alone: limits, quantisation, interference, data quality, offsets."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from vlab.cases.channel_map import Run
from vlab.cases.initial_state import joint_of
from vlab.diagnose.data.command_limit import CommandLimit, find_limit
from vlab.diagnose.data.mains_interference import MainsInterference
from vlab.diagnose.data.noise import noise_levels, noise_notes
from vlab.diagnose.data.quality import DataQuality, SensorLimit, sensor_limits
from vlab.diagnose.data.quantisation import SensorStep, sensor_steps
from vlab.diagnose.diagnosis import Finding
from vlab.diagnose.findings import command_unit
from vlab.diagnose.inference.sensor_offset import SensorOffset
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import DATA_FINDINGS, EVIDENCE, FINDINGS
from vlab.diagnose.validation.simulation import ExtendedModel
from vlab.physics.catalogue import EFFECTS


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
    offsets : tuple of SensorOffset
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
    offsets: tuple[SensorOffset, ...] = ()
    noise: tuple[str, ...] = ()

    @property
    def is_missing(self) -> bool:
        """Whether any finding is physics missing in the model."""
        return (
            self.limit is not None
            or bool(self.stops)
            or bool(self.steps)
            or bool(self.interferences)
            or bool(self.offsets)
        )

    def quality_lines(self, *, is_named: bool) -> tuple[str, ...]:
        """Return the lines on the quality of the recordings.

        Parameters
        ----------
        is_named : bool
            Whether the verdict reports the findings; quantisation counts as noise otherwise.

        Returns
        -------
        tuple of str
            Lines on damage, benign interference and quantisation.
        """
        steps = () if is_named else self.steps
        return (*self.damage.lines, *(hum.line for hum in self.benign_interferences), *(step.line for step in steps))

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
        return out + [
            finding_of_offset(offset, units[offset.channel], alike_offsets(offset.channel, problem))
            for offset in self.offsets
        ]


def look_at_data(problem: Problem, damage: DataQuality, held_out: Sequence[Run] = ()) -> DataFindings:
    """Examine the fitted recordings without their model.

    Only commands of a control law are replayed.

    Parameters
    ----------
    problem : Problem
        Problem with the recordings.
    damage : DataQuality
        Data quality.
    held_out : sequence of Run
        Hold-out recordings; a sensor's range limit holds in them, too.

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
        for stop in sensor_limits(runs, held_out)
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


def finding_of_limit(limit: CommandLimit, problem: Problem) -> Finding:
    """Return the finding of a command limit.

    Parameters
    ----------
    limit : CommandLimit
        Limit.
    problem : Problem
        Problem with the law.

    Returns
    -------
    Finding
        Finding.
    """
    law = next(run.law for run in problem.runs if run.law is not None)
    effect = EFFECTS["actuator-clipping"]
    index = problem.plant.actuator_index(limit.actuator)
    unit = command_unit(problem, index)
    scale = float(law.per_actuator[list(law.actuators).index(index)])
    reach = "the law receives the limited command" if limit.is_known else "the law does not know of it"
    # odds of the replay errors, at the effective sample size of every score
    odds = (limit.after / limit.before) ** EVIDENCE.model_error_samples
    return Finding(
        effect=effect.name,
        form=effect.name,
        family=effect.family,
        place=f"actuator:{limit.actuator}",
        places_90=(f"actuator:{limit.actuator}",),
        probability=1.0 / (1.0 + odds),
        alike=(effect.name,),
        parameters={"limit": _estimated(limit.limit * scale, limit.sd * scale, unit)},
        law=effect.law,
        words=f"{effect.words}; the replayed law misses the recorded commands by {100 * limit.before:.0f} % without it and "
        f"{100 * limit.after:.0f} % with it, and {reach}",
    )


def finding_of_interference(interference: MainsInterference, unit: str) -> Finding:
    """Return the finding of mains interference on a sensor.

    Parameters
    ----------
    interference : MainsInterference
        Interference.
    unit : str
        Unit of the channel.

    Returns
    -------
    Finding
        Finding.
    """
    lines = " and ".join(f"{k * interference.frequency:.2f} Hz" for k in interference.harmonics)
    words = f"at {lines}, {100 * interference.share:.2g} % of the channel's rms, steady, at a phase of its own in every recording"
    parameters = {
        "amplitude": _known(np.sqrt(2) * interference.rms, DATA_FINDINGS.amplitude_sd, unit),
        "frequency": _known(interference.frequency, DATA_FINDINGS.exact_sd, "Hz"),
    }
    return _seen("mains-hum", interference.channel, parameters, words)


def finding_of_stop(stop: SensorLimit, unit: str) -> Finding:
    """Return the finding of a sensor's range limit."""
    words = f"{100 * stop.share:.2g} % of its samples stand at exactly that value"
    return _seen("sensor-clipping", stop.channel, {"limit": _known(stop.limit, DATA_FINDINGS.exact_sd, unit)}, words)


def finding_of_step(step: SensorStep, unit: str) -> Finding:
    """Return the finding of a coarsely quantised sensor.

    Parameters
    ----------
    step : SensorStep
        Quantisation.
    unit : str
        Unit of the channel.

    Returns
    -------
    Finding
        Finding.
    """
    parameters = {"step": _estimated(step.step, step.sd, unit)}
    words = f"its values stand on steps of {100 * step.share:.2g} % of its rms"
    return _seen("sensor-quantisation", step.channel, parameters, words)


def alike_offsets(channel: str, problem: Problem) -> tuple[str, ...]:
    """Return the effects that shift a channel by the same constant.

    A constant force shifts the reading of a joint alone if a servo holds the joint, or the spring of the only joint.

    Parameters
    ----------
    channel : str
        Channel.
    problem : Problem
        Problem with plant and recordings.

    Returns
    -------
    tuple of str
        Effects, the offset of the sensor first.
    """
    compared = next((c for c in problem.runs[0].compared if c.channel == channel), None)
    found = None if compared is None else joint_of(problem.plant, compared)
    if found is None or found[1] != 0:
        return ("sensor-offset",)
    model = problem.plant.model
    joint = int(model.dof_jntid[found[0]])
    is_driven = (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)) & (model.actuator_trnid[:, 0] == joint)
    if np.any(is_driven & (model.actuator_biasprm[:, 1] < 0.0)):
        return ("sensor-offset", "actuator-offset", "force-offset")
    return ("sensor-offset", "force-offset") if model.nv == 1 and model.jnt_stiffness[joint] > 0 else ("sensor-offset",)


def finding_of_offset(offset: SensorOffset, unit: str, alike: tuple[str, ...] = ("sensor-offset",)) -> Finding:
    """Return the finding of a sensor offset.

    Parameters
    ----------
    offset : SensorOffset
        Offset.
    unit : str
        Unit of the channel.
    alike : tuple of str
        Effects of the same readings, which share the probability.

    Returns
    -------
    Finding
        Finding.
    """
    parameters = {"offset": _estimated(offset.offset, offset.sd, unit)}
    words = "the fit to all recordings puts the offset there"
    if len(alike) > 1:
        words += f"; {' or '.join(alike[1:])} of this joint shifts the readings alike"
    found = _seen("sensor-offset", offset.channel, parameters, words)
    return replace(found, alike=alike, probability=FINDINGS.seen / len(alike))


def _seen(name: str, channel: str, parameters: dict[str, dict[str, Any]], words: str) -> Finding:
    effect, place = EFFECTS[name], f"sensor:{channel.removeprefix('sensor:')}"
    return Finding(
        effect=name,
        form=name,
        family=effect.family,
        place=place,
        places_90=(place,),
        probability=FINDINGS.seen,
        alike=(name,),
        parameters=parameters,
        law=effect.law,
        words=f"{effect.words}; {words}",
    )


def _estimated(value: float, sd: float, unit: str) -> dict[str, Any]:
    """Return a value with its normal 90 % interval."""
    spread = FINDINGS.half_width * sd
    return {"value": value, "unit": unit, "ci90": [value - spread, value + spread]}


def _known(value: float, share: float, unit: str) -> dict[str, Any]:
    return {"value": float(value), "unit": unit, "ci90": [float(value * (1 - share)), float(value * (1 + share))]}
