"""Findings of a diagnosis, as reported."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from vlab.cases.channel_map import Run
from vlab.diagnose.diagnosis import NAMING, Finding, Verdict
from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.inference.model_choice import Choice
from vlab.diagnose.inference.parameter_vector import is_logarithm
from vlab.diagnose.model_kinds.model_kind import ModelKind
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.settings import FINDINGS
from vlab.diagnose.validation.gap import Distance
from vlab.physics.effect import Effect, Parameter
from vlab.plants.base import Plant
from vlab.units import at_rotation

TOLD: tuple[Verdict, ...] = ("missing-physics", "nothing-missing")
"""Verdicts with meaningful probabilities among the tried hypotheses."""


class Reportable(Protocol):
    """Parts of an inverse problem that name findings."""

    @property
    def model_kind(self) -> ModelKind:
        """Kind of the nominal model."""

    @property
    def plant(self) -> Plant:
        """Nominal plant."""

    @property
    def places(self) -> tuple[Place, ...]:
        """Locations."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs."""

    @property
    def runs(self) -> tuple[Run, ...]:
        """Recordings in time; none in a case of frequency data."""

    @property
    def excited(self) -> tuple[int | None, ...]:
        """Actuators whose inputs are recorded; None for a force at a port."""


def findings_of_terms(choice: Choice, fit: Fit, problem: Reportable) -> list[Finding]:
    """Return the findings of the chosen hypothesis.

    Parameters
    ----------
    choice : Choice
        Choice with alternatives and probabilities.
    fit : Fit
        Fit of the hypothesis.
    problem : Reportable
        Problem.

    Returns
    -------
    list of Finding
        One finding per term.
    """
    out = []
    for i, term in enumerate(fit.terms):
        parameters: dict[str, dict[str, Any]] = {}
        for parameter in term.effect.parameters:
            value, sd = term.values[parameter.name], fit.sd.get(f"{term.label}:{parameter.name}", 0.0)
            low, high = _interval(parameter, float(value), FINDINGS.half_width * sd)
            unit = unit_at(parameter.unit, term, problem)
            parameters[parameter.name] = {"value": float(value), "unit": unit, "ci90": [float(low), float(high)]}
        is_first = bool(choice.best.terms) and term.effect.physics == choice.best.terms[0].effect.physics
        places = choice.places if is_first and i == 0 else {term.place.name: 1.0}
        alike = [term.effect.physics, *(name for h in choice.alike for name in _instead(h, fit, i))]
        alike += ["sensor-delay"] if _delays_all_inputs(term, problem) else []
        out.append(
            Finding(
                effect=term.effect.physics,
                form=term.effect.name,
                family=term.effect.family,
                place=place_of(term.place.name, term.effect, problem),
                places_90=tuple(dict.fromkeys(place_of(p, term.effect, problem) for p in _most(places))),
                probability=min(choice.shares.get(term.effect.physics, choice.probability), 1.0),
                alike=tuple(dict.fromkeys(alike)),
                parameters=parameters,
                law=term.effect.law,
                words=term.effect.words,
            )
        )
    return out


def _delays_all_inputs(term: Term, problem: Reportable) -> bool:
    """Return whether a term delays every input.

    A time-invariant model cannot tell a common delay of all inputs from the same delay of all readings.
    """
    if term.effect.name != "actuator-delay" or any(run.law is not None for run in problem.runs):
        return False
    return bool(problem.excited) and all(actuator in term.place.indices for actuator in problem.excited)


def _interval(parameter: Parameter, value: float, spread: float) -> tuple[float, float]:
    """Return a value's 90 % interval from its entry's spread."""
    if parameter.signed:
        return value - spread, value + spread
    if is_logarithm(parameter):
        return value * float(np.exp(-spread)), value * float(np.exp(min(spread, 50.0)))
    return max(value * (1.0 - spread), 0.0), value * (1.0 + spread)


def findings_of_attempt(hypothesis: Hypothesis, fit: Fit, problem: Reportable) -> list[Finding]:
    """Return an unchosen hypothesis as findings without probability."""
    places = {t.place.name: 1.0 for t in fit.terms[:1]}
    alone = Choice(best=hypothesis, alike=(), probability=float("nan"), ranking=(), places=places)
    return findings_of_terms(alone, fit, problem)


def graded(
    findings: Sequence[Finding],
    choice: Choice,
    explained: float,
    *,
    is_plausible: bool = True,
    fitted: Sequence[Term] = (),
) -> tuple[Finding, ...]:
    """Return the findings of a partial explanation.

    The unexplained share may belong to a law that explains the rest as well, so it bounds every probability: all of them by
    the explained share, and each by its own share over this and the unexplained one. Beside
    parameters that refute the model, another error of the model is as likely as the effects, which halves the
    probabilities. Effects of the same family that are as probable join the indistinguishable ones, and the probability is
    that of all of them: fitted recordings may prefer one form of a law, and hold-out recordings another. Effects that only
    hold-out data prefer as a set have half of the probability of their families: no posterior speaks for the set itself.
    After refutations, the reserve for physics outside the catalogue weighs against what is left.

    Parameters
    ----------
    findings : sequence of Finding
        Effects of the attempt.
    choice : Choice
        Choice with its ranking.
    explained : float
        Explained share of the mismatch [1].
    is_plausible : bool
        Whether the uncertain parameters agree with what the case states.
    fitted : sequence of Term
        Effects of the attempt's fit; other findings are those from the data alone.

    Returns
    -------
    tuple of Finding
        Findings with probabilities.
    """
    known = choice.reserve + sum(p for h, p in choice.tried if h.terms)
    shares: dict[str, float] = {}
    for h, p in choice.tried:
        for name in {t.effect.physics for t in h.terms}:
            shares[name] = shares.get(name, 0.0) + p / max(known, 1e-300)
    named = {t.effect.physics for t in fitted}
    is_ranked = any({t.effect.physics for t in h.terms} == named for h, _ in choice.tried)
    together = set() if is_ranked else named
    families = {t.effect.family for t in fitted}
    of_set = sum(p for h, p in choice.tried if families & {t.effect.family for t in h.terms}) / max(known, 1e-300)
    out, left = [], max(1.0 - explained, 0.0)
    for finding in findings:
        part = finding.explained / (finding.explained + left) if finding.explained > 0.0 else explained
        is_of_data = finding.effect not in named and (bool(fitted) or finding.effect not in shares)
        most = (1.0 if is_plausible else 0.5) * (explained if is_of_data else min(explained, part))
        if is_of_data:  # the data alone show it, however little it explains
            out.append(replace(finding, probability=most * finding.probability))
            continue
        own = shares.get(finding.effect, 0.0)
        related = (t.effect for h, _ in choice.tried for t in h.terms if t.effect.family == finding.family)
        rivals = [e.physics for e in related if shares[e.physics] >= own and finding.effect not in together]
        alike = tuple(dict.fromkeys([*finding.alike, *rivals]))
        names = {finding.effect, *alike}
        of_any = sum(p for h, p in choice.tried if names & {t.effect.physics for t in h.terms}) / max(known, 1e-300)
        of_any = 0.5 * of_set if finding.effect in together else of_any
        out.append(replace(finding, probability=most * max(own, of_any), alike=alike))
    return tuple(out)


def by_what_they_explain(findings: Sequence[Finding], checked: Sequence[Distance]) -> tuple[Finding, ...]:
    """Return findings in order of explained residual.

    Parameters
    ----------
    findings : sequence of Finding
        Findings.
    checked : sequence of Distance
        Errors with one part per finding, in the same order.

    Returns
    -------
    tuple of Finding
        Ordered findings.
    """
    out = []
    for i, finding in enumerate(findings):
        parts = [(run, run.parts[i]) for run in checked if len(run.parts) == len(findings)]
        names = tuple(run.name for run, part in parts if run.role == "holdout" and not part.is_idle)
        gained = sum(part.left**2 - run.after**2 for run, part in parts if np.isfinite(run.after))
        mismatch = sum(run.before**2 for run, _ in parts)
        share = min(gained / mismatch, 1.0) if mismatch > 0.0 and np.isfinite(gained) else float("nan")
        out.append((gained, replace(finding, verified_by=names, explained=share)))
    return tuple(finding for _, finding in sorted(out, key=lambda item: -item[0]))


def one_per_law(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return findings with the places of every law together.

    Friction in all joints of a machine is one finding with a value for each joint.

    Parameters
    ----------
    findings : sequence of Finding
        Findings in order of what they explain.

    Returns
    -------
    tuple of Finding
        Findings; a law at several places stands where its first place stood.
    """
    laws: dict[str, list[Finding]] = {}
    for finding in findings:
        laws.setdefault(finding.form, []).append(finding)
    return tuple(
        replace(
            first,
            elsewhere=tuple((f.place, f.parameters) for f in others),
            explained=first.explained + sum(f.explained for f in others),
            verified_by=tuple(dict.fromkeys(name for f in (first, *others) for name in f.verified_by)),
        )
        for first, *others in laws.values()
    )


def alternatives(choice: Choice, problem: Reportable, verdict: Verdict, before: float) -> tuple[dict[str, Any], ...]:
    """Return the hypotheses besides the reported one, best first.

    The chosen hypothesis is included where nothing is reported.

    Parameters
    ----------
    choice : Choice
        Choice with its ranking.
    problem : Reportable
        Problem.
    verdict : Verdict
        Verdict.
    before : float
        Residual of the calibrated model over the noise.

    Returns
    -------
    tuple of dict
        Effect, location, probability and residual.
    """
    tried = choice.ranking if verdict in NAMING and choice.best.terms else choice.tried
    is_told = verdict in TOLD
    return tuple(
        {
            "effect": " + ".join(t.effect.name for t in h.terms) or "nothing",
            "place": " + ".join(place_of(t.place.name, t.effect, problem) for t in h.terms),
            "probability": p if is_told else None,
            "remaining": h.normalised_residual,
            "remaining_share": h.normalised_residual / max(before, 1e-300),
        }
        for h, p in tried[: FINDINGS.most_alternatives]
    )


def place_of(name: str, effect: Effect, problem: Reportable) -> str:
    """Return the reported name of a location.

    Parameters
    ----------
    name : str
        Name of the location.
    effect : Effect
        Effect there.
    problem : Reportable
        Problem.

    Returns
    -------
    str
        Name.
    """
    if effect.picks_up:
        sensors = [p.name for p in problem.places if p.kind == "sensor"]
        name = next((sensor for sensor in sensors if name.startswith(f"{sensor}/")), name)
    driven = len([p for p in problem.places if p.kind == "actuator" and not p.also])
    return problem.model_kind.reported_place(name, effect, driven)


def _instead(hypothesis: Hypothesis, fit: Fit, i: int) -> list[str]:
    """Return an equally good hypothesis' substitutes for one effect.

    All other effects must be equal.
    """
    if len(hypothesis.terms) != len(fit.terms):
        return []
    others = [t.effect.name for k, t in enumerate(fit.terms) if k != i]
    left = list(hypothesis.terms)
    for name in others:
        same = next((t for t in left if t.effect.name == name), None)
        if same is None:
            return []
        left.remove(same)
    return [t.effect.physics for t in left]


def unit_at(unit: str, term: Term, problem: Reportable) -> str:
    """Return the unit of a parameter at its location.

    Sensor effects have the channel's unit, actuator effects the command's, all others that of the motion.

    Parameters
    ----------
    unit : str
        Unit of the parameter at a translation.
    term : Term
        Effect with its place.
    problem : Reportable
        Problem.

    Returns
    -------
    str
        Unit there.
    """
    effect, place = term.effect, term.place
    if effect.kind == "sensor":
        own = _channel_unit(problem, place.index)
        if "command" in effect.needs:
            return {"m/N": _ratio(own, command_unit(problem, place.other))}.get(unit, unit)
        return {"m": own, "m/s": _rate(own)}.get(unit, unit)
    if effect.kind == "actuator":
        own = command_unit(problem, place.indices[0])
        return {"N": own, "N/s": _rate(own), "1/N": _ratio("1", own)}.get(unit, unit)
    return at_rotation(unit) if place.angular else unit


def _rate(unit: str) -> str:
    """Return the unit of a rate."""
    return f"{unit}^2" if unit.endswith("/s") else _ratio(unit, "s")


def _ratio(unit: str, other: str) -> str:
    above, below = (f"({u})" if "/" in u or " " in u else u or "1" for u in (unit, other))
    return f"{above}/{below}" if other else unit


def _channel_unit(problem: Reportable, index: int) -> str:
    for run in problem.runs:
        name = problem.names[index]
        if name in run.measured.names:
            return str(run.measured.channels[run.measured.index(name)].unit)
    return "m"


def command_unit(problem: Reportable, index: int) -> str:
    """Return the unit of an actuator's commands.

    Parameters
    ----------
    problem : Reportable
        Problem.
    index : int
        Index of the actuator.

    Returns
    -------
    str
        Unit, or "".
    """
    tap = problem.plant.actuators[index]
    if tap.unit != "command":
        return str(tap.unit)
    for run in problem.runs:
        channels = [d.channel for d in run.drives if d.actuator == index]
        channels += [c.channel for c in run.compared if c.actuator == index]
        if channels:
            return str(run.measured.channels[run.measured.index(channels[0])].unit)
    return ""


def _most(places: dict[str, float]) -> tuple[str, ...]:
    out, held = [], 0.0
    for name, probability in places.items():
        out.append(name)
        held += probability
        if held >= FINDINGS.credible:
            break
    return tuple(out)
