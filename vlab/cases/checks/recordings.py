"""What is wrong with what a case says of its recordings, found beside the model as given, before anything is fitted or sought.

A slip of a sign or a unit, two columns exchanged, an output early or late, an input that drives something else: each is proposed where the
bands of a channel show it, and believed where a simulation of the recordings without it leaves little. It is said with the lines of the
case that mend it, and never mended here.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, islice

import numpy as np

from vlab.cases.case import Case
from vlab.cases.checks.bands import bands
from vlab.cases.checks.beside import FEWEST, Beside, beside, first_seconds
from vlab.cases.checks.coherence import unrelated
from vlab.cases.checks.correction import (
    Correction,
    FileCheck,
    Found,
    Severity,
    Taken,
    columns_of,
    slips_of,
)
from vlab.cases.checks.shifts import shifts
from vlab.cases.checks.slips import SMALL, is_turned, reading, slip_of_unit, slip_without_sign
from vlab.cases.wiring import Run
from vlab.signals import Recording

UNEXPLAINED = 0.5
"""Other readings of the inputs are tried where the model leaves this share of some channel in most bands of some recording."""
WORSE = 1.2
"""A correction of a channel may leave this multiple of what was left of others, and `SLACK` more."""
SLACK = 0.02
"""Share of the recorded power that is no matter: a tenth of the size is more."""
SMALLER = 0.1
"""Exchanged columns are believed where they leave this share of what is left otherwise."""
MOST_TRIED = 40
"""Other readings of the inputs that are tried, each in a simulation of the shortest recording."""


def check_recordings(
    case: Case, runs: Sequence[Run] | None = None, simulated: Sequence[Recording | None] | None = None
) -> FileCheck:
    """Say what is wrong with what a case says of its recordings.

    Parameters
    ----------
    runs : sequence of Run, optional
        As wired; all of the case by default.
    simulated : sequence of Recording, optional
        What the model as given does; the first seconds are simulated by default.

    Returns
    -------
    FileCheck
        Empty where nothing is wrong, or nothing shows.
    """
    runs = case.runs() if runs is None else list(runs)
    if simulated is None:
        runs = [first_seconds(case.plant, run) for run in runs]
    look = _Look(case, beside(case.plant, runs, simulated))
    found = look.slips() or look.swaps() or look.readings_of_inputs() or look.unrelated() or look.without_sign()
    return FileCheck(found=(*found, *look.shifts({name for f in found for name in f.channels})))


class _Look:
    """A case beside its model as given, and what may be wrong with it."""

    def __init__(self, case: Case, now: Beside) -> None:
        self.case, self.now = case, now
        self.columns = columns_of(case)
        self.inputs = tuple(dict.fromkeys(drive.channel for run in now.runs for drive in run.drives))
        self.outputs = tuple(name for name, of_runs in now.channels.items() if of_runs)

    # ---- signs and units ------------------------------------------------------------------------------------------

    def slips(self) -> list[Found]:
        """Return the slips of signs and units that channels show."""
        own = {name: taken for name in self.outputs if (taken := self._own_slip(name)) is not None}
        of_input = self._slip_of_input() if len(self.outputs) > 1 or not own else None
        if of_input is not None:
            return [self._said_of_input(of_input)]
        together = Correction(taken=tuple(own.values()))
        return [self._said_of_output(taken) for taken in own.values()] if own and self._holds(together) else []

    def _own_slip(self, name: str) -> Taken | None:
        slip = slip_of_unit(self.now.channels[name], slips_of(self.columns[name]))
        if slip is not None:
            return Taken(channel=name, source=name, factor=slip[1], unit=slip[0])
        return Taken(channel=name, source=name, factor=-1.0) if is_turned(self.now.channels[name]) else None

    def _slip_of_input(self) -> Taken | None:
        """Return the slip of the one input that makes all outputs what they are, if there is one."""
        if len(self.inputs) != 1 or not self.outputs:
            return None
        name = self.inputs[0]
        if all(is_turned(self.now.channels[output]) for output in self.outputs):
            taken = Taken(channel=name, source=name, factor=-1.0)
            return taken if self._holds(Correction(taken=(taken,))) else None
        # where a force is too large the model moves too much, and the recordings show too little
        seen = {unit: 1.0 / slip for unit, slip in slips_of(self.columns[name]).items()}
        found = [slip_of_unit(self.now.channels[output], seen) for output in self.outputs]
        if None in found or len(set(found)) != 1 or found[0] is None:
            return None
        taken = Taken(channel=name, source=name, factor=1.0 / found[0][1], unit=found[0][0])
        return taken if self._holds(Correction(taken=(taken,))) else None

    def _said_of_output(self, taken: Taken) -> Found:
        read, column = reading(self.now.channels[taken.channel]), self.columns[taken.channel]
        assert read is not None
        size = float(np.exp(read.log_size))
        if taken.unit:
            text = (
                f"{taken.channel} is {_number(np.sign(taken.factor) * size)} times what the model gives in every recording, as if its "
                f"numbers were in {taken.unit} and not in {column.unit}"
            )
        else:
            text = f"{taken.channel} is the model's with its sign turned in every recording (fit {-size:.2f})"
        ways = [Correction(taken=(taken,))]
        if self.outputs == (taken.channel,):  # of one input and one output either may be it
            of_input = self._slip_of_input()
            ways += [] if of_input is None else [Correction(taken=(of_input,))]
        return self._found(text, ways)

    def _said_of_input(self, taken: Taken) -> Found:
        what = " and ".join(self.outputs) if len(self.outputs) <= 3 else f"all {len(self.outputs)} outputs"
        if taken.unit:
            text = (
                f"{taken.channel} seems to be in {taken.unit} and not in {self.columns[taken.channel].unit}: with it {what} are as large "
                "as the model gives in every recording"
            )
        else:
            text = (
                f"{taken.channel} has its sign turned: {what} are the model's with the sign turned in every recording"
            )
        return self._found(text, [Correction(taken=(taken,))])

    # ---- columns exchanged ----------------------------------------------------------------------------------------

    def swaps(self) -> list[Found]:
        """Return the outputs that show each other's motion."""
        out: list[Found] = []
        for one, other in combinations(self.outputs, 2):
            if any({one, other} & set(f.channels) for f in out) or not self._alike(one, other):
                continue
            correction = Correction(taken=(Taken(channel=one, source=other), Taken(channel=other, source=one)))
            crossed = self._crossed(one, other)
            before = min(self.now.left(one), self.now.left(other))
            if before > SLACK and crossed <= SMALLER * before and self._holds(correction):
                text = (
                    f"{one} and {other} show each other's motion in every recording, as if their columns were exchanged"
                )
                out.append(self._found(text, [correction]))
        return out

    def _alike(self, one: str, other: str) -> bool:
        return self.columns[one].si == self.columns[other].si

    def _crossed(self, one: str, other: str) -> float:
        """Return the most that is left of two channels beside what the model says of each other's, in any run."""
        left = [0.0]
        for run, own in zip(self.now.runs, self.now.simulated, strict=True):
            if own is None or not {one, other} <= set(run.measured.names):
                continue
            for name, model in ((one, other), (other, one)):
                found = bands(run.measured.time, run.measured[name], own[model])
                left.append(found.left() if len(found) >= FEWEST else 0.0)
        return max(left) if len(left) > 1 else 1.0

    # ---- inputs read otherwise ------------------------------------------------------------------------------------

    def readings_of_inputs(self) -> list[Found]:
        """Return what is wrong with inputs of which a model is not linear enough to show it channel by channel."""
        if not self.now.channels or (self.outputs and self.now.worst < UNEXPLAINED):
            return []
        short = min(self.now.runs, key=lambda run: float(run.measured.time[-1] - run.measured.time[0]))
        found, best = None, SMALL
        for correction in islice(self._other_readings(), MOST_TRIED):
            tried = beside(self.case.plant, [correction.on(short)])
            if any(tried.channels.values()) and tried.worst < best and self._holds(correction):
                found, best = correction, tried.worst
        return [] if found is None else [self._found(self._words_of(found), [found])]

    def _other_readings(self) -> Iterator[Correction]:
        for name in self.inputs:
            yield Correction(taken=(Taken(channel=name, source=name, factor=-1.0),))
        for one, other in combinations(self.inputs, 2):
            if self._alike(one, other):
                yield Correction(taken=(Taken(channel=one, source=other), Taken(channel=other, source=one)))
        for name in self.inputs:
            for unit, slip in slips_of(self.columns[name]).items():
                yield Correction(taken=(Taken(channel=name, source=name, factor=slip, unit=unit),))
        kinds = dict.fromkeys(self.columns[name].unit for name in self.now.channels)
        for kind in kinds:  # one hand writes all encoders of a file
            same = [name for name in self.now.channels if self.columns[name].unit == kind]
            for unit, slip in slips_of(self.columns[same[0]]).items():
                yield Correction(taken=tuple(Taken(channel=n, source=n, factor=slip, unit=unit) for n in same))

    def _words_of(self, correction: Correction) -> str:
        names = " and ".join(correction.channels)
        if correction.is_swap:
            what = f"{names} drive each other's places, as if their columns were exchanged"
        elif correction.taken[0].unit:
            said = self.columns[correction.channels[0]].unit
            what = f"{names} seems to be in {correction.taken[0].unit} and not in {said}"
        else:
            what = f"{names} has its sign turned"
        return f"{what}: read so, every recording is as the model gives it"

    # ---- what no line of a case mends -----------------------------------------------------------------------------

    def unrelated(self) -> list[Found]:
        """Return that no output has anything to do with the inputs, where the model says that all do."""
        text = unrelated(self.now)
        return [Found(severity="warning", text=text, channels=self.outputs)] if text else []

    def without_sign(self) -> list[Found]:
        """Return outputs of a size that no physics makes, where the model's resonances lie too far off to show a sign."""
        if any(run.law is not None for run in self.now.runs):
            return []  # a loop that is unstable with the model as given runs to any size
        out = []
        for name in self.outputs:
            slip = slip_without_sign(self.now.channels[name], slips_of(self.columns[name]))
            if slip is not None:
                taken = Taken(channel=name, source=name, factor=slip[1], unit=slip[0])
                out.append(replace(self._said_of_output(taken), severity="warning"))
        return out

    def shifts(self, aside: set[str]) -> list[Found]:
        """Return the outputs that are early or late."""
        return [found for found in shifts(self.now, self.columns) if not aside & set(found.channels)]

    # ---- whether a correction holds -------------------------------------------------------------------------------

    def _holds(self, correction: Correction) -> bool:
        """Return whether the model does better on all recordings without a slip, and nowhere worse."""
        then = beside(self.case.plant, [correction.on(run) for run in self.now.runs])
        concerned = set(self.outputs) & set(correction.channels) or set(self.outputs) or set(then.channels)
        if not all(then.channels[name] for name in concerned):
            return False
        for name, of_runs in then.channels.items():
            before, after = self.now.left(name), then.left(name)
            if name not in concerned:
                if after > WORSE * before + SLACK:
                    return False
            elif (
                is_turned(of_runs)
                or slip_of_unit(of_runs, slips_of(self.columns[name])) is not None
                or (after > SMALL and after > before - SLACK and not correction.is_beyond_physics)
            ):
                return False
        return True

    def _found(self, text: str, ways: Sequence[Correction]) -> Found:
        severity: Severity = "warning" if all(t.factor == -1.0 for t in ways[0].taken) else "fatal"
        words = (
            f"{text}; to mend it, say in {self.case.path.name}: {'; or '.join(way.edits(self.case) for way in ways)}"
        )
        return Found(severity=severity, text=words, channels=ways[0].channels)


def _number(value: float) -> str:
    return f"{value:.4g}"
