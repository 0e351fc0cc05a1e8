"""Time shifts of outputs, common to all frequency bands."""

from dataclasses import dataclass

import numpy as np

from vlab.cases.checks.bands import LINES, bands_of_spectra, spectra
from vlab.cases.checks.beside import FEWEST, Beside
from vlab.cases.checks.correction import Found
from vlab.signals import Array

LONGEST = 0.1
"""LONGEST [1]: largest shift tried, as a share of the recording."""
LEAST_SAMPLES = 1.5
"""LEAST_SAMPLES [samples]: smallest reported shift. Half a sample or one sample is due to the input hold."""
SMALLER, MATTERS = 0.1, 0.01
"""SMALLER [1]: largest ratio of the residual with the shift to the residual without, in the mean over bands.
MATTERS [1]: smallest residual share without the shift."""
SAME = 0.2
"""SAME [1]: relative tolerance on the shifts of all recordings; half a sample is allowed as well."""
FINE = 20
"""FINE [1]: subdivisions of a sample in the search for a shift."""


@dataclass(frozen=True, kw_only=True)
class Shift:
    """Delay of a recorded channel.

    Parameters
    ----------
    seconds : float
        Delay [s], negative for an early channel.
    before, after : float
        Mean residual share over bands, without and with the shift.
    """

    seconds: float
    before: float
    after: float


def shift(time: Array, recorded: Array, simulated: Array) -> Shift | None:
    """Return the shift with the smallest residual.

    Parameters
    ----------
    time : (n,) array
        Time stamps [s].
    recorded, simulated : (n,) array

    Returns
    -------
    Shift or None
        Shift; None with too few bands.
    """
    n, step = len(time), (time[-1] - time[0]) / (len(time) - 1)
    freq, (Y, S) = spectra(time, recorded, simulated)
    found = bands_of_spectra(freq, Y, S, lowest=(LINES - 1) * freq[1])
    if len(found) < FEWEST:
        return None
    inside = found.of_line >= 0
    cross = np.where(inside, Y * np.conj(S) / found.recorded[found.of_line], 0.0)  # equal weight for every band
    lags = np.fft.fftfreq(n, 1.0 / n)
    along = np.fft.irfft(cross, n)
    best = float(lags[np.argmax(np.where(np.abs(lags) <= LONGEST * n, along, -np.inf))])
    fine = (best + np.arange(-FINE, FINE + 1) / FINE) * step
    likeness = np.real(np.exp(2j * np.pi * np.outer(fine, freq[inside])) @ cross[inside])
    seconds = float(fine[np.argmax(likeness)])
    moved = bands_of_spectra(freq, Y, S * np.exp(-2j * np.pi * freq * seconds), lowest=(LINES - 1) * freq[1])
    return Shift(seconds=seconds, before=float(found.remains().mean()), after=float(moved.remains().mean()))


def shifts(now: Beside) -> list[Found]:
    """Return outputs with one shift in all recordings.

    A late output may be due to an effect of the catalogue. An output early by more than the model's own delay cannot be
    physical.

    Parameters
    ----------
    now : Beside
        Recordings and their simulation.

    Returns
    -------
    list of Found
        Findings.
    """
    late = {name: seconds for name in now.channels if (seconds := _same_shift(now, name)) is not None}
    if len(late) > 1 and len(late) == sum(bool(of_runs) for of_runs in now.channels.values()):
        middle = float(np.median(list(late.values())))
        if all(abs(seconds - middle) <= SAME * abs(middle) for seconds in late.values()):
            return [_of_all(now, tuple(late), middle)]
    is_only = sum(bool(of_runs) for of_runs in now.channels.values()) == 1
    inputs = _inputs(now) if is_only else ""
    return [_of_one(name, seconds, inputs) for name, seconds in late.items()]


def _same_shift(now: Beside, name: str) -> float | None:
    """Return the common delay of a channel [s].

    Returns
    -------
    float or None
        None without a shift, or with different shifts.
    """
    found, step = [], 0.0
    for run, own in zip(now.runs, now.simulated, strict=True):
        if own is None or name not in run.measured.names:
            continue
        one = shift(run.measured.time, run.measured[name], own[name])
        step = max(step, run.measured.sample_period)
        if one is not None:
            found.append(one)
    if not found or any(one.before < MATTERS or one.after > SMALLER * one.before for one in found):
        return None
    seconds = np.array([one.seconds for one in found])
    middle = float(np.median(seconds))
    if abs(middle) < LEAST_SAMPLES * step or np.any(np.abs(seconds - middle) > max(SAME * abs(middle), 0.5 * step)):
        return None
    return middle


def _of_one(name: str, seconds: float, inputs: str) -> Found:
    """Return the finding on one channel, beside inputs that may be late."""
    size = f"{1e3 * abs(seconds):.3g} ms"
    if seconds > 0.0:
        text = f"{name} is {size} late beside the model in every recording, all else the same: it was stamped late, "
        if inputs:  # no other output shows whether the input is late
            text += (
                f"its sensor is late, or {inputs} acts late, which one channel cannot tell; to state it of the sensor: "
            )
        else:
            text += "or its sensor is late; either shift the column, or state it: "
        text += f'[[model.effect]] name = "sensor-delay", place = "{name}", parameters = {{ delay = {seconds:.4g} }}'
        return Found(severity="note", text=text, channels=(name,))
    text = f"{name} is {size} early beside the model in every recording, all else the same; shift the column in the file by as much"
    return Found(severity="note", text=text, channels=(name,))


def _inputs(now: Beside) -> str:
    """Return the names of the driving channels."""
    return " and ".join(dict.fromkeys(drive.channel for run in now.runs for drive in run.drives))


def _of_all(now: Beside, names: tuple[str, ...], seconds: float) -> Found:
    inputs = _inputs(now)
    how = "late" if seconds > 0.0 else "early"
    beside = f"{inputs} and the model" if inputs else "the model"
    text = f"all outputs are {1e3 * abs(seconds):.3g} ms {how} beside {beside}, all else the same"
    if seconds < 0.0:
        text += ": the inputs were stamped late"
    elif inputs:
        text += f": {inputs} acts late, or all outputs were stamped late"
    return Found(severity="note", text=text, channels=names)
