"""Sampling convention, estimated where a case leaves it open.

Commands may be held from their sample (zero-order hold), until their sample, or vary linearly. Channels may be sampled
before or after the command. Half a sample is no physics, but turns phases by a right angle at the Nyquist frequency.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from vlab.cases.case import Case
from vlab.cases.description import ChannelTable, Hold
from vlab.diagnose.data.noise import noise_levels
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.input_shares import input_shares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import SAMPLING_CONVENTION
from vlab.physics.effect import Effect
from vlab.physics.port_lines import STAGGERED
from vlab.signals import ORDER

WORDS: dict[Hold, str] = {
    "linear": "inputs run straight from sample to sample",
    "zero": "inputs stand from their sample to the next, whose readings are the first to see them",
    "zero-first": "inputs stand from their sample to the next, and its own readings see them",
    "past": "inputs stood from the sample before until their own",
}
"""Descriptions of the input holds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Convention:
    """Convention with its log-likelihood gain.

    Parameters
    ----------
    case : Case
        Case with the convention.
    hold : str
        Hold of the inputs; "" for the assumed one.
    skew_s : float
        Lead of positions, accelerations and forces over velocities and inputs [s].
    log_likelihood_gain : float
        Gain less the cost per convention [nat].
    is_near : bool
        Whether the estimated share is near one.
    is_conclusive : bool
        Whether share, skew and explained residual are all plausible.
    """

    case: Case
    hold: Hold
    skew_s: float
    log_likelihood_gain: float
    is_near: bool
    is_conclusive: bool

    @property
    def lines(self) -> list[str]:
        """Descriptions of the convention."""
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
    """Return the screening under the most likely convention.

    The screening is unchanged where the case states the convention or the data do not identify it. Semi-implicit
    simulators store positions half a step ahead of velocities, which counts as convention. Control laws and structures
    have known timing.

    Parameters
    ----------
    screen : ScoreTest
        Screening.
    signals : callable
        Returns the fit runs of a case with another convention.
    again : callable
        Returns the screening of a case with another convention and note, or None.
    leaves : callable
        Returns the mean square of a refit to whole runs, over noise and model error.
    effects : sequence of Effect
        Candidate effects.

    Returns
    -------
    ScoreTest
        Screening.
    """
    lines: list[str] = []
    for _ in range(SAMPLING_CONVENTION.most_passes):
        problem = screen.problem
        if not problem.model_kind.has_open_conventions or not _shows(problem):
            break
        left_open = _left_open(problem, signals)
        conventions = list(_conventions(screen, left_open))
        found = _favoured_convention(screen, left_open, conventions, effects)
        likely = found or _hinted_at(conventions)
        other = None if likely is None else again(likely.case, note_of_conventions([*lines, *likely.lines]))
        if likely is None or other is None or (found is None and not _leaves_less(leaves, other, screen)):
            break
        lines += likely.lines
        screen = other
    return screen


def open_holds(problem: Problem) -> list[Hold]:
    """Return the holds that a case leaves open.

    Parameters
    ----------
    problem : Problem
        Problem.

    Returns
    -------
    list of Hold
        Holds; empty where the data decided or cannot decide.
    """
    if problem.timing or not problem.model_kind.has_open_conventions or not _shows(problem):
        return []
    return [hold for hold, _ in _others(problem.case) if hold in ("linear", "zero")]


def decided_holds(problem: Problem, stated: Case) -> list[Hold]:
    """Return the other holds where the data decided on one.

    Parameters
    ----------
    problem : Problem
        Problem with the decided hold.
    stated : Case
        Case as it is stated.

    Returns
    -------
    list of Hold
        Holds; empty where the case states the hold, or none was decided on.
    """
    if not problem.timing or not problem.model_kind.has_open_conventions:
        return []
    holds: tuple[Hold, ...] = ("linear", "zero")
    return [hold for hold in holds if with_decided_hold(problem.case, hold, stated).table != problem.case.table]


def with_decided_hold(case: Case, hold: Hold, stated: Case) -> Case:
    """Return a case with a hold for inputs without a stated one.

    Parameters
    ----------
    case : Case
        Case with any holds.
    hold : Hold
        Hold.
    stated : Case
        The same case as it is stated.

    Returns
    -------
    Case
        Case with the hold.
    """
    tables = []
    for table, own in zip(case.table.recording, stated.table.recording, strict=True):
        is_open = {c.column for c in own.channel if c.input and not c.hold}
        channels = tuple(replace(c, hold=hold) if c.input and c.column in is_open else c for c in table.channel)
        tables.append(replace(table, channel=channels))
    return case.with_recordings(tables)


def describe_hold(hold: Hold) -> str:
    """Return a hold's description and its setting."""
    return f'{WORDS[hold]} (hold = "{hold}")'


def note_of_conventions(lines: Sequence[str]) -> str:
    """Return conventions as one note."""
    return f"{'; '.join(lines)}: the case does not say it, the recordings do"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Open:
    """Conventions that a case leaves open.

    Parameters
    ----------
    inputs : list of (str, Case, sequence of Signals)
        Holds with case and signals; "" without signals for the assumed one.
    skewable : list of int
        Channels that a simulator's steps may skew.
    half_step : float
        Unit of the skew [s].
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
    """Return the convention of largest gain, or None."""
    gaining = [convention for convention in conventions if convention.log_likelihood_gain > SAMPLING_CONVENTION.gain]
    conclusive = [convention for convention in gaining if convention.is_conclusive]
    if conclusive or not gaining:
        return max(conclusive, key=lambda convention: convention.log_likelihood_gain, default=None)
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
    """Return the input hold that the innovations weakly favour.

    A filter with much process noise hides most of a convention in slow motion.
    """
    holds = [
        c
        for c in conventions
        if c.hold and not c.skew_s and c.is_near and c.log_likelihood_gain > SAMPLING_CONVENTION.hint
    ]
    return max(holds, key=lambda c: c.log_likelihood_gain, default=None)


def _leaves_less(leaves: Callable[[S], float], other: S, screen: S) -> bool:
    """Return whether a refit leaves much less under another screening."""
    return leaves(other) < SAMPLING_CONVENTION.much_less * leaves(screen)


def _conventions(screen: ScoreTest, left_open: _Open) -> Iterator[_Convention]:
    """Yield the open conventions with their gains."""
    step = left_open.half_step
    for hold, case, signals in left_open.inputs:
        first = [signals] if hold else []
        for moved in ([], left_open.skewable) if left_open.skewable else ([],):
            if not first and not moved:
                continue
            shares, log_likelihood_gain, explained = input_shares(screen, first, moved, step)
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
    """Return a problem's signals with other inputs."""
    return [
        replace(s, u=t.u, y=t.y, load=np.hstack([t.load, s.load[:, t.load.shape[1] :]]))
        for s, t in zip(problem.signals, signals, strict=True)
    ]


def _half_step(problem: Problem) -> float:
    """Return half the shorter of integration step and sample [s]."""
    return 0.5 * min(problem.plant.timestep, *(run.measured.sample_period for run in problem.runs))


def _skewable(problem: Problem) -> list[int]:
    """Return the channels that a simulator's steps would skew.

    There are none without staggered steps, with a stated delay, or without evidence in the channels.
    """
    is_driven = any(run.drives for run in problem.runs)
    if not is_driven and len({order == 1 for order in problem.orders}) < 2:
        return []  # positions of a release do not identify its start
    stated = any(channel.delay_s for table in problem.case.table.recording for channel in table.channel)
    if problem.plant.model.opt.integrator not in STAGGERED or stated:
        return []
    if not all(run.measured.is_uniform for run in problem.case.runs()):
        return []
    return [i for i, order in enumerate(problem.orders) if order != 1]


def _skewed(case: Case, seconds: float) -> Case:
    """Return a case with a time skew."""

    def moved(channel: ChannelTable) -> ChannelTable:
        is_skewed = not channel.input and ORDER.get(channel.kind, 0) != 1
        return replace(channel, delay_s=-seconds) if is_skewed else channel

    return case.with_channels(lambda table: map(moved, table.channel))


def _shows(problem: Problem) -> bool:
    """Return whether half a sample exceeds the noise in some channel.

    Control laws keep their own time and are excluded.
    """
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
    """Yield the other holds that a case leaves open, with the case."""
    for hold in WORDS:
        other = with_hold(case, hold)
        if other.table != case.table:
            yield hold, other


def with_hold(case: Case, hold: Hold) -> Case:
    """Return a case with an input hold, where open.

    Parameters
    ----------
    case : Case
        Case.
    hold : Hold
        Hold.

    Returns
    -------
    Case
        Case with the hold.
    """
    return case.with_channels(lambda table: (_with(channel, hold) for channel in table.channel))


def _with(channel: ChannelTable, hold: Hold) -> ChannelTable:
    is_open = channel.input and (not channel.hold or (channel.hold == "zero" and hold == "zero-first"))
    if not is_open or (not channel.hold and hold == ("zero" if channel.is_held else "linear")):
        return channel
    return replace(channel, hold=hold)
