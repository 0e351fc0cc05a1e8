"""Summary of a diagnosis in plain sentences."""

from vlab.cases.case import Case
from vlab.diagnose.advice import share
from vlab.diagnose.frequency_pipeline import FrequencyDiagnosed
from vlab.diagnose.pipeline import Diagnosed
from vlab.files.text import as_sentence, in_digits
from vlab.views.reports.page import Headline


def verdict_sentence(done: Diagnosed | FrequencyDiagnosed) -> str:
    """Return the verdict in one plain sentence.

    Parameters
    ----------
    done : Diagnosed or FrequencyDiagnosed
        Completed diagnosis.

    Returns
    -------
    str
        Sentence with gap or residual.
    """
    diagnosis = done.diagnosis
    errors = diagnosis.heldout
    is_nominal = any(c.stands == "nominal" for c in diagnosis.checked)
    where = "recordings to which nothing was fitted" if diagnosis.is_held_out else "the recordings it was fitted to"
    if diagnosis.is_naming:
        names = " and ".join(f"{f.effect.replace('-', ' ')} at {f.site}" for f in diagnosis.findings)
        if diagnosis.verdict == "unknown-law":
            return (
                f"No effect of the catalogue explains the recordings; a tabulated force at {diagnosis.findings[0].site} explains "
                f"{share(diagnosis.explained or 0.0)} of the mean-square mismatch on {where}."
            )
        if diagnosis.verdict != "missing-physics":
            return (
                f"The model leaves out {names}, and more: the extended model explains {share(diagnosis.explained or 0.0)} of the "
                f"mean-square mismatch on {where}."
            )
        gap = errors["gap_closed"]
        own = "the nominal or calibrated model" if is_nominal else "the calibrated model"
        if gap is None:
            return f"The model leaves out {names}."
        closed = f"closes {100 * gap:.0f} % of the gap between {own} and the noise on {where}"
        return f"The model leaves out {names}; the extended model {closed}."
    if diagnosis.verdict == "nothing-missing":
        left = _ratio(errors["nrmse_before"], errors["nrmse_noise"])
        how = "nominal or calibrated" if is_nominal else "calibrated"
        return f"Nothing is missing: the residual of the {how} model is {left} on {where}."
    if diagnosis.attempt is not None and diagnosis.attempt.is_of_the_fit_alone:
        left = _ratio(errors["nrmse_before"], errors["nrmse_noise"])
        return (
            f"{diagnosis.attempt.name} explains the fit recordings and has no effect on the held-out recordings, where the residual "
            f"without it is {left} already: nothing is verified."
        )
    if diagnosis.verdict == "none-of-these":
        left = _ratio(errors["nrmse_before"], errors["nrmse_noise"])
        how = "nominal or calibrated" if is_nominal else "calibrated"
        sentence = f"The residual of the {how} model is {left} on {where}; no effect of the catalogue explains it."
        if diagnosis.calibrated is None:
            return sentence
        removed = share(diagnosis.calibrated)
        return f"{sentence} Calibration alone removes {removed} of the nominal model's mean-square error."
    return "The recordings are damaged, so the model was not judged."


def _ratio(error: float | None, noise: float | None) -> str:
    if error is None:
        return "unbounded"
    if not noise:
        return f"{in_digits(100 * error)} % of the recordings' rms"
    return f"{in_digits(100 * error)} % of the recordings' rms, {in_digits(error / noise)} times the noise,"


BADGES = {
    "missing-physics": ("missing physics found", "found"),
    "partly-explained": ("partly explained", "found"),
    "unknown-law": ("place found, law unknown", "found"),
    "nothing-missing": ("nothing is missing", "fine"),
    "none-of-these": ("none of the catalogue", "open"),
    "bad-recording": ("recordings not usable", "stopped"),
}
"""BADGES: verdict in a few words, and tone of the badge."""


def headline(done: Diagnosed | FrequencyDiagnosed, *, is_in_folder: bool = True) -> Headline:
    """Return badge, sentence, errors before and after, and next command.

    Parameters
    ----------
    done : Diagnosed or FrequencyDiagnosed
        Completed diagnosis.
    is_in_folder : bool
        Whether the folder of the page holds the extended model and the Rerun file, which the next command opens.

    Returns
    -------
    Headline
        Head of the report.
    """
    diagnosis = done.diagnosis
    badge, tone = BADGES[diagnosis.verdict]
    errors, pair = diagnosis.heldout, []
    where = "on held-out recordings" if diagnosis.is_held_out else "on the fit recordings"
    if diagnosis.checked:
        before = "nominal or calibrated" if any(c.stands == "nominal" for c in diagnosis.checked) else "calibrated"
        named = [(f"error of the {before} model {where}", "nrmse_before")]
        named += [("error of the extended model", "nrmse_after")] if diagnosis.is_naming else []
        named.append(("noise", "nrmse_noise"))
        pair = [(label, f"{in_digits(100 * errors[key])} %") for label, key in named if errors[key] is not None]
    command = "vlab show ."
    if diagnosis.is_naming:
        command = "vlab compare amended.toml" if diagnosis.is_complete else "vlab diagnose amended.toml --out ../next"
    command = command if is_in_folder else ""
    return Headline(badge=badge, tone=tone, sentence=verdict_sentence(done), pair=pair, command=command)


def title_of(title: str, case: Case) -> str:
    """Return the title of a diagnosis.

    Parameters
    ----------
    title : str
        Title of the case; may be empty.
    case : Case
        Case of the diagnosis.

    Returns
    -------
    str
        Title, or the name of the folder or of the model of a case without one.
    """
    model = case.table.model
    named = title or ("" if case.in_memory else case.path.absolute().parent.name) or model.mjcf or model.structure
    return f"Diagnosis: {named}"


def summary(done: Diagnosed | FrequencyDiagnosed) -> list[str]:
    """Return the paragraphs under the headline: findings, notes, next measurement.

    Parameters
    ----------
    done : Diagnosed or FrequencyDiagnosed
        Completed diagnosis.

    Returns
    -------
    list of str
        Paragraphs.
    """
    diagnosis = done.diagnosis
    out = []
    for finding in diagnosis.findings:
        out.append(f"{finding.name}: {finding.words}.")
        if len(finding.alike) > 1:
            out.append(f"{finding.name} is indistinguishable from {', '.join(finding.alike[1:])} in these recordings.")
    out += [as_sentence(note) for note in diagnosis.notes]
    out.append(f"Next measurement: {diagnosis.next_measurement}.")
    return out
