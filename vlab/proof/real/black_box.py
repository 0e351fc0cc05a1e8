"""Black-box models of a case, as upper references.

A linear and a small nonlinear state-space model learn from the fitted recordings alone. Candidates learn the first two
thirds of every fitted recording, and the free run over the whole chooses their sizes. Both then run freely over the hold-out recordings from an initial state that is estimated in
the window of `vlab.cases.initial_state`. No black box knows the structure, and no effect comes out of it.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from vlab.cases.case import Case
from vlab.cases.channel_map import Run, compared_names
from vlab.cases.initial_state import LEAST_SAMPLES, MOST_SAMPLES, PERIODS
from vlab.diagnose.data.band import fastest
from vlab.diagnose.parameters.holdout import moves, read_holdout
from vlab.diagnose.settings import RECORDED_RUNS
from vlab.diagnose.validation.horizon import parts_of
from vlab.errors import VlabError
from vlab.proof.real.errors import RecordingErrors, errors_of, rms_over_recordings
from vlab.proof.real.state_space import Fitted, Model, Samples, estimated_start, fit, fit_in_stages
from vlab.proof.real.subspace import Observability, fit_linear, observability
from vlab.recordings.quality import held_samples
from vlab.signals import ORDER, Array, rms, sample_period

PER_PERIOD = 20.0
"""PER_PERIOD [samples]: least samples in a period of the highest recorded frequency; faster recordings are thinned."""
LEAST_KEPT = 400
"""LEAST_KEPT [samples]: thinning leaves at least as many samples of every fitted recording."""
LEARNT = 2.0 / 3.0
"""LEARNT [-]: first part of every fitted recording that teaches the candidates; the free run over the whole chooses."""
ORDERS = (1, 2, 3, 4, 6, 8, 10, 12, 16, 20)
"""ORDERS [-]: candidate orders of the linear model."""
ROWS, MOST_ROWS = 30, 400
"""ROWS [samples]: block rows of the subspace method.
MOST_ROWS [-]: most rows of a Hankel matrix."""
WORTH, EXACT, VAIN = 0.95, 1e-6, 3
"""WORTH [-]: ratio of errors below which a larger model is preferred to a smaller one.
EXACT [-]: error below which no larger model is preferred.
VAIN [-]: successive larger orders without such an improvement that end the search."""
UNITS = (3, 8)
"""UNITS [-]: candidate numbers of hyperbolic tangents."""
MOST_ORDER = 8
"""MOST_ORDER [-]: largest order of the nonlinear model."""
TRIAL_STEPS, LAST_STEPS, STAGE_STEPS = 15, 60, 40
"""TRIAL_STEPS [-]: most steps in the fit of a linear candidate.
LAST_STEPS [-]: most steps in the fit of the chosen model to everything.
STAGE_STEPS [-]: most steps in every stage of a nonlinear fit."""
RIDGE = 1e-5
"""RIDGE [-]: weight of the squared entries of the nonlinear part beside the squared relative errors; more makes the model
less nonlinear."""
FAR = 100.0
"""FAR [-]: largest simulated output, over the rms of the recording, beyond which a free run counts as diverged."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """Recordings of a case in the form of the black boxes.

    Parameters
    ----------
    fit, holdout : tuple of Run
        Fitted and hold-out recordings.
    names : tuple of str
        Output channels.
    period_s : float
        Common sample period [s].
    centre, scale : (p,) array
        Means and standard deviations of the outputs over the fitted recordings.
    force : (m,) array
        Standard deviations of the inputs.
    """

    fit: tuple[Run, ...]
    holdout: tuple[Run, ...]
    names: tuple[str, ...]
    period_s: float
    centre: Array
    scale: Array
    force: Array

    def samples(self, run: Run) -> Samples:
        """Return a recording at the common period, scaled.

        Inputs are means over the intervals, outputs are values at their beginnings.

        Parameters
        ----------
        run : Run
            Recording.

        Returns
        -------
        Samples
            Samples whose squared weighted errors sum up to the squared relative error.
        """
        at = run.measured.time
        stamps = at[0] + self.period_s * np.arange(1 + int((at[-1] - at[0]) / self.period_s + 1e-6))
        held = held_samples(run.measured)
        outputs, weights = [], []
        for i, name in enumerate(self.names):
            values, read = run.measured[name], run.measured.is_read(name) & ~held
            size = float(np.std(values[read])) / self.scale[i] if read.any() else 0.0
            outputs.append(np.interp(stamps, at, (values - self.centre[i]) / self.scale[i]))
            is_known = np.interp(stamps, at, read.astype(float)) == 1.0
            weights.append(is_known / size if size > 0.0 else np.zeros(stamps.size))
        inputs = [_means(at, run.measured[drive.channel], stamps) for drive in run.drives]
        u = np.column_stack(inputs) / self.force if inputs else np.zeros((stamps.size, 0))
        weight = np.column_stack(weights) / np.sqrt(stamps.size * len(self.names))
        return Samples(u=u, y=np.column_stack(outputs), weight=weight)


def _means(at: Array, values: Array, stamps: Array) -> Array:
    """Return the means of a signal over the intervals after some stamps."""
    if stamps.size == at.size:
        return np.interp(stamps, at, values)
    total = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(at))])  # constant between samples
    ends = np.append(stamps, stamps[-1] + (stamps[1] - stamps[0]))
    means = np.diff(np.interp(ends, at, total)) / np.diff(ends)
    means[-1] = values[-1]
    return np.asarray(means)


class _Unsuitable(Exception):
    """Reason for which a case has no black box."""


def black_boxes(case: Case, parts: Mapping[str, int], skip: int = 0) -> dict[str, Any]:
    """Return the hold-out errors of both black boxes on a case.

    Parameters
    ----------
    case : Case
        Case.
    parts : mapping of str to int
        Number of parts in which the diagnosis predicts a hold-out recording; one by default.
    skip : int
        First samples that absolute errors leave out.

    Returns
    -------
    dict
        Errors, sizes and durations of ``"linear"`` and ``"nonlinear"``, or the reason as ``"note"``.
    """
    try:
        data = prepared(case)
    except (_Unsuitable, VlabError) as reason:
        note = " ".join(str(reason).split())
        return {kind: {"note": f"not applicable: {note}"} for kind in ("linear", "nonlinear")}
    out: dict[str, Any] = {}
    began = time.monotonic()
    samples = [data.samples(run) for run in data.fit]
    linear = choose_linear(samples)
    out["linear"] = {
        **_result(data, linear.model, parts, skip),
        "order": linear.model.order,
        "seconds": time.monotonic() - began,
    }
    began = time.monotonic()
    nonlinear = choose_nonlinear(samples, linear)
    out["nonlinear"] = {
        **_result(data, nonlinear.model, parts, skip),
        "order": nonlinear.model.order,
        "units": nonlinear.model.units,
        "seconds": time.monotonic() - began,
    }
    for kind in out.values():
        kind["period_s"] = data.period_s
    return out


def prepared(case: Case) -> Prepared:
    """Return the recordings of a case for black boxes.

    Parameters
    ----------
    case : Case
        Case.

    Returns
    -------
    Prepared
        Recordings and scales.

    Raises
    ------
    _Unsuitable
        The case has no recordings over time to fit or to hold out, or its recordings cannot share one model.
    """
    fitted = [run for run in case.runs(("fit",)) if len(run.measured) >= RECORDED_RUNS.least_samples and moves(run)]
    if not fitted:
        raise _Unsuitable("responses and modal tables have no free run")
    holdout = read_holdout(case, compared_names(fitted), fitted).runs
    if not holdout:
        raise _Unsuitable("no recording is held out")
    names = [c.channel for c in fitted[0].compared]
    drives = [(d.actuator, d.port) for d in fitted[0].drives]
    for run in (*fitted, *holdout):
        if [c.channel for c in run.compared] != names or [(d.actuator, d.port) for d in run.drives] != drives:
            raise _Unsuitable(f"{run.name} has other channels than {fitted[0].name}")
        if not run.measured.is_uniform:
            raise _Unsuitable(f"the time stamps of {run.name} are uneven")
    names = [name for name in names if any(np.ptp(run.measured[name]) > 0 for run in fitted)]
    outputs = [np.concatenate([run.measured[name][run.measured.is_read(name)] for run in fitted]) for name in names]
    inputs = [
        np.concatenate([run.measured[run.drives[i].channel] for run in fitted]) for i in range(len(fitted[0].drives))
    ]
    return Prepared(
        fit=tuple(fitted),
        holdout=tuple(holdout),
        names=tuple(names),
        period_s=_period(fitted, names),
        centre=np.array([np.mean(values) for values in outputs]),
        scale=np.array([np.std(values) for values in outputs]),
        force=np.array([rms(values) or 1.0 for values in inputs]),
    )


def _period(fitted: Sequence[Run], names: Sequence[str]) -> float:
    """Return the sample period of the black boxes [s]."""
    longest = max(sample_period(run.measured.time) for run in fitted)
    channels = fitted[0].measured.channels
    orders = [ORDER.get(channels[fitted[0].measured.index(name)].kind, 0) for name in names]
    highest = max(
        fastest(np.column_stack([run.measured[n] for n in names]), sample_period(run.measured.time), orders)
        for run in fitted
    )
    shortest = min(float(run.measured.time[-1] - run.measured.time[0]) for run in fitted)
    wanted = min(1.0 / (PER_PERIOD * highest) if highest > 0.0 else np.inf, shortest / LEAST_KEPT)
    return longest * max(1, int(wanted / longest + 1e-9))


def choose_linear(samples: Sequence[Samples]) -> Fitted:
    """Fit linear models of several orders, and the chosen one to everything.

    Parameters
    ----------
    samples : sequence of Samples
        Fitted recordings.

    Returns
    -------
    Fitted
        Model of the order whose free run departs least, the unseen last third included.
    """
    learnt = [own.rows(slice(_learnt(own))) for own in samples]
    seen = _observability(learnt)
    orders = [order for order in ORDERS if order <= seen.most] or [1]
    errors: list[float] = []
    for order in orders:
        found = fit_linear(seen, learnt, order, steps=TRIAL_STEPS)
        errors.append(_trial_error(found, samples))
        if len(errors) > _smallest(errors) + VAIN:
            break
    return fit_linear(_observability(samples), samples, orders[_smallest(errors)], steps=LAST_STEPS)


def choose_nonlinear(samples: Sequence[Samples], linear: Fitted) -> Fitted:
    """Fit nonlinear models of several sizes, and the chosen one to everything.

    Parameters
    ----------
    samples : sequence of Samples
        Fitted recordings.
    linear : Fitted
        Linear model of the same recordings.

    Returns
    -------
    Fitted
        Model of the size whose free run departs least, the unseen last third included.
    """
    learnt = [own.rows(slice(_learnt(own))) for own in samples]
    seen = _observability(learnt)
    outputs = samples[0].y.shape[1]
    wanted = (2 * outputs, 4 * outputs, linear.model.order)
    orders = sorted({min(order, MOST_ORDER, seen.most) for order in wanted})
    found = [_nonlinear(seen, learnt, order, units) for order in orders for units in UNITS]
    chosen = found[_smallest([_trial_error(one, samples) for one in found])]
    return fit(chosen.model, samples, chosen.starts, steps=LAST_STEPS, ridge=RIDGE)


def _nonlinear(seen: Observability, samples: Sequence[Samples], order: int, units: int) -> Fitted:
    """Fit a nonlinear model from the linear one of its order."""
    linear = fit_linear(seen, samples, order, steps=TRIAL_STEPS)
    forces = np.std(np.vstack([own.u for own in samples]), axis=0)
    start = linear.model.with_units(units, np.concatenate([np.ones(order), forces]))
    window = _window(linear.model, samples[0], len(samples[0].y))
    return fit_in_stages(start, samples, steps=STAGE_STEPS, window=window, ridge=RIDGE)


def _learnt(own: Samples) -> int:
    return max(1, int(LEARNT * len(own.y)))


def _observability(samples: Sequence[Samples]) -> Observability:
    channels = samples[0].u.shape[1] + samples[0].y.shape[1]
    shortest = min(len(own.y) for own in samples)
    rows = max(2, min(ROWS, MOST_ROWS // (2 * channels), shortest // 4))
    return observability(samples, rows)


def _trial_error(found: Fitted, samples: Sequence[Samples]) -> float:
    """Return the weighted rms error over whole recordings, learnt and unseen parts.

    The unseen part of a decay may be noise alone, and the learnt part then decides.
    """
    total = 0.0
    for own, x0 in zip(samples, found.starts, strict=True):
        left = own.weight * (found.model.simulated(x0, own.u) - own.y)
        total += float(np.sum(left**2)) if np.all(np.isfinite(left)) else np.inf
    return float(np.sqrt(total))


def _smallest(errors: Sequence[float]) -> int:
    """Return the first model that no later one beats clearly."""
    best = 0
    for i, error in enumerate(errors):
        if errors[best] > EXACT and error < WORTH * errors[best]:
            best = i
    return best


def _window(model: Model, own: Samples, most: int) -> int:
    """Return the samples that estimate an initial state.

    The window holds two periods of the slowest mode with half a period in the recording, as that of the models of
    physics.
    """
    values = np.linalg.eigvals(model.A)
    turns = np.abs(np.angle(values[np.imag(values) > 0])) / (2.0 * np.pi)  # cycles per sample
    slow = turns[turns * len(own.y) > 0.5]
    count = int(PERIODS / slow.min()) if slow.size else 0
    return min(max(count, LEAST_SAMPLES), most, max(len(own.y) // 2, 2))  # half of a short part stays unseen


def _result(data: Prepared, model: Model, parts: Mapping[str, int], skip: int) -> dict[str, Any]:
    """Return the errors of a model on the hold-out recordings."""
    found = [_holdout_errors(data, model, run, parts.get(run.name, 1), skip) for run in data.holdout]
    total = rms_over_recordings([one.nrmse for one in found])
    return {
        "nrmse": total,
        "per_recording": [one.to_json() for one in found],
        "note": "" if np.isfinite(total) else "diverged on a hold-out recording",
    }


def _holdout_errors(data: Prepared, model: Model, run: Run, count: int, skip: int) -> RecordingErrors:
    pieces = []
    for part in parts_of(run, count):
        own = data.samples(part)
        ratio = sample_period(part.measured.time) / data.period_s
        most = max(LEAST_SAMPLES, int(MOST_SAMPLES * ratio))
        y = model.simulated(estimated_start(model, own, _window(model, own, most)), own.u)
        stamps = part.measured.time[0] + data.period_s * np.arange(len(y))
        if not np.all(np.isfinite(y)):
            return errors_of(run, None, skip)
        seen = y if len(y) == len(part.measured) else CubicSpline(stamps, y)(part.measured.time)
        pieces.append(data.centre + data.scale * seen)
    whole = run.measured.data.copy()
    columns = [run.measured.index(name) for name in data.names]
    values = np.concatenate(pieces)
    sizes = np.array([np.std(run.measured[name]) for name in data.names])
    if np.any(np.abs(values - run.measured.data[:, columns]) > FAR * np.where(sizes > 0, sizes, np.inf)):
        return errors_of(run, None, skip)
    whole[:, columns] = values
    return errors_of(run, replace(run.measured, data=whole), skip)
