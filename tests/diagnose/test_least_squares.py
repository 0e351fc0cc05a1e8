"""Near rest and along a motion: fits of one interface, whatever the recordings leave open and however little explains them."""

import numpy as np
import pytest
from rig_folder import Channel, Record, multisine, write_case
from scipy.integrate import solve_ivp

from vlab.cases import load_case
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.model_choice import choose_model
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.search.alternative_conventions import choose_convention, list_conventions
from vlab.diagnose.search.model_class import choose_model_class
from vlab.diagnose.settings import HYPOTHESIS_FITS
from vlab.physics.catalogue import EFFECTS

RATE, SECONDS, NOISE = 100.0, 4.0, 1e-4
GRAVITY, MASS, LENGTH, INERTIA, DAMPING = 9.81, 0.5, 0.4, 0.082, 0.05
"""Of a pendulum: inertia about its hinge."""
MODEL = """<mujoco model="pendulum">
  <option timestep="0.002" integrator="implicitfast" gravity="0 0 -9.81"><flag contact="disable"/></option>
  <worldbody><body name="arm"><joint name="hinge" type="hinge" axis="0 -1 0" damping="0.05"/>
    <inertial pos="0 0 -0.4" mass="0.5" diaginertia="0.002 0.002 0.002"/></body></worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
  <sensor><jointpos name="encoder" joint="hinge"/></sensor>
</mujoco>"""
FAR, NEAR = 0.7, 0.02
"""Root mean square of the torque [N m]: the pendulum swings far from where it is linear, or near rest."""


def pendulum(folder, torque, *, hold, initial):
    """Write the case of a driven pendulum whose file holds another torque than the one that drove it, as of mixed up columns."""
    rng, records = np.random.default_rng(5), []
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    for name, role in (("first", "fit"), ("second", "holdout")):
        true, other = (multisine(rng, 0.3, 3.0, SECONDS, torque) for _ in range(2))

        def rate(t, x, true=true):
            return [
                x[1],
                (min(t, 1.0) * float(true(t)) - DAMPING * x[1] - MASS * GRAVITY * LENGTH * np.sin(x[0])) / INERTIA,
            ]

        angle = solve_ivp(rate, (0.0, SECONDS), [0.0, 0.0], "DOP853", time, rtol=1e-9, atol=1e-11).y[0]
        angle = angle + NOISE * rng.standard_normal(time.size)
        columns = {"u": np.minimum(time, 1.0) * other(time), "angle": angle}
        records.append(Record(name=name, role=role, columns=columns, rate_hz=RATE, initial=initial))
    write_case(
        folder,
        title="Pendulum",
        mjcf=MODEL,
        uncertain={"mass": 0.03},
        channels=[
            Channel(column="u", at="motor", kind="moment", unit="N m", is_input=True, hold=hold),
            Channel(column="angle", at="encoder", kind="angle", unit="rad"),
        ],
        records=records,
    )
    path = folder / "case.toml"
    path.write_text(path.read_text().replace('hold = ""\n', ""))
    return load_case(folder)


def searched(case):
    effects = [EFFECTS["viscous-damping"]]
    model_class = choose_model_class(case, effects)
    return model_class, model_class.search(effects, lambda share, what: None)


@pytest.mark.slow
@pytest.mark.parametrize("torque", [FAR, NEAR])
@pytest.mark.parametrize(("hold", "initial"), [("", "rest"), ("zero", "auto")])
def test_what_nothing_explains_is_read_in_the_ways_that_its_case_leaves_open(tmp_path, torque, hold, initial):
    model_class, found = searched(pendulum(tmp_path, torque, hold=hold, initial=initial))
    assert model_class.is_linear == (torque == NEAR)
    assert (
        choose_model(found).best.normalised_residual > HYPOTHESIS_FITS.enough
    )  # so every other way to read the case is tried
    (other,) = list_conventions(model_class.problem)
    assert (
        choose_convention(model_class, found, model_class.problem.case) is None
    )  # and no reading makes a wrong torque the right one
    assert model_class.whole_runs_of(other.of(model_class.problem.case), found.whole.model_error) is not None


@pytest.mark.slow
@pytest.mark.parametrize("torque", [FAR, NEAR])
def test_fits_of_whole_runs_offer_what_a_refiner_does(tmp_path, torque):
    case = pendulum(tmp_path, torque, hold="zero", initial="rest")
    near = LeastSquares(choose_model_class(pendulum(tmp_path / "near", NEAR, hold="zero", initial="rest"), []).screen)
    model_class = choose_model_class(case, [])
    whole = model_class.whole_runs_of(case, model_class.problem.model_error)
    needed = {name for name in vars(near) if not name.startswith("_")} - {"highest"}  # of a twin's own frequencies
    assert needed <= set(vars(whole)) | {"is_rough"}
    assert whole.model_error == model_class.problem.model_error


@pytest.mark.slow
@pytest.mark.parametrize("torque", [FAR, NEAR])
def test_a_fit_of_recordings_that_tell_nothing_of_the_model_ends(tmp_path, torque):
    case = pendulum(tmp_path, torque, hold="zero", initial="rest")
    model_class = choose_model_class(case, [])
    whole = model_class.whole_runs_of(case, 1e9)  # an error allowed for beside which no parameter moves anything
    whole.directions = whole.directions[:, :0]
    whole.free_starts = {}
    fit = whole.fit()
    assert np.isfinite(fit.cost)
    assert fit.terms == ()


@pytest.mark.slow
@pytest.mark.parametrize("torque", [FAR, NEAR])
def test_what_nothing_explains_is_never_claimed_with_confidence(tmp_path, torque):
    case = pendulum(tmp_path, torque, hold="", initial="rest")
    diagnosis = diagnose(case, effects=[EFFECTS["viscous-damping"], EFFECTS["added-mass"]]).diagnosis
    assert diagnosis.verdict in ("none-of-these", "bad-recording", "partly-explained")
    assert all(finding.probability < 0.5 for finding in diagnosis.findings)  # the explained share bounds it
    assert [c.gap_closed for c in diagnosis.checked if c.gap_closed and c.gap_closed > 0.2] == []
