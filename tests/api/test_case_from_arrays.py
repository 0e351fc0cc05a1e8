"""Cases from arrays: names, kinds and units of the model, roles, and what is refused."""

import mujoco
import numpy as np
import pytest
from carriage import MODEL, SAMPLES, STEP, run

import vlab
from vlab.cases.compare import compare_case
from vlab.errors import BadCase, BadRecording, UnknownName, VlabError

T, FORCE, POSITION = run(1)
ARM = """<mujoco><option timestep="0.002"/><worldbody><body name="arm">
<joint name="elbow" type="hinge" axis="0 1 0" damping="0.1"/><geom name="rod" type="capsule" size=".01" fromto="0 0 0 0 0 -.3" mass=".5"/>
<site name="tip" pos="0 0 -.3"/></body></worldbody>
<actuator><motor name="elbow" joint="elbow"/><position name="servo" joint="elbow" kp="3"/></actuator>
<sensor><jointpos name="elbow" joint="elbow"/><accelerometer name="acc" site="tip"/></sensor></mujoco>"""


def case(t=T, inputs=None, outputs=None, model=MODEL, **more):
    inputs = {"motor": FORCE} if inputs is None else inputs
    return vlab.Case.from_arrays(model, t, inputs, {"encoder": POSITION} if outputs is None else outputs, **more)


def channels(given, run=0):
    return [(c.at, c.kind, c.unit, c.input) for c in given.table.recording[run].channel]


def test_kinds_and_units_are_those_of_the_model():
    assert channels(case(outputs={"encoder": POSITION, "tacho": 0 * T})) == [
        ("motor", "force", "N", True),
        ("encoder", "displacement", "m", False),
        ("tacho", "velocity", "m/s", False),
    ]


def test_joints_need_no_sensor_and_vectors_are_split():
    given = vlab.Case.from_arrays(ARM, T, {"servo": FORCE}, {"joint:elbow": POSITION, "acc": np.ones((SAMPLES, 3))})
    assert channels(given) == [
        ("servo", "command", "", True),
        ("joint:elbow", "angle", "rad", False),
        *((f"acc.{axis}", "acceleration", "m/s^2", False) for axis in "xyz"),
    ]
    assert given.runs()[0].compared[0].port == "joint:elbow"


def test_an_actuator_and_a_sensor_may_have_one_name():
    given = vlab.Case.from_arrays(ARM, T, {"elbow": FORCE}, {"elbow": POSITION})
    assert [c.column for c in given.table.recording[0].channel] == ["input:elbow", "output:elbow"]
    assert channels(given)[0][1:3] == ("moment", "N m")


def test_columns_take_the_keys_of_a_case_file():
    more = {"pos_mm": {"at": "encoder", "unit": "mm", "noise": 0.002}}
    given = case(outputs={"pos_mm": 1e3 * POSITION}, channels=more)
    run = given.runs()[0]
    np.testing.assert_allclose(run.outputs.data[:, 0], POSITION[: len(run.measured)], rtol=1e-12)
    assert run.compared[0].noise == pytest.approx(2e-6)


@pytest.mark.parametrize(
    "model",
    [
        lambda folder: MODEL,
        lambda folder: mujoco.MjSpec.from_string(MODEL),
        lambda folder: mujoco.MjModel.from_xml_string(MODEL),
        lambda folder: str(folder / "carriage.xml"),
        lambda folder: folder / "carriage.xml",
    ],
    ids=["text", "spec", "model", "name", "path"],
)
def test_every_form_of_a_model_gives_the_same_comparison(tmp_path, model):
    (tmp_path / "carriage.xml").write_text(MODEL)
    found = compare_case(case(model=model(tmp_path)))
    reference = compare_case(case())
    assert found.runs[0].misfits[0].nrmse == pytest.approx(reference.runs[0].misfits[0].nrmse, rel=1e-9)


def test_a_case_file_of_the_same_data_gives_the_same_comparison(tmp_path):
    (tmp_path / "carriage.xml").write_text(MODEL)
    table = np.column_stack([T, FORCE, POSITION])
    np.savetxt(tmp_path / "run.csv", table, "%.17g", ",", header="t,u,x", comments="")
    channel = '[[recording.channel]]\ncolumn = "{}"\nat = "{}"\nkind = "{}"\nunit = "{}"\n'
    (tmp_path / "case.toml").write_text(
        '[model]\nmjcf = "carriage.xml"\n[[recording]]\nfile = "run.csv"\ntime = "t"\nrole = "fit"\n'
        + channel.format("u", "motor", "force", "N")
        + "input = true\n"
        + channel.format("x", "encoder", "displacement", "m")
    )
    (from_file,) = compare_case(vlab.Case.load(tmp_path)).runs
    (from_arrays,) = compare_case(case(holdout=())).runs
    assert from_arrays.misfits[0].nrmse == pytest.approx(from_file.misfits[0].nrmse, rel=1e-9)


def test_a_model_that_was_changed_after_loading_keeps_the_change():
    model = mujoco.MjModel.from_xml_string(MODEL)
    model.dof_damping[0] = 2.123456789
    assert case(model=model).plant.model.dof_damping[0] == 2.123456789


def test_a_model_without_a_known_source_is_refused():
    model = mujoco.MjModel.from_xml_string(MODEL)
    mujoco.MjModel.from_xml_string(ARM)
    with pytest.raises(BadCase, match=r"source of the MjModel is not known.*give what the model was compiled from"):
        case(model=model)


def test_the_last_third_of_a_single_run_and_the_last_of_several_are_held_out():
    assert [(r.role, len(r.measured)) for r in case().runs()] == [("fit", 2667), ("holdout", 1333)]
    several = case(inputs=[{"motor": FORCE}] * 3, outputs=[{"encoder": POSITION}] * 3)
    assert [r.role for r in several.table.recording] == ["fit", "fit", "holdout"]
    chosen = case(inputs=[{"motor": FORCE}] * 3, outputs=[{"encoder": POSITION}] * 3, holdout=[0])
    assert [r.role for r in chosen.table.recording] == ["holdout", "fit", "fit"]


def test_parts_of_a_run_share_no_sample():
    fit, held = case(holdout=0.25).runs()
    assert fit.measured.time[-1] < held.measured.time[0]
    assert len(fit.measured) + len(held.measured) == SAMPLES
    np.testing.assert_array_equal(held.before.time, fit.measured.time)


def test_lost_readings_are_not_compared():
    position = POSITION.copy()
    position[100:150] = np.nan
    assert not case(outputs={"encoder": position}).runs()[0].outputs.is_read("encoder")[100:150].any()


def test_a_structure_takes_its_places():
    base = np.zeros(200)
    given = vlab.Case.from_arrays("beam", 5e-4 * np.arange(200), {"base": base}, {"20in": base}, holdout=())
    assert channels(given) == [("base", "force", "N", True), ("20in", "velocity", "m/s", False)]


def test_a_case_is_shown_in_one_line():
    assert repr(case(title="Carriage")) == "<Case 'Carriage' of model.xml: run1 (fit), run1 held out (holdout)>"
    assert repr(case().runs()[0].measured).startswith("<Recording: 2667 samples, 2.666 s, motor [N], encoder [m]>")


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({"outputs": {"encodr": POSITION}}, UnknownName, "did you mean 'encoder'"),
        ({"inputs": {"moter": FORCE}}, UnknownName, "did you mean 'motor'"),
        ({"outputs": {"encoder": POSITION[:-1]}}, BadCase, "3999 samples, t has 4000"),
        ({"outputs": {}}, BadCase, "no outputs"),
        ({"outputs": {"encoder": ["a"] * SAMPLES}}, BadCase, "not numeric"),
        ({"inputs": {"motor": np.full(SAMPLES, np.nan)}}, BadRecording, "motor"),
        ({"t": T[::-1]}, BadRecording, "do not increase"),
        ({"t": None}, BadCase, "give t in s"),
        ({"t": "clock"}, UnknownName, "clock"),
        ({"holdout": 1.5}, BadCase, "share of every run"),
        ({"holdout": [3]}, BadCase, "numbers of runs from 0 to 0"),
        ({"holdout": [0]}, BadCase, "the only run is held out"),
        ({"inputs": [{"motor": FORCE}]}, BadCase, "give both as lists"),
        ({"channels": {"encoder": {"unt": "mm"}}}, BadCase, "did you mean 'unit'"),
        ({"channels": {"encodr": {"unit": "mm"}}}, UnknownName, "did you mean 'encoder'"),
        ({"channels": {"encoder": {"unit": "N"}}}, BadCase, "'force', not 'displacement'"),
        ({"uncertain": {"stifness": 0.1}}, BadCase, "did you mean 'stiffness'"),
        ({"model": 3}, BadCase, "the model is an int"),
        ({"model": "none.xml"}, VlabError, "no such model file"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(change, error, match):
    with pytest.raises(error, match=match) as caught:
        case(**change)
    assert "\n" not in str(caught.value)


def test_data_frames_are_read_and_written():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"t": T, "motor": FORCE, "encoder": POSITION})
    reference = case().runs()[0].measured
    for t, frames in (
        ("t", (frame[["t", "motor"]], frame[["encoder"]])),
        (frame["t"], (frame[["motor"]], frame[["encoder"]])),
        (None, (frame.set_index("t")[["motor"]], frame.set_index("t")[["encoder"]])),
    ):
        found = vlab.Case.from_arrays(MODEL, t, *frames).runs()[0].measured
        np.testing.assert_array_equal(found.data, reference.data)
    stamps = pandas.to_datetime("2026-01-01") + pandas.to_timedelta(T, unit="s")
    dated = frame.set_index(stamps)
    found = vlab.Case.from_arrays(MODEL, None, dated[["motor"]], dated[["encoder"]]).runs()[0].measured
    np.testing.assert_allclose(np.diff(found.time), STEP, rtol=1e-6)
    back = reference.to_pandas()
    assert list(back.columns) == ["motor", "encoder"]
    np.testing.assert_array_equal(back["encoder"], reference["encoder"])
