"""Frequency responses of a checked recording: measured, calibrated and extended."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import signal

from vlab.diagnose.validation.checked import Checked
from vlab.errors import VlabError
from vlab.modal.frf import estimate_frf
from vlab.signals import FrequencyResponse, Recording
from vlab.views.figures import to_svg
from vlab.views.figures.diagnosis import response_figure

POWERFUL = 1e-3
"""POWERFUL [-]: share of the input's largest power density above which a response is drawn."""
COHERENT = 0.8
"""COHERENT [-]: coherence above which a line shows the structure; a figure needs half of its lines above."""
LEAST_LINES = 8
"""LEAST_LINES [lines]: fewest lines of a figure."""


def responses(run: Checked, name: str) -> list[tuple[str, str]]:
    """Return the response of a channel to the strongest input.

    The input that explains most of the channel is drawn. The result is empty without a varying input, with uneven samples,
    with few lines, or where the coherence is low.

    Parameters
    ----------
    run : Checked
        Checked recording.
    name : str
        Name of the channel.

    Returns
    -------
    list of (svg, caption)
        Drawing, if there is one.
    """
    inputs = [n for n in run.measured.inputs if np.ptp(run.measured[n]) > 0]
    if not inputs or not run.measured.is_uniform:
        return []
    strongest = max(inputs, key=lambda n: float(np.std(run.measured[n])))
    curves: list[tuple[str, FrequencyResponse]] = []
    try:
        for label, recording in (("measured", run.measured), (run.stands, run.standing), ("extended", run.extended)):
            if recording is not None:
                frf = estimate_frf(recording, inputs=inputs, outputs=[name])
                if not curves:
                    strongest = _explaining(frf, run.measured, inputs)
                column = inputs.index(strongest)
                low, high = _driven_band(run.measured[strongest], run.measured.rate, len(frf.freq))
                frf = frf.between(max(low, frf.freq[0]), min(high, frf.freq[-1]))
                curves.append((label, replace(frf, H=frf.H[:, :, [column]], inputs=(strongest,), variance=None)))
    except VlabError:  # record too short, or inputs indistinguishable: no response
        return []
    first = curves[0][1]
    coherent = first.coherence is not None and np.mean(first.coherence > COHERENT) > 0.5
    if len(first.freq) < LEAST_LINES or not coherent:
        return []
    output, source = (run.measured.channels[run.measured.index(n)] for n in (name, strongest))
    return [
        (
            to_svg(response_figure(curves, output, source)),
            f"Frequency response (H1) of {name} to {strongest} in {run.name}.",
        )
    ]


def _explaining(frf: FrequencyResponse, recording: Recording, inputs: Sequence[str]) -> str:
    """Return the input whose power explains most of the output."""
    shares = []
    for column, name in enumerate(inputs):
        freq, power = signal.welch(recording[name], recording.rate, nperseg=min(2 * len(frf.freq), len(recording)))
        shares.append(float(np.sum(np.abs(frf.H[:, 0, column]) ** 2 * np.interp(frf.freq, freq, power))))
    return inputs[int(np.argmax(shares))]


def _driven_band(values: Any, rate: float, lines: int) -> tuple[float, float]:
    """Return the frequency range with substantial input power [Hz]."""
    freq, power = signal.welch(values, rate, nperseg=min(2 * lines, len(values)))
    there = freq[1:][power[1:] > POWERFUL * power[1:].max()]
    return float(there[0]), float(there[-1])
