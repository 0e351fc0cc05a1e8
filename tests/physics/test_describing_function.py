"""Describing functions against closed forms, conservation of energy and a second method."""

import numpy as np
import pytest

from vlab.physics.catalogue import EFFECTS
from vlab.physics.describing_function import (
    channel_gain,
    dependence,
    describing_function,
    gaussian_mean,
    has_describing_function,
    trial_values,
)
from vlab.physics.effect import PortEffect, Step

A = np.array([0.3, 1.0, 2.5])
OMEGA = 7.0
NONLINEAR = {
    *("quadratic-drag", "cubic-stiffness", "cubic-quintic-stiffness", "string-stiffness", "coulomb-friction"),
    *("smooth-friction", "stribeck-friction", "dead-band", "stop", "jenkins-slip", "bouc-wen", "lugre-friction"),
    *("plastic-set", "actuator-clipping", "soft-saturation", "actuator-dead-zone", "slew-limit", "rate-limit"),
    *("actuator-quantisation", "sensor-clipping", "sensor-soft-saturation", "sensor-quantisation"),
    *("iwan-slip", "actuator-hysteresis", "unknown-law"),
}


def saturation(ratio):
    """Return the closed form of a unit limit at `ratio` = limit/amplitude (Gelb and Vander Velde, table B.1)."""
    r = np.minimum(ratio, 1.0)
    return 2 / np.pi * (np.arcsin(r) + r * np.sqrt(1 - r**2))


def jenkins(force, slip, a):
    """Return the closed form of a slider with a spring: Masing's loop, k = force/slip (Iwan 1966)."""
    k = force / slip
    turn = np.arccos(1 - 2 * slip / np.maximum(a, slip))
    stored = k / np.pi * (turn - 0.5 * np.sin(2 * turn))
    lost = k / np.pi * np.sin(turn) ** 2
    return np.where(a <= slip, k, stored + 1j * lost)


CLOSED = {
    "coulomb-friction": ({"force": 2.0}, lambda a: 4j * 2.0 / (np.pi * a)),
    "cubic-stiffness": ({"k3": 3.0}, lambda a: 0.75 * 3.0 * a**2),
    "cubic-quintic-stiffness": ({"k3": 3.0, "k5": -0.4}, lambda a: 0.75 * 3.0 * a**2 - 0.625 * 0.4 * a**4),
    "quadratic-drag": ({"coefficient": 2.0}, lambda a: 8j / (3 * np.pi) * 2.0 * OMEGA**2 * a),
    "dead-band": ({"stiffness": 5.0, "gap": 0.8}, lambda a: -5.0 * saturation(0.8 / a)),
    "stop": ({"stiffness": 5.0, "gap": 0.8}, lambda a: 5.0 * (1 - saturation(0.8 / a))),
    "jenkins-slip": ({"force": 2.0, "slip": 0.5}, lambda a: jenkins(2.0, 0.5, a)),
}


@pytest.mark.parametrize("name", list(CLOSED))
def test_a_port_law_has_its_closed_form(name):
    values, exact = CLOSED[name]
    found = describing_function(EFFECTS[name], values, A, OMEGA)
    # 256 samples a cycle: a jump or an edge between samples errs by (pi/256)^2 of the whole
    assert np.allclose(found, exact(A), rtol=3e-4, atol=3e-4 * np.abs(exact(A)).max())


@pytest.mark.parametrize(
    ("name", "values", "exact"),
    [
        ("actuator-clipping", {"limit": 0.8}, lambda a: saturation(0.8 / a)),
        ("actuator-dead-zone", {"threshold": 0.8}, lambda a: 1 - saturation(0.8 / a)),
        ("sensor-clipping", {"limit": 0.8}, lambda a: saturation(0.8 / a)),
    ],
)
def test_a_channel_law_has_its_closed_form(name, values, exact):
    assert np.allclose(channel_gain(EFFECTS[name], values, A, OMEGA), exact(A), atol=3e-4)


def test_a_slew_limit_makes_a_triangle_of_the_limited_slope():
    slope, a = 1.0, 5.0  # far beyond the limit the output is a triangle of amplitude (slope/omega)(pi/2)
    found = channel_gain(EFFECTS["slew-limit"], {"slope": slope}, a, OMEGA)
    assert abs(found) == pytest.approx(8 / np.pi**2 * slope / OMEGA * np.pi / 2 / a, rel=2e-3)
    assert np.degrees(np.angle(found)) < -85.0  # and lags by nearly a quarter of a cycle


@pytest.mark.slow
def test_the_nonlinear_effects_of_the_catalogue_are_found_by_trying():
    # laws of one side have a mean force, a coil's travel acts with the command, drifts and hum are not periodic
    assert {name for name, effect in EFFECTS.items() if has_describing_function(effect)} == NONLINEAR


def test_laws_depend_on_displacement_velocity_or_both():
    kinds = {name: dependence(EFFECTS[name]) for name in ("cubic-stiffness", "quadratic-drag", "lugre-friction")}
    assert kinds == {"cubic-stiffness": "displacement", "quadratic-drag": "velocity", "lugre-friction": "both"}


@pytest.mark.parametrize("name", sorted(n for n in NONLINEAR if isinstance(EFFECTS[n], PortEffect)))
def test_no_passive_law_gives_energy(name):
    effect = EFFECTS[name]
    z = describing_function(effect, trial_values(effect), np.geomspace(0.05, 20.0, 30), OMEGA)
    assert z.imag.min() > -1e-6 * np.abs(z).max()


@pytest.mark.parametrize("name", ["jenkins-slip", "bouc-wen", "coulomb-friction"])
def test_the_loss_is_the_area_of_the_loop(name):
    """pi a^2 Im Z is the work of a cycle, here from the trapezoidal rule over the loop."""
    effect, a, n = EFFECTS[name], 1.5, 4096
    values = trial_values(effect)
    memory, work = effect.memory(()), 0.0
    for k in range(3 * n):
        angle, h = 2 * np.pi * (k + 0.5) / n, 2 * np.pi / OMEGA / n
        v = a * OMEGA * np.cos(angle)
        force, memory = effect.force(a * np.sin(angle), v, values, Step(h, k * h, 1e-200), memory)
        work -= float(force) * v * h if k >= 2 * n else 0.0
    z = complex(describing_function(effect, values, a, OMEGA))
    assert np.pi * a**2 * z.imag == pytest.approx(work, rel=2e-3)


@pytest.mark.parametrize(
    ("name", "values", "exact"),
    [
        # E[F z]/s^2 of a cubic spring is 3 k3 s^2, E[F v]/E[v^2] of drag is c sqrt(8/pi) s_v, of friction Fc sqrt(2/pi)/s_v
        ("cubic-stiffness", {"k3": 2.0}, lambda s: 3 * 2.0 * s**2),
        ("quadratic-drag", {"coefficient": 2.0}, lambda s: 1j * OMEGA * 2.0 * np.sqrt(8 / np.pi) * OMEGA * s),
        ("coulomb-friction", {"force": 2.0}, lambda s: 1j * OMEGA * 2.0 * np.sqrt(2 / np.pi) / (OMEGA * s)),
    ],
)
def test_the_gaussian_mean_is_the_statistical_linearisation(name, values, exact):
    s = np.array([0.4, 1.1])
    found = gaussian_mean(lambda a: describing_function(EFFECTS[name], values, a, OMEGA), s)
    # 24 quantiles of the weighted amplitudes
    assert np.allclose(found, exact(s), rtol=0.02)
