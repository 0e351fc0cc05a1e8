"""Physics at the places of the two structures, and in the laboratory's loop."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from vlab.controllers import DirectRateFeedback
from vlab.fe import build_fe_model
from vlab.hardware import load_hardware
from vlab.lab.excitation import build_excitation
from vlab.lab.experiment import Experiment, run_experiment
from vlab.lab.laws import published_law
from vlab.physics.attach import Attached, attach, port_at
from vlab.physics.catalogue import effect_named
from vlab.plants import build_plant
from vlab.structure import load_structure

VARIANTS = {"beam": "published", "grid": "physical"}


@lru_cache(maxsize=8)
def plant_of(structure, kind):
    return build_plant(load_structure(structure), kind, VARIANTS[structure])


def with_effects(plant, *effects):
    return attach(plant, [Attached(effect_named(name), at, values) for name, at, values in effects])


@pytest.mark.parametrize("kind", ["composite", "fe", "modal"])
@pytest.mark.parametrize(
    ("structure", "places"),
    [
        ("beam", "base 40in top beam:30in-40in clamp crosspiece-left crosspiece-right tip-left cable-lower cable-upper tension floor coil:base"),
        ("grid", "joint1 point21 bar:5-9 bar:13-14 plate13 plate22 top-beam floor"),
    ],
)  # fmt: skip
def test_every_plant_has_the_places_that_cases_name(structure, places, kind):
    for place in places.split():
        port = port_at(plant_of(structure, kind), place)
        assert np.any(port.row(plant_of(structure, kind).new_data()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("structure", "place", "effect", "values", "tolerance"),
    [
        ("beam", "40in", "added-mass", {"mass": 0.1}, 0.02),
        ("beam", "cable-lower", "lost-stiffness", {"share": 0.2}, 0.02),
        ("beam", "tension", "tension-error", {"tension": 30.0}, 0.02),
        ("beam", "crosspiece-left", "lost-stiffness", {"share": 0.2}, 0.02),
        ("beam", "clamp", "lost-stiffness", {"share": 0.2}, 0.1),  # two hinges a span against cubic elements
        ("beam", "beam:30in-40in", "lost-stiffness", {"share": 0.2}, 0.15),
        ("grid", "bar:5-9", "lost-stiffness", {"share": 0.2}, 0.1),
        ("grid", "plate13", "lost-stiffness", {"share": 0.2}, 0.02),
    ],
)
def test_the_native_plant_and_the_fe_plant_shift_alike(structure, place, effect, values, tolerance):
    shifts = []
    for kind in ("composite", "fe"):
        plant = plant_of(structure, kind)
        before, after = plant.linearise().freq[:4], with_effects(plant, (effect, place, values)).linearise().freq[:4]
        shifts.append(after / before - 1)
    assert np.abs(shifts[1]).max() > 1e-4
    assert shifts[0] == pytest.approx(shifts[1], abs=tolerance * np.abs(shifts[1]).max())


def test_a_tension_error_is_another_tension():
    beam = load_structure("beam")
    cable = next(c for c in beam.cable if c.tension is not None)
    more = replace(cable, tension=cable.tension + 20.0)
    tight = replace(beam, cable=tuple(more if c is cable else c for c in beam.cable))
    expected = build_fe_model(tight).linear.freq[:6] / build_fe_model(beam).linear.freq[:6] - 1
    plant = plant_of("beam", "fe")
    own = with_effects(plant, ("tension-error", "tension", {"tension": 20.0}))
    got = own.linearise().freq[:6] / plant.linearise().freq[:6] - 1
    # w' is taken as constant over 10 in: (k h)^2/12 of the tension's share, 10 % at the sixth mode
    assert got[:3] == pytest.approx(expected[:3], rel=0.02)
    assert got == pytest.approx(expected, rel=0.12)


def experiment(plant, *, law=None, excite="multisine", seconds=1.0):
    excitation = build_excitation(
        excite, level=0.1, low_hz=None, high_hz=None, period_s=None, odd=None, seed=None if excite == "release" else 0
    )
    return run_experiment(
        Experiment(plant=plant, seconds=seconds, excitation=excitation, excite="base", controller=law)
    ).recording


def test_a_plant_rings_at_the_frequencies_that_its_linearisation_says():
    # released from a deflection without damping the motion is a sum of cosines of the linear model's own modes
    plant = with_effects(
        plant_of("beam", "modal"),
        ("added-mass", "40in", {"mass": 0.3}),
        ("lost-stiffness", "cable-upper", {"share": 0.3}),
    )
    assert len(plant.physics) == 2
    recording = experiment(plant, excite="release", seconds=2.0)
    linear = plant.linearise()
    omega, shapes = linear.eigen
    load = plant.port("base").row(None)
    at, t = plant.port("40in").row(None), recording.time
    modal = (shapes.T @ load) * 0.1
    zeta = np.einsum("ji,jk,ki->i", shapes, linear.C, shapes) / (2 * omega)
    damped = omega * np.sqrt(1 - zeta**2)
    # q(t) of a released mode: v = -q0 w/sqrt(1-z^2) e^(-z w t) sin(wd t)
    speed = -np.exp(-np.outer(t, zeta * omega)) * np.sin(np.outer(t, damped)) * (modal / omega / np.sqrt(1 - zeta**2))
    expected = speed @ (at @ shapes)
    # the 12th mode at 60 Hz drifts by (w h)^2/24 = 0.15 % of its phase; it carries little
    assert np.std(recording["sensor:40in"] - expected) < 0.03 * np.std(expected)


def test_a_gain_of_all_actuators_is_a_gain_of_the_law():
    beam, plant = load_structure("beam"), plant_of("beam", "modal")
    law = published_law(beam, "mfdrf")
    half = DirectRateFeedback(1.5 * law.gains, sensors=law.sensors, actuators=law.actuators)
    driven = {"excite": "release"}
    one = experiment(with_effects(plant, ("actuator-gain", "chain", {"gain": 0.5})), law=law, **driven)
    two = experiment(plant, law=half, **driven)
    assert np.allclose(one["sensor:40in"], two["sensor:40in"], rtol=0, atol=1e-9 * np.abs(two["sensor:40in"]).max())
    # what the laboratory records is what it asked for
    assert np.allclose(1.5 * one["force:base"], two["force:base"], rtol=0, atol=1e-9 * np.abs(two["force:base"]).max())


def test_the_law_sees_what_a_sensor_says():
    beam, plant = load_structure("beam"), plant_of("beam", "modal")
    law = published_law(beam, "mfdrf")
    index = law.sensors.index("40in")
    gains = law.gains.copy()
    gains[:, index] *= 1.2
    stronger = DirectRateFeedback(gains, sensors=law.sensors, actuators=law.actuators)
    one = experiment(with_effects(plant, ("sensor-gain", "sensor:40in", {"gain": 0.2})), law=law)
    two = experiment(plant, law=stronger)
    largest = np.abs(two["sensor:40in"]).max()
    assert np.allclose(one["sensor:40in"], 1.2 * two["sensor:40in"], rtol=0, atol=1e-9 * largest)
    assert np.allclose(one["sensor:base"], two["sensor:base"], rtol=0, atol=1e-9 * largest)


def test_noise_comes_after_the_sensor():
    plant = plant_of("beam", "modal")
    noisy = replace(load_hardware(), velocity_sensor=replace(load_hardware().velocity_sensor, noise=1e-3))
    runs = [
        run_experiment(Experiment(plant=p, seconds=1.0, hardware=noisy, seed=3)).recording["sensor:base"]
        for p in (plant, with_effects(plant, ("sensor-gain", "sensor:base", {"gain": 1.0})))
    ]
    assert np.array_equal(*runs)  # nothing moves, so there is nothing to magnify


def test_the_floor_pushes_all_masses_alike():
    # the modes' participation is the same in links, in elements and in modal coordinates
    shares = []
    for kind in ("composite", "fe", "modal"):
        plant = plant_of("beam", kind)
        shares.append(np.abs(plant.linearise().eigen[1].T @ port_at(plant, "floor").row(None))[:6])
    assert shares[0] == pytest.approx(shares[1], abs=0.01 * shares[1].max())
    assert shares[2] == pytest.approx(shares[1], abs=1e-6 * shares[1].max())
    moved = experiment(
        with_effects(plant, ("sinusoidal-force", "floor", {"sine": 0.1, "cosine": 0.0, "frequency": 2.0}))
    )
    assert np.std(moved["sensor:40in"] - experiment(plant)["sensor:40in"]) > 0
