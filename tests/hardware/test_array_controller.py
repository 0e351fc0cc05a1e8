"""The array controller: what fits into its matrix, and that it runs what was downloaded."""

import numpy as np
import pytest
from vlab.controllers.block_diagonal import block_diagonal

from vlab.controllers import DirectRateFeedback, LinearLaw, delayed_lqg, lqg
from vlab.design.published_tables import published_design
from vlab.design.state_model import state_model
from vlab.design.weights import noise_of, weights_of
from vlab.errors import BadController, BadExperiment
from vlab.fe.reduced import build_reduced_model
from vlab.hardware.array_controller import ArrayController
from vlab.hardware.laboratory import ArraySize
from vlab.lab import Experiment, run_experiment
from vlab.lab.laws import published_law
from vlab.structure import load_structure

PLACES = ("40in", "20in", "base")


def law(n=0, channels=3, rate=None) -> LinearLaw:
    names = [f"p{i}" for i in range(channels)]
    parts = (np.zeros((n, n)), np.ones((n, channels)), np.ones((channels, n)), np.eye(channels))
    return LinearLaw(*parts, sensors=names, actuators=names, rate=rate)


@pytest.fixture(scope="module")
def grid_model():
    return state_model(build_reduced_model(load_structure("grid"), "exact"))


@pytest.fixture(scope="module")
def grid_lqg(grid_model):
    asked = published_design("grid")
    return lqg.design(grid_model, weights_of(asked, grid_model), noise_of(asked, grid_model), rate=1000.0)


def test_the_array_is_that_of_the_text(laboratory):
    assert laboratory.array == ArraySize(inputs=16, outputs=16, states=32, source="section 5.3, equation 5.1")


def test_direct_feedback_fills_f11_alone(beam, laboratory):
    given = published_law(beam, "mfdrf")
    F = ArrayController(given, laboratory).coefficients
    assert F.shape == (48, 48)
    assert np.array_equal(F[:3, :3], -given.gains)
    assert np.count_nonzero(F) == np.count_nonzero(given.gains)


def test_an_observer_fills_everything_but_f11(grid_lqg, laboratory):
    F = ArrayController(grid_lqg.controller, laboratory.at_rate(1000.0)).coefficients
    assert not F[:16, :16].any()
    assert np.array_equal(F[:5, 16:40], -grid_lqg.F)  # (5.2)
    assert F[16:40, 16:40] == pytest.approx(grid_lqg.controller.A, abs=0)
    assert not F[5:16].any()
    assert not F[40:].any()


def test_816_numbers_become_288_in_block_diagonal_form(grid_lqg, laboratory):
    hardware = laboratory.at_rate(1000.0)
    plain = ArrayController(grid_lqg.controller, hardware)
    few = ArrayController(block_diagonal(grid_lqg.controller), hardware)
    assert plain.non_zeros == 816  # section 5.3, n_R = 12
    assert few.non_zeros == 288
    y = np.random.default_rng(0).standard_normal((500, 5))
    expected = np.array([plain.step(s) for s in y])
    assert np.array([few.step(s) for s in y]) == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_roots_carried_to_the_s_plane_are_the_continuous_observers(grid_lqg, laboratory):
    # the text's check of the discretisation: all frequencies lie far below half the sample rate
    roots = ArrayController(grid_lqg.controller, laboratory.at_rate(1000.0)).s_plane()
    expected = np.linalg.eigvals(grid_lqg.A_estimator)
    assert np.abs(roots[:, None] - expected[None, :]).min(axis=1).max() < 1e-7 * np.abs(expected).max()


def test_the_whole_matrix_gives_what_the_occupied_part_gives(grid_lqg, laboratory):
    array = ArrayController(grid_lqg.controller, laboratory.at_rate(1000.0))
    F, x = array.coefficients, np.zeros(32)
    for y in np.random.default_rng(1).standard_normal((20, 5)):
        out = F @ np.concatenate([y, np.zeros(11), x])
        x = out[16:]
        assert array.step(y) == pytest.approx(out[:5], abs=1e-12 * np.abs(F).max())


def test_an_array_runs_in_the_loop_as_the_law_itself(modal, beam, laboratory):
    given = published_law(beam, "lqdrf")
    runs = [run_experiment(Experiment(plant=modal, seconds=0.5, controller=c, hardware=laboratory)).recording for c in (given, ArrayController(given, laboratory))]  # fmt: skip
    assert np.array_equal(runs[0].data, runs[1].data)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (law(33), "33 states; the array takes 32: reduce the model to 16 modes or fewer"),
        (law(0, 17), "17 sensors; the array takes 16"),
        (law(rate=1000.0), "made for 1000 Hz and the array samples at 2000 Hz"),
        (object(), "no `matrices`"),
    ],
)
def test_what_does_not_fit_is_refused(laboratory, given, message):
    with pytest.raises(BadController, match=message):
        ArrayController(given, laboratory)


@pytest.mark.parametrize("rate", [1.9, 2000.5])
def test_the_rate_has_limits(laboratory, rate):
    with pytest.raises(BadExperiment, match="outside the converter's 2 to 2000 Hz"):
        laboratory.at_rate(rate)


def test_hardware_without_an_array_says_so(laboratory):
    from dataclasses import replace

    with pytest.raises(BadController, match="no array; add a table"):
        ArrayController(law(), replace(laboratory, array=None))


def test_a_law_in_a_loop_of_another_rate_is_refused(modal):
    given = DirectRateFeedback(np.eye(3), sensors=PLACES, actuators=PLACES)
    slow = LinearLaw(*given.matrices, sensors=PLACES, actuators=PLACES, rate=1000.0)
    with pytest.raises(BadController, match="made for 1000 Hz; the loop samples at 2000 Hz"):
        run_experiment(Experiment(plant=modal, seconds=0.1, controller=slow))


def test_the_grids_design_with_delay_does_not_fit_the_array(grid_model, laboratory):
    # 24 states and two past commands of five coils: 34 of 32
    asked = published_design("grid")
    design = delayed_lqg.design(
        grid_model, weights_of(asked, grid_model), noise_of(asked, grid_model), rate=1000.0, delay_samples=1.35
    )
    with pytest.raises(BadController, match="34 states; the array takes 32"):
        ArrayController(design.controller, laboratory.at_rate(1000.0))
