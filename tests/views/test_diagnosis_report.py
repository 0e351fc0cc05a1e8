"""The report of a diagnosis on a small rig: every file that it writes is read back and run again."""

import dataclasses
import json
import math
import re
import shutil
import tomllib
from itertools import pairwise
from types import SimpleNamespace

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rerun.chunk import RrdReader

from vlab.cases import load_case
from vlab.cases.compare import compare_case
from vlab.cli.diagnose import _errors as printed_errors
from vlab.diagnose import export as amended_model
from vlab.diagnose.advice import OF_ERRORS
from vlab.diagnose.diagnosis import Attempt
from vlab.diagnose.model_kinds.structure_file import structure_toml
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.validation.gap import total
from vlab.diagnose.validation.simulation import ExtendedModel, check, extended
from vlab.errors import BadCase
from vlab.lab import Experiment, run_experiment
from vlab.lab.excitation import Multisine
from vlab.parallel import limited_to
from vlab.physics.attach import Attached, written
from vlab.physics.catalogue import EFFECTS
from vlab.plants.build import build_plant
from vlab.plants.mjcf import build_mjcf
from vlab.recordings import write_recording
from vlab.structure.reader import load_structure
from vlab.views.figures import to_svg
from vlab.views.figures.model_drawing import model_figure, place_position
from vlab.views.figures.restoring_force import restoring_force
from vlab.views.reports import diagnosis as diagnosis_report
from vlab.views.reports.diagnosis_summary import verdict_sentence

RATE, SECONDS = 200.0, 4.0
MASS, STIFFNESS, DAMPING, FRICTION = 1.0, 800.0, 1.5, 0.6
RIG = f"""<mujoco model="one mass">
  <option timestep="0.0025" integrator="RK4" gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody>
    <geom name="wall" type="box" size="0.02 0.1 0.1" pos="-0.3 0 0"/>
    <body name="cart"><joint name="slide" type="slide" axis="1 0 0" stiffness="{STIFFNESS}" damping="{DAMPING}"/>
      <geom type="box" size="0.1 0.05 0.05" mass="{MASS}"/></body>
  </worldbody>
  <tendon><fixed name="cable"><joint joint="slide" coef="1"/></fixed></tendon>
  <actuator><motor name="motor" joint="slide"/></actuator>
  <sensor><jointpos name="gauge" joint="slide"/></sensor>
</mujoco>
"""
HEADINGS = [
    "What was found",
    "Where",
    "Measured, calibrated and extended",
    "The missing force",
    "How far the models are from the recordings",
    "Alternatives",
    "Where the mismatch is",
    "Calibrated parameters",
    "Not excluded",
    "Next measurement",
    "Quality of the recordings",
    "The extended model",
    "The answer without vlab",
    "How long it took",
]


def response(force, friction):
    """Return the displacement of the mass with dry friction: drift, kick, drift in steps ten times as short as the samples."""
    x = v = 0.0
    h, out = 1 / (10 * RATE), []
    for u in force:
        out.append(x)
        for _ in range(10):
            x += 0.5 * h * v
            free = v + h / MASS * (u - STIFFNESS * x - DAMPING * v)
            v = free - np.clip(free, -h * friction / MASS, h * friction / MASS)
            x += 0.5 * h * v
    return np.array(out)


def write_rig(folder, friction):
    folder.mkdir()
    (folder / "rig.xml").write_text(RIG)
    rng = np.random.default_rng(7)
    time = np.arange(round(SECONDS * RATE)) / RATE
    text = ['title = "One mass"', '[model]\nmjcf = "rig.xml"']
    for name, role, level in (("low", "fit", 3.0), ("high", "fit", 6.0), ("other", "holdout", 4.0)):
        lines = np.arange(4, 40) / SECONDS
        force = (
            level * np.sqrt(2 / 36) * np.sin(2 * np.pi * np.outer(time, lines) + rng.uniform(0, 6.3, 36)).sum(axis=1)
        )
        x = response(force, friction)
        x += 0.003 * x.std() * rng.standard_normal(x.size)
        pq.write_table(pa.table({"u": force, "x": x}), folder / f"{name}.parquet")
        text.append(
            f'[[recording]]\nfile = "{name}.parquet"\nname = "{name}"\nrole = "{role}"\nrate_hz = {RATE}\ninitial = "rest"'
        )
        text.append(
            '[[recording.channel]]\ncolumn = "u"\nat = "motor"\nkind = "force"\nunit = "N"\ninput = true\nhold = "zero"'
        )
        text.append('[[recording.channel]]\ncolumn = "x"\nat = "gauge"\nkind = "displacement"\nunit = "m"')
    (folder / "case.toml").write_text("\n".join(text) + "\n")
    return load_case(folder)


@pytest.fixture(scope="module")
def found(tmp_path_factory, quick_layout):
    base = tmp_path_factory.mktemp("found")
    effects = [EFFECTS[name] for name in ("coulomb-friction", "added-mass")]
    done = diagnose(write_rig(base / "case", FRICTION), effects=effects)
    folder = base / "out"
    folder.mkdir()
    diagnosis_report.write_diagnosis(done, folder)
    return done, folder


@pytest.fixture(scope="module")
def nothing(tmp_path_factory, quick_layout):
    base = tmp_path_factory.mktemp("nothing")
    done = diagnose(write_rig(base / "case", 0.0), effects=[EFFECTS["coulomb-friction"]])
    folder = base / "out"
    folder.mkdir()
    diagnosis_report.write_diagnosis(done, folder)
    return done, folder


def heldout(folder):
    """Return the NRMSE of the held-out recordings of a written case."""
    return float(
        np.sqrt(np.mean([v**2 for v in compare_case(folder / "amended.toml", roles=("holdout",)).nrmse.values()]))
    )


def refuse(text):
    raise AssertionError(f"{text} is no number of JSON")


def test_the_document_holds_finite_numbers_only(found):
    done, folder = found
    document = json.loads((folder / "diagnosis.json").read_text(), parse_constant=refuse)
    assert document["verdict"] == done.diagnosis.verdict == "missing-physics"
    assert document["findings"][0]["effect"] == "coulomb-friction"
    assert diagnosis_report.finite({"a": [math.inf, np.float64(2.0), np.int64(3)]}) == {"a": [None, 2.0, 3]}


def test_the_report_says_what_where_and_by_how_much_in_this_order(found):
    done, folder = found
    page = (folder / "report.html").read_text().replace("\N{NO-BREAK SPACE}%", " %")
    assert re.findall(r"<h2>(.*?)</h2>", page) == HEADINGS
    finding = done.diagnosis.findings[0]
    gap = f"{100 * done.diagnosis.heldout['gap_closed']:.0f} %"
    assert (
        page.index(f"The model leaves out coulomb friction at {finding.place}") < page.index(gap) < page.index("<h2>")
    )
    for text in (
        finding.law,
        f"force = {finding.parameters['force']['value']:.4g} N. Below",
        "dotted: noise",
        "[N]",
        "[m/s]",
        "frequency [Hz]",
        "(the same)",
    ):
        assert text.replace("'", "&#39;") in page
    assert page.count("<svg") >= 7


def test_the_printed_errors_say_what_they_are(found):
    done, _ = found
    *rows, note = printed_errors(done.diagnosis).splitlines()
    assert note == f"({OF_ERRORS})"
    assert rows[-1].endswith(f"{100 * done.diagnosis.heldout['gap_closed']:.1f}".removesuffix(".0"))


def test_the_amended_model_runs_by_itself(found, tmp_path):
    done, folder = found
    shutil.copyfile(folder / "amended.xml", tmp_path / "alone.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "alone.xml"))
    assert model.dof_frictionloss[0] == pytest.approx(
        done.fit.terms[0].values["force"], rel=1e-5
    )  # the file has six digits
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 100)
    assert np.all(np.isfinite(data.qpos))


def test_the_written_case_reproduces_the_reported_error(found, nothing):
    # six digits in the file, and an initial state at rest: what differs is round-off of the parameters
    assert heldout(found[1]) == pytest.approx(found[0].diagnosis.heldout["nrmse_after"], rel=0.01)
    assert heldout(nothing[1]) == pytest.approx(nothing[0].diagnosis.heldout["nrmse_before"], rel=0.01)


def test_the_scene_holds_recording_old_and_new_simulation(found):
    entities = {
        piece.entity_path for piece in RrdReader(found[1] / "run.rrd").stream().to_chunks() if not piece.is_static
    }
    # the viewer draws entities by name: the thick black measurement must not lie over the models
    wanted = ("0-measured", "2-calibrated", "3-extended", "left/2-calibrated", "left/3-extended")
    assert {path for path in entities if "/diagnosis/" in path} == {f"/diagnosis/0/0/{name}" for name in wanted}


def test_the_force_found_without_a_law_is_the_hidden_one(found):
    done, _ = found
    free, law = (restoring_force(done, done.fit.terms[0]).curves[1][k] for k in (3, 4))
    v = restoring_force(done, done.fit.terms[0]).curves[1][2]
    fast = np.abs(v) > 0.5 * np.std(v)
    # noise and the smoothing's shrinking leave a fifth; the law itself is within its fit's accuracy
    assert -np.mean(free[fast] * np.sign(v[fast])) == pytest.approx(FRICTION, rel=0.2)
    assert -np.mean(law[fast] * np.sign(v[fast])) == pytest.approx(FRICTION, rel=0.1)


def test_nothing_missing_is_said_and_shown(nothing):
    done, folder = nothing
    page = (folder / "report.html").read_text()
    assert done.diagnosis.verdict == "nothing-missing"
    assert "Nothing is missing" in page
    assert "times the noise" in page
    assert "The missing force" not in page
    assert mujoco.MjModel.from_xml_path(str(folder / "amended.xml")).dof_frictionloss[0] == 0.0


@pytest.mark.parametrize("verdict", ["none-of-these", "bad-recording"])
def test_the_other_verdicts_have_their_own_words(nothing, verdict):
    diagnosis = dataclasses.replace(nothing[0].diagnosis, verdict=verdict, quality=("gauge: clipped",), checked=())
    done = dataclasses.replace(nothing[0], diagnosis=diagnosis)
    sentence = verdict_sentence(done)
    assert ("no effect of the catalogue" in sentence) == (verdict == "none-of-these")
    assert ("damaged" in sentence) == (verdict == "bad-recording")
    assert "gauge: clipped" in [line for section in diagnosis_report.sections(done) for line in section.text]


@pytest.mark.parametrize("effect", ["nothing", "viscous-damping"])
def test_damage_that_an_effect_may_cause_is_said_to_be_searched(nothing, effect):
    # a turned sign may be an effect of a sensor; the page used to say "not searched" above a ranking of the search
    tried = ({"effect": effect, "place": "", "probability": None, "remaining": 5.0, "remaining_share": 1.0},)
    diagnosis = dataclasses.replace(
        nothing[0].diagnosis, verdict="bad-recording", quality=("turned",), checked=(), alternatives=tried
    )
    parts = diagnosis_report.sections(dataclasses.replace(nothing[0], diagnosis=diagnosis))
    lines = [line for section in parts for line in section.text]
    assert ("These recordings were not searched." in lines) == (effect == "nothing")


@pytest.mark.slow
def test_the_best_attempt_is_shown_without_a_probability(found):
    done, _ = found
    own = done.diagnosis
    attempt = Attempt(findings=own.findings, checked=own.checked, fit=done.fit)
    tried = dataclasses.replace(
        own,
        verdict="none-of-these",
        findings=(),
        checked=tuple(c.without_findings() for c in own.checked),
        attempt=attempt,
        alternatives=tuple({**a, "probability": None} for a in own.alternatives),
    )
    parts = diagnosis_report.sections(dataclasses.replace(done, diagnosis=tried))
    (first, *_) = parts
    assert any(
        f"Best attempt, not a finding: coulomb-friction at {own.findings[0].place}" in line for line in first.text
    )
    assert any(row[2] == "force" for _, rows in first.tables for row in rows)
    words = [*(line for part in parts for line in part.text), *(c for part in parts for f in part.figures for c in f)]
    assert not any("robabilit" in line for line in words)
    (errors,) = next(part for part in parts if part.title.startswith("How far")).tables
    assert errors[0][5] == "best attempt"
    assert errors[1][-1][5] == pytest.approx(own.heldout["nrmse_after"])


def test_a_place_is_marked_with_the_probability_of_its_finding(found):
    done, folder = found
    finding = done.diagnosis.findings[0]
    marks = diagnosis_report._marks(done)
    assert marks[0][0] == finding.place
    assert marks[0][1] <= finding.probability
    page = (folder / "report.html").read_text().replace("\N{NO-BREAK SPACE}%", " %")
    assert "4\N{NO-BREAK SPACE}% of every" in (folder / "report.html").read_text()  # no line breaks before the sign
    assert page.count("4 % of every probability is reserved for physics outside the catalogue") == 1


def test_a_model_that_cannot_follow_is_reported_and_not_drawn(nothing):
    lost = dataclasses.replace(
        nothing[0].diagnosis.checked[0], nominal=np.inf, before=np.inf, after=np.inf, simulated=(None, None, None)
    )
    done = dataclasses.replace(nothing[0], diagnosis=dataclasses.replace(nothing[0].diagnosis, checked=(lost,)))
    sections = diagnosis_report.sections(done)
    assert any("can follow this recording" in line for s in sections for line in s.text)
    assert any("cannot follow" in row for s in sections for _, rows in s.tables for row in rows)


def test_places_are_drawn_where_the_model_has_them():
    plant = build_mjcf(RIG.replace('<body name="cart">', '<body name="cart" pos="0.1 0 0.4">'))
    data = plant.new_data()
    for place in ("joint:slide", "body:cart", "tendon:cable", "actuator:motor", "sensor:gauge"):
        at, towards = place_position(plant, data, place, None)
        assert at == pytest.approx([0.1, 0.0, 0.4])
        assert (towards is not None) == place.startswith(("actuator", "sensor"))
    svg = to_svg(model_figure(plant, [("joint:slide", 0.8), ("sensor:gauge", 0.2)]))
    for text in ("joint:slide (80 %)", "sensor:gauge (20 %)", "[m]"):
        assert text in svg


def test_places_of_a_structure_are_its_points():
    beam = load_structure("beam")
    plant = build_plant(beam, "composite", "published")
    for place, point in (("20in", "20in"), ("coil:base", "base"), ("sensor:20in", "20in"), ("actuator:base", "base")):
        x, z = beam.position(point)
        assert place_position(plant, plant.new_data(), place, beam)[0] == pytest.approx([x, 0.0, z])
    for element, ends in (("beam:30in-40in", ("30in", "40in")), ("crosspiece-left", ("tip-left", "20in"))):
        middle = np.mean([beam.position(end) for end in ends], axis=0)
        assert place_position(plant, plant.new_data(), element, beam)[0][[0, 2]] == pytest.approx(middle)
    assert place_position(plant, plant.new_data(), "clamp", beam)[0][[0, 2]] == pytest.approx(beam.position("20in"))
    figure = model_figure(plant, [("20in", 0.9)], structure=beam)
    assert "20in (90 %)" in to_svg(figure)
    (axes,) = figure.axes
    figure.canvas.draw()
    boxes = [label.get_window_extent() for label in axes.get_xticklabels()]  # the beam is narrow and tall
    assert all(one.x1 < other.x0 for one, other in pairwise(boxes))


@pytest.mark.parametrize("name", ["beam", "grid"])
def test_a_structure_file_reads_back_to_the_same_structure(name, tmp_path):
    structure = load_structure(name)
    (tmp_path / "s.toml").write_text(structure_toml(structure))
    assert load_structure(tmp_path / "s.toml") == structure


def test_toml_reads_back_to_what_was_written():
    table = {
        "title": 'quote " backslash \\ tab\t',
        "model": {
            "uncertain": {"geom:arm:mass": 0.02},
            "effect": [{"name": "a", "parameters": {"x": 1e-300}}, {"name": "b"}],
        },
        "recording": [{"rate_hz": 1000, "input": True, "channel": [{"gains": [[1.5, -2.0]]}, {"unit": ""}]}],
    }
    assert tomllib.loads(amended_model.toml_text(table)) == table


def test_an_effect_written_as_a_spring_takes_nothing_from_the_defaults():
    defaults = '<default><tendon stiffness="7" damping="3" frictionloss="2" armature="1"/></default>'
    plant = build_mjcf(RIG.replace("<worldbody>", defaults + "<worldbody>", 1))
    slip = Attached(effect=EFFECTS["jenkins-slip"], place="joint:slide", values={"force": 1.0, "slip": 0.01})
    spec, left = written(plant, [slip])
    model = mujoco.MjModel.from_xml_string(spec.to_xml())
    i = model.tendon(f"{slip.label}:1").id
    assert not left
    assert model.tendon_stiffness[i] == pytest.approx(100.0)
    assert model.tendon_damping[i] == model.tendon_frictionloss[i] == model.tendon_armature[i] == 0.0


def test_a_case_states_effects_of_the_catalogue_only(tmp_path):
    write_rig(tmp_path / "case", 0.0)
    path = tmp_path / "case" / "case.toml"
    given = path.read_text()
    effect = (
        '[[model.effect]]\nname = "actuator-delay"\nplace = "actuator:motor"\n[model.effect.parameters]\ndelay = 0.01\n'
    )
    path.write_text(given.replace("[[recording]]", effect + "[[recording]]", 1))
    assert len(load_case(path).plant.physics) == 1
    for wrong in ("actuator-delai", "mine.py:Effect", "coulomb-friction"):
        path.write_text(given.replace("[[recording]]", effect.replace("actuator-delay", wrong) + "[[recording]]", 1))
        with pytest.raises(BadCase, match=r"model\.effect\[0\]"):
            load_case(path)


@pytest.mark.slow
def test_an_amended_structure_reproduces_its_error_from_its_files(tmp_path):
    """Parameters and a friction put in by hand: the files must bring all of them back, whatever the fit is worth."""
    case_folder, out = tmp_path / "case", tmp_path / "out"
    case_folder.mkdir()
    out.mkdir()
    text = 'title = "Beam"\n[model]\nstructure = "beam"\n'
    for name, role, seed in (("a", "fit", 1), ("b", "holdout", 2)):
        experiment = Experiment(
            plant=build_plant(load_structure("beam")),
            seconds=1.0,
            excitation=Multisine(level=0.3),
            excite="base",
            seed=seed,
        )
        write_recording(run_experiment(experiment).recording, case_folder / f"{name}.parquet")
        text += f'[[recording]]\nfile = "{name}.parquet"\nrole = "{role}"\ntime = "time"\n[[recording.channel]]\n'
        text += 'column = "excitation:base"\nat = "base"\nkind = "excitation"\nunit = "N"\ninput = true\n'
        text += '[[recording.channel]]\ncolumn = "sensor:20in"\nat = "20in"\nkind = "velocity"\nunit = "m/s"\n'
    (case_folder / "case.toml").write_text(text)
    case = load_case(case_folder)
    problem = prepare(case)
    place = next(p for p in problem.places if "20in" in (p.name, *p.aliases))
    term = Term(effect=EFFECTS["coulomb-friction"], place=place, values={"force": 0.04})
    theta = np.array([0.5 * (-1) ** i * p.sd for i, p in enumerate(problem.parameters)])
    fit = Fit(
        terms=(term,), theta=theta, offsets=np.array([1e-4]), starts={}, error=np.zeros((1, 1)), chi2=0.0, cost=0.0
    )
    before, after = extended(problem, dataclasses.replace(fit, terms=())), extended(problem, fit)
    checked = check(case.runs(("holdout",)), before, after, nominal=ExtendedModel(plant=case.plant))
    done = SimpleNamespace(
        problem=problem,
        diagnosis=SimpleNamespace(findings=(1,), checked=checked, heldout={"nrmse_after": total(checked, "after")}),
        fit=fit,
        before=before,
        after=after,
        choice=SimpleNamespace(best=SimpleNamespace(terms=(term,))),
    )
    files = amended_model.write_extended_model(done, out)
    assert abs(total(checked, "after") / total(checked, "before") - 1.0) > 0.01  # the friction counts
    assert files.nrmse == pytest.approx(files.reported, rel=1e-6)


def test_sections_drawn_side_by_side_are_those_of_one_process(found):
    with limited_to(1):
        alone = diagnosis_report.sections(found[0])
    assert diagnosis_report.sections(found[0]) == alone
