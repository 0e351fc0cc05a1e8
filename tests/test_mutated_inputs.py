"""Whatever a file holds: something is computed, or one line says why not; nothing else, and in time."""

import functools
import json
import os
import shutil
import tempfile
import traceback
import warnings
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mutated import Bound, TooMuchWork, mutated_bytes, mutated_text
from vlab.controllers.law_file import load_law

import vlab.proof.prove as proving
from vlab.cases import compare_case, load_case
from vlab.cases.case import CASE as CASE_NAME
from vlab.cases.draft import draft_case
from vlab.cli import main
from vlab.diagnose.precheck import precheck_case
from vlab.diagnose.predictors.frequency_problem import prepare_frequency
from vlab.errors import VlabError
from vlab.fe import build_fe_model
from vlab.files.assets import asset
from vlab.files.output_folder import finite
from vlab.lab.plan import load_plan
from vlab.lab.run_folder import load_run
from vlab.modal.modal_test import ModalTest, run_modal_test
from vlab.plants import build_plant
from vlab.proof.conceal import conceal_cases
from vlab.proof.manifest import manifest
from vlab.proof.prove import prove
from vlab.proof.seal import ANSWERS, COMMITMENTS, MANIFEST, canonical, read_json, write_json
from vlab.recordings import write_recording
from vlab.signals import Channel, Recording
from vlab.structure import load_structure

MOST_S = 30.0
"""Work that a small file may make [s]: relaxing a model that never rests takes most."""
QUICK, FEW, MANY = 9, 4, int(os.environ.get("VLAB_MUTATED", "60"))
"""Files of every kind that are mutated: in a quick look, of those that take long in it, and in the slow tier; with VLAB_MUTATED=420 in
the environment these are five thousand in all."""

MANY_OF = {"case": 3}
"""Multiples of `MANY`: of the changes of a case file one in twenty is harmless."""

RIG = """<mujoco model="rig">
  <option timestep="0.002" gravity="0 0 -9.81"/>
  <worldbody><geom type="plane" size="2 2 0.1"/>
    <body name="arm" pos="0 0 1"><joint name="hinge" axis="0 1 0" stiffness="2" damping="0.05" range="-90 90"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.4"/><site name="tip" pos="0.3 0 0"/>
      <body name="tool" pos="0.3 0 0"><joint name="slide" type="slide" axis="1 0 0" stiffness="300" damping="0.4"/>
        <geom size="0.03" mass="0.2"/></body></body></worldbody>
  <tendon><fixed name="sum"><joint joint="hinge" coef="2"/></fixed></tendon>
  <actuator><motor name="motor" joint="hinge"/><position name="servo" joint="slide" kp="50"/></actuator>
  <sensor><jointpos name="encoder" joint="hinge"/><accelerometer name="acc" site="tip"/></sensor>
</mujoco>
"""
CASE = """title = "Rig"
[model]
mjcf = "rig.xml"
[model.uncertain]
mass = 0.03
"geom:rod:mass" = 0.1
[[model.effect]]
name = "coulomb-friction"
place = "joint:hinge"
parameters = {{ force = 0.01 }}
[[recording]]
file = "run.{kind}"
name = "first"
role = "fit"
time = "t"
start_s = 0.02
stop_s = 0.35
[[recording.channel]]
column = "u"
at = "motor"
kind = "moment"
unit = "N m"
input = true
hold = "zero"
[[recording.channel]]
column = "y"
at = "encoder"
kind = "angle"
unit = "rad"
delay_s = 0.001
[[recording]]
file = "run.{kind}"
role = "holdout"
rate_hz = 100.0
start_s = 0.4
initial = "rest"
[[recording.channel]]
column = "y"
at = "joint:hinge"
kind = "angle"
unit = "deg"
scale = 1.0
"""
TIME = np.arange(60) / 100.0
COLUMNS = {"t": TIME, "u": 0.2 * np.sin(9 * TIME), "y": 0.1 * np.sin(9 * TIME) ** 2}


def rig(folder, kind):
    """A user's model with recordings of one kind of file."""
    (folder / "rig.xml").write_text(RIG)
    (folder / "case.toml").write_text(CASE.format(kind=kind))
    path = folder / f"run.{kind}"
    if kind == "csv":
        rows = zip(*COLUMNS.values(), strict=True)
        path.write_text("t,u,y\n" + "\n".join(",".join(f"{value:.6g}" for value in row) for row in rows) + "\n")
    elif kind == "parquet":
        pq.write_table(pa.table(COLUMNS), path)
    elif kind == "npz":
        np.savez(path, **COLUMNS)
    else:
        channels = [Channel(name=name, kind="angle", unit="rad", is_input=name == "u") for name in ("u", "y")]
        data = np.column_stack([COLUMNS["u"], COLUMNS["y"]])
        write_recording(Recording(time=TIME, data=data, channels=channels), path)
        text = (folder / "case.toml").read_text()
        (folder / "case.toml").write_text(text.replace('time = "t"', 'time = "time"'))


def compared(folder):
    json.dumps(finite(compare_case(folder).to_json(overlay=True)), allow_nan=False)


def checked(folder):
    json.dumps(finite(precheck_case(folder).to_json()), allow_nan=False)


def drafted(folder):
    """A case of a model and its logs is drafted, and can be read."""
    draft = draft_case(str(folder / "rig.xml"), [folder / "run.csv", folder / "again.csv"], folder)
    (folder / CASE_NAME).write_text(draft.text)
    load_case(folder)


def logged(folder):
    """A model with two logs whose columns have the names of its parts, and no case."""
    (folder / "rig.xml").write_text(RIG)
    rows = "\n".join(",".join(f"{value:.6g}" for value in row) for row in zip(*COLUMNS.values(), strict=True))
    for name in ("run", "again"):
        (folder / f"{name}.csv").write_text(f"t [s],motor [N m],encoder [rad]\n{rows}\n")


def structure(folder):
    """The beam and its laboratory as files, with a law and its gains in the loop."""
    for name in ("beam", "laboratory"):
        shutil.copyfile(asset(f"{name}.toml"), folder / f"{name}.toml")
    (folder / "law.toml").write_text(
        'format = "vlab-law-1"\nsensors = ["base", "20in"]\nactuators = ["base"]\nrate_hz = 1000.0\n'
        "A = [[0.5, 0.1], [0.0, 0.2]]\nB = [[1.0, 0.5], [0.5, 2.0]]\nC = [[1.0, 0.0]]\nD = [[0.0, 0.0]]\n"
    )
    time = np.arange(200) / 2000.0
    pq.write_table(pa.table({"u": np.sin(50 * time), "y": 1e-3 * np.sin(50 * time)}), folder / "run.parquet")
    (folder / "case.toml").write_text("""title = "Beam"
[model]
structure = "beam.toml"
hardware = "laboratory.toml"
plant = "modal"
[[recording]]
file = "run.parquet"
role = "fit"
rate_hz = 2000.0
[[recording.channel]]
column = "u"
at = "base"
kind = "force"
unit = "N"
input = true
[[recording.channel]]
column = "y"
at = "sensor:base"
kind = "velocity"
unit = "m/s"
""")


def structured(folder):
    load_law(folder / "law.toml")
    built = load_structure(folder / "beam.toml")
    build_fe_model(built)
    build_plant(built, "composite").linearise()
    compared(folder)


def frame(folder):
    """Frequency responses and a table of modes of a real frame."""
    for path in Path(asset("cases/three_storey")).iterdir():
        if path.suffix in (".toml", ".xml", ".mat", ".csv"):
            shutil.copyfile(path, folder / path.name)


def responded(folder):
    for name in ("swansea", "southampton", "modal"):
        prepare_frequency(load_case(folder / f"{name}.toml"))


def experiment(folder):
    """A run folder, and the plan of others."""
    words = [
        "experiment",
        "beam",
        "--plant",
        "modal",
        "--seconds",
        "1",
        "--period",
        "0.5",
        "--band",
        "5",
        "30",
        "--law",
        "mfdrf",
        "--out",
    ]
    assert main([*words, str(folder / "run")]) == 0
    (folder / "run" / "run.rrd").unlink()
    shutil.copyfile(asset("examples/plan.toml"), folder / "plan.toml")


def planned(folder):
    load_plan(folder / "plan.toml").prepare()
    recording, settings = load_run(folder / "run")
    run_modal_test([recording], ModalTest(n_modes=2))
    settings.prepare()


ANSWER = {
    "verdict": "missing-physics",
    "findings": [
        {
            "effect": "stop",
            "place": "joint:x",
            "class": ["stop", "dead-band"],
            "places_90": ["joint:x"],
            "probability": 0.9,
            "parameters": {"gap": {"value": 0.1, "unit": "m", "ci90": [0.05, 0.2]}},
        }
    ],
    "heldout": {"gap_closed": 0.9, "nrmse_before": 0.5, "nrmse_noise": 0.01},
    "baselines": {"sparse regression": {"named": [{"effect": "stop"}], "nrmse": 0.1}},
    "seconds": 1.0,
}


@functools.cache
def manifest_of(commitments):
    """All sources are read for a manifest: once for all tests."""
    return manifest(json.loads(commitments), baselines=None)


@functools.cache
def concealed():
    """Return the files of a concealed case and its truth, by name."""
    with tempfile.TemporaryDirectory() as folder:
        conceal_cases(Path(folder) / "cases", suites=["null"], count=1, seed=3, benches=["slider"], jobs=1)
        paths = [path for path in Path(folder).rglob("*") if path.is_file()]
        return {path.relative_to(folder): path.read_bytes() for path in paths}


def sealed(folder):
    """A concealed case, answered and not yet counted."""
    for name, content in concealed().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    cases, out = folder / "cases", folder / "out"
    (out / ANSWERS).mkdir(parents=True)
    commitments = read_json(cases / COMMITMENTS)
    write_json(out / MANIFEST, manifest_of(canonical(commitments)))
    for name in commitments["cases"]:
        write_json(out / ANSWERS / f"{name}.json", {"case": name, **ANSWER})


def proved(folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(proving, "manifest", lambda commitments, **settings: manifest_of(canonical(commitments)))
        prove(folder / "cases", folder / "out")


def counted(folder):
    """The same, after the answers have been frozen."""
    sealed(folder)
    proved(folder)


TEXTS = (".toml", ".xml", ".csv", ".json", ".uff")
KINDS = {
    "model": (lambda folder: rig(folder, "csv"), compared, ("rig.xml",)),
    "case": (lambda folder: rig(folder, "csv"), compared, ("case.toml",)),
    **{
        kind: (lambda folder, kind=kind: rig(folder, kind), compared, (f"run.{kind}",))
        for kind in ("csv", "parquet", "uff", "mat", "npz")
    },
    "checked": (lambda folder: rig(folder, "csv"), checked, ("case.toml", "rig.xml", "run.csv")),
    "drafted": (logged, drafted, ("run.csv", "rig.xml")),
    "structure": (structure, structured, ("beam.toml", "laboratory.toml", "law.toml", "case.toml")),
    "frame": (frame, responded, ("swansea.toml", "southampton.toml", "modal.toml", "swansea.csv", "force_floor1.mat")),
    "run": (experiment, planned, ("run/run.toml", "run/manifest.json", "run/recording.parquet", "plan.toml")),
    "answers": (sealed, proved, ("out/*/*.json", "out/*.json", "cases/*.json", "cases-truth/*.json")),
    "counted": (counted, proved, ("out/*.json", "out/*/*.json", "cases/*.json", "cases-truth/*.json")),
}
"""By kind: what writes the files, what uses them, and which are mutated."""
SLOW_KINDS = ("frame", "run", "answers", "counted")


def attempt(folder, use):
    """Return what came of files: "" for something computed, "refused", or the traceback of what must not be."""
    try:
        with Bound(MOST_S), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of numpy: what is not finite is looked at where it is used
            use(folder)
    except VlabError as error:
        return "refused" if str(error) else "nothing is said"
    except (Exception, TooMuchWork):
        return traceback.format_exc()
    return ""


def wrong(tmp, kind, numbers):
    """Mutate the files of a kind, one at a time; return what must not be by number, and how many were used."""
    make, use, patterns = KINDS[kind]
    sound = tmp / "sound"
    sound.mkdir()
    make(sound)
    trial = tmp / "trial"
    shutil.copytree(sound, trial)
    assert attempt(trial, use) == ""
    files = [path for pattern in patterns for path in sorted(sound.glob(pattern))]
    found, used = {}, 0
    for number in numbers:
        rng = np.random.default_rng([list(KINDS).index(kind), number])
        file = files[rng.integers(len(files))]
        here = tmp / "mutated"
        shutil.copytree(sound, here)
        change = mutated_text if file.suffix in TEXTS and rng.random() < 0.7 else mutated_bytes
        (here / file.relative_to(sound)).write_bytes(change(file.read_bytes(), rng))
        said = attempt(here, use)
        used += said == ""
        if said not in ("", "refused"):
            found[number] = f"{file.name}: {said}"
        shutil.rmtree(here)
    return found, used


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_mutated_file_is_used_or_refused(tmp_path, kind):
    found, _ = wrong(tmp_path, kind, range(FEW if kind in SLOW_KINDS else QUICK))
    assert not found, "\n".join(f"{number}: {said}" for number, said in found.items())


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_mutated_files_are_used_or_refused(tmp_path, kind):
    found, used = wrong(tmp_path, kind, range(MANY_OF.get(kind, 1) * MANY))
    assert not found, "\n".join(f"{number}: {said}" for number, said in found.items())
    assert used  # not all that is changed matters
