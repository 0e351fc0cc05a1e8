"""Data quality of a recording: findings to report, without repairs."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from vlab.recordings.consistency import NEAR, known_factor, mismatches
from vlab.recordings.ticks import even_in_ticks, resolution_of
from vlab.recordings.wraps import wraps
from vlab.signals import Array, Channel, Recording

CLIPPED_RUN = 3
"""CLIPPED_RUN [samples]: fewest equal samples at the extreme value that form a flat top."""
FAST = 3
"""FAST [steps/sample]: speed at both ends of a flat part beyond which the part is no quantised smooth top."""

HELD_RUN = 10
"""HELD_RUN [samples]: shortest standstill of all sensors during motion that counts as a dropped block."""

SAME = 1e-10
"""SAME [1]: value of 1 - |correlation| below which two channels are one signal. The limit corresponds to a relative
difference of 1.4e-5; two sensors differ more."""

USUAL = 0.02
"""USUAL [1]: share of long time steps above which sampling counts as uneven, without gaps."""
COARSE = 0.03
"""COARSE [1]: smallest reported ratio of quantisation step to standard deviation. The quantisation noise,
step/sqrt(12), is then above 1 %."""


@dataclass(frozen=True)
class Finding:
    """A data-quality finding.

    Parameters
    ----------
    channel : str
        The channel, or ``"time"``; empty for all channels.
    kind : str
        ``clipping``, ``constant``, ``duplicate``, ``jitter``, ``gap``, ``held``, ``quantisation``, ``reading``,
        ``units``, ``sign`` or ``wrap``.
    text : str
        Observation, location and amount.
    severity : {"note", "warning"}
        A warning may change a diagnosis.
    """

    channel: str
    kind: str
    text: str
    severity: Literal["note", "warning"]


def findings(recording: Recording) -> tuple[Finding, ...]:
    """Return the data-quality findings of a recording.

    The order is time stamps, channels, pairs of channels.
    """
    with np.errstate(all="ignore"):  # extreme doubles may overflow; an overflow yields no finding
        return tuple(_findings(recording))


def _findings(recording: Recording) -> Iterator[Finding]:
    for text in recording.meta.get("reading", ()):
        yield Finding("", "reading", str(text), "note")
    yield from _time(recording)
    moving = []
    for i, channel in enumerate(recording.channels):
        values = recording.data[:, i]
        if values.min() == values.max():
            text = f"{channel.name} is {values[0]:g} {channel.unit} throughout"
            yield Finding(channel.name, "constant", text, "note" if _drives(channel) else "warning")
            continue
        moving.append(i)
        step = _step(values)
        yield from _clipping(recording, i)
        yield from _quantisation(recording, i, step)
        yield from _wraps(recording, i)
    yield from _held(recording, moving)
    yield from _duplicates(recording, moving)
    yield from _derivatives(recording, moving)


def runs(mask: NDArray[np.bool_]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return start and end of each run of true values.

    The end is one past the last index.
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False]))))
    return edges[::2], edges[1::2]


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _time(recording: Recording) -> Iterator[Finding]:
    steps = np.diff(recording.time)
    usual, long = float(np.median(steps)), long_step(recording.time)
    coarse = even_in_ticks(recording.time)
    if coarse is not None:
        yield Finding("time", "jitter", coarse.advice, "warning")
        return
    gaps = np.flatnonzero(steps > long)
    if gaps.size:
        lost = int(np.sum(np.rint(np.minimum(steps[gaps] / usual, 1e12)) - 1))
        where = f"the first after t = {recording.time[gaps[0]]:g} s"
        text = f"{_count(gaps.size, 'gap')} in the time stamps, about {lost} samples lost, {where}"
        yield Finding("time", "gap", text, "warning")
    regular = steps[steps <= long]
    spread = float(np.ptp(regular)) / usual
    if spread > 1e-4 and np.ptp(regular) > 1.001 * resolution_of(recording.time):  # limit of Recording.is_uniform
        severity: Literal["note", "warning"] = "warning" if spread > 0.05 else "note"
        yield Finding(
            "time",
            "jitter",
            f"the time steps vary from {regular.min():g} to {regular.max():g} s ({100 * spread:.2g} %)",
            severity,
        )


def long_step(time: Array) -> float:
    """Return the shortest time step that counts as a gap.

    The limit is 1.5 times the median step, or 4 times if long steps are frequent.
    """
    steps = np.diff(time)
    usual = float(np.median(steps))
    is_uneven = np.mean(steps > 1.5 * usual) > USUAL
    return (4.0 if is_uneven else 1.5) * usual


def _step(values: Array) -> float:
    """Return the smallest difference between values, beyond rounding."""
    levels = np.diff(np.unique(values))
    levels = levels[levels > 8 * np.spacing(np.abs(values).max())]
    return float(levels.min()) if levels.size else 0.0


def _is_on_grid(values: Array, step: float) -> bool:
    """Return whether values lie on at least three levels of a grid."""
    levels = (np.unique(values) - values.min()) / step
    return bool(levels.size > 2 and np.abs(levels - np.rint(levels)).max() < 0.01)


def quantisation_step(values: Array) -> float | None:
    """Return the step of a sensor's readings.

    Parameters
    ----------
    values : (n,) array
        Readings.

    Returns
    -------
    float or None
        Step [unit of the readings]; None for readings on no grid. The noise of quantisation is ``step / sqrt(12)``.
    """
    step = _step(values) if values.size else 0.0
    return step if step > 0.0 and _is_on_grid(values, step) else None


def _drives(channel: Channel) -> bool:
    return channel.is_input or channel.kind in ("command", "excitation")


def flat_tops(values: Array) -> dict[str, NDArray[np.bool_]]:
    """Return samples at a limit by side (``"lower"``, ``"upper"``).

    A signal enters and leaves a clipped top at speed. A quantised smooth top x = -c k^2/2 that is flat for n >= 3
    samples satisfies c (n/2)^2/2 <= step/2. Its slope at the ends, c n/2, is at most 2 step/n, about one step a sample.
    Three steps a sample therefore indicate clipping. A signal at its extreme value for more than half of the time is at
    rest.

    Parameters
    ----------
    values : array
        Samples of a channel, (n,).

    Returns
    -------
    dict of str to array
        Boolean masks, (n,) each.
    """
    out: dict[str, NDArray[np.bool_]] = {}
    step = _step(values)
    for side, extreme in (("lower", values.min()), ("upper", values.max())):
        at_extreme = values == extreme
        lengths, speeds = _tops(values, at_extreme)
        if np.any((lengths >= CLIPPED_RUN) & (speeds > FAST * step)) and at_extreme.mean() <= 0.5:
            out[side] = at_extreme
    return out


def sticks(values: Array) -> bool:
    """Return whether a motion turns back from rest mostly short of its extremes.

    A joint with dry friction does so; its flat tops are no limit of the sensor. Noise of several steps holds a few equal
    samples by chance, so the larger number of samples decides.

    Parameters
    ----------
    values : array
        Samples of a channel, (n,).

    Returns
    -------
    bool
        Whether the motion sticks.
    """
    lengths, before, after, level = _flats(values, *_constant(values))
    is_fast = np.minimum(np.abs(before), np.abs(after)) > FAST * _step(values)
    is_short = (level > values.min()) & (level < values.max())
    is_turn = (lengths >= CLIPPED_RUN) & is_fast & (before * after < 0)
    return bool(lengths[is_turn & is_short].sum() > lengths[is_turn & ~is_short].sum())


def cut_off(values: Array, at_limit: NDArray[np.bool_]) -> float:
    """Return the estimated overshoot beyond a limit, in steps.

    A parabola with the same duration and end slopes replaces the flat top.
    """
    lengths, speeds = _tops(values, at_limit)
    return float(np.max(0.25 * lengths * speeds, initial=0.0)) / max(_step(values), 1e-300)


def _constant(values: Array) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return start and end of each run of equal values."""
    first, last = runs(np.diff(values) == 0)
    return first, last + 1


def _flats(values: Array, first: NDArray[Any], last: NDArray[Any]) -> tuple[Array, Array, Array, Array]:
    """Return the lengths, end slopes and levels of flat parts.

    Lengths are in samples, slopes before and after per sample. Parts without two samples on either side are left out.
    """
    inside = (first >= 2) & (last + 1 < values.size)
    first, last = first[inside], last[inside]
    before, after = values[first - 1] - values[first - 2], values[last + 1] - values[last]
    return np.asarray(last - first, dtype=float), before, after, values[first]


def _tops(values: Array, at_extreme: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return lengths of flat tops, and the smaller speed of their ends."""
    lengths, before, after, _ = _flats(values, *runs(at_extreme))
    return lengths, np.minimum(np.abs(before), np.abs(after))


EXTREMES = {"upper": "largest value", "lower": "smallest value"}
"""EXTREMES [-]: names of a command's extremes, which are limits or intended."""


def _clipping(recording: Recording, index: int) -> Iterator[Finding]:
    """Yield findings on a channel's limits."""
    channel, values = recording.channels[index], recording.data[:, index]
    for side, at_limit in () if sticks(values) else flat_tops(values).items():
        first, last = runs(at_limit)
        long = last - first >= CLIPPED_RUN
        where = f"stands at its {EXTREMES[side]}" if _drives(channel) else f"stops at its {side} limit of"
        text = (
            f"{channel.name} {where} {values[at_limit][0]:g} {channel.unit} "
            f"{_count(int(long.sum()), 'time')}, up to {int((last - first).max())} samples, "
            f"{100 * at_limit.mean():.2g} % of the samples, first at t = {recording.time[first[long][0]]:g} s"
        )
        # a drive limit is physics that a model may contain; a sensor limit is lost data
        yield Finding(channel.name, "clipping", text, "note" if _drives(channel) else "warning")


def _quantisation(recording: Recording, index: int, step: float) -> Iterator[Finding]:
    """Yield a finding on coarse quantisation."""
    channel, values = recording.channels[index], recording.data[:, index]
    size = float(values.std())
    if step <= COARSE * size:
        return
    if _is_on_grid(values, step):
        share = f"{100 * step / size:.2g} % of its standard deviation"
        text = f"{channel.name} moves in steps of {step:.4g} {channel.unit}, {share}"
        is_coarse = step > 0.3 * size and not _drives(channel)  # a stepped command is intended
        yield Finding(channel.name, "quantisation", text, "warning" if is_coarse else "note")


def _wraps(recording: Recording, index: int) -> Iterator[Finding]:
    """Yield a finding on an angle that jumps by a full turn."""
    channel = recording.channels[index]
    if channel.kind != "angle":
        return
    is_read = recording.is_read(channel.name)
    jumps = wraps(recording.data[is_read, index], is_target=_drives(channel))
    if jumps.size:
        first = recording.time[is_read][jumps[0] + 1]
        text = f"{channel.name} jumps by a full turn {_count(jumps.size, 'time')}, first at t = {first:g} s"
        yield Finding(channel.name, "wrap", text, "warning")


def held_samples(recording: Recording) -> NDArray[np.bool_]:
    """Return a mask of samples lost and replaced by the last value.

    In such a block all sensors stand still and then jump.
    """
    out = np.zeros(len(recording), dtype=bool)
    for first, last in zip(*_held_blocks(recording, _moving(recording)), strict=True):
        out[first + 1 : last + 1] = True
    return out


def _moving(recording: Recording) -> list[int]:
    return [i for i in range(len(recording.channels)) if np.ptp(recording.data[:, i]) > 0]


def _held_blocks(recording: Recording, moving: list[int]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the last good and the last held sample of each block."""
    sensors = [i for i in moving if not recording.channels[i].is_input]
    if not sensors:
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    moves = np.abs(np.diff(recording.data[:, sensors], axis=0))
    first, last = runs(np.max(moves, axis=1) == 0.0)
    inside = (last - first >= HELD_RUN) & (first > 0) & (last < len(moves))
    first, last = first[inside], last[inside]
    usual = np.median(moves, axis=0)
    # an encoder between two steps is constant as well
    least = np.maximum(usual, [_step(recording.data[:, i]) for i in sensors])
    held = (
        (moves[first - 1] > least).any(axis=1) & (moves[last % len(moves)] > 3 * least).any(axis=1) & (usual > 0).any()
    )
    data = recording.data[:, sensors]
    is_clipped = (data[first] == data.min(axis=0)) | (data[first] == data.max(axis=0))
    held &= ~is_clipped.all(axis=1)
    return first[held], last[held]


def _held(recording: Recording, moving: list[int]) -> Iterator[Finding]:
    """Yield findings on held samples."""
    first, last = _held_blocks(recording, moving)
    if first.size:
        longest = int((last - first).max())
        where = f"the first after t = {recording.time[first[0]]:g} s"
        text = f"{_count(first.size, 'block')} of samples repeat the last value, up to {longest} samples, {where}"
        yield Finding("", "held", text, "warning")


def _duplicates(recording: Recording, moving: list[int]) -> Iterator[Finding]:
    """Yield findings on proportional channels."""
    if len(moving) < 2:
        return
    data = recording.data[:, moving]
    centred = data - data.mean(axis=0)
    centred /= np.abs(centred).max(axis=0)
    norms = np.linalg.norm(centred, axis=0)
    correlation = (centred.T @ centred) / np.outer(norms, norms)
    for i, k in zip(*np.nonzero(np.triu(1.0 - np.abs(correlation) < SAME, 1)), strict=True):
        one, other = (recording.channels[moving[j]] for j in (i, k))
        if np.array_equal(data[:, i], data[:, k]):
            text = f"{other.name} has the same samples as {one.name}"
        else:
            factor = correlation[i, k] * np.std(data[:, k]) / np.std(data[:, i])
            mistake = known_factor(factor)
            text = f"{other.name} is {one.name} times {factor:.6g}, offset aside"
            text += f" (as if {mistake})" if mistake else ""
        yield Finding(other.name, "duplicate", text, "note" if _drives(one) or _drives(other) else "warning")


def _derivatives(recording: Recording, moving: list[int]) -> Iterator[Finding]:
    """Yield findings on channels with a wrong derivative ratio."""
    for first, second, ratio in mismatches(recording, moving):
        one, other = recording.channels[first], recording.channels[second]
        order = "second derivative" if "accel" in other.kind and "veloc" not in one.kind else "derivative"
        text = f"{other.name} is {abs(ratio):.3g} times the {order} of {one.name}"
        mistake = known_factor(ratio)
        if abs(abs(ratio) - 1) > 2 * NEAR:
            why = f", as if {mistake}" if mistake else "; no unit that is often mistaken explains it"
            yield Finding(other.name, "units", text + why, "warning" if mistake else "note")
        if ratio < 0:
            yield Finding(
                other.name, "sign", f"{other.name} has the opposite sign of the {order} of {one.name}", "warning"
            )
