"""Validation in MuJoCo on hold-out recordings."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from vlab.cases.channel_map import Run
from vlab.cases.replay_bench import at_timestep
from vlab.cases.simulate import simulate
from vlab.diagnose.data.band import below
from vlab.diagnose.data.command_limit import CommandLimit
from vlab.diagnose.data.mains_interference import MainsInterference
from vlab.diagnose.data.noise import estimate_noise
from vlab.diagnose.data.quality import SensorLimit
from vlab.diagnose.data.quantisation import SensorStep
from vlab.diagnose.parameters.terms import Fit, with_effects
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import VALIDATION
from vlab.diagnose.validation.checked import Checked
from vlab.diagnose.validation.gap import block_log_ratios, part_of
from vlab.diagnose.validation.horizon import can_be_halved, is_predicted, length_of_parts, parts_of, parts_within
from vlab.errors import BadCase, Diverged
from vlab.parallel import side_by_side
from vlab.plants.base import Plant
from vlab.recordings.quality import held_samples
from vlab.signals import Array, Recording, rms, strung_together


@dataclass(frozen=True, kw_only=True, eq=False)
class ExtendedModel:
    """Calibrated plant with added physics, and its measurement chain.

    Parameters
    ----------
    plant : Plant
        Plant.
    names : tuple of str
        Compared channels.
    sensor_gain, offset, about : (n_channels,) array
        Gain, offset and the value about which the gain acts [SI], in the order of `names`.
    limit : CommandLimit or None
        Limit on a law's commands.
    stops : tuple of SensorLimit
        Range limits of sensors.
    interferences : tuple of MainsInterference
        Mains interference, with the amplitude of the fitted recordings and each recording's own phase.
    steps : tuple of SensorStep
        Quantisation of sensors.
    """

    plant: Plant
    names: tuple[str, ...] = ()
    sensor_gain: Array | None = None
    offset: Array | None = None
    about: Array | float = 0.0
    limit: CommandLimit | None = None
    stops: tuple[SensorLimit, ...] = ()
    interferences: tuple[MainsInterference, ...] = ()
    steps: tuple[SensorStep, ...] = ()

    def simulated(self, run: Run) -> Recording:
        """Simulate a run's channels.

        Parameters
        ----------
        run : Run
            Recording; it may lack corrected channels.

        Returns
        -------
        Recording
            Simulated channels [SI].

        Raises
        ------
        Diverged
            The simulation diverges.
        BadCase
            No initial state was found.
        """
        recording = simulate(self.plant, self._moved(run if self.limit is None else self.limit.on(run))).recording
        data = recording.data.copy()
        for column, gain, offset, about in self._calibration(recording):
            data[:, column] = about + gain * (data[:, column] - about) + offset
        for interference in self.interferences:
            if interference.channel in recording.names:
                data[:, recording.index(interference.channel)] += interference.expected(run)
        for step in self.steps:
            if step.channel in recording.names:
                column = recording.index(step.channel)
                data[:, column] = step.on(data[:, column])
        for stop in self.stops:
            if stop.channel in recording.names:
                column = recording.index(stop.channel)
                data[:, column] = np.clip(data[:, column], -stop.limit, stop.limit)
        return replace(recording, data=data)

    def _moved(self, run: Run) -> Run:
        """Return a run with calibrated channels, for the initial state."""
        before = None if run.before is None else self._calibrated(run.before)
        return replace(run, measured=self._calibrated(run.measured), before=before)

    def _calibrated(self, recording: Recording) -> Recording:
        """Return a recording without the gains and offsets of the sensors."""
        data = recording.data.copy()
        for column, gain, offset, about in self._calibration(recording):
            data[:, column] = about + (data[:, column] - about - offset) / gain
        return replace(recording, data=data)

    def _calibration(self, recording: Recording) -> Iterator[tuple[int, float, float, float]]:
        """Yield the calibration of every corrected channel."""
        if self.sensor_gain is None or self.offset is None:
            return
        abouts = np.broadcast_to(self.about, self.sensor_gain.shape)
        for name, *values in zip(self.names, self.sensor_gain, self.offset, abouts, strict=True):
            if name in recording.names:
                gain, offset, about = (float(value) for value in values)
                yield recording.index(name), gain, offset, about


SimulationKey: TypeAlias = tuple[ExtendedModel | None, Run, int]
"""Model, recording and its number of parts."""
SimulationCache: TypeAlias = dict[SimulationKey, Recording | None]
"""Simulation of each key; None without a model, or after divergence."""


def extended(problem: Problem, fit: Fit, without: Collection[str] = ()) -> ExtendedModel:
    """Return a problem's plant extended by a fit.

    Parameters
    ----------
    problem : Problem
        Problem.
    fit : Fit
        Fit.
    without : collection of str
        Channels whose offset stays zero.

    Returns
    -------
    ExtendedModel
        Extended model.
    """
    gains = np.ones(len(problem.names))
    for parameter, value in zip(problem.parameters, fit.theta, strict=True):
        if parameter.sensor is not None:
            gains[parameter.sensor] *= np.exp(value)
    return ExtendedModel(
        plant=with_effects(problem.adjusted(fit.theta), fit.terms, problem.names),
        names=problem.names,
        sensor_gain=gains,
        about=problem.about,
        offset=np.where([name in without for name in problem.names], 0.0, fit.offsets),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Ablations:
    """Extended model with findings removed, otherwise unchanged.

    Parameters
    ----------
    names : tuple of str
        Findings.
    models : tuple
        Model without each finding in this order. With several findings the last model has none.
    """

    names: tuple[str, ...] = ()
    models: tuple[Any, ...] = ()

    def changed(self, change: Callable[[Any], Any]) -> "Ablations":
        """Return the ablations with every model changed."""
        return replace(self, models=tuple(change(model) for model in self.models))


def check(
    runs: Sequence[Run],
    before: ExtendedModel,
    after: ExtendedModel | None,
    interferences: Sequence[MainsInterference] = (),
    *,
    nominal: ExtendedModel | None = None,
    ablations: Ablations | None = None,
    horizon_s: float = np.inf,
    band_hz: float = np.inf,
    cache: SimulationCache | None = None,
) -> list[Checked]:
    """Simulate runs with all models and compare.

    Parameters
    ----------
    runs : sequence of Run
        Recordings.
    before : ExtendedModel
        Calibrated model.
    after : ExtendedModel or None
        Extended model; None without findings.
    interferences : sequence of MainsInterference
        Interference that counts as noise.
    nominal : ExtendedModel or None
        Nominal model; without one its errors are NaN.
    ablations : Ablations or None
        Models without single findings.
    horizon_s : float
        Longest part that is predicted from one state [s].
    band_hz : float
        Highest frequency that the models predict [Hz]; above, an error counts as far as the noise.
    cache : dict, optional
        Known simulations of the nominal and the calibrated model; missing ones are added.

    Returns
    -------
    list of Checked
        Errors of every recording.
    """
    ablations, cache = ablations or Ablations(), {} if cache is None else cache
    models = [nominal, before, after, *ablations.models]
    counts = [parts_within(run, horizon_s) for run in runs]
    pending = list(range(len(runs)))
    found: dict[int, Checked] = {}
    while pending:
        cut = [(runs[i], counts[i]) for i in pending]
        new = _simulated([(model, *own) for own in cut for model in models if (model, *own) not in cache])
        cache |= {key: data for key, data in new.items() if key[0] in (nominal, before)}
        for i in pending:
            own = [(new if (key := (model, runs[i], counts[i])) in new else cache)[key] for model in models]
            length = length_of_parts(runs[i], counts[i])
            found[i] = _checked(runs[i], models, own, interferences, ablations.names, (length, band_hz))
        pending = [i for i in pending if can_be_halved(runs[i], counts[i]) and not _is_predicted(found[i])]
        for i in pending:
            counts[i] *= 2
    return [found[i] for i in range(len(runs))]


def _above(left: Array, h: float, band_hz: float, noise: float) -> float:
    """Return the mean square of an error above a band, beyond the noise there.

    Parameters
    ----------
    left : (n,) array
        Error of a model.
    h : float
        Sample period [s].
    band_hz : float
        Highest frequency that the models predict [Hz].
    noise : float
        Rms of the noise, which is white at these frequencies.
    """
    share = 2.0 * h * band_hz
    if share >= 1.0:
        return 0.0
    return max(float(np.mean((left - below(left, h, band_hz)) ** 2)) - (1.0 - share) * noise**2, 0.0)


def _is_predicted(checked: Checked) -> bool:
    return is_predicted([checked.nominal, checked.calibrated, checked.after], checked.noise)


def _simulated(keys: Sequence[SimulationKey]) -> SimulationCache:
    """Simulate runs, in parts, with their models.

    Parameters
    ----------
    keys : sequence of (ExtendedModel or None, Run, int)
        Models, recordings and numbers of parts.

    Returns
    -------
    dict
        Simulation of each key; None without a model, or where a part diverges.
    """
    parts = {key: parts_of(key[1], key[2]) for key in keys}
    data = iter(side_by_side(lambda item: _try(*item), [(key[0], part) for key in parts for part in parts[key]]))
    out: SimulationCache = {}
    for key, own in parts.items():
        found = [next(data) for _ in own]
        pieces = [d for d in found if d is not None]
        whole = own[0].measured if len(own) == 1 else strung_together([part.measured for part in own])
        is_whole = len(pieces) == len(own)
        meta = {"simulated": own[0].name}
        out[key] = replace(whole, data=np.concatenate(pieces), meta=meta) if is_whole else None
    return out


def spread_over(recordings: Sequence[Run], run: Run) -> dict[str, float]:
    """Return every channel's spread over all recordings, relative to one.

    Parameters
    ----------
    recordings : sequence of Run
        Recordings of the case.
    run : Run
        Recording of reference.

    Returns
    -------
    dict
        Spread by channel that moves in the recording of reference [1].
    """

    def values(own: Run, name: str) -> Array:
        return own.measured[name][own.measured.is_read(name)]

    names = [c.channel for c in run.compared if np.ptp(run.measured[c.channel]) > 0]
    return {
        name: float(
            np.std(np.concatenate([values(own, name) for own in recordings if name in own.measured.names]))
            / np.std(values(run, name))
        )
        for name in names
    }


def with_finer_steps(model: ExtendedModel) -> ExtendedModel:
    """Return a model whose plant has a shorter time step."""
    return replace(model, plant=at_timestep(model.plant, model.plant.timestep / VALIDATION.finer))


def coarse_steps(model: ExtendedModel, runs: Sequence[Run], horizon_s: float = np.inf) -> str:
    """Return a note where shorter time steps change runs.

    The change must exceed the noise. No physics compensates integration error. Both models are simulated over the same
    parts of every run.

    Parameters
    ----------
    model : ExtendedModel
        Calibrated model.
    runs : sequence of Run
        Recordings.
    horizon_s : float
        See `check`.

    Returns
    -------
    str
        Note, or "".
    """
    worst, where = 0.0, ""
    for own in check(runs, model, with_finer_steps(model), horizon_s=horizon_s):
        _, one, two = own.simulated
        if one is None or two is None:
            continue
        moved = [rms(one[name] - two[name]) / np.std(own.measured[name]) for name in own.channels]
        size = float(np.sqrt(np.mean(np.square(moved))))
        if size >= max(own.noise, VALIDATION.coarse * own.calibrated) and size > worst:
            worst, where = size, own.name
    if not where:
        return ""
    step = model.plant.timestep
    return (
        f"steps of {1e3 * step / VALIDATION.finer:.3g} ms instead of {1e3 * step:.3g} ms change what the model does in "
        f"{where} by {100 * worst:.2g} % of its rms: no physics makes up for that; give the model a shorter timestep, or the "
        'integrator "RK4"'
    )


def _checked(
    run: Run,
    models: Sequence[ExtendedModel | None],
    simulated: Sequence[Recording | None],
    interferences: Sequence[MainsInterference],
    findings: Sequence[str],
    extent: tuple[float, float],
) -> Checked:
    horizon, band_hz = extent
    names = [c.channel for c in run.compared if np.ptp(run.measured[c.channel]) > 0]
    kept = ~held_samples(run.measured)
    read = {n: run.measured.is_read(n) for n in names}
    scale = np.array([np.std(run.measured[n][read[n]]) for n in names])
    expected = noise = _noise_shares(run, names, scale, models, interferences)

    def above(left: Sequence[Array]) -> Array:
        if np.isinf(band_hz) or not run.measured.is_uniform:
            return np.zeros(len(left))
        h = run.measured.sample_period
        return np.array([_above(e, h, band_hz, n) for e, n in zip(left, expected * scale, strict=True)])

    def apart(one: Recording, other: Recording) -> Array:
        left = [(one[n] - other[n])[kept & read[n]] for n in names]
        whole, more = np.array([rms(e) for e in left]), above(left)
        return np.where(more > 0, np.sqrt(np.maximum(whole**2 - more, 0.0)), whole) / scale

    errors, recordings = [], list(simulated[:3])
    for model, recording in zip(models, simulated, strict=True):
        if recording is None:
            errors.append(np.full(len(names), np.inf if model is not None else np.nan))
        else:
            errors.append(apart(recording, run.measured))
    noise = np.fmin(noise, np.fmin.reduce(errors))  # a model does not predict noise, so no error is below the noise
    left = [rms(e) for e in errors]
    stands = errors[0] if left[1] > left[0] else errors[1]
    standing = recordings[0] if left[1] > left[0] else recordings[1]
    if models[2] is None:
        errors[2], recordings[2] = stands, standing
    bare = recordings[2] if not findings else simulated[-1]
    start = bare if findings and left[-1] < rms(stands) else standing
    is_limited = standing is not None and bool(
        np.any(above([(standing[n] - run.measured[n])[kept & read[n]] for n in names]) > (expected * scale) ** 2)
    )
    parts = []
    for name, without, own in zip(findings, simulated[3:], left[3:], strict=False):
        moved = np.full(len(names), np.inf)
        if recordings[2] is not None and without is not None:
            moved = apart(recordings[2], without)
        parts.append(part_of(name, own, moved, noise, int(kept.sum())))
    return Checked(
        name=run.name,
        role=run.role,
        nominal=left[0],
        before=rms(stands),
        after=rms(errors[2]),
        noise=rms(noise),
        channels={n: tuple(float(x[i]) for x in (errors[0], stands, errors[2], noise)) for i, n in enumerate(names)},  # type: ignore[misc]
        calibrated=left[1],
        bare=left[-1] if findings else float("nan"),
        parts=tuple(parts),
        horizon_s=horizon,
        band_hz=band_hz if is_limited else np.inf,
        log_ratios=_log_ratios(run, names, start, recordings[2], (scale, noise), band_hz if is_limited else np.inf),
        run=run,
        simulated=(recordings[0], recordings[1], recordings[2]),
    )


def _noise_shares(
    run: Run,
    names: Sequence[str],
    scale: Array,
    models: Sequence[ExtendedModel | None],
    interferences: Sequence[MainsInterference],
) -> Array:
    """Return the noise of every channel over its rms, with quantisation and mains interference."""
    estimates = [estimate_noise(run, name) for name in names]
    noise = np.array([estimate.rms for estimate in estimates]) / scale
    for step in next((m.steps for m in reversed(models[:3]) if m is not None), ()):
        if step.channel in names:
            i = names.index(step.channel)
            noise[i] = max(noise[i], step.step / np.sqrt(12) / scale[i])
    for interference in interferences:
        if interference.channel in names:
            i = names.index(interference.channel)
            hum = float(np.sqrt(np.mean(interference.on(run) ** 2))) / scale[i]
            noise[i] = max(noise[i], hum) if estimates[i].is_of_repeats else np.hypot(noise[i], hum)
    return noise


def _log_ratios(
    run: Run,
    names: Sequence[str],
    without: Recording | None,
    extended: Recording | None,
    sizes: tuple[Array, Array],
    band_hz: float,
) -> Array:
    """Return the log ratios of both models' errors by block.

    `sizes` holds the channels' rms, and their noise over the rms.
    """
    if without is None or extended is None or without is extended:
        return np.zeros(0)
    scale, noise = sizes
    kept = ~held_samples(run.measured)
    columns = [run.measured.index(name) for name in names]
    read = np.column_stack([run.measured.is_read(name) for name in names])
    errors = [
        below((model.data - run.measured.data)[:, columns] * read, run.measured.sample_period, band_hz)[kept] / scale
        for model in (without, extended)
    ]
    return block_log_ratios(errors[0], errors[1], VALIDATION.blocks, np.nan_to_num(noise) if np.isinf(band_hz) else 0.0)


def _try(model: ExtendedModel | None, run: Run) -> Array | None:
    try:
        return None if model is None else model.simulated(run).data
    except (Diverged, BadCase):  # or no initial state was found: the model cannot follow the recording
        return None
