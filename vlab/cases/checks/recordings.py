"""Checks of column descriptions against the nominal model.

Candidate mistakes are a sign, a unit, two exchanged columns, a time shift or an unrelated input. The bands of a channel
propose a candidate. A simulation of the corrected recordings accepts the candidate if the residual is small. The
finding names the edit of the case.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, islice

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.cases.checks.bands import bands
from vlab.cases.checks.beside import EXPLAINED, FEWEST, UNEXPLAINED, Beside, beside, first_seconds
from vlab.cases.checks.clock import check_clock
from vlab.cases.checks.coherence import unrelated
from vlab.cases.checks.copies import check_copies
from vlab.cases.checks.correction import (
    Correction,
    FileCheck,
    Found,
    Severity,
    Taken,
    columns_of,
    mend_in,
    slips_of,
)
from vlab.cases.checks.periods import check_periods
from vlab.cases.checks.ranges import check_ranges
from vlab.cases.checks.shifts import shifts
from vlab.cases.checks.sizes import check_sizes
from vlab.cases.checks.slips import SMALL, is_turned, near_units, reading, slip_of_unit, slip_without_sign
from vlab.cases.checks.still import check_still
from vlab.cases.checks.wraps import check_wraps
from vlab.signals import Recording

WORSE = 1.2
"""WORSE [1]: largest growth of another channel's residual under a correction, with `SLACK` in addition."""
SLACK = 0.02
"""SLACK [1]: negligible share of the recorded power; 0.01 is a tenth of the amplitude."""
SMALLER = 0.1
"""SMALLER [1]: residual ratio below which a correction of a partly explained channel is accepted."""
MOST_TRIED = 12
"""MOST_TRIED [1]: largest number of trial corrections."""
STEPS_TRIED = 4000
"""STEPS_TRIED [1]: integration steps of each trial, on the recording with most unexplained channels."""


def check_recordings(
    case: Case, runs: Sequence[Run] | None = None, simulated: Sequence[Recording | None] | None = None
) -> FileCheck:
    """Check the column descriptions of a case.

    Parameters
    ----------
    case : Case
        Case with its model.
    runs : sequence of Run, optional
        Runs of the case; read from the files by default.
    simulated : sequence of Recording, optional
        Response of the nominal model; the first seconds are simulated by default.

    Returns
    -------
    FileCheck
        Findings; empty without any.

    Raises
    ------
    BadCase
        The unit of time is wrong, see `vlab.cases.checks.clock`.
    """
    runs = case.runs() if runs is None else list(runs)
    damaged = check_still(runs) or check_wraps(case, runs)
    if damaged:
        return FileCheck(found=tuple(damaged))
    if simulated is None:
        check_clock(case, runs)
    of_range, of_all = check_ranges(case, runs), [*check_copies(runs), *check_periods(runs)]
    runs = [first_seconds(case.plant, run) for run in runs]
    look = _Look(case, beside(case.plant, runs, simulated))
    found = look.slips() or look.swaps() or look.choose_convention() or look.unrelated() or look.without_sign()
    said = {name for f in found for name in f.channels}
    of_range = [f for f in of_range if not said & set(f.channels)]
    said |= {name for f in of_range for name in f.channels}
    of_size = [] if found else check_sizes(case, look.now, said)  # a wrong input changes every size
    return FileCheck(found=(*found, *of_range, *of_all, *of_size, *look.shifts(said)))


class _Look:
    """Search for mistakes in a case beside its nominal model."""

    def __init__(self, case: Case, now: Beside) -> None:
        self.case, self.now = case, now
        self.columns = columns_of(case)
        self.inputs = tuple(dict.fromkeys(drive.channel for run in now.runs for drive in run.drives))
        self.outputs = tuple(name for name, of_runs in now.channels.items() if of_runs)

    # ---- signs and units ------------------------------------------------------------------------------------------

    def slips(self) -> list[Found]:
        """Return visible mistakes of signs and units."""
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
        """Return the mistake of one input that explains all outputs."""
        if len(self.inputs) != 1 or not self.outputs:
            return None
        name = self.inputs[0]
        if all(is_turned(self.now.channels[output]) for output in self.outputs):
            taken = Taken(channel=name, source=name, factor=-1.0)
            return taken if self._holds(Correction(taken=(taken,))) else None
        # too large a force moves the model too much, so the recordings look too small
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
            units = " or ".join(near_units(read, slips_of(column)))
            text = (
                f"{taken.channel} is {np.sign(taken.factor) * size:.4g} times what the model gives in every recording, as if its "
                f"numbers were in {units} and not in {column.unit}"
            )
        else:
            text = f"{taken.channel} is the model's with its sign turned in every recording (fit {-size:.2f})"
        return self._found(text, [Correction(taken=(taken,)), *self._by_an_input(taken)])

    def _by_an_input(self, taken: Taken) -> list[Correction]:
        """Return input mistakes that explain an output's mistake too.

        If input and output change in proportion, either may be wrong.
        """
        out = []
        for name in self.inputs:
            slips = {"": -1.0} if not taken.unit else slips_of(self.columns[name])
            for unit, slip in slips.items():
                if abs(taken.factor * slip - 1.0) < SMALL:
                    correction = Correction(taken=(Taken(channel=name, source=name, factor=slip, unit=unit),))
                    out += [correction] if self._holds(correction) else []
        return out

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
        """Return pairs of exchanged outputs."""
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
        """Return the largest residual share of two exchanged channels."""
        left = [0.0]
        for run, own in zip(self.now.runs, self.now.simulated, strict=True):
            if own is None or not {one, other} <= set(run.measured.names):
                continue
            for name, model in ((one, other), (other, one)):
                found = bands(run.measured.time, run.measured[name], own[model])
                left.append(found.left() if len(found) >= FEWEST else 0.0)
        return max(left) if len(left) > 1 else 1.0

    # ---- columns read otherwise -----------------------------------------------------------------------------------

    def choose_convention(self) -> list[Found]:
        """Return mistakes found by trial simulations.

        Such mistakes concern inputs, or outputs that spoil the initial state. A nonlinear model hides both from the
        bands.
        """
        unexplained = self._unexplained(self.now)
        if not unexplained:
            return []

        def left(run: Run) -> int:
            at = beside(self.case.plant, [run])
            own = [name for name in unexplained if name in at.channels]  # not every recording has every channel
            return sum(not at.channels[name] or at.left(name) > EXPLAINED for name in own)

        parts = [first_seconds(self.case.plant, run, STEPS_TRIED) for run in self.now.runs]
        as_said = [left(part) for part in parts]
        found, best = None, max(as_said)
        worst = parts[as_said.index(best)]
        for correction in islice(self._other_readings(unexplained), MOST_TRIED):
            still = left(correction.on(worst))
            if still < best and self._is_better(correction) and self._explains(correction, unexplained):
                found, best = correction, still
        return [] if found is None else [self._found(self._words_of(found), [found])]

    def _explains(self, correction: Correction, names: Sequence[str]) -> bool:
        """Return whether the model gives some channels in all recordings under a correction."""
        then = beside(self.case.plant, [correction.on(run) for run in self.now.runs])
        return all(then.channels.get(name) and then.left(name) <= EXPLAINED for name in names)

    def _unexplained(self, at: Beside) -> list[str]:
        return [name for name in at.channels if at.left(name) >= UNEXPLAINED]

    def _other_readings(self, unexplained: Sequence[str]) -> Iterator[Correction]:
        """Yield trial corrections, those with few columns first.

        The corrections concern every input and every unexplained output.
        """
        for name in self.inputs:
            yield Correction(taken=(Taken(channel=name, source=name, factor=-1.0),))
        for one, other in combinations(self.inputs, 2):
            if self._alike(one, other):
                yield Correction(taken=(Taken(channel=one, source=other), Taken(channel=other, source=one)))
        for name in (*unexplained, *self.inputs):
            yield from self._in_other_units((name,))
        units = dict.fromkeys(self.columns[name].unit for name in unexplained)
        for unit in units:  # all encoders of a file usually share one unit
            names = tuple(name for name in unexplained if self.columns[name].unit == unit)
            if len(names) > 1:
                yield from self._in_other_units(names)

    def _in_other_units(self, names: Sequence[str]) -> Iterator[Correction]:
        for unit, slip in slips_of(self.columns[names[0]]).items():
            yield Correction(taken=tuple(Taken(channel=n, source=n, factor=slip, unit=unit) for n in names))

    def _words_of(self, correction: Correction) -> str:
        names = " and ".join(correction.channels)
        if correction.is_swap:
            what = f"{names} drive each other's places, as if their columns were exchanged"
        elif correction.taken[0].unit:
            said = self.columns[correction.channels[0]].unit
            what = f"{names}: the numbers are in {correction.taken[0].unit} and not in {said}"
        else:
            what = f"{names}: the sign is turned"
        return f"{what}: read so, the recordings are nearly what the model gives, and are not otherwise"

    # ---- what no line of a case mends -----------------------------------------------------------------------------

    def unrelated(self) -> list[Found]:
        """Return a finding if outputs are unrelated to inputs.

        The model's outputs must be coherent with the inputs.
        """
        text = unrelated(self.now)
        return [Found(severity="warning", text=text, channels=self.outputs)] if text else []

    def without_sign(self) -> list[Found]:
        """Return outputs of an impossible amplitude.

        The model's resonances are too far off for a sign.
        """
        if any(run.law is not None for run in self.now.runs):
            return []  # an unstable loop with the nominal model reaches any amplitude
        out = []
        for name in self.outputs:
            slip = slip_without_sign(self.now.channels[name], slips_of(self.columns[name]))
            if slip is not None:
                taken = Taken(channel=name, source=name, factor=slip[1], unit=slip[0])
                out.append(replace(self._said_of_output(taken), severity="warning"))
        return out

    def shifts(self, aside: set[str]) -> list[Found]:
        """Return outputs with a time shift."""
        return [found for found in shifts(self.now) if not aside & set(found.channels)]

    # ---- whether a correction holds -------------------------------------------------------------------------------

    def _holds(self, correction: Correction) -> bool:
        """Return whether a correction improves on the case as given."""
        return self._is_better(correction, beyond_physics=correction.is_beyond_physics)

    def _is_better(self, correction: Correction, *, beyond_physics: bool = False) -> bool:
        """Return whether a correction improves all recordings.

        No channel may become worse.

        Parameters
        ----------
        beyond_physics : bool
            Whether no deterioration suffices, without an improvement.
        """
        then = beside(self.case.plant, [correction.on(run) for run in self.now.runs])
        concerned = set(then.channels) & set(correction.channels) or set(then.channels)
        is_better = beyond_physics
        for name, of_runs in then.channels.items():
            before, after = self.now.left(name), then.left(name)
            if after > WORSE * before + SLACK or (name in correction.channels and not of_runs):
                return False
            if name in concerned and (is_turned(of_runs) or slip_of_unit(of_runs, slips_of(self.columns[name]))):
                return False
            is_explained = before >= UNEXPLAINED and after <= EXPLAINED
            is_with = correction.is_turned and (read := reading(of_runs)) is not None and read.sign == 1.0
            is_better |= name in concerned and (is_explained or after <= SMALLER * before or is_with)
        return is_better

    def _found(self, text: str, ways: Sequence[Correction]) -> Found:
        severity: Severity = "warning" if ways[0].is_turned else "fatal"
        mend = "; or ".join(way.edits(self.case) for way in ways)
        words = f"{text}{mend_in(self.case)}{mend}"
        return Found(severity=severity, text=words, channels=ways[0].channels, mend=mend)
