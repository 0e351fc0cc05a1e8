"""The whole way of a diagnosis, from a case to what is said of it."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from vlab.cases.case import Case
from vlab.cases.misfit import misfit
from vlab.diagnose.choose import Choice, choose
from vlab.diagnose.commands import CommandLimit, find_limit
from vlab.diagnose.damage import Damage, SensorLimit, assess, sensor_limits
from vlab.diagnose.diagnosis import Diagnosis, Finding, Verdict
from vlab.diagnose.final_fit import final_fit, loudest_and_quietest
from vlab.diagnose.findings import alternatives, of_hum, of_limit, of_step, of_stop, of_terms, of_zero
from vlab.diagnose.fits import by_score, scored_by
from vlab.diagnose.frequency.engine import FrequencyDiagnosed, diagnose_frequency, is_in_frequency
from vlab.diagnose.hum import Hum
from vlab.diagnose.hypothesis import Hypothesis
from vlab.diagnose.mesh import with_modes_of_fe
from vlab.diagnose.noise import noise_levels
from vlab.diagnose.problem import MESH_OWN_ERROR, MODEL_ERROR, Problem
from vlab.diagnose.refine import EXACT, ITERATIONS, Refiner
from vlab.diagnose.resolution import SensorStep, sensor_steps
from vlab.diagnose.roads import road_of
from vlab.diagnose.search import TimeFound
from vlab.diagnose.standoff import without_standoffs
from vlab.diagnose.terms import Fit, Term
from vlab.diagnose.unseen import held_out, moves
from vlab.diagnose.verify import Amended, Checked, amended, check, coarse_steps, gap_closed, total
from vlab.diagnose.words import far_off, next_measurement, not_excluded
from vlab.diagnose.zeros import Zero, shifted_zeros
from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import Effect

ABOVE_NOISE = 1.5
"""Held-out recordings are not explained where the refitted model leaves more than this multiple of their noise..."""
LEAST_MISFIT = 0.005
"""...and more than this share of their rms, or what the mesh of a structure leaves: what integration and interpolation leave of
a user's model."""
LEAST_GAP, LEAST_TO_NOISE = 0.78, 0.5
"""An effect is reported as found where it closes this share of the held-out gap down to noise and what the simulation itself
misses, and this share of the gap down to the noise alone. On concealed cases of two rigs effects that were there closed .91 and
more, other forms of them .78 and more, laws fitted to what no law describes .58 to .77."""
NEAR_NOISE, LEAST_NEAR_NOISE = 1.1, 0.7
"""Where no more than this multiple of the noise is left, this share is enough: the gap was small."""
NO_WORSE, BETTER = 1.02, 0.998
"""A model is no worse than another where it leaves at most this multiple, which is what the fits' own convergence is good for; and
better where it leaves at most that one: hum within the noise has another phase in every recording, and fits none kept aside."""
NEARLY_ALL = 0.9
"""Share of the gap that is closed in most recordings where a single one may have less."""
LOST = 1.0
"""An error as large as the recording itself: a model that leaves it there explains nothing, however far off another one is."""
STEPS_ALONG_MOTION = 6
"""Steps of the last fit along a motion, before those that MuJoCo's own run corrects."""
MOST_TRIED = 3
"""Hypotheses that are tried in MuJoCo until it confirms one."""
BENIGN_HUM, HUM_OVER_NOISE = 0.03, 2.0
"""Hum below this share of its channel's rms, or this multiple of its noise, is what every laboratory has."""
BENIGN_STOP = 0.002
"""A sensor that stands at its limit for a smaller share of the samples is said among the recordings' defects only."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """What recordings show without any law of physics fitted.

    Parameters
    ----------
    limit : CommandLimit or None
        Of the commands of a law in the loop.
    stops : tuple of SensorLimit
        Of sensors, where they matter.
    steps : tuple of SensorStep
        Of sensors whose readings are coarse.
    hums, benign_hums : tuple of Hum
        On sensors: where it matters, and elsewhere.
    damage : Damage
        Of the recordings.
    zeros : tuple of Zero
        Of channels that are far off, as the last fit has them.
    """

    limit: CommandLimit | None
    stops: tuple[SensorLimit, ...]
    steps: tuple[SensorStep, ...]
    hums: tuple[Hum, ...]
    benign_hums: tuple[Hum, ...]
    damage: Damage
    zeros: tuple[Zero, ...] = ()

    @property
    def is_missing(self) -> bool:
        """Whether any of it is physics that the model lacks."""
        return self.limit is not None or bool(self.stops) or bool(self.steps) or bool(self.hums) or bool(self.zeros)

    def on(self, model: Amended) -> Amended:
        """Return a model with it."""
        return replace(model, limit=self.limit, stops=self.stops, steps=self.steps, hums=self.hums)

    def of_law(self, problem: Problem) -> list[Finding]:
        """Return the limit of the commands as a finding: the law is known, so nothing is surer."""
        return [] if self.limit is None else [of_limit(self.limit, problem)]

    def of_sensors(self, problem: Problem) -> list[Finding]:
        """Return what sensors show as findings."""
        units = {c.name: c.unit for c in problem.runs[0].measured.channels}
        out = [of_stop(stop, units[stop.channel]) for stop in self.stops]
        out += [of_step(step, units[step.channel]) for step in self.steps]
        out += [of_hum(hum, units[hum.channel]) for hum in self.hums]
        return out + [of_zero(zero, units[zero.channel]) for zero in self.zeros]


def look(problem: Problem, damage: Damage) -> Seen:
    """Look at the recordings to fit of a case without its model; the law in the loop aside, whose commands are replayed."""
    runs = problem.runs
    big: list[Hum] = []
    small: list[Hum] = []
    for hum in problem.hums:
        noise = float(np.median([noise_levels(run, [hum.channel]) for run in runs]))
        matters = hum.share > BENIGN_HUM and hum.rms > HUM_OVER_NOISE * noise
        (big if matters else small).append(hum)
    stops = tuple(stop for stop in sensor_limits(runs) if stop.share > BENIGN_STOP)
    limit = find_limit(problem.case.plant, runs)
    steps = tuple(step for step in sensor_steps(runs) if step.channel not in {stop.channel for stop in stops})
    return Seen(limit=limit, stops=stops, steps=steps, hums=tuple(big), benign_hums=tuple(small), damage=damage)


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
    found: TimeFound
    choice: Choice
    before: Amended
    after: Amended
    fit: Fit


def diagnose(
    case: Case, *, effects: Sequence[Effect] = (), progress: Callable[[float, str], None] | None = None
) -> Diagnosed | FrequencyDiagnosed:
    """Diagnose a case; one of frequency responses and modal tables only in frequency.

    Parameters
    ----------
    effects : sequence of Effect
        What may be missing; the whole catalogue by default.

    Raises
    ------
    BadCase
        No recording to fit, or recordings that do not fit the model.
    BadRecording
        A file is damaged or not what the case says.
    """
    if is_in_frequency(case):
        return diagnose_frequency(case, effects=effects, progress=progress)
    began = time.monotonic()
    report = progress or (lambda share, what: None)
    report(0.0, "reading")
    given = case.plant
    case, standoffs = without_standoffs(with_modes_of_fe(case))
    effects = list(effects) or list(EFFECTS.values())
    road = road_of(case, effects)
    problem, case = road.problem, road.problem.case
    unseen = held_out(case, problem.names, problem.runs)
    seen = look(problem, assess([*problem.runs, *unseen.runs]))
    found = road.search([] if seen.damage.fatal else effects, lambda share, what: report(0.8 * share, what))
    report(0.8, "fitting whole recordings")
    settled = _settled(problem, found, seen, effects, is_linear=road.is_linear)
    choice, fit_before, fit_after = settled.choice, settled.before, settled.after
    seen = replace(seen, zeros=shifted_zeros(problem, fit_after, [s.channel for s in standoffs]))
    before, after = amended(problem, fit_before, seen.zeros), seen.on(amended(problem, fit_after))
    without = seen.on(amended(problem, fit_before))
    if seen.is_missing and fit_after.terms and not _is_needed(problem, without, after):
        fit_after, after = fit_before, without
    report(0.9, "checking in MuJoCo")
    runs = list(unseen.runs) or [run for run in problem.runs if moves(run)]
    is_amended = bool(choice.best.terms) or seen.is_missing
    nominal = Amended(plant=given)
    checked = check(runs, before, after if is_amended else None, seen.benign_hums, nominal=nominal)
    verdict = _verdict(choice, checked, seen, case.structure is not None)
    if verdict != "missing-physics":
        after, fit_after = before, fit_before  # what is not reported is not in the amended model
        checked = [c.unamended() for c in checked]
    coarse = coarse_steps(before, checked[0], runs[0]) if verdict == "none-of-these" and case.structure is None else ""
    notes = (
        *([coarse] if coarse else []),
        *(s.line for s in standoffs),
        *unseen.notes,
        *problem.notes,
        *settled.rejected,
        *road.notes,
    )
    diagnosis = _say(verdict, problem, choice, fit_after, checked, seen, notes, time.monotonic() - began)
    report(1.0, "done")
    return Diagnosed(
        diagnosis=diagnosis, problem=problem, found=found, choice=choice, before=before, after=after, fit=fit_after
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Settled:
    """A choice with the last fits of the refitted and the amended model, and what was dropped on the way, in words."""

    choice: Choice
    before: Fit
    after: Fit
    rejected: tuple[str, ...] = ()


def _settled(problem: Problem, found: TimeFound, seen: Seen, effects: Sequence[Effect], *, is_linear: bool) -> _Settled:
    """Return the best hypothesis that MuJoCo confirms on recordings to fit; the very best where it confirms none of the first.

    The search has a linear twin for MuJoCo. A law that is good there may run away here, or bend the model in ways that the
    twin does not have; then the next one has its turn.
    """
    whole, first = found.whole, None
    plain = whole.fit((), found.before.long_fit)
    rejected: list[tuple[str, str]] = []
    simplified: set[str] = set()
    plain_in_mujoco = cache(lambda: final_fit(problem, whole, plain, seen.limit))
    unconfirmed = 0
    while unconfirmed < MOST_TRIED:
        choice, before, after = choose(found), plain, plain
        if choice.best.terms:
            on_twin = _exactly(whole, choice.best, ITERATIONS if is_linear else STEPS_ALONG_MOTION)
            if on_twin.nil:
                rejected.append((choice.best.label, f"of {', '.join(on_twin.nil)} the last fit leaves nothing"))
                rest = [t for t in on_twin.terms if t.label not in on_twin.nil]
                found = _with(_without(found, choice.best, on_twin.nil), whole, rest, on_twin)
                continue
            lesser = on_twin.plainer(effects)
            if choice.best.label not in simplified and lesser != on_twin.terms:
                simplified.add(choice.best.label)  # that it scores less for what it has in vain is left to the choice
                found = _with(found, whole, lesser, on_twin)
                continue
            after = final_fit(problem, whole, on_twin, seen.limit) if is_linear else on_twin
            if after is not on_twin:  # where a law carries over to MuJoCo as it is, so do the uncertain parameters
                before = plain_in_mujoco()
        elif is_linear:
            before = after = plain_in_mujoco()
        settled = _Settled(choice=choice, before=before, after=after, rejected=_dropped(rejected))
        first = first or settled
        if not choice.best.terms:
            break
        if not is_linear or _is_confirmed(problem, settled, seen):
            return _with_fewer(problem, found, seen, effects, settled, is_linear=is_linear)
        rejected.append((choice.best.label, "its law fits on the linear twin, but not in MuJoCo"))
        found = _without(found, choice.best)
        unconfirmed += 1
    assert first is not None
    # the first one is what is reported where none is confirmed: it was not dropped
    label = first.choice.best.label
    return replace(first, rejected=_dropped([(name, why) for name, why in rejected if name != label]))


def _dropped(rejected: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Return in words which hypotheses were dropped, and why."""
    return tuple(f"{label}: {why}; dropped" for label, why in rejected)


def _with_fewer(
    problem: Problem,
    found: TimeFound,
    seen: Seen,
    effects: Sequence[Effect],
    settled: _Settled,
    *,
    is_linear: bool,
) -> _Settled:
    """Return what is settled with one effect of two, where MuJoCo's own simulation of recordings to fit is no worse with it: the second
    one then makes up for what the twin does not do as MuJoCo does."""
    both = settled.choice.best
    if len(both.terms) < 2:
        return settled
    parts = {t.label for t in both.terms}
    alone = replace(found, hypotheses=tuple(h for h in found.hypotheses if h.label in parts))
    if not choose(alone).best.terms:
        return settled
    one = _settled(problem, alone, seen, effects, is_linear=is_linear)
    left = []
    for which in (settled, one):
        before, after = (seen.on(amended(problem, fit)) for fit in (which.before, which.after))
        left.append(total(check(problem.runs, before, after), "after"))
    if not left[1] <= NO_WORSE * left[0]:
        return settled
    why = f"MuJoCo leaves as little with {one.choice.best.label} alone"
    return replace(one, rejected=(*settled.rejected, *_dropped([(both.label, why)])))


def _without(found: TimeFound, hypothesis: Hypothesis, nil: Sequence[str] = ()) -> TimeFound:
    """Return what was found without a hypothesis; where a part of it is nothing, without any that adds to the rest of it."""
    rest = {t.label for t in hypothesis.terms} - set(nil)

    def stays(h: Hypothesis) -> bool:
        labels = {t.label for t in h.terms}
        return h is not hypothesis and not (nil and rest and rest < labels)

    return replace(found, hypotheses=tuple(h for h in found.hypotheses if stays(h)))


def _with(found: TimeFound, whole: Refiner, terms: Sequence[Term], start: Fit) -> TimeFound:
    """Return what was found with effects fitted from where another fit has them, in the place of the same ones fitted worse."""
    if not terms:
        return found
    fit = whole.fit(terms, start, ITERATIONS)
    own = replace(scored_by(whole, fit), whole=fit, worth=found.before.worth)
    worse = [h for h in found.hypotheses if h.label == own.label]
    if any(h.score >= own.score for h in worse):
        return found
    return replace(found, hypotheses=tuple(by_score([own], [h for h in found.hypotheses if h not in worse])))


def _exactly(whole: Refiner, best: Hypothesis, iterations: int) -> Fit:
    """Return the last fit of a hypothesis: a comparison is done where the rest of the way says nothing, a value is not."""
    return whole.fit(best.terms, best.long_fit, iterations, settled=EXACT)


def _is_confirmed(problem: Problem, settled: _Settled, seen: Seen) -> bool:
    """Return whether MuJoCo's own simulation closes enough of the gap on the loudest and the quietest recording to fit."""
    before, after = (seen.on(amended(problem, fit)) for fit in (settled.before, settled.after))
    errors = _errors(check(loudest_and_quietest(problem), before, after, seen.benign_hums))
    gap = gap_closed(errors["before"], errors["after"], errors["noise"])
    return gap is None or gap >= LEAST_TO_NOISE


def _is_needed(problem: Problem, without: Amended, after: Amended) -> bool:
    """Return whether the chosen effects still explain the recordings to fit beside what these show without a model."""
    return _closes(check(problem.runs, without, after), problem.case.structure is not None)


def _errors(checked: Sequence[Checked]) -> dict[str, float]:
    return {key: total(checked, key) for key in ("before", "after", "noise")}


def _closes(checked: Sequence[Checked], is_structure: bool) -> bool:
    """Return whether an amended model closes enough of the gap: of all recordings together, or nearly all of it in most of them and
    much in every one. A single recording goes far beyond the motion that a law was fitted to, and counts most.
    """
    if any(run.after >= LOST for run in checked):
        return False
    gaps = [gap for run in checked if (gap := run.gap_closed) is not None]
    if len(gaps) > 2 and np.median(gaps) >= NEARLY_ALL and min(gaps) >= LEAST_TO_NOISE:
        return True
    errors = _errors(checked)
    gap = gap_closed(errors["before"], errors["after"], errors["noise"])
    reachable = float(np.hypot(errors["noise"], MESH_OWN_ERROR if is_structure else MODEL_ERROR))
    share = gap_closed(errors["before"], errors["after"], reachable)
    least = LEAST_NEAR_NOISE if errors["after"] <= NEAR_NOISE * errors["noise"] else LEAST_GAP
    return gap is not None and gap >= LEAST_TO_NOISE and max(gap, share or 0.0) >= least


def _verdict(choice: Choice, checked: Sequence[Checked], seen: Seen, is_structure: bool) -> Verdict:
    if seen.damage.fatal:
        return "bad-recording"
    errors = _errors(checked)
    floor = MESH_OWN_ERROR if is_structure else LEAST_MISFIT
    unexplained = errors["before"] > max(ABOVE_NOISE * errors["noise"], floor)
    if (choice.best.terms or seen.is_missing) and _closes(checked, is_structure):
        return "missing-physics"
    is_followed = errors["before"] <= ABOVE_NOISE * errors["noise"]
    no_gap = gap_closed(errors["before"], errors["after"], errors["noise"]) is None
    least = NO_WORSE if choice.is_of_priors else BETTER
    is_needed = choice.gained > 0 and (choice.is_of_priors or no_gap) and errors["after"] <= least * errors["before"]
    # there is no gap to close where coarse steps count as noise, or a refit follows with parameters that nobody believes
    has_steps = bool(seen.steps) and errors["after"] <= NO_WORSE * errors["before"]
    if is_followed and (has_steps or is_needed):
        return "missing-physics"
    if not unexplained:
        return "nothing-missing"
    return "bad-recording" if seen.damage.warnings else "none-of-these"


def _say(
    verdict: Verdict,
    problem: Problem,
    choice: Choice,
    fit: Fit,
    checked: Sequence[Checked],
    seen: Seen,
    notes: Sequence[str],
    seconds: float,
) -> Diagnosis:
    case = problem.case
    findings = (*seen.of_law(problem), *of_terms(choice, fit, problem), *seen.of_sensors(problem))
    return Diagnosis(
        title=case.table.title,
        verdict=verdict,
        findings=findings if verdict == "missing-physics" else (),
        alternatives=alternatives(choice, problem, is_reported=verdict == "missing-physics"),
        checked=tuple(checked),
        mismatch=_mismatch(checked),
        not_excluded=(*not_excluded(choice, verdict), *far_off(problem.parameters, fit.theta)),
        next_measurement=next_measurement(choice, verdict, [f.effect for f in findings]),
        quality=(*seen.damage.lines, *(_hum_line(hum) for hum in seen.benign_hums)),
        notes=tuple(notes),
        calibration={p.name: float(v) for p, v in zip(problem.parameters, fit.theta, strict=True) if abs(v) > 1e-6},
        seconds=seconds,
    )


def _hum_line(hum: Hum) -> str:
    lines = " and ".join(f"{k * hum.frequency:.2f}" for k in hum.harmonics)
    return f"{hum.channel}: mains hum at {lines} Hz, {100 * hum.share:.2g} % of its rms; taken off before the search"


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
