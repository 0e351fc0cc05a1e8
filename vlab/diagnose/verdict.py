"""The verdict: whether what was chosen explains enough, nothing is missing, or nothing in the catalogue explains the difference."""

from collections.abc import Callable, Sequence

import numpy as np

from vlab.diagnose.data_findings import DataFindings
from vlab.diagnose.diagnosis import Verdict
from vlab.diagnose.inference.model_choice import Choice
from vlab.diagnose.settings import GAP, PROBLEM, VERDICT
from vlab.diagnose.validation.gap import gap_closed, total, verifying
from vlab.diagnose.validation.simulation import Checked


def errors_of(checked: Sequence[Checked]) -> dict[str, float]:
    """Return the errors of the refitted and the amended model and the noise, over all recordings."""
    return {key: total(checked, key) for key in ("before", "after", "noise")}


def closes_gap(checked: Sequence[Checked], *, is_structure: bool) -> bool:
    """Return whether an amended model closes enough of the gap: of all recordings together, or nearly all of it in most of them and
    much in every one. A single recording goes far beyond the motion that a law was fitted to, and counts most.

    The gap is that of the recordings in which a finding does anything, from what the model leaves without the findings.
    """
    if any(run.after >= GAP.lost or _has_lost_a_channel(run) for run in checked):
        return False
    tests = verifying(checked)
    gaps = [gap for run in tests if (gap := gap_closed(run.start, run.after, run.noise)) is not None]
    if len(gaps) > 2 and np.median(gaps) >= VERDICT.nearly_all and min(gaps) >= VERDICT.least_to_noise:
        return True
    errors = {**errors_of(tests), "start": total(tests, "start")}
    gap = gap_closed(errors["start"], errors["after"], errors["noise"])
    reachable = float(np.hypot(errors["noise"], PROBLEM.mesh_own_error if is_structure else PROBLEM.model_error))
    share = gap_closed(errors["start"], errors["after"], reachable)
    least = VERDICT.least_near_noise if errors["after"] <= VERDICT.near_noise * errors["noise"] else VERDICT.least_gap
    return gap is not None and gap >= VERDICT.least_to_noise and max(gap, share or 0.0) >= least


def _has_lost_a_channel(run: Checked) -> bool:
    """Return whether an amended model leaves all of a channel that is more than noise."""
    return any(after >= GAP.lost and noise < 0.5 * GAP.lost for _, _, after, noise in run.channels.values())


def is_needed(choice: Choice, checked: Sequence[Checked], *, is_structure: bool) -> bool:
    """Return whether a choice that has no gap to close, for a refit follows with parameters that nobody believes, or as well as its mesh
    lets it, is better than that."""
    errors = errors_of(checked)
    no_gap = gap_closed(errors["before"], errors["after"], errors["noise"]) is None
    least = GAP.no_worse if choice.is_prior_driven else VERDICT.better
    before, after = errors["before"], errors["after"]
    if is_structure:  # what its mesh leaves bends the parameters, too: that they are unlikely says little
        no_gap, least = no_gap or not _shows("before", errors, is_structure=True), VERDICT.better_of_mesh
        before, after = (float(np.sqrt(max(e**2 - errors["noise"] ** 2, 0.0))) for e in (before, after))
    return choice.gained > 0 and (choice.is_prior_driven or no_gap) and after <= least * before


def _shows(which: str, errors: dict[str, float], *, is_structure: bool) -> bool:
    """Return whether the refitted (``"before"``) or amended model (``"after"``) leaves more than noise and what it leaves of itself."""
    if is_structure:
        return bool(errors[which] > np.hypot(VERDICT.above_noise * errors["noise"], PROBLEM.mesh_own_error))
    return errors[which] > max(VERDICT.above_noise * errors["noise"], VERDICT.least_misfit)


def residual_note(verdict: Verdict, checked: Sequence[Checked], *, is_structure: bool) -> list[str]:
    """Return in a sentence that an amended model leaves more than noise, where it does: two effects are sought at most."""
    errors = errors_of(checked)
    if verdict != "missing-physics" or not _shows("after", errors, is_structure=is_structure):
        return []
    times = errors["after"] / max(errors["noise"], 1e-300)
    return [
        f"the residual of the extended model is {times:.3g} times the noise: more may be missing; continue with vlab diagnose OUT/amended.toml"
    ]


def is_incoherent(checked: Sequence[Checked]) -> bool:
    """Return whether the model's residual has no coherence with inputs and motion: then it is noise, however coloured."""
    return total(checked, "before") <= VERDICT.above_noise * total(checked, "incoherent")


def coloured_noise_note(verdict: Verdict, checked: Sequence[Checked], *, is_structure: bool) -> list[str]:
    """Return in a sentence that more than the noise of the spectra's upper ends is left and counts as noise, where that is so."""
    errors = errors_of(checked)
    if verdict != "nothing-missing" or not _shows("before", errors, is_structure=is_structure):
        return []
    return [
        f"the residual is {100 * errors['before']:.2g} % of the recordings' rms and coherent with neither the inputs nor the motion: "
        "coloured noise"
    ]


def is_of_the_fit_alone(
    checked: Sequence[Checked], fitted: Callable[[], Sequence[Checked]], *, is_structure: bool
) -> bool:
    """Return whether findings explain the recordings to fit and do nothing in any recording kept aside, which then verifies none.

    Parameters
    ----------
    fitted : callable
        Gives how far the models are from the recordings to fit.
    """
    return bool(checked) and all(run.is_idle for run in checked) and closes_gap(fitted(), is_structure=is_structure)


def decide_verdict(
    choice: Choice,
    checked: Sequence[Checked],
    seen: DataFindings,
    *,
    is_structure: bool,
    fitted: Callable[[], Sequence[Checked]] = list,
) -> Verdict:
    """Return the verdict on recordings kept aside, or on those fitted where none are.

    Parameters
    ----------
    fitted : callable
        Gives how far the models are from the recordings to fit.
    """
    if seen.damage.fatal:
        return "bad-recording"
    errors = errors_of(checked)
    unexplained = _shows("before", errors, is_structure=is_structure)
    if not seen.is_missing and is_of_the_fit_alone(checked, fitted, is_structure=is_structure):
        return "none-of-these"
    if (choice.best.terms or seen.is_missing) and closes_gap(checked, is_structure=is_structure):
        return "missing-physics"
    is_followed = errors["before"] <= VERDICT.above_noise * errors["noise"] or (is_structure and not unexplained)
    # there is no gap to close where coarse steps count as noise, or no recording kept aside reaches a limit
    shows = bool(seen.steps or seen.stops) and errors["after"] <= GAP.no_worse * errors["before"]
    tests = not all(run.is_idle for run in checked)
    if is_followed and (shows or (tests and is_needed(choice, checked, is_structure=is_structure))):
        return "missing-physics"
    if not unexplained or is_incoherent(checked):
        return "nothing-missing"
    return "bad-recording" if seen.damage.warnings else "none-of-these"
