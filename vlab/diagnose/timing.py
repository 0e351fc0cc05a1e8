"""When inputs act, where a case does not say it: read off the recordings.

Whether a command stands from its sample on or stood until it, runs straight from sample to sample, and whether the readings of its
sample were taken before it went out, is a convention of whoever wrote the file. Half a sample more or less is no physics, but at
half the sample rate it turns phases by a right angle.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vlab.cases.case import Case
from vlab.cases.description import ChannelTable, Hold
from vlab.diagnose.noise import noise_levels
from vlab.diagnose.prepare import prepare
from vlab.diagnose.problem import Problem
from vlab.diagnose.screen import Screen

WORDS: dict[Hold, str] = {
    "linear": "inputs run straight from sample to sample",
    "zero": "inputs stand from their sample to the next, whose readings are the first to see them",
    "zero-first": "inputs stand from their sample to the next, and its own readings see them",
    "past": "inputs stood from the sample before until their own",
}
NEAR = 0.2
"""Another convention is taken where the recordings ask for it and for nothing else: for this much more or less of it at most."""
GAIN = 30.0
"""It must gain this much in log-likelihood: as much as the refitted parameters' directions could together by chance, and more."""
EXPLAINED = 0.05
"""It must explain this share of what the refitted model leaves."""
SEEN = 0.5
"""Conventions are compared where half a sample moves the readings by this multiple of their noise."""


def timed(problem: Problem) -> Problem:
    """Return a problem whose inputs act when the recordings show that they do; the same one where its case says it, or nothing shows.

    Laws in the loop are replayed on their own clock, and the two structures' converters are known: these stay as they are.
    """
    case = problem.case
    if case.structure is not None or any(run.law is not None for run in problem.runs) or not _matters(problem):
        return problem
    others = list(_others(case))
    if not others:
        return problem
    screen, best, most = Screen(problem), problem, GAIN
    for hold, other in others:
        candidate = prepare(other, [run.role for run in problem.runs])
        share, gain, explained = screen.instead(candidate.signals)
        if gain > most and explained > EXPLAINED and abs(share - 1.0) < NEAR:
            line = f'{WORDS[hold]} (hold = "{hold}"): the case does not say it, the recordings do'
            best, most = replace(candidate, timing=line), gain
    return best


def _matters(problem: Problem) -> bool:
    """Return whether half a sample shows: in readings that move in it, or in readings of the inputs themselves."""
    for run in problem.runs:
        if not run.drives or not run.measured.is_uniform:
            continue
        noise = noise_levels(run, problem.names)
        columns = np.column_stack([run.measured[name] for name in problem.names])
        moved = np.mean(np.diff(columns, axis=0) ** 2, axis=0) - 2.0 * noise**2
        if np.any(moved > (2.0 * SEEN * noise) ** 2):
            return True
    return False


def _others(case: Case) -> Iterator[tuple[Hold, Case]]:
    """Yield the other conventions that a case leaves open, and the case with each of them."""
    for hold in WORDS:
        tables = [
            replace(table, channel=tuple(_with(channel, hold) for channel in table.channel))
            for table in case.table.recording
        ]
        if any(table != given for table, given in zip(tables, case.table.recording, strict=True)):
            yield hold, replace(case, table=replace(case.table, recording=tuple(tables)))


def _with(channel: ChannelTable, hold: Hold) -> ChannelTable:
    is_open = channel.input and (not channel.hold or (channel.hold == "zero" and hold == "zero-first"))
    if not is_open or (not channel.hold and hold == ("zero" if channel.is_held else "linear")):
        return channel
    return replace(channel, hold=hold)
