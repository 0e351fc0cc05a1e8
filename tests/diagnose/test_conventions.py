"""When inputs act, in its parts: what a case leaves open, what shows, and what a screening makes of either."""

from dataclasses import replace

import numpy as np
import pytest
import test_sampling_convention
from test_sampling_convention import MODEL, stepped
from test_sampling_convention import case as case_of

from vlab.cases.description import ChannelTable
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.search.sampling_convention import (
    WORDS,
    _Convention,
    _favoured_convention,
    _half_step,
    _hinted_at,
    _leaves_less,
    _shows,
    _skewable,
    _skewed,
    describe_hold,
    note_of_conventions,
    open_holds,
    score_by_timing,
    with_hold,
)
from vlab.diagnose.settings import SAMPLING_CONVENTION

STEP = 1.0 / test_sampling_convention.RATE
"""As long as a sample, so that a step's half is half a sample."""


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Return cases of two seconds by when their inputs act and what is said of it, each written once."""
    known = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(test_sampling_convention, "SECONDS", 2.0)

        def of(truth, **given):
            key = (truth, tuple(sorted(given.items())))
            if key not in known:
                known[key] = case_of(tmp_path_factory.mktemp("case"), truth, **given)
            return known[key]

        yield of


def channels(case):
    return [c for table in case.table.recording for c in table.channel]


# ---- what a case says and leaves open -------------------------------------------------------------------------------


@pytest.mark.parametrize("hold", WORDS)
def test_a_hold_that_a_case_states_is_kept_whatever_is_tried(written, hold):
    """But that of a stated hold from its sample on it may be open which readings see it first."""
    stated = written("linear", hold=hold)
    for other in WORDS:
        tried = with_hold(stated, other)
        inputs = {c.hold for c in channels(tried) if c.input}
        assert inputs == {"zero-first" if (hold, other) == ("zero", "zero-first") else hold}
        assert [c for c in channels(tried) if not c.input] == [c for c in channels(stated) if not c.input]


@pytest.mark.parametrize(("given", "usual"), [("force", "linear"), ("command", "zero")])
def test_what_a_case_is_taken_to_mean_is_not_tried_as_another_convention(written, given, usual):
    """Forces run straight where nothing is said, and commands stand."""
    case = written("linear", given=given)
    assert with_hold(case, usual).table == case.table
    changed = {hold for hold in WORDS if with_hold(case, hold).table != case.table}
    assert changed == set(WORDS) - {usual}
    for hold in changed:
        once = with_hold(case, hold)
        assert {c.hold for c in channels(once) if c.input} == {hold}
        assert with_hold(once, hold).table == once.table


def test_readings_that_were_skewed_stand_so_much_ahead_but_velocities(written):
    case = written("linear", rows=stepped(1), velocity=True)
    skewed = _skewed(case, 7e-4)
    for was, now in zip(channels(case), channels(skewed), strict=True):
        expected = -7e-4 if was.kind == "displacement" else was.delay_s
        assert now == replace(was, delay_s=expected)
    assert _skewed(case, 0.0).table == case.table


def test_every_convention_is_said_with_the_word_that_a_case_has_for_it():
    for hold in WORDS:
        assert f'hold = "{hold}"' in describe_hold(hold)
        ChannelTable(
            column="u", at="motor", kind="force", unit="N", input=True, hold=hold
        )  # the case's own reader knows it
    line = note_of_conventions([describe_hold("past"), "something else"])
    assert all(part in line for part in (describe_hold("past"), "something else", "recordings do"))


# ---- what shows -----------------------------------------------------------------------------------------------------


def test_half_a_sample_shows_where_readings_move_in_it(written):
    problem = prepare(written("zero"))
    assert _shows(problem)
    noisy = []
    for run in problem.runs:
        data, rng = run.measured.data.copy(), np.random.default_rng(0)
        column = run.measured.index(problem.names[0])
        data[:, column] += 30 * data[:, column].std() * rng.standard_normal(len(data))
        noisy.append(replace(run, measured=replace(run.measured, data=data)))
    assert not _shows(replace(problem, runs=tuple(noisy)))
    free = tuple(replace(run, drives=()) for run in problem.runs)
    assert not _shows(replace(problem, runs=free))  # without an input there is nothing to act
    replayed = tuple(replace(run, law=object()) for run in problem.runs)
    assert not _shows(replace(problem, runs=replayed))  # a law keeps its own time


def test_holds_are_open_until_the_recordings_have_told(written):
    problem = prepare(written("zero"))
    assert open_holds(problem) == ["zero"]
    assert open_holds(replace(problem, timing="told")) == []
    assert open_holds(prepare(written("zero", given="command"))) == ["linear"]
    assert open_holds(prepare(written("past", hold="linear"))) == []


def test_half_a_step_is_that_of_the_model_or_of_a_sample_whichever_is_shorter(written):
    fine = prepare(written("zero"))
    assert _half_step(fine) == pytest.approx(0.5 * 0.0005)
    coarse = prepare(written("zero", model=MODEL.replace('timestep="0.0005"', 'timestep="0.01"')))
    assert _half_step(coarse) == pytest.approx(0.5 * STEP)


def test_steps_skew_positions_and_accelerations_and_never_velocities(written):
    case = written("", rows=stepped(1), velocity=True)
    problem = prepare(case)
    assert [problem.orders[i] for i in _skewable(problem)] == [order for order in problem.orders if order != 1] == [0]
    exact = MODEL.replace("<option ", '<option integrator="RK4" ')
    assert _skewable(prepare(written("", rows=stepped(1), velocity=True, model=exact))) == []  # its steps leave none
    assert _skewable(prepare(_skewed(case, 1e-4))) == []  # the case states one


# ---- what a screening makes of it -----------------------------------------------------------------------------------


TOLD: dict = {}


def told(case):
    """Return the screening that one of a case ends with, and what it was told on the way; each is made once."""
    if id(case) in TOLD:
        return TOLD[id(case)][1:]
    lines = []

    def again(other, line):
        lines.append(line)
        return ScoreTest(replace(prepare(other), timing=line))

    def leaves(screen):
        raise AssertionError("no refit is needed where innovations tell")

    done = score_by_timing(ScoreTest(prepare(case)), lambda c: prepare(c).signals, again, leaves, ())
    TOLD[id(case)] = case, done, lines
    return done, lines


@pytest.mark.parametrize(("truth", "found"), [("zero", "zero"), ("past", "past"), ("linear", "")])
def test_a_screening_takes_the_inputs_as_they_acted(written, truth, found):
    """It is made again once for it, in words that name the convention, and not where the case was right."""
    done, lines = told(written(truth))
    assert {c.hold for c in channels(done.problem.case) if c.input} == {found}
    assert len(lines) == bool(found)
    assert all(f'hold = "{found}"' in line for line in lines)
    assert done.problem.timing == "".join(lines)


@pytest.mark.slow
def test_a_screening_takes_positions_as_the_steps_left_them(written):
    """Half a step ahead of the velocities, which a loop of semi-implicit steps writes."""
    model = MODEL.replace('timestep="0.0005"', f'timestep="{STEP}"')
    done, lines = told(written("", rows=stepped(1), velocity=True, model=model))
    _, position, velocity = done.problem.case.table.recording[0].channel
    assert position.delay_s == pytest.approx(-0.5 * STEP, rel=0.1)
    assert velocity.delay_s == 0.0
    assert "ms ahead" in lines[-1]


def test_a_screening_that_cannot_be_made_again_stays_as_it_is(written):
    screen = ScoreTest(prepare(written("zero")))
    same = score_by_timing(screen, lambda c: prepare(c).signals, lambda c, line: None, lambda s: 1.0, ())
    assert same is screen


@pytest.mark.parametrize("truth", ["zero", "past"])
def test_what_is_right_is_not_asked_twice(written, truth):
    """A screening of the convention that was found asks for no other one."""
    done, _ = told(written(truth))
    again, lines = told(done.problem.case)
    assert lines == []
    assert again.problem.case.table == done.problem.case.table


def convention(hold, gain, **other):
    usual = {"case": None, "skew_s": 0.0, "is_near": True, "is_conclusive": True}
    return _Convention(hold=hold, log_likelihood_gain=gain, **{**usual, **other})


def test_a_hint_is_a_hold_alone_that_is_asked_for_once():
    """A skew, a hold that is asked for many times over, and what gains next to nothing are none."""
    weak, strong = convention("zero", 2 * SAMPLING_CONVENTION.hint), convention("past", 5 * SAMPLING_CONVENTION.hint)
    others = [
        convention("past", 50.0, skew_s=1e-3), convention("zero-first", 60.0, is_near=False), convention("", 70.0)
    ]  # fmt: skip
    assert _hinted_at([weak, *others, strong]) is strong
    assert _hinted_at([*others, convention("zero", 0.5 * SAMPLING_CONVENTION.hint)]) is None


def test_what_is_believed_is_what_gains_most_of_what_is_asked_for(written):
    screen = ScoreTest(prepare(written("linear")))
    effective_share, more = (
        convention("zero", 2 * SAMPLING_CONVENTION.gain),
        convention("past", 3 * SAMPLING_CONVENTION.gain),
    )
    doubtful = convention("zero-first", 9 * SAMPLING_CONVENTION.gain, is_conclusive=False)
    assert _favoured_convention(screen, None, [effective_share, more, doubtful], ()) is more
    assert _favoured_convention(screen, None, [convention("zero", 0.9 * SAMPLING_CONVENTION.gain)], ()) is None


def test_a_refit_has_the_word_where_it_leaves_much_less():
    left = {"other": SAMPLING_CONVENTION.much_less - 0.01, "same": 1.0, "near": SAMPLING_CONVENTION.much_less + 0.01}
    assert _leaves_less(left.get, "other", "same")
    assert not _leaves_less(left.get, "near", "same")
