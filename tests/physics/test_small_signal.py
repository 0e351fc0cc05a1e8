"""Effects in frequency, taken from laws that run in time: against the closed forms of the same laws."""

import numpy as np
import pytest

from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import Parameter, PortEffect
from vlab.physics.port_memory import RATES
from vlab.physics.small_signal import channel_response, is_linear, small_signal

FREQ = np.linspace(0.5, 20.0, 40)
S = 2j * np.pi * FREQ
LINEAR = {
    *("added-mass", "rotary-inertia", "lost-stiffness", "stiffness-to-ground", "magnetic-negative-stiffness"),
    *("tension-error", "viscous-damping", "attached-oscillator", "structural-damping", "actuator-gain"),
    *("actuator-delay", "actuator-lag", "sensor-gain", "sensor-delay", "sensor-lag", "sensor-high-pass"),
    *("sensor-resonance", "crosstalk", "cross-axis", "misplaced-sensor"),
}


def test_the_linear_effects_of_the_catalogue_are_found_by_trying():
    # clips, gaps, friction and polynomials are not linear; offsets, hum, drift, jitter and holds are not time-invariant
    assert {name for name, effect in EFFECTS.items() if is_linear(effect)} == LINEAR


def test_an_attached_oscillator_resists_as_its_closed_form():
    mass, hz, damping = 0.3, 5.0, 0.02
    w = 2 * np.pi * hz
    values = {"mass": mass, "frequency": hz, "damping_ratio": damping}
    law = small_signal(EFFECTS["attached-oscillator"], values, 0.0, abs(S[-1]))
    exact = mass * S**2 * (w**2 + 2 * damping * w * S) / (S**2 + 2 * damping * w * S + w**2)
    # the law is measured in steps of 1e-4 rad: an error of second order in that
    assert np.allclose(law.impedance(S), exact, rtol=1e-6)
    poles = np.linalg.eigvals(law.A)
    assert np.allclose(np.abs(poles), w, rtol=1e-5)


def test_structural_damping_loses_what_its_maxwell_elements_lose():
    loss, centre = 3.0, 4.0
    law = small_signal(EFFECTS["structural-damping"], {"loss": loss, "centre": centre}, 0.0, abs(S[-1]))
    r = S[:, None] / (2 * np.pi * centre * np.array(RATES))
    at = 1j / np.array(RATES)
    scale = loss / np.sum(np.imag(at / (1 + at)))
    exact = scale * (np.sum(r / (1 + r), axis=1) - np.sum(np.real(at / (1 + at))))
    assert np.allclose(law.impedance(S), exact, rtol=1e-4, atol=1e-5 * loss)


@pytest.mark.parametrize(
    ("name", "values", "exact"),
    [
        ("actuator-gain", {"gain": -2.0}, lambda s: -1.0 + 0 * s),
        ("actuator-delay", {"delay": 0.003}, lambda s: np.exp(-0.003 * s)),
        ("actuator-lag", {"time_constant": 0.02}, lambda s: 1 / (1 + 0.02 * s)),
        ("sensor-high-pass", {"time_constant": 0.5}, lambda s: 0.5 * s / (1 + 0.5 * s)),
        ("sensor-lag", {"time_constant": 0.5}, lambda s: 1 / (1 + 0.5 * s)),
    ],
)
def test_a_filter_is_given_by_its_response_to_an_impulse(name, values, exact):
    # 64 samples a cycle at the highest frequency: straight lines between samples are off by (pi/64)^2/3 = 0.08 %
    assert np.abs(channel_response(EFFECTS[name], values, FREQ) - exact(S)).max() < 1.5e-3


def test_a_users_own_linear_effect_needs_no_formula():
    class Foam(PortEffect):
        name, family, law, words = "foam", "damping", "Kelvin and Voigt", "foam"
        parameters = (Parameter(name="stiffness", unit="N/m", low=1.0, high=10.0),)

        def force(self, z, v, p, step, memory):
            return -p["stiffness"] * (z + 0.1 * v), memory

    assert is_linear(Foam())
    assert np.allclose(small_signal(Foam(), {"stiffness": 5.0}, 0.0, 100.0).impedance(S), 5.0 * (1 + 0.1 * S))
