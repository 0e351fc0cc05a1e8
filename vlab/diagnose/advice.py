"""Notes of a diagnosis: possibilities not excluded, and the next measurement."""

import math
from collections.abc import Collection, Sequence

import numpy as np

from vlab.diagnose.diagnosis import NAMING, Attempt, Verdict
from vlab.diagnose.inference.model_choice import Choice
from vlab.diagnose.model_kinds.model_kind import ModelKind
from vlab.diagnose.parameters.mjcf import Uncertain, prior_deviations
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.settings import ADVICE, GAP, MODEL_CHOICE, VERDICT
from vlab.diagnose.validation.checked import Checked
from vlab.diagnose.validation.gap import Distance, total, whole_gap
from vlab.diagnose.verdict import errors_of
from vlab.files.text import in_digits
from vlab.physics.catalogue import CANDIDATES, EFFECTS
from vlab.physics.effect import Effect
from vlab.physics.family import separating_measurement
from vlab.signals import Array

_AGAIN = "a repetition on another day, with the same excitation at a third of the level"
RESERVED = f"{100 * MODEL_CHOICE.lapse:.2g} % of every probability is reserved for physics outside the catalogue"
"""Note on the probability of physics outside the catalogue."""


RATIO_OF_SEARCH = (
    "residual / noise: of the search, on the fit recordings, where the expected error of the model counts as noise"
)
"""Note on the residuals of alternatives, whose noise is not that of the table of errors."""


OF_ERRORS = "errors: a share of the recording, so 0.01 is 1 %; gap closed: (calibrated - extended)/(calibrated - noise)"
"""Note on the table of errors, whose numbers have no unit."""


def share(part: float) -> str:
    """Return a share in per cent, 100 only where nothing is left.

    Parameters
    ----------
    part : float
        Share [1].

    Returns
    -------
    str
        Percentage, whole, and with two decimals rounded down where it would read 100 %.
    """
    whole = f"{100 * part:.0f}"
    return f"{math.floor(1e4 * part) / 100:g} %" if whole == "100" and part < 1.0 else f"{whole} %"


def format_probability(probability: float) -> str:
    """Return a probability as text."""
    return f"{probability:.3f}" if probability >= ADVICE.least_probability else f"< {ADVICE.least_probability:g}"


def scope_note(effects: Sequence[Effect], at: Collection[str]) -> tuple[str, ...]:
    """Return a note on a restricted search.

    Parameters
    ----------
    effects : sequence of Effect
        Candidate effects.
    at : collection of str
        Places at which effects are sought; empty for all.

    Returns
    -------
    tuple of str
        One note, or none.
    """
    names = {effect.name for effect in effects}
    left_out = sum(effect.name not in names for effect in CANDIDATES)
    left = [f"{left_out} of {len(CANDIDATES)} effects of the catalogue"] if left_out else []
    left += [f"all places but {', '.join(at)}"] if at else []
    return (f"not searched, as asked: {' and '.join(left)}",) if left else ()


def before_heading(checked: Sequence[Distance]) -> str:
    """Return the table heading of errors without findings."""
    return "nominal or calibrated" if any(c.stands == "nominal" for c in checked) else "calibrated"


def spoilt_note(checked: Sequence[Distance]) -> tuple[str, ...]:
    """Return a note on recordings where calibration increases the error.

    Parameters
    ----------
    checked : sequence of Distance
        Errors.

    Returns
    -------
    tuple of str
        One note, or none.
    """
    worse = [c for c in checked if c.calibrated > GAP.no_worse * c.nominal]
    if not worse:
        return ()
    each = ", ".join(f"{c.name} (error {_error(c.calibrated)}, nominal {_error(c.nominal)})" for c in worse)
    return (
        f"the calibrated model is worse than the nominal model on {each}: the gap counts from the nominal model there",
    )


def notes_on_models(checked: Sequence[Distance]) -> tuple[str, ...]:
    """Return notes on failures of the nominal and the calibrated model.

    Parameters
    ----------
    checked : sequence of Distance
        Errors.

    Returns
    -------
    tuple of str
        Notes.
    """
    return (*diverged_note(checked), *spoilt_note(checked), *refuted_note(checked))


def diverged_note(checked: Sequence[Distance]) -> tuple[str, ...]:
    """Return a note on recordings where the nominal model diverges.

    Parameters
    ----------
    checked : sequence of Distance
        Errors.

    Returns
    -------
    tuple of str
        One note, or none.
    """
    names = [c.name for c in checked if np.isinf(c.nominal)]
    if not names:
        return ()
    return (
        f"the simulation of the model as given diverges on {', '.join(names)}: give the model a shorter timestep, or the "
        'integrator "implicitfast"',
    )


def refuted_note(checked: Sequence[Distance]) -> tuple[str, ...]:
    """Return a note on recordings that a model of implausible parameters follows.

    Parameters
    ----------
    checked : sequence of Distance
        Errors.

    Returns
    -------
    tuple of str
        One note, or none.
    """
    refuted = [c for c in checked if c.is_refuted]
    if not refuted:
        return ()
    each = ", ".join(f"{c.name} (error {_error(c.calibrated)})" for c in refuted)
    return (
        f"the calibrated model follows {each} as well, but only with implausible parameters: the gap counts from the nominal model",
    )


def _error(error: float) -> str:
    return f"{error:.3g}" if np.isfinite(error) else "beyond all bounds"


def idle_note(checked: Sequence[Distance]) -> tuple[str, ...]:
    """Return notes on findings without effect in hold-out recordings.

    Parameters
    ----------
    checked : sequence of Distance
        Errors with a part per finding.

    Returns
    -------
    tuple of str
        One note per unverifiable finding.
    """
    held = [c for c in checked if c.role == "holdout" and c.parts]
    out = []
    for i, part in enumerate(held[0].parts if held else ()):
        names = [c.name for c in held if c.parts[i].is_idle]
        if names:
            able = [c.name for c in held if c.name not in names]
            rest = (
                f"cannot verify it as {'; '.join(able)} can"
                if able
                else "cannot verify it, and no other recording is held out: it comes from the fit recordings alone"
            )
            out.append(f"{part.name} is within the noise in {', '.join(names)}, which {rest}")
    return tuple(out)


def attempt_sentence(attempt: Attempt) -> str:
    """Return a sentence on the best attempt and its closed gap.

    Parameters
    ----------
    attempt : Attempt
        Best attempt.

    Returns
    -------
    str
        Sentence.
    """
    if attempt.is_of_the_fit_alone:
        return (
            f"From the fit recordings alone: {attempt.name} explains the fit recordings and has no effect on the held-out "
            "recordings, which cannot verify it."
        )
    gap, left = whole_gap(attempt.checked), {key: total(attempt.checked, key) for key in ("before", "after", "noise")}
    closed = "" if gap is None else f"closes {100 * gap:.0f} % of the gap to the noise and "
    return (
        f"Best attempt, not a finding: {attempt.name} {closed}has a residual of {left['after']:.3g}, "
        f"from {left['before']:.3g} without it (noise {left['noise']:.3g})."
    )


def not_excluded(choice: Choice, verdict: str, reported: Sequence[Term]) -> tuple[str, ...]:
    """Return the possibilities that the recordings do not exclude.

    Parameters
    ----------
    choice : Choice
        Choice with alternatives.
    verdict : str
        Verdict.
    reported : sequence of Term
        Effects of the findings, which a check in MuJoCo may prefer to the choice.

    Returns
    -------
    tuple of str
        Possibilities.
    """
    out: list[str] = []
    if verdict in NAMING and choice.best.terms:
        labels, first = {term.label for term in reported}, choice.best.terms[0]
        others = [h.label for h in choice.alike if {term.label for term in h.terms} != labels]
        out += [f"{label} has as small a residual" for label in others[: ADVICE.most_alike]]
        likely = [p for p, share in choice.places.items() if share > ADVICE.likely_place and p != first.place.name]
        out += [f"{first.effect.name} at {p}" for p in likely if first.label in labels]
    elif verdict == "nothing-missing" or verdict in NAMING:
        out.append("effects smaller than the noise and the uncertainty of the model")
    else:
        tried = [h for h, _ in choice.tried if h.terms]
        out += [
            f"{h.label} was tried; its residual is {in_digits(h.normalised_residual)} times the noise"
            for h in tried[:3]
        ]
        out.append("physics that is not in the catalogue")
    return tuple(out)


def implausible_parameters(parameters: Sequence[Uncertain], theta: Array) -> tuple[str, ...]:
    """Return notes on uncertain parameters far from their priors.

    A missing effect that only changes a value is absorbed by calibration of that value.

    Parameters
    ----------
    parameters : sequence of Uncertain
        Uncertain parameters.
    theta : (n_parameters,) array
        Log factors.

    Returns
    -------
    tuple of str
        One note per implausible parameter.
    """
    deviations = prior_deviations(theta, np.array([p.may_vanish for p in parameters], dtype=bool))
    return tuple(
        f"{p.name} was calibrated by {_change(p, float(v))}, {abs(d) / p.sd:.1f} of its standard deviations: check the value, "
        "state a wider [model.uncertain], or look for missing physics there"
        for p, v, d in zip(parameters, theta, deviations, strict=True)
        if abs(d) > ADVICE.far_off * p.sd
    )


def _change(parameter: Uncertain, value: float) -> str:
    if parameter.shifted:
        return f"{100.0 * value:+.3g} % of the radius of gyration"
    return f"{1e3 * value:+.2g} mm" if parameter.kind == "place" else f"{100.0 * float(np.expm1(value)):+.3g} %"


def next_measurement(choice: Choice, verdict: str, shown: Sequence[str] = (), attempt: Attempt | None = None) -> str:
    """Return the measurement that separates the remaining possibilities.

    Parameters
    ----------
    choice : Choice
        Choice with alternatives.
    verdict : str
        Verdict.
    shown : sequence of str
        Effects shown by the data alone.
    attempt : Attempt or None
        Best attempt, where nothing is reported.

    Returns
    -------
    str
        Measurement.
    """
    if attempt is not None and attempt.is_of_the_fit_alone:
        return f"another held-out recording, as loud as the fit recordings, so that {attempt.name} acts in it"
    if verdict == "bad-recording":
        return "the same recordings again, with the damage that is listed under their quality repaired"
    if verdict in NAMING and not choice.best.terms:
        return next((EFFECTS[name].confirmed_by for name in shown if EFFECTS[name].confirmed_by), _AGAIN)
    if verdict == "nothing-missing":
        return "a recording at a level several times higher, which brings out what grows with amplitude"
    if verdict == "none-of-these":
        return "a sensor on both sides of the place where the mismatch is largest, and three levels of a periodic excitation"
    firsts = [t for h in (choice.best, *choice.alike) for t in h.terms[:1]]
    families = {t.effect.family for t in firsts}
    is_of_both_ends = {"actuator", "sensor"} <= {t.place.name.partition(":")[0] for t in firsts}
    is_open = len(families) > 1 or len(choice.alike) > 1
    measurement = separating_measurement(families, is_of_both_ends=is_of_both_ends) if is_open else ""
    if measurement:
        return measurement
    if len([p for p in choice.places.values() if p > ADVICE.open_place]) > 1:
        return "a sensor between the remaining places, " + " and ".join(list(choice.places)[:2])
    return choice.best.terms[0].effect.traits.tested_by or _AGAIN


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


def _is_gaussian(checked: Sequence[Checked]) -> bool:
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
    if not _is_gaussian(checked):
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
