"""An effect that no hold-out recording excites is verified by cross-validation over the fitted recordings."""

import numpy as np
import pytest
from rig_stop import GAP, STOP, stop_case
from servo_rigs import servo_case

from vlab.cases.case import load_case
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.predictors.trajectory_problem import prepare_trajectory
from vlab.diagnose.search.left_out_recordings import leaving_out
from vlab.physics.catalogue import EFFECTS

SOUGHT = [EFFECTS[n] for n in ("one-sided-stiffness", "added-mass")]


@pytest.fixture(scope="module")
def twice(tmp_path_factory):
    """Two fitted recordings that meet the stop, and a hold-out recording that does not."""
    rig = stop_case(tmp_path_factory.mktemp("stop") / "twice", loud=(1.0, 0.9))
    return rig, diagnose(load_case(rig.folder), effects=SOUGHT)


@pytest.mark.slow
def test_a_stop_in_two_fitted_recordings_is_verified_by_leaving_each_out(twice):
    rig, found = twice
    document = found.diagnosis.to_json()
    assert document["verdict"] == "missing-physics"
    (stop,) = document["findings"]
    assert (stop["effect"], stop["place"]) == (rig.effect, rig.place)
    assert stop["parameters"]["stiffness"]["value"] == pytest.approx(STOP, rel=0.1)
    assert stop["parameters"]["gap"]["value"] == pytest.approx(GAP, rel=0.05)
    checked = {run["name"]: run for run in document["heldout"]["per_recording"]}
    assert list(checked) == ["aside", "loud, left out of the fit", "loud 2, left out of the fit"]
    assert [run["can_verify"] for run in checked.values()] == [False, True, True]
    assert stop["verified_by"] == ["loud, left out of the fit", "loud 2, left out of the fit"]
    for name in ("loud, left out of the fit", "loud 2, left out of the fit"):
        assert checked[name]["nrmse_after"] < 0.2 * checked[name]["nrmse_before"]


@pytest.mark.slow
def test_a_left_out_recording_has_no_say_in_a_fit(twice):
    _, found = twice
    whole, fit = found.found.whole, found.fit
    rest = leaving_out(whole, "loud")
    samples = {run.name: run.y.shape for run in whole.runs}
    vector = rest.vector(fit.terms)
    x = rest.initial(vector, [t.values for t in fit.terms], fit.theta, fit)
    residual, of_all = rest.residual(vector, x[None])[0], whole.residual(vector, x[None])[0]
    first = vector.priors
    count = int(np.prod(samples["loud"]))
    assert not residual[first : first + count].any()
    np.testing.assert_array_equal(residual[first + count :], of_all[first + count :])
    assert all(run.valid is None for run in whole.runs)  # the fits to all recordings are unchanged


def test_along_a_motion_the_samples_between_two_times_are_left_out(tmp_path):
    """The windows of a recording have the recorded times of their own samples."""
    servo_case(tmp_path, "lever")
    windows = TrajectoryLeastSquares(TrajectoryScoreTest(*prepare_trajectory(load_case(tmp_path / "case.toml"))))
    assert len(windows.runs) > len(set(windows.recordings))
    span = (2.0, 3.0)
    rest = leaving_out(windows, "two", span)
    for run, name, time in zip(rest.runs, windows.recordings, windows.sample_times, strict=True):
        is_left = (time > span[0] - 1e-6) & (time < span[1] + 1e-6) & (name == "two")
        valid = np.ones(run.y.shape, dtype=bool) if run.valid is None else run.valid
        np.testing.assert_array_equal(valid, np.broadcast_to(~is_left[:, None], valid.shape))
    times = [time for name, time in zip(windows.recordings, windows.sample_times, strict=True) if name == "two"]
    np.testing.assert_allclose(np.concatenate(times), np.arange(500) / 100.0)
    whole = leaving_out(windows, "two").runs
    assert [bool(run.valid is None) for run in whole] == [name != "two" for name in windows.recordings]
    assert not any(run.valid.any() for run in whole if run.valid is not None)
