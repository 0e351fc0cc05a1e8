"""Every effect of the catalogue in MuJoCo beside the same effect in the reduced model of the diagnosis."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from physics_rig import CHANNEL_VALUES, PORT_VALUES, chain_rig

from vlab.cases.initial_state import InitialState
from vlab.cases.simulate import simulate
from vlab.errors import BadExperiment, UnknownName
from vlab.physics.attach import Attached, attach, effect_tables, own_stiffness, port_at, written
from vlab.physics.attached import AtPort
from vlab.physics.catalogue import ALIASES, EFFECTS, effect_named
from vlab.physics.native import SPRINGS
from vlab.physics.servo import ServoEffect
from vlab.plants.mjcf import build_mjcf

ALL = {**PORT_VALUES, **CHANNEL_VALUES}
STEP_ERROR = 0.04
"""Share of an effect's own signal. Both march explicitly: MuJoCo in 0.5 ms steps, the twin in steps of a 22nd of the
fastest cycle; where the forces turn round within a step (friction that falls with speed) 2.6 % were measured, elsewhere 1 %."""


def rig_for(name, **options):
    return chain_rig(kind="hinge" if name == "rotary-inertia" else "slide", **options)


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


def test_the_values_of_the_tests_cover_the_catalogue():
    of_servos = {name for name, effect in EFFECTS.items() if isinstance(effect, ServoEffect)}  # see test_servo.py
    assert set(ALL) == set(EFFECTS) - {"tension-error"} - of_servos  # a stretched bar: see test_places.py


@pytest.mark.slow
@pytest.mark.parametrize("name", PORT_VALUES)
def test_a_force_at_a_port_is_the_same_in_mujoco_and_in_the_reduced_model(name):
    rig, (at, values) = rig_for(name), PORT_VALUES[name]
    here = rig.in_mujoco([(name, at, values)]) - rig.in_mujoco([])
    there = rig.in_reduced_model([(name, at, values)]) - rig.in_reduced_model([])
    for k in range(here.shape[1]):
        assert rms(here[:, k] - there[:, k]) < STEP_ERROR * rms(here[:, k])


@pytest.mark.parametrize("name", [n for n, (at, _) in CHANNEL_VALUES.items() if "/" not in at])
def test_a_change_of_a_channel_is_the_same_in_mujoco_and_in_the_reduced_model(name):
    rig, (at, values) = chain_rig(step=1e-3), CHANNEL_VALUES[name]
    here = rig.in_mujoco([(name, at, values)]) - rig.in_mujoco([])
    there = rig.in_reduced_model([(name, at, values)]) - rig.in_reduced_model([])
    if name == "sensor-quantisation":  # a sample that the two models have on either side of an edge differs by a step
        assert np.mean(np.abs(here - there) > 0.1 * values["step"]) < 0.1
        assert np.abs(here - there).max() < 1.1 * values["step"]
        return
    assert rms(here[:, 0] - there[:, 0]) < STEP_ERROR * rms(here[:, 0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_every_parameter_moves_the_output(name):
    rig, (at, values) = rig_for(name, step=1e-3), ALL[name]
    before = rig.in_mujoco([(name, at, values)])
    for parameter in EFFECTS[name].parameters:
        moved = {**values, parameter.name: 1.3 * values[parameter.name]}
        change = rig.in_mujoco([(name, at, moved)]) - before
        assert max(rms(change[:, k]) / rms(before[:, k]) for k in range(3)) > 1e-4, parameter.name


@pytest.mark.parametrize("name", ["crosstalk", "cross-axis", "misplaced-sensor"])
def test_what_a_sensor_picks_up_is_mixed_in(name):
    rig, (at, values) = chain_rig(step=1e-3), CHANNEL_VALUES[name]
    before, after = rig.in_mujoco([]), rig.in_mujoco([(name, at, values)])
    other = before[:, 1] if name != "crosstalk" else np.concatenate([[0.0], rig.run.measured["push"][:-1]])
    expected = EFFECTS[name].mix(before[:, 0], other, values)
    assert np.allclose(after[:, 0], expected, atol=1e-12)
    assert np.array_equal(after[:, 1:], before[:, 1:])


def test_effects_on_each_other_count():
    # two masses and friction at once: forces are found together, not one after the other
    rig = chain_rig()
    several = [
        ("added-mass", "tendon:whole", {"mass": 0.6}),
        ("added-mass", "joint:b", {"mass": 0.8}),
        ("attached-oscillator", "joint:b", {"mass": 0.3, "frequency": 4.0, "damping_ratio": 0.1}),
        ("stribeck-friction", "joint:a", {"force": 1.0, "excess": 0.5, "speed": 0.1}),
    ]
    here, there = rig.in_mujoco(several) - rig.in_mujoco([]), rig.in_reduced_model(several) - rig.in_reduced_model([])
    assert rms(here - there) < STEP_ERROR * rms(here)


# ---- MuJoCo's own elements ------------------------------------------------------------------------------------------


def run_of(rig, plant):
    rest = InitialState(qpos=plant.rest, qvel=np.zeros(plant.model.nv), how="rest")
    return simulate(plant, rig.run, initial=rest).recording.select(list(rig.problem.names)).data


NATIVE = [
    "added-mass", "lost-stiffness", "stiffness-to-ground", "magnetic-negative-stiffness", "viscous-damping",
    "quadratic-drag", "cubic-stiffness", "quadratic-stiffness", "quadratic-cubic-stiffness", "coulomb-friction",
    "rotary-inertia",
]  # fmt: skip


@pytest.mark.parametrize("name", NATIVE)
def test_numbers_of_the_model_and_forces_while_it_runs_do_the_same(name):
    rig, (at, values) = rig_for(name), PORT_VALUES[name]
    plant = rig.case.plant
    own = attach(plant, [Attached(EFFECTS[name], at, values)])
    assert not own.physics
    force = AtPort(effect=EFFECTS[name], port=port_at(plant, at), values=values, stiffness=own_stiffness(plant, at))
    before = run_of(rig, plant)
    native, forced = run_of(rig, own) - before, run_of(rig, replace(plant, physics=(force,))) - before
    # MuJoCo takes a damper's velocity at the step's beginning, the force at its middle: half a step is 0.014 rad of the
    # fastest mode; MuJoCo's friction is a little soft; all else is the same to
    # (h c/m)^2, the share of the model's own implicit dampers that is left out
    allowed = {"coulomb-friction": STEP_ERROR, "viscous-damping": 0.014, "quadratic-drag": 0.014}.get(name, 1e-5)
    assert rms(native - forced) < allowed * rms(forced)


@pytest.mark.parametrize("name", [*NATIVE, *SPRINGS, "actuator-gain", "actuator-clipping"])
def test_the_written_model_runs_by_itself_as_the_attached_one(name):
    rig, (at, values) = rig_for(name), ALL[name]
    plant, effects = rig.case.plant, [Attached(EFFECTS[name], at, values)]
    spec, left = written(plant, effects)
    assert not left
    before = run_of(rig, plant)
    here = run_of(rig, build_mjcf(spec.to_xml())) - before
    there = run_of(rig, attach(plant, effects)) - before
    assert rms(here - there) < 0.01 * rms(there)


def test_what_has_no_element_is_left_for_the_case_file():
    plant = chain_rig().case.plant
    effects = [Attached(effect_named("bouc-wen"), "joint:a", {"force": 2.0, "yield": 0.004})]
    effects.append(Attached(effect_named("added-mass"), "body:c", {"mass": 0.25}))
    spec, left = written(plant, effects)
    assert [one.effect.name for one in left] == ["bouc-wen"]
    assert float(spec.compile().body("c").mass[0]) == pytest.approx(1.25)
    assert 'name = "bouc-wen"' in effect_tables(left)
    assert "yield = 0.004" in effect_tables(left)


ARM = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="arm" euler="0 20 0">
<joint name="hinge" type="hinge" axis="0 1 0"/><joint name="roll" type="hinge" axis="1 0 0"/>
<geom type="box" size="0.2 0.03 0.02" pos="0.2 0 0" mass="1.5" euler="10 0 30"/><site name="tip" pos="0.4 0.02 -0.01"/>{more}
</body></worldbody><sensor><jointpos name="angle" joint="hinge"/></sensor></mujoco>"""


def test_a_mass_at_a_site_is_the_model_with_a_small_ball_there():
    """Masses, inertias, gravity's moments and the forces of turning, wherever the arm is and however it moves."""
    ball = '<geom type="sphere" size="1e-3" pos="0.4 0.02 -0.01" mass="0.35"/>'
    plant, other = (build_mjcf(ARM.format(more=more)) for more in ("", ball))
    effects = [Attached(effect_named("added-mass"), "site:tip", {"mass": 0.35})]
    loaded = attach(plant, effects)
    assert not loaded.physics  # its weight comes with it
    spec, left = written(plant, effects)
    assert not left
    for model in (loaded.model, build_mjcf(spec.to_xml()).model):
        found = []
        for m in (model, other.model):
            data = mujoco.MjData(m)
            data.qpos[:], data.qvel[:] = (0.7, -0.4), (2.0, -1.0)
            mujoco.mj_forward(m, data)
            mass = np.zeros((2, 2))
            mujoco.mj_fullM(m, data, mass)
            found.append(np.vstack([mass, data.qfrc_bias]))
        np.testing.assert_allclose(*found, rtol=1e-4)  # the ball is a millimetre large
    with pytest.raises(BadExperiment, match="site:tip.x"):
        attach(plant, [Attached(effect_named("coulomb-friction"), "site:tip", {"force": 1.0})])
    with pytest.raises(UnknownName, match="tip"):
        attach(plant, [Attached(effect_named("added-mass"), "site:tap", {"mass": 1.0})])


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["RK4", "implicitfast"])
def test_other_integrators_do_the_same(integrator):
    one = [("stribeck-friction", *PORT_VALUES["stribeck-friction"]), ("added-mass", "tendon:whole", {"mass": 0.3})]
    euler, other = chain_rig(step=2.5e-4), chain_rig(step=2.5e-4, integrator=integrator)
    here, there = (rig.in_mujoco(one) - rig.in_mujoco([]) for rig in (euler, other))
    assert rms(here - there) < STEP_ERROR * rms(here)


def test_small_motion_of_an_attached_plant_is_what_it_runs_with():
    rig = chain_rig()
    values = {"mass": 0.4}
    own = attach(rig.case.plant, [Attached(effect_named("added-mass"), "tendon:whole", values)])
    port = port_at(rig.case.plant, "tendon:whole")
    forced = attach(replace(rig.case.plant, ports={**rig.case.plant.ports, "here": replace(port, name="here")}),
                    [Attached(effect_named("added-mass"), "here", values)])  # fmt: skip
    assert forced.physics
    assert not own.physics
    assert np.allclose(forced.linearise().freq, own.linearise().freq, rtol=1e-9)


# ---- refusals -------------------------------------------------------------------------------------------------------


def test_names_and_places_that_do_not_fit_are_refused():
    plant = chain_rig().case.plant
    with pytest.raises(UnknownName, match="did you mean 'coulomb-friction'"):
        effect_named("coulomb-frction")
    with pytest.raises(UnknownName, match="joint:a"):
        attach(plant, [Attached(effect_named("added-mass"), "joint:d", {"mass": 1.0})])
    with pytest.raises(BadExperiment, match="lacks mass"):
        Attached(effect_named("added-mass"), "joint:a", {})
    with pytest.raises(UnknownName, match="parameter"):
        Attached(effect_named("added-mass"), "joint:a", {"weight": 1.0})
    with pytest.raises(BadExperiment, match="no finite"):
        Attached(effect_named("added-mass"), "joint:a", {"mass": float("nan")})
    with pytest.raises(BadExperiment, match="must be positive"):
        Attached(effect_named("jenkins-slip"), "joint:a", {"force": 1.0, "slip": 0.0})
    with pytest.raises(BadExperiment, match="rotation"):
        attach(plant, [Attached(effect_named("rotary-inertia"), "joint:a", {"inertia": 1.0})])
    with pytest.raises(BadExperiment, match="elastic element"):
        attach(plant, [Attached(effect_named("lost-stiffness"), "tendon:whole", {"share": 0.1})])
    with pytest.raises(BadExperiment, match="no actuator"):
        attach(plant, [Attached(effect_named("coil-force-over-travel"), "joint:b", {"loss": 1.0})])
    with pytest.raises(UnknownName, match="actuator:push"):
        attach(plant, [Attached(effect_named("actuator-gain"), "actuator:shove", {"gain": 0.1})])


def test_other_names_lead_to_effects():
    for alias, name in ALIASES.items():
        assert alias not in EFFECTS
        assert effect_named(alias) is EFFECTS[name]


def test_a_users_own_effect(tmp_path):
    file = tmp_path / "own.py"
    file.write_text(
        "from vlab.physics.effect import Parameter, PortEffect\n"
        "class Quintic(PortEffect):\n"
        "    name, family, law, words = 'quintic', 'nonlinear-stiffness', 'F = -k z^5', 'a quintic spring'\n"
        "    parameters = (Parameter(name='k', unit='N/m^5', low=1.0, high=1e12),)\n"
        "    def force(self, z, v, p, step, memory):\n"
        "        return -p['k'] * z**5, memory\n"
    )
    rig = chain_rig()
    effect = effect_named(f"{file}:Quintic")
    plant = attach(rig.case.plant, [Attached(effect, "joint:a", {"k": 1e8})])
    assert rms(run_of(rig, plant) - run_of(rig, rig.case.plant)) > 0
    (tmp_path / "bad.py").write_text("1/0")
    (tmp_path / "other.py").write_text("class Quintic: pass")
    with pytest.raises(BadExperiment, match="fails when it is loaded"):
        effect_named(f"{tmp_path / 'bad.py'}:Quintic")
    with pytest.raises(BadExperiment, match="no subclass"):
        effect_named(f"{tmp_path / 'other.py'}:Quintic")
