"""The laws by themselves: step by step as all at once, energy, and closed forms."""

import numpy as np
import pytest
from physics_rig import CHANNEL_VALUES, PORT_VALUES

from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import PickUp, Step

H = 1e-3
COVERS = {
    1: "added-mass", 2: "rotary-inertia", 3: "lost-stiffness", 4: "joint-flexibility", 5: "tension-error",
    6: "temperature-drift", 7: "cable-slack", 8: "cable-string-mode", 9: "hardening", 10: "initial-curvature",
    11: "stiffness-to-ground", 12: "structural-damping", 13: "viscous-damping", 14: "quadratic-drag",
    15: "air-added-mass", 16: "coulomb-friction", 17: "jenkins-slip", 18: "bouc-wen", 19: "lugre-friction",
    20: "backlash", 21: "stop", 22: "loosening", 23: "plastic-set", 24: "coil-force-over-travel",
    25: "magnetic-negative-stiffness", 26: "back-emf", 27: "coil-inductance", 28: "actuator-clipping", 29: "slew-limit",
    30: "actuator-gain", 31: "actuator-delay", 32: "actuator-hold", 33: "filter-corner", 34: "sensor-gain",
    35: "sensor-high-pass", 36: "crosstalk", 37: "floor-motion",
}  # fmt: skip
"""One name for each row of the list of effects that real laboratories have."""


def test_every_effect_of_the_list_has_a_name():
    from vlab.physics.catalogue import effect_named

    assert list(COVERS) == list(range(1, 38))
    for name in COVERS.values():
        effect = effect_named(name)
        assert all([effect.words, effect.law, effect.parameters])
        for p in effect.parameters:
            assert p.low < p.high
            assert p.unit
            assert p.role == "amplitude" or p.grid
            assert 0.0 not in p.grid  # which no factor moves away from


@pytest.mark.parametrize("name", [n for n in CHANNEL_VALUES if not isinstance(EFFECTS[n], PickUp)])
def test_step_by_step_is_the_same_as_all_at_once(name):
    effect, values = EFFECTS[name], CHANNEL_VALUES[name][1]
    t = np.arange(400) * H
    x = 0.02 * np.sin(2 * np.pi * 7 * t) + 0.01 * np.random.default_rng(1).standard_normal(t.size)
    x *= 1000.0 if effect.kind == "actuator" else 1.0
    if effect.kind == "actuator":
        whole, step = effect.actuate(x, values, H), effect.stepper(values, H)
        single = [step(v) for v in x.tolist()]
    else:
        whole, step = effect.sense(x, values, H, t), effect.stepper(values, H)
        single = [step(v, s, 0.0) for v, s in zip(x.tolist(), t.tolist(), strict=True)]
    assert np.allclose(single, whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())
    two = np.stack([x, -x], axis=1)  # several signals side by side, time along the first axis
    both = effect.actuate(two, values, H) if effect.kind == "actuator" else effect.sense(two, values, H, t)
    assert np.allclose(both[:, 0], whole)


def test_what_a_correction_does_to_noise_is_told_and_has_an_end():
    """A resonance at 40 Hz, sampled at 1 kHz: its plain inverse would magnify the noise 80 times, and the band holds none of that."""
    t = np.arange(4000) * H
    noise = np.random.default_rng(3).standard_normal(t.size)
    for name, values in (
        ("sensor-gain", {"gain": 0.25}),
        ("sensor-delay", {"delay": 2.3e-3}),
        ("sensor-lag", {"time_constant": 2e-3}),
        ("sensor-resonance", {"frequency": 40.0, "damping_ratio": 0.1}),
    ):
        effect = EFFECTS[name]
        assert np.std(effect.correct(noise, values, H, t)) == pytest.approx(effect.growth(values, H), rel=0.05)
        below = np.sin(2 * np.pi * 25 * t) * np.sin(np.pi * t / t[-1])
        back = effect.correct(effect.sense(below, values, H, t), values, H, t)
        assert np.abs(back - below).max() < 0.02
    assert effect.growth(values, H) < 3.0


def work(name, values, z, v, h):
    """Return the energy that a law takes out of a motion, sample by sample."""
    effect, out = EFFECTS[name], []
    memory = effect.memory(())
    for k, (zk, vk) in enumerate(zip(z.tolist(), v.tolist(), strict=True)):
        force, memory = effect.force(zk, vk, values, Step(h, k * h, 1e-6, vk), memory)
        out.append(-force * vk * h)
    return np.cumsum(out)


@pytest.mark.parametrize("name", ["quadratic-drag", "coulomb-friction", "smooth-friction", "stribeck-friction"])
def test_drag_and_friction_only_take_energy(name):
    rng, h = np.random.default_rng(3), H
    v = np.cumsum(rng.standard_normal(2000)) * 0.01
    assert np.all(np.diff(work(name, PORT_VALUES[name][1], np.cumsum(v) * h, v, h)) >= 0)


@pytest.mark.parametrize(
    "name", ["jenkins-slip", "iwan-slip", "bouc-wen", "lugre-friction", "structural-damping", "attached-oscillator"]
)
@pytest.mark.parametrize("hz", [1.0, 4.0, 9.0])
def test_hysteresis_takes_energy_in_every_cycle(name, hz):
    h = 2e-4
    t = np.arange(int(12 / hz / h)) * h + h / 2
    z, v = 0.01 * np.sin(2 * np.pi * hz * t), 0.02 * np.pi * hz * np.cos(2 * np.pi * hz * t)
    taken = work(name, PORT_VALUES[name][1], z, v, h)
    cycle = round(1 / hz / h)
    assert np.all(taken[5 * cycle :: cycle][1:] > taken[5 * cycle :: cycle][:-1])


@pytest.mark.slow
@pytest.mark.parametrize("octaves", [-3.3, 0.0, 3.3])
def test_the_loss_factor_is_constant_over_two_decades(octaves):
    loss, centre, h = 60.0, 4.0, 1e-4
    hz = centre * 2.0**octaves
    t = np.arange(int(16 / hz / h)) * h + h / 2
    z, v = 0.01 * np.sin(2 * np.pi * hz * t), 0.02 * np.pi * hz * np.cos(2 * np.pi * hz * t)
    taken = work("structural-damping", {"loss": loss, "centre": centre}, z, v, h)
    cycle = round(1 / hz / h)
    # a loss stiffness takes pi loss A^2 a cycle; three elements ripple: 1 at the centre, 0.87 a decade off
    assert (taken[15 * cycle] - taken[14 * cycle]) / (np.pi * loss * 1e-4) == pytest.approx(
        1.0 if octaves == 0 else 0.87, abs=0.02
    )


def test_jenkins_loop_has_the_area_of_its_parallelogram():
    force, slip, amplitude, h = 2.0, 4e-3, 0.01, 1e-4
    t = np.arange(30000) * h + h / 2
    z, v = amplitude * np.sin(2 * np.pi * t), 2 * np.pi * amplitude * np.cos(2 * np.pi * t)
    taken = work("jenkins-slip", {"force": force, "slip": slip}, z, v, h)
    assert taken[29999] - taken[19999] == pytest.approx(4 * force * (amplitude - slip), rel=1e-3)


def test_a_plastic_set_stays():
    effect, values = EFFECTS["plastic-set"], {"stiffness": 100.0, "yield": 1.0}
    memory = effect.memory(())
    for z in (0.5, 1.4, 0.0):
        force, memory = effect.force(z, 0.0, values, Step(H), memory)
    assert force == pytest.approx(100.0 * 0.4)
    small = effect.force(0.9, 0.0, values, Step(H), effect.memory(()))[0]
    assert small == 0.0


def test_an_attached_oscillator_weighs_its_mass_when_moved_slowly():
    effect, h = EFFECTS["attached-oscillator"], 1e-3
    values, hz = {"mass": 2.0, "frequency": 20.0, "damping_ratio": 0.5}, 0.5
    t = np.arange(8000) * h + h / 2
    w = 2 * np.pi * hz
    memory, out = effect.memory(()), []
    for z, v in zip(np.sin(w * t).tolist(), (w * np.cos(w * t)).tolist(), strict=True):
        force, memory = effect.force(z, v, values, Step(h), memory)
        out.append(force)
    expected = 2.0 * w * w * np.sin(w * t)  # -m a
    assert np.abs(out - expected)[4000:].max() < 0.03 * expected.max()  # D w/w0 = 0.025 in quadrature


def test_a_hold_near_a_whole_number_of_samples_keeps_that_pattern():
    """What is held must not change with the last digit of the period: a fit's steps would leave the right one."""
    u, h = np.arange(40.0), 1e-3
    held = np.repeat(u[::4], 4)
    for period in (3.95e-3, 4e-3 * (1 - 1e-12), 4e-3, 4e-3 * (1 + 1e-12), 4.05e-3):
        np.testing.assert_array_equal(EFFECTS["actuator-hold"].actuate(u, {"period": period}, h), held)
    between = EFFECTS["actuator-hold"].actuate(u, {"period": 3.5e-3}, h)
    assert sorted(set(np.diff(np.unique(between)))) == [3.0, 4.0]  # a clock of its own takes now three, now four


def test_a_soft_limit_of_a_sensor_is_taken_off_as_far_as_it_tells():
    """The correction is the inverse of the law; beyond 98 % of the limit it says no more than atanh(.98) = 2.298 limits."""
    effect, p = EFFECTS["sensor-soft-saturation"], {"limit": 0.5}
    x, t = np.linspace(-1.0, 1.0, 201), np.zeros(201)
    y = effect.sense(x, p, 1e-3, t)
    assert np.abs(y).max() < 0.5
    np.testing.assert_allclose(effect.correct(y, p, 1e-3, t), x, rtol=1e-12, atol=1e-15)
    far = effect.correct(np.array([0.5, -0.7]), p, 1e-3, t[:2])
    np.testing.assert_allclose(far, [0.5 * np.arctanh(0.98), -0.5 * np.arctanh(0.98)])


def test_a_hold_near_whole_samples_is_one_of_whole_samples():
    hold = EFFECTS["actuator-hold"]
    u = np.random.default_rng(5).standard_normal(300)
    for period, taken in ((0.00396, 0.004), (0.00403, 0.004), (0.0043, 0.0043)):
        assert hold.taken({"period": period}, 0.002)["period"] == pytest.approx(taken, rel=1e-12)
        np.testing.assert_array_equal(
            hold.actuate(u, {"period": period}, 0.002), hold.actuate(u, {"period": taken}, 0.002)
        )
