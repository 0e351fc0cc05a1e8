"""A diagnosis in a few plain sentences."""

from vlab.diagnose.frequency_pipeline import FrequencyDiagnosed
from vlab.diagnose.pipeline import Diagnosed


def verdict_sentence(done: Diagnosed | FrequencyDiagnosed) -> str:
    """Return the verdict in one plain sentence."""
    diagnosis = done.diagnosis
    errors = diagnosis.heldout
    spoilt_note = any(c.is_spoilt for c in diagnosis.checked)
    where = (
        "recordings that were never used in the search" if diagnosis.is_held_out else "the recordings it was fitted to"
    )
    if diagnosis.verdict == "missing-physics":
        names = " and ".join(f"{f.effect.replace('-', ' ')} at {f.place}" for f in diagnosis.findings)
        gap = errors["gap_closed"]
        own = "itself, as given or refitted," if spoilt_note else "its refitted self"
        if gap is None:
            return f"The model leaves out {names}."
        closed = f"closes {100 * gap:.0f} % of the gap between {own} and the noise on {where}"
        return f"The model leaves out {names}; with it the model {closed}."
    if diagnosis.verdict == "nothing-missing":
        left = _ratio(errors["nrmse_before"], errors["nrmse_noise"])
        how = (
            "as given or with its uncertain parameters refitted"
            if spoilt_note
            else "with its uncertain parameters refitted"
        )
        return f"Nothing is missing: {how} the model leaves {left} on {where}."
    if diagnosis.attempt is not None and diagnosis.attempt.is_of_the_fit_alone:
        left = _ratio(errors["nrmse_before"], errors["nrmse_noise"])
        return (
            f"{diagnosis.attempt.name} explains the recordings to fit, and does nothing in those kept aside, of which the model without it "
            f"leaves {left} already: nothing is verified."
        )
    if diagnosis.verdict == "none-of-these":
        left = _ratio(errors["nrmse_before"], errors["nrmse_noise"])
        how = "The model, as given or refitted," if spoilt_note else "The refitted model"
        return f"{how} leaves {left} on {where}, and no effect of the catalogue explains it."
    return "The recordings are damaged, so nothing is said of the model."


def _ratio(error: float | None, noise: float | None) -> str:
    if error is None:
        return "more than it can follow"
    if not noise:
        return f"{100 * error:.3g} % of the recordings' rms"
    return f"{100 * error:.3g} % of the recordings' rms, {error / noise:.3g} times the noise,"


def summary(done: Diagnosed | FrequencyDiagnosed) -> list[str]:
    """Return the paragraphs under the title: the verdict, what it means, and what limits it."""
    diagnosis = done.diagnosis
    out = [verdict_sentence(done)]
    for finding in diagnosis.findings:
        out.append(f"{finding.name}: {finding.words}.")
        if len(finding.alike) > 1:
            out.append(f"These recordings cannot tell it from {', '.join(finding.alike[1:])}.")
    out += list(diagnosis.notes)
    out.append(f"Next measurement: {diagnosis.next_measurement}.")
    return out
