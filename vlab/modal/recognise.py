"""Recognition of the excitation of a recording.

The recording's notes precede the samples.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from vlab.errors import BadRecording
from vlab.modal.steps import Step, find_steps
from vlab.signals import Array, Recording

SignalKind = Literal["random", "periodic", "burst", "stepped", "impact", "dwell", "free", "ambient"]
FREE_KINDS = ("free", "ambient")
"""Names of the excitations without a recorded input: a release, and unknown broadband forces."""
KINDS: tuple[str, ...] = get_args(SignalKind)
"""Names of the excitations."""

REST_LEVEL, REST_SHARE = 0.05, 0.95
"""REST_LEVEL [1]: level relative to the peak below which an input is at rest.
REST_SHARE [1]: smallest share of time at rest of a hammer's input."""
STEADY_SHARE = 0.6
"""STEADY_SHARE [1]: smallest share of time with constant frequency of a stepped sine."""
LEAST_STEP, MOST_STEPS = 10, 5000
"""LEAST_STEP [samples]: shortest plausible step.
MOST_STEPS [1]: largest plausible number of steps."""
DRIFT = 0.2
"""DRIFT [1]: frequency change within a step, relative to the change between steps, above which a sine sweeps
continuously."""


@dataclass(frozen=True, kw_only=True)
class Signal:
    """Excitation of a recording.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    period_s, block_s : float or None
        Period of a periodic signal, block length of bursts [s].
    steps : tuple of Step
        Steps of a stepped sine, or the single step of a dwell.
    drive_s : float or None
        Stop time of a dwell's forces [s after the first sample].
    is_recognised : bool
        Whether the samples determined the kind, instead of the recording's notes or the user.
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
    """Return the excitation of a recording.

    Arguments precede the recording's notes, and notes precede the samples.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    input : str
        Evaluated input channel.
    kind : str or None
        Kind of `KINDS`, if known.
    period_s, segment_s, dwell_s : float or None
        Period of a periodic signal, length of segments or bursts, duration of each step of a stepped sine [s].

    Returns
    -------
    Signal
        Excitation.

    Raises
    ------
    BadRecording
        The kind is unknown, or its period, block or steps are neither given nor found.
    """
    if kind is not None and kind not in KINDS:
        raise BadRecording(f"unknown signal {kind!r} (accepted: {', '.join(KINDS)})")
    meta = recording.meta
    said = kind or ("periodic" if period_s is not None else "stepped" if dwell_s is not None else None)
    noted = meta.get("signal", "periodic" if meta.get("period_s") is not None else None)
    said = said or (noted if noted in KINDS else None)
    if segment_s is not None and kind is None and said not in ("burst", "impact"):  # implies random data
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
    """Return the excitation that the samples resemble.

    The default is random noise.
    """
    x = recording[input] - np.median(recording[input])
    peak = np.abs(x).max()
    if peak == 0:
        return Signal(kind="random")  # a later check refuses a constant input
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
        return Signal(kind="random", is_recognised=True)  # a sweep: the frequency never stands still
    return Signal(kind="stepped", steps=tuple(steps), is_recognised=True)


def _driven_until(x: Array) -> int:
    """Return the number of samples up to the end of the drive."""
    loud = np.flatnonzero(np.abs(x) > REST_LEVEL * np.abs(x).max())
    return int(loud[-1]) + 1 if loud.size else len(x)
