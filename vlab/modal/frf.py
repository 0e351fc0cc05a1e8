"""Frequency responses from recordings, with integration and peak reading."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from vlab.errors import BadRecording, unknown_name
from vlab.modal.channels import checked_data, response_unit
from vlab.modal.spectra import excited_lines, period_spectra, segment_spectra, solve
from vlab.signals import Array, ComplexArray, FrequencyResponse, Recording

Estimator = Literal["H1", "H2", "Hv"]

RANDOM_FLOOR, PERIODIC_FLOOR = 1e-10, 1e-6
"""RANDOM_FLOOR [1]: smallest used input power of random data, relative to the largest line (100 dB); below is rounding.
PERIODIC_FLOOR [1]: same for periodic data (60 dB), which allows the force drop-out at resonance of a light
structure."""

_INTEGRALS = {"m/s^2": "m/s", "m/s": "m", "rad/s^2": "rad/s", "rad/s": "rad"}


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredFrequencyResponse(FrequencyResponse):
    """A frequency response with its variance.

    Parameters
    ----------
    variance : (n, n_outputs, n_inputs) array or None
        Variance of the complex H (real plus imaginary part), from the spread over segments or periods.
    n_averages : float
        Number of independent averages; overlapping windows count less.
    resolution_hz : float
        Noise bandwidth of the window [Hz]; closer poles leak into each other. 0 without a window.
    added_decay : float
        Decay of an exponential window on input and output [1/s]. H is evaluated at s = added_decay + j omega, which
        moves every pole left by the same amount.
    """

    variance: Array | None = None
    n_averages: float = np.nan
    resolution_hz: float = 0.0
    added_decay: float = 0.0

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
        """Return the lines with low <= frequency <= high [Hz]."""
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
    periods without a window. After the transient (`skip_s`) periodic data have no leakage, and differences between
    periods are noise.

    H1 is unbiased with noise on the outputs only, H2 with noise on the input only [1]_. Hv assumes equal relative noise
    on both [2]_. Several inputs are solved together, H = S_yx S_xx^-1, with the multiple coherence. In a closed loop
    the input must be the signal added to the loop, not the coil's total. The line at 0 Hz is dropped, because sensor
    offsets are no responses.

    Parameters
    ----------
    recording : Recording
        Uniformly sampled.
    inputs, outputs : sequence of str
        Channel names; by default the channels marked as inputs, and all remaining channels.
    estimator : {"H1", "H2", "Hv"}
        H2 with several inputs needs as many outputs.
    segment_s : float
        Length of a segment of random data [s]; an eighth of the recording by default. Its inverse is the line spacing.
        Leakage overestimates the damping of a mode narrower than about four lines (2 zeta f segment_s < 4).
    period_s : float
        Period of the excitation [s], a whole number of samples. The last whole periods are used.
    overlap : float
        Overlap of segments, in [0, 1); periods do not overlap.
    window : str
        Window of segments, a name of `scipy.signal.get_window`.
    skip_s : float
        Time dropped at the start [s], for the transient.
    power_floor : float
        Smallest used input power relative to the largest line; by default 1e-10 for random and 1e-6 for periodic data.
        With one periodic input a line must also repeat significantly.

    Returns
    -------
    MeasuredFrequencyResponse
        H with ordinary or multiple coherence and variance.

    Raises
    ------
    BadRecording
        Uneven samples, a recording too short for coherence, a constant input, or identical inputs. Or the period is no
        whole number of samples or does not fit the input.
    UnknownName
        The recording has no channel of that name.

    References
    ----------
    .. [1] Bendat and Piersol, *Random Data*, Wiley, 4th ed., 2010, ch. 6 and 9 (variance: table 9.6).
    .. [2] Rocklin, Crowley and Vold, "A comparison of H1, H2, and Hv frequency response functions", IMAC III, 1985.
    """
    inputs = tuple(recording.inputs if inputs is None else inputs)
    outputs = tuple([n for n in recording.names if n not in inputs] if outputs is None else outputs)
    dt, x, y = checked_data(recording, inputs, outputs, skip_s)
    if period_s is None:
        spectra = segment_spectra(x, y, dt, len(x) * dt / 8 if segment_s is None else segment_s, overlap, window)
    else:
        spectra = period_spectra(x, y, dt, period_s)
    floor = (RANDOM_FLOOR if period_s is None else PERIODIC_FLOOR) if power_floor is None else power_floor
    keep = excited_lines(spectra.X, floor, is_periodic=period_s is not None)
    if not np.any(keep):
        raise BadRecording(
            f"no line above 0 Hz is excited by all of {', '.join(inputs)}; excite all inputs in one band"
        )
    kept = spectra.at(keep)
    H, coherence, variance = solve(kept, estimator)
    return MeasuredFrequencyResponse(
        freq=kept.freq,
        H=H,
        outputs=outputs,
        inputs=inputs,
        unit=response_unit(recording, inputs, outputs),
        coherence=coherence,
        variance=variance,
        n_averages=kept.n_effective,
        resolution_hz=kept.resolution_hz,
    )


def integrate(frf: FrequencyResponse) -> FrequencyResponse:
    """Divide by j omega: accelerance to mobility to receptance."""
    return _times_power_of_s(frf, -1)


def differentiate(frf: FrequencyResponse) -> FrequencyResponse:
    """Multiply by j omega: receptance to mobility to accelerance."""
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
    """Return mode shapes from the peaks of responses.

    Level and phase of each response at each natural frequency form the shape, as in the dissertation (section 5.4.1).
    The method suits well separated, lightly damped modes; `vlab.modal.poles.estimate_poles` separates close modes.

    Parameters
    ----------
    frf : FrequencyResponse
        Responses; integrate a mobility first for displacement shapes.
    frequencies : array of n_modes
        Approximate natural frequencies [Hz].
    half_width_hz : float
        Half width of the search for a peak [Hz].
    input : str
        Input of the used column, required with several inputs.
    per_output : bool
        Whether each output has its own peak. By default all outputs use the line of their largest common response.
        Phases then stay comparable, and a neighbour's flank is not taken for a nodal point's peak.
    normalise : bool
        Whether to divide each mode by its largest response.

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
