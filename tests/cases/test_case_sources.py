"""Sources of a case: stated states, data sets, outside files; names and units that they suggest."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command import run as command
from form_rigs import HEAD, SHARED, TIME, N, channel, columns, write_case, write_csv

from vlab.cases import load_case
from vlab.cases.checks.periods import check_periods
from vlab.cases.checks.ranges import check_ranges
from vlab.cases.places import suggest
from vlab.cases.simulate import simulate
from vlab.errors import BadCase, UnknownName, VlabError

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
