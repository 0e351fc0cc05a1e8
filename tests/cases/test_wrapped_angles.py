"""Angles that jump by a full turn: found, never repaired unasked, and read as said."""

import numpy as np
import pytest

from vlab.cases.case import Case, load_case
from vlab.cases.checks import check_recordings
from vlab.cases.draft import draft_case
from vlab.diagnose.precheck import precheck_case
from vlab.errors import BadCase
from vlab.recordings.quality import findings
from vlab.recordings.wraps import unwrapped, wraps
from vlab.signals import Channel, Recording

WHEEL = """<mujoco model="wheel"><compiler angle="radian"/><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
<joint name="axle" axis="0 0 1" damping="0.01"/><geom size="0.05" mass="1" pos="0.2 0 0"/></body></worldbody>
<actuator><motor name="motor" joint="axle"/></actuator></mujoco>"""
TIME = 0.01 * np.arange(600)
TURNS = 12.0 * np.sin(0.9 * TIME) + 0.3 * np.sin(11 * TIME)
STANDSTILL = 3.0 + 0.3 * np.clip(TIME - 2.0, 0.0, 1.0)


def into_turn(angle, low=-np.pi, turn=2 * np.pi):
    return (angle - low) % turn + low


def steps_of(values, step):
    return step * np.rint(values / step)


NOISE = np.random.default_rng(1).normal(size=TIME.size)
SWING = 2.0 * np.sin(9.0 * TIME)  # fast, less than a turn


@pytest.mark.parametrize(
    ("angle", "turn"),
    [
        (TURNS, 2 * np.pi),
        (np.rad2deg(TURNS), 360.0),
        (steps_of(TURNS, 2 * np.pi / 64), 2 * np.pi),
        (TURNS + 0.01 * NOISE, 2 * np.pi),
        (STANDSTILL + 1e-3 * NOISE, 2 * np.pi),
        (80.0 * TIME, 2 * np.pi),  # 0.13 turns a sample
    ],
)
def test_every_jump_of_a_wrapped_angle_is_found(angle, turn):
    low = -0.5 * turn
    wrapped = into_turn(angle, low, turn)
    jumps = np.flatnonzero(np.diff(np.floor((angle - low) / turn)))
    assert jumps.size
    np.testing.assert_array_equal(wraps(wrapped, turn), jumps)
    back = unwrapped(wrapped, turn)
    np.testing.assert_allclose(back - back[0], angle - angle[0], atol=1e-9 * turn)


@pytest.mark.parametrize(
    "angle",
    [
        TURNS,
        SWING,
        np.where(np.arange(600) % 150 == 75, 0.0, 3.3 + 0.01 * np.sin(TIME)),  # lost readings
        np.where(TIME < 3, -2.0, 2.0) + 0.01 * NOISE,  # a fast move
        np.where(TIME < 3, 0.0, 2 * np.pi),  # a target that steps by a turn
        np.repeat([0.0, 4.0, -1.0, 3.0, 1.0, 4.5], 100),
        np.zeros(600),
    ],
)
def test_a_sound_angle_has_no_jumps(angle):
    assert not wraps(angle).size


def test_a_target_may_step_from_its_last_place_to_its_first():
    target = np.repeat(np.deg2rad([0.0, 60.0, 120.0, 180.0, 240.0, 300.0, 0.0]), 40)
    assert not wraps(target, is_target=True).size
    assert wraps(target).size == 1  # a sensor of six steps a turn


def test_blank_readings_stay_blank_and_hide_no_jump():
    angle = into_turn(TURNS)
    angle[::7] = np.nan
    back = unwrapped(angle)
    is_read = np.isfinite(angle)
    np.testing.assert_array_equal(np.isfinite(back), is_read)
    np.testing.assert_allclose((back - TURNS)[is_read], (back - TURNS)[1], atol=1e-9)


def test_the_quality_names_the_jumps():
    channel = Channel(name="yaw", kind="angle", unit="rad")
    recording = Recording(time=TIME, data=into_turn(TURNS)[:, None], channels=[channel])
    (found,) = findings(recording)
    first = TIME[wraps(into_turn(TURNS))[0] + 1]
    assert (found.kind, found.severity) == ("wrap", "warning")
    assert found.text.endswith(f"times, first at t = {first:g} s")


# ---- cases ------------------------------------------------------------------------------------------------------------


def write_wheel(folder, angle):
    (folder / "wheel.xml").write_text(WHEEL)
    table = np.column_stack([TIME, angle])
    np.savetxt(folder / "log.csv", table, delimiter=",", header="time,axle", comments="")
    return folder


def write_case(folder, *lines, kind="angle", unit="rad"):
    text = '[model]\nmjcf = "wheel.xml"\n[[recording]]\nfile = "log.csv"\nrole = "fit"\ntime = "time"\n[[channel]]\n'
    keys = ['column = "axle"', 'at = "joint:axle"', f'kind = "{kind}"', f'unit = "{unit}"', *lines]
    (folder / "case.toml").write_text(text + "\n".join(keys) + "\n")
    return folder


def test_a_wrapped_angle_is_damage_until_the_case_says_unwrap(tmp_path):
    write_wheel(tmp_path, into_turn(TURNS))
    (found,) = check_recordings(load_case(write_case(tmp_path))).found
    assert found.severity == "fatal"
    assert found.mend == 'unwrap = true in every [[channel]] with column = "axle"'
    checked = precheck_case(tmp_path)
    assert "jumps by a full turn" in checked.refused[0]

    case = load_case(write_case(tmp_path, "unwrap = true"))
    assert not check_recordings(case).of("fatal")
    (run,) = case.runs()
    angle = run.measured["joint:axle"]
    np.testing.assert_allclose(angle - angle[0], TURNS - TURNS[0], atol=1e-9)


def test_degrees_are_unwrapped_by_their_turn(tmp_path):
    write_wheel(tmp_path, into_turn(np.rad2deg(TURNS), 0.0, 360.0))
    (run,) = load_case(write_case(tmp_path, "unwrap = true", unit="deg")).runs()
    angle = run.measured["joint:axle"]
    np.testing.assert_allclose(angle - angle[0], TURNS - TURNS[0], atol=1e-9)


def test_only_an_angle_is_unwrapped(tmp_path):
    write_wheel(tmp_path, TURNS)
    with pytest.raises(BadCase, match="unwrap is for an angle"):
        load_case(write_case(tmp_path, "unwrap = true", kind="angular-velocity", unit="rad/s"))


def test_arrays_name_the_argument(tmp_path):
    (write_wheel(tmp_path, TURNS) / "wheel.xml").write_text(WHEEL)

    def case(**more):
        return Case.from_arrays(tmp_path / "wheel.xml", TIME, None, {"axle": into_turn(TURNS)}, **more)

    (found,) = check_recordings(case()).found
    assert found.mend == 'channels={"axle": {"unwrap": True}}'
    assert not check_recordings(case(channels={"axle": {"unwrap": True}})).of("fatal")


@pytest.mark.parametrize(("turn", "unit"), [(2 * np.pi, "rad"), (360.0, "deg")])
def test_a_draft_unwraps_and_says_so(tmp_path, turn, unit):
    write_wheel(tmp_path, into_turn(TURNS * turn / (2 * np.pi), -0.5 * turn, turn))
    draft = draft_case(str(tmp_path / "wheel.xml"), [tmp_path / "log.csv"], tmp_path)
    (match,) = draft.channels
    assert (match.unit, match.is_unit_sure) == (unit, True)
    assert f"unwrap = true  # the column jumps by a full turn {match.wraps} times" in draft.text
    assert any("unwrap = true" in line for line in draft.unsure)
    (tmp_path / "case.toml").write_text(draft.text)
    run = load_case(tmp_path).runs()[0]
    angle = run.measured["joint:axle"]
    np.testing.assert_allclose(angle - angle[0], (TURNS - TURNS[0])[: angle.size], atol=1e-9)
    assert not check_recordings(load_case(tmp_path)).of("fatal")
