"""Drafts of cases: columns matched by names and values, units with reasons, hold-outs picked."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from arm_logs import ARM, write_arm, write_log

from vlab.cases.case import load_case
from vlab.cases.draft import draft_case
from vlab.cases.draft.matching import leads
from vlab.cases.places import numbered_from
from vlab.errors import BadCase, BadRecording, BadStructure

SLIDE = """<mujoco model="slide"><option timestep="0.001" gravity="0 0 0"/><worldbody><body name="carriage">
<joint name="slide" type="slide" axis="1 0 0" stiffness="800" damping="6"/><geom type="box" size="0.05 0.05 0.05" mass="2"/>
</body></worldbody><actuator><motor name="motor" joint="slide"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return write_arm(tmp_path_factory.mktemp("arm") / "my arm", logs=4, seconds=3.0)


def drafted(model: Path, logs: list[Path], **options):
    """Return a draft beside its logs, and the case that its text makes."""
    folder = logs[0].parent
    draft = draft_case(str(model), logs, folder, **options)
    (folder / "case.toml").write_text(draft.text, encoding="utf-8")
    return draft, load_case(folder, allow_outside=draft.leaves_folder)


def by_column(draft) -> dict[str, tuple[str, str, str, bool]]:
    return {m.label: (m.at, m.kind, m.unit, m.is_input) for m in draft.channels}


def write_table(path: Path, **columns) -> Path:
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")
    return path


def swinging(seconds: float = 4.0, period: float = 0.01):
    """Return times and two independent motions about 1."""
    time = period * np.arange(round(seconds / period))
    return time, np.sin(2 * np.pi * time), np.sin(2 * np.pi * 1.7 * time + 1.0)


# ---- an arm as a newcomer has it ------------------------------------------------------------------------------------


def test_an_arm_in_degrees_and_milliseconds_is_understood(arm):
    model, logs = arm
    draft, case = drafted(model, logs)
    assert by_column(draft) == {
        "action.shoulder_pan.pos": ("shoulder_pan", "command", "deg", True),
        "action.elbow_flex.pos": ("elbow_flex", "command", "deg", True),
        "shoulder_pan.pos": ("joint:shoulder_pan", "angle", "deg", False),
        "elbow_flex.pos": ("joint:elbow_flex", "angle", "deg", False),
    }
    assert (draft.clock.time, draft.clock.unit) == ("timestamp", "ms")
    assert [(name, table.role) for name, table in case.recordings()] == [
        *(("run1", "fit"), ("run2", "fit")),
        *(("run3", "holdout"), ("run4", "holdout")),
    ]
    left = {part.label: part.why for part in draft.left_out}
    assert "derives" in left["elbow_flex.vel"]
    assert "temperature" in left["elbow_flex temperature"]
    assert "frame" in left
    run = case.runs(("holdout",))[0]
    assert float(np.ptp(run.measured["joint:elbow_flex"])) < np.pi  # in rad
    assert run.measured.rate == pytest.approx(50.0)


def test_the_text_says_why_and_what_is_uncertain(arm):
    draft, _ = drafted(*arm)
    assert 'unit = "deg"  # ' in draft.text
    uncertain = tomllib.loads(draft.text)["model"]["uncertain"]
    assert set(uncertain) == {"mass", "damping", "armature", "gain", "sensor"}  # no spring and no friction in the model


def test_one_log_is_cut_in_two_parts(arm):
    model, logs = arm
    draft, case = drafted(model, logs[:1])
    (fitted, kept) = (table for _, table in case.recordings())
    assert (fitted.role, kept.role, fitted.stop_s) == ("fit", "holdout", kept.start_s)
    assert fitted.stop_s == pytest.approx(2.0, abs=0.05)  # two thirds of 2.98 s
    assert [run.role for run in case.runs()] == ["fit", "holdout"]
    assert len(draft.parts) == 2


def test_files_elsewhere_need_the_permission(arm, tmp_path):
    model, logs = arm
    (tmp_path / "here").mkdir()
    draft = draft_case(str(model), logs, tmp_path / "here")
    assert draft.leaves_folder
    (tmp_path / "here" / "case.toml").write_text(draft.text, encoding="utf-8")
    assert len(load_case(tmp_path / "here", allow_outside=True).recordings()) == 4
    assert not draft_case(str(model), logs, logs[0].parent).leaves_folder


def test_files_of_one_name_are_told_by_their_folders(arm, tmp_path):
    model, logs = arm
    copies = []
    for i, log in enumerate(logs[:2]):
        (tmp_path / f"run{i}").mkdir()
        copies.append(tmp_path / f"run{i}" / f"log{log.suffix}")
        copies[i].write_bytes(log.read_bytes())
    text = draft_case(str(model), copies, tmp_path).text
    assert [table["name"] for table in tomllib.loads(text)["recording"]] == ["run0 log", "run1 log"]


def test_names_with_signs_of_patterns_and_quotes_are_kept(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    logs = [write_log(tmp_path / f'run "{i}" [of 2].csv', i, 2.0) for i in (1, 2)]
    _, case = drafted(tmp_path / "arm.xml", logs)
    assert [table.file for _, table in case.recordings()] == [log.name for log in logs]


def test_a_log_with_other_columns_is_left_out(arm, tmp_path):
    model, logs = arm
    time, one, _ = swinging()
    other = write_table(tmp_path / "zero.csv", timestamp=1e3 * time, pressure=one)
    draft = draft_case(str(model), [*logs[:2], other], logs[0].parent)
    assert any("zero.csv is left out" in line for line in draft.unsure)
    assert [path.name for part in draft.parts for path in part.paths] == ["run1.csv", "run2.csv"]


TROLLEY = """<mujoco model="trolley"><option timestep="0.001" gravity="0 0 0"/><worldbody><body name="trolley">
<joint name="rail" type="slide" axis="1 0 0" damping="4" {}/><geom type="box" size="0.05 0.05 0.05" mass="2"/>
</body></worldbody><actuator><motor name="motor" joint="rail"/></actuator>
<sensor><jointpos name="encoder" joint="rail"/></sensor></mujoco>"""


@pytest.mark.parametrize(
    ("joint", "largest", "unit", "is_sure", "why"),
    [
        ('range="-2 2" limited="true"', 0.8, "m", False, "of the joint's range in m; in mm they fit, too"),
        ('range="-2 2" limited="true"', 800.0, "mm", True, "would leave the range"),
        ("", 0.8, "m", False, "times that of the model; in mm they fit, too"),
        ("", 800.0, "mm", False, "more than the model's size"),
    ],
)
def test_a_trolley_on_a_long_rail_is_in_metres(tmp_path, joint, largest, unit, is_sure, why):
    (tmp_path / "trolley.xml").write_text(TROLLEY.format(joint))
    time, one, other = swinging()  # the force has nothing to do with the motion, so no simulation tells the unit
    log = write_table(tmp_path / "log.csv", time=time, motor=10.0 * other, encoder=largest * one)
    draft = draft_case(str(tmp_path / "trolley.xml"), [log], tmp_path)
    (encoder,) = [m for m in draft.channels if m.at == "encoder"]
    assert (encoder.unit, encoder.is_unit_sure) == (unit, is_sure)
    assert why in encoder.why_unit
    assert any("encoder" in line for line in draft.unsure) is not is_sure


# ---- names, roles and units -----------------------------------------------------------------------------------------


def test_joints_numbered_from_one_are_told_from_joints_numbered_from_zero():
    assert numbered_from(["t", "q1", "q2", "q3"], 3) == 1
    assert numbered_from(["t", "q0", "q1", "q2"], 3) == 0
    assert numbered_from(["position[1]"], 3) == 0


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 1])
def test_numbers_follow_the_order_of_the_joints(tmp_path, first):
    (tmp_path / "arm.xml").write_text(ARM)
    time, one, other = swinging()
    columns = {"t": time, f"qpos_{first}": one, f"qpos_{first + 1}": other}
    log = write_table(tmp_path / "log.csv", **columns, **{f"ctrl_{first}": one, f"ctrl_{first + 1}": other})
    draft, _ = drafted(tmp_path / "arm.xml", [log])
    found = {column: at for column, (at, *_) in by_column(draft).items()}
    assert found[f"qpos_{first}"] == "joint:shoulder_pan"
    assert found[f"qpos_{first + 1}"] == "joint:elbow_flex"
    assert found[f"ctrl_{first + 1}"] == "elbow_flex"


@pytest.mark.parametrize("name", ["shoulder_pan_joint", "shoulder_pan_hinge"])
def test_generic_words_of_a_joint_may_be_missing_in_a_column(tmp_path, name):
    (tmp_path / "arm.xml").write_text(
        ARM.replace('joint name="shoulder_pan"', f'joint name="{name}"')
        .replace('joint="shoulder_pan"', f'joint="{name}"')
        .replace('position name="shoulder_pan"', 'position name="pan_servo"')
    )
    draft, _ = drafted(tmp_path / "arm.xml", [write_log(tmp_path / "log.csv", 1, 2.0)])
    assert by_column(draft)["shoulder_pan.pos"][0] == f"joint:{name}"
    assert by_column(draft)["action.shoulder_pan.pos"][0] == "pan_servo"


@pytest.mark.slow
def test_of_two_positions_the_earlier_is_the_command(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    time, one, other = swinging()
    late = np.interp(time - 0.05, time, one)
    columns = {"t": time, "follower_shoulder_pan": late, "leader_shoulder_pan": one, "elbow_flex_cmd": other}
    draft, _ = drafted(tmp_path / "arm.xml", [write_table(tmp_path / "log.csv", **columns, elbow_flex_pos=other)])
    found = by_column(draft)
    assert found["leader_shoulder_pan"][3]
    assert not found["follower_shoulder_pan"][3]
    assert any("leader_shoulder_pan" in line for line in draft.unsure)
    assert leads(one, late)
    assert not leads(late, one)


def test_an_effort_is_no_input_of_a_servo(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    time, one, other = swinging()
    columns = {"t": time, "elbow_flex_pos": one, "elbow_flex_torque": other, "elbow_flex_cmd": one}
    draft, _ = drafted(tmp_path / "arm.xml", [write_table(tmp_path / "log.csv", **columns)])
    assert "elbow_flex_torque" not in by_column(draft)
    (why,) = (left.why for left in draft.left_out if left.label == "elbow_flex_torque")
    assert '<actuatorfrc name="elbow_flex_effort" actuator="elbow_flex"/>' in why
    sensed = ARM.replace("</mujoco>", f"<sensor>{why[why.index('<') : why.index('/>') + 2]}</sensor></mujoco>")
    (tmp_path / "arm.xml").write_text(sensed)
    draft, _ = drafted(tmp_path / "arm.xml", [tmp_path / "log.csv"])
    assert by_column(draft)["elbow_flex_torque"] == ("elbow_flex_effort", "moment", "N m", False)


def slide_log(folder: Path, *, unit_of_x: float, **names) -> Path:
    """Write a log of the slide: force [N] and position in a unit [m]."""
    import mujoco

    (folder / "slide.xml").write_text(SLIDE)
    model = mujoco.MjModel.from_xml_string(SLIDE)
    data = mujoco.MjData(model)
    time = 0.001 * np.arange(3000)
    force = 8.0 * np.sin(2 * np.pi * (0.5 + time) * time)
    x = np.empty(len(time))
    for k in range(len(time)):
        x[k] = data.qpos[0]
        data.ctrl[0] = force[k]
        mujoco.mj_step(model, data)
    columns = dict(zip(names.get("columns", ("t", "u", "x")), (time, force, x / unit_of_x), strict=True))
    return write_table(folder / "log.csv", **columns)


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("m", 1.0)])
def test_the_simulation_tells_millimetres_from_metres(tmp_path, unit, metres):
    log = slide_log(tmp_path, unit_of_x=metres)
    draft, _ = drafted(tmp_path / "slide.xml", [log])
    assert by_column(draft) == {"u": ("motor", "force", "N", True), "x": ("joint:slide", "displacement", unit, False)}
    (x,) = (m for m in draft.channels if m.label == "x")
    assert x.why_unit.startswith("simulated so")


def test_a_stated_unit_is_taken(tmp_path):
    log = slide_log(tmp_path, unit_of_x=1e-3, columns=("t_s", "motor_force_N", "slide_mm"))
    draft, _ = drafted(tmp_path / "slide.xml", [log])
    (x,) = (m for m in draft.channels if m.label == "slide_mm")
    assert (x.unit, x.why_unit) == ("mm", "stated by file or name")
    assert draft.unsure == ()


# ---- clocks ---------------------------------------------------------------------------------------------------------


def test_without_a_clock_the_rate_is_asked_for(arm, tmp_path):
    model, _ = arm
    _, one, other = swinging()
    log = write_table(tmp_path / "log.csv", frame=np.arange(len(one)), elbow_flex_pos=one, elbow_flex_cmd=other)
    with pytest.raises(BadCase, match=r"no column counts the time .*--rate-hz"):
        draft_case(str(model), [log], tmp_path)
    draft = draft_case(str(model), [log], tmp_path, rate_hz=100.0)
    assert tomllib.loads(draft.text)["recording"][0]["rate_hz"] == 100.0


def test_a_clock_without_a_name_is_a_guess(arm, tmp_path):
    model, _ = arm
    time, one, other = swinging()
    log = write_table(tmp_path / "log.csv", zeit=time, elbow_flex_pos=one, elbow_flex_cmd=other)
    draft = draft_case(str(model), [log], tmp_path)
    assert (draft.clock.time, draft.clock.unit) == ("zeit", "s")
    assert any("zeit is the time" in line for line in draft.unsure)


def test_times_that_start_again_are_several_runs(arm, tmp_path):
    model, _ = arm
    time, one, other = swinging()
    twice = {name: np.tile(values, 2) for name, values in (("t", time), ("elbow_flex_pos", one), ("u", other))}
    with pytest.raises(BadCase, match="start again"):
        draft_case(str(model), [write_table(tmp_path / "log.csv", **twice)], tmp_path)


def test_one_repeated_time_stamp_is_no_new_run(arm, tmp_path):
    model, _ = arm
    time, one, other = swinging()
    time[200] = time[199]
    log = write_table(tmp_path / "log.csv", t=time, elbow_flex_pos=one, u=other)
    with pytest.raises(BadCase, match="repeats in 1 of 400 samples, first in sample 200; delete"):
        draft_case(str(model), [log], tmp_path)


def test_a_column_with_a_word_among_numbers_is_named(arm, tmp_path):
    model, _ = arm
    time, one, other = swinging()
    log = write_table(tmp_path / "log.csv", t=time, elbow_flex_pos=one, shoulder_pan_pos=other)
    lines = log.read_text().splitlines()
    lines[50] = ",".join([*lines[50].split(",")[:2], "ERR"])
    log.write_text("\n".join(lines))
    draft = draft_case(str(model), [log], tmp_path)
    left = {part.label: part.why for part in draft.left_out}
    assert "ERR" in left["shoulder_pan_pos"]
    assert any("'shoulder_pan_pos' belongs to joint:shoulder_pan" in line for line in draft.unsure)
    assert "shoulder_pan_pos" in draft.text


def test_a_log_that_is_named_twice_is_taken_once_and_said(arm, tmp_path):
    model, _ = arm
    time, one, other = swinging()
    log = write_table(tmp_path / "log.csv", t=time, elbow_flex_pos=one, shoulder_pan_pos=other)
    draft = draft_case(str(model), [log, tmp_path / "." / log.name], tmp_path)
    assert "log.csv is named 2 times and taken once" in draft.unsure


def test_a_cut_last_line_is_said_once(arm, tmp_path):
    model, _ = arm
    time, one, other = swinging()
    log = write_table(tmp_path / "log.csv", t=time, elbow_flex_pos=one, shoulder_pan_pos=other)
    log.write_text(log.read_text() + "4.0,0.1\n")
    with pytest.raises(BadRecording, match="line 402: 2 cells where 3 are expected") as raised:
        draft_case(str(model), [log], tmp_path)
    assert str(raised.value).count("line 402") == 1


def test_two_samples_are_no_log(arm, tmp_path, recwarn):
    model, _ = arm
    log = write_table(tmp_path / "log.csv", t=np.array([0.0, 0.01]), elbow_flex_pos=np.array([0.1, 0.2]))
    with pytest.raises(BadRecording, match="2 samples; a diagnosis needs at least 20"):
        draft_case(str(model), [log], tmp_path)
    assert not recwarn.list


def test_a_robot_description_of_ros_says_how_to_convert_it(arm, tmp_path):
    _, logs = arm
    (tmp_path / "arm.xml").write_text('<robot name="arm"><link name="base"/></robot>')
    with pytest.raises(BadStructure, match="URDF.*MjSpec.from_file"):
        draft_case(str(tmp_path / "arm.xml"), logs, tmp_path)


# ---- bad input ------------------------------------------------------------------------------------------------------


def test_a_log_without_any_place_names_columns_and_places(arm, tmp_path):
    model, _ = arm
    time, one, _ = swinging()
    log = write_table(tmp_path / "log.csv", t=time, pressure=one)
    with pytest.raises(BadCase, match="no column shows a sensor, joint or site.*'pressure'.*joint:shoulder_pan"):
        draft_case(str(model), [log], tmp_path)


def test_a_model_without_names_says_what_to_add(tmp_path):
    plain = ARM.replace(' name="shoulder_pan"', "").replace(' name="elbow_flex"', "")
    plain = plain[: plain.index("<actuator>")] + "</mujoco>"
    (tmp_path / "arm.xml").write_text(plain)
    with pytest.raises(BadCase, match='<joint name="upper_joint"'):
        draft_case(str(tmp_path / "arm.xml"), [write_log(tmp_path / "log.csv", 1, 2.0)], tmp_path)


@pytest.mark.parametrize(
    ("model", "log", "error", "match"),
    [
        ("nowhere.xml", "run1.csv", BadCase, "no such model file"),
        (".", "run1.csv", BadCase, "the folder is no model"),
        ("run1.csv", "run2.csv", BadCase, "this is no model"),
        ("arm.xml", "arm.xml", BadCase, "a recording was expected after the model"),
        ("arm.xml", "empty.csv", BadRecording, "empty"),
        ("arm.xml", "header.csv", BadRecording, "header.csv"),
        ("arm.xml", "nowhere.csv", BadRecording, "nowhere.csv"),
    ],
)
def test_what_is_no_model_and_no_log_is_refused_in_one_line(arm, model, log, error, match):
    folder = arm[0].parent
    (folder / "empty.csv").write_text("")
    (folder / "header.csv").write_text("t,elbow_flex.pos\n")
    with pytest.raises(error, match=match) as raised:
        draft_case(str(folder / model), [folder / log], folder)
    assert "\n" not in str(raised.value)


MOTOR = """<mujoco><worldbody><body name="rotor"><joint name="shaft" type="hinge" axis="0 0 1"/>
<inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody>
<actuator><general name="bridge" joint="shaft" gainprm="0.017" biastype="affine" biasprm="0 0 -0.0017"/></actuator>
<sensor><jointvel name="speed" joint="shaft"/></sensor></mujoco>"""


@pytest.mark.parametrize("name", ["rpm", "RPM", "motor_rpm"])
def test_a_column_of_turns_a_minute_shows_the_speed_of_a_motor(tmp_path, name):
    (tmp_path / "motor.xml").write_text(MOTOR)
    time, one, other = swinging()
    log = write_table(tmp_path / "log.csv", **{"time": time, "pwm": 100 + 50 * one, name: 300 * other})
    draft, case = drafted(tmp_path / "motor.xml", [log])
    assert by_column(draft)["pwm"][2:] == ("", True)  # back-EMF makes no velocity servo of a motor
    (run, *_) = case.runs(("fit",))
    measured = run.measured[run.compared[0].channel]
    assert np.max(np.abs(measured)) == pytest.approx(300 * 2 * np.pi / 60, rel=1e-3)


# ---- clocks of loggers ----------------------------------------------------------------------------------------------


def runs_of(tmp_path, stamp):
    """Return the draft of one log with stamps, and its fitted and its held-out run."""
    time, force, motion = swinging()
    (tmp_path / "slide.xml").write_text(SLIDE)
    rows = [f"{stamp(t)},{f:.9f},{1e-3 * q:.9f}\n" for t, f, q in zip(time, force, motion, strict=True)]
    (tmp_path / "log.csv").write_text("timestamp,motor,slide\n" + "".join(rows))
    draft, case = drafted(tmp_path / "slide.xml", [tmp_path / "log.csv"])
    return draft, *(case.runs((role,))[0] for role in ("fit", "holdout"))


def clock(t):
    return f"10:00:{t:06.3f}"


STAMPS = {"clock": clock, "ISO": lambda t: f"2025-03-01T{clock(t)}Z", "epoch": lambda t: f"{1.7e9 + t:.3f}"}


@pytest.mark.parametrize("form", STAMPS)
def test_times_of_a_run_count_from_the_first_sample_of_the_log(tmp_path, form):
    draft, fit, held_out = runs_of(tmp_path, STAMPS[form])
    assert draft.clock.time == "timestamp"
    assert draft.clock.unit == "s"
    assert [part.name for part in draft.parts] == ["log before 2.66 s", "log from 2.66 s"]
    assert fit.measured.time[0] == 0.0
    assert fit.measured.time[-1] == pytest.approx(2.65, abs=1e-6)  # the border is a sample of the later part
    assert held_out.measured.time[0] == pytest.approx(2.66, abs=1e-6)
    assert held_out.before.time[0] == 0.0
