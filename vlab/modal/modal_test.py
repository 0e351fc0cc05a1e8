"""A modal test: frequency responses, poles and shapes from one or several recordings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlab.errors import BadRecording
from vlab.modal.frf import Estimator, MeasuredFrequencyResponse, estimate_frf
from vlab.modal.poles import PoleEstimate, estimate_poles
from vlab.signals import Recording

SETTLING_SHARE = 0.5
"""Share of the periods of a periodic record that is left out at its start, for the transient to decay."""


@dataclass(frozen=True, kw_only=True)
class ModalTest:
    """How to test.

    Parameters
    ----------
    inputs, outputs : sequence of str
        Channels; by default the inputs of the recording, and its sensors.
    band_hz : (low, high)
        Band in which modes are looked for.
    n_modes : int or None
        How many to report; as many as the data support by default.
    period_s : float or None
        Period of the excitation; by default what the recording says of itself, else the data count as random.
    """

    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    band_hz: tuple[float, float] | None = None
    n_modes: int | None = None
    estimator: Estimator = "H1"
    period_s: float | None = None
    segment_s: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalTestResult:
    """Responses of every recording, and the poles of their mean, all sensors as displacements."""

    responses: tuple[MeasuredFrequencyResponse, ...]
    mean: MeasuredFrequencyResponse
    poles: PoleEstimate

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        estimate, shapes = self.poles, self.poles.real_shapes()
        return {
            "frf": [_response(f) for f in self.responses],
            "modes": [
                {
                    "hz": float(estimate.freq[j]),
                    "zeta": float(estimate.zeta[j]),
                    "shape": dict(zip(self.mean.outputs, shapes[:, j].tolist(), strict=True)),
                    "confidence": float(estimate.confidence[j]),
                    "hz_sd": float(estimate.freq_sd[j]),
                    "zeta_sd": float(estimate.zeta_sd[j]),
                }
                for j in range(len(estimate.freq))
            ],
            "residual": estimate.residual,
        }


def _response(frf: MeasuredFrequencyResponse) -> dict[str, Any]:
    return {
        "inputs": list(frf.inputs),
        "outputs": list(frf.outputs),
        "unit": frf.unit,
        "freq_hz": frf.freq.tolist(),
        "real": frf.H.real.tolist(),
        "imag": frf.H.imag.tolist(),
        "coherence": None if frf.coherence is None else frf.coherence.tolist(),
    }


def run_modal_test(recordings: Sequence[Recording], test: ModalTest) -> ModalTestResult:
    """Estimate responses of each recording and the poles of their average.

    Raises
    ------
    BadRecording
        Nothing to test, recordings that do not go together, or one of the refusals of `estimate_frf`, `estimate_poles`.
    """
    responses = estimate_responses(recordings, test)
    first = responses[0]
    for other in responses[1:]:
        same = other.freq.shape == first.freq.shape and np.allclose(other.freq, first.freq)
        if not same or (other.inputs, other.outputs) != (first.inputs, first.outputs):
            raise BadRecording(
                "the recordings differ in channels or frequency lines and have no common average; test them one by one"
            )
    mean = first if len(responses) == 1 else _average(responses)
    receptance = _as_displacement(mean, recordings[0])
    poles = estimate_poles(receptance, sample_rate=recordings[0].rate, band_hz=test.band_hz, n_modes=test.n_modes)
    return ModalTestResult(responses=responses, mean=receptance, poles=poles)


def _average(responses: Sequence[MeasuredFrequencyResponse]) -> MeasuredFrequencyResponse:
    coherences = [f.coherence for f in responses if f.coherence is not None]
    variances = [f.variance for f in responses if f.variance is not None]
    complete = len(variances) == len(responses)
    return replace(
        responses[0],
        H=np.mean([f.H for f in responses], axis=0),
        coherence=np.mean(coherences, axis=0) if len(coherences) == len(responses) else None,
        variance=np.mean(variances, axis=0) / len(responses) if complete else None,
    )


def _as_displacement(frf: MeasuredFrequencyResponse, recording: Recording) -> MeasuredFrequencyResponse:
    """Return the responses with velocities and accelerations integrated in the frequency domain (section 5.4.1).

    Mode shapes of different kinds of sensors then stand in one unit.
    """
    order = {"velocity": 1, "angular-velocity": 1, "acceleration": 2, "angular-acceleration": 2}
    powers = np.array([order.get(recording.channels[recording.index(name)].kind, 0) for name in frf.outputs])
    factor = (2j * np.pi * frf.freq[:, None]) ** -powers[None, :]
    variance = None if frf.variance is None else frf.variance * np.abs(factor[:, :, None]) ** 2
    return replace(frf, H=frf.H * factor[:, :, None], variance=variance, unit="m/N" if np.any(powers) else frf.unit)


def estimate_responses(recordings: Sequence[Recording], test: ModalTest) -> tuple[MeasuredFrequencyResponse, ...]:
    """Estimate the responses of each recording, without looking for poles; raises as `run_modal_test` does."""
    if not recordings:
        raise BadRecording("no recording was given")
    return tuple(_estimate(recording, test) for recording in recordings)


def _estimate(recording: Recording, test: ModalTest) -> MeasuredFrequencyResponse:
    inputs = test.inputs or recording.inputs
    if not inputs:
        raise BadRecording(
            f"the recording marks no input; name one with --input (channels: {', '.join(recording.names)})"
        )
    sensed = [
        c.name
        for c in recording.channels
        if c.kind in ("velocity", "displacement", "acceleration", "angle", "angular-velocity")
    ]
    outputs = test.outputs or tuple(name for name in sensed if name not in inputs)
    if not outputs:
        raise BadRecording(
            f"the recording has no sensor; name outputs with --output (channels: {', '.join(recording.names)})"
        )
    period = test.period_s if test.period_s is not None else recording.meta.get("period_s")
    periods = 0 if period is None else int((len(recording) + 0.5) / recording.rate / float(period))
    if period is None or test.segment_s is not None or (periods < 2 and test.period_s is None):
        # not periodic, or too short to show that it is: averaged over windowed segments
        return estimate_frf(
            recording, inputs=inputs, outputs=outputs, estimator=test.estimator, segment_s=test.segment_s
        )
    skip = float(period) * min(int(SETTLING_SHARE * periods), max(periods - 2, 0))
    return estimate_frf(
        recording, inputs=inputs, outputs=outputs, estimator=test.estimator, period_s=float(period), skip_s=skip
    )
