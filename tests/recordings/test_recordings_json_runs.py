"""JSON logs of several runs: one table with the number of the run, and one recording a run in a case."""

import json

import numpy as np
import pytest

from vlab.cases.case import load_case
from vlab.cases.draft import draft_case
from vlab.recordings import open_table
from vlab.recordings.table import EVERY

SLIDE = """<mujoco model="slide"><option timestep="0.001" gravity="0 0 0"/><worldbody><body name="carriage">
<joint name="slide" type="slide" axis="1 0 0" stiffness="800" damping="6"/><geom type="box" size="0.05 0.05 0.05" mass="2"/>
</body></worldbody><actuator><motor name="motor" joint="slide"/></actuator>
<sensor><jointpos name="encoder" joint="slide"/></sensor></mujoco>"""


def lists(seed, count=60):
    time = 0.02 * np.arange(count)
    return {
        "time": time.tolist(),
        "motor": np.sin(seed + 9 * time).tolist(),
        "encoder": (1e-3 * np.cos(seed + time)).tolist(),
    }


def rows(seed, count=60):
    one = lists(seed, count)
    return [dict(zip(one, values, strict=True)) for values in zip(*one.values(), strict=True)]


FORMS = {
    "list of runs": [lists(1), lists(2, 50)],
    "list of lists of rows": [rows(1), rows(2, 50)],
    "named runs": {"robot": "cart", "run1": lists(1), "run2": lists(2, 50)},
    "named rows": {"episode_0": rows(1), "episode_1": rows(2, 50)},
    "runs under a key": {"meta": {"robot": "cart", "rate": 50}, "runs": [lists(1), lists(2, 50)]},
    "rows under a key": {"trials": [rows(1), rows(2, 50)]},
}


def written(folder, content, name="log.json"):
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.parametrize("form", FORMS)
def test_runs_of_a_document_follow_each_other(tmp_path, form):
    table = open_table(written(tmp_path, FORMS[form]), blanks=EVERY)
    assert set(table.names) == {"time", "motor", "encoder", "episode_index"}
    np.testing.assert_allclose(table["encoder"], [*lists(1)["encoder"], *lists(2, 50)["encoder"]])
    np.testing.assert_array_equal(table["episode_index"], [0] * 60 + [1] * 50)
    assert any("2 runs" in note for note in table.notes)


def test_each_run_of_a_document_is_a_recording(tmp_path):
    (tmp_path / "slide.xml").write_text(SLIDE)
    log = written(tmp_path, {"runs": [lists(1), lists(2, 50)]})
    draft = draft_case(str(tmp_path / "slide.xml"), [log], tmp_path)
    (tmp_path / "case.toml").write_text(draft.text)
    runs = load_case(tmp_path).runs()
    assert [(run.role, len(run.measured.time)) for run in runs] == [("fit", 60), ("holdout", 50)]
    np.testing.assert_allclose(runs[1].measured["encoder"], lists(2, 50)["encoder"])


def test_each_line_of_lists_is_a_run(tmp_path):
    text = "".join(json.dumps({"name": f"take {i}", **lists(i)}) + "\n" for i in range(3))
    table = open_table(written(tmp_path, text, "log.jsonl"), blanks=EVERY)
    np.testing.assert_array_equal(table["episode_index"], np.repeat([0, 1, 2], 60))


def test_one_run_in_a_list_has_times_that_increase(tmp_path):
    table = open_table(written(tmp_path, [lists(3)]), columns=["time", "motor"])
    assert table.names == ("time", "motor")
    np.testing.assert_allclose(table["time"], lists(3)["time"])


def test_data_inside_of_runs_have_dotted_names(tmp_path):
    runs = [{"name": name, "gain": 2.0, "data": lists(i)} for i, name in enumerate("ab")]
    table = open_table(written(tmp_path, runs), blanks=EVERY)
    assert {"data.time", "data.motor", "gain", "episode_index"} <= set(table.names)
    assert "a, b" in table.notes[0]


@pytest.mark.parametrize(
    "record",
    [
        {"time": 0.1, "q": [0.1, 0.2, 0.3]},
        {"timestamp": 7, "t": [1.0, 2.0, 0.5]},  # a place t, not a list of times
        {"stamp": 0.3, "joints": [{"position": 1.0}, {"position": 2.0}]},
    ],
)
def test_rows_with_vectors_are_no_runs(tmp_path, record):
    table = open_table(written(tmp_path, [record] * 40), blanks=EVERY)
    assert "episode_index" not in table.names
    assert all(len(table[name]) == 40 for name in table.names)


def test_rows_of_vectors_without_a_time_are_no_runs(tmp_path):
    table = open_table(written(tmp_path, [{"q": [0.1 * i, 0.2], "u": [1.0, 2.0]} for i in range(40)]))
    assert table.names == ("q[0]", "q[1]", "u[0]", "u[1]")


def test_streams_of_one_recording_stay_apart(tmp_path):
    table = open_table(written(tmp_path, {"left": lists(1), "right": lists(2)}), blanks=EVERY)
    assert "left.encoder" in table.names
    assert "episode_index" not in table.names
    assert any("if they are runs" in note for note in table.notes)


def test_a_column_that_one_run_lacks_has_no_readings_there(tmp_path):
    short = lists(2)
    del short["motor"]
    table = open_table(written(tmp_path, [lists(1), short]), blanks=EVERY)
    assert np.isnan(table["motor"][60:]).all()
    assert np.isfinite(table["motor"][:60]).all()


def test_columns_of_unequal_length_in_a_run_are_named(tmp_path):
    odd = lists(2) | {"motor": [1.0, 2.0, 3.0]}
    table = open_table(written(tmp_path, [lists(1), odd]), blanks=EVERY)
    assert "in run '1' it has 3 rows, and its other columns 60" in table.refused["motor"]


def test_the_actuator_of_a_nested_log_is_found(tmp_path):
    (tmp_path / "slide.xml").write_text(SLIDE)
    one = lists(1)
    nested = {"time": one["time"], "act": {"motor": one["motor"]}, "sens": {"encoder": one["encoder"]}}
    draft = draft_case(str(tmp_path / "slide.xml"), [written(tmp_path, nested)], tmp_path)
    assert {(m.label, m.at) for m in draft.channels} == {("act.motor", "motor"), ("sens.encoder", "encoder")}


def test_episodes_of_a_text_log_are_recordings(tmp_path):
    (tmp_path / "slide.xml").write_text(SLIDE)
    lines = ["time,motor,encoder,episode_index"]
    lines += [f"{r['time']:.2f},{r['motor']},{r['encoder']},{i}" for i in range(3) for r in rows(i)]
    written(tmp_path, "\n".join(lines) + "\n", "log.csv")
    text = draft_case(str(tmp_path / "slide.xml"), [tmp_path / "log.csv"], tmp_path).text
    (tmp_path / "case.toml").write_text(text)
    assert [run.role for run in load_case(tmp_path).runs()] == ["fit", "fit", "holdout"]
