"""When inputs act: conventions of files that a case does not state, found from recordings that scipy integrated."""

import mujoco
import numpy as np
import pytest
from rig_folder import Channel, Record, multisine, write_case
from scipy import signal

from vlab.cases import load_case
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.search.model_class import choose_model_class

RATE, SECONDS, NOISE = 500.0, 8.0, 0.003
MASS, STIFFNESS, DAMPING = 1.02, 2510.0, 1.1
"""True; the model has 1 kg, 2500 N/m, 1 N s/m: 8 Hz, one per cent of critical damping."""

MODEL = """<mujoco model="mass">
  <option timestep="0.0005" gravity="0 0 0"/>
  <worldbody><body name="mass"><joint name="x" type="slide" axis="1 0 0" stiffness="2500" damping="1"/>
    <geom type="box" size=".05 .05 .05" mass="1"/><site name="s"/></body></worldbody>
  <actuator><motor name="motor" joint="x"/></actuator>
  <sensor><jointpos name="gauge" joint="x"/><jointvel name="v" joint="x"/><accelerometer name="acc" site="s"/></sensor>
</mujoco>"""


def stepped(every, sensors=("gauge", "v")):
    """Rows as a loop writes them that sets a control and steps MuJoCo, `every` steps a row."""

    def rows(truth, kind, level, rng):
        model = mujoco.MjModel.from_xml_string(
            MODEL.replace('stiffness="2500" damping="1"', f'stiffness="{STIFFNESS}" damping="{DAMPING}"')
        )
        model.opt.timestep = 1.0 / RATE / every
        model.body_mass[1] = MASS
        data, time = mujoco.MjData(model), np.arange(0.0, SECONDS, 1.0 / RATE)
        u, y = multisine(rng, 0.5, 60.0, SECONDS, level)(time), np.zeros((len(time), 2))
        for k in range(len(time)):
            data.ctrl[0] = u[k]
            mujoco.mj_forward(model, data)
            y[k] = [data.sensor(name).data[0] for name in sensors]
            mujoco.mj_step(model, data, every)
        y += NOISE * y.std(axis=0) * rng.standard_normal(y.shape)
        return {"u": u, "y": y[:, 0], "v": y[:, 1]}

    return rows


def recorded(truth, kind, level, rng):
    """Rows of a file whose inputs act as `truth` says."""
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    u = multisine(rng, 0.5, 60.0, SECONDS, level)(time)
    system = ([[0.0, 1.0], [-STIFFNESS / MASS, -DAMPING / MASS]], [[0.0], [1.0 / MASS]], np.eye(2), [[0.0], [0.0]])
    _, y, _ = signal.lsim(system, u, time, interp=truth == "linear")
    now = {"linear": u, "zero-first": u}.get(truth, np.append(0.0, u[:-1]))
    acc = (now - STIFFNESS * y[:, 0] - DAMPING * y[:, 1]) / MASS
    out = y[:, 0] if kind == "displacement" else acc
    out = out + NOISE * out.std() * rng.standard_normal(len(out))
    return {"u": np.append(0.0, u[:-1]) if truth == "past" else u, "y": out}


def case(folder, truth, *, kind="displacement", given="force", hold="", rows=recorded, model=MODEL, velocity=False):
    rng = np.random.default_rng(4)
    at, unit = {"displacement": ("gauge", "m"), "acceleration": ("acc.x", "m/s^2")}[kind]
    records = [
        Record(name=f"run {i}", role=role, columns=rows(truth, kind, level, rng), rate_hz=RATE)
        for i, (level, role) in enumerate([(1.0, "fit"), (2.0, "fit"), (1.5, "holdout")])
    ]
    write_case(
        folder,
        title="Mass",
        mjcf=model,
        uncertain={"mass": 0.03},
        channels=[
            Channel(column="u", at="motor", kind=given, unit="N", is_input=True, hold=hold),
            Channel(column="y", at=at, kind=kind, unit=unit),
            *([Channel(column="v", at="v", kind="velocity", unit="m/s")] if velocity else []),
        ],
        records=records,
    )
    if not hold:
        path = folder / "case.toml"
        path.write_text(path.read_text().replace('hold = ""\n', ""))
    return load_case(folder)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "kind", "given", "found"),
    [
        ("linear", "displacement", "force", ""),
        ("zero", "displacement", "force", "zero"),
        ("past", "displacement", "force", "past"),
        ("linear", "acceleration", "force", ""),
        ("zero", "acceleration", "force", "zero"),
        ("zero-first", "acceleration", "force", "zero-first"),
        ("past", "acceleration", "force", "past"),
        ("linear", "displacement", "command", "linear"),
        ("zero", "displacement", "command", ""),
        ("zero", "acceleration", "command", ""),
        ("zero-first", "acceleration", "command", "zero-first"),
    ],
)
def test_recordings_tell_when_their_inputs_act(tmp_path, truth, kind, given, found):
    problem = choose_model_class(case(tmp_path, truth, kind=kind, given=given)).problem
    channel = problem.case.table.recording[0].channel[0]
    assert channel.hold == found
    assert bool(problem.timing) == bool(found)
    assert not found or f'"{found}"' in problem.notes[0]


@pytest.mark.slow
def test_what_a_case_states_is_kept(tmp_path):
    problem = choose_model_class(case(tmp_path, "past", hold="linear")).problem
    assert problem.case.table.recording[0].channel[0].hold == "linear"
    assert not problem.timing


@pytest.mark.slow
@pytest.mark.parametrize("samples", [0.5, 2.0])
def test_a_delay_is_no_convention_unless_it_is_half_a_sample(tmp_path, samples):
    def late(truth, kind, level, rng):
        time = np.arange(0.0, SECONDS, 1.0 / RATE)
        rows = recorded(truth, kind, level, rng)
        rows["y"] = np.interp(time - samples / RATE, time, rows["y"])
        return rows

    problem = choose_model_class(case(tmp_path, "linear", rows=late)).problem
    assert problem.case.table.recording[0].channel[0].hold == ("zero" if samples == 0.5 else "")


@pytest.mark.slow
@pytest.mark.parametrize(("truth", "kind"), [("past", "displacement"), ("zero-first", "acceleration")])
def test_another_convention_is_no_missing_physics(tmp_path, truth, kind):
    done = diagnose(case(tmp_path, truth, kind=kind)).diagnosis
    assert done.verdict == "nothing-missing"
    assert any(f'hold = "{truth}"' in note for note in done.notes)
    errors = done.heldout
    assert errors["nrmse_before"] < 1.3 * errors["nrmse_noise"]


@pytest.mark.slow
@pytest.mark.parametrize("given", ["force", "command"])
@pytest.mark.parametrize("every", [1, 2])
def test_steps_of_a_simulation_leave_positions_ahead(tmp_path, every, given):
    step = 1.0 / RATE / every
    model = MODEL.replace('timestep="0.0005"', f'timestep="{step}"')
    problem = choose_model_class(
        case(tmp_path, "", given=given, rows=stepped(every), model=model, velocity=True)
    ).problem
    _, position, velocity = problem.case.table.recording[0].channel
    assert position.delay_s == pytest.approx(-0.5 * step, rel=0.05)
    assert velocity.delay_s == 0.0
    assert "ms ahead" in problem.notes[0]


@pytest.mark.slow
def test_a_model_stepped_as_it_is_lacks_nothing(tmp_path):
    model = MODEL.replace('timestep="0.0005"', 'timestep="0.002"')
    done = diagnose(case(tmp_path, "", rows=stepped(1), model=model, velocity=True)).diagnosis
    assert done.verdict == "nothing-missing"
    assert "stand 1.0" in done.notes[0]
    assert '"zero"' in done.notes[0]
    # excited up to 60 Hz the steps are an eighth of a cycle: of the 12 % that the skew makes there, 2.5 % are left of it
    assert done.heldout["nrmse_before"] < 1.6 * done.heldout["nrmse_noise"]


ARM = """<mujoco><option timestep="{step}" integrator="{integrator}"/><worldbody><body name="arm">
  <joint name="pivot" type="hinge" axis="0 1 0" damping="{damping}" frictionloss="{friction}"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass="{mass}"/></body></worldbody>
  <actuator><motor name="motor" joint="pivot"/></actuator>
  <sensor><jointpos name="angle" joint="pivot"/></sensor></mujoco>"""


def arm(folder, step, every, *, integrator="Euler", hold="", friction=0.0, highest=6.0):
    """A case of an arm that swings far, in rows of `every` steps of MuJoCo in which its torque stands still."""
    true = ARM.format(step=step, integrator=integrator, damping=0.022, mass=0.507, friction=friction)
    rng, records, rate = np.random.default_rng(6), [], 1.0 / (step * every)
    for i, (level, role) in enumerate([(0.6, "fit"), (0.9, "fit"), (0.75, "holdout")]):
        model = mujoco.MjModel.from_xml_string(true)
        data, time = mujoco.MjData(model), np.arange(0.0, 8.0, 1.0 / rate)
        u, y = multisine(rng, 0.3, highest, 8.0, level)(time), np.zeros(len(time))
        for k in range(len(time)):
            data.ctrl[0], y[k] = u[k], data.qpos[0]
            mujoco.mj_step(model, data, every)
        assert np.abs(y).max() > 0.4
        y += 0.002 * y.std() * rng.standard_normal(len(y))
        records.append(Record(name=f"run {i}", role=role, columns={"u": u, "y": y}, rate_hz=rate))
    write_case(
        folder,
        title="Arm",
        mjcf=ARM.format(step=step, integrator=integrator, damping=0.02, mass=0.5, friction=0.0),
        uncertain={"mass": 0.02},
        channels=[
            Channel(column="u", at="motor", kind="moment", unit="N m", is_input=True, hold=hold),
            Channel(column="y", at="angle", kind="angle", unit="rad"),
        ],
        records=records,
    )
    return load_case(folder)


@pytest.mark.slow
def test_steps_leave_positions_ahead_far_from_rest_too(tmp_path):
    model_class = choose_model_class(arm(tmp_path, 0.004, 1, hold="zero"))
    problem = model_class.problem
    assert not model_class.is_linear
    assert "ms ahead" in problem.timing
    # about a motion that is itself found from the skewed readings a fifth of it may be lost
    assert problem.case.table.recording[0].channel[1].delay_s == pytest.approx(-0.5 * 0.004, rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.06])
def test_inputs_stand_far_from_rest_too(tmp_path, friction):
    model_class = choose_model_class(arm(tmp_path, 0.0005, 20, integrator="RK4", friction=friction))
    assert not model_class.is_linear
    assert model_class.problem.case.table.recording[0].channel[0].hold == "zero"


@pytest.mark.slow
def test_a_refit_to_whole_recordings_tells_when_slow_inputs_act(tmp_path):
    """Up to 1.2 Hz the filter takes half of 5 ms for a force that it does not know."""
    model_class = choose_model_class(arm(tmp_path, 0.0005, 10, integrator="RK4", highest=1.2))
    assert not model_class.is_linear
    assert model_class.problem.case.table.recording[0].channel[0].hold == "zero"
