"""Files that are no files, numbers out of range and sensors that stand still: one line, and no waiting."""

import errno
import json
import os

import numpy as np
import pytest
from command import run

from vlab.cli import init
from vlab.files import plain_text

MODEL = """<mujoco model="rig"><option timestep="0.002" gravity="0 0 0"/>
  <worldbody><body name="arm"><joint name="hinge" axis="0 1 0" stiffness="2" damping="{damping}"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.4"/></body></worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
  <sensor><jointpos name="encoder" joint="hinge"/></sensor></mujoco>
"""
CASE = """[model]
mjcf = "rig.xml"
[[recording]]
file = "a.csv"
role = "fit"
rate_hz = {rate}
[[recording.channel]]
column = "encoder"
at = "encoder"
kind = "angle"
unit = "rad"
"""


@pytest.fixture
def rig(tmp_path):
    """Return a folder with a model, a case and two logs, one of them a link to the other."""
    write(tmp_path, np.sin(np.arange(400) / 30.0))
    return tmp_path


def write(folder, encoder, *, damping=0.01, rate="100.0"):
    (folder / "rig.xml").write_text(MODEL.format(damping=damping))
    (folder / "case.toml").write_text(CASE.format(rate=rate))
    rows = (f"{k / 100.0:.2f},{0.1 * np.cos(k / 30.0):.6g},{y:.6g}" for k, y in enumerate(encoder))
    (folder / "a.csv").write_text("t,motor,encoder\n" + "\n".join(rows) + "\n")


def refused(capsys, *words):
    """Return the one line with which a command refuses its input."""
    status, out, err = run(capsys, *map(str, words))
    assert (status, out, err.count("\n")) == (2, "", 1)
    return err


@pytest.mark.parametrize("verb", ["compare", "check", "diagnose"])
def test_a_device_or_a_pipe_is_no_case(capsys, tmp_path, verb):
    os.mkfifo(tmp_path / "pipe.toml")
    assert "a device or a pipe" in refused(capsys, verb, tmp_path / "pipe.toml")
    assert "a device or a pipe" in refused(capsys, verb, "/dev/zero")


def test_a_pipe_among_the_files_of_a_campaign_or_an_output_folder_is_not_waited_for(capsys, rig):
    (rig / "cases").mkdir()
    os.mkfifo(rig / "cases" / "commitments.json")
    assert "a device or a pipe" in refused(capsys, "prove", rig / "cases")
    (rig / "out").mkdir()
    os.mkfifo(rig / "out" / "manifest.json")
    assert "holds files that vlab did not write" in refused(capsys, "check", rig / "case.toml", "--out", rig / "out")


def test_a_text_file_of_any_size_is_not_read_into_memory(capsys, rig, monkeypatch):
    monkeypatch.setattr(plain_text, "MOST_BYTES", 100)
    assert "at most 100 are read" in refused(capsys, "compare", rig / "case.toml")


def test_a_whole_number_beyond_all_floats_is_refused_with_its_key(capsys, rig):
    write(rig, np.sin(np.arange(400) / 30.0), rate="9" * 400)
    assert "recording[0].rate_hz: the whole number is above 1e308" in refused(capsys, "check", rig / "case.toml")


def test_a_check_of_sensors_that_stand_still_says_so(capsys, rig):
    write(rig, np.zeros(400))
    status, out, err = run(capsys, "check", str(rig / "case.toml"))
    assert (status, err) == (0, "")
    assert "no sensor moves in any recording to fit" in out


def test_a_model_that_grows_out_of_all_numbers_about_rest_is_refused(capsys, rig):
    write(rig, np.sin(np.arange(400) / 30.0), damping=-50.0)
    assert run(capsys, "init", str(rig / "rig.xml"), str(rig / "a.csv"), "--out", str(rig / "drafted"))[0] == 0
    line = refused(capsys, "compare", rig / "case.toml")
    assert "unstable and grows out of all numbers" in line
    assert 'say initial = "rest"' in line


def test_a_log_that_is_named_twice_is_taken_once(capsys, rig):
    (rig / "b.csv").symlink_to("a.csv")
    logs = [str(rig / "a.csv"), str(rig / ".." / rig.name / "a.csv"), str(rig / "b.csv")]
    status, out, _ = run(capsys, "init", str(rig / "rig.xml"), *logs, "--out", str(rig / "drafted"))
    assert status == 0
    assert out.count(" held out, to verify what is found") <= 1
    assert "start_s" in (rig / "drafted" / "case.toml").read_text()  # the one log is divided
    assert run(capsys, "check", str(rig / "drafted"), "--allow-outside")[0] == 0


def test_a_column_with_the_name_of_an_actuator_drives_the_actuator(capsys, rig):
    status, _, _ = run(capsys, "init", str(rig / "rig.xml"), str(rig / "a.csv"), "--out", str(rig / "drafted"))
    assert status == 0
    text = (rig / "drafted" / "case.toml").read_text()
    assert 'at = "motor"' in text
    assert "input = true" in text


def test_a_draft_that_cannot_be_written_leaves_no_empty_folder(capsys, rig, monkeypatch):
    def full(*arguments, **settings):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "case.toml")

    monkeypatch.setattr(init, "written_whole", full)
    words = ["init", rig / "rig.xml", rig / "a.csv", "--out", rig / "new" / "drafted"]
    assert "No space left on device" in refused(capsys, *words)
    assert not (rig / "new").exists()


def test_a_diagnosis_of_sensors_that_stand_still_ends_before_any_fit(capsys, rig, monkeypatch):
    from vlab.diagnose import pipeline

    def unwanted(*_):
        raise AssertionError("a model class was fitted")

    monkeypatch.setattr(pipeline, "choose_model_class", unwanted)
    write(rig, np.full(400, 0.001))
    status, out, _ = run(capsys, "diagnose", str(rig / "case.toml"), "--out", str(rig / "out"))
    assert status == 0
    assert "no sensor moves in any recording to fit" in out
    assert "0.001 rad throughout" in out


def test_the_noise_of_a_check_is_at_least_that_of_the_step(capsys, rig):
    step = 0.05
    write(rig, step * np.rint(np.sin(np.arange(400) / 30.0) / step))
    status, out, _ = run(capsys, "check", str(rig / "case.toml"), "--json")
    assert status == 0
    for channel in (c for c in json.loads(out)["channels"] if not c["is_input"]):
        assert channel["step"] == pytest.approx(step)
        assert channel["noise"] >= step / np.sqrt(12.0) * (1.0 - 1e-9)
    assert "sensor step" in run(capsys, "check", str(rig / "case.toml"))[1]
