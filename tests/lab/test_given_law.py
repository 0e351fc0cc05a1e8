"""Laws as objects of Python: the same run as from a law file, and a record in the run folder."""

import numpy as np
import pytest

import vlab
from vlab.controllers import DirectRateFeedback, LinearLaw, ObserverFeedback
from vlab.errors import BadController, BadDesign, BadExperiment
from vlab.lab.given_law import given_law
from vlab.lab.run_folder import load_run

SHORT = {"seconds": 0.2, "progress": False}
CARRIAGE = """<mujoco><worldbody><body name="b"><joint name="slide" type="slide" axis="1 0 0" stiffness="200" damping="4"/>
<geom size="0.05" mass="2"/></body></worldbody><actuator><motor name="motor" joint="slide"/></actuator>
<sensor><jointpos name="enc" joint="slide"/></sensor></mujoco>"""


class Damper:
    """u = -2 y at one coil."""

    sensors = actuators = ("base",)

    def reset(self):
        pass

    def step(self, y):
        return -2.0 * y


@pytest.fixture(scope="module")
def designed():
    return vlab.design("beam", "mfdrf")


def test_a_design_and_its_law_run_as_the_law_file_does(designed, tmp_path):
    file = designed.save(tmp_path / "design") / "controller.toml"
    by_file = vlab.experiment("beam", law=file, **SHORT).recording.data
    for law in (designed, designed.law):
        np.testing.assert_array_equal(vlab.experiment("beam", law=law, **SHORT).recording.data, by_file)


def test_a_function_takes_si_samples_in_the_order_of_the_law_files(designed):
    gains = designed.law.gains
    by_function = vlab.experiment("beam", law=lambda y: -gains @ y, **SHORT).recording.data
    by_design = vlab.experiment("beam", law=designed, **SHORT).recording.data
    np.testing.assert_allclose(by_function, by_design, atol=1e-12)


def test_the_run_folder_of_a_linear_law_runs_again(designed, tmp_path):
    done = vlab.experiment("beam", law=designed, out=tmp_path / "run", **SHORT)
    _, settings = load_run(tmp_path / "run")
    again = settings.inside(tmp_path / "run").prepare()
    np.testing.assert_array_equal(again.law.gains, designed.law.gains)
    assert done.recording.meta["law"] == settings.law == "controller.toml"


def test_the_run_folder_of_any_other_law_holds_its_source_and_runs_nothing(tmp_path):
    vlab.experiment("beam", law=Damper(), out=tmp_path / "run", **SHORT)
    record = (tmp_path / "run" / "law.txt").read_text()
    assert "return -2.0 * y" in record
    assert "sensors [SI]: base" in record
    _, settings = load_run(tmp_path / "run")
    assert settings.law.endswith("Damper")
    with pytest.raises(BadController, match=r"was an object of Python, and law.txt is only its record"):
        settings.inside(tmp_path / "run").prepare()


def test_an_observer_runs_as_the_matrices_that_the_folder_keeps():
    observer = ObserverFeedback([[0.5]], [[1.0]], [[1.0]], K=[[0.1]], M=[[0.2]], sensors=["base"], actuators=["base"])
    assert isinstance(given_law(observer).law, LinearLaw)
    limited = ObserverFeedback(
        [[0.5]], [[1.0]], [[1.0]], K=[[0.1]], M=[[0.2]], sensors=["base"], actuators=["base"], limit=1.0
    )
    assert given_law(limited).law is limited


@pytest.mark.parametrize("law", [Damper, Damper(), DirectRateFeedback([[2.0]], sensors=["base"], actuators=["base"])])
def test_a_class_an_object_and_gains_are_one_law(law):
    reference = vlab.experiment("beam", law=Damper, **SHORT).recording.data
    np.testing.assert_allclose(vlab.experiment("beam", law=law, **SHORT).recording.data, reference, atol=1e-12)


def test_a_function_drives_a_model_of_its_own_from_all_sensors(tmp_path):
    (tmp_path / "carriage.xml").write_text(CARRIAGE)
    done = vlab.experiment(
        tmp_path / "carriage.xml", law=lambda y: -3.0 * y[0], seconds=0.2, out=tmp_path / "run", progress=False
    )
    recording = done.recording
    np.testing.assert_allclose(recording["command:motor"], -3.0 * recording["enc"], atol=1e-12)
    assert (tmp_path / "run" / "law.txt").is_file()


@pytest.mark.parametrize(
    ("law", "error", "match"),
    [
        (3, BadController, "the law is an int; accepted: a name, a law of vlab.design"),
        (lambda y: y[:1], BadController, "gave 1 commands at sample 1; 3 are needed"),
        (lambda y: 1 / 0, BadController, "fails in step"),
        (object(), BadController, "the law is an object"),
    ],
)
def test_what_is_no_law_is_one_line(law, error, match):
    with pytest.raises(error, match=match):
        vlab.experiment("beam", law=law, **SHORT)


def test_a_regulator_and_a_second_design_model_are_refused(designed):
    with pytest.raises(BadDesign, match="take lqg"):
        vlab.experiment("beam", law=vlab.design("beam", "lqr"), **SHORT)
    with pytest.raises(BadExperiment, match="the law is made already"):
        vlab.experiment("beam", law=designed, model="full", **SHORT)
