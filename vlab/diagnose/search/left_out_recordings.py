"""Cross-validation over fitted recordings, where no hold-out recording excites an effect.

Every fitted recording that excites the effect is left out in turn. The calibrated and the extended model are refitted to
the others and predict it. Of a single such recording, every half is left out in turn. An effect in a single half remains
unverified.

References
----------
M. Stone, Cross-validatory choice and assessment of statistical predictions, J. R. Stat. Soc. B 36 (1974) 111-147.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from vlab.cases.channel_map import Run
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.diagnosis import Attempt, Finding
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.search.ablation import wrong_offsets
from vlab.diagnose.search.attempt import Trials
from vlab.diagnose.settings import CROSS_VALIDATION
from vlab.diagnose.validation.checked import Checked
from vlab.diagnose.validation.horizon import can_be_halved, parts_of
from vlab.diagnose.validation.simulation import extended
from vlab.signals import Array


def with_left_out(
    attempt: Attempt,
    trials: Trials,
    whole: LeastSquares,
    before: Fit,
    findings_of: Callable[[Fit], Sequence[Finding]],
) -> Attempt:
    """Return an attempt with its errors on left-out recordings.

    Parameters
    ----------
    attempt : Attempt
        Attempt without effect in any hold-out recording.
    trials : Trials
        Models and recordings of the attempt.
    whole : LeastSquares
        Fits to whole runs.
    before : Fit
        Fit of the calibrated model.
    findings_of : callable
        Returns the findings of a fit.

    Returns
    -------
    Attempt
        Attempt with further errors; unchanged where fewer than two fitted recordings, or halves, excite the effect.
    """
    findings = findings_of(attempt.fit)
    exciting = _exciting(trials.on_fitted(attempt.fit, findings))
    recording = exciting[0].name if len(exciting) == 1 else ""
    if len(exciting) == 1 and can_be_halved(exciting[0], 1):
        halves = [
            replace(half, name="{} from {:.4g} to {:.4g} s".format(half.name, *_span_of(half)))
            for half in parts_of(exciting[0], 2)
        ]
        exciting = _exciting(replace(trials, runs=halves).of(attempt.fit, findings).checked)
    if len(exciting) < 2:
        return attempt

    def predicted(run: Run) -> Sequence[Checked]:
        rest = leaving_out(whole, recording, _span_of(run)) if recording else leaving_out(whole, run.name)
        calibrated, fit = (rest.fit(f.terms, f, CROSS_VALIDATION.refitted) for f in (before, attempt.fit))
        offsets = wrong_offsets(trials.problem, attempt.fit, trials.seen)
        model = extended(trials.problem, calibrated, offsets)
        own = replace(
            trials,
            runs=[replace(run, name=f"{run.name}, left out of the fit", role="holdout")],
            before=model if trials.change is None else trials.change(model),
            cache={},
        )
        return own.of(fit, findings_of(fit)).checked

    return replace(attempt, checked=(*attempt.checked, *(c for run in exciting for c in predicted(run))))


def _span_of(run: Run) -> tuple[float, float]:
    """Return the first and the last time of a recording [s]."""
    return float(run.measured.time[0]), float(run.measured.time[-1])


def _exciting(checked: Sequence[Checked]) -> list[Run]:
    """Return the recordings in which an effect acts."""
    return [c.run for c in checked if any(not part.is_idle for part in c.parts)]


def leaving_out(whole: LeastSquares, recording: str, span: tuple[float, float] = (-np.inf, np.inf)) -> LeastSquares:
    """Return fits without the samples of a recording.

    Parameters
    ----------
    whole : LeastSquares
        Fits to whole runs.
    recording : str
        Name of a fitted recording.
    span : tuple of float
        Times of the first and the last sample to leave out [s].

    Returns
    -------
    LeastSquares
        Fits to the other samples.
    """

    def left(run: Signals, time: Array) -> Signals:
        margin = 0.5 * float(np.median(np.diff(time))) if len(time) > 1 else 0.0
        valid = np.ones(run.y.shape, dtype=bool) if run.valid is None else run.valid
        return replace(run, valid=valid & ((time < span[0] - margin) | (time > span[1] + margin))[:, None])

    other = copy(whole)
    other.runs = [
        left(run, time) if name == recording else run
        for run, name, time in zip(whole.runs, whole.recordings, whole.sample_times, strict=True)
    ]
    other.__dict__.pop("weights", None)  # of the samples
    other.free_starts = other.initial_condition_nuisance()
    return other
