"""Damage to recordings before any model is asked: what makes them useless, and the samples that say nothing.

What `vlab.recordings.quality` finds is reported and never mended. Samples that were lost (gaps in the time stamps, blocks that
repeat the last value) or stand at a sensor's limit are left out of the search; a recording that holds little else, a sensor
that is dead or a copy of another one makes the verdict ``bad-recording``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vlab.cases.channel_map import Compared, Run, compared_names
from vlab.cases.checks import FileCheck
from vlab.diagnose.settings import QUALITY
from vlab.recordings.quality import cut_off, findings, flat_tops, held_samples, long_step
from vlab.signals import Array

DAMAGING = ("duplicate", "gap", "held", "quantisation", "sign", "units")
"""Kinds of warnings that may be why a recording is not explained. Samples at a limit are left out and said; uneven samples are
compared at their own times; a sensor that stands still in one recording may be right."""


@dataclass(frozen=True, kw_only=True)
class DataQuality:
    """What is wrong with the recordings of a case.

    Parameters
    ----------
    fatal : tuple of str
        Why nothing can be said of the model; empty where something can.
    warnings : tuple of str
        What may have changed the diagnosis.
    notes : tuple of str
        What else was seen.
    """

    fatal: tuple[str, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def lines(self) -> tuple[str, ...]:
        """All of it, the worst first."""
        return (*self.fatal, *self.warnings, *self.notes)


@dataclass(frozen=True, kw_only=True)
class SensorLimit:
    """A limit at which a sensor stops.

    Parameters
    ----------
    channel : str
        Its name.
    limit : float
        Largest magnitude [SI unit of the channel].
    share : float
        Of the samples of all recordings that stand there.
    tops : int
        Lower and upper ends of recordings that stand at exactly that magnitude.
    beyond : float
        How far the signal would have gone beyond it, in steps of its readings.
    """

    channel: str
    limit: float
    share: float
    tops: int
    beyond: float


def assess_quality(runs: Sequence[Run], fitted: Sequence[Run] = (), file: FileCheck | None = None) -> DataQuality:
    """Say what is wrong with some runs.

    Parameters
    ----------
    fitted : sequence of Run
        Those of them that the model is fitted to, in which every sensor must move; all by default.
    file : FileCheck, optional
        What is wrong with what their case says of them.
    """
    warnings = [] if file is None else list(file.of("warning"))
    notes = [] if file is None else list(file.of("note"))
    for run in runs:
        for finding in findings(run.measured):
            is_damage = finding.severity == "warning" and finding.kind in DAMAGING
            (warnings if is_damage else notes).append(f"{run.name}: {finding.text}")
    lost = float(np.mean(np.concatenate([~_kept(run) for run in runs])))
    fatal = [f"{100 * lost:.0f} % of the samples are lost"] if lost > QUALITY.most_lost else []
    return DataQuality(
        fatal=(*fatal, *_dead(fitted or runs), *_copies(runs)), warnings=tuple(warnings), notes=tuple(notes)
    )


def sensor_limits(runs: Sequence[Run]) -> tuple[SensorLimit, ...]:
    """Return the limits that sensors stop at, the same in all runs that reach them."""
    out = []
    for channel in compared_names(runs):
        tops = [(run, at) for run in runs for at in flat_tops(run.measured[channel]).values()]
        if not tops:
            continue
        sizes = np.array([abs(float(run.measured[channel][at][0])) for run, at in tops])
        counts = np.array([np.count_nonzero(at) for _, at in tops])
        limit = float(sizes.max())
        at_limit = counts[sizes >= 0.99 * limit].sum()
        largest = max(float(np.abs(run.measured[channel]).max()) for run in runs)
        # nothing ever goes beyond the end of a range; a coarse reading may stand still at the top of a small motion as well
        if at_limit >= QUALITY.most_at_limit * counts.sum() and largest <= 1.01 * limit:
            reached = [np.abs(run.measured[channel]) >= limit * (1 - 1e-9) for run in runs]
            share, same = float(np.mean(np.concatenate(reached))), int(np.count_nonzero(sizes >= limit * (1 - 1e-9)))
            beyond = max(cut_off(run.measured[channel], at) for run, at in tops)
            out.append(SensorLimit(channel=channel, limit=limit, share=share, tops=same, beyond=beyond))
    return tuple(out)


def is_informative(run: Run, compared: Sequence[Compared]) -> NDArray[np.bool_]:
    """Return which samples of which compared channels say something of the structure, (n_samples, n_channels)."""
    if run.valid is not None:
        return run.valid[:, [run.measured.index(c.channel) for c in compared]]
    out = np.repeat(_kept(run)[:, None], len(compared), axis=1)
    for i, c in enumerate(compared):
        for at_limit in flat_tops(run.measured[c.channel]).values():
            out[:, i] &= ~at_limit
    return out


def marked(run: Run) -> Run:
    """Return a run that knows which of its samples say something, whatever is done to their values."""
    valid = np.ones(run.measured.data.shape, dtype=bool)
    valid[:, [run.measured.index(c.channel) for c in run.compared]] = is_informative(run, run.compared)
    return replace(run, valid=valid)


def on_clock(run: Run, valid: NDArray[np.bool_], grid: Array) -> NDArray[np.bool_]:
    """Return which samples of a clock stand on samples that say something, (n, n_channels); between lost ones none does."""
    time = run.measured.time - run.measured.time[0]
    h, step = float(np.median(np.diff(time))), float(np.median(np.diff(grid)))
    reach = max(h, step)
    count = np.vstack([np.zeros((1, valid.shape[1])), np.cumsum(~valid, axis=0)])
    first = np.searchsorted(time, grid - 1.01 * reach)
    last = np.searchsorted(time, grid + 1.01 * reach, side="right")
    whole = count[last] - count[first] == 0
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    bridged = time[after] - time[after - 1] > long_step(time)
    return np.asarray(whole & ~bridged[:, None] & (last > first)[:, None])


def _kept(run: Run) -> NDArray[np.bool_]:
    """Return which samples were not lost and filled by the last value."""
    return ~held_samples(run.measured)


def _dead(runs: Sequence[Run]) -> list[str]:
    moves = {
        c: any(np.ptp(run.measured[c]) > 0 for run in runs if c in run.measured.names) for c in compared_names(runs)
    }
    if not any(moves.values()):
        return ["no sensor moves in any recording to fit"]
    return [f"{channel} stands still in every recording to fit" for channel, moving in moves.items() if not moving]


def _copies(runs: Sequence[Run]) -> list[str]:
    names = compared_names(runs)
    out = []
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            both = [run.measured for run in runs if {one, other} <= set(run.measured.names)]
            if both and all(np.array_equal(m[one], m[other]) and np.ptp(m[one]) > 0 for m in both):
                out.append(f"{other} holds the same samples as {one}")
    return out
