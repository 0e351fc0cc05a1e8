"""Horizon of prediction: parts of a recording, each predicted alone.

The simulation of an unstable, chaotic or lightly damped system departs from the recording after some time, with the true
law as well. A recording that no model predicts as a whole is therefore cut into halves, quarters and so on. Every part
starts from a state that is estimated in the same way for every model. The longest parts that some model predicts count.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vlab.cases.channel_map import Run
from vlab.diagnose.settings import VALIDATION
from vlab.signals import Recording, strung_together


def parts_of(run: Run, count: int) -> list[Run]:
    """Cut a recording into parts of equal length.

    Parameters
    ----------
    run : Run
        Recording with mapped channels.
    count : int
        Number of parts.

    Returns
    -------
    list of Run
        Parts in order. All but the first start from an estimated state.
    """
    if count == 1:
        return [run]
    out = []
    for index in np.array_split(np.arange(len(run.measured)), count):
        start, stop = int(index[0]), int(index[-1]) + 1
        out.append(
            replace(
                run,
                measured=run.measured.rows(slice(start, stop)),
                before=_before(run, start),
                initial=run.initial if start == 0 else "estimated",
                start=run.start if start == 0 else None,
                valid=None if run.valid is None else run.valid[start:stop],
            )
        )
    return out


def _before(run: Run, start: int) -> Recording | None:
    """Return the samples of the file before a part."""
    if start == 0:
        return run.before
    own = run.measured.rows(slice(0, start))
    return own if run.before is None else strung_together([run.before, own])


def can_be_halved(run: Run, count: int) -> bool:
    """Return whether a recording in some parts may be cut further.

    Parameters
    ----------
    run : Run
        Recording.
    count : int
        Present number of parts.

    Returns
    -------
    bool
        Whether twice as many parts are long enough.
    """
    return len(run.measured) >= 2 * count * VALIDATION.least_part


def is_predicted(errors: Sequence[float], noise: float) -> bool:
    """Return whether some model explains half of the variance beyond the noise.

    Parameters
    ----------
    errors : sequence of float
        Errors of the models over the rms of the recording; NaN without a model.
    noise : float
        Noise over the rms of the recording.

    Returns
    -------
    bool
        Whether the recording is predicted, or noise alone.
    """
    least = float(np.nanmin(errors))
    return noise >= 1.0 or least**2 - noise**2 < 0.5 * (1.0 - noise**2)


def parts_within(run: Run, horizon_s: float) -> int:
    """Return the number of equal parts within a horizon.

    Parameters
    ----------
    run : Run
        Recording.
    horizon_s : float
        Longest part [s].

    Returns
    -------
    int
        Number of parts, each long enough for a state of its own.
    """
    span = float(run.measured.time[-1] - run.measured.time[0])
    return max(1, min(round(span / horizon_s), len(run.measured) // VALIDATION.least_part))


def length_of_parts(run: Run, count: int) -> float:
    """Return the length of a part [s]; infinite for an uncut recording."""
    return np.inf if count == 1 else float(run.measured.time[-1] - run.measured.time[0]) / count
