"""Robustness of a sampled loop: gain, delay, filter and disc margins.

A margin comes from exact eigenvalues of the sampled loop. The parameter moves from its nominal value until the largest
eigenvalue leaves the unit circle; bisection then refines the crossing. An unstable range narrower than a step of the
search is missed.
"""

import itertools
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import bisect

from vlab.errors import BadController
from vlab.hardware.output_chain import theoretical_response
from vlab.lab.prediction import LoopPole, SampledLoop, law_response
from vlab.signals import Array

GAINS = np.geomspace(1.0, 100.0, 41)
"""GAINS [1]: trial gains on all commands, upward and as reciprocals downward, in steps of 12 %."""
DELAY_STEP, DELAY_SPAN = 0.25, 10.0
"""DELAY_STEP [samples]: step of the trial delays.
DELAY_SPAN [samples]: largest added trial delay."""
CORNERS = np.geomspace(1.0, 1e-3, 41)
"""CORNERS [1]: trial factors on the corner of the RC filters, in steps of 16 %."""


@dataclass(frozen=True, kw_only=True)
class Margin:
    """Stability limit of a loop under one parameter.

    Parameters
    ----------
    value : float or None
        Parameter at the limit; None for a loop stable over the whole search.
    searched : float
        End of the search.
    first : LoopPole or None
        Pole that crosses.
    """

    value: float | None
    searched: float
    first: LoopPole | None


@dataclass(frozen=True, kw_only=True)
class DiscMargin:
    """Largest disc of gain and phase that keeps stability.

    The disc belongs to the balanced sensitivity (S - T)/2 [1]_.

    Parameters
    ----------
    size : float
        alpha = 1 / max |(S - T)/2|, for all channels at once or for one.
    hz : float
        Frequency of the smallest disc [Hz].
    gain_low, gain_high : float
        Smallest and largest factor on each perturbed channel.
    phase : float
        Largest phase of each perturbed channel [rad].

    References
    ----------
    .. [1] P. Seiler, A. Packard and P. Gahinet, An introduction to disk margins, IEEE Control Systems 40(5) (2020)
           78-95.
    """

    size: float
    hz: float

    @property
    def gain_low(self) -> float:
        """Smallest factor inside the disc."""
        return max((1 - self.size / 2) / (1 + self.size / 2), 0.0)

    @property
    def gain_high(self) -> float:
        """Largest factor inside the disc."""
        return (1 + self.size / 2) / (1 - self.size / 2) if self.size < 2 else float("inf")

    @property
    def phase(self) -> float:
        """Phase margin 2 atan(size/2) [rad]."""
        return float(2 * np.arctan(self.size / 2))


def find_margin(at: Callable[[float], SampledLoop], values: Array) -> Margin:
    """Return the first value that makes the loop unstable.

    A loop unstable at the first (nominal) value has the margin there.

    Parameters
    ----------
    at : callable
        Loop as a function of the parameter.
    values : array
        Search path from the nominal value.

    Returns
    -------
    Margin
        Margin.
    """
    if at(float(values[0])).radius >= 1:
        return Margin(value=float(values[0]), searched=float(values[0]), first=at(float(values[0])).critical())
    for inside, outside in itertools.pairwise(values):
        if at(float(outside)).radius >= 1:
            crossing = bisect(lambda v: at(float(v)).radius - 1, float(inside), float(outside), rtol=1e-7, xtol=1e-12)
            return Margin(value=float(crossing), searched=float(crossing), first=at(float(crossing)).critical())
    return Margin(value=None, searched=float(values[-1]), first=None)


def gain_margins(loop: SampledLoop) -> tuple[Margin, Margin]:
    """Return the gain margins below and above one.

    The factor acts on all commands.
    """
    return find_margin(loop.with_gain, 1 / GAINS), find_margin(loop.with_gain, GAINS)


def delay_margin(loop: SampledLoop, *, span: float = DELAY_SPAN) -> Margin:
    """Return the total delay at the stability limit [samples]."""
    start = loop.converter.delay_samples
    return find_margin(loop.with_delay, start + np.arange(0.0, span + DELAY_STEP / 2, DELAY_STEP))


def filter_margin(loop: SampledLoop) -> Margin | None:
    """Return the filter corner at the stability limit [Hz].

    None without filters.
    """
    corner = loop.converter.filter_corner
    return find_margin(loop.with_filter, corner * CORNERS) if corner > 0 else None


def sweep(at: Callable[[float], SampledLoop], values: Array) -> list[tuple[float, LoopPole]]:
    """Return the least stable pole at every value."""
    return [(float(value), at(float(value)).critical()) for value in values]


def disc_margins(loop: SampledLoop) -> tuple[DiscMargin, list[DiscMargin]]:
    """Return the disc margins of all channels and of each channel.

    The simultaneous margin is a lower bound: the largest singular value after a diagonal scaling bounds the structured
    singular value. An unstable loop has zero margins.

    Parameters
    ----------
    loop : SampledLoop
        Sampled loop.

    Returns
    -------
    tuple of (DiscMargin, list of DiscMargin)
        Margin with all channels perturbed, and one a channel with the remaining loops closed.
    """
    count = loop.at_coils.shape[0]
    if loop.radius >= 1:
        return DiscMargin(size=0.0, hz=loop.critical().hz), [DiscMargin(size=0.0, hz=loop.critical().hz)] * count
    freq = _lines(loop)
    L = loop.opened(freq)
    S = np.linalg.inv(np.eye(count) + L)
    balanced = S - np.eye(count) / 2  # (S - T)/2 with T = I - S
    together = _scaled_norm(balanced)
    alone = np.abs(np.einsum("fii->fi", S) - 0.5)
    return (
        DiscMargin(size=float(1 / together.max()), hz=float(freq[together.argmax()])),
        [DiscMargin(size=float(1 / x.max()), hz=float(freq[x.argmax()])) for x in alone.T],
    )


def _lines(loop: SampledLoop) -> Array:
    """Return frequencies that resolve every resonance [Hz].

    The resonances belong to the open and the closed loop, up to half the sample rate.
    """
    top = loop.converter.rate / 2
    around = np.concatenate([-np.geomspace(0.01, 30, 15)[::-1], [0.0], np.geomspace(0.01, 30, 15)])
    light = [p for closed in (loop, loop.with_gain(0.0)) for p in closed.poles() if p.hz < top and abs(p.zeta) < 0.3]
    peaks = [p.hz * (1 + abs(p.zeta) * around) for p in light]
    lines = np.concatenate([np.geomspace(1e-4 * top, top, 1000), *peaks])
    return np.unique(lines[(lines > 1e-4 * top) & (lines < top)])


def _scaled_norm(M: Array) -> Array:
    """Return a bound of the structured singular value, (n_freq,).

    The structure is one complex number a channel. Osborne's scaling [1]_ balances rows and columns in four passes.

    References
    ----------
    .. [1] E. E. Osborne, On pre-conditioning of matrices, Journal of the ACM 7 (1960) 338-345.
    """
    scaled = M.copy()
    for _ in range(4):
        for i in range(M.shape[1]):
            off = np.arange(M.shape[1]) != i
            row, column = np.linalg.norm(scaled[:, i, off], axis=1), np.linalg.norm(scaled[:, off, i], axis=1)
            d = np.sqrt(np.where((row > 0) & (column > 0), column / np.maximum(row, 1e-300), 1.0))[:, None]
            scaled[:, i, :] *= d
            scaled[:, :, i] /= d
    both = np.linalg.norm(np.stack([M, scaled]), ord=2, axis=(2, 3))
    return np.asarray(both.min(axis=0))


def damper_strengths(loop: SampledLoop, freq: Array) -> Array:
    """Return the law's damper strengths over frequency.

    The strengths are the eigenvalues of the Hermitian part of -c K, for collocated coils and sensors. c is the response
    of hold, delay and filter. A negative value belongs to a combination of coils that drives motion instead of damping.
    A light unmodelled mode with such motion loses damping.

    Parameters
    ----------
    loop : SampledLoop
        Sampled loop.
    freq : array
        Frequencies [Hz].

    Returns
    -------
    array
        Ascending strengths [N s/m], (n_freq, n_coils).

    Raises
    ------
    BadController
        Commands and samples of the law are not paired.
    """
    if loop.at_coils.shape != loop.at_sensors.shape:
        raise BadController("damper strengths need as many sensors as coils, in collocated pairs")
    through = theoretical_response(loop.converter, freq)[:, None, None]
    H = -np.reshape(loop.gain, (-1, 1)) * law_response(loop.law, freq, loop.converter.rate) * through
    return np.asarray(np.linalg.eigvalsh((H + np.conj(np.swapaxes(H, 1, 2))) / 2))


def robustness_report(
    loop: SampledLoop, *, modelled: Collection[int] | None = None, sweeps: bool = True
) -> dict[str, Any]:
    """Return margins, sweeps and poles of a loop as plain data.

    Parameters
    ----------
    loop : SampledLoop
        Loop, see `vlab.lab.prediction.loop_on`.
    modelled : collection of int or None
        Modes, from 1, in the law's design model; the remaining modes are unmodelled. None if unknown.
    sweeps : bool
        Whether to add the least stable pole over delay and gain.

    Returns
    -------
    dict of str to object
        Plain values by name.
    """

    def pole(p: LoopPole | None) -> dict[str, Any] | None:
        if p is None:
            return None
        known = None if modelled is None or not p.is_mode else p.mode in modelled
        return {
            "hz": p.hz,
            "zeta": p.zeta,
            "growth_per_s": p.growth,
            "mode": p.mode,
            "is_mode": p.is_mode,
            "energy_share": p.share,
            "modelled": known,
        }

    def margin(m: Margin | None, name: str, scale: float = 1.0) -> dict[str, Any] | None:
        if m is None:
            return None
        value = None if m.value is None else m.value * scale
        return {name: value, f"searched_{name}": m.searched * scale, "first": pole(m.first)}

    def disc(d: DiscMargin) -> dict[str, Any]:
        return {
            "size": d.size,
            "gain_low": d.gain_low,
            "gain_high": d.gain_high,
            "phase_deg": float(np.degrees(d.phase)),
            "hz": d.hz,
        }

    parts, T = loop.converter, 1.0 / loop.converter.rate
    low, high = gain_margins(loop)
    together, alone = disc_margins(loop)
    late = delay_margin(loop)
    delay = margin(late, "samples")
    if delay is not None:
        delay["extra_s"] = None if late.value is None else (late.value - parts.delay_samples) * T
    poles = loop.poles()
    report: dict[str, Any] = {
        "rate_hz": parts.rate,
        "delay_samples": parts.delay_samples,
        "filter_corner_hz": parts.filter_corner,
        "is_stable": loop.radius < 1,
        "least_stable": pole(max(poles, key=lambda p: p.growth)),
        "gain_margin": {"low": margin(low, "factor"), "high": margin(high, "factor")},
        "delay_margin": delay,
        "filter_margin": margin(filter_margin(loop), "corner_hz"),
        "disc_margin": {"all_channels": disc(together), "each_channel": [disc(d) for d in alone]},
        "poles": [pole(p) for p in poles if p.hz < parts.rate / 4],
    }
    if sweeps:
        delays = np.arange(0.0, parts.delay_samples + 5.0, 0.25)
        report["delay_sweep"] = [{"samples": v, **(pole(p) or {})} for v, p in sweep(loop.with_delay, delays)]
        gains = np.geomspace(0.1, 10.0, 41)
        report["gain_sweep"] = [{"factor": v, **(pole(p) or {})} for v, p in sweep(loop.with_gain, gains)]
    return report


def robustness_text(report: dict[str, Any]) -> str:
    """Return a report's margins as text.

    Parameters
    ----------
    report : dict of str to object
        Result of `robustness_report`.

    Returns
    -------
    str
        One line a margin.
    """

    def what(pole: dict[str, Any] | None) -> str:
        if pole is None:
            return ""
        if not pole["is_mode"]:
            return f"  first: {pole['hz']:.4g} Hz, no mode of the structure alone"
        kind = "" if pole["modelled"] is None else ", in the design model" if pole["modelled"] else ", unmodelled"
        return f"  first: {pole['hz']:.4g} Hz, mode {pole['mode']}{kind}"

    def line(name: str, margin: dict[str, Any] | None, key: str, unit: str) -> str:
        if margin is None:
            return f"{name:<22} none in the loop"
        if margin[key] is None:
            return f"{name:<22} none found up to {margin[f'searched_{key}']:.4g} {unit}".rstrip()
        return f"{name:<22} {margin[key]:.4g} {unit}".rstrip() + what(margin["first"])

    least, disc = report["least_stable"], report["disc_margin"]["all_channels"]
    state = "stable" if report["is_stable"] else "UNSTABLE"
    lines = [
        f"{state} at {report['rate_hz']:g} Hz with {report['delay_samples']:g} samples of delay; least stable: {least['hz']:.4g} Hz, damping ratio {least['zeta']:.4g}, {'mode ' + str(least['mode']) if least['is_mode'] else 'no mode of the structure alone'}",
        line("gain, upward", report["gain_margin"]["high"], "factor", ""),
        line("gain, downward", report["gain_margin"]["low"], "factor", ""),
        line("delay", report["delay_margin"], "samples", "samples"),
        line("filter corner", report["filter_margin"], "corner_hz", "Hz"),
        f"{'disc, all channels':<22} size {disc['size']:.3g}: gains {disc['gain_low']:.3g} to {disc['gain_high']:.3g}, phase {disc['phase_deg']:.3g} deg, at {disc['hz']:.4g} Hz",
    ]
    return "\n".join(lines)
