"""Unequal arms of a crosspiece: their mode in opposition stays in the search, and their difference is found."""

import dataclasses

import numpy as np
import pytest
from scipy import linalg
from test_reduced_model import BEAM_CASE, corrected

from vlab.cases import load_case
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.mode_selection import as_stepped
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.fe import build_fe_model
from vlab.lab import Experiment, run_experiment
from vlab.lab.excitation import Multisine
from vlab.plants import build_plant
from vlab.recordings import write_recording
from vlab.structure.discretisation import Tuning
from vlab.structure.model import Span

LEFT, RIGHT = "crosspiece:tip-left-20in:stiffness", "crosspiece:20in-tip-right:stiffness"
OPPOSED = 2 * np.pi * 8.627
"""Natural frequency of the arms in opposition [rad/s], of the FE model."""
DIFFERENCE = 0.03


def problem_of(structure, folder):
    """Return the problem of the even beam with a recording of a structure."""
    plant = build_plant(dataclasses.replace(structure, tuning=Tuning(of_fe=8)), "composite", "physical")
    experiment = Experiment(plant=plant, seconds=8.0, excitation=Multisine(level=0.05), excite="base")
    write_recording(run_experiment(experiment).recording, folder / "run.parquet")
    text = BEAM_CASE.format(plant="composite", kind="excitation")
    (folder / "case.toml").write_text(text.replace("plant =", 'variant = "physical"\nplant =', 1))
    return prepare(corrected(load_case(folder)))


@pytest.fixture(scope="module")
def uneven(beam, tmp_path_factory):
    span = Span(name="left", bar="crosspiece", between=("tip-left", "20in"), stiffness=1 - DIFFERENCE)
    return problem_of(dataclasses.replace(beam, span=(span,)), tmp_path_factory.mktemp("uneven"))


def test_the_mode_in_opposition_is_kept_though_no_coil_drives_it(uneven, beam):
    near = np.abs(uneven.reduced_model.omega / OPPOSED - 1.0)
    assert near.min() < 2e-3
    mode = near.argmin()
    assert np.abs(uneven.reduced_model.forces[mode]).max() < 1e-6 * np.abs(uneven.reduced_model.forces).max()
    fe = build_fe_model(beam, "physical")
    assert fe.linear.eigen[0][2] == pytest.approx(OPPOSED, rel=1e-3)


def test_the_difference_of_the_arms_is_a_stationary_point_and_is_found(uneven):
    names = [p.name for p in uneven.parameters]
    left, right = names.index(LEFT), names.index(RIGHT)
    fits = LeastSquares(ScoreTest(uneven), uneven.in_role("fit"))
    theta = fits.fit(()).theta
    # what the sensors see is nearly the same with the arms exchanged
    assert abs(theta[left] - theta[right]) == pytest.approx(DIFFERENCE, rel=0.35)


def test_a_rebuilt_plant_has_the_frequencies_and_forces_of_uneven_arms(uneven):
    reduced_model, plant = uneven.reduced_model, uneven.plant
    theta = np.zeros(len(uneven.parameters))
    names = [p.name for p in uneven.parameters]
    theta[names.index(LEFT)], theta[names.index(RIGHT)] = 0.0135, -0.0053
    M, _, K = (part[0] for part in reduced_model.matrices(theta[None])[:3])
    squares, modal = linalg.eigh(K, M)
    linear = uneven.model_kind.adjusted(plant, uneven.parameters, theta).linearise()
    same = np.argmax(np.abs((reduced_model.shapes @ modal).T @ linear.M @ linear.eigen[1]), axis=1)[:8]
    mass, _, stiffness = (np.diag(part) for part in as_stepped(plant, linear, linear.eigen[1][:, same], plant.timestep))
    shown = np.sqrt((linear.eigen[0][same] ** 2 + stiffness) / (1.0 + mass))
    assert shown == pytest.approx(np.sqrt(squares[:8]), rel=2e-5)  # second order of one per cent
    pushed = np.abs(plant.actuator_forces().T @ linear.eigen[1][:, same])
    expected = np.abs(reduced_model.forces.T @ modal[:, :8])
    np.testing.assert_allclose(pushed, expected, atol=0.01 * expected.max())
    opposed = np.abs(shown / OPPOSED - 1.0).argmin()
    assert pushed[:, opposed].max() > 0.1 * pushed.max()  # no longer silent
