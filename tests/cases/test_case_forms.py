"""Short forms of a case: shared channels, patterns, rows, clocks of channels, blank cells, data sets, outside files."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command import run as command

from vlab.cases import compare_case, load_case
from vlab.cases.checks.periods import check_periods
from vlab.cases.checks.ranges import check_ranges
from vlab.cases.places import suggest
from vlab.cases.simulate import simulate
from vlab.errors import BadCase, BadRecording, UnknownName, VlabError
from vlab.files.toml_writer import toml_text
from vlab.recordings.selection import parse_where

RIG = """<mujoco><compiler angle="radian"/><option timestep="0.001" gravity="0 0 0"/><worldbody>
<body name="arm"><joint name="shoulder_pan" axis="0 0 1" stiffness="4" damping="0.3" range="-2 2" limited="true"/>
  <geom size="0.05" mass="1" pos="0.2 0 0"/>
  <body name="fore" pos="0.4 0 0"><joint name="elbow_flex" axis="0 0 1" stiffness="2" damping="0.2"/>
    <geom size="0.05" mass="0.5" pos="0.2 0 0"/></body></body></worldbody>
<actuator><motor name="pan_motor" joint="shoulder_pan"/><position name="flex_servo" joint="elbow_flex" kp="5" kv="0.2"
  ctrllimited="true" ctrlrange="-2 2"/></actuator></mujoco>"""
SHARED = """
[[channel]]
column = "u"
at = "pan_motor"
kind = "moment"
unit = "N m"
input = true
hold = "zero"
[[channel]]
column = "q"
at = "joint:shoulder_pan"
kind = "angle"
unit = "rad"
"""
HEAD = '[model]\nmjcf = "rig.xml"\n'
N, DT = 200, 0.01
TIME = np.arange(N) * DT


def columns(seed=0):
    rng = np.random.default_rng(seed)
    return {"t": TIME, "u": np.repeat(rng.normal(size=N // 10), 10), "q": 0.1 * np.sin(3 * TIME + seed)}


def write_csv(path, table):
    rows = [",".join(table)]
    count = max(len(values) for values in table.values())
    for k in range(count):
        cells = [f"{v[k]:.17g}" if k < len(v) and np.isfinite(v[k]) else "" for v in table.values()]
        rows.append(",".join(cells))
    path.write_text("\n".join(rows) + "\n")


@pytest.fixture
def folder(tmp_path):
    case = tmp_path / "case"
    case.mkdir()
    (case / "rig.xml").write_text(RIG)
    for k in (1, 2, 10):
        write_csv(case / f"run{k}.csv", columns(k))
    return case


def write_case(folder, text):
    (folder / "case.toml").write_text(HEAD + text)
    return folder


def channel(column, at, kind, unit, *more):
    lines = [f'column = "{column}"', f'at = "{at}"', f'kind = "{kind}"', f'unit = "{unit}"', *more]
    return "\n".join(["[[recording.channel]]", *lines, ""])


Q = channel("q", "joint:shoulder_pan", "angle", "rad")
U = channel("u", "pan_motor", "moment", "N m", "input = true", 'hold = "zero"')

# ---- shared channels and patterns -----------------------------------------------------------------------------------


def test_shared_channels_and_a_pattern_are_the_plain_form(folder):
    plain = "".join(
        f'[[recording]]\nfile = "run{k}.csv"\nrole = "{role}"\ntime = "t"\n{U}{Q}'
        for k, role in ((1, "fit"), (2, "fit"), (10, "holdout"))
    )
    expected = load_case(write_case(folder, plain)).runs()
    short = (
        '[[recording]]\nfiles = "run?.csv"\nrole = "fit"\ntime = "t"\n'
        '[[recording]]\nfile = "run10.csv"\nrole = "holdout"\ntime = "t"\n'
    )
    case = load_case(write_case(folder, short + SHARED))
    assert [name for name, _ in case.recordings()] == ["run1", "run2", "recording3"]
    for run, other in zip(case.runs(), expected, strict=True):
        assert run.role == other.role
        assert run.measured.names == other.measured.names
        np.testing.assert_array_equal(run.measured.data, other.measured.data)


def test_the_plain_form_of_a_case_is_written_and_read_again(folder):
    case = load_case(write_case(folder, f'[[recording]]\nfiles = "run*.csv"\nrole = "fit"\ntime = "t"\n{SHARED}'))
    (folder / "plain.toml").write_text(toml_text(case.raw))
    again = load_case(folder / "plain.toml")
    assert again.table == case.table
    assert "channel" not in again.raw


def test_files_of_a_pattern_are_in_the_order_of_their_numbers(folder):
    case = load_case(
        write_case(folder, f'[[recording]]\nfiles = ["run1*.csv", "run2.csv"]\nrole = "fit"\ntime = "t"\n{SHARED}')
    )
    assert [table.file for _, table in case.recordings()] == ["run1.csv", "run10.csv", "run2.csv"]
    case = load_case(
        write_case(folder, f'[[recording]]\nname = "lab"\nfiles = "run*.csv"\nrole = "fit"\ntime = "t"\n{SHARED}')
    )
    assert [name for name, _ in case.recordings()] == ["lab run1", "lab run2", "lab run10"]


def test_a_channel_of_its_own_takes_the_place_of_the_shared_one(folder):
    case = load_case(write_case(folder, f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\n{SHARED}'))
    text = f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\n{channel("q", "joint:shoulder_pan", "angle", "deg")}'
    (plain,) = case.runs()
    (run,) = load_case(write_case(folder, text + SHARED)).runs()
    np.testing.assert_allclose(run.measured["joint:shoulder_pan"], np.deg2rad(plain.measured["joint:shoulder_pan"]))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (f'[[recording]]\nfiles = "log*.csv"\nrole = "fit"\ntime = "t"\n{SHARED}', r"no file matches 'log\*.csv'; files .*run1.csv"),
        (f'[[recording]]\nfile = "run1.csv"\nfiles = "run*.csv"\nrole = "fit"\ntime = "t"\n{SHARED}', "both given"),
        (f'[[recording]]\nfiles = "../*.csv"\nrole = "fit"\ntime = "t"\n{SHARED}', "leaves the case's folder.*--allow-outside"),
        (f'[[recording]]\nfiles = 3\nrole = "fit"\ntime = "t"\n{SHARED}', "a pattern such as"),
        ('[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\n' + SHARED.replace('"angle"', '"angel"'), r"recording.*channel"),
        ('[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\n' + SHARED.replace("joint:shoulder_pan", "joint:x"), r"case.toml: channel\[1\]: unknown sensor"),
        ('[[modal]]\nrole = "fit"\nfrequency_hz = [1.0]\n' + SHARED, "shared channels belong to recordings"),
        (f'[recording]\nfile = "run1.csv"\n{SHARED}', r"write \[\[recording\]\]"),
        (f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\nepisode = -1\n{SHARED}', "numbers of episodes from 0"),
        (f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\nepisode = 0\nepisodes = [1]\n{SHARED}', "both given"),
    ],
)  # fmt: skip
def test_short_forms_that_are_refused(folder, text, match):
    with pytest.raises(VlabError, match=match) as caught:
        load_case(write_case(folder, text))
    assert "\n" not in str(caught.value)


# ---- rows -----------------------------------------------------------------------------------------------------------


def test_rows_are_chosen_by_comparisons(folder):
    table = columns()
    table["level_V"] = np.where(TIME < 1.0, np.float32(0.1), 0.3)
    write_csv(folder / "levels.csv", table)
    text = "".join(
        f'[[recording]]\nfile = "levels.csv"\nrole = "{role}"\ntime = "t"\nwhere = "{where}"\n'
        for role, where in (("fit", "level_V == 0.1"), ("holdout", "level_V == 0.3 and t < 1.5"))
    )
    fit, held = load_case(write_case(folder, text + SHARED)).runs()
    assert (fit.measured.time[0], fit.measured.time[-1]) == (0.0, pytest.approx(0.99))
    assert (held.measured.time[0], held.measured.time[-1]) == (pytest.approx(1.0), pytest.approx(1.49))
    without = text.replace('time = "t"', "rate_hz = 100.0")
    _, held = load_case(write_case(folder, without + SHARED)).runs()
    assert held.measured.time[0] == 0.0
    assert held.measured.rate == pytest.approx(100.0)


def test_the_same_rows_are_not_both_fitted_and_held_out(folder):
    table = {**columns(), "run": np.where(TIME < 1.0, 1, 2)}
    write_csv(folder / "runs.csv", table)
    text = "".join(
        f'[[recording]]\nfile = "runs.csv"\nrole = "{role}"\ntime = "t"\nwhere = "{where}"\n'
        for role, where in (("fit", "run == 1"), ("holdout", "run >= 1"))
    )
    with pytest.raises(BadCase, match="held out and fitted"):
        load_case(write_case(folder, text + SHARED))


@pytest.mark.parametrize(
    "where",
    [
        "level",
        "level = 1",
        "level == x",
        "__import__('os') == 1 or 1",
        "level == 1 or run == 2",
        "level == nan",
        "== 1",
        "",
    ],
)
def test_what_is_no_comparison_is_refused(where):
    with pytest.raises(BadCase, match="is no comparison; accepted: 'COLUMN OPERATOR NUMBER'"):
        parse_where(where)


def test_names_in_quotes_may_hold_operators():
    (condition,) = parse_where('"a <b> c" >= -1.5e-3')
    assert (condition.column, condition.operator, condition.number) == ("a <b> c", ">=", -1.5e-3)


def test_a_comparison_that_no_row_meets_names_the_values(folder):
    text = '[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\nwhere = "u == 77"\n'
    with pytest.raises(BadRecording, match="0 rows meet u == 77; values of 'u': "):
        load_case(write_case(folder, text + SHARED)).runs()


# ---- clocks of channels and blank cells -----------------------------------------------------------------------------


def test_a_held_input_on_its_own_clock_keeps_the_impulse_of_every_step(folder):
    """Mean over a step times its length is the integral of the held input, whatever the two clocks are."""
    own = np.sort(np.random.default_rng(1).uniform(0.0, TIME[-1], 70))
    own[0] = 0.0
    values = np.random.default_rng(2).normal(size=70)
    write_csv(folder / "two.csv", {"t": TIME, "q": columns()["q"], "t_u": own, "u": values})
    text = f'[[recording]]\nfile = "two.csv"\nrole = "fit"\ntime = "t"\n{U}time = "t_u"\n{Q}'
    (run,) = load_case(write_case(folder, text)).runs()
    fine = np.linspace(0.0, TIME[-1], 400_001)[:-1]
    exact = np.cumsum(values[np.searchsorted(own, fine, side="right") - 1]) * (fine[1] - fine[0])
    steps = np.cumsum(run.measured["pan_motor"][:-1]) * DT
    np.testing.assert_allclose(steps, np.interp(TIME[1:], fine, exact), atol=2e-4)
    (note,) = run.measured.meta["reading"]
    assert note.startswith("u: 70 samples at ")
    assert note.endswith("on their own clock, as means over the steps of the recording")


def test_a_reading_on_its_own_clock_is_compared_near_its_times_only(folder):
    own = TIME[::4] + 0.001
    angle = 0.1 * np.sin(3 * own)
    write_csv(folder / "two.csv", {"t": TIME, "u": columns()["u"], "q": columns()["q"], "t_e": own, "e": angle})
    more = channel("e", "joint:elbow_flex", "angle", "rad", 'time = "t_e"')
    text = f'[[recording]]\nfile = "two.csv"\nrole = "fit"\ntime = "t"\n{U}{Q}{more}'
    (run,) = load_case(write_case(folder, text)).runs()
    is_read = run.measured.is_read("joint:elbow_flex")
    np.testing.assert_array_equal(np.flatnonzero(is_read), np.arange(0, N, 4))
    assert run.measured.is_read("joint:shoulder_pan").all()
    at = run.measured.time[is_read][1:]  # a straight line between readings 40 ms apart: 0.1 * 9 * 0.04^2 / 8
    np.testing.assert_allclose(run.measured["joint:elbow_flex"][is_read][1:], 0.1 * np.sin(3 * at), atol=2e-4)
    part = run.measured.between(0.5, 1.0)
    assert part.is_read("joint:elbow_flex").sum() == 12


def test_channels_with_times_of_their_own_need_no_common_time(folder):
    write_csv(folder / "own.csv", {"t_q": TIME, "q": columns()["q"], "t_u": TIME[::2], "u": columns()["u"][::2]})
    text = f'[[recording]]\nfile = "own.csv"\nrole = "fit"\n{U}time = "t_u"\n{Q}time = "t_q"\n'
    (run,) = load_case(write_case(folder, text)).runs()
    np.testing.assert_array_equal(run.measured.time, TIME)
    np.testing.assert_allclose(run.measured["pan_motor"], columns()["u"], atol=1e-12)  # even rows hold the tens
    with pytest.raises(BadCase, match="give rate_hz, or time"):
        load_case(write_case(folder, text.replace('time = "t_q"\n', "")))
    write_csv(folder / "own.csv", {"t_q": TIME, "q": columns()["q"], "t_u": TIME[::-1], "u": columns()["u"]})
    case = load_case(write_case(folder, text))
    with pytest.raises(BadRecording, match="the times 't_u' of column 'u' do not increase at sample 1"):
        case.runs()


def test_blank_cells_of_an_input_stand_only_where_the_case_says_so(folder):
    table = columns()
    blank = np.arange(N) % 5 != 0
    write_csv(folder / "blank.csv", {**table, "u": np.where(blank, np.nan, table["u"])})
    text = f'[[recording]]\nfile = "blank.csv"\nrole = "fit"\ntime = "t"\n{U}{Q}'
    with pytest.raises(BadRecording, match=r"'u' drives the model and is blank at sample 1 .*blank = \"hold\""):
        load_case(write_case(folder, text)).runs()
    (run,) = load_case(write_case(folder, text.replace("input = true", 'input = true\nblank = "hold"'))).runs()
    np.testing.assert_array_equal(run.measured["pan_motor"], table["u"])
    assert run.measured.meta["reading"] == ("u: 160 of 200 cells are blank; the last value stands",)
    with pytest.raises(BadCase, match="is for inputs"):
        load_case(write_case(folder, text.replace(Q, Q + 'blank = "hold"\n')))


def test_rows_before_the_first_value_of_an_input_are_left_out(folder):
    table = columns()
    write_csv(folder / "late.csv", {**table, "u": np.where(np.arange(N) < 7, np.nan, table["u"])})
    text = f'[[recording]]\nfile = "late.csv"\nrole = "fit"\ntime = "t"\n{U}blank = "hold"\n{Q}'
    (run,) = load_case(write_case(folder, text)).runs()
    assert run.measured.time[0] == pytest.approx(0.07)
    assert "7 samples without a known input left out" in run.measured.meta["reading"][1]


def test_samples_without_a_reading_are_not_compared(folder):
    """The residual of a channel with lost readings is that of the readings left."""
    case = load_case(
        write_case(folder, f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\ninitial = "rest"\n{SHARED}')
    )
    (run,) = case.runs()
    own = simulate(case.plant, run).recording["joint:shoulder_pan"]
    lost = (np.arange(N) // 20) % 3 == 1
    write_csv(folder / "lost.csv", {**columns(1), "q": np.where(lost, np.nan, columns(1)["q"])})
    comparison = compare_case(
        write_case(folder, f'[[recording]]\nfile = "lost.csv"\nrole = "fit"\ntime = "t"\ninitial = "rest"\n{SHARED}')
    )
    (result,) = comparison.runs
    kept = columns(1)["q"][~lost]
    assert result.misfits[0].nrmse == pytest.approx(np.sqrt(np.mean((own[~lost] - kept) ** 2)) / kept.std(), rel=1e-9)
    said = f"q: {lost.sum()} of {N} samples have no reading and are not compared"
    assert any(said in remark for remark in comparison.remarks)


# ---- state, data sets, outside --------------------------------------------------------------------------------------


def test_a_stated_state_is_the_first_of_the_simulation(folder):
    text = (
        f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\nqpos = [0.3, -0.1]\nqvel = [0.0, 0.5]\n{SHARED}'
    )
    case = load_case(write_case(folder, text))
    (run,) = case.runs()
    simulation = simulate(case.plant, run)
    assert simulation.initial.how == "stated"
    assert simulation.recording["joint:shoulder_pan"][0] == pytest.approx(0.3, abs=1e-9)
    with pytest.raises(BadCase, match=r"qpos has 1 numbers, the model has 2.*shoulder_pan, elbow_flex"):
        load_case(write_case(folder, text.replace("[0.3, -0.1]", "[0.3]")))
    with pytest.raises(BadCase, match="both given"):
        load_case(write_case(folder, text.replace("qpos", 'initial = "rest"\nqpos')))
    with pytest.raises(BadCase, match="qvel is given without qpos"):
        load_case(write_case(folder, text.replace("qpos = [0.3, -0.1]\n", "")))


def lerobot(folder, version):
    """Write a data set of two episodes, whose second is episode 1 of twice the angle."""
    names = ["shoulder_pan.pos", "elbow_flex.pos"]
    vector = {"dtype": "float32", "shape": [2], "names": names if version == 3 else {"motors": names}}
    scalar = {"dtype": "int64", "shape": [1], "names": None}
    info = {
        "codebase_version": f"v{version}.0",
        "total_episodes": 2,
        "chunks_size": 1000,
        "fps": 100,
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
        if version == 2
        else "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "features": {"action": vector, "observation.state": vector, "timestamp": scalar, "episode_index": scalar},
    }
    data = folder / "data"
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    (data / "chunk-000").mkdir(parents=True)
    tables = []
    for episode in (0, 1):
        angle = np.rad2deg(columns()["q"]) * (1 + episode)
        states = np.column_stack([angle, np.zeros(N)]).astype(np.float32)
        tables.append(
            pa.table(
                {
                    "action": pa.FixedSizeListArray.from_arrays(pa.array(states.ravel()), 2),
                    "observation.state": pa.array(states.tolist(), pa.list_(pa.float32())),
                    "timestamp": pa.array(TIME, pa.float32()),
                    "episode_index": pa.array(np.full(N, episode), pa.int64()),
                }
            )
        )
    if version == 2:
        for episode, table in enumerate(tables):
            pq.write_table(table, data / "chunk-000" / f"episode_{episode:06d}.parquet")
    else:
        pq.write_table(
            pa.concat_tables([t.combine_chunks() for t in (tables[0].cast(tables[1].schema), tables[1])]),
            data / "chunk-000" / "file-000.parquet",
        )
        listed = folder / "meta" / "episodes" / "chunk-000"
        listed.mkdir(parents=True)
        rows = {"episode_index": [0, 1], "data/chunk_index": [0, 0], "data/file_index": [0, 0]}
        pq.write_table(pa.table(rows), listed / "file-000.parquet")


ROBOT = channel("action[elbow_flex.pos]", "flex_servo", "command", "deg", "input = true") + channel(
    "observation.state[shoulder_pan.pos]", "joint:shoulder_pan", "angle", "deg"
)


@pytest.mark.parametrize("version", [2, 3])
def test_an_episode_of_a_data_set_is_a_recording(folder, version):
    lerobot(folder / "set", version)
    text = f'[[recording]]\nfile = "set"\nrole = "fit"\nepisode = 1\n{ROBOT}'
    case = load_case(write_case(folder, text))
    (run,) = case.runs()
    np.testing.assert_allclose(run.measured["joint:shoulder_pan"], 2 * columns()["q"], atol=1e-6)
    assert run.measured.rate == pytest.approx(100.0, rel=1e-4)
    assert case.table.recording[0].channel[0].column == "action[1]"
    assert case.table.recording[0].file.endswith(".parquet")
    both = load_case(write_case(folder, text.replace("episode = 1", "episodes = [0, 1]")))
    assert [name for name, _ in both.recordings()] == ["episode 0", "episode 1"]
    every = load_case(write_case(folder, text.replace("episode = 1\n", "")))
    assert [table.where for _, table in every.recordings()] == ["episode_index == 0", "episode_index == 1"]
    assert "no episode is chosen" in every.notes[0]


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("episode = 1", "episode = 2", "there is no episode 2; accepted: 0 to 1"),
        ("action[elbow_flex.pos]", "action[elbow.pos]", r"did you mean 'elbow_flex.pos'"),
        ("action[elbow_flex.pos]", "elbow_flex.pos", r"accepted: action\[elbow_flex.pos\], observation.state\[elbow_flex.pos\]"),
        ('"set"', '"rigs"', "there is no file"),
        ('"set"', '"set/meta"', "the folder is no recording"),
    ],
)  # fmt: skip
def test_data_sets_that_are_refused(folder, old, new, match):
    lerobot(folder / "set", 2)
    text = f'[[recording]]\nfile = "set"\nrole = "fit"\nepisode = 1\n{ROBOT}'
    with pytest.raises(VlabError, match=match):
        load_case(write_case(folder, text.replace(old, new)))


def test_many_episodes_need_a_choice(folder):
    lerobot(folder / "set", 2)
    info = json.loads((folder / "set" / "meta" / "info.json").read_text())
    (folder / "set" / "meta" / "info.json").write_text(json.dumps({**info, "total_episodes": 10**15}))
    with pytest.raises(BadCase, match=r"more than 20 episodes; choose some, such as episodes = \[0, 1\]"):
        load_case(write_case(folder, f'[[recording]]\nfile = "set"\nrole = "fit"\n{ROBOT}'))


def test_a_damaged_description_of_a_data_set_is_refused(folder):
    lerobot(folder / "set", 2)
    (folder / "set" / "meta" / "info.json").write_text("{")
    text = f'[[recording]]\nfile = "set"\nrole = "fit"\nepisode = 1\n{ROBOT}'
    with pytest.raises(VlabError, match="not JSON"):
        load_case(write_case(folder, text))
    info = {"total_episodes": 1, "features": {}, "data_path": "../../{episode_index.__class__}.parquet"}
    (folder / "set" / "meta" / "info.json").write_text(json.dumps(info))
    with pytest.raises(VlabError, match="there is no file .*__class__.*outside the case's folder"):
        load_case(write_case(folder, text.replace("episode = 1", 'episode = 0\ntime = "timestamp"')))


def test_files_outside_are_read_only_with_permission(folder, tmp_path, capsys):
    write_csv(tmp_path / "outside.csv", columns())
    text = f'[[recording]]\nfile = "../outside.csv"\nrole = "fit"\ntime = "t"\n{SHARED}'
    write_case(folder, text)
    status, _, err = command(capsys, "compare", str(folder))
    assert status == 2
    assert "outside the case's folder" in err
    assert "--allow-outside" in err
    (run,) = load_case(folder, allow_outside=True).runs()
    np.testing.assert_array_equal(run.measured["joint:shoulder_pan"], columns()["q"])
    status, out, err = command(capsys, "compare", str(folder), "--allow-outside", "--json")
    assert (status, err.count("error")) == (0, 0)
    assert json.loads(out)["runs"][0]["samples"] == N
    write_case(folder, text.replace("../outside.csv", str(tmp_path / "outside.csv")))
    assert len(load_case(folder, allow_outside=True).runs()) == 1
    write_case(folder, text.replace("../outside.csv", "/dev/zero"))
    with pytest.raises(BadCase, match="no ordinary file"):
        load_case(folder, allow_outside=True)


# ---- names and units ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("column", "at", "is_input"),
    [
        ("shoulder_pan.pos", "joint:shoulder_pan", False),
        ("observation.state[elbow_flex.pos]", "joint:elbow_flex", False),
        ("qpos_0", "joint:shoulder_pan", False),
        ("/joint_states/position[1]", "joint:elbow_flex", False),
        ("observation.state[0]", "joint:shoulder_pan", False),
        ("action[1]", "flex_servo", True),
        ("elbow_flex_cmd", "flex_servo", True),
        ("ElbowFlex position", "joint:elbow_flex", False),
    ],
)
def test_names_of_logs_suggest_places(folder, column, at, is_input):
    plant = load_case(write_case(folder, f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\n{SHARED}')).plant
    found = suggest(column, plant)
    assert (found.at, found.is_input) == (at, is_input)


@pytest.mark.parametrize("column", ["temperature", "position[7]", "x", "run 3"])
def test_names_that_fit_no_place_suggest_none(folder, column):
    plant = load_case(write_case(folder, f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\n{SHARED}')).plant
    assert suggest(column, plant) is None


def test_an_unknown_place_suggests_the_joint(folder):
    text = '[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\n' + SHARED.replace(
        "joint:shoulder_pan", "shoulder_pan.pos"
    )
    with pytest.raises(BadCase, match="unknown sensor 'shoulder_pan.pos'; did you mean 'joint:shoulder_pan'"):
        load_case(write_case(folder, text))


def test_degrees_read_as_radians_leave_the_range_of_the_joint(folder):
    table = columns()
    table["q"] = np.rad2deg(table["q"]) * 5
    write_csv(folder / "deg.csv", table)
    case = load_case(write_case(folder, f'[[recording]]\nfile = "deg.csv"\nrole = "fit"\ntime = "t"\n{SHARED}'))
    (found,) = check_ranges(case, case.runs())
    assert found.severity == "warning"
    assert "in deg the numbers stay inside" in found.text
    assert 'unit = "deg" in every [[channel]] with column = "q"' in found.text
    right = load_case(
        write_case(folder, (folder / "case.toml").read_text().removeprefix(HEAD).replace('"rad"', '"deg"'))
    )
    assert check_ranges(right, right.runs()) == []


def test_the_overview_of_a_file(folder, capsys):
    table = {**columns(), "angle [deg]": 40 * columns()["q"], "who": np.full(N, np.nan)}
    write_csv(folder / "log.csv", table)
    status, out, _ = command(capsys, "columns", str(folder / "log.csv"), "--model", str(folder / "rig.xml"), "--json")
    assert status == 0
    document = json.loads(out)
    found = {column["name"]: column for column in document["columns"]}
    assert found["t"]["kind"] == "time"
    assert found["t"]["rate_hz"] == pytest.approx(100.0)
    assert found["angle [deg]"]["unit"] == "deg"
    assert found["q"]["rows"] == N
    assert found["q"]["greatest"] == pytest.approx(columns()["q"].max())
    assert found["who"]["blank"] == N
    status, out, _ = command(capsys, "columns", str(folder / "log.csv"))
    assert status == 0
    assert "time, 100 Hz" in out


def test_the_overview_of_a_data_set_names_the_elements(folder, capsys):
    lerobot(folder / "set", 3)
    status, out, _ = command(capsys, "columns", str(folder / "set"), "--model", str(folder / "rig.xml"))
    assert status == 0
    assert "action[1] = action[elbow_flex.pos]" in out
    assert "flex_servo (input)" in out
    assert "time, starts again 1 times" in out


@pytest.mark.parametrize(
    ("name", "match"), [("none.csv", "no such file"), ("rig.xml", "accepted: .csv"), (".", "no recording")]
)
def test_an_overview_of_what_is_no_recording_is_one_line(folder, capsys, name, match):
    status, out, err = command(capsys, "columns", str(folder / name))
    assert (status, out) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert match in err


def test_an_unknown_column_suggests_the_element(folder):
    lerobot(folder / "set", 2)
    text = f'[[recording]]\nfile = "set"\nrole = "fit"\nepisode = 1\n{ROBOT}'.replace(
        "action[elbow_flex.pos]", "action[7]"
    )
    with pytest.raises(UnknownName, match=r"unknown column 'action\[7\]'.*accepted: action\[0\], action\[1\]"):
        load_case(write_case(folder, text)).runs()


def test_a_stated_period_is_checked_against_the_inputs(folder):
    table = columns()
    table["u"] = np.sin(2 * np.pi * TIME / 0.5)
    write_csv(folder / "run1.csv", table)
    text = f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\nperiod_s = 0.5\n{SHARED}'
    assert check_periods(load_case(write_case(folder, text)).runs()) == []
    for period, match in (("0.4", "differs by"), ("1.2", "hold less than two periods")):
        (found,) = check_periods(load_case(write_case(folder, text.replace("= 0.5", f"= {period}"))).runs())
        assert match in found.text
    with pytest.raises(BadCase, match="must be positive"):
        load_case(write_case(folder, text.replace("= 0.5", "= 0.0")))
