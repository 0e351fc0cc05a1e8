"""Hold, delay and filter against their theory."""

import numpy as np
import pytest
from vlab.controllers.sampling import delay_split

from vlab.errors import BadExperiment
from vlab.hardware import load_hardware
from vlab.hardware.laboratory import Converter
from vlab.hardware.output_chain import OutputChain, theoretical_response


def converter(**settings) -> Converter:
    return Converter(
        **{"rate": 2000.0, "lowest_rate": 2.0, "highest_rate": 2000.0, "delay_samples": 1.35, "filter_corner": 677.0}
        | settings
    )


def measured_response(parts: Converter, freq: float, substeps: int) -> complex:
    """Drive the chain with a sampled sine and take the fundamental of the forces at the middles of the steps."""
    samples = round(20 * parts.rate / freq) * 5
    samples -= samples % round(parts.rate / np.gcd(round(parts.rate), round(freq)))  # whole periods of both
    chain = OutputChain(parts, channels=1, substeps=substeps)
    t = np.arange(samples) / parts.rate
    forces = np.concatenate([chain.push(np.array([u])).copy() for u in np.sin(2 * np.pi * freq * t)])[:, 0]
    middle = (np.arange(samples * substeps) + 0.5) / (parts.rate * substeps)
    second_half = middle > t[-1] / 2
    mean = 2j * np.mean(forces[second_half] * np.exp(-2j * np.pi * freq * middle[second_half]))
    return mean / np.sinc(freq / (parts.rate * substeps))  # means over a step, not values


@pytest.mark.parametrize(("freq", "degrees"), [(10.0, 0.1), (41.0, 0.1), (100.0, 0.3)])
@pytest.mark.parametrize("substeps", [1, 4])
def test_phase_of_delay_and_filter_is_that_of_theory(laboratory, freq, degrees, substeps):
    # asked for: 0.1 deg at 10 and 41 Hz, 0.3 deg at 100 Hz
    measured = measured_response(laboratory.converter, freq, substeps)
    theory = theoretical_response(laboratory.converter, np.array([freq]))[0]
    assert abs(np.degrees(np.angle(measured / theory))) < degrees
    assert abs(measured) == pytest.approx(abs(theory), rel=5e-3)


def test_theory_of_the_laboratory_chain_is_known_numbers():
    # 1.35 and 0.5 samples at 2 kHz and the corner at 677 Hz, at 41 Hz: 360 * 41 * 1.85 / 2000 + atan(41/677)
    theory = theoretical_response(converter(), np.array([41.0]))[0]
    assert np.degrees(np.angle(theory)) == pytest.approx(
        -(360 * 41 * 1.85 / 2000 + np.degrees(np.arctan(41 / 677))), abs=1e-9
    )


def test_delay_without_filter_moves_the_stair_exactly():
    chain = OutputChain(converter(filter_corner=0.0), channels=1)
    forces = [float(chain.push(np.array([u]))[0, 0]) for u in (1.0, 0.0, 0.0, 0.0)]
    assert forces == pytest.approx([0.0, 0.65, 0.35, 0.0], abs=1e-12)  # the unit stair from 1.35 to 2.35 samples


def test_no_delay_and_no_filter_is_a_plain_hold():
    chain = OutputChain(converter(filter_corner=0.0, delay_samples=0.0), channels=2, substeps=3)
    assert np.array_equal(chain.push(np.array([1.0, -2.0])), np.tile([1.0, -2.0], (3, 1)))


def test_filter_step_response_is_exponential():
    parts = converter(delay_samples=0.0)
    chain = OutputChain(parts, channels=1, substeps=2)
    forces = np.concatenate([chain.push(np.array([1.0])).copy() for _ in range(3)])[:, 0]
    a, edges = 2 * np.pi * 677.0, np.arange(7) / 4000.0
    exact = 1 + np.diff(np.exp(-a * edges)) / (a / 4000.0)  # mean of 1 - exp(-a t) over every step
    assert forces == pytest.approx(exact, rel=1e-12)


def test_impulse_is_conserved():
    # every command reaches the coil in the end: sum of forces over steps = sum of commands over samples
    for delay in (0.0, 0.3, 1.0, 1.35, 2.999999999999):
        chain = OutputChain(converter(delay_samples=delay), channels=1, substeps=2)
        total = sum(float(chain.push(np.array([u])).sum()) / 2 for u in [1.0, *[0.0] * 40])
        assert total == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("substeps", [1, 3])
def test_a_whole_run_at_once_is_the_same_as_sample_by_sample(substeps):
    commands = np.random.default_rng(0).standard_normal((50, 2))
    chain = OutputChain(converter(), channels=2, substeps=substeps)
    one_by_one = np.concatenate([chain.push(u).copy() for u in commands])
    assert chain.response(commands) == pytest.approx(one_by_one, abs=1e-13)  # rounding


def test_reset_forgets():
    chain = OutputChain(converter(), channels=1)
    first = [chain.push(np.array([u])).copy() for u in (1.0, 2.0, 3.0)]
    chain.reset()
    assert np.array_equal(first, [chain.push(np.array([u])).copy() for u in (1.0, 2.0, 3.0)])


def test_delay_split_takes_up_rounding():
    assert delay_split(1.35) == (1, pytest.approx(0.35))
    assert delay_split(2.9999999999) == (3, 0.0)


@pytest.mark.parametrize("rate", [1.0, 2001.0])
def test_rates_outside_the_converter_are_refused(laboratory, rate):
    with pytest.raises(BadExperiment, match="outside the converter's 2 to 2000 Hz"):
        laboratory.at_rate(rate)


def test_the_laboratory_is_that_of_the_text():
    hardware = load_hardware()
    assert (hardware.converter.rate, hardware.converter.delay_samples, hardware.converter.filter_corner) == (
        2000.0,
        1.35,
        677.0,
    )
    assert hardware.velocity_sensor.linear_range == pytest.approx(0.25 * 0.0254)
    assert hardware.displacement_probe.sensitivity == pytest.approx(1 / 0.0254)
    assert hardware.coil.back_emf_damping == 0.0
