"""Cross-validation over fitted recordings, where no hold-out recording excites an effect.

Every fitted recording that excites the effect is left out in turn. The calibrated and the extended model are refitted to
the others and predict it. An effect in a single recording remains unverified.

References
----------
M. Stone, Cross-validatory choice and assessment of statistical predictions, J. R. Stat. Soc. B 36 (1974) 111-147.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from vlab.cases.channel_map import Run
from vlab.diagnose.diagnosis import Attempt, Finding
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.search.ablation import wrong_offsets
from vlab.diagnose.search.attempt import Trials
from vlab.diagnose.settings import CROSS_VALIDATION
from vlab.diagnose.validation.checked import Checked
from vlab.diagnose.validation.simulation import extended


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
        Attempt with further errors; unchanged where fewer than two fitted recordings excite the effect.
    """
    fitted = trials.on_fitted(attempt.fit, findings_of(attempt.fit))
    exciting = [c.run for c in fitted if any(not part.is_idle for part in c.parts)]
    if len(exciting) < 2:
        return attempt

    def predicted(run: Run) -> Sequence[Checked]:
        rest = leaving_out(whole, run.name)
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


def leaving_out(whole: LeastSquares, recording: str) -> LeastSquares:
    """Return fits without the samples of a recording.

    Parameters
    ----------
    whole : LeastSquares
        Fits to whole runs.
    recording : str
        Name of a fitted recording.

    Returns
    -------
    LeastSquares
        Fits to the other recordings.
    """
    other = copy(whole)
    other.runs = [
        replace(run, valid=np.zeros(run.y.shape, dtype=bool)) if name == recording else run
        for run, name in zip(whole.runs, whole.recordings, strict=True)
    ]
    other.__dict__.pop("weights", None)  # of the samples
    other.free_starts = other.initial_condition_nuisance()
    return other
