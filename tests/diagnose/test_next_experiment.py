"""The computed next experiment against scaling laws of linear models and of friction."""

from dataclasses import replace

import numpy as np
import pytest
import rig_oscillator
from rig_oscillator import oscillator_case

from vlab.cases import load_case
from vlab.diagnose.settings import VALIDATION
from vlab.diagnose.validation.next_experiment import experiments, in_words
from vlab.diagnose.validation.simulation import ExtendedModel, check
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import EFFECTS


@pytest.fixture
def rig(tmp_path, monkeypatch):
    monkeypatch.setattr(rig_oscillator, "SECONDS", 4.0)
    oscillator_case(tmp_path, benign=0.0)
    case = load_case(tmp_path)
    return case.plant, [replace(run, before=None, initial="rest") for run in case.runs(("holdout",))]


def model(plant, name, place, **values):
    return ExtendedModel(plant=attach(plant, [Attached(effect=EFFECTS[name], place=place, values=values)], channels=[]))


def within_noise(run):
    """Return errors of a model that leaves noise alone."""
    return replace(run, after=run.noise, channels={n: (a, b, c, c) for n, (a, b, c, _) in run.channels.items()})


@pytest.mark.slow
def test_linear_rivals_differ_in_proportion_to_the_level(rig):
    plant, runs = rig
    one = model(plant, "added-mass", "joint:mass2", mass=0.02)
    other = model(plant, "stiffness-to-ground", "joint:mass2", stiffness=10.0)
    checked = check(runs, one, None)
    of_noise = {e.recording: {} for e in experiments(one, other, runs, [within_noise(c) for c in checked])}
    for e in experiments(one, other, runs, [within_noise(c) for c in checked]):
        of_noise[e.recording][e.level] = e.separation
    assert len(of_noise) == len(runs)
    for separation in of_noise.values():
        for level in VALIDATION.levels:
            assert separation[level] == pytest.approx(level * separation[1.0], rel=1e-6)


@pytest.mark.slow
def test_friction_and_drag_are_separated_away_from_the_level_of_equal_loss(rig):
    """Friction loses 4 F a in a cycle of amplitude a, viscous damping pi c omega a^2: equal at one level only."""
    plant, runs = rig
    runs = [run for run in runs if "multisine" in run.name]
    omega = 2 * np.pi * 3.2  # of the first mode
    size = float(np.sqrt(2.0) * runs[0].measured["sensor3"].std())
    friction = model(plant, "coulomb-friction", "joint:mass3", force=0.1)
    viscous = model(plant, "viscous-damping", "joint:mass3", damping=4 * 0.1 / (np.pi * omega * size))
    found = experiments(friction, viscous, runs, check(runs, friction, None))
    assert found[0].level != 1.0
    assert found[0].separation > next(e.separation for e in found if e.level == 1.0)
    words = in_words(found, "friction", "damping")
    assert "times the excitation of other multisine" in words
    assert "friction and damping differ there" in words


@pytest.mark.slow
def test_rivals_that_do_the_same_leave_no_experiment(rig):
    plant, runs = rig
    one = model(plant, "added-mass", "joint:mass2", mass=0.02)
    assert in_words(experiments(one, one, runs, check(runs, one, None)), "a", "b") == ""
