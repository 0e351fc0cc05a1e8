"""Stepped sines: detection of steps, their frequencies and responses."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.errors import BadRecording
from vlab.modal.channels import checked_data, response_unit
from vlab.modal.frf import Estimator, MeasuredFrequencyResponse
from vlab.modal.spectra import Spectra, solve
from vlab.signals import Array, ComplexArray, Recording

SLIP = 0.02
"""SLIP [cycles]: deviation of a zero crossing from the prediction of the preceding cycles that ends a step."""
PATIENCE = 3
"""PATIENCE [1]: consecutive deviating crossings that end a step; a single one may be noise."""
SHORTEST = 6
"""SHORTEST [cycles]: shortest step."""
PARTS = 4
"""PARTS [1]: averaged parts of a step; their spread gives noise and coherence."""
SETTLING = 0.5
"""SETTLING [1]: share dropped at the start of each step, for decay of the transient."""


@dataclass(frozen=True, kw_only=True)
class Step:
    """A stretch of constant frequency.

    Parameters
    ----------
    start, stop : int
        First sample, and the one after the last.
    hz : float or None
        Frequency [Hz]; None if still to be estimated from the input.
    drift_hz : float
        Frequency of the second half minus frequency of the first half [Hz].
    """

    start: int
    stop: int
    hz: float | None
    drift_hz: float = 0.0


def find_steps(x: Array, rate: float) -> list[Step]:
    """Return stretches with a sine of constant frequency.

    The upward zero crossings of a steady sine lie on a straight line over their number. The line is followed until
    `PATIENCE` consecutive crossings deviate by more than `SLIP` cycles.

    Parameters
    ----------
    x : array
        Signal, (n,).
    rate : float
        Sample rate [Hz].

    Returns
    -------
    list of Step
        Steps in order.
    """
    t = _crossings(np.asarray(x, dtype=float))
    steps, first = [], 0
    while first < t.size - SHORTEST:
        last = _end_of_line(t, first)
        if last - first >= SHORTEST:
            count = np.arange(last - first + 1)
            period = np.polyfit(count, t[first : last + 1], 1)[0]
            half = count.size // 2
            halves = [
                np.polyfit(count[:half], t[first : last + 1][part], 1)[0] for part in (slice(half), slice(-half, None))
            ]
            drift = rate / halves[1] - rate / halves[0]
            steps.append(Step(start=int(np.ceil(t[first])), stop=int(t[last]) + 1, hz=rate / period, drift_hz=drift))
        first = last + 1
    return steps


def _crossings(x: Array) -> Array:
    """Return upward zero crossings [samples].

    Crossings without a real oscillation between are noise.
    """
    level = 0.3 * np.sqrt(2 * np.mean(x**2))
    state = np.where(x > level, 1, np.where(x < -level, -1, 0))
    known = np.flatnonzero(state)
    if known.size == 0:
        return np.zeros(0)
    rises = np.flatnonzero((state[known[:-1]] < 0) & (state[known[1:]] > 0))
    out = np.empty(rises.size)
    for i, k in enumerate(rises):  # a line through the whole rise is less noisy than one through the samples at zero
        a, b = known[k], known[k + 1]
        n = np.arange(a, b + 1)
        slope, offset = np.polyfit(n, x[a : b + 1], 1)
        out[i] = np.clip(-offset / slope, a, b) if slope > 0 else (a + b) / 2
    return out


def _end_of_line(t: Array, first: int) -> int:
    """Return the last crossing on the line that begins at `first`.

    Running sums keep the cost of a crossing constant.
    """
    n = s_k = s_kk = s_t = s_kt = 0.0
    missed = 0
    origin = t[first]
    for i in range(first, t.size):
        k, value = float(i - first), float(t[i] - origin)
        if n >= 2:
            det = n * s_kk - s_k**2
            slope = (n * s_kt - s_k * s_t) / det
            predicted = (s_t - slope * s_k) / n + slope * k
            missed = missed + 1 if abs(value - predicted) > SLIP * abs(slope) * (3.0 if n < 4 else 1.0) else 0
            if missed >= PATIENCE:
                return i - PATIENCE
            if missed:
                continue
        n, s_k, s_kk, s_t, s_kt = n + 1, s_k + k, s_kk + k * k, s_t + value, s_kt + k * value
    return t.size - 1


def estimate_stepped_frf(
    recording: Recording,
    steps: Sequence[Step],
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    estimator: Estimator = "H1",
    settling: float = SETTLING,
) -> MeasuredFrequencyResponse:
    """Estimate the frequency response from a stepped sine.

    Each step gives one line. The settled part of a step is divided into `PARTS` stretches. In each, a least-squares fit
    of a sine, a constant and a drift gives every channel's amplitude. Stretches therefore need not hold whole cycles.
    The amplitudes are averaged like spectra of segments.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    steps : sequence of Step
        Steps; an unknown frequency is estimated from the first input.
    inputs, outputs : sequence of str
        Channel names; one input.
    estimator : Estimator
        ``"H1"``, ``"H2"`` or ``"Hv"``.
    settling : float
        Share dropped at the start of each step.

    Returns
    -------
    MeasuredFrequencyResponse
        H with coherence and variance.

    Raises
    ------
    BadRecording
        Several inputs, too short steps, or an error of `checked_data`.
    """
    inputs, outputs = tuple(inputs), tuple(outputs)
    if len(inputs) != 1:
        raise BadRecording(
            f"a stepped sine has one input, not {len(inputs)} ({', '.join(inputs)}); test them one by one"
        )
    dt, x, y = checked_data(recording, inputs, outputs, 0.0)
    data = np.hstack([x, y])
    rows = []
    for step in steps:
        begin = step.start + int(np.ceil(settling * (step.stop - step.start)))
        here = slice(begin, step.stop)
        hz = step.hz if step.hz is not None else tone(x[here, 0], dt)
        cycles = (step.stop - begin) * dt * hz
        if cycles < PARTS:
            raise BadRecording(
                f"the step at {hz:g} Hz leaves {cycles:.2g} cycles once {settling:.0%} of it has settled; at least {PARTS} are "
                "needed: dwell longer"
            )
        edges = np.linspace(begin, step.stop, PARTS + 1).astype(int)
        parts = [sines(data[a:b], a * dt, dt, hz) for a, b in itertools.pairwise(edges)]
        rows.append((hz, np.array(parts)))
    rows.sort(key=lambda row: row[0])
    rows = [row for i, row in enumerate(rows) if i == 0 or row[0] > rows[i - 1][0] * (1 + 1e-9)]
    freq = np.array([hz for hz, _ in rows])
    both = np.stack([parts for _, parts in rows], axis=1)
    spectra = Spectra(X=both[:, :, :1], Y=both[:, :, 1:], freq=freq, n_effective=float(PARTS), resolution_hz=0.0)
    H, coherence, variance = solve(spectra, estimator)
    return MeasuredFrequencyResponse(
        freq=freq,
        H=H,
        outputs=outputs,
        inputs=inputs,
        unit=response_unit(recording, inputs, outputs),
        coherence=coherence,
        variance=variance,
        n_averages=float(PARTS),
    )


def sines(data: Array, start_s: float, dt: float, hz: float) -> ComplexArray:
    """Return the complex amplitude of a sine in each column.

    A constant and a drift are fitted together with the sine.

    Parameters
    ----------
    data : (n, n_channels) array
        Samples.
    start_s : float
        Time of the first sample [s], the reference of the phase.
    dt : float
        Time step [s].
    hz : float
        Frequency [Hz].

    Returns
    -------
    complex array
        Amplitudes, (n_channels,).
    """
    t = start_s + dt * np.arange(len(data))
    turn = 2 * np.pi * hz * t
    basis = np.stack([np.cos(turn), np.sin(turn), np.ones(len(t)), np.linspace(-1, 1, len(t))], axis=1)
    fitted = np.linalg.lstsq(basis, data, rcond=None)[0]
    return np.asarray(fitted[0] - 1j * fitted[1])


def tone(x: Array, dt: float) -> float:
    """Return the frequency of the strongest sine [Hz].

    The phase change between the halves refines the spectral peak.

    Parameters
    ----------
    x : array
        Signal, (n,).
    dt : float
        Time step [s].

    Returns
    -------
    float
        Frequency [Hz].
    """
    size = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x))))
    hz = float((np.argmax(size[1:]) + 1) / (len(x) * dt))
    half = len(x) // 2
    for _ in range(4):
        early, late = (sines(x[a : a + half, None], a * dt, dt, hz)[0] for a in (0, half))
        hz += float(np.angle(late * np.conj(early)) / (2 * np.pi * half * dt))
    return hz


def merged(responses: Sequence[MeasuredFrequencyResponse]) -> MeasuredFrequencyResponse:
    """Return responses at different lines as one.

    The function joins a sweep and its zooms; repeated lines are dropped.

    Parameters
    ----------
    responses : sequence of MeasuredFrequencyResponse
        Responses of the same channels.

    Returns
    -------
    MeasuredFrequencyResponse
        Response with ascending lines.
    """
    freq = np.concatenate([f.freq for f in responses])
    order = np.argsort(freq, kind="stable")
    order = order[np.concatenate([[True], np.diff(freq[order]) > 1e-9 * freq[order][1:]])]
    parts = {name: [getattr(f, name) for f in responses] for name in ("H", "coherence", "variance")}
    joined = {k: np.concatenate(v)[order] if all(p is not None for p in v) else None for k, v in parts.items()}
    return replace(responses[0], freq=freq[order], **joined)  # type: ignore[arg-type]
