"""Check of a case before a diagnosis.

The check sets each channel beside its simulation, and names mistakes of the file and limits of a diagnosis. The check
simulates every recording once with the nominal model, and fits nothing but the initial state.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from vlab.cases.case import Case, load_case
from vlab.cases.channel_map import Run
from vlab.cases.checks import check_recordings
from vlab.cases.checks.bands import spectra
from vlab.cases.checks.shifts import shift
from vlab.cases.compare import RunComparison, compare_case
from vlab.diagnose.data.noise import estimate_noise
from vlab.diagnose.data.quality import assess_quality
from vlab.diagnose.precheck.duration import expected_seconds
from vlab.diagnose.precheck.refusals import refusals, unseen_joints
from vlab.diagnose.precheck.responses import band_of_power, has_responses_alone, precheck_responses
from vlab.diagnose.precheck.result import ChannelCheck, Precheck, Remark, remarks_of_file, worst_first
from vlab.diagnose.settings import PRECHECK
from vlab.errors import Diverged
from vlab.recordings.quality import findings, quantisation_step
from vlab.signals import Array


def precheck_case(
    path: Path | str,
    *,
    allow_outside: bool = False,
    progress: Callable[[float, str], None] = lambda share, what: None,
) -> Precheck:
    """Check a case before a diagnosis.

    A case of frequency responses and modal tables is compared with the linearised model.

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
    loaded = load_case(path, allow_outside=allow_outside)
    if has_responses_alone(loaded):
        return precheck_responses(loaded)
    try:
        comparison = compare_case(loaded, progress=progress)
    except Diverged as error:
        return _diverged(loaded, str(error))
    simulated_s = time.process_time() - began
    case, runs = comparison.case, [r.run for r in comparison.runs]
    channels = [check for r in comparison.runs for check in _channels(r)]
    refused = [*comparison.check.of("fatal"), *refusals(case, runs, comparison.check)]
    remarks = [
        *remarks_of_file(comparison.check),
        *_of_runs(runs),
        *(Remark(channel="", what=note) for note in getattr(case.plant, "notes", ())),
        *(Remark(channel="", what=text) for text in unseen_joints(case.plant, runs)),
    ]
    return Precheck(
        title=case.table.title,
        comparison=comparison,
        channels=tuple(channels),
        remarks=worst_first(list({remark.what: remark for remark in remarks}.values())),
        refused=tuple(dict.fromkeys(refused)),
        seconds_expected=None if refused else expected_seconds(case, runs, simulated_s),
    )


def _diverged(case: Case, why: str) -> Precheck:
    """Return the check of a case whose simulation diverges."""
    runs = case.runs()
    found = check_recordings(case, runs)
    return Precheck(
        title=case.table.title,
        comparison=None,
        channels=(),
        remarks=(*remarks_of_file(found), *_of_runs(runs)),
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
        step = quantisation_step(measured[name][measured.is_read(name)])
        of_step = 0.0 if step is None else step / np.sqrt(12.0)
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
                noise=max(noise.rms, of_step),
                noise_source=noise.words if noise.rms >= of_step else "from the steps of the readings",
                step=step,
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
    return band_of_power(freq, np.abs(spectrum) ** 2)


# ---- observations ------------------------------------------------------------------------------------------------


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
