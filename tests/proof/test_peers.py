"""Other methods on small cases whose missing physics is known."""

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.optimize import OptimizeResult, least_squares

import vlab
from vlab.cases.initial_state import find_initial_state
from vlab.cases.simulate import simulate
from vlab.diagnose.parameters.terms import Fit
from vlab.errors import VlabError
from vlab.proof.judge import judge
from vlab.proof.peers import mujoco_sysid, registry, sparse_regression
from vlab.proof.peers.bic import bic_over_catalogue, criterion
from vlab.proof.peers.freed_numbers import freed_numbers, with_numbers
from vlab.proof.peers.friction_models import MODELS, fit_friction_models
from vlab.proof.peers.friction_run import FRICTION, NO_FRICTION, prepared, run_with_friction
from vlab.proof.peers.measured_states import States, joint_channels, states_of
from vlab.proof.peers.mujoco_sysid import fit_all_numbers
from vlab.proof.peers.result import MOST_ERROR, Named, NotUsable, PeerResult, compared_names, error_of, mjcf_runs
from vlab.proof.peers.scoring import peer_rows, peer_table
from vlab.proof.peers.sparse_columns import Columns, Library, free_runs

RIG = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0" integrator="RK4"><flag contact="disable"/></option>
  <worldbody><body name="cart">
    <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
    <joint name="cart" type="slide" axis="1 0 0" stiffness="400" damping="0.8"/>
  </body></worldbody>
  <actuator><motor name="motor" joint="cart"/></actuator>
  <sensor><jointpos name="encoder" joint="cart"/></sensor>
</mujoco>"""
ARM = """
<mujoco>
  <compiler autolimits="true"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody><body name="upper">
    <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.002 0.002 0.002"/>
    <joint name="shoulder" axis="0 1 0" damping="0.2" armature="0.01"/>
    <body name="lower" pos="0.2 0 0">
      <inertial pos="0.08 0 0" mass="0.3" diaginertia="0.001 0.001 0.001"/>
      <joint name="elbow" axis="0 1 0" damping="0.1" armature="0.008"/>
    </body>
  </body></worldbody>
  <actuator>
    <position name="shoulder_servo" joint="shoulder" kp="40" kv="1.5" forcerange="-8 8"/>
    <position name="elbow_servo" joint="elbow" kp="25" kv="0.8" forcerange="-5 5"/>
  </actuator>
  <sensor><actuatorfrc name="effort" actuator="elbow_servo"/></sensor>
</mujoco>"""
RATE, SECONDS = 200.0, 5.0
KNOWN = {"mass": 0.02, "stiffness": 0.03, "damping": 0.2, "gain": 0.02, "sensor": 0.005}


def command(run, scale=8.0):
    """A multisine, held between samples."""
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    phases = np.random.default_rng(run).uniform(0, 2 * np.pi, 12)
    lines = 0.4 * np.arange(1, 13)
    return t, scale * np.mean([np.sin(2 * np.pi * f * t + p) for f, p in zip(lines, phases, strict=True)], axis=0)


def rig_case(force, seed=1):
    """Return a case whose rig has an added force of position and velocity, by Runge-Kutta steps of 0.5 ms."""
    rng, runs, h = np.random.default_rng(seed), [], 5e-4
    for k in range(3):
        t, u = command(k)
        q, v, series = 0.0, 0.0, []
        for pushed in u:
            series.append(q)
            for _ in range(round(1 / RATE / h)):
                a = [0.0] * 5
                at = [(q, v)] * 5
                for i, share in enumerate((0.5, 0.5, 1.0, 0.0)):
                    x, w = at[i]
                    a[i] = pushed - 400.0 * x - 0.8 * w + force(x, w)
                    at[i + 1] = (q + share * h * w, v + share * h * a[i])
                q += h / 6 * (at[0][1] + 2 * (at[1][1] + at[2][1]) + at[3][1])
                v += h / 6 * (a[0] + 2 * (a[1] + a[2]) + a[3])
        runs.append((t, u, np.array(series)))
    noise = 1e-4 * np.std(runs[0][2])
    return vlab.Case.from_arrays(
        RIG,
        runs[0][0],
        [{"motor": u} for _, u, _ in runs],
        [{"encoder": q + noise * rng.standard_normal(len(q))} for _, _, q in runs],
        uncertain=KNOWN,
        channels={"motor": {"hold": "zero"}},
        initial="rest",
    )


def arm_case(dry=0.0, share=0.0):
    """Return a case of an arm whose elbow has dry friction, or friction in proportion to its motor moment."""
    rng, inputs, outputs = np.random.default_rng(5), [], []
    for k in range(3):
        model = mujoco.MjModel.from_xml_string(ARM)
        data = mujoco.MjData(model)
        _, one = command(k, 1.0)
        _, two = command(k + 10, 1.5)
        mujoco.mj_forward(model, data)
        q = np.empty((len(one), 3))
        for i, commands in enumerate(zip(one, two, strict=True)):
            mujoco.mj_forward(model, data)
            q[i] = *data.qpos, data.sensordata[0]
            data.ctrl[:] = commands
            for _ in range(round(1 / RATE / 0.001)):
                model.dof_frictionloss[1] = dry + share * abs(data.qfrc_actuator[1])
                mujoco.mj_step(model, data)
        q[:, :2] += 1e-5 * rng.standard_normal((len(q), 2))
        inputs.append({"shoulder_servo": one, "elbow_servo": two})
        outputs.append({"shoulder": q[:, 0], "elbow": q[:, 1]})
    known = {**KNOWN, "damping": 0.3, "armature": 0.1, "velocity-gain": 0.1, "inertia": 0.05}
    held = {name: {"hold": "zero"} for name in inputs[0]}
    return vlab.Case.from_arrays(ARM, command(0)[0], inputs, outputs, uncertain=known, channels=held, initial="rest")


@pytest.fixture(scope="module")
def plain():
    return rig_case(lambda q, v: 0.0)


@pytest.fixture(scope="module")
def rubbing_arm():
    return arm_case(dry=0.4)


# ---- what all peers share -------------------------------------------------------------------------------------------


def test_a_fault_of_a_peer_is_its_result(plain, monkeypatch):
    def breaks(case):
        raise ZeroDivisionError("no\nsamples")

    def refuses(case):
        raise NotUsable("for other models")

    peers = {"one": registry.Peer(run=breaks), "two": registry.Peer(run=refuses, is_slow=False)}
    monkeypatch.setattr(registry, "PEERS", peers)
    found = registry.peers_of(plain)
    assert found["one"]["note"] == "failed: ZeroDivisionError: no samples"
    assert found["two"]["note"] == "not run: for other models"
    assert all(result["cpu_seconds"] >= 0.0 for result in found.values())
    assert set(registry.peers_of(plain, slow_too=False)) == {"two"}
    assert set(registry.peers_of(plain, ["one"])) == {"one"}


def test_an_unknown_peer_is_refused():
    registry.check_peers(["bic", "pysindy"])
    with pytest.raises(VlabError, match="mujoco.sysid"):
        registry.check_peers(["sindy"])


def test_a_missing_extra_is_a_note(plain, monkeypatch):
    monkeypatch.setattr(sparse_regression, "HAS_PYSINDY", False)
    monkeypatch.setattr(mujoco_sysid, "HAS_SYSID", False)
    found = registry.peers_of(plain, ["pysindy", "mujoco.sysid"])
    assert all("pip install 'vlab-vibration[peers]'" in result["note"] for result in found.values())


def test_the_error_of_a_free_run_is_relative_to_each_channel(plain):
    _, (run, *_), _ = mjcf_runs(plain)
    measured = np.column_stack([run.measured[name] for name in compared_names(run)])
    assert error_of(run, measured) == 0.0
    assert error_of(run, measured + 0.1 * measured.std(axis=0)) == pytest.approx(0.1)
    assert error_of(run, np.full_like(measured, np.nan)) == MOST_ERROR


# ---- sparse regression ----------------------------------------------------------------------------------------------


def test_free_runs_of_an_oscillator_follow_its_closed_form():
    t = np.arange(0.0, 2.0, 0.002)
    zeros = np.zeros((len(t), 1))
    states = States(q=zeros + 1.0, v=zeros, a=zeros, u=zeros, step_s=0.002)
    columns = Columns(places=("joint:a",), rows=np.eye(1), deflection=np.ones(1), speed=np.ones(1))
    stable, unstable = np.zeros((9, 1)), np.zeros((9, 1))
    stable[1], unstable[1] = -25.0, 900.0
    q, v = free_runs(columns, np.array([stable, unstable]), np.array([Library().shapes] * 2), states)
    np.testing.assert_allclose(q[:, 0, 0], np.cos(5 * t), atol=1e-8)
    np.testing.assert_allclose(v[:, 0, 0], -5 * np.sin(5 * t), atol=1e-7)
    assert np.isnan(q[-1, 1, 0])


def test_columns_of_clearances_are_zero_within_the_gap():
    columns = Columns(places=("joint:a",), rows=np.eye(1), deflection=np.array([2.0]), speed=np.ones(1))
    q = np.array([[-3.0], [-1.0], [1.0], [3.0]])
    stop = Library(rise=0.05, below=1.0, above=1.0, clearance="stop")
    one_sided = Library(rise=0.05, above=0.0, clearance="one-sided-stiffness")
    found = [columns.of(q, 0 * q, 0 * q, own.shapes)[:, -1] for own in (stop, one_sided, Library())]
    np.testing.assert_allclose(found, [[-1, 0, 0, 1], [0, 0, 1, 3], [0, 0, 0, 0]])


def test_states_are_smoothed_and_velocities_are_integrated(plain):
    plant, (run, *_), _ = mjcf_runs(plain)
    channels = joint_channels(plant, run)
    assert channels == {0: ("encoder", 0)}
    t = run.measured.time
    moved = replace(run, measured=replace(run.measured, data=np.column_stack([np.sin(3 * t)] * 2)))
    as_position = states_of(moved, {0: ("encoder", 0)}, 0.05)
    as_velocity = states_of(moved, {0: ("encoder", 1)}, 0.05)
    np.testing.assert_allclose(as_position.a[:, 0], -9 * np.sin(3 * t), atol=0.02)
    np.testing.assert_allclose(as_velocity.q[:, 0], (1 - np.cos(3 * t)) / 3, atol=0.01)


def test_an_arm_has_no_constant_inertia(rubbing_arm):
    with pytest.raises(NotUsable, match="depends on its pose"):
        joint_channels(rubbing_arm.plant, rubbing_arm.runs(("fit",))[0])


@pytest.mark.slow
@pytest.mark.skipif(not sparse_regression.HAS_PYSINDY, reason="needs pysindy")
@pytest.mark.parametrize(
    ("effect", "force"),
    [
        (None, lambda q, v: 0.0),
        ("cubic-stiffness", lambda q, v: -2e6 * q**3),
        ("quadratic-drag", lambda q, v: -20.0 * v * abs(v)),
    ],
)
def test_pysindy_names_a_law_of_its_library(effect, force):
    found = sparse_regression.sparse_regression(rig_case(force))
    assert (found.named.effect if found.named else None) == effect
    assert found.nrmse < 0.2  # the phase of light damping


# ---- mujoco.sysid ---------------------------------------------------------------------------------------------------


def test_freed_numbers_at_their_nominal_values_change_nothing(plain, rubbing_arm):
    for case in (plain, rubbing_arm):
        freed = freed_numbers(case.plant, KNOWN, case.runs(("fit",)))
        assert len({number.label for number in freed}) == len(freed)
        model = with_numbers(case.plant.model, freed, np.zeros(len(freed)))
        for name in ("body_mass", "dof_damping", "dof_frictionloss", "actuator_gainprm", "actuator_forcerange"):
            np.testing.assert_array_equal(getattr(model, name), getattr(case.plant.model, name))


def test_only_inertia_that_moves_is_freed(plain, rubbing_arm):
    labels = {number.label for number in freed_numbers(plain.plant, KNOWN, plain.runs(("fit",)))}
    assert "mass:1" in labels
    assert "inertia:1" not in labels  # the cart slides
    labels = {number.label for number in freed_numbers(rubbing_arm.plant, KNOWN, rubbing_arm.runs(("fit",)))}
    assert {"mass:2", "inertia:2", "kp:1", "kv:1", "limit:1", "friction:1", "armature:1"} <= labels


@pytest.mark.slow
@pytest.mark.skipif(not mujoco_sysid.HAS_SYSID, reason="needs mujoco.sysid")
def test_sysid_names_dry_friction_and_nothing_without():
    friction = fit_all_numbers(rig_case(lambda q, v: -0.2 * np.tanh(v / 1e-3)))
    assert friction.named is not None
    assert (friction.named.effect, friction.named.place) == ("coulomb-friction", "joint:cart")
    nothing = fit_all_numbers(rig_case(lambda q, v: 0.0))
    assert nothing.named is None
    assert nothing.nrmse < 0.01


# ---- friction models of servos --------------------------------------------------------------------------------------


def test_runs_without_friction_and_with_constant_friction_are_those_of_the_replay(rubbing_arm):
    plant, (run, *_), _ = mjcf_runs(rubbing_arm)
    start = find_initial_state(plant, run)
    own = prepared(plant, run, start)
    friction = np.tile(NO_FRICTION, (2, 1))
    for dry in (0.0, 0.3):
        friction[:, FRICTION.index("base")] = dry
        model = copy.copy(plant.model)
        model.dof_frictionloss[:] = dry
        recording = simulate(replace(plant, model=model), run, initial=start).recording
        expected = np.column_stack([recording[name] for name in compared_names(run)])
        np.testing.assert_allclose(run_with_friction(own, copy.copy(own.plant.model), friction), expected, atol=1e-9)


def test_a_rig_on_motors_is_no_arm(plain):
    with pytest.raises(NotUsable, match="position servo"):
        fit_friction_models(plain)


def test_friction_models_are_nested():
    columns = {name: {c for p in freed for c in p.columns} for name, freed in MODELS.items()}
    assert columns["M0"] < columns["M1"] < columns["M2"] < columns["M4"] == columns["M5"] < columns["M6"]
    assert columns["M1"] < columns["M3"] < columns["M4"]
    assert len(MODELS["M4"]) < len(MODELS["M5"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dry", "share", "effect"), [(0.0, 0.0, None), (0.4, 0.0, "coulomb-friction"), (0.0, 0.3, "servo-load-friction")]
)
def test_friction_models_tell_dry_friction_from_friction_of_the_load(dry, share, effect):
    found = fit_friction_models(arm_case(dry, share))
    assert (found.named.effect if found.named else None) == effect
    if effect:
        assert found.named is not None
        assert found.named.place == "joint:elbow"


# ---- Bayesian information criterion ---------------------------------------------------------------------------------


def test_the_criterion_is_that_of_white_noise_of_unknown_variance():
    rng = np.random.default_rng(3)
    y = rng.standard_normal(500) + 0.3
    costs = [float(y @ y), float(np.sum((y - y.mean()) ** 2))]
    best = least_squares(lambda m: y - m, [0.0])
    assert isinstance(best, OptimizeResult)
    assert 2 * best.cost == pytest.approx(costs[1])
    fits = [Fit(terms=(), theta=np.zeros(0), offsets=np.zeros(0), starts={}, error=np.zeros(0), chi2=c + 2.0, cost=c)
            for c in costs]  # fmt: skip
    gain = criterion(fits[0], 500) - criterion(fits[1], 500)
    assert gain == pytest.approx(500 * np.log(costs[0] / costs[1]))
    assert criterion(fits[0], 500) == pytest.approx(500 * np.log(costs[0] / 500) + 2.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "force"), [(None, lambda q, v: 0.0), ("quadratic-drag", lambda q, v: -20.0 * v * abs(v))]
)
def test_the_criterion_names_what_is_there(effect, force):
    found = bic_over_catalogue(rig_case(force))
    assert (found.named.effect if found.named else None) == effect
    assert "candidates fitted" in found.remark


# ---- score ----------------------------------------------------------------------------------------------------------


def judged_case(name, hidden, named, nrmse, cpu):
    things = [
        {"effect": e, "family": "", "form": "", "accepted": [e], "place": "joint:x", "places_alike": [], "places_near": [],
         "at_actuator": False, "parameters": {}, "same_parameters": False}
        for e in hidden
    ]  # fmt: skip
    truth = {"case": name, "suite": "in-library" if hidden else "null", "bench": "slider", "noise": "low",
             "one_level": False, "sigma": [1.0, 1.0], "hidden": things, "size": {"left": 5.0} if hidden else None}  # fmt: skip
    found = Named(effect=named, place="joint:x", share=1.0) if named else None
    result = PeerResult(named=found, names=("stop",), nrmse=nrmse).to_json()
    answer = {"verdict": "nothing-missing", "findings": [], "seconds": 1.0, "cpu_seconds": 3.0,
              "heldout": {"gap_closed": None, "nrmse_before": 0.5, "nrmse_noise": 0.1, "nrmse_after": 0.5},
              "baselines": {"bic": {**result, "cpu_seconds": cpu}, "pysindy": {"note": "not run: for rigs"}}}  # fmt: skip
    return truth, answer


def test_the_score_counts_classes_false_alarms_errors_and_times():
    rows = [
        judged_case("a", ["stop"], "stop", 0.1, 10.0),
        judged_case("b", ["stop"], "dead-band", 0.3, 20.0),
        judged_case("c", [], "stop", 0.2, 60.0),
        judged_case("d", [], None, 0.4, 40.0),
    ]
    judged = [judge(truth, answer) for truth, answer in rows]
    truths, answers = ({pair[0]["case"]: pair[i] for pair in rows} for i in (0, 1))
    table = {row["method"]: row for row in peer_rows(judged, answers, truths)}
    row = table["bic"]
    assert (row["right"]["count"], row["right"]["of"]) == (1, 2)
    assert (row["false_alarms"]["count"], row["false_alarms"]["of"]) == (1, 2)
    assert row["nrmse"] == pytest.approx(0.25)
    assert row["cpu_seconds"] == pytest.approx(30.0)
    assert row["gap_closed"] == pytest.approx(0.75)  # the median of 1.0 and 0.5
    assert row["vlab_beside"]["false_alarms"]["count"] == 0
    assert "for rigs" in table["pysindy"]["note"]
    heads, cells = peer_table({"baselines": list(table.values())})
    assert all(len(line) == len(heads) for line in cells)


def test_a_peer_on_nulls_alone_has_a_row():
    truth, answer = judged_case("c", [], "stop", 0.2, 60.0)
    (row,) = [r for r in peer_rows([judge(truth, answer)], {"c": answer}, {"c": truth}) if r["method"] == "bic"]
    assert row["false_alarms"]["count"] == 1
    assert row["usable"] == 1
