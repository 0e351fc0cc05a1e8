"""Experiment, modal test and design from Python: the same as the commands."""

import json

import numpy as np
import pytest
from command import run

import vlab
from vlab.errors import BadDesign, BadExperiment, VlabError
from vlab.files.assets import asset
from vlab.recordings import read_recording

HAMMER = {"inputs": ["Hammer=force,N"], "outputs": ["Vel40in=velocity,mm/s", "VelBase=velocity,mm/s"]}


def test_an_experiment_in_memory_is_the_one_of_the_command(capsys, tmp_path):
    done = vlab.experiment("beam", seconds=0.5, seed=3, law="mfdrf", progress=False)
    words = ["experiment", "beam", "--seconds", "0.5", "--seed", "3", "--law", "mfdrf", "--out", str(tmp_path / "run")]
    status, _, err = run(capsys, *words)
    assert status == 0, err
    stored = read_recording(tmp_path / "run" / "recording.parquet")
    np.testing.assert_array_equal(done.recording.data, stored.data)
    assert "0.5 s" in repr(done)


def test_an_experiment_writes_a_run_folder(tmp_path):
    done = vlab.experiment(seconds=0.2, out=tmp_path / "run", progress=False)
    assert {"recording.parquet", "run.toml", "manifest.json", "run.rrd"} <= {
        p.name for p in (tmp_path / "run").iterdir()
    }
    np.testing.assert_array_equal(read_recording(tmp_path / "run" / "recording.parquet").data, done.recording.data)


def test_a_modal_test_is_the_one_of_the_command(capsys):
    found = vlab.modal_test(asset("examples/hammer.csv"), **HAMMER)
    words = [
        word
        for key, option in (("inputs", "--input"), ("outputs", "--output"))
        for n in HAMMER[key]
        for word in (option, n)
    ]
    status, out, err = run(capsys, "modal-test", str(asset("examples/hammer.csv")), *words, "--json")
    assert status == 0, err
    assert [mode["hz"] for mode in json.loads(out)["modes"]] == found.poles.freq.tolist()
    assert len(repr(found).splitlines()) == 1 + found.poles.freq.size


@pytest.mark.slow
def test_a_design_is_the_one_of_the_command(capsys, tmp_path):
    made = vlab.design("beam", "lqr")
    status, out, err = run(capsys, "design", "beam", "--law", "lqr", "--json")
    assert status == 0, err
    document, own = json.loads(out), made.to_dict()
    assert {k: v for k, v in document.items() if k != "seconds"} == {k: v for k, v in own.items() if k != "seconds"}
    assert repr(made).startswith("<DesignedLaw: lqr on the full model of beam; ")
    assert (made.save(tmp_path / "design") / "design.json").is_file()


def test_a_design_states_the_units_of_what_was_asked(capsys):
    status, out, err = run(capsys, "design", "beam", "--law", "lqr", "--r", "0.01")
    assert (status, err) == (0, "")
    assert "q = 1 (in, lbf, cs), r = 0.01 (m, N, s)" in out
    printed = vlab.design("beam", "lqr", r=0.22, units="published").document
    assert printed["performance_indices"] == pytest.approx(vlab.design("beam", "lqr").document["performance_indices"])
    assert set(printed["asked"]["units"].values()) == {"in, lbf, cs"}


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda: vlab.design("beam", ""), BadDesign),
        (lambda: vlab.design("beam", "mfdrf", with_delay=True), BadDesign),
        (lambda: vlab.design("beam", "lqq"), VlabError),
        (lambda: vlab.design("beam", "lqr", units="imperial"), VlabError),
        (lambda: vlab.experiment("beam", seed=-1), BadExperiment),
        (lambda: vlab.modal_test("none.csv"), VlabError),
    ],
)
def test_bad_settings_are_one_line(call, error):
    with pytest.raises(error) as caught:
        call()
    assert "\n" not in str(caught.value)
