"""Analytical and measured response of a run."""

import numpy as np

from vlab.controllers.linear import LinearController
from vlab.fe.second_order import Quantity
from vlab.hardware.back_emf import brake_model
from vlab.lab.prediction import closed_loop_response
from vlab.lab.run_folder import PreparedRun
from vlab.modal.frf import MeasuredFrequencyResponse
from vlab.modal.modal_test import ModalTest, estimate_responses
from vlab.signals import Array, FrequencyResponse, Recording

SENSED: dict[str, Quantity] = {"velocity": "velocity", "displacement": "displacement"}
"""Measured quantity by kind of sensor."""
UNITS = {"velocity": "m/s/N", "displacement": "m/N"}
"""SI unit of the response by kind of sensor."""


def measured_response(recording: Recording, kind: str = "velocity") -> MeasuredFrequencyResponse | None:
    """Return the responses of sensors to a periodic excitation.

    A run of fewer than two periods, or with another excitation, has leakage and gives no response.

    Parameters
    ----------
    recording : Recording
        Recording of the run.
    kind : str
        Kind of the sensors, ``"velocity"`` or ``"displacement"``.

    Returns
    -------
    MeasuredFrequencyResponse or None
        H1 responses; None without sensors or periods.
    """
    period = recording.meta.get("period_s")
    outputs = tuple(c.name for c in recording.channels if c.kind == kind)
    if (
        period is None
        or not outputs
        or not recording.inputs
        or (len(recording) + 0.5) / recording.rate < 2 * float(period)
    ):
        return None
    return estimate_responses([recording], ModalTest(outputs=outputs))[0]


def analytical_response(
    prepared: PreparedRun, recording: Recording, freq: Array, kind: str = "velocity"
) -> FrequencyResponse | None:
    """Return the FE model's response of the loop.

    The loop includes hold, delay, filter and braking coils.

    Parameters
    ----------
    prepared : PreparedRun
        Prepared run.
    recording : Recording
        Recording in SI.
    freq : array
        Frequencies [Hz].
    kind : str
        Kind of the sensors.

    Returns
    -------
    FrequencyResponse or None
        None if the excitation has no input channel, or the law is nonlinear.
    """
    law, fe = prepared.law, brake_model(prepared.fe_model(), prepared.hardware)
    if not recording.inputs or kind not in SENSED or not (law is None or isinstance(law, LinearController)):
        return None
    excited = fe.deflection(recording.channels[recording.index(recording.inputs[0])].at)[:, None]
    parts, names, share = [], [], prepared.hardware.velocity_sensor.signal_share
    for channel in (c for c in recording.channels if c.kind == kind):
        row, quantity = fe.deflection(channel.at)[None, :], SENSED[channel.kind]
        row = share * row if channel.kind == "velocity" else row
        if law is None:
            parts.append(fe.linear.frequency_response(freq, excited, row, quantity=quantity).H)
        else:
            parts.append(
                closed_loop_response(
                    fe.linear,
                    fe.deflections(law.actuators).T,
                    law,
                    prepared.hardware.converter,
                    freq,
                    sensors=share * fe.deflections(law.sensors),
                    excited=excited,
                    outputs=row,
                    quantity=quantity,
                )
            )
        names.append(channel.name)
    return FrequencyResponse(
        freq=np.asarray(freq),
        H=np.concatenate(parts, axis=1),
        outputs=tuple(names),
        inputs=recording.inputs[:1],
        unit=UNITS[kind],
    )
