"""The model in frequency: responses, modes and their derivatives against direct solutions and finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from frequency_rigs import CHAIN_EFFECTS, write_beam, write_chain

from vlab.cases import load_case
from vlab.diagnose.data.responses import Modes, _roughness, read_measured, thinned
from vlab.diagnose.inference.frequency_least_squares import Fitter, Point
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.frequency import answer
from vlab.diagnose.predictors.frequency_modes import ModelModes, model_modes, state_matrix
from vlab.diagnose.predictors.frequency_problem import prepare_frequency
from vlab.diagnose.predictors.frequency_residual import _modal_difference, tracked
from vlab.diagnose.search.frequency_screening import ScoreTest
from vlab.diagnose.settings import FREQUENCY_RESIDUAL
from vlab.diagnose.validation.frequency import check_frequency, extended_by
from vlab.errors import BadCase
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import EFFECTS


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chain")
    write_chain(folder, CHAIN_EFFECTS["added-mass"])
    return prepare_frequency(load_case(folder))


def term(problem, name, place, **values):
    found = next(p for p in problem.places if p.name == place)
    return Term(effect=EFFECTS[name], place=found, values=values)


HYPOTHESES = [
    [("lost-stiffness", "tendon:spring2", {"share": 0.3})],
    [("attached-oscillator", "joint:mass2", {"mass": 0.1, "frequency": 6.0, "damping_ratio": 0.03})],
    [("actuator-delay", "actuator:motor", {"delay": 0.004}), ("added-mass", "joint:mass3", {"mass": 0.2})],
    [("sensor-gain", "sensor:sensor2", {"gain": -0.4}), ("crosstalk", "sensor:sensor1/motor", {"share": 1e-4})],
    [("misplaced-sensor", "sensor:sensor1/sensor2", {"share": 0.2})],
]


@pytest.mark.parametrize("hypothesis", HYPOTHESES, ids=lambda h: "+".join(name for name, _, _ in h))
def test_derivatives_are_those_of_finite_differences(chain, hypothesis):
    terms = tuple(term(chain, name, place, **values) for name, place, values in hypothesis)
    fitter = Fitter(chain)
    rng = np.random.default_rng(0)
    point = Point(theta=0.3 * fitter.sd * rng.standard_normal(len(fitter.sd)), terms=terms)
    jacobian = fitter._stacked(point, 0.0)[1]
    step = 1e-5
    for k in range(jacobian.shape[1]):
        move = np.zeros(jacobian.shape[1])
        move[k] = step
        high, low = (fitter._stacked(fitter._moved(point, sign * move), 0.0)[0] for sign in (1, -1))
        slope = (high - low) / (2 * step)
        # by the effects' own parameters one-sided steps of 1e-4, over a damping ratio of 0.03: 0.3 %
        assert np.abs(slope - jacobian[:, k]).max() < 1e-2 * np.abs(jacobian[:, k]).max() + 1e-6


def test_a_trial_of_low_rank_is_the_model_solved_again(chain):
    fitter = Fitter(chain)
    point = Point(theta=np.zeros(len(fitter.sd)), terms=())
    lines = ScoreTest(fitter, point).lines[0]
    oscillator = term(chain, "attached-oscillator", "joint:mass2", mass=0.2, frequency=5.0, damping_ratio=0.05)
    data = chain.measured[0]
    from vlab.diagnose.predictors.frequency import at_port

    z = at_port(oscillator, oscillator.values, float(data.omega[-1])).impedance(1j * data.omega)
    quick = lines.with_port(z, lines.at(oscillator.place)).H
    direct = answer(chain.view, chain.state(point.theta), data, chain.wires, [oscillator]).H
    assert np.allclose(quick, direct, rtol=1e-8)


@pytest.mark.parametrize("hypothesis", HYPOTHESES, ids=lambda h: "+".join(name for name, _, _ in h))
def test_mujocos_linearisation_of_the_amended_plant_answers_as_the_search_does(chain, hypothesis):
    terms = tuple(term(chain, name, place, **values) for name, place, values in hypothesis)
    fit = Fitter(chain).fit(terms, np.zeros(len(chain.prior)), iterations=0)
    model = extended_by(chain, fit)
    checked = check_frequency([model] * 3, chain.measured)[0]
    own = answer(chain.view, chain.state(fit.theta), chain.measured[0], chain.wires, terms).H
    assert np.allclose(checked.answers[0], own, rtol=1e-5, atol=1e-8 * np.abs(own).max())


def test_a_light_oscillator_is_no_mode_of_the_structure(chain):
    light = term(chain, "attached-oscillator", "joint:mass2", mass=1e-4, frequency=5.0, damping_ratio=0.01)
    state = chain.state(np.zeros(len(chain.prior)))
    modes = model_modes(state_matrix(state, [light], 200.0), chain.view.m)
    assert np.sum(modes.part > 0.3) == 3
    heavy = term(chain, "attached-oscillator", "joint:mass2", mass=0.5, frequency=8.9, damping_ratio=0.01)
    modes = model_modes(state_matrix(state, [heavy], 200.0), chain.view.m)
    assert np.sum(modes.part > 0.3) == 4  # tuned to a mode it splits it into two that are the structure's in part


def test_modes_keep_their_order_and_none_is_passed_over_for_nothing():
    freq = np.array([1.0, 2.0, 3.0, 4.0])
    none = np.zeros((0, 0))
    modes = ModelModes(
        s=2j * np.pi * freq, left=none, right=np.zeros((4, 4)), poles=none, index=np.arange(4), m=4, part=np.ones(4)
    )
    sd = np.full(3, 0.01)
    table = Modes(
        name="m", role="fit", freq=np.array([1.08, 2.1, 3.2]), zeta=np.full(3, np.nan), at=(), shapes=np.zeros((3, 0)),
        freq_sd=sd, zeta_sd=sd, shape_sd=sd,
    )  # fmt: skip
    assert list(tracked(modes, table, np.zeros((0, 4)))) == [0, 1, 2]
    far = replace(table, freq=np.array([1.0, 3.0, 4.0]))
    assert list(tracked(modes, far, np.zeros((0, 4)))) == [0, 2, 3]


def test_a_model_without_oscillating_modes_is_far_from_every_measured_mode():
    none = np.zeros((0, 0))
    modes = ModelModes(
        s=np.zeros(0), left=none, right=np.zeros((1, 0)), poles=none, index=np.arange(0), m=1, part=np.zeros(0)
    )
    sd = np.full(2, 0.01)
    table = Modes(
        name="m", role="fit", freq=np.array([1.0, 2.0]), zeta=np.full(2, np.nan), at=("hinge",), shapes=np.ones((2, 1)),
        freq_sd=sd, zeta_sd=sd, shape_sd=sd,
    )  # fmt: skip
    rows, pairs = np.ones((1, 1)), np.full(2, -1)
    assert np.all(_modal_difference(modes, table, rows, pairs) == FREQUENCY_RESIDUAL.far)


# ---- what was measured ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1e-3, 1e-2])
def test_noise_is_found_beside_sharp_resonances(size):
    freq = np.arange(1.0, 20.0, 0.02)
    s = 2j * np.pi * freq
    H = sum(1 / (s**2 + 2 * 0.002 * w * s + w**2) for w in 2 * np.pi * np.array([4.0, 9.0, 9.6]))[:, None]
    rng = np.random.default_rng(0)
    level = size * np.median(np.abs(H))
    noise = level * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    found = np.sqrt(_roughness(freq, H + noise))
    # the median of 25 lines scatters by a fifth; at the three resonances the curve itself is rough
    assert np.median(found) == pytest.approx(level, rel=0.15)
    assert np.mean(np.abs(np.log(found / level)) < 0.7) > 0.9


def test_a_stated_coherence_is_the_noise(tmp_path):
    write_chain(tmp_path, CHAIN_EFFECTS["none"])
    table = np.genfromtxt(tmp_path / "fit.csv", delimiter=",", names=True)
    columns = np.column_stack([*(table[n] for n in table.dtype.names), np.full(len(table), 0.9)])
    header = ",".join([*table.dtype.names, "coh"])
    np.savetxt(tmp_path / "fit.csv", columns, delimiter=",", header=header, comments="")
    text = (tmp_path / "case.toml").read_text().replace('at = "sensor1"\n', 'at = "sensor1"\ncoherence = "coh"\n', 1)
    text = text.replace('form = "receptance"', 'form = "receptance"\naverages = 20', 1)
    (tmp_path / "case.toml").write_text(text)
    data = read_measured(load_case(tmp_path), ("fit",))[0]
    relative = data.noise[:, 0] / np.abs(data.H[:, 0])
    assert np.allclose(relative, np.sqrt(0.1 / (0.9 * 20)), rtol=1e-6)  # Bendat and Piersol (9.81)


def test_thinning_keeps_the_lines_at_resonances(tmp_path):
    write_beam(tmp_path, CHAIN_EFFECTS["none"])
    whole = read_measured(load_case(tmp_path), ("fit",))
    few = thinned(whole)
    assert few[0].freq is few[1].freq  # on the same lines they stay together
    assert len(few[0].freq) <= 250 < len(whole[0].freq)
    power = np.abs(whole[0].H).max(axis=1)
    for peak in whole[0].freq[np.argsort(power)[-3:]]:
        assert np.abs(few[0].freq - peak).min() < 0.06


def test_what_cannot_be_compared_is_refused(tmp_path):
    write_chain(tmp_path, CHAIN_EFFECTS["none"])
    text = (tmp_path / "case.toml").read_text()
    (tmp_path / "case.toml").write_text(text.replace('input = "motor"', 'input = "sensor1"'))
    with pytest.raises(BadCase, match="a force acts at an actuator or a port"):
        prepare_frequency(load_case(tmp_path))
    (tmp_path / "case.toml").write_text(text.replace('role = "fit"', 'role = "holdout"'))
    with pytest.raises(BadCase, match="has the role fit"):
        prepare_frequency(load_case(tmp_path))
    (tmp_path / "case.toml").write_text(text)
    rig = (tmp_path / "rig.xml").read_text()
    (tmp_path / "rig.xml").write_text(rig.replace('stiffness="2000"', 'stiffness="-2000"'))
    with pytest.raises(BadCase, match="unstable"):
        prepare_frequency(load_case(tmp_path))


def test_physics_of_the_nominal_model_is_in_its_responses(chain):
    effects = [
        Attached(EFFECTS["attached-oscillator"], "joint:mass2", {"mass": 0.1, "frequency": 6.0, "damping_ratio": 0.02}),
        Attached(EFFECTS["sensor-delay"], "sensor:sensor1", {"delay": 0.002}),
    ]
    from vlab.diagnose.validation.frequency import nominal_model

    plant = attach(chain.plant, effects)
    found = check_frequency([nominal_model(plant, chain.wires)] * 3, chain.measured)[0].answers[0]
    terms = [
        term(chain, "attached-oscillator", "joint:mass2", mass=0.1, frequency=6.0, damping_ratio=0.02),
        term(chain, "sensor-delay", "sensor:sensor1", delay=0.002),
    ]
    state = chain.state(np.zeros(len(chain.prior)))
    own = answer(chain.view, state, chain.measured[0], chain.wires, terms).H
    assert np.allclose(found, own, rtol=1e-6)


def test_a_response_that_gives_back_power_is_told(tmp_path):
    write_beam(tmp_path, CHAIN_EFFECTS["none"])
    sound = read_measured(load_case(tmp_path), ("fit",))[0]
    assert sound.input in sound.outputs
    assert not sound.gives_power
    assert replace(sound, H=-sound.H).gives_power  # a turned sensor
    receptance = replace(sound, order=0, H=sound.H / (1j * sound.omega[:, None]))
    assert not receptance.gives_power
    assert replace(receptance, H=receptance.H.conj()).gives_power  # a phase that counts the other way
    assert not replace(sound, H=np.abs(sound.H), is_magnitude=True).gives_power


def test_lines_outside_the_band_are_left_out(tmp_path):
    write_chain(tmp_path, CHAIN_EFFECTS["none"])
    text = (tmp_path / "case.toml").read_text()
    whole = read_measured(load_case(tmp_path), ("fit",))[0]
    band = 'form = "receptance"\nlow_hz = 2.0\nhigh_hz = 8.0'
    (tmp_path / "case.toml").write_text(text.replace('form = "receptance"', band))
    part = read_measured(load_case(tmp_path), ("fit",))[0]
    np.testing.assert_array_equal(part.freq, whole.freq[(whole.freq >= 2.0) & (whole.freq <= 8.0)])
    (tmp_path / "case.toml").write_text(text.replace('form = "receptance"', band.replace("8.0", "1.0")))
    with pytest.raises(BadCase, match="the lower must come first"):
        load_case(tmp_path)
