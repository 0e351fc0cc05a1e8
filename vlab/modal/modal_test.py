"""Modal test: frequency responses, poles and shapes from recordings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlab.errors import BadRecording
from vlab.modal.appropriation import AppropriatedForces, appropriate
from vlab.modal.combine import combine_responses, join_outputs
from vlab.modal.distortion import Distortion, separate_distortion
from vlab.modal.dwell import DwellResult, evaluate_dwell
from vlab.modal.free_response import estimate_free_response, free_signal
from vlab.modal.frf import Estimator, MeasuredFrequencyResponse, estimate_frf, peak_levels
from vlab.modal.given_responses import choose, displacement_unit, in_si, motion_of
from vlab.modal.impact import END_LEVEL, estimate_impact_frf, without_added_decay
from vlab.modal.poles import PoleEstimate, estimate_poles
from vlab.modal.recognise import FREE_KINDS, Signal, signal_of
from vlab.modal.steps import estimate_stepped_frf
from vlab.modal.turns import in_turns
from vlab.signals import ORDER, Array, FrequencyResponse, Recording, check_sizes

SETTLING_SHARE = 0.5
"""SETTLING_SHARE [1]: share of the periods dropped at the start of a periodic record, for decay of the transient."""
FINE_LINES, FINEST = 201, 1e-3
"""FINE_LINES [1]: number of lines over a peak for force appropriation.
FINEST [1]: smallest half width of a peak relative to its frequency."""
PEAK_WIDTH = 0.02
"""PEAK_WIDTH [1]: relative half width of the search for a peak, at most half the distance to the next."""


_OF_RECORDS = ("signal", "period_s", "segment_s", "dwell_s", "estimator", "end_level")


@dataclass(frozen=True, kw_only=True)
class ModalTest:
    """Settings of a modal test.

    Parameters
    ----------
    inputs, outputs : sequence of str
        Channel names; by default the recording's inputs and sensors.
    band_hz : (low, high)
        Band of the modes [Hz].
    n_modes : int or None
        Number of reported modes, the first ones in the band; by default as many as the data support.
    signal : str or None
        Excitation, one of `vlab.modal.recognise.KINDS`; by default from the recording's notes or samples.
    period_s : float or None
        Period of the excitation [s]; by default from the recording's notes.
    segment_s : float or None
        Length of segments of random data, or of blocks of bursts and blows [s].
    dwell_s : float or None
        Duration of each step of a stepped sine [s]; detected by default.
    end_level : float
        Value of a hammer's exponential window at the end of a block.
    """

    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    band_hz: tuple[float, float] | None = None
    n_modes: int | None = None
    estimator: Estimator = "H1"
    signal: str | None = None
    period_s: float | None = None
    segment_s: float | None = None
    dwell_s: float | None = None
    end_level: float = END_LEVEL

    def __post_init__(self) -> None:
        if self.n_modes is not None and self.n_modes < 1:
            raise BadRecording(f"{self.n_modes} modes cannot be reported; accepted: whole numbers from 1")
        if not 0 < self.end_level <= 1:
            raise BadRecording(
                f"the exponential window leaves {self.end_level:g} at its end; accepted: above 0 up to 1"
            )
        for name in ("period_s", "segment_s", "dwell_s"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise BadRecording(f"{name} is {value:g} s; accepted: finite times above 0")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ModalTestResult:
    """Responses of every recording, and their common poles.

    All sensors are converted to displacements.

    Parameters
    ----------
    signals : tuple of Signal
        Excitation of each recording; empty for given responses.
    distortion : tuple of Distortion
        Noise and nonlinear distortion of each input with periodic data.
    forces : tuple of AppropriatedForces
        With several inputs: forces of a dwell for each mode.
    skipped_s : tuple of float or None
        Time dropped at the start of each periodic recording [s]; None for any other excitation.
    notes : tuple of str
        Remarks on given responses, one sentence each.
    """

    responses: tuple[MeasuredFrequencyResponse, ...]
    mean: MeasuredFrequencyResponse
    poles: PoleEstimate
    signals: tuple[Signal, ...] = ()
    distortion: tuple[Distortion, ...] = ()
    forces: tuple[AppropriatedForces, ...] = ()
    skipped_s: tuple[float | None, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Return one line a mode."""
        found = self.poles
        head = f"<ModalTestResult: {found.freq.size} modes from {len(self.mean.inputs)} inputs, {len(self.mean.outputs)} outputs>"
        rows = zip(found.freq, found.zeta, found.confidence, strict=True)
        return "\n".join([head, *(f"  {hz:.4g} Hz, zeta {zeta:.3g}, confidence {c:.2f}" for hz, zeta, c in rows)])

    def n_given(self) -> int:
        """Return the number of responses of one output to one input."""
        return sum(len(frf.outputs) * len(frf.inputs) for frf in self.responses)

    def misfit_band(self) -> tuple[float, float]:
        """Return the band with the middle 90 % of the residual [Hz]."""
        fitted = self.poles.fitted
        rows = np.searchsorted(self.mean.freq, fitted.freq)
        left = np.cumsum(np.sum(np.abs(self.mean.H[rows] - fitted.H) ** 2, axis=(1, 2)))
        low, high = fitted.freq[np.searchsorted(left, [0.05 * left[-1], 0.95 * left[-1]])]
        return float(low), float(high)

    def still_ringing(self) -> Array:
        """Return each mode's remaining transient, (n_modes,), in 0 to 1.

        The value is exp(-zeta omega t) with the shortest time t dropped from a periodic record; 0 for any other
        excitation. The remaining transient differs between periods and counts as noise. Its common part biases the
        damping.
        """
        times = [time for time in self.skipped_s if time is not None]
        omega = 2 * np.pi * self.poles.freq
        return np.asarray(np.exp(-self.poles.zeta * omega * min(times))) if times else np.zeros(omega.size)

    def peak_shapes(self) -> Array:
        """Return peak-picked shapes, (n_outputs, n_modes).

        The method is the dissertation's (section 5.4.1): level and phase of each displacement at the line of the
        largest common response. The input with the strongest response to the mode is used. The largest component is 1;
        every further component is its part in phase or in opposition.
        """
        freq, spacing = self.poles.freq, float(np.median(np.diff(self.mean.freq)))
        shapes = []
        for j, hz in enumerate(freq):
            nearest = np.min(np.abs(np.delete(freq, j) - hz), initial=np.inf) / 2
            width = max(min(PEAK_WIDTH * hz, nearest), spacing)
            at = int(np.argmin(np.abs(self.mean.freq - hz)))
            into = self.mean.inputs[int(np.argmax(np.linalg.norm(self.mean.H[at], axis=0)))]
            shapes.append(peak_levels(self.mean, hz, width, input=into)[0].real)
        return np.array(shapes).reshape(freq.size, len(self.mean.outputs)).T

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        estimate, shapes, peaks = self.poles, self.poles.real_shapes(), self.peak_shapes()
        outputs = self.mean.outputs
        document: dict[str, Any] = {
            "frf": [_response(f) for f in self.responses],
            "signals": [{"kind": s.kind, "recognised": s.is_recognised} for s in self.signals],
            "modes": [
                {
                    "hz": float(estimate.freq[j]),
                    "zeta": float(estimate.zeta[j]),
                    "shape": dict(zip(outputs, shapes[:, j].tolist(), strict=True)),
                    "peak_shape": dict(zip(outputs, peaks[:, j].tolist(), strict=True)),
                    "confidence": float(estimate.confidence[j]),
                    "hz_sd": float(estimate.freq_sd[j]),
                    "zeta_sd": float(estimate.zeta_sd[j]),
                }
                for j in range(len(estimate.freq))
            ],
            "residual": estimate.residual,
            "distortion": [_distortion(part) for part in self.distortion],
            "notes": list(self.notes),
        }
        for mode, left in zip(document["modes"], self.still_ringing().tolist(), strict=True):
            mode["transient_left"] = left
        if len(self.mean.inputs) > 1:
            for mode, shape in zip(document["modes"], estimate.real_participation().T.tolist(), strict=True):
                mode["input_shape"] = dict(zip(self.mean.inputs, shape, strict=True))
        for mode, forces in zip(document["modes"], self.forces, strict=False):
            named = dict(zip(forces.inputs, forces.forces.tolist(), strict=True))
            mode["dwell"] = {"hz": forces.hz, "indicator": forces.indicator, "forces": named}
        return document


def _response(frf: MeasuredFrequencyResponse) -> dict[str, Any]:
    return {
        "inputs": list(frf.inputs),
        "outputs": list(frf.outputs),
        "unit": frf.unit,
        "freq_hz": frf.freq.tolist(),
        "real": frf.H.real.tolist(),
        "imag": frf.H.imag.tolist(),
        "coherence": None if frf.coherence is None else frf.coherence.tolist(),
        "added_decay_1_s": frf.added_decay,
    }


def _distortion(part: Distortion) -> dict[str, Any]:
    return {
        "input": part.input,
        "realisations": part.realisations,
        "periods": part.periods,
        "levels": part.levels(),
        "freq_hz": part.freq.tolist(),
        "noise_sd": part.noise_sd.tolist(),
        "total_sd": None if part.total_sd is None else part.total_sd.tolist(),
    }


def run_modal_test(recordings: Sequence[Recording], test: ModalTest) -> ModalTestResult:
    """Estimate responses of recordings and their common poles.

    Recordings of one input are realisations and averaged. Recordings of different inputs form columns, which separates
    close modes (a test with several references).

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of one rate.
    test : ModalTest
        Settings.

    Returns
    -------
    ModalTestResult
        Responses, poles, distortion and forces.

    Raises
    ------
    BadRecording
        No data, incompatible recordings, or an error of the estimators.
    """
    recordings = in_turns(recordings)
    signals = read_signals(recordings, test)
    if any(signal.kind == "dwell" for signal in signals):
        raise BadRecording("a dwell holds one mode and gives no frequency response; test dwells by themselves")
    rates = sorted({round(recording.rate, 6) for recording in recordings})
    if len(rates) > 1:
        raise BadRecording(
            f"the recordings have rates from {rates[0]:g} to {rates[-1]:g} Hz; test those of one rate together"
        )
    responses = tuple(_estimate(r, test, s) for r, s in zip(recordings, signals, strict=True))
    is_free = {signal.kind in FREE_KINDS for signal in signals}
    if len(is_free) > 1:
        raise BadRecording("records with and without an input have no common response; test them one by one")
    combined = combine_responses(responses)
    kinds = [recordings[0].channels[recordings[0].index(n)].kind for n in combined.outputs]
    mean = combined if True in is_free else as_displacement(combined, kinds)
    noted = {tuple(r.meta.get("band_hz", ())) for r in recordings}  # of a sweep, whose force leaks beyond
    band: Any = test.band_hz or (noted.pop() if len(noted) == 1 else ()) or None
    poles = estimate_poles(mean, sample_rate=recordings[0].rate, band_hz=band, n_modes=test.n_modes)
    poles = without_added_decay(poles, mean.added_decay)
    return ModalTestResult(
        responses=responses,
        mean=mean,
        poles=poles,
        signals=signals,
        distortion=_distortions(recordings, signals, responses),
        forces=_forces(poles) if len(mean.inputs) > 1 and mean.added_decay == 0 else (),
        skipped_s=tuple(
            _skip_s(r, s) if s.kind == "periodic" else None for r, s in zip(recordings, signals, strict=True)
        ),
    )


def run_response_test(
    responses: Sequence[FrequencyResponse], test: ModalTest, *, notes: Sequence[str] = ()
) -> ModalTestResult:
    """Estimate the common poles of given responses.

    Responses of different outputs to one input are put together. Responses of one output to one input are averaged, and
    responses to different inputs form columns.

    Parameters
    ----------
    responses : sequence of FrequencyResponse
        Responses, each with the unit of its motion per unit input.
    test : ModalTest
        Settings; settings of records in time must keep their defaults.
    notes : sequence of str
        Remarks on the responses for the result.

    Returns
    -------
    ModalTestResult
        Responses, poles and forces; without excitations.

    Raises
    ------
    BadRecording
        No response, a unit without a motion, incompatible responses, or a setting of records in time.
    UnknownName
        No such input or output.
    """
    if not responses:
        raise BadRecording("no frequency response was given")
    for name in _OF_RECORDS:
        if getattr(test, name) != getattr(ModalTest, name):
            raise BadRecording(f"{name} belongs to records in time; leave it out, the frequency responses are given")
    chosen = choose([in_si(response) for response in responses], test.inputs, test.outputs)
    moved = [
        replace(as_displacement(frf, [motion_of(frf)] * len(frf.outputs)), unit=displacement_unit(frf))
        for frf in chosen
    ]
    mean = combine_responses(join_outputs(moved))
    poles = without_added_decay(estimate_poles(mean, band_hz=test.band_hz, n_modes=test.n_modes), mean.added_decay)
    return ModalTestResult(
        responses=chosen,
        mean=mean,
        poles=poles,
        forces=_forces(poles) if len(mean.inputs) > 1 and mean.added_decay == 0 else (),
        notes=tuple(notes),
    )


def run_dwell_test(recording: Recording, test: ModalTest) -> DwellResult:
    """Evaluate one mode of a recorded dwell.

    `run_modal_test` states the errors.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    test : ModalTest
        Settings of the test.

    Returns
    -------
    DwellResult
        Shape, indicator and decay.
    """
    (signal,) = read_signals([recording], test)
    if signal.kind != "dwell":
        raise BadRecording(f"the excitation is {signal.kind}, not a dwell; give --signal dwell where it is one")
    inputs, outputs = _channels(recording, test)
    order = np.array([ORDER.get(recording.channels[recording.index(name)].kind, 0) for name in outputs])
    return evaluate_dwell(
        recording, signal.steps[0], inputs=inputs, outputs=outputs, derivatives=order, drive_s=signal.drive_s
    )


def read_signals(recordings: Sequence[Recording], test: ModalTest) -> tuple[Signal, ...]:
    """Return the excitation of each recording.

    `run_modal_test` states the errors.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of a test.
    test : ModalTest
        Settings of the test.

    Returns
    -------
    tuple of Signal
        One signal a recording.
    """
    if not recordings:
        raise BadRecording("no recording was given")
    return tuple(_signal(recording, test) for recording in recordings)


def _signal(recording: Recording, test: ModalTest) -> Signal:
    inputs, outputs = _channels(recording, test)
    if not inputs or test.signal in FREE_KINDS:
        return free_signal(recording, outputs, kind=test.signal)
    times = {"period_s": test.period_s, "segment_s": test.segment_s, "dwell_s": test.dwell_s}
    return signal_of(recording, inputs[0], kind=test.signal, **times)


def as_displacement(frf: MeasuredFrequencyResponse, kinds: Sequence[str]) -> MeasuredFrequencyResponse:
    """Return responses integrated to displacements.

    Velocities and accelerations are integrated in the frequency domain (section 5.4.1). Shapes of different sensors
    then share one unit.

    Parameters
    ----------
    frf : MeasuredFrequencyResponse
        Responses above 0 Hz.
    kinds : sequence of str
        Kind of each output.

    Returns
    -------
    MeasuredFrequencyResponse
        Displacements per unit input.
    """
    powers = np.array([ORDER.get(kind, 0) for kind in kinds])
    factor = (frf.added_decay + 2j * np.pi * frf.freq[:, None]) ** -powers[None, :]
    variance = None if frf.variance is None else frf.variance * np.abs(factor[:, :, None]) ** 2
    return replace(frf, H=frf.H * factor[:, :, None], variance=variance, unit="m/N" if np.any(powers) else frf.unit)


def estimate_responses(recordings: Sequence[Recording], test: ModalTest) -> tuple[MeasuredFrequencyResponse, ...]:
    """Estimate the responses of each recording, without poles.

    `run_modal_test` states the errors.
    """
    recordings = in_turns(recordings)
    signals = read_signals(recordings, test)
    return tuple(_estimate(r, test, s) for r, s in zip(recordings, signals, strict=True))


def _channels(recording: Recording, test: ModalTest) -> tuple[tuple[str, ...], tuple[str, ...]]:
    check_sizes(recording, "the recording")
    inputs = test.inputs or recording.inputs
    sensed = [c.name for c in recording.channels if c.kind in ORDER]
    outputs = test.outputs or tuple(name for name in sensed if name not in inputs)
    if not outputs:
        raise BadRecording(
            f"the recording has no sensor; name outputs with --output (channels: {', '.join(recording.names)})"
        )
    return tuple(inputs), tuple(outputs)


def _estimate(recording: Recording, test: ModalTest, signal: Signal) -> MeasuredFrequencyResponse:
    inputs, outputs = _channels(recording, test)
    common: dict[str, Any] = {"inputs": inputs, "outputs": outputs, "estimator": test.estimator}
    if signal.kind in FREE_KINDS:
        return estimate_free_response(
            recording, signal, outputs=outputs, end_level=test.end_level, segment_s=test.segment_s
        )
    if signal.kind == "stepped":
        return estimate_stepped_frf(recording, signal.steps, **common)
    if signal.kind == "impact":
        return estimate_impact_frf(recording, block_s=test.segment_s, end_level=test.end_level, **common)
    if signal.kind == "burst":
        return estimate_frf(recording, segment_s=signal.block_s, overlap=0.0, window="boxcar", **common)
    skip = _skip_s(recording, signal)
    if skip is None and test.period_s is None:
        # random, or too short for two periods: averaged over windowed segments
        return estimate_frf(recording, segment_s=test.segment_s, **common)
    return estimate_frf(recording, period_s=signal.period_s, skip_s=skip or 0.0, **common)


def _skip_s(recording: Recording, signal: Signal) -> float | None:
    """Return the time dropped from periodic data [s].

    None for fewer than two periods.
    """
    if signal.period_s is None:
        return None
    periods = int((len(recording) + 0.5) / recording.rate / signal.period_s)
    return signal.period_s * min(int(SETTLING_SHARE * periods), periods - 2) if periods >= 2 else None


def _distortions(
    recordings: Sequence[Recording], signals: Sequence[Signal], responses: Sequence[MeasuredFrequencyResponse]
) -> tuple[Distortion, ...]:
    """Separate noise and distortion for each input.

    All recordings of the input must have one period.
    """
    groups: dict[str, list[int]] = {}
    for i, (recording, signal, response) in enumerate(zip(recordings, signals, responses, strict=True)):
        if signal.kind == "periodic" and len(response.inputs) == 1 and _skip_s(recording, signal) is not None:
            groups.setdefault(response.inputs[0], []).append(i)
    parts = []
    for input, members in groups.items():
        period = signals[members[0]].period_s
        if period is None or any(signals[i].period_s != period for i in members):
            continue
        skip = max(_skip_s(recordings[i], signals[i]) or 0.0 for i in members)
        parts.append(
            separate_distortion(
                [recordings[i] for i in members],
                input=input,
                outputs=responses[members[0]].outputs,
                period_s=period,
                skip_s=skip,
            )
        )
    return tuple(parts)


def _forces(poles: PoleEstimate) -> tuple[AppropriatedForces, ...]:
    """Appropriate forces to each mode on the fitted responses.

    The fit is free of noise and has lines finer than a peak.
    """
    chosen = []
    for hz, zeta, shape in zip(poles.freq, poles.zeta, poles.real_shapes().T, strict=True):
        width = max(zeta, FINEST) * hz
        low, high = poles.fitted.freq[0], poles.fitted.freq[-1]
        fine = np.linspace(max(hz - width, low), min(hz + width, high), FINE_LINES)
        chosen.append(appropriate(poles.on_lines(fine), hz, 2 * width, shape=shape))
    return tuple(chosen)
