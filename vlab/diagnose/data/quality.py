"""Data quality: fatal defects of recordings, and the mask of informative samples.

Defects found by `vlab.recordings.quality` are reported and never repaired. Lost samples and samples at a sensor limit
are masked. A recording without enough informative samples, a dead sensor or a duplicate sensor gives the verdict
``bad-recording``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vlab.cases.channel_map import Compared, Run, compared_names
from vlab.cases.checks import FileCheck
from vlab.diagnose.settings import QUALITY
from vlab.recordings.quality import cut_off, findings, flat_tops, held_samples, long_step, sticks
from vlab.signals import Array, sample_period

DAMAGING = ("duplicate", "gap", "held", "quantisation", "sign", "units")
"""Kinds of warnings that can explain a residual. Limits are masked, uneven samples are compared at their own times, and
a constant sensor may be correct in one recording."""


@dataclass(frozen=True, kw_only=True)
class DataQuality:
    """Defects of a case's recordings.

    Parameters
    ----------
    fatal : tuple of str
        Defects that preclude a diagnosis.
    warnings : tuple of str
        Defects that may have changed the diagnosis.
    notes : tuple of str
        Further observations.
    since : mapping of str to float
        Time by recording from which a warning may explain a residual [s]; other recordings have none.
    """

    fatal: tuple[str, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    since: Mapping[str, float] = field(default_factory=dict)

    @property
    def lines(self) -> tuple[str, ...]:
        """All messages, the worst first."""
        return (*self.fatal, *self.warnings, *self.notes)


@dataclass(frozen=True, kw_only=True)
class SensorLimit:
    """Range limit of a sensor.

    Parameters
    ----------
    channel : str
        Channel.
    limit : float
        Largest magnitude [SI unit of the channel].
    share : float
        Share of all samples at the limit.
    tops : int
        Number of flat upper and lower ends at exactly that magnitude.
    beyond : float
        Extrapolated excess over the limit [quantisation steps].
    """

    channel: str
    limit: float
    share: float
    tops: int
    beyond: float


def assess_quality(runs: Sequence[Run], fitted: Sequence[Run] = (), file: FileCheck | None = None) -> DataQuality:
    """Assess the recordings of a case.

    Parameters
    ----------
    runs : sequence of Run
        All recordings.
    fitted : sequence of Run
        Recordings of the fit, in which every sensor must move; all by default.
    file : FileCheck, optional
        Findings on the case description.

    Returns
    -------
    DataQuality
        Defects, warnings and notes.
    """
    warnings = [] if file is None else list(file.of("warning"))
    notes = [] if file is None else list(file.of("note"))
    since = {run.name: -np.inf for run in runs} if warnings else {}
    for run in runs:
        for finding in findings(run.measured):
            is_damage = finding.severity == "warning" and finding.kind in DAMAGING
            (warnings if is_damage else notes).append(f"{run.name}: {finding.text}")
            if is_damage:
                first = _first_gap(run.measured.time) if finding.kind == "gap" else -np.inf
                since[run.name] = min(first, since.get(run.name, np.inf))
    lost = float(np.mean(np.concatenate([~_kept(run) for run in runs])))
    fatal = [f"{100 * lost:.0f} % of the samples are lost"] if lost > QUALITY.most_lost else []
    return DataQuality(
        fatal=(*fatal, *_dead(fitted or runs), *_copies(runs)),
        warnings=tuple(warnings),
        notes=tuple(notes),
        since=since,
    )


def _first_gap(time: Array) -> float:
    """Return the time of the last sample before the first gap [s]."""
    return float(time[np.argmax(np.diff(time) > long_step(time))])


def sensor_limits(runs: Sequence[Run], held_out: Sequence[Run] = ()) -> tuple[SensorLimit, ...]:
    """Identify range limits of sensors, common to all runs.

    A machine that pauses at its farthest pose looks like a limit, until it goes farther.

    Parameters
    ----------
    runs : sequence of Run
        Recordings.
    held_out : sequence of Run
        Hold-out recordings, which refute a limit that they exceed.

    Returns
    -------
    tuple of SensorLimit
        Limits.
    """
    out = []
    for channel in compared_names(runs):
        moving = [run for run in runs if not sticks(run.measured[channel])]
        tops = [(run, at) for run in moving for at in flat_tops(run.measured[channel]).values()]
        if not tops:
            continue
        sizes = np.array([abs(float(run.measured[channel][at][0])) for run, at in tops])
        counts = np.array([np.count_nonzero(at) for _, at in tops])
        limit = float(sizes.max())
        at_limit = counts[sizes >= QUALITY.same_limit * limit].sum()
        measured = [run.measured for run in (*runs, *held_out) if channel in run.measured.names]
        largest = max(float(np.abs(m[channel][m.is_read(channel)]).max(initial=0.0)) for m in measured)
        # no sample exceeds a range limit; coarse quantisation is flat at the top of a small motion as well
        if at_limit >= QUALITY.most_at_limit * counts.sum() and largest <= QUALITY.over_limit * limit:
            reached = [np.abs(run.measured[channel]) >= limit * (1 - 1e-9) for run in runs]
            share, same = float(np.mean(np.concatenate(reached))), int(np.count_nonzero(sizes >= limit * (1 - 1e-9)))
            beyond = max(cut_off(run.measured[channel], at) for run, at in tops)
            out.append(SensorLimit(channel=channel, limit=limit, share=share, tops=same, beyond=beyond))
    return tuple(out)


def is_informative(run: Run, compared: Sequence[Compared]) -> NDArray[np.bool_]:
    """Return the mask of informative samples of compared channels.

    Parameters
    ----------
    run : Run
        Recording.
    compared : sequence of Compared
        Channels.

    Returns
    -------
    (n_samples, n_channels) array of bool
        False for lost samples and samples at a sensor limit.
    """
    if run.valid is not None:
        return run.valid[:, [run.measured.index(c.channel) for c in compared]]
    out = np.repeat(_kept(run)[:, None], len(compared), axis=1)
    for i, c in enumerate(compared):
        out[:, i] &= run.measured.is_read(c.channel)
        for at_limit in flat_tops(run.measured[c.channel]).values():
            out[:, i] &= ~at_limit
    return out


def marked(run: Run) -> Run:
    """Return a run that stores its mask of informative samples.

    The mask survives later changes of the values.
    """
    valid = np.ones(run.measured.data.shape, dtype=bool)
    valid[:, [run.measured.index(c.channel) for c in run.compared]] = is_informative(run, run.compared)
    return replace(run, valid=valid)


def on_clock(run: Run, valid: NDArray[np.bool_], grid: Array) -> NDArray[np.bool_]:
    """Return the mask of informative samples on another clock.

    Parameters
    ----------
    run : Run
        Recording.
    valid : (n_samples, n_channels) array of bool
        Mask of the recorded samples.
    grid : (n,) array
        Times of the clock [s].

    Returns
    -------
    (n, n_channels) array of bool
        False near masked samples and inside gaps.
    """
    time = run.measured.time - run.measured.time[0]
    h, step = sample_period(time), sample_period(grid)
    reach = max(h, step)
    count = np.vstack([np.zeros((1, valid.shape[1])), np.cumsum(~valid, axis=0)])
    first = np.searchsorted(time, grid - QUALITY.reach * reach)
    last = np.searchsorted(time, grid + QUALITY.reach * reach, side="right")
    whole = count[last] - count[first] == 0
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    bridged = time[after] - time[after - 1] > long_step(time)
    return np.asarray(whole & ~bridged[:, None] & (last > first)[:, None])


def _kept(run: Run) -> NDArray[np.bool_]:
    """Return the mask of samples that do not repeat a held value."""
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
