"""Check of a case before a diagnosis.

The check sets each channel beside its simulation, and names mistakes of the file and limits of a diagnosis. The check
simulates every recording once with the nominal model, and fits nothing but the initial state.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vlab.cases.case import load_case
from vlab.cases.channel_map import Run
from vlab.cases.checks import FileCheck, check_recordings
from vlab.cases.checks.bands import spectra
from vlab.cases.checks.shifts import shift
from vlab.cases.compare import Comparison, RunComparison, compare_case
from vlab.diagnose.data.noise import estimate_noise
from vlab.diagnose.data.quality import assess_quality
from vlab.diagnose.precheck.duration import expected_seconds
from vlab.diagnose.precheck.refusals import refusals, unseen_joints
from vlab.diagnose.settings import PRECHECK
from vlab.errors import Diverged
from vlab.recordings.quality import findings
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class ChannelCheck:
    """One channel of one recording.

    Parameters
    ----------
    recording, role, channel, unit : str
        Recording with its role, channel with its SI unit.
    is_input : bool
        Whether the channel drives the model.
    recorded_rms : float
        Rms about the mean [unit].
    simulated_rms : float or None
        Rms of the simulation about its mean [unit]; None for an input.
    correlation : float or None
        Correlation of recording and simulation, from -1 to 1.
    nrmse : float or None
        Rms error over the recorded rms.
    delay_s : float or None
        Shift of the recording behind the simulation with the smallest residual [s].
    left_now, left_shifted : float or None
        Share of the recorded power, in the mean over frequency bands, without and with the shift.
    period_s : float
        Median sample period [s].
    low_hz, high_hz : float or None
        Band that holds most of the power about the mean [Hz].
    noise : float or None
        Rms of the noise [unit]; None for an input.
    noise_source : str
        How the noise was obtained.
    """

    recording: str
    role: str
    channel: str
    unit: str
    is_input: bool
    recorded_rms: float
    simulated_rms: float | None = None
    correlation: float | None = None
    nrmse: float | None = None
    delay_s: float | None = None
    left_now: float | None = None
    left_shifted: float | None = None
    period_s: float
    low_hz: float | None = None
    high_hz: float | None = None
    noise: float | None = None
    noise_source: str = ""


@dataclass(frozen=True, kw_only=True)
class Remark:
    """One observation of a check.

    Parameters
    ----------
    channel : str
        Channel; empty for the whole case.
    what : str
        Observation.
    value : float or None
        Number of the observation, if there is one.
    mend : str
        Edit of the case or of the measurement; empty if none is needed.
    severity : str
        ``"fatal"``, ``"warning"`` or ``"note"``.
    """

    channel: str
    what: str
    value: float | None = None
    mend: str = ""
    severity: str = "note"


@dataclass(frozen=True, kw_only=True, eq=False)
class Precheck:
    """Result of a check.

    Parameters
    ----------
    comparison : Comparison or None
        Recordings beside their simulation; None where the simulation diverges.
    channels : tuple of ChannelCheck
        Channels of all recordings.
    remarks : tuple of Remark
        Observations, the worst first.
    refused : tuple of str
        Reasons for which a diagnosis would refuse the case.
    seconds_expected : float or None
        Rough time of a diagnosis [s]; None for a case that would be refused.
    """

    comparison: Comparison | None
    channels: tuple[ChannelCheck, ...]
    remarks: tuple[Remark, ...]
    refused: tuple[str, ...]
    seconds_expected: float | None

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document."""
        return {
            "findings": [asdict(remark) for remark in self.remarks],
            "refused": list(self.refused),
            "seconds_expected": self.seconds_expected,
            "channels": [asdict(channel) for channel in self.channels],
        }


def precheck_case(
    path: Path | str,
    *,
    allow_outside: bool = False,
    progress: Callable[[float, str], None] = lambda share, what: None,
) -> Precheck:
    """Check a case before a diagnosis.

    Parameters
    ----------
    path : path
        Folder or file of the case.
    allow_outside : bool
        Whether the case may name files outside its folder.
    progress : callable
        Receives the completed share and the present step.

    Returns
    -------
    Precheck
        Channels, observations and limits.

    Raises
    ------
    BadCase
        The case does not fit its model, or has a wrong time unit.
    BadRecording
        A file is damaged or contradicts the case.
    """
    began = time.process_time()  # not delayed by other work on the machine
    try:
        comparison = compare_case(path, allow_outside=allow_outside, progress=progress)
    except Diverged as error:
        return _diverged(path, allow_outside, str(error))
    simulated_s = time.process_time() - began
    case, runs = comparison.case, [r.run for r in comparison.runs]
    channels = [check for r in comparison.runs for check in _channels(r)]
    refused = [*comparison.check.of("fatal"), *refusals(case, runs, comparison.check)]
    remarks = [
        *_of_file(comparison.check),
        *_of_runs(runs),
        *(Remark(channel="", what=note) for note in getattr(case.plant, "notes", ())),
        *(Remark(channel="", what=text) for text in unseen_joints(case.plant, runs)),
    ]
    order = ("fatal", "warning", "note")
    return Precheck(
        comparison=comparison,
        channels=tuple(channels),
        remarks=tuple(sorted(remarks, key=lambda remark: order.index(remark.severity))),
        refused=tuple(dict.fromkeys(refused)),
        seconds_expected=None if refused else expected_seconds(case, runs, simulated_s),
    )


def _diverged(path: Path | str, allow_outside: bool, why: str) -> Precheck:
    """Return the check of a case whose simulation diverges."""
    case = load_case(path, allow_outside=allow_outside)
    runs = case.runs()
    found = check_recordings(case, runs)
    return Precheck(
        comparison=None,
        channels=(),
        remarks=(*_of_file(found), *_of_runs(runs)),
        refused=(f"the simulation diverges: {why}", *refusals(case, runs, found)),
        seconds_expected=None,
    )


# ---- channels ----------------------------------------------------------------------------------------------------


def _channels(compared: RunComparison) -> list[ChannelCheck]:
    run = compared.run
    measured = run.measured
    period = measured.sample_period
    out = []
    for drive in run.drives:
        values = measured[drive.channel]
        out.append(_input(run, drive.channel, values, period))
    misfits = {m.channel: m for m in compared.misfits}
    for c in (c for c in run.compared if c.channel in misfits):
        m, name = misfits[c.channel], c.channel
        moved = shift(measured.time, measured[name], compared.simulated[name])
        noise = estimate_noise(run, name)
        rms = _rms(measured[name][measured.is_read(name)])
        low, high = power_band(measured.time, measured[name])
        out.append(
            ChannelCheck(
                recording=run.name,
                role=run.role,
                channel=name,
                unit=m.unit,
                is_input=False,
                recorded_rms=rms,
                simulated_rms=rms / m.rms_ratio if m.rms_ratio > 0.0 else None,
                correlation=m.correlation,
                nrmse=m.nrmse,
                delay_s=None if moved is None else moved.seconds,
                left_now=None if moved is None else moved.before,
                left_shifted=None if moved is None else moved.after,
                period_s=period,
                low_hz=low,
                high_hz=high,
                noise=noise.rms,
                noise_source=noise.words,
            )
        )
    return out


def _input(run: Run, name: str, values: Array, period: float) -> ChannelCheck:
    low, high = power_band(run.measured.time, values)
    unit = run.measured.channels[run.measured.index(name)].unit
    return ChannelCheck(
        recording=run.name,
        role=run.role,
        channel=name,
        unit=unit,
        is_input=True,
        recorded_rms=_rms(values),
        period_s=period,
        low_hz=low,
        high_hz=high,
    )


def _rms(values: Array) -> float:
    return float(np.std(values)) if values.size else 0.0


def power_band(time: Array, values: Array) -> tuple[float | None, float | None]:
    """Return the band of most of a channel's power.

    Parameters
    ----------
    time : (n,) array
        Time stamps [s].
    values : (n,) array
        Samples.

    Returns
    -------
    tuple of float or None
        Quantiles of the cumulated power [Hz]; None for a constant channel.
    """
    if not np.ptp(values) > 0.0 or values.size < PRECHECK.least_samples:
        return None, None
    freq, (spectrum,) = spectra(time, values)
    power = np.cumsum(np.abs(spectrum) ** 2)
    if not power[-1] > 0.0:
        return None, None
    edge = (1.0 - PRECHECK.band_share) / 2.0
    low, high = np.searchsorted(power, [edge * power[-1], (1.0 - edge) * power[-1]])
    return float(freq[low]), float(freq[min(high, len(freq) - 1)])


# ---- observations ------------------------------------------------------------------------------------------------


def _of_file(check: FileCheck) -> list[Remark]:
    return [Remark(channel=", ".join(f.channels), what=f.what, mend=f.mend, severity=f.severity) for f in check.found]


def _of_runs(runs: Sequence[Run]) -> list[Remark]:
    """Return remarks on damage and on what a diagnosis lacks."""
    out = []
    for run in runs:
        for found in findings(run.measured):
            what = f"{run.name}: {found.text}"
            out.append(Remark(channel=found.channel, what=what, severity=found.severity))
    damage = assess_quality(runs, [run for run in runs if run.role == "fit"])
    out += [Remark(channel="", what=text, severity="fatal") for text in damage.fatal]
    if not any(run.role == "holdout" for run in runs):
        mend = 'role = "holdout" in a recording, or start_s and stop_s for a part of one'
        out.append(
            Remark(
                channel="",
                what="no recording is held out, so nothing verifies what is found",
                mend=mend,
                severity="warning",
            )
        )
    if not any(run.drives for run in runs):
        out.append(Remark(channel="", what="no channel drives the model; the recordings count as free motion"))
    return out
