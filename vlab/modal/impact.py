"""Hammer tests: detection of blows, exclusion of double hits, exponential windows.

The window's known damping is removed from the poles.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.errors import BadRecording
from vlab.modal.channels import checked_data, response_unit
from vlab.modal.frf import Estimator, MeasuredFrequencyResponse
from vlab.modal.poles import PoleEstimate
from vlab.modal.spectra import Spectra, solve
from vlab.signals import Array, Recording

THRESHOLD = 0.1
"""THRESHOLD [1]: smallest force of a blow relative to the largest."""
EDGE = 0.01
"""EDGE [1]: end of a blow as a share of its own peak."""
PRETRIGGER = 0.002
"""PRETRIGGER [1]: share of a block before the blow."""
END_LEVEL = 0.05
"""END_LEVEL [1]: value of the exponential window at the end of a block; customary values are 0.01 to 0.05."""
USABLE = 1e-2
"""USABLE [1]: smallest used force power relative to the largest line, 20 dB as customary for hammers."""


@dataclass(frozen=True, kw_only=True)
class Blow:
    """A blow with its first sample and end.

    `count` is the number of pulses until the next blow.
    """

    start: int
    stop: int
    count: int = 1


def find_blows(force: Array, rate: float, *, block_s: float | None = None) -> list[Blow]:
    """Return the blows in a force signal.

    The resting value must be zero. A pulse within a block of the preceding one is its double hit. Without `block_s`,
    pulses within a twentieth of the median interval count as one blow.

    Parameters
    ----------
    force : array
        Force samples, (n,).
    rate : float
        Sample rate [Hz].
    block_s : float or None
        Length of a block [s].

    Returns
    -------
    list of Blow
        Blows in order.
    """
    size = np.abs(force)
    loud = size > THRESHOLD * size.max()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], loud, [False]]).astype(int)))
    pulses = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    starts = np.array([a for a, _ in pulses])
    near = block_s * rate if block_s is not None else 0.05 * np.max(np.diff(starts), initial=0.0)
    blows: list[Blow] = []
    for a, b in pulses:
        begin, end = _feet(size, a, b)
        if blows and a - blows[-1].start < near:
            previous = blows[-1]
            touching = begin <= previous.stop  # one pulse with a dent is no double hit
            blows[-1] = replace(previous, stop=max(end, previous.stop), count=previous.count + (not touching))
        else:
            blows.append(Blow(start=begin, stop=end))
    return blows


def _feet(size: Array, a: int, b: int) -> tuple[int, int]:
    """Widen a pulse to its crossings of the floor."""
    floor = EDGE * size[a:b].max()
    while a > 0 and size[a - 1] > floor:
        a -= 1
    while b < len(size) and size[b] > floor:
        b += 1
    return a, b


def estimate_impact_frf(
    recording: Recording,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    estimator: Estimator = "H1",
    block_s: float | None = None,
    end_level: float = END_LEVEL,
) -> MeasuredFrequencyResponse:
    """Estimate the frequency response from hammer blows.

    A rectangular window cuts the force to its pulse. The same exponential multiplies force and response, so that the
    response ends within the block. H is then exact at s = added_decay + j omega, and `without_added_decay` removes the
    window's damping from the poles [1]_. Blocks with a double hit are dropped.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    inputs, outputs : sequence of str
        Channel names; one input.
    estimator : Estimator
        ``"H1"``, ``"H2"`` or ``"Hv"``.
    block_s : float or None
        Length of a block [s]; the shortest interval between blows by default.
    end_level : float
        Value of the exponential window at the end of a block, in (0, 1]; 1 for no window.

    Returns
    -------
    MeasuredFrequencyResponse
        H with coherence and variance.

    Raises
    ------
    BadRecording
        Several inputs, no blow, double hits only, or blocks without response.

    References
    ----------
    .. [1] A. Brandt, *Noise and Vibration Analysis*, Wiley, 2011, chapter 13.
    """
    inputs, outputs = tuple(inputs), tuple(outputs)
    if len(inputs) != 1:
        raise BadRecording(
            f"a hammer test has one input, not {len(inputs)} ({', '.join(inputs)}); test them one by one"
        )
    if not 0 < end_level <= 1:
        raise BadRecording(f"the exponential window leaves {end_level:g} at its end; accepted: above 0 up to 1")
    dt, x, y = checked_data(recording, inputs, outputs, 0.0)
    force, motion = x[:, 0] - np.median(x[:, 0]), y - np.mean(y, axis=0)
    blows = find_blows(force, 1 / dt, block_s=block_s)
    length = _block_length(blows, len(force), dt, block_s)
    lead = min(int(PRETRIGGER * length), *(blow.start for blow in blows))
    whole = [b for b in blows if b.start - lead + length <= len(force)]
    used = [b for b in whole if b.count == 1]
    if not used:
        what = f"all {len(whole)} of them are doubled" if whole else "none leaves a whole block"
        raise BadRecording(
            f"{len(blows)} blows were found in {inputs[0]!r} and {what}; strike once a block, or give --segment"
        )
    decay = -np.log(end_level) / (length * dt)
    X, Y = _cut(force, motion, used, lead, length)
    window = np.exp(-decay * dt * (np.arange(length) - lead))
    X, Y = X * window[:, None], Y * window[:, None]
    power = np.mean(np.abs(np.fft.rfft(X[:, :, 0], axis=1)) ** 2, axis=0)
    keep = power > USABLE * power.max()
    keep[0] = False
    spectra = Spectra(
        X=np.fft.rfft(X, axis=1),
        Y=np.fft.rfft(Y, axis=1),
        freq=np.arange(length // 2 + 1) / (length * dt),
        n_effective=float(len(used)),
        resolution_hz=decay / np.pi,  # half-power width of any pole under the window
    ).at(keep)
    H, coherence, variance = solve(spectra, estimator)
    is_single = len(used) < 2  # a single blow is coherent whatever the noise
    return MeasuredFrequencyResponse(
        freq=spectra.freq,
        H=H,
        outputs=outputs,
        inputs=inputs,
        unit=response_unit(recording, inputs, outputs),
        coherence=None if is_single else coherence,
        variance=None if is_single else variance,
        n_averages=float(len(used)),
        resolution_hz=spectra.resolution_hz,
        added_decay=decay,
    )


def _cut(force: Array, motion: Array, blows: Sequence[Blow], lead: int, length: int) -> tuple[Array, Array]:
    """Return the pulses (n_blows, length, 1) and responses (n_blows, length, p)."""
    X, Y = np.zeros((len(blows), length, 1)), np.empty((len(blows), length, motion.shape[1]))
    for i, blow in enumerate(blows):
        begin = blow.start - lead
        X[i, lead : lead + blow.stop - blow.start, 0] = force[blow.start : blow.stop]
        Y[i] = motion[begin : begin + length]
    return X, Y


def _block_length(blows: list[Blow], samples: int, dt: float, block_s: float | None) -> int:
    if not blows:
        raise BadRecording("no blow was found: the input never rises")
    starts = [blow.start for blow in blows]
    shortest = int(np.min(np.diff(starts), initial=samples - starts[0]))
    length = shortest if block_s is None else round(block_s / dt)
    longest = max(blow.stop - blow.start for blow in blows)
    if length < 8 * longest:
        raise BadRecording(
            f"a block of {length * dt:g} s for blows of {longest * dt:g} s holds no free response; give a longer --segment"
        )
    return min(length, samples - starts[0])


def without_added_decay(estimate: PoleEstimate, decay: float) -> PoleEstimate:
    """Return the poles without an exponential window's damping.

    Each pole moves right by the decay [1/s]; frequency and damping follow. A pole left without damping is noise or
    leakage and counts as nuisance.

    Parameters
    ----------
    estimate : PoleEstimate
        Poles of the windowed data.
    decay : float
        Decay of the window [1/s].

    Returns
    -------
    PoleEstimate
        Corrected estimate.

    Raises
    ------
    BadRecording
        No pole keeps any damping: the window is too strong for the noise.
    """
    if decay == 0:
        return estimate
    keep = np.flatnonzero(estimate.s.real + decay < 0)
    if keep.size == 0:
        raise BadRecording(
            f"no mode has damping left without the exponential window's {decay:g} 1/s; use longer blocks or a weaker window"
        )
    s = estimate.s[keep] + decay
    freq_sd, zeta_sd = estimate.freq_sd[keep], estimate.zeta_sd[keep]
    zeta_sd = np.hypot(zeta_sd, freq_sd / estimate.freq[keep] * estimate.zeta[keep])
    omega = np.abs(s)
    return replace(
        estimate,
        s=s,
        freq=omega / (2 * np.pi),
        zeta=-s.real / omega,
        shapes=estimate.shapes[:, keep],
        participation=estimate.participation[:, keep],
        freq_sd=freq_sd,
        zeta_sd=zeta_sd * np.abs(estimate.s[keep]) / omega,
        confidence=estimate.confidence[keep],
        n_nuisance=estimate.n_nuisance + estimate.s.size - keep.size,
    )
