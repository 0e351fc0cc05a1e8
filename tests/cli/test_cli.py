"""The command line as others' scripts call it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command import run

from vlab.cli import VERBS, build_parser, main
from vlab.errors import OutputRefused
from vlab.files.assets import asset
from vlab.files.output_folder import output_folder, write_manifest
from vlab.recordings import read_recording
from vlab.views.reports import modal_test as modal_test_report

QUICK = ("experiment", "beam", *["--plant", "modal", "--seconds", "0.5", "--period", "0.2", "--band", "10", "30"])
"""The shortest experiment there is."""


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "run"
    words = f"experiment beam --plant modal --seconds 3 --period 1 --band 1 30 --seed 3 --law mfdrf --out {out}".split()
    assert main(words) == 0
    return out


def test_modes_document_has_what_scripts_need(capsys):
    status, out, err = run(capsys, "modes", "beam", "--json")
    document = json.loads(out)
    assert status == 0
    assert err == ""
    assert document["structure"] == "beam"
    assert [row["mode"] for row in document["modes"]] == [1, 2, 3, 4, 5, 6]
    header = run(capsys, "modes", "beam")[1].lower()
    assert "fe model hz" in header
    assert "mujoco fe matrices hz" in header
    assert " fe hz" not in header
    for row in document["modes"]:
        assert row["fe_hz"] == pytest.approx(row["published_hz"], rel=1e-3)  # Table 1, 0.1 %
        assert row["plant_hz"]["composite"] == pytest.approx(row["fe_hz"], rel=2e-3)  # 0.2 %
        assert row["mac"]["composite"] >= 0.995
        assert set(row["plant_hz"]) == {"composite", "fe", "modal"}
    for facts in document["plants"].values():
        assert set(facts) >= {"dof", "timestep_s", "numerical_damping_ratio", "real_time_factor"}
        assert abs(facts["numerical_damping_ratio"]) < 1e-4


def test_reproduce_document_has_cells_and_reasons(capsys):
    status, out, _ = run(capsys, "reproduce", "1", "8", "12", "--json")  # all of them: tests/reproduce
    document = json.loads(out)
    assert status == 0
    assert [t["table"] for t in document["tables"]] == ["1", "8", "12"]
    assert document["shares"]["beam"] == {"of": 24, "inside_honest": 24, "inside": 24}
    assert document["shares"]["grid"]["inside_honest"] == document["shares"]["grid"]["of"] - 1  # one was widened
    cell = document["tables"][0]["cells"][0]
    assert set(cell) >= {"row", "column", "published", "ours", "tolerance", "ok"}
    assert all(set(part) == {"table", "why"} for part in document["not_reproducible"])


def test_reproduce_says_when_a_cell_is_out(capsys, monkeypatch):
    monkeypatch.setattr("vlab.reproduce.tables.structure.TABLE_1", 1e-5)
    status, out, _ = run(capsys, "reproduce", "1")
    assert status == 1
    assert "no" in out


def test_a_run_folder_is_whole(run_folder):
    assert {p.name for p in run_folder.iterdir()} == {"recording.parquet", "run.toml", "manifest.json", "run.rrd"}
    manifest = json.loads((run_folder / "manifest.json").read_text())
    assert manifest["settings"]["seed"] == 3
    assert len(manifest["recording_sha256"]) == 64
    recording = read_recording(run_folder / "recording.parquet")
    assert recording.rate == pytest.approx(2000.0)
    assert recording.inputs == ("excitation:base",)
    assert recording.meta["law"] == "mfdrf"


def test_the_same_command_gives_the_same_bits(run_folder, tmp_path):
    words = f"experiment beam --plant modal --seconds 3 --period 1 --band 1 30 --seed 3 --law mfdrf --out {tmp_path / 'again'}".split()
    assert main(words) == 0
    first, second = (json.loads((p / "manifest.json").read_text()) for p in (run_folder, tmp_path / "again"))
    assert first["recording_sha256"] == second["recording_sha256"]


@pytest.mark.slow
def test_bits_do_not_depend_on_the_number_of_threads(tmp_path):
    # 221 degrees of freedom: large enough for the linear algebra to be split over threads
    words = [
        "experiment",
        "grid",
        "--plant",
        "composite",
        "--seconds",
        "0.5",
        "--period",
        "0.25",
        "--band",
        "4",
        "30",
        "--out",
    ]
    hashes = []
    for threads in ("1", "2"):
        out = tmp_path / threads
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
        subprocess.run(
            [sys.executable, "-m", "vlab", *words, str(out)], env=environment, check=True, capture_output=True
        )
        hashes.append(json.loads((out / "manifest.json").read_text())["recording_sha256"])
    assert hashes[0] == hashes[1]


def test_modal_test_reads_a_run_folder(capsys, monkeypatch, run_folder, tmp_path):
    monkeypatch.setattr(modal_test_report, "DRAWN", 1)  # a figure takes longer than the fit
    monkeypatch.setattr(modal_test_report, "DISTORTED", 1)
    status, out, _ = run(
        capsys,
        "modal-test",
        str(run_folder),
        "--modes",
        "3",
        "--band",
        "3",
        "20",
        "--json",
        "--out",
        str(tmp_path / "test"),
    )
    document = json.loads(out)
    assert status == 0
    assert len(document["modes"]) == 3
    assert set(document["modes"][0]) >= {"hz", "zeta", "shape", "confidence"}
    frf = document["frf"][0]
    assert np.shape(frf["real"]) == (len(frf["freq_hz"]), len(frf["outputs"]), 1)
    assert (tmp_path / "test" / "manifest.json").is_file()


def test_experiment_document_names_its_channels(capsys, tmp_path):
    status, out, _ = run(
        capsys, "experiment", "beam", "--plant", "modal", "--excite", "release", "--level", "0.2", "--seconds", "0.5", "--json", "--out", str(tmp_path / "r")
    )  # fmt: skip
    document = json.loads(out)
    assert status == 0
    assert document["real_time_factor"] > 0
    assert document["is_compiled"]
    assert "probe:30in" in document["channels"]


@pytest.mark.parametrize(
    ("seconds", "said"), [("0.3", "the record holds 1.5 periods of its excitation (0.2 s)"), ("0.4", "")]
)
def test_a_record_too_short_for_its_period_is_said(capsys, tmp_path, seconds, said):
    words = ["experiment", "beam", "--plant", "modal", "--period", "0.2", "--band", "10", "30", "--seconds", seconds]
    status, out, err = run(capsys, *words, "--out", str(tmp_path / "run"))
    assert (status, err) == (0, "")  # a record like that can be wanted: it is no error
    if said:
        (line,) = (line for line in out.splitlines() if line.startswith(said))
        assert line.endswith("give --seconds 0.8, or a shorter --period")
    else:
        assert "periods" not in out
    status, out, _ = run(capsys, "experiment", "beam", "--plant", "modal", "--excite", "release", "--seconds", "0.2",
                         "--json", "--out", str(tmp_path / "release"))  # fmt: skip
    assert json.loads(out)["periods"] is None


def test_csv_says_the_same_as_parquet(tmp_path):
    words = (
        f"experiment beam --plant modal --seconds 0.2 --period 0.1 --band 10 30 --csv --out {tmp_path / 'run'}".split()
    )
    assert main(words) == 0
    parquet, csv = (read_recording(tmp_path / "run" / f"recording.{kind}") for kind in ("parquet", "csv"))
    assert np.array_equal(parquet.data, csv.data)
    assert parquet.channels == csv.channels


def test_a_divergence_is_one_line_and_status_1(capsys, tmp_path):
    words = [
        "experiment",
        "beam",
        "--plant",
        "modal",
        "--level",
        "1e300",
        "--seconds",
        "1",
        "--out",
        str(tmp_path / "out"),
    ]
    status, out, err = run(capsys, *words)
    assert (status, out) == (1, "")
    assert "diverged" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["modes", "baem"], "did you mean 'beam'"),
        (["modes", "beam", "--variant", "publsihed"], "did you mean 'published'"),
        (["experiment", "beam", "--law", "mfdfr"], "unknown law 'mfdfr'; did you mean 'mfdrf'"),
        (["experiment", "beam", "--plant", "compsite"], "did you mean 'composite'"),
        (["experiment", "beam", "--excite", "noise"], "unknown excitation 'noise'"),
        (["experiment", "beam", "--at", "bse"], "did you mean"),
        (["experiment", "beam", "--rate", "1900"], "not a whole number; rates that fit are"),
        (["experiment", "beam", "--rate", "5000"], "outside the converter's 2 to 2000 Hz"),
        (["experiment", "beam", "--seconds", "nan"], "cannot be run"),
        (["experiment", "beam", "--seconds", "-1"], "cannot be run"),
        (["experiment", "beam", "--band", "30", "5"], "not 0 < low < high"),
        (["experiment", "beam", "--band", "5", "2000"], "drives and records up to 1000 Hz"),
        (["experiment", "beam", "--level", "inf"], "not a finite number"),
        (["experiment", "beam", "--seed", "-1"], "accepted: whole numbers from 0"),
        *(
            ([verb, *more, "--seed", "-1"], "accepted: whole numbers from 0")
            for verb, *more in (["demo"], ["correct", "beam"], ["reproduce"], ["conceal"], ["prove", "--quick"])
        ),
        (["experiment", "beam", "--noise", "-1"], "is negative"),
        (["experiment", "beam", "--noise", "nan"], "not finite"),
        (["experiment", "beam", "--noise", "1e300"], "accepted: 0 to 1000"),
        (["experiment", "beam", "--period", "1e30"], "more than 1e+06 lines"),
        (["experiment", "beam", "--excite", "release", "--period", "3"], "has no setting 'period_s'"),
        (["experiment", "beam", "--hardware", "nowhere.toml"], "nowhere.toml"),
        (["experiment"], "required: structure"),
        (["experiment", "beam", "--seconds", "ten"], "invalid float value: 'ten'"),
        (["reproduce", "42"], "unknown table '42'; did you mean '4'? (accepted: 1, 3, 4, 5, "),
        (["modal-test", "nowhere.parquet"], "nowhere.parquet"),
        (["modal-test", "nowhere"], "nowhere: there is no such file"),
        (["compare", "nowhere"], "nowhere"),
        (["compare", "x" * 5000], "File name too long"),
        (["modes", "x" * 5000], "File name too long"),
        (["experiment", "beam", "--out", "x" * 5000], "File name too long"),
        (["experiment", "beam", "--out", "."], "the output folder . is the folder in which the command runs"),
        (["conceal", "--n", "1", "--out", "."], "the output folder . is the folder in which the command runs"),
        (["conceal", "--n", "1", "--out", "/"], "no folder can stand beside the root"),
        (["prove", "."], "commitments.json"),
        (["prove", "/"], "no folder can stand beside the root"),
        (["show", "nowhere"], "no run.rrd here"),
        (["dance"], "unknown command 'dance'; did you mean 'diagnose'? (accepted: demo, examples"),
        (["diagnos", "case.toml"], "unknown command 'diagnos'; did you mean 'diagnose'?"),
        (["modes", "--jsn"], "unknown option '--jsn'; did you mean '--json'?"),
        (["diagnose", "--out-folder=x"], "unknown option '--out-folder'; did you mean '--out'?"),
        (["--versoin"], "unknown option '--versoin'; did you mean '--version'?"),
        (["examples", "dance"], "vlab examples: unknown argument 'dance'"),
        (
            ["check", "a.xml", "b c.csv"],
            "'b c.csv'; vlab check takes one case: draft it with vlab init a.xml 'b c.csv'",
        ),
        (["experiment", "beam", "--out", "/dev/null/sub"], "lies in /dev/null, which is a file"),
        (["conceal", "--again", "/dev/null", "--out", "new"], "/dev/null is no folder of sealed cases"),
        (["--json"], "required: VERB"),
        (["--json", "examples"], "unknown argument '--json'; write it after the command"),
    ],
)
def test_bad_input_is_one_line_and_status_2(capsys, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *words)
    assert status == 2
    assert out == ""
    assert message in err
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []  # nothing half-written


def test_what_is_no_rerun_recording_is_not_given_to_the_viewer(capsys, tmp_path):
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(b"RR")
    status, out, err = run(capsys, "show", str(cut))
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "it does not begin as one" in err


def test_a_truncated_run_is_refused(capsys, run_folder, tmp_path):
    copy = tmp_path / "run"
    copy.mkdir()
    (copy / "run.toml").write_bytes((run_folder / "run.toml").read_bytes())
    whole = (run_folder / "recording.parquet").read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", b"no parquet"):
        (copy / "recording.parquet").write_bytes(damaged)
        status, _, err = run(capsys, "modal-test", str(copy))
        assert status == 2
        assert "recording.parquet" in err


def test_channel_names_that_match_nothing_are_refused(capsys, run_folder):
    status, _, err = run(capsys, "modal-test", str(run_folder), "--output", "sensor:bse")
    assert status == 2
    assert "did you mean 'sensor:base'" in err


@pytest.mark.parametrize(
    ("order", "status", "said"),
    [
        ("computers,software,array,control,amplifiers,op-amps", 0, ""),
        ("computers, software, array, control, op-amps, amplifiers", 0, "unstable-sensors"),
        ("computers,software,array,amplifiers,control,op-amps", 2, "warmed the coils by 100 K"),
        ("computers,software,array,control,amplifiers", 2, "'op-amps' is off"),
        ("computers,sofware", 2, "did you mean 'software'?"),
    ],
)
def test_the_bench_is_switched_on_as_told_and_has_its_faults(capsys, tmp_path, order, status, said):
    found, out, err = run(capsys, *QUICK, "--power-up", order, "--out", str(tmp_path / "run"), "--json")
    assert found == status
    assert said in (err if status else out)
    if not status:
        manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
        assert manifest["faults"] == json.loads(out)["faults"]
        assert len(manifest["faults"]) == (1 if said else 0)


@pytest.mark.parametrize("words", ["--force base", "--response 40in", "--response 40in --out out"])
def test_responses_need_a_force_and_a_folder(capsys, words):
    status, _, err = run(capsys, "modes", "beam", *words.split())
    assert status == 2
    assert "give --force" in err


def test_a_folder_with_other_files_is_never_touched(capsys, tmp_path):
    precious = tmp_path / "results"
    precious.mkdir()
    (precious / "thesis.txt").write_text("three years")
    status, _, err = run(capsys, *QUICK, "--out", str(precious))
    assert status == 2
    assert "files that vlab did not write" in err
    assert [p.name for p in tmp_path.rglob("*")] == ["results", "thesis.txt"]


def test_what_is_read_is_never_replaced(capsys, run_folder, tmp_path):
    before = sorted((p.name, p.stat().st_mtime_ns) for p in run_folder.iterdir())
    for read, out in ((run_folder, run_folder), (run_folder / "recording.parquet", run_folder)):
        status, _, err = run(capsys, "modal-test", str(read), "--out", str(out))
        assert status == 2
        assert "read here and would be lost" in err
    assert sorted((p.name, p.stat().st_mtime_ns) for p in run_folder.iterdir()) == before
    folder = tmp_path / "designed"  # of vlab's own, so it would be replaced
    with output_folder(folder) as fresh:
        (fresh / "controller.toml").write_text("")
        write_manifest(fresh)
    law = str(folder / "controller.toml")
    for words in (QUICK, ("design", "beam"), ("compare", law)):
        status, _, err = run(capsys, *words, *([] if words[0] == "compare" else ["--law", law]), "--out", str(folder))
        assert (status, "would be lost" in err) == (2, True)
    assert (folder / "controller.toml").exists()


def test_an_output_folder_that_cannot_be_written_is_refused(capsys, tmp_path):
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/nowhere/run")):
        status, _, err = run(capsys, *QUICK, "--out", str(out))
        assert status == 2
        assert "output folder" in err


def test_an_error_inside_leaves_the_old_folder(tmp_path):
    with output_folder(tmp_path / "out") as folder:
        (folder / "kept.txt").write_text("old")
        write_manifest(folder)
    with pytest.raises(ZeroDivisionError), output_folder(tmp_path / "out", overwrite=True) as folder:  # noqa: PT012
        (folder / "half.txt").write_text("new")
        raise ZeroDivisionError
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["kept.txt", "manifest.json"]
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    with pytest.raises(OutputRefused), output_folder(tmp_path / "out" / "kept.txt"):
        pass


def test_every_verb_has_help_and_json(capsys):
    for verb in VERBS:
        with pytest.raises(SystemExit) as stop:
            main([verb, "--help"])
        assert stop.value.code == 0
        assert build_parser(verb).parse_known_args([verb, "--json", "beam", "run.csv"])[0].json


def test_help_names_examples_that_an_installed_command_has_too():
    """A wheel has no folder ``assets``; ``example:NAME`` is there in a checkout and after an installation."""
    helps = {verb: next(a for a in build_parser(verb)._actions if a.dest == "verb").choices[verb] for verb in VERBS}
    texts = {verb: " ".join(sub.format_help().split()) for verb, sub in helps.items()}
    assert [verb for verb, text in texts.items() if "assets/" in text] == ["prove"]  # keys that only the laboratory has
    assert "example:plan.toml" in texts["experiment"]


@pytest.mark.parametrize("words", [[], ["help"]], ids=["nothing", "help"])
def test_without_a_command_the_commands_are_listed(capsys, words):
    status, out, err = run(capsys, *words)
    assert (status, err) == (0, "")
    assert set(VERBS) <= {line.split()[0] for line in out.splitlines() if line.startswith("    ") and line[4] != " "}


def test_help_of_a_command(capsys):
    status, out, _ = run(capsys, "help", "compare")
    assert status == 0
    assert out.startswith("usage: vlab compare")


def test_help_needs_no_simulator():
    code = (
        "import sys, vlab.cli; vlab.cli.build_parser(); sys.exit('mujoco' in sys.modules or 'control' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.slow
def test_demo_tells_the_whole_story(capsys, tmp_path):
    status, out, _ = run(capsys, "demo", "--json", "--out", str(tmp_path / "demo"))
    document = json.loads(out)
    assert status == 0
    assert set(document) >= {"out", "report", "rrd", "seconds"}
    assert Path(document["report"]).stat().st_size > 1e5
    assert Path(document["rrd"]).stat().st_size > 1e6
    assert all(abs(row["off_percent"]) < 3.0 for row in document["closed_loop"])  # asked for: 3 % on six modes
    concealed = document["concealed"]
    assert concealed["is_found"]
    assert concealed["diagnosis"]["heldout"]["gap_closed"] > 0.7
    assert concealed["truth"].partition("@")[0] in [f["effect"] for f in concealed["diagnosis"]["findings"]]
    case = (tmp_path / "demo" / "concealed" / "case.toml").read_text()
    assert concealed["truth"].partition("@")[0] not in case
    assert (tmp_path / "demo" / "diagnosis" / "report.html").exists()


@pytest.mark.slow
def test_shipped_case_is_compared(capsys):
    status, out, _ = run(capsys, "compare", str(asset("cases/avc_cantilever/free_decay.toml")), "--json")
    document = json.loads(out)
    assert status == 0
    for recording in document["runs"]:
        for misfit in recording["misfits"]:
            assert misfit["unit"] == "m"
            assert (
                0 < misfit["nrmse"] < 2.0
            )  # the nominal 8.0 Hz drifts off the measured 8.2 Hz: at worst opposite phase


@pytest.mark.parametrize("number", ["0", "-1", "two"])
def test_a_number_of_processes_is_whole_and_positive(capsys, number):
    status, _, err = run(capsys, "diagnose", "somewhere", f"--jobs={number}")
    assert status == 2
    assert f"'{number}' is no number of processes; accepted: whole numbers from 1" in err


def test_the_table_says_that_a_law_acts_within_a_servo(capsys):
    _, out, _ = run(capsys, "effects", "--family", "saturation")
    (line,) = [line for line in out.splitlines() if "servo-torque-speed-line" in line]
    assert "position servo" in line
    assert "joint" not in line
