"""What a diagnosis says in words: what was not excluded, and the measurement that would decide."""

from collections.abc import Sequence

import numpy as np

from vlab.diagnose.diagnosis import Attempt
from vlab.diagnose.inference.model_choice import Choice
from vlab.diagnose.parameters.mjcf import Uncertain
from vlab.diagnose.settings import ADVICE, GAP, MODEL_CHOICE
from vlab.diagnose.validation.gap import Distance, total, whole_gap
from vlab.signals import Array

_SEPARATES = {
    frozenset(
        {"friction", "hysteresis"}
    ): "a slow quasi-static sweep through several amplitudes: the loop of dry friction has "
    "vertical sides at every amplitude, that of micro-slip a slope",
    frozenset(
        {"damping", "friction"}
    ): "releases or sine dwells at three amplitudes a factor of three apart: damping ratios that rise "
    "with amplitude speak for drag, falling ones for dry friction, constant ones for viscous damping",
    frozenset(
        {"nonlinear-stiffness", "clearance"}
    ): "sine dwells at three amplitudes below and above the gap, harmonics recorded",
    frozenset(
        {"nonlinear-stiffness", "contact"}
    ): "sine dwells at three amplitudes, harmonics recorded: a stop sets in at one amplitude",
    frozenset({"mass", "stiffness"}): "the same test with a known mass added at the place, or modes with a node there",
    frozenset(
        {"gain", "mass"}
    ): "a calibration of one actuator against a known force, or of one sensor against a known motion",
    frozenset({"gain", "stiffness"}): "a static test: a known force and the deflection it gives",
    frozenset(
        {"timing"}
    ): "excitation up to frequencies where a delay turns the phase by much more than a first-order lag",
    frozenset(
        {"saturation"}
    ): "the same excitation at a level that is twice as large, the actuator's own force recorded",
    frozenset({"mass"}): "the same test with a known mass moved along the structure",
    frozenset(
        {"stiffness"}
    ): "mode shapes at more points: a local loss of stiffness shows as a kink where its curvature is large",
}
_TESTS = {
    "mass": "the same test with a known mass added at the place: the frequencies must fall as with both",
    "stiffness": "a known force at the place, and the deflection that it gives",
    "damping": "releases from two heights: they tell how the decay changes with amplitude",
    "nonlinear-stiffness": "sine dwells near the resonance at two levels: its frequency must move as the law says",
    "friction": "the same excitation at a third of the level: dry friction must take three times its share",
    "clearance": "sine dwells with less and with more motion than the gap: the response must change its kind there",
    "contact": "the same excitation at a level that does not reach the contact: what was found must be gone",
    "bias": "readings at rest with the drive switched off and on",
    "disturbance": "a recording with the drive switched off: what was found must still be there",
    "hysteresis": "slow cycles to and fro at two amplitudes, force and motion recorded: their loops must open as the law says",
    "time-variation": "the same recording again, an hour later",
    "substructure": "a sensor on what swings along, or the same test with it held",
    "gain": "a calibration of one actuator against a known force, or of one sensor against a known motion",
    "saturation": "the same excitation at half the level, which stays clear of the limit: what was found must be gone",
    "timing": "a step of the command and its answer, sampled ten times as fast",
    "resolution": "the same excitation at ten times the level, where steps no longer matter",
    "actuator-position": "a known current in the coil at three positions of its travel, and the force that it gives",
    "sensor-dynamics": "a second sensor of another make beside it, over the whole band",
    "pick-up": "the same commands with the structure held: what the sensor still reads is not motion",
}
"""What a single finding of a family foretells, and can be refuted by."""
_AGAIN = "a repetition on another day, with the same excitation at a third of the level"
_CONFIRMS = {
    "actuator-clipping": "the same loop at half the level, where no command reaches the limit: the model must then do without it",
    "sensor-clipping": "the same excitation at a level at which the sensor stays within its range",
    "mains-hum": "a recording at rest with the leads routed otherwise: mains interference changes, motion does not",
    "sensor-offset": "a reading of the sensor at rest, before and after",
}


RESERVED = f"{100 * MODEL_CHOICE.lapse:.2g} % of every probability is reserved for physics outside the catalogue"


def format_probability(probability: float) -> str:
    """Return a probability as it is printed."""
    return f"{probability:.3f}" if probability >= ADVICE.least_probability else f"< {ADVICE.least_probability:g}"


def before_heading(checked: Sequence[Distance]) -> str:
    """Return what errors without the findings are headed with in a table."""
    return "nominal or calibrated" if any(c.is_spoilt for c in checked) else "calibrated"


def spoilt_note(checked: Sequence[Distance]) -> tuple[str, ...]:
    """Return in one sentence which recordings a refit takes the model further from; nothing where there are none."""
    worse = [c for c in checked if c.calibrated > GAP.no_worse * c.nominal]
    if not worse:
        return ()
    each = ", ".join(f"{c.name} (error {_error(c.calibrated)}, nominal {_error(c.nominal)})" for c in worse)
    return (
        f"the calibrated model is worse than the nominal model on {each}: the gap counts from the nominal model there",
    )


def _error(error: float) -> str:
    return f"{error:.3g}" if np.isfinite(error) else "beyond all bounds"


def idle_note(checked: Sequence[Distance]) -> tuple[str, ...]:
    """Return in a sentence each which findings no recording kept aside, or not every one, can verify."""
    held = [c for c in checked if c.role == "holdout" and c.parts]
    out = []
    for i, part in enumerate(held[0].parts if held else ()):
        names = [c.name for c in held if c.parts[i].is_idle]
        if names:
            rest = (
                "cannot verify it"
                if len(names) < len(held)
                else "cannot verify it, and no other recording is held out: it comes from the fit recordings alone"
            )
            out.append(f"{part.name} is within the noise in {', '.join(names)}, which {rest}")
    return tuple(out)


def attempt_sentence(attempt: Attempt) -> str:
    """Return in a sentence what the best attempt is worth."""
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


def not_excluded(choice: Choice, verdict: str) -> tuple[str, ...]:
    """Return what the recordings leave open."""
    out: list[str] = []
    if verdict == "missing-physics" and choice.best.terms:
        others = [h.label for h in choice.alike if h is not choice.best]
        out += [f"{label} has as small a residual" for label in others[:5]]
        best = choice.best.terms[0].place.name
        out += [
            f"{choice.best.terms[0].effect.name} at {p}"
            for p, share in choice.places.items()
            if share > 0.05 and p != best
        ]
    elif verdict in ("nothing-missing", "missing-physics"):
        out.append("effects smaller than the noise and the uncertainty of the model")
    else:
        tried = [h for h, _ in choice.tried if h.terms]
        out += [f"{h.label} was tried; its residual is {h.normalised_residual:.3g} times the noise" for h in tried[:3]]
        out.append("physics that is not in the catalogue")
    return tuple(out)


def implausible_parameters(parameters: Sequence[Uncertain], theta: Array) -> tuple[str, ...]:
    """Return which uncertain parameters a refit took further than chance would, at log-factors (n_parameters,).

    Physics that only changes a number hides there: a refit that may change the number takes it up.
    """
    return tuple(
        f"{p.name} was calibrated by {_change(p, float(v))}, {abs(v) / p.sd:.1f} of its standard deviations: check the value, "
        "state a wider [model.uncertain], or look for missing physics there"
        for p, v in zip(parameters, theta, strict=True)
        if abs(v) > ADVICE.far_off * p.sd
    )


def _change(parameter: Uncertain, value: float) -> str:
    return f"{1e3 * value:+.2g} mm" if parameter.kind == "place" else f"{100.0 * float(np.expm1(value)):+.2g} %"


def next_measurement(choice: Choice, verdict: str, shown: Sequence[str] = (), attempt: Attempt | None = None) -> str:
    """Return the measurement that would separate what is left.

    Parameters
    ----------
    shown : sequence of str
        Effects that the recordings show without any model.
    attempt : Attempt or None
        The best one, where nothing is reported.
    """
    if attempt is not None and attempt.is_of_the_fit_alone:
        return f"another held-out recording, as loud as the fit recordings, so that {attempt.name} acts in it"
    if verdict == "bad-recording":
        return "the same recordings again, with the damage that is listed under their quality repaired"
    if verdict == "missing-physics" and not choice.best.terms:
        return next((_CONFIRMS[name] for name in shown if name in _CONFIRMS), _AGAIN)
    if verdict == "nothing-missing":
        return "a recording at a level several times higher, which brings out what grows with amplitude"
    if verdict == "none-of-these":
        return "a sensor on both sides of the place where the mismatch is largest, and three levels of a periodic excitation"
    families = {t.effect.family for h in (choice.best, *choice.alike) for t in h.terms[:1]}
    if len(families) == 1:
        single = frozenset(families)
        if len(choice.alike) > 1 and single in _SEPARATES:
            return _SEPARATES[single]
    for pair, words in _SEPARATES.items():
        if pair <= families and len(pair) > 1:
            return words
    if len([p for p in choice.places.values() if p > 0.1]) > 1:
        return "a sensor between the remaining places, " + " and ".join(list(choice.places)[:2])
    return _TESTS.get(choice.best.terms[0].effect.family, _AGAIN)  # an effect of one's own may have a family of its own
