"""When inputs act and readings are taken, where a case does not say it: read off the recordings.

Whether a command stands from its sample on or stood until it, runs straight from sample to sample, and whether the readings of its
sample were taken before it went out, is a convention of whoever wrote the file. Half a sample more or less is no physics, but at
half the sample rate it turns phases by a right angle.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import ORDER
from vlab.cases.description import ChannelTable, Hold
from vlab.diagnose.data.noise import noise_levels
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import SAMPLING_CONVENTION
from vlab.physics.effect import Effect
from vlab.physics.running import STAGGERED

WORDS: dict[Hold, str] = {
    "linear": "inputs run straight from sample to sample",
    "zero": "inputs stand from their sample to the next, whose readings are the first to see them",
    "zero-first": "inputs stand from their sample to the next, and its own readings see them",
    "past": "inputs stood from the sample before until their own",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class _Convention:
    """A convention that the recordings may ask for, and how much they do.

    Parameters
    ----------
    case : Case
        With it.
    hold : str
        Of the inputs; "" as given.
    skew_s : float
        By which positions, accelerations and forces are ahead of velocities and inputs.
    gain : float
        In log-likelihood, less its price.
    is_near : bool
        Whether they ask for it once, not for more or less of it.
    is_conclusive : bool
        Whether they ask for it and for nothing else.
    """

    case: Case
    hold: Hold
    skew_s: float
    log_likelihood_gain: float
    is_near: bool
    is_conclusive: bool

    @property
    def lines(self) -> list[str]:
        """It in words."""
        out = [describe_hold(self.hold)] if self.hold else []
        if self.skew_s:
            out.append(
                f"positions and accelerations stand {1e3 * self.skew_s:.3g} ms ahead, as steps of a simulation leave them (delay_s)"
            )
        return out


S = TypeVar("S", bound=ScoreTest)


def score_by_timing(
    screen: S,
    signals: Callable[[Case], Sequence[Signals]],
    again: Callable[[Case, str], S | None],
    leaves: Callable[[S], float],
    effects: Sequence[Effect],
) -> S:
    """Return a screening whose inputs act when the recordings show that they do; the same one where its case says it, or nothing shows.

    A simulation with semi-implicit steps that writes its state leaves positions half a step ahead of velocities; that counts as a
    convention, too. Laws in the loop are replayed on their own clock, and the two structures' converters are known: these stay as
    they are.

    Parameters
    ----------
    signals : callable
        Puts the runs to fit of a case with another convention on the search's clock.
    again : callable
        Screens a case with another convention, which is to be said of it in these words; None where it cannot.
    leaves : callable
        Mean square, over that of noise and model error, that a refit to whole recordings leaves of a screening.
    effects : sequence of Effect
        What may be missing besides.
    """
    lines: list[str] = []
    for _ in range(SAMPLING_CONVENTION.most_passes):
        problem = screen.problem
        if problem.case.structure is not None or not _shows(problem):
            break
        left_open = _left_open(problem, signals)
        conventions = list(_conventions(screen, left_open))
        found = _favoured_convention(screen, left_open, conventions, effects)
        likely = found or _hinted_at(conventions)
        other = None if likely is None else again(likely.case, said([*lines, *likely.lines]))
        if likely is None or other is None or (found is None and not _leaves_less(leaves, other, screen)):
            break
        lines += likely.lines
        screen = other
    return screen


def open_holds(problem: Problem) -> list[Hold]:
    """Return whether inputs run straight or stand, whichever a case without a word on it is not taken to mean; nothing where the recordings
    have told, or cannot."""
    if problem.timing or problem.case.structure is not None or not _shows(problem):
        return []
    return [hold for hold, _ in _others(problem.case) if hold in ("linear", "zero")]


def describe_hold(hold: Hold) -> str:
    """Return what a hold of inputs is, and how a case says it."""
    return f'{WORDS[hold]} (hold = "{hold}")'


def said(lines: Sequence[str]) -> str:
    """Return conventions in one line."""
    return f"{'; '.join(lines)}: the case does not say it, the recordings do"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Open:
    """What a case leaves open.

    Parameters
    ----------
    inputs : list of (str, Case, sequence of Signals)
        Holds of the inputs, each with the case and its signals on the search's clock; "" and no signals as given.
    skewable : list of int
        Channels whose readings a simulation's steps may have left ahead.
    half_step : float
        By which they would be [s].
    """

    inputs: list[tuple[Hold, Case, Sequence[Signals]]]
    skewable: list[int]
    half_step: float


def _left_open(problem: Problem, signals: Callable[[Case], Sequence[Signals]]) -> _Open:
    others = [(hold, case, _with_inputs_of(problem, signals(case))) for hold, case in _others(problem.case)]
    return _Open(inputs=[("", problem.case, ()), *others], skewable=_skewable(problem), half_step=_half_step(problem))


def _favoured_convention(
    screen: ScoreTest, left_open: _Open, conventions: Sequence[_Convention], effects: Sequence[Effect]
) -> _Convention | None:
    """Return the convention that the recordings ask for most: alone or, where they ask for it and more, beside what may be missing."""
    asked = [convention for convention in conventions if convention.log_likelihood_gain > SAMPLING_CONVENTION.gain]
    effective_share = [convention for convention in asked if convention.is_conclusive]
    if effective_share or not asked:
        return max(effective_share, key=lambda convention: convention.log_likelihood_gain, default=None)
    candidates = screen.candidates(effects)[: SAMPLING_CONVENTION.beside]
    most, found = candidates[0].log_likelihood_gain + SAMPLING_CONVENTION.gain if candidates else np.inf, None
    for candidate in candidates:
        for convention in _conventions(screen.given([candidate]), left_open):
            if (
                convention.is_conclusive
                and convention.log_likelihood_gain > SAMPLING_CONVENTION.gain
                and candidate.log_likelihood_gain + convention.log_likelihood_gain > most
            ):
                most, found = candidate.log_likelihood_gain + convention.log_likelihood_gain, convention
    return found


def _hinted_at(conventions: Sequence[_Convention]) -> _Convention | None:
    """Return the hold of the inputs that the innovations speak for, if softly: a filter that trusts the recordings hides most of what
    a slow motion has of it."""
    holds = [
        c
        for c in conventions
        if c.hold and not c.skew_s and c.is_near and c.log_likelihood_gain > SAMPLING_CONVENTION.hint
    ]
    return max(holds, key=lambda c: c.log_likelihood_gain, default=None)


def _leaves_less(leaves: Callable[[S], float], other: S, screen: S) -> bool:
    """Return whether a refit to whole recordings leaves much less with another screening."""
    return leaves(other) < SAMPLING_CONVENTION.much_less * leaves(screen)


def _conventions(screen: ScoreTest, left_open: _Open) -> Iterator[_Convention]:
    """Yield what recordings ask for of what a case leaves open: of every hold with and without a skew of the readings."""
    step = left_open.half_step
    for hold, case, signals in left_open.inputs:
        first = [signals] if hold else []
        for moved in ([], left_open.skewable) if left_open.skewable else ([],):
            if not first and not moved:
                continue
            shares, log_likelihood_gain, explained = screen.asked(first, moved, step)
            skew = float(shares[-1]) if moved else 0.0
            is_near = not hold or abs(shares[0] - 1.0) < SAMPLING_CONVENTION.near
            yield _Convention(
                case=_skewed(case, skew * step) if moved else case,
                hold=hold,
                skew_s=skew * step,
                log_likelihood_gain=log_likelihood_gain - SAMPLING_CONVENTION.gain_each * (len(shares) - 1),
                is_near=is_near,
                is_conclusive=is_near
                and explained > SAMPLING_CONVENTION.explained
                and (not moved or SAMPLING_CONVENTION.least_skew < skew < SAMPLING_CONVENTION.most_skew),
            )


def _with_inputs_of(problem: Problem, signals: Sequence[Signals]) -> list[Signals]:
    """Return a problem's signals with the inputs of others, and with what its model's own nonlinearity adds as it was."""
    return [
        replace(s, u=t.u, y=t.y, load=np.hstack([t.load, s.load[:, t.load.shape[1] :]]))
        for s, t in zip(problem.signals, signals, strict=True)
    ]


def _half_step(problem: Problem) -> float:
    """Return half an integration step of the model, or half a sample where that is shorter [s]."""
    return 0.5 * min(problem.plant.timestep, *(float(np.median(np.diff(run.measured.time))) for run in problem.runs))


def _skewable(problem: Problem) -> list[int]:
    """Return the channels that a simulation's steps would skew: none where its steps do not, no skew shows, or the case states one."""
    is_driven = any(run.drives for run in problem.runs)
    if not is_driven and len({order == 1 for order in problem.orders}) < 2:
        return []  # of a release seen by positions alone nobody knows when it began
    stated = any(channel.delay_s for table in problem.case.table.recording for channel in table.channel)
    if problem.plant.model.opt.integrator not in STAGGERED or stated:
        return []
    if not all(run.measured.is_uniform for run in problem.case.runs()):
        return []
    return [i for i, order in enumerate(problem.orders) if order != 1]


def _skewed(case: Case, seconds: float) -> Case:
    """Return a case whose readings but velocities show what is so much later than their stamps."""
    tables = []
    for table in case.table.recording:
        own = [c for c in table.channel if not c.input and ORDER.get(c.kind, 0) != 1]
        channels = tuple(replace(c, delay_s=-seconds) if c in own else c for c in table.channel)
        tables.append(replace(table, channel=channels))
    return replace(case, table=replace(case.table, recording=tuple(tables)))


def _shows(problem: Problem) -> bool:
    """Return whether half a sample shows in readings that move in it, without a law in the loop, which keeps its own time."""
    if any(run.law is not None for run in problem.runs):
        return False
    for run in problem.runs:
        if not run.drives or not run.measured.is_uniform:
            continue
        noise = noise_levels(run, problem.names)
        columns = np.column_stack([run.measured[name] for name in problem.names])
        moved = np.mean(np.diff(columns, axis=0) ** 2, axis=0) - 2.0 * noise**2
        if np.any(moved > (2.0 * SAMPLING_CONVENTION.seen * noise) ** 2):
            return True
    return False


def _others(case: Case) -> Iterator[tuple[Hold, Case]]:
    """Yield the other conventions that a case leaves open, and the case with each of them."""
    for hold in WORDS:
        other = with_hold(case, hold)
        if other.table != case.table:
            yield hold, other


def with_hold(case: Case, hold: Hold) -> Case:
    """Return a case whose inputs act in a certain way where it leaves that open."""
    tables = [
        replace(table, channel=tuple(_with(channel, hold) for channel in table.channel))
        for table in case.table.recording
    ]
    return replace(case, table=replace(case.table, recording=tuple(tables)))


def _with(channel: ChannelTable, hold: Hold) -> ChannelTable:
    is_open = channel.input and (not channel.hold or (channel.hold == "zero" and hold == "zero-first"))
    if not is_open or (not channel.hold and hold == ("zero" if channel.is_held else "linear")):
        return channel
    return replace(channel, hold=hold)
