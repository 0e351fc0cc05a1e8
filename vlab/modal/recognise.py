"""What kind of signal excited a recording: as the recording says, or as its input looks."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from vlab.errors import BadRecording
from vlab.modal.steps import Step, find_steps
from vlab.signals import Array, Recording

SignalKind = Literal["random", "periodic", "burst", "stepped", "impact", "dwell"]
KINDS: tuple[str, ...] = get_args(SignalKind)

REST_LEVEL, REST_SHARE = 0.05, 0.95
"""An input that is below this part of its peak for more than this share of the time is one of blows."""
STEADY_SHARE = 0.6
"""A sine in steps has a frequency that stands for at least this share of the time."""
LEAST_STEP, MOST_STEPS = 10, 5000
"""Samples of a step, and steps of a recording, below and above which a given dwell is a slip of the pen."""
DRIFT = 0.2
"""Change of frequency within a step, relative to that between steps, above which the sine slides and has no steps."""


@dataclass(frozen=True, kw_only=True)
class Signal:
    """What a modal test is to make of a recording.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    period_s, block_s : float or None
        Of a periodic signal, of bursts.
    steps : tuple of Step
        Of a stepped sine, or the one of a dwell.
    drive_s : float or None
        When the forces of a dwell stopped [s after the first sample].
    is_recognised : bool
        Whether the kind was told from the samples rather than said by the recording or its user.
    """

    kind: str
    period_s: float | None = None
    block_s: float | None = None
    steps: tuple[Step, ...] = ()
    drive_s: float | None = None
    is_recognised: bool = False


def signal_of(
    recording: Recording,
    input: str,
    *,
    kind: str | None = None,
    period_s: float | None = None,
    segment_s: float | None = None,
    dwell_s: float | None = None,
) -> Signal:
    """Return the signal of a recording's input: what is given counts first, then what the recording says, then its samples.

    Parameters
    ----------
    input : str
        The channel that is looked at.
    kind : str or None
        One of `KINDS`, where it is known.
    period_s, segment_s, dwell_s : float or None
        Of a periodic signal, of segments or bursts, of each step of a stepped sine.

    Raises
    ------
    BadRecording
        An unknown kind, or one whose period, block or steps are neither given nor found.
    """
    if kind is not None and kind not in KINDS:
        raise BadRecording(f"unknown signal {kind!r} (accepted: {', '.join(KINDS)})")
    meta = recording.meta
    said = kind or ("periodic" if period_s is not None else "stepped" if dwell_s is not None else None)
    noted = meta.get("signal", "periodic" if meta.get("period_s") is not None else None)
    said = said or (noted if noted in KINDS else None)
    if segment_s is not None and kind is None and said not in ("burst", "impact"):  # asks for segments of that length
        found = _recognised(recording, input) if said is None else None
        return found if found is not None and found.kind == "impact" else Signal(kind="random")
    if said == "periodic":
        period = period_s if period_s is not None else meta.get("period_s")
        if period is None:
            raise BadRecording("a periodic signal needs its period; give --period in s")
        return Signal(kind="periodic", period_s=float(period))
    if said == "burst":
        block = segment_s if segment_s is not None else meta.get("block_s")
        if block is None:
            raise BadRecording("bursts need the length of their blocks; give --segment in s")
        return Signal(kind="burst", block_s=float(block))
    if said in ("stepped", "dwell"):
        return _sine(recording, input, said, dwell_s)
    return Signal(kind=said) if said is not None else _recognised(recording, input)


def _sine(recording: Recording, input: str, kind: str, dwell_s: float | None) -> Signal:
    meta, x, length = recording.meta, recording[input], len(recording) / recording.rate
    if kind == "dwell":
        noted = meta.get("drive_s")
        stop, end = (_driven_until(x) / recording.rate, 0.99 * length) if noted is None else (float(noted), length)
        drive = None if stop >= end else stop
        found = find_steps(x[: None if drive is None else round(drive * recording.rate)], recording.rate)
        hz = meta.get("dwell_hz", None if not found else max(found, key=lambda s: s.stop - s.start).hz)
        if hz is None:
            raise BadRecording(f"no sine stands still in {input!r}; is it a dwell?")
        whole = Step(start=0, stop=round((drive or length) * recording.rate), hz=float(hz))
        return Signal(kind="dwell", steps=(whole,), drive_s=drive)
    if dwell_s is not None:
        if dwell_s * recording.rate < LEAST_STEP or length / dwell_s > MOST_STEPS:
            raise BadRecording(
                f"steps of {dwell_s:g} s in a recording of {length:g} s at {recording.rate:g} Hz are no steps of a sine; accepted: "
                f"at least {LEAST_STEP} samples a step and at most {MOST_STEPS} steps"
            )
        edges = np.arange(0.0, length + 1e-9, dwell_s)
        pairs = zip(edges[:-1], edges[1:], [None] * (len(edges) - 1), strict=True)
    elif "step_hz" in meta and "step_s" in meta:
        edges = np.concatenate([[0.0], np.cumsum(meta["step_s"])])
        pairs = zip(edges[:-1], edges[1:], meta["step_hz"], strict=True)
    else:
        steps = find_steps(x, recording.rate)
        if len(steps) < 2:
            raise BadRecording(f"no steps of frequency are found in {input!r}; give the time of each with --dwell")
        return Signal(kind="stepped", steps=tuple(steps), is_recognised=True)
    steps = [
        Step(start=round(a * recording.rate), stop=round(b * recording.rate), hz=hz)
        for a, b, hz in pairs
        if b <= length + 0.5 / recording.rate
    ]
    if not steps:
        raise BadRecording(f"the recording of {length:g} s holds no whole step; record longer or give --dwell")
    return Signal(kind="stepped", steps=tuple(steps))


def _recognised(recording: Recording, input: str) -> Signal:
    """Return what the samples look like; random noise where they look like nothing else."""
    x = recording[input] - np.median(recording[input])
    peak = np.abs(x).max()
    if peak == 0:
        return Signal(kind="random")  # refused later, as constant
    if np.mean(np.abs(x) < REST_LEVEL * peak) > REST_SHARE:
        return Signal(kind="impact", is_recognised=True)
    stop = _driven_until(x)
    steps = find_steps(x[:stop], recording.rate)
    share = sum(s.stop - s.start for s in steps) / stop
    if share < STEADY_SHARE:
        return Signal(kind="random", is_recognised=True)
    if len(steps) == 1:
        return Signal(
            kind="dwell",
            steps=tuple(steps),
            drive_s=None if stop > 0.99 * len(x) else stop / recording.rate,
            is_recognised=True,
        )
    hz = np.array([s.hz for s in steps])
    within = np.array([s.drift_hz for s in steps])
    if np.median(np.abs(within)) > DRIFT * np.median(np.abs(np.diff(hz))):
        return Signal(kind="random", is_recognised=True)  # a sweep: its frequency never stands still
    return Signal(kind="stepped", steps=tuple(steps), is_recognised=True)


def _driven_until(x: Array) -> int:
    """Return the number of samples up to the last one that is not nearly zero."""
    loud = np.flatnonzero(np.abs(x) > REST_LEVEL * np.abs(x).max())
    return int(loud[-1]) + 1 if loud.size else len(x)
