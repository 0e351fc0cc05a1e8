"""Check of frequency responses and modal tables before a diagnosis.

Each response stands beside that of the linearised model, each modal table beside the model's modes. Nothing is fitted.
"""

import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.data.responses import Modes, Response, read_measured
from vlab.diagnose.frequency_pipeline import FORMS, is_in_frequency
from vlab.diagnose.precheck.result import ChannelCheck, Precheck, Remark, remarks_of_file, worst_first
from vlab.diagnose.predictors.frequency_problem import prepare_frequency
from vlab.diagnose.predictors.level_answer import answer_at_level
from vlab.diagnose.settings import PRECHECK
from vlab.diagnose.validation.frequency import apart, heard, modal_answer, modal_errors, nominal_model
from vlab.diagnose.validation.response_checks import check_responses
from vlab.errors import BadRecording, VlabError
from vlab.signals import Array, ComplexArray

BEYOND = (
    "the check of frequency data compares responses and modes with the model as given; delays, sample periods and noise "
    "over time need a [[recording]]"
)
"""BEYOND: limit of the check of frequency data."""


def has_responses_alone(case: Case) -> bool:
    """Return whether a diagnosis would use the frequency data of a case.

    Parameters
    ----------
    case : Case
        Case.

    Returns
    -------
    bool
        Whether frequency data are fitted, or are all that the case has.
    """
    has_responses = bool(case.table.frf or case.table.modal)
    return is_in_frequency(case) or (has_responses and not case.recordings(("fit", "holdout")))


def precheck_responses(case: Case) -> Precheck:
    """Check the frequency responses and modal tables of a case.

    Parameters
    ----------
    case : Case
        Case with frequency data.

    Returns
    -------
    Precheck
        One channel for every output of a response, one remark for every modal table.

    Raises
    ------
    BadRecording
        A file is damaged or contradicts the case.
    """
    remarks = [Remark(channel="", what=BEYOND)]
    remarks += [Remark(channel="", what=note) for note in getattr(case.plant, "notes", ())]
    try:
        problem = prepare_frequency(case)
        file = check_responses(problem)
    except BadRecording:
        raise
    except VlabError as error:
        return _checked(case, [], remarks, [str(error)])
    view, state = nominal_model(problem.plant, problem.wires).seen()
    channels: list[ChannelCheck] = []
    for data in read_measured(case, ("fit", "holdout")):
        if isinstance(data, Response):
            channels += _channels(data, answer_at_level(view, state, data, problem.wires).H)
        else:
            errors = modal_errors(data, modal_answer(view, state, data))
            remarks.append(Remark(channel=data.name, what=_words_on_modes(data, errors)))
    if not problem.held_out:
        what = "nothing is held out; the diagnosis leaves out one part after another to verify what is found"
        remarks.append(Remark(channel="", what=what))
    return _checked(case, channels, [*remarks_of_file(file), *remarks], list(file.of("fatal")))


def _checked(case: Case, channels: list[ChannelCheck], remarks: list[Remark], refused: list[str]) -> Precheck:
    return Precheck(
        title=case.table.title,
        comparison=None,
        channels=tuple(channels),
        remarks=worst_first(remarks),
        refused=tuple(refused),
        seconds_expected=None,
    )


def _channels(data: Response, own: ComplexArray) -> list[ChannelCheck]:
    """Return one check for every output of a response."""
    error = np.sqrt(np.nanmean(apart(data, own), axis=0))
    usable = heard(data)
    out = []
    for k, output in enumerate(data.outputs):
        measured, model = data.H[usable[:, k], k], own[usable[:, k], k]
        if data.is_magnitude:
            measured, model = np.abs(measured), np.abs(model)
        low, high = band_of_power(data.freq, np.abs(data.H[:, k]) ** 2)
        sizes = _rms(measured) * _rms(model)
        out.append(
            ChannelCheck(
                recording=data.name,
                role=data.role,
                channel=f"{output} per {data.input}",
                unit=FORMS[data.order],
                is_input=False,
                recorded_rms=_rms(measured),
                simulated_rms=_rms(model),
                correlation=float(np.mean((np.conj(measured) * model).real)) / sizes if sizes > 0.0 else None,
                nrmse=float(error[k]),
                low_hz=low,
                high_hz=high,
                noise=_rms(data.noise[:, k]),
                noise_source="coherence or variance of the file, or roughness over the lines",
            )
        )
    return out


def _rms(values: Array | ComplexArray) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2))) if values.size else 0.0


def _words_on_modes(data: Modes, errors: dict[str, Array]) -> str:
    """Return one line on a modal table beside the modes of the model."""
    rms = {name: f"{100 * float(np.sqrt(np.mean(error**2))):.3g} %" for name, error in errors.items()}
    parts = [f"the rms difference of the {name} is {share}" for name, share in rms.items()]
    return f"{data.name} ({data.role}): {data.n} modes beside those of the model: {', '.join(parts)}"


def band_of_power(freq: Array, power: Array) -> tuple[float | None, float | None]:
    """Return the band of most of a spectrum's power.

    Parameters
    ----------
    freq : (n,) array
        Lines [Hz].
    power : (n,) array
        Power at the lines.

    Returns
    -------
    tuple of float or None
        Quantiles of the cumulated power [Hz]; None without power.
    """
    cumulated = np.cumsum(power)
    if not cumulated[-1] > 0.0:
        return None, None
    edge = (1.0 - PRECHECK.band_share) / 2.0
    low, high = np.searchsorted(cumulated, [edge * cumulated[-1], (1.0 - edge) * cumulated[-1]])
    return float(freq[low]), float(freq[min(high, len(freq) - 1)])
