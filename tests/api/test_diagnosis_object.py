"""Diagnosis from Python: one small diagnosis, and everything that its result gives."""

import json
import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from carriage import FRICTION, MODEL, run
from matplotlib.figure import Figure

import vlab
from vlab.api.diagnosis import candidate_effects
from vlab.errors import BadExperiment, OutputRefused, UnknownName
from vlab.physics.catalogue import CANDIDATES
from vlab.physics.port_linear import ViscousDamping
from vlab.views.reports.diagnosis_summary import title_of


def carriage(**more):
    runs = [run(seed) for seed in (1, 2)]
    inputs, outputs = [{"motor": u} for _, u, _ in runs], [{"encoder": x} for _, _, x in runs]
    hold = {"motor": {"hold": "zero"}}
    return vlab.Case.from_arrays(MODEL, runs[0][0], inputs, outputs, title="Carriage", channels=hold, **more)


@pytest.fixture(scope="module")
def result():
    steps = []
    found = vlab.diagnose(carriage(), families=["friction"], jobs=1, progress=lambda share, what: steps.append(share))
    assert steps[0] == 0.0
    assert steps[-1] == 1.0
    return found


@pytest.fixture(scope="module")
def rejected():
    """Millimetres that the case takes for metres."""
    runs = [run(seed, friction=0.0) for seed in (1, 2)]
    outputs = [{"encoder": 1e3 * x} for _, _, x in runs]
    case = vlab.Case.from_arrays(MODEL, runs[0][0], [{"motor": u} for _, u, _ in runs], outputs)
    return vlab.diagnose(case, progress=False)


def test_the_missing_friction_is_found(result):
    assert result.verdict == "missing-physics"
    (finding,) = result.findings
    assert (finding.effect, finding.form, finding.place) == ("coulomb-friction", "coulomb-friction", "joint:slide")
    assert finding.parameters["force"]["value"] == pytest.approx(FRICTION, rel=0.02)


def test_the_extended_model_is_a_mujoco_model(result):
    model = result.model()
    assert isinstance(model, mujoco.MjModel)
    assert model.dof_frictionloss[0] == pytest.approx(FRICTION, rel=0.02)


def test_the_result_is_short_on_the_screen(result):
    head, finding = repr(result).splitlines()
    assert head.startswith("<Diagnosis of 'Carriage': missing-physics, ")
    assert re.match(r"  coulomb-friction at joint:slide \(probability [01]\.\d\d\): \w+ = ", finding)
    assert len(repr(result.done)) < 200


def test_a_notebook_shows_a_table_and_no_markup_of_the_title(result):
    shown = result._repr_html_()
    assert "<td>joint:slide</td>" in shown
    assert "<script" not in shown


@pytest.mark.slow
def test_the_dictionary_is_the_file(result, tmp_path):
    folder = result.save(tmp_path / "out")
    written = json.loads((folder / "diagnosis.json").read_text())
    del written["amended"], written["mujoco"]  # both describe the other files
    on_files = written["notes"][len(result.to_dict()["notes"]) :]
    assert on_files == ["The answer for MuJoCo alone is not written: the model was given without a file"]
    written["notes"] = written["notes"][: -len(on_files)]
    assert written == result.to_dict()
    assert {"report.html", "run.rrd", "amended.xml", "amended.toml", "manifest.json"} <= {
        path.name for path in folder.iterdir()
    }
    again = vlab.load_case(folder / "amended.toml")
    before, after = carriage().runs()[0].measured, again.runs()[0].measured
    np.testing.assert_array_equal(before.data, after.data)
    with pytest.raises(OutputRefused):
        result.save(folder)


@pytest.mark.slow
def test_figures_and_report(result, tmp_path):
    assert isinstance(result.plot(), Figure)
    assert isinstance(result.plot("force"), Figure)
    with pytest.raises(UnknownName, match="overlay"):
        result.plot("overly")
    page = result.report(tmp_path / "report.html")
    assert "Carriage" in page.read_text(encoding="utf-8")
    with pytest.raises(OutputRefused, match=r"\.html"):
        result.report(tmp_path / "report")


@pytest.mark.slow
def test_a_rejected_case_says_why(rejected, tmp_path):
    assert rejected.verdict == "bad-recording"
    assert rejected.findings == ()
    assert rejected.done.diagnosis.quality
    assert rejected._repr_html_()
    for part in (rejected.model, rejected.plot):
        with pytest.raises(BadExperiment, match="the case was rejected"):
            part()
    assert rejected.report(tmp_path / "why.html").is_file()


def test_documents_keep_the_schema(result, rejected):
    jsonschema = pytest.importorskip("jsonschema")
    schema = vlab.diagnosis_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    check = jsonschema.Draft202012Validator(schema)
    for document in (result.to_dict(), rejected.to_dict()):
        assert not [error.message for error in check.iter_errors(document)]
        assert set(schema["required"]) == set(document)
    damaged = {**result.to_dict(), "verdict": "maybe"}
    assert list(check.iter_errors(damaged))


class OwnDamper(ViscousDamping):
    name = "own-damper"


def test_own_effects_stand_beside_the_catalogue():
    assert [e.name for e in candidate_effects([OwnDamper()])] == [*(e.name for e in CANDIDATES), "own-damper"]
    assert [e.name for e in candidate_effects([OwnDamper()], [])] == ["own-damper"]
    assert {e.family for e in candidate_effects((), ["friction"])} == {"friction"}
    assert vlab.effects("friction") == candidate_effects((), ["friction"])
    assert [e.name for e in candidate_effects(["dead-band"], [])] == ["dead-band"]
    with pytest.raises(UnknownName, match="did you mean 'friction'"):
        candidate_effects((), ["frictions"])
    with pytest.raises(BadExperiment, match="another effect named 'own-damper'"):
        candidate_effects([OwnDamper(), OwnDamper()])
    with pytest.raises(BadExperiment, match="no effect is left"):
        candidate_effects((), [])


@pytest.mark.parametrize("settings", [{"jobs": 0}, {"time_limit": -1.0}])
def test_impossible_settings_are_refused_before_the_case_is_read(settings):
    with pytest.raises(BadExperiment):
        vlab.diagnose("no-such-case", **settings)


def test_a_bad_recording_says_why(result):
    bad = replace(result.done.diagnosis, verdict="bad-recording", findings=(), quality=("run1: gap <1>", "second"))
    shown = vlab.Diagnosis(result.case, replace(result.done, diagnosis=bad))
    assert repr(shown).splitlines() == [f"<Diagnosis of {bad.title!r}: bad-recording>", "  run1: gap <1>"]
    assert "The recordings are damaged, so the model was not judged. run1: gap &lt;1&gt;." in shown._repr_html_()


@pytest.mark.slow
def test_a_page_alone_names_no_file_that_is_not_beside_it(result, tmp_path):
    page = result.report(tmp_path / "page.html").read_text(encoding="utf-8")
    assert "amended.toml" not in page
    assert "Next, in this folder" not in page
    folder = result.save(tmp_path / "folder")
    assert "vlab compare amended.toml" in (folder / "report.html").read_text(encoding="utf-8")


def test_a_diagnosis_without_a_title_is_headed_by_its_model(result):
    t, force, position = run(1)
    untitled = vlab.Case.from_arrays(MODEL, t, {"motor": force}, {"encoder": position})
    assert title_of("", untitled) == "Diagnosis: model.xml"
    assert title_of("Carriage", untitled) == "Diagnosis: Carriage"
    assert repr(untitled).startswith("<Case of model.xml: ")
