"""What recordings of machines bring: masses that nothing holds, joints that rest on a stop, friction that is dry and viscous at once."""

import numpy as np
import pytest
from rig_folder import Channel, Record, multisine, write_case
from scipy.integrate import solve_ivp

from vlab.cases import load_case
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.predictors.modal import mix
from vlab.diagnose.predictors.own_nonlinearity import Inverse, ModalMotion
from vlab.diagnose.predictors.scope import _departure, _large
from vlab.diagnose.predictors.trajectory_data import sampled
from vlab.diagnose.settings import SCOPE
from vlab.errors import Diverged
from vlab.physics.catalogue import EFFECTS
from vlab.plants.mjcf import build_mjcf

MASS, DRY, VISCOUS, NOISE = 2.0, 0.8, 3.0, 2e-5
RATE, SECONDS = 200.0, 12.0

SLIDE = """<mujoco model="slide">
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"{limits}/>
    <geom type="box" size=".05 .05 .05" mass="2" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><motor name="motor" joint="x"/></actuator>
  <sensor><jointpos name="encoder" joint="x"/></sensor>
</mujoco>"""
FREE, ON_A_STOP = SLIDE.format(limits=""), SLIDE.format(limits=' limited="true" range="0 2"')


def test_a_mass_that_nothing_holds_is_linear():
    plant = build_mjcf(FREE)
    assert _departure(plant, plant.linearise(), *_large(plant)) < SCOPE.exact


def test_a_stop_at_rest_is_no_spring():
    plant = build_mjcf(ON_A_STOP)
    away = np.linspace(0.5, 1.0, 7)[:, None] * np.sqrt(MASS)  # m, in a mode of unit modal mass
    rates = np.random.default_rng(0).normal(size=(2, 7, 1))
    extra = Inverse(plant, plant.linearise().eigen[1]).extra(ModalMotion(away, *rates), np.zeros((7, 0)), 0.01)
    # a free mass has no force beside its inertia, which is linear; the stop it rested on would be 1e5 N
    np.testing.assert_allclose(extra, 0.0, atol=1e-8)


def test_a_command_is_picked_up_by_its_own_number():
    commands = np.random.default_rng(0).normal(size=(6, 3))
    run = Signals(
        name="run",
        role="fit",
        h=0.01,
        u=commands,
        load=np.zeros((6, 0)),
        y=np.zeros((6, 1)),
        noise=np.ones(1),
        scale=np.ones(1),
        at_rest=True,
    )
    place = Place(name="encoder", kind="pick-up", index=0, other=2, tag="command")
    term = Term(effect=EFFECTS["crosstalk"], place=place, values={"share": 0.1})
    y = np.zeros((6, 1, 1, 1))
    mix(y, term, {"share": np.array([0.1])}, [run])
    np.testing.assert_allclose(y[:, 0, 0, 0], 0.1 * np.append(0.0, commands[:-1, 2]))


def test_a_motion_that_runs_away_is_said_so():
    with pytest.raises(Diverged, match="timestep"):
        sampled(np.full((1, 2, 2), np.nan), np.ones((1, 1, 1)), 0.01)


def test_a_lag_goes_on_from_what_was_recorded():
    lag, h, p = EFFECTS["sensor-lag"], 0.01, {"time_constant": 0.2}
    time = np.arange(0.0, 6.0, h)
    true = np.sin(3.0 * time)
    recorded = lag.sense(true, p, h, time)
    middle = 300
    step = lag.resumed(p, h, float(recorded[middle]))
    later = [step(float(x), float(t), 0.0) for x, t in zip(true[middle:], time[middle:], strict=True)]
    # the filter's own state is one number, so nothing is left but rounding
    np.testing.assert_allclose(later, recorded[middle:], atol=1e-12)
    from_rest = lag.stepper(p, h)
    assert abs(from_rest(float(true[middle]), 0.0, 0.0) - recorded[middle]) > 0.05


def rubbed(level, rng):
    """Rows of a cart with dry and viscous friction under a multisine, from rest; friction turns round within 5 mm/s."""
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    force = multisine(rng, 0.25, 4.0, SECONDS, level)

    def rate(t, x):
        return [x[1], (force(t) - VISCOUS * x[1] - DRY * np.tanh(x[1] / 5e-3)) / MASS]

    found = solve_ivp(rate, (0.0, SECONDS), [0.0, 0.0], t_eval=time, rtol=1e-7, atol=1e-9, max_step=2e-3)
    return {"u": force(time), "y": found.y[0] + NOISE * rng.standard_normal(len(time))}


def cart(folder, mjcf):
    """Write the case of a cart with friction; return it, loaded."""
    rng = np.random.default_rng(3)
    write_case(
        folder,
        title="Cart",
        mjcf=mjcf,
        uncertain={"mass": 0.02},
        channels=[
            Channel(column="u", at="motor", kind="force", unit="N", is_input=True, hold="linear"),
            Channel(column="y", at="encoder", kind="displacement", unit="m"),
        ],
        records=[
            Record(name=f"run {i}", role=role, columns=rubbed(level, rng), rate_hz=RATE)
            for i, (role, level) in enumerate([("fit", 3.0), ("fit", 5.0), ("holdout", 4.0)])
        ],
    )
    return load_case(folder)


@pytest.mark.slow
def test_friction_is_dry_and_viscous_at_once(tmp_path):
    done = diagnose(cart(tmp_path, FREE)).diagnosis
    assert {f.effect for f in done.findings} == {"coulomb-friction", "viscous-damping"}
    assert {f.place for f in done.findings} == {"joint:x"}
    found = {f.effect: f.parameters for f in done.findings}
    # the mass is known to 2 %, and both forces go with its scale: three standard deviations of it
    assert found["coulomb-friction"]["force"]["value"] == pytest.approx(DRY, rel=0.06)
    assert found["viscous-damping"]["damping"]["value"] == pytest.approx(VISCOUS, rel=0.06)
    assert done.heldout["gap_closed"] > 0.9


@pytest.mark.slow
def test_friction_that_the_model_has_may_be_off(tmp_path):
    known = SLIDE.format(limits=f' damping="{VISCOUS}" frictionloss="{0.8 * DRY}"')
    done = diagnose(cart(tmp_path, known)).diagnosis
    # MuJoCo's dry friction turns round more sharply than the cart's does, which may be found: but no more friction, and no other gain
    assert not {f.effect for f in done.findings} - {"coulomb-friction"}
    friction = sum(value for name, value in done.calibration.items() if name.split(":")[-1] == "friction")
    named = sum(f.parameters["force"]["value"] for f in done.findings)
    # the mass is known to 2 %, and all forces go with its scale: three standard deviations of it
    assert 0.8 * DRY * np.exp(friction) + named == pytest.approx(DRY, rel=0.06)
