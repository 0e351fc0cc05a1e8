"""Replays in compiled code beside the same steps in Python."""

import ast
import inspect
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from physics_rig import CHANNEL_VALUES, FILTER_OF_SERVO, OF_SERVOS, PORT_VALUES, SERVO, _chain_case, chain_rig, servoed

from vlab.cases import compiled_replay
from vlab.cases.case import load_case
from vlab.cases.compiled_replay import LEAST_MEMORY
from vlab.cases.initial_state import InitialState
from vlab.cases.replay_bench import NotSafe
from vlab.cases.simulate import simulate
from vlab.errors import BadExperiment
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import effect_named
from vlab.plants.contacts import IS_COUNTED, contact_count, pairs_that_can_touch


def both(rig, effects, monkeypatch):
    """Return the channels of a run in compiled code and in Python."""
    return of_case(rig.case, effects, monkeypatch)


def of_case(case, effects, monkeypatch):
    """Return the same of the first run of a case."""
    plant = attach(case.plant, [Attached(effect_named(n), at, p) for n, at, p in effects])
    (run, *_) = case.runs(("fit",))
    names = [c.channel for c in run.compared]
    qvel = np.linspace(0.1, 0.3, plant.model.nv)
    start, runs, compiled = InitialState(qpos=plant.rest + 1e-3, qvel=qvel, how="given"), [], []
    inside = compiled_replay.replay_compiled

    def counted(*args):
        compiled.append(inside(*args))
        return compiled[-1]

    monkeypatch.setattr(compiled_replay, "replay_compiled", counted)
    for can in (compiled_replay.can_compile, lambda plant, ports: False):
        monkeypatch.setattr(compiled_replay, "can_compile", can)
        runs.append(simulate(plant, run, initial=start).recording.select(names).data)
    assert len(compiled) == bool(plant.physics)  # native effects run in MuJoCo's own loop
    assert all(done is not None for done in compiled)
    return runs


def check(runs):
    here, there = runs
    assert np.all(np.isfinite(here))
    assert here == pytest.approx(there, rel=1e-9, abs=1e-11 * np.abs(there).max())


@pytest.mark.parametrize("name", PORT_VALUES)
def test_an_effect_at_a_port(name, monkeypatch):
    rig, (at, values) = chain_rig(kind="hinge" if name == "rotary-inertia" else "slide"), PORT_VALUES[name]
    check(both(rig, [(name, at, values)], monkeypatch))


@pytest.mark.parametrize("name", PORT_VALUES)
def test_an_effect_at_a_port_in_steps_of_runge_kutta(name, monkeypatch):
    rig = chain_rig(kind="hinge" if name == "rotary-inertia" else "slide", integrator="RK4")
    at, values = PORT_VALUES[name]
    check(both(rig, [(name, at, values)], monkeypatch))


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast"])
def test_several_effects_act_on_each_other(integrator, monkeypatch):
    names = ("added-mass", "viscous-damping", "cubic-stiffness", "lugre-friction", "attached-oscillator", "bouc-wen")
    effects = [(name, *PORT_VALUES[name]) for name in names]
    check(both(chain_rig(integrator=integrator), effects, monkeypatch))


@pytest.mark.parametrize("name", CHANNEL_VALUES)
def test_an_effect_on_a_channel_or_actuator(name, monkeypatch):
    rig, (at, values) = chain_rig(step=1e-3), CHANNEL_VALUES[name]
    check(both(rig, [(name, at, values), ("bouc-wen", *PORT_VALUES["bouc-wen"])], monkeypatch))


@pytest.mark.parametrize("lag", ["", FILTER_OF_SERVO])
@pytest.mark.parametrize("name", OF_SERVOS)
def test_an_effect_within_a_servo(name, lag, tmp_path, monkeypatch):
    _chain_case(tmp_path, "slide", 5e-4, "implicitfast")
    case, values = servoed(tmp_path, SERVO.format(lag)), OF_SERVOS[name]
    check(of_case(case, [(name, "actuator:push", values)], monkeypatch))


def test_channels_at_ports_follow_the_kinematics(tmp_path, monkeypatch):
    _chain_case(tmp_path, "slide", 5e-4, "Euler")
    text = (tmp_path / "case.toml").read_text()
    whole = '[[recording.channel]]\ncolumn = "pos_a"\nat = "tendon:whole"\nkind = "displacement"\nunit = "m"'
    (tmp_path / "case.toml").write_text(
        text.replace('column = "pos_a"\nat = "pos_a"', 'column = "pos_c"\nat = "pos_c"', 1)
    )
    text = (tmp_path / "case.toml").read_text()
    first = text.index('[[recording.channel]]\ncolumn = "pos_c"')
    (tmp_path / "case.toml").write_text(text[:first] + whole + "\n")
    case = load_case(tmp_path)
    runs = of_case(case, [("bouc-wen", *PORT_VALUES["bouc-wen"])], monkeypatch)
    check(runs)
    assert np.std(runs[0]) > 1e-3  # the tendon moves
    bare = simulate(case.plant, case.runs(("fit",))[0]).recording.data
    assert np.std(bare[:, -1]) > 1e-3


NESTED = """<mujoco><worldbody><body><joint/><geom size=".1"/><body pos="0 0 .1"><joint/><geom size=".1"/></body></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("options", "geom", "pairs", "can"),
    [
        ("", "", 0, True),
        ("", '<geom size=".1"/>', 1, True),
        ("", '<geom size=".1"/>' * 10, 100, False),  # too many may meet at once for the memory
        ('<option solver="PGS"/>', '<geom size=".1"/>', 1, False),
        ('<option solver="PGS"><flag contact="disable"/></option>', '<geom size=".1"/>', 0, True),
    ],
)
def test_models_whose_first_contacts_fit_into_memory_run_in_compiled_code(options, geom, pairs, can):
    body = '<body><joint type="slide"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{}</body>'
    size = '<size memory="5M"/>'
    text = f"<mujoco>{size}{options}<worldbody>{body.format(geom)}{body.format(geom)}</worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    assert pairs_that_can_touch(model) == pairs
    assert compiled_replay.can_compile(SimpleNamespace(model=model, restoring=None), ()) is can


def test_neighbours_cannot_touch():
    assert pairs_that_can_touch(mujoco.MjModel.from_xml_string(NESTED)) == 0


def test_the_number_of_contacts_is_that_of_mujoco():
    ball = '<body pos="{} 0 0"><freejoint/><geom size=".1"/></body>'
    text = f"<mujoco><worldbody>{''.join(ball.format(0.15 * i) for i in range(6))}</worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    assert IS_COUNTED
    seen = contact_count(data)
    for height in (0.0, 1.0, 0.0):
        data.qpos[7 * 2 + 2] = height
        mujoco.mj_fwdPosition(model, data)
        assert seen[0] == data.ncon == (5 if height == 0.0 else 3)


@pytest.mark.parametrize("gap", [0.02, 10.0])
def test_a_run_ends_in_python_where_geoms_touch(gap, tmp_path, monkeypatch):
    """A ball of the first body meets a wall on its way, or does not."""
    _chain_case(tmp_path, "slide", 5e-4, "implicitfast")
    (model,) = tmp_path.glob("*.xml")
    text = model.read_text()
    first = text.index("<body")
    wall = f'<geom type="box" size=".1 .1 .1" pos="{0.1 + 0.05 + gap} 0 0"/>'
    inside = text.index(">", text.index("<joint", first)) + 1
    ball = '<geom type="sphere" size=".05" mass="0"/>'
    model.write_text(text[:first] + wall + text[first:inside] + ball + text[inside:])
    case = load_case(tmp_path)
    if pairs_that_can_touch(case.plant.model) == 0:
        case.plant.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    assert pairs_that_can_touch(case.plant.model) == 1
    plant = attach(case.plant, [Attached(effect_named("bouc-wen"), *PORT_VALUES["bouc-wen"])])
    (run, *_) = case.runs(("fit",))
    start = InitialState(qpos=plant.rest, qvel=np.full(plant.model.nv, 1.0), how="given")
    finished, inside = [], compiled_replay.replay_compiled

    def watched(*args):
        done = inside(*args)
        finished.append(done)
        return done

    monkeypatch.setattr(compiled_replay, "replay_compiled", watched)
    here = simulate(plant, run, initial=start).recording.data
    monkeypatch.setattr(compiled_replay, "can_compile", lambda plant, ports: False)
    there = simulate(plant, run, initial=start).recording.data
    assert bool(finished) is (gap > 1.0)
    assert here == pytest.approx(there, rel=1e-9, abs=1e-11 * np.abs(there).max())


def test_a_foreign_callback_is_refused():
    rig = chain_rig()
    plant = attach(rig.case.plant, [Attached(effect_named("bouc-wen"), *PORT_VALUES["bouc-wen"])])
    mujoco.set_mjcb_control(lambda model, data: None)
    try:
        with pytest.raises(BadExperiment, match="mjcb_control"):
            simulate(plant, rig.run)
    finally:
        mujoco.set_mjcb_control(None)


def test_constraints_in_steps_of_runge_kutta_stay_in_python():
    plant = chain_rig(integrator="RK4").case.plant
    assert compiled_replay.can_compile(plant, ())
    plant.model.dof_frictionloss[0] = 0.1
    assert not compiled_replay.can_compile(plant, ())
    plant.model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert compiled_replay.can_compile(plant, ())


@pytest.mark.parametrize("delay", ["", 'delay="0.01" nsample="8"'])
def test_delays_in_steps_of_runge_kutta_stay_in_python(delay):
    """MuJoCo advances the history of a delay in its own step only."""
    text = f"""<mujoco><option integrator="RK4"/><worldbody><body><joint name="a" type="slide"/>
    <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
    <actuator><motor joint="a" {delay}/></actuator></mujoco>"""
    plant = SimpleNamespace(model=mujoco.MjModel.from_xml_string(text), restoring=None, dissipation=None)
    assert compiled_replay.can_compile(plant, ()) is not bool(delay)


def test_a_model_with_little_memory_stays_in_python(monkeypatch):
    rig = chain_rig()
    plant = attach(rig.case.plant, [Attached(effect_named("bouc-wen"), *PORT_VALUES["bouc-wen"])])
    assert plant.model.narena >= LEAST_MEMORY
    asked = []

    def refused(*args):
        asked.append(args)
        raise NotSafe

    rest = InitialState(qpos=plant.rest, qvel=np.zeros(plant.model.nv), how="rest")
    expected = simulate(plant, rig.run, initial=rest).recording.data
    monkeypatch.setattr(compiled_replay, "replay_compiled", refused)
    assert simulate(plant, rig.run, initial=rest).recording.data == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert asked


def test_port_forces_compile_once():
    """A replay calls them at readings and at steps; a constant argument is a type of its own, to be compiled again."""
    tree = ast.parse(inspect.getsource(compiled_replay._run.py_func))
    calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call) and ast.unparse(n.func) == "add_port_forces"]
    assert len(calls) == 2
    assert not any(isinstance(argument, ast.Constant) for call in calls for argument in call.args)
