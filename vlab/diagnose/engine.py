"""The whole way of a diagnosis, from a case to what is said of it."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlab.cases.case import Case
from vlab.cases.misfit import misfit
from vlab.cases.wiring import Run
from vlab.diagnose.choose import Choice, choose
from vlab.diagnose.commands import CommandLimit, find_limit
from vlab.diagnose.diagnosis import Diagnosis, Finding, Verdict
from vlab.diagnose.prepare import Problem, prepare
from vlab.diagnose.refine import Fit
from vlab.diagnose.search import WORTH, Found, Hypothesis, search
from vlab.diagnose.verify import Amended, Checked, amended, check, gap_closed, total
from vlab.diagnose.words import next_measurement, not_excluded
from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import Effect

ABOVE_NOISE = 1.5
"""Held-out recordings are not explained where the refitted model leaves more than this multiple of their noise..."""
LEAST_MISFIT = 0.015
"""...and more than this share of their rms: integrators, meshes and interpolation leave up to a per cent."""
LEAST_GAP = 0.4
"""An effect is reported as found where it closes at least this share of the held-out gap."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosed:
    """A diagnosis with what it was made of.

    Parameters
    ----------
    before, after : Amended
        The refitted and the amended model; the same where nothing was found.
    """

    diagnosis: Diagnosis
    problem: Problem
    found: Found
    choice: Choice
    before: Amended
    after: Amended
    fit: Fit


def diagnose(
    case: Case, *, effects: Sequence[Effect] = (), progress: Callable[[float, str], None] | None = None
) -> Diagnosed:
    """Diagnose a case.

    Parameters
    ----------
    effects : sequence of Effect
        What may be missing; the whole catalogue by default.

    Raises
    ------
    BadCase
        No recording to fit, or recordings that do not fit the model.
    """
    began = time.monotonic()
    report = progress or (lambda share, what: None)
    report(0.0, "reading")
    problem = prepare(case, ("fit",))
    found = search(problem, list(effects) or list(EFFECTS.values()), lambda share, what: report(0.8 * share, what))
    choice = choose(found)
    report(0.8, "fitting whole recordings")
    fit_before = found.whole.fit((), found.before.fit)
    fit_after = found.whole.fit(choice.best.terms, choice.best.fit, 6) if choice.best.terms else fit_before
    before, after = amended(problem, fit_before), amended(problem, fit_after)
    limit = find_limit(case.plant, problem.runs)
    after = replace(after, limit=limit)
    report(0.9, "checking in MuJoCo")
    holdouts = case.runs(("holdout",)) if case.recordings(("holdout",)) else []
    runs: list[Run] = list(holdouts) or list(problem.runs)
    checked = check(case, runs, before, after if choice.best.terms or limit else None)
    diagnosis = _say(case, problem, choice, fit_after, checked, limit, time.monotonic() - began)
    report(1.0, "done")
    return Diagnosed(
        diagnosis=diagnosis, problem=problem, found=found, choice=choice, before=before, after=after, fit=fit_after
    )


def _verdict(choice: Choice, checked: Sequence[Checked], limit: CommandLimit | None) -> Verdict:
    errors = {key: total(checked, key) for key in ("before", "after", "noise")}
    gap = gap_closed(errors["before"], errors["after"], errors["noise"])
    unexplained = errors["before"] > max(ABOVE_NOISE * errors["noise"], LEAST_MISFIT)
    if (choice.best.terms or limit is not None) and (gap is None or gap >= LEAST_GAP):
        return "missing-physics"
    return "none-of-these" if unexplained else "nothing-missing"


def _say(
    case: Case,
    problem: Problem,
    choice: Choice,
    fit: Fit,
    checked: Sequence[Checked],
    limit: CommandLimit | None,
    seconds: float,
) -> Diagnosis:
    verdict = _verdict(choice, checked, limit)
    notes = (
        []
        if case.recordings(("holdout",))
        else ["no hold-out recording: nothing could be verified on data that the search did not use"]
    )
    found_limit = [] if limit is None else [_limit_finding(limit, problem)]
    findings = (*found_limit, *_findings(choice, fit)) if verdict == "missing-physics" else ()
    return Diagnosis(
        title=case.table.title,
        verdict=verdict,
        findings=findings,
        alternatives=tuple(_alternatives(choice)),
        checked=tuple(checked),
        mismatch=_mismatch(checked),
        not_excluded=not_excluded(choice, verdict),
        next_measurement=next_measurement(choice, verdict),
        notes=tuple(notes),
        calibration={p.name: float(v) for p, v in zip(problem.parameters, fit.theta, strict=True) if abs(v) > 1e-6},
        seconds=seconds,
    )


def _limit_finding(limit: CommandLimit, problem: Problem) -> Finding:
    law = next(run.law for run in problem.runs if run.law is not None)
    effect = EFFECTS["actuator-clipping"]
    index = problem.plant.actuator_index(limit.actuator)
    tap = problem.plant.actuators[index]
    recorded = [
        run.measured.channels[run.measured.index(c.channel)].unit
        for run in problem.runs
        for c in run.compared
        if c.actuator == index
    ]
    unit = tap.unit if tap.unit != "command" else next(iter(recorded), "")
    scale = float(law.per_actuator[list(law.actuators).index(index)])
    value, spread = limit.limit * scale, 1.645 * limit.sd * scale
    told = "the law is told the limited command" if limit.is_known else "the law does not know of it"
    # the odds of the replays' errors, of as many independent samples as any score counts
    odds = (limit.after / limit.before) ** WORTH
    return Finding(
        effect=effect.name,
        family=effect.family,
        place=f"actuator:{limit.actuator}",
        places_90=(f"actuator:{limit.actuator}",),
        probability=1.0 / (1.0 + odds),
        alike=(effect.name,),
        parameters={"limit": {"value": value, "unit": unit, "ci90": [value - spread, value + spread]}},
        law=effect.law,
        words=f"{effect.words}; the replayed law misses the recorded commands by {100 * limit.before:.0f} % without it and "
        f"{100 * limit.after:.0f} % with it, and {told}",
    )


def _findings(choice: Choice, fit: Fit) -> list[Finding]:
    out = []
    for i, term in enumerate(fit.terms):
        parameters: dict[str, dict[str, Any]] = {}
        for parameter in term.effect.parameters:
            value, sd = term.values[parameter.name], choice.best.fit.sd.get(f"{term.label}:{parameter.name}", 0.0)
            spread = 1.645 * sd
            low, high = (
                (value - spread, value + spread)
                if parameter.signed
                else (value * np.exp(-spread), value * np.exp(min(spread, 50.0)))
            )
            unit = _unit(parameter.unit, term.place.angular)
            parameters[parameter.name] = {"value": float(value), "unit": unit, "ci90": [float(low), float(high)]}
        places = choice.places if i == 0 else {term.place.name: 1.0}
        alike = [term.effect.name, *(name for h in choice.alike for name in _instead(h, fit, i))]
        out.append(
            Finding(
                effect=term.effect.name,
                family=term.effect.family,
                place=term.place.name,
                places_90=_most(places),
                probability=choice.probability,
                alike=tuple(dict.fromkeys(alike)),
                parameters=parameters,
                law=term.effect.law,
                words=term.effect.words,
            )
        )
    return out


def _instead(hypothesis: Hypothesis, fit: Fit, i: int) -> list[str]:
    """Return what a hypothesis that fits as well has in the place of one of the chosen effects, the others being the same."""
    others = [t.effect.name for k, t in enumerate(fit.terms) if k != i]
    names = [t.effect.name for t in hypothesis.terms]
    for name in others:
        if name not in names:
            return []
        names.remove(name)
    return names


_ANGULAR = {"N": "N m", "m": "rad", "kg": "kg m^2", "m/s": "rad/s", "N/m": "N m/rad", "N s/m": "N m s/rad"}


def _unit(unit: str, angular: bool) -> str:
    """Return a parameter's unit at a rotation, where forces are moments and displacements angles."""
    if not angular:
        return unit
    if unit in _ANGULAR:
        return _ANGULAR[unit]
    return unit.replace("N", "N m", 1).replace("/m", "/rad") if unit.startswith("N") else unit.replace("m", "rad")


def _most(places: dict[str, float]) -> tuple[str, ...]:
    out, held = [], 0.0
    for name, probability in places.items():
        out.append(name)
        held += probability
        if held >= 0.9:
            break
    return tuple(out)


def _alternatives(choice: Choice) -> list[dict[str, Any]]:
    return [
        {
            "effect": " + ".join(t.effect.name for t in h.terms) or "nothing",
            "place": " + ".join(t.place.name for t in h.terms),
            "probability": p,
            "remaining": h.level,
        }
        for h, p in choice.ranking[:8]
    ]


def _mismatch(checked: Sequence[Checked]) -> dict[str, Any]:
    """Return where the refitted model is off, without any hypothesis: bands, channels, times, the worst first."""
    bands: list[dict[str, float]] = []
    channels: dict[str, float] = {}
    times: list[dict[str, Any]] = []
    for run in checked:
        simulated = run.simulated[1]
        if simulated is None:
            continue
        for name, errors in run.channels.items():
            channels[name] = max(channels.get(name, 0.0), errors[1])
            found = misfit(run.measured, simulated, name)
            for low, high, share in zip(
                found.band_edges_hz[:-1], found.band_edges_hz[1:], found.band_share, strict=True
            ):
                bands.append({"low_hz": float(low), "high_hz": float(high), "share": float(share), "nrmse": errors[1]})
            k = int(np.argmax(found.window_nrmse))
            times.append(
                {
                    "recording": run.name,
                    "channel": name,
                    "time_s": float(found.window_time_s[k]),
                    "nrmse": float(found.window_nrmse[k]),
                }
            )
    bands.sort(key=lambda b: -b["share"] * b["nrmse"] ** 2)
    times.sort(key=lambda t: -t["nrmse"])
    order = sorted(channels, key=lambda c: -channels[c])
    return {
        "where_frequency_hz": bands[:4],
        "where_channel": [{"channel": c, "nrmse": channels[c]} for c in order],
        "where_time_s": times[:4],
    }
