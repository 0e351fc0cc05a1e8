"""A diagnosis in a few plain sentences."""

from vlab.diagnose.engine import Diagnosed
from vlab.diagnose.frequency.engine import FrequencyDiagnosed


def verdict_sentence(done: Diagnosed | FrequencyDiagnosed) -> str:
    """Return the verdict in one plain sentence."""
    diagnosis = done.diagnosis
    errors = diagnosis.heldout
    where = (
        "recordings that were never used in the search" if diagnosis.is_verified else "the recordings it was fitted to"
    )
    if diagnosis.verdict == "missing-physics":
        names = " and ".join(f"{f.effect.replace('-', ' ')} at {f.place}" for f in diagnosis.findings)
        gap = errors["gap_closed"]
        closed = (
            ""
            if gap is None
            else f"; with it the model closes {100 * gap:.0f} % of the gap between its refitted self and the noise on {where}"
        )
        return f"The model leaves out {names}{closed}."
    if diagnosis.verdict == "nothing-missing":
        left = _ratio(errors["nrmse_before"], errors["nrmse_noise"])
        return f"Nothing is missing: with its uncertain parameters refitted the model leaves {left} on {where}."
    if diagnosis.verdict == "none-of-these":
        left = _ratio(errors["nrmse_before"], errors["nrmse_noise"])
        return f"The refitted model leaves {left} on {where}, and no effect of the catalogue explains it."
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
