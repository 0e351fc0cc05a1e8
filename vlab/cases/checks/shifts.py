"""Outputs that are early or late beside a model by the same time in all bands of frequency."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vlab.cases.checks.bands import LINES, bands_of_spectra, spectra
from vlab.cases.checks.beside import FEWEST, Beside
from vlab.cases.checks.correction import Column, Found
from vlab.signals import Array

LONGEST = 0.1
"""Longest shift that is looked for, as a share of a recording."""
LEAST_SAMPLES = 1.5
"""Shortest one that is said: half a sample or a whole one is how inputs are held."""
SMALLER, MATTERS = 0.1, 0.01
"""A shift is said where it leaves this share of what is left without it, in the mean over bands, which must be this share of the power."""
SAME = 0.2
"""Relative difference of the shifts of all recordings, or half a sample."""
FINE = 20
"""Parts of a sample that a shift is found to."""


@dataclass(frozen=True, kw_only=True)
class Shift:
    """By what a recording is late.

    Parameters
    ----------
    seconds : float
        Negative where it is early.
    before, after : float
        What is left of the recorded power without and with it, in the mean over bands.
    """

    seconds: float
    before: float
    after: float


def shift(time: Array, recorded: Array, simulated: Array) -> Shift | None:
    """Return the shift of a recorded channel that leaves least; None where too few bands say something.

    Parameters
    ----------
    time : (n,) array
        [s].
    recorded, simulated : (n,) array
    """
    n, step = len(time), (time[-1] - time[0]) / (len(time) - 1)
    freq, (Y, S) = spectra(time, recorded, simulated)
    found = bands_of_spectra(freq, Y, S, lowest=(LINES - 1) * freq[1])
    if len(found) < FEWEST:
        return None
    inside = found.of_line >= 0
    cross = np.where(inside, Y * np.conj(S) / found.recorded[found.of_line], 0.0)  # all bands count alike
    lags = np.fft.fftfreq(n, 1.0 / n)
    along = np.fft.irfft(cross, n)
    best = float(lags[np.argmax(np.where(np.abs(lags) <= LONGEST * n, along, -np.inf))])
    fine = (best + np.arange(-FINE, FINE + 1) / FINE) * step
    likeness = np.real(np.exp(2j * np.pi * np.outer(fine, freq[inside])) @ cross[inside])
    seconds = float(fine[np.argmax(likeness)])
    moved = bands_of_spectra(freq, Y, S * np.exp(-2j * np.pi * freq * seconds), lowest=(LINES - 1) * freq[1])
    return Shift(seconds=seconds, before=float(found.remains().mean()), after=float(moved.remains().mean()))


def shifts(now: Beside, columns: Mapping[str, Column]) -> list[Found]:
    """Return the outputs that are early or late by the same time in all recordings.

    What is late may be physics, an effect of the catalogue; what is early by more than the model is late itself cannot be.
    """
    late = {name: seconds for name in now.channels if (seconds := _same_shift(now, name)) is not None}
    if len(late) > 1 and len(late) == sum(bool(of_runs) for of_runs in now.channels.values()):
        middle = float(np.median(list(late.values())))
        if all(abs(seconds - middle) <= SAME * abs(middle) for seconds in late.values()):
            return [_of_all(now, tuple(late), middle)]
    return [_of_one(name, seconds, columns[name]) for name, seconds in late.items()]


def _same_shift(now: Beside, name: str) -> float | None:
    """Return by what a channel is late in all recordings that say something of it; None where it is not, or differs."""
    found, step = [], 0.0
    for run, own in zip(now.runs, now.simulated, strict=True):
        if own is None or name not in run.measured.names:
            continue
        one = shift(run.measured.time, run.measured[name], own[name])
        step = max(step, float(np.median(np.diff(run.measured.time))))
        if one is not None:
            found.append(one)
    if not found or any(one.before < MATTERS or one.after > SMALLER * one.before for one in found):
        return None
    seconds = np.array([one.seconds for one in found])
    middle = float(np.median(seconds))
    if abs(middle) < LEAST_SAMPLES * step or np.any(np.abs(seconds - middle) > max(SAME * abs(middle), 0.5 * step)):
        return None
    return middle


def _of_one(name: str, seconds: float, column: Column) -> Found:
    size = f"{1e3 * abs(seconds):.3g} ms"
    if seconds > 0.0:
        text = (
            f"{name} is {size} late beside the model in every recording, all else the same: it was stamped late, or its sensor is late; "
            f'either shift the column, or state it: [[model.effect]] name = "sensor-delay", place = "{name}", '
            f"parameters = {{ delay = {seconds:.4g} }}"
        )
        return Found(severity="note", text=text, channels=(name,))
    text = f"{name} is {size} early beside the model in every recording, all else the same; shift the column in the file by as much"
    return Found(severity="note", text=text, channels=(name,))


def _of_all(now: Beside, names: tuple[str, ...], seconds: float) -> Found:
    inputs = " and ".join(dict.fromkeys(drive.channel for run in now.runs for drive in run.drives)) or "the model"
    how = "late" if seconds > 0.0 else "early"
    text = f"all outputs are {1e3 * abs(seconds):.3g} ms {how} beside {inputs} and the model, all else the same"
    text += "" if seconds > 0.0 else ": the inputs were stamped late"
    return Found(severity="note", text=text, channels=names)
