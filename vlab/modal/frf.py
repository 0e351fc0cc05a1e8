"""Frequency responses from recordings, and what is read off them directly."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal, stats

from vlab.errors import BadRecording, unknown_name
from vlab.signals import Array, ComplexArray, FrequencyResponse, Recording

Estimator = Literal["H1", "H2", "Hv"]

MIN_SEGMENTS = 4
"""Fewest segments per input for random data: with as many segments as inputs the coherence is 1 whatever the noise."""
MIN_PERIODS = 2
"""Fewest periods per input for periodic data, for the same reason."""
RANDOM_FLOOR, PERIODIC_FLOOR = 1e-10, 1e-6
"""Lines with less than this fraction of the input's largest power are left out. Random: only what is rounding error
(100 dB). Periodic: 60 dB, room for the force drop-out at resonance of a light structure, none for rounding error."""
REPEATABILITY = 1e-3
"""Chance that a line of pure input noise passes for one that the periodic input excites (F test over the periods)."""
MAX_CONDITION = 1e10
"""Largest condition number of the inputs' coherence matrix; beyond it the inputs are one input in several channels."""

_INTEGRALS = {"m/s^2": "m/s", "m/s": "m", "rad/s^2": "rad/s", "rad/s": "rad"}


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredFrequencyResponse(FrequencyResponse):
    """A frequency response that knows how noisy it is.

    Parameters
    ----------
    variance : (n, n_outputs, n_inputs) array or None
        Variance of the complex H (of its real and imaginary part together), from the spread over segments or periods.
    n_averages : float
        Independent averages that it rests on; overlapping windows count for less than their number.
    resolution_hz : float
        Noise bandwidth of the window: poles nearer than this leak into each other. 0 without a window.
    """

    variance: Array | None = None
    n_averages: float = np.nan
    resolution_hz: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.variance is not None:
            variance = np.array(self.variance, dtype=float)
            if variance.shape != self.H.shape or not np.all(np.isfinite(variance)) or np.any(variance < 0):
                raise BadRecording(
                    f"a variance of shape {variance.shape} must be finite, >= 0 and fit H {self.H.shape}"
                )
            variance.setflags(write=False)
            object.__setattr__(self, "variance", variance)

    def between(self, low: float, high: float) -> "MeasuredFrequencyResponse":
        """Return the part with low <= frequency <= high [Hz]."""
        return self._lines((self.freq >= low) & (self.freq <= high))

    def _lines(self, keep: Any) -> "MeasuredFrequencyResponse":
        cut: dict[str, Any] = {name: getattr(self, name) for name in ("coherence", "variance")}
        cut = {name: None if value is None else value[keep] for name, value in cut.items()}
        return replace(self, freq=self.freq[keep], H=self.H[keep], **cut)


def estimate_frf(
    recording: Recording,
    *,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    estimator: Estimator = "H1",
    segment_s: float | None = None,
    period_s: float | None = None,
    overlap: float = 0.5,
    window: str = "hann",
    skip_s: float = 0.0,
    power_floor: float | None = None,
) -> MeasuredFrequencyResponse:
    """Estimate the frequency responses of a recording.

    Random data are averaged over windowed, overlapping segments. Periodic data (`period_s`) are averaged over whole
    periods without a window: once the transient has died out (`skip_s`) there is no leakage, and what differs from
    period to period is noise. H1 is unbiased with noise on the outputs only, H2 with noise on the input only [1]_;
    Hv takes both as equally noisy for their power [2]_. Several inputs are solved together, H = S_yx S_xx^-1, with the
    multiple coherence. In a closed loop choose what was added to the loop as input, not the sum that the coil gets.
    The line at 0 Hz is left out: offsets of the sensors are not responses.

    Parameters
    ----------
    recording : Recording
        Uniformly sampled.
    inputs, outputs : sequence of str
        Channel names; by default the channels marked as inputs, and all others.
    estimator : {"H1", "H2", "Hv"}
        H2 with several inputs needs as many outputs.
    segment_s : float
        Length of a segment of random data [s]; by default an eighth of the recording. Line spacing is its inverse, and
        a mode narrower than about four lines (2 zeta f segment_s < 4) comes out too damped by leakage.
    period_s : float
        Period of the excitation [s], a whole number of samples. The last whole periods are used.
    overlap : float
        Of segments, in [0, 1); periods do not overlap.
    window : str
        Of segments; a name that `scipy.signal.get_window` knows.
    skip_s : float
        Left out at the start [s], for the transient.
    power_floor : float
        Lines with less than this fraction of the input's largest power are left out; 1e-10 for random and 1e-6 for
        periodic data by default. Periodic data of one input must also repeat significantly at a line.

    Returns
    -------
    MeasuredFrequencyResponse
        With coherence (ordinary or multiple) and variance.

    Raises
    ------
    BadRecording
        Not uniform, too short for coherence to mean anything, an input that is constant, inputs that are one and the
        same signal, a period that is not a whole number of samples or with which the input does not repeat.
    UnknownName
        A channel name that the recording does not have.

    References
    ----------
    .. [1] Bendat and Piersol, *Random Data*, Wiley, 4th ed., 2010, ch. 6 and 9 (variance: table 9.6).
    .. [2] Rocklin, Crowley and Vold, "A comparison of H1, H2, and Hv frequency response functions", IMAC III, 1985.
    """
    inputs = tuple(recording.inputs if inputs is None else inputs)
    outputs = tuple([n for n in recording.names if n not in inputs] if outputs is None else outputs)
    dt, x, y = _checked_data(recording, inputs, outputs, skip_s)
    if period_s is None:
        spectra = _segment_spectra(x, y, dt, len(x) * dt / 8 if segment_s is None else segment_s, overlap, window)
    else:
        spectra = _period_spectra(x, y, dt, period_s)
    floor = (RANDOM_FLOOR if period_s is None else PERIODIC_FLOOR) if power_floor is None else power_floor
    keep = _excited(spectra.X, floor, is_periodic=period_s is not None)
    if not np.any(keep):
        raise BadRecording(
            f"no line above 0 Hz is excited by all of {', '.join(inputs)}; excite all inputs in one band"
        )
    kept = replace(spectra, X=spectra.X[:, keep], Y=spectra.Y[:, keep], freq=spectra.freq[keep])
    H, coherence, variance = _solve(kept, estimator)
    return MeasuredFrequencyResponse(
        freq=kept.freq,
        H=H,
        outputs=outputs,
        inputs=inputs,
        unit=_unit(recording, inputs, outputs),
        coherence=coherence,
        variance=variance,
        n_averages=kept.n_effective,
        resolution_hz=kept.resolution_hz,
    )


def integrate(frf: FrequencyResponse) -> FrequencyResponse:
    """Divide by j omega: accelerance -> mobility -> receptance."""
    return _times_power_of_s(frf, -1)


def differentiate(frf: FrequencyResponse) -> FrequencyResponse:
    """Multiply by j omega: receptance -> mobility -> accelerance."""
    return _times_power_of_s(frf, 1)


def peak_levels(
    frf: FrequencyResponse,
    frequencies: ArrayLike,
    half_width_hz: float,
    *,
    input: str | None = None,
    per_output: bool = False,
    normalise: bool = True,
) -> ComplexArray:
    """Read mode shapes off the peaks: level and phase of each response at each natural frequency.

    This is how the dissertation got its mode shapes (section 5.4.1). It is right for well separated, lightly damped
    modes; `vlab.modal.poles.estimate_poles` separates close ones.

    Parameters
    ----------
    frf : FrequencyResponse
        Integrate mobility first to have displacement shapes.
    frequencies : array of n_modes
        Where the peaks are, about [Hz].
    half_width_hz : float
        How far from there the peak is sought [Hz].
    input : str
        The input whose column is read; needed where there are several.
    per_output : bool
        Take each output at its own peak; by default all at the line where they are largest together, which keeps
        their phases comparable and does not mistake the flank of a neighbour for the peak of a nodal point.
    normalise : bool
        Divide each mode by its largest response, which becomes 1.

    Returns
    -------
    (n_modes, n_outputs) complex array
    """
    column = _column(frf, input)
    rows = []
    for frequency in np.atleast_1d(np.asarray(frequencies, dtype=float)):
        near = np.flatnonzero(np.abs(frf.freq - frequency) <= half_width_hz)
        if near.size == 0:
            raise BadRecording(
                f"no line within {half_width_hz:g} Hz of {frequency:g} Hz; the response has {frf.freq.size} lines from "
                f"{frf.freq[0]:g} to {frf.freq[-1]:g} Hz: widen half_width_hz"
            )
        H = frf.H[near, :, column]
        power = np.abs(H) ** 2
        line = np.argmax(power, axis=0) if per_output else np.full(H.shape[1], np.argmax(power.sum(axis=1)))
        level = H[line, np.arange(H.shape[1])]
        largest = level[np.argmax(np.abs(level))]
        if normalise and largest == 0:
            raise BadRecording(f"all responses near {frequency:g} Hz are zero; there is no shape to normalise")
        rows.append(level / largest if normalise else level)
    return np.array(rows)


def _column(frf: FrequencyResponse, input: str | None) -> int:
    if input is None:
        if len(frf.inputs) > 1:
            raise BadRecording(f"say which input: the response has {', '.join(frf.inputs)}")
        return 0
    if input not in frf.inputs:
        raise unknown_name("input", input, frf.inputs)
    return frf.inputs.index(input)


def _checked_data(
    recording: Recording, inputs: tuple[str, ...], outputs: tuple[str, ...], skip_s: float
) -> tuple[float, Array, Array]:
    """Return the time step and the input and output samples after `skip_s`."""
    columns = [recording.index(name) for name in inputs + outputs]
    if not inputs or not outputs:
        what = "input" if not inputs else "output"
        raise BadRecording(
            f"no {what} channel: name the {what}s, or mark inputs with is_input (has: {recording.names})"
        )
    for name in inputs + outputs:
        if (inputs + outputs).count(name) > 1:
            raise BadRecording(f"channel {name!r} is named more than once among inputs and outputs")
    if not recording.is_uniform:
        steps = np.diff(recording.time)
        raise BadRecording(
            f"time steps from {steps.min():g} to {steps.max():g} s: a frequency response needs even sampling; resample "
            "first"
        )
    dt = float(recording.time[-1] - recording.time[0]) / (len(recording) - 1)
    first = max(0, int(np.ceil(skip_s / dt - 1e-6)))
    data = recording.data[first:, columns]
    if len(data) < 2:
        raise BadRecording(f"skip_s = {skip_s:g} s leaves nothing of {len(recording) * dt:g} s")
    x, y = data[:, : len(inputs)], data[:, len(inputs) :]
    for name, column in zip(inputs, x.T, strict=True):
        if np.ptp(column) <= 1e-12 * np.abs(column).max():  # a few thousand times the rounding error of one sample
            raise BadRecording(f"input channel {name!r} is constant ({column[0]:g}): nothing was excited by it")
    return dt, x, y


@dataclass(frozen=True, kw_only=True, eq=False)
class _Spectra:
    X: ComplexArray  # (average, line, input)
    Y: ComplexArray
    freq: Array
    n_effective: float
    resolution_hz: float


def _period_spectra(x: Array, y: Array, dt: float, period_s: float) -> _Spectra:
    """Transform the last whole periods, each by itself."""
    length = round(period_s / dt)
    if length < 2 or abs(period_s / dt - length) > 1e-4:  # 1e-4 of a sample: 80 dB below the signal at Nyquist
        raise BadRecording(
            f"period_s = {period_s:g} s is {period_s / dt:.6g} samples of {dt:g} s; averaging without leakage needs a "
            "whole number"
        )
    n, n_in = len(x) // length, x.shape[1]
    if n < MIN_PERIODS * n_in:
        raise BadRecording(
            f"{n} whole periods of {period_s:g} s for {n_in} inputs: coherence would be 1 by construction; "
            f"at least {MIN_PERIODS} an input are needed: record longer or skip less"
        )
    X, Y = (np.fft.rfft(a[len(a) - n * length :].reshape(n, length, -1), axis=1) for a in (x, y))
    if n_in == 1:
        power, common = np.sum(np.abs(X[:, 1:]) ** 2), n * np.sum(np.abs(X[:, 1:].mean(axis=0)) ** 2)
        if common < 0.5 * power:
            raise BadRecording(
                f"the input does not repeat with period_s = {period_s:g} s; leave it out for random data"
            )
    return _Spectra(X=X, Y=Y, freq=_lines(length, dt), n_effective=float(n), resolution_hz=0.0)


def _segment_spectra(x: Array, y: Array, dt: float, segment_s: float, overlap: float, window: str) -> _Spectra:
    """Transform windowed, overlapping segments without their means."""
    if not 0 <= overlap < 1:
        raise BadRecording(f"overlap = {overlap:g} is not in [0, 1)")
    length = round(segment_s / dt)
    try:
        taper = signal.get_window(window, max(length, 1))
    except ValueError as error:
        raise BadRecording(f"window {window!r} is not one that scipy.signal.get_window knows") from error
    hop, n_in = max(1, round(length * (1 - overlap))), x.shape[1]
    n = (len(x) - length) // hop + 1 if 2 <= length <= len(x) else 0
    if n < MIN_SEGMENTS * n_in:
        raise BadRecording(
            f"{n} segments of {length * dt:g} s for {n_in} inputs: coherence would be near 1 by construction; at least "
            f"{MIN_SEGMENTS} an input are needed: choose a shorter segment_s or record longer"
        )
    pieces = []
    for a in (x, y):
        cut = a[hop * np.arange(n)[:, None] + np.arange(length)]
        pieces.append(np.fft.rfft((cut - cut.mean(axis=1, keepdims=True)) * taper[:, None], axis=1))
    lags = np.arange(1, min(n, -(-length // hop)))
    rho = np.array([taper[k * hop :] @ taper[: length - k * hop] for k in lags]) / (taper @ taper)
    return _Spectra(
        X=pieces[0],
        Y=pieces[1],
        freq=_lines(length, dt),
        n_effective=float(n / (1 + 2 * np.sum((1 - lags / n) * rho**2))),  # Welch, IEEE Trans. AU 15, 1967
        resolution_hz=float((taper @ taper) / np.sum(taper) ** 2 / dt),
    )


def _lines(length: int, dt: float) -> Array:
    return np.arange(length // 2 + 1) / (length * dt)


def _excited(X: ComplexArray, floor: float, *, is_periodic: bool) -> NDArray[np.bool_]:
    """Return the lines above 0 Hz that every input excites."""
    power = np.mean(np.abs(X) ** 2, axis=0)
    keep = np.all(power > floor * power[1:].max(axis=0), axis=1)
    keep[0] = False
    if is_periodic and X.shape[2] == 1:
        n = len(X)
        mean = X.mean(axis=0)
        spread = np.sum(np.abs(X - mean) ** 2, axis=0) / (n - 1)
        keep &= (n * np.abs(mean) ** 2 > stats.f.ppf(1 - REPEATABILITY, 2, 2 * (n - 1)) * spread)[:, 0]
    return keep


def _solve(spectra: _Spectra, estimator: str) -> tuple[ComplexArray, Array, Array]:
    """Return H, multiple coherence and variance of H."""
    X, Y = spectra.X, spectra.Y
    if estimator not in ("H1", "H2", "Hv"):
        raise BadRecording(f"unknown estimator {estimator!r} (accepted: H1, H2, Hv)")
    n_in, n_out = X.shape[2], Y.shape[2]
    S_xx = np.einsum("pfi,pfj->fij", X, X.conj()) / len(X)
    S_yx = np.einsum("pfo,pfj->foj", Y, X.conj()) / len(X)
    S_yy = np.mean(np.abs(Y) ** 2, axis=0)
    scale = np.sqrt(np.einsum("fii->fi", S_xx).real)  # units of the inputs differ; coherence between them does not
    normed = S_xx / scale[:, :, None] / scale[:, None, :]
    condition = np.linalg.cond(normed)
    if condition.max() > MAX_CONDITION:
        worst = spectra.freq[np.argmax(condition)]
        raise BadRecording(
            f"the {n_in} inputs are fully coherent with each other at {worst:g} Hz (condition {condition.max():.1e}): "
            "their responses cannot be told apart; drive them with independent signals or one at a time"
        )
    inverse = np.linalg.inv(normed) / scale[:, :, None] / scale[:, None, :]
    H = S_yx @ inverse
    left = np.mean(np.abs(Y - np.einsum("foi,pfi->pfo", H, X)) ** 2, axis=0)  # S_yy - H S_xy would cancel
    coherence = np.clip(1 - np.divide(left, S_yy, out=np.ones_like(S_yy), where=S_yy > 0), 0.0, 1.0)
    noise = left / max(spectra.n_effective - n_in, 1.0)
    variance = noise[:, :, None] * np.einsum("fii->fi", inverse).real[:, None, :]
    if estimator == "H2":
        H = _h2(X, Y, S_yx, S_yy)
    elif estimator == "Hv":
        H = np.stack([_hv(normed, S_yx[:, o] / scale, S_yy[:, o]) for o in range(n_out)], axis=1) / scale[:, None, :]
    return H, coherence, variance


def _h2(X: ComplexArray, Y: ComplexArray, S_yx: ComplexArray, S_yy: Array) -> ComplexArray:
    if X.shape[2] == 1:
        if np.any(S_yx == 0):
            raise BadRecording("an output does not respond to the input at all at some line: H2 does not exist; use H1")
        return S_yy[:, :, None] / S_yx.conj()
    if X.shape[2] != Y.shape[2]:
        raise BadRecording(f"H2 with {X.shape[2]} inputs needs as many outputs, not {Y.shape[2]}; use H1 or Hv")
    full = np.einsum("pfo,pfq->foq", Y, Y.conj()) / len(Y)
    return full @ np.linalg.inv(np.swapaxes(S_yx, 1, 2).conj())


def _hv(S_xx: ComplexArray, S_yx: ComplexArray, S_yy: Array) -> ComplexArray:
    """Total least squares on channels of unit power: the combination of inputs and output that has least power is 0."""
    n_in = S_xx.shape[1]
    power = np.sqrt(np.where(S_yy > 0, S_yy, 1.0))
    G = np.empty((len(S_xx), n_in + 1, n_in + 1), complex)
    G[:, :n_in, :n_in], G[:, n_in, n_in] = S_xx, S_yy / power**2
    G[:, n_in, :n_in] = S_yx / power[:, None]
    G[:, :n_in, n_in] = G[:, n_in, :n_in].conj()
    least = np.linalg.eigh(G)[1][:, :, 0]  # power of v^H [x; y] is v^H G v
    return -least[:, :n_in].conj() / least[:, n_in:].conj() * power[:, None]


def _unit(recording: Recording, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> str:
    """Return the unit of H where it is one for all, else nothing."""
    over, under = ({recording.channels[recording.index(n)].unit for n in names} for names in (outputs, inputs))
    if len(over) != 1 or len(under) != 1:
        return ""
    numerator, denominator = (f"({u})" if re.search(r"[ /*]", u) else u or "1" for u in (over.pop(), under.pop()))
    return f"{numerator}/{denominator}"


def _times_power_of_s(frf: FrequencyResponse, power: int) -> FrequencyResponse:
    if power < 0 and frf.freq[0] <= 0:
        raise BadRecording(f"cannot integrate the line at {frf.freq[0]:g} Hz; keep frequencies above 0 with between()")
    omega = 2 * np.pi * frf.freq[:, None, None]
    changes: dict[str, Any] = {"H": frf.H * (1j * omega) ** power, "unit": _unit_times_power_of_s(frf.unit, power)}
    if isinstance(frf, MeasuredFrequencyResponse) and frf.variance is not None:
        changes["variance"] = frf.variance * omega ** (2 * power)
    return replace(frf, **changes)


def _unit_times_power_of_s(unit: str, power: int) -> str:
    table = _INTEGRALS if power < 0 else {v: k for k, v in _INTEGRALS.items()}
    match = re.fullmatch(r"\(?([^()/]+(?:/s(?:\^2)?)?)\)?/(\([^()]+\)|[^()/ ]+)", unit)
    if match and match[1] in table:
        new = table[match[1]]
        return f"({new})/{match[2]}" if "/" in new else f"{new}/{match[2]}"
    return f"({unit}) {'s' if power < 0 else '1/s'}" if unit else ""
