"""Micro-slip of a joint and hysteresis of a drive are named from recordings that vlab did not make."""

from types import SimpleNamespace

import numpy as np
import pytest
from rig_hysteresis import JOINTED, RATE, Sliders, _ring_down, driven_case, hysteretic, slipping_case

from vlab.cases import load_case, simulate
from vlab.cases.initial_state import InitialState
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.predictors.modal import _inputs
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import EFFECTS


def test_many_plays_of_the_rig_are_the_law_of_the_catalogue():
    u = np.cumsum(np.random.default_rng(4).standard_normal(600))
    u *= 8.0 / np.abs(u).max()
    own = EFFECTS["actuator-hysteresis"].actuate(u, {"growth": 0.02, "limit": 10.0}, 1 / RATE)
    other = hysteretic(u, 0.02, 10.0)
    assert np.std(own - other) < 0.02 * np.std(other - u)  # ten operators in place of three hundred


@pytest.mark.slow
def test_a_joint_of_many_sliders_rings_down_as_in_mujoco(tmp_path):
    """The blow from rest of the rig's own integrator, and of MuJoCo with the catalogue's law."""
    rig = slipping_case(tmp_path)
    blow = np.array([0.0, 0.3])
    theirs = _ring_down(blow, rig.parameters, np.zeros(4), 3.0)
    case = load_case(tmp_path)
    plant = attach(case.plant, [Attached(EFFECTS["iwan-slip"], rig.place, rig.parameters)])
    run = next(run for run in case.runs() if run.name == "large")
    start = InitialState(qpos=plant.rest, qvel=blow, how="rest")
    ours = simulate(plant, run, initial=start).recording.data[: len(theirs)]
    linear = simulate(case.plant, run, initial=start).recording.data[: len(theirs)]
    assert np.std(ours - theirs) < 0.05 * np.std(linear - theirs)  # ten sliders in place of 120
    assert "link" in JOINTED
    assert Sliders(**rig.parameters)(1.0) == pytest.approx(rig.parameters["force"], rel=0.01)


def test_a_window_remembers_the_extremes_of_the_commands_before_it():
    """An early extreme, far before the samples that a lag of an actuator needs, shows in the force of a late window."""
    u = np.concatenate([[0.0, 8.0], np.sin(0.1 * np.arange(800))])[:, None]
    at, load = 600, np.zeros((202, 0))
    one = np.ones(1)
    window = Signals(
        name="window", role="fit", h=0.005, u=u[at:], load=load, y=np.zeros((202, 1)), noise=one, scale=one,
        at_rest=False, led=u[:at],
    )  # fmt: skip
    values = {"growth": np.array([0.02]), "limit": np.array([10.0])}
    term = SimpleNamespace(effect=EFFECTS["actuator-hysteresis"], place=SimpleNamespace(indices=(0,)))
    force = _inputs([window], [term], [values], 1, with_ends=False)[0][:, 0, 0, 0]
    whole = term.effect.actuate(u[:, 0], {"growth": 0.02, "limit": 10.0}, 0.005)
    np.testing.assert_allclose(force, whole[at:], rtol=1e-12)
    fresh = term.effect.actuate(u[at:, 0], {"growth": 0.02, "limit": 10.0}, 0.005)
    assert np.abs(fresh - force).mean() > 0.1


@pytest.mark.slow
def test_micro_slip_of_a_joint_is_named_at_the_joint(tmp_path):
    rig = slipping_case(tmp_path)
    result = diagnose(load_case(tmp_path)).diagnosis
    assert result.verdict == "missing-physics"
    (finding,) = result.findings
    assert (finding.family, finding.place) == (EFFECTS[rig.effect].family, rig.place)
    assert rig.effect in finding.alike


@pytest.mark.slow
def test_hysteresis_of_a_drive_is_named_with_its_growth(tmp_path):
    rig = driven_case(tmp_path)
    result = diagnose(load_case(tmp_path)).diagnosis
    assert result.verdict == "missing-physics"
    (finding,) = result.findings
    assert (finding.effect, finding.place) == (rig.effect, rig.place)
    assert finding.parameters["growth"]["value"] == pytest.approx(rig.parameters["growth"], rel=0.1)
