"""Notes on what a verdict leaves open."""

from collections.abc import Sequence

from vlab.diagnose.diagnosis import NAMING, Verdict
from vlab.diagnose.model_kinds.model_kind import ModelKind
from vlab.diagnose.settings import VERDICT
from vlab.diagnose.validation.checked import Checked
from vlab.diagnose.validation.gap import total
from vlab.diagnose.verdict import errors_of
from vlab.files.text import in_digits


def residual_note(verdict: Verdict, checked: Sequence[Checked], *, model_kind: ModelKind) -> list[str]:
    """Return a note where the residual exceeds the noise.

    Parameters
    ----------
    verdict : Verdict
        Verdict.
    checked : sequence of Checked
        Errors on recordings.
    model_kind : ModelKind
        Kind of the nominal model.

    Returns
    -------
    list of str
        One note, or none.
    """
    errors = errors_of(checked)
    if verdict not in NAMING or not model_kind.is_mismatch(errors["after"], errors["noise"]):
        return []
    times = errors["after"] / max(errors["noise"], 1e-300)
    return [f"the residual of the extended model is {in_digits(times)} times the noise: more may be missing"]


def is_gaussian(checked: Sequence[Checked]) -> bool:
    """Return whether every residual may be stationary Gaussian noise.

    The test has the false-alarm rate of the verdict. Physics that comes and goes, as an intermittent contact, has
    bursts. Noise that rings up a lightly damped mode has bursts as well.
    """
    rate = VERDICT.false_alarm_rate / max(len(checked), 1)
    return all(c.is_gaussian(rate) for c in checked)


def coloured_noise_note(verdict: Verdict, checked: Sequence[Checked], *, model_kind: ModelKind) -> list[str]:
    """Return a note where a coloured residual counts as noise.

    Parameters
    ----------
    verdict : Verdict
        Verdict.
    checked : sequence of Checked
        Errors on recordings.
    model_kind : ModelKind
        Kind of the nominal model.

    Returns
    -------
    list of str
        One note, or none.
    """
    errors = errors_of(checked)
    if verdict != "nothing-missing" or not model_kind.is_mismatch(errors["before"], errors["noise"]):
        return []
    what = "coloured noise"
    if not is_gaussian(checked):
        what += ", or physics that comes and goes, for the residual has bursts that stationary noise has not"
    return [
        f"the residual is {100 * errors['before']:.2g} % of the recordings' rms and coherent with neither the inputs nor the motion: "
        f"{what}"
    ]


def fit_note(verdict: Verdict, checked: Sequence[Checked], *, model_kind: ModelKind) -> list[str]:
    """Return a note where only fitted recordings show a mismatch.

    Parameters
    ----------
    verdict : Verdict
        Verdict.
    checked : sequence of Checked
        Errors on hold-out recordings.
    model_kind : ModelKind
        Kind of the nominal model.

    Returns
    -------
    list of str
        One note, or none.
    """
    if verdict != "none-of-these" or not checked:
        return []
    if model_kind.is_mismatch(total(checked, "before"), total(checked, "noise")):
        return []
    return ["the model follows the hold-out recordings; the mismatch shows in the fitted recordings only"]
