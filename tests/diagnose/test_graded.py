"""Partial explanations: significance between predictions, horizons, shares, and several effects at once."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp
from test_honest_gap import distance, finding, fit_of

from vlab.cases import load_case
from vlab.diagnose.diagnosis import Attempt
from vlab.diagnose.findings import graded, one_per_law
from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.inference.fit_at_optimum import information_on
from vlab.diagnose.inference.model_choice import Choice
from vlab.diagnose.inference.prior_check import has_plausible_parameters
from vlab.diagnose.model_kinds.mjcf_model import MjcfModel
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Candidate, Term
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.search.forward_selection import further_effects, in_all_joints, laws_in_all_joints
from vlab.diagnose.search.shortlist import rivals_of
from vlab.diagnose.settings import EVIDENCE
from vlab.diagnose.validation.gap import block_log_ratios, explained_share, predicts_better
from vlab.diagnose.validation.horizon import is_predicted, parts_of
from vlab.diagnose.validation.simulation import ExtendedModel, check
from vlab.diagnose.verdict import explains_most, explains_part, is_partial_explanation
from vlab.physics.catalogue import EFFECTS

BETTER = np.array([0.9, 1.1, 1.0, 0.8, 1.2, 1.05])


# ---- significance ----------------------------------------------------------------------------------------------------


def test_the_log_ratio_of_a_block_is_that_of_its_mean_squares():
    without, extended = np.full((12, 2), 0.2), np.full((12, 2), 0.1)
    extended[:6] = 0.4
    assert np.allclose(block_log_ratios(without, extended, 2), [np.log(0.25), np.log(4.0)])
    assert block_log_ratios(np.zeros((4, 1)), extended[:4, :1], 2).size == 0
    # a block where both models leave noise alone says nothing
    noise = np.full(2, 0.3)
    assert np.allclose(block_log_ratios(without, extended, 2, noise), [np.log(0.25)])


def test_equal_models_seldom_pass_the_test_between_predictions():
    rng = np.random.default_rng(3)
    passed = 0
    for _ in range(1000):
        ratios = block_log_ratios(rng.standard_normal((400, 1)), rng.standard_normal((400, 1)), 8)
        passed += predicts_better(ratios, 0.01)
    assert passed <= 22  # 10 are expected; 22 or more have a probability of 0.0006


def test_a_model_with_half_the_error_passes_the_test():
    rng = np.random.default_rng(4)
    ratios = block_log_ratios(rng.standard_normal((400, 1)), 0.5 * rng.standard_normal((400, 1)), 8)
    assert predicts_better(ratios, 0.01)
    assert not predicts_better(-ratios, 0.01)
    assert not predicts_better(np.zeros(0), 0.01)


def test_a_model_that_is_better_in_every_block_passes_the_test():
    """A limit acts in one of eight blocks; the large ratio raises the variance of a t test."""
    ratios = np.array([0.08, 1.42, 0.06, 0.09, 0.05, 0.07, 0.04, 0.03])
    assert stats.ttest_1samp(ratios, 0.0, alternative="greater").pvalue > 0.05
    assert predicts_better(ratios, 0.01)
    assert not predicts_better(-ratios, 0.01)


# ---- the partial explanation -----------------------------------------------------------------------------------------


def test_a_partial_explanation_improves_every_recording():
    half = {"nominal": 0.5, "calibrated": 0.4, "after": 0.2, "log_ratios": BETTER}
    assert explains_part([distance(**half), distance(**half)])
    assert not explains_part([distance(**half), distance(**{**half, "log_ratios": -BETTER})])  # one gets worse
    small, none = {**half, "after": 0.35}, {**half, "after": 0.38}
    assert explains_part([distance(**small)])
    assert not explains_most([distance(**small)])
    assert not explains_part([distance(**none)])  # 40 ln(0.40/0.38) = 2 nat: indistinguishable from no finding
    assert not explains_part([distance(**half), distance(**{**half, "after": 0.41})])
    assert explains_most([distance(**half)])
    assert not explains_part([distance(**{**half, "log_ratios": BETTER - 1.0})])  # one block carries the difference
    assert not explains_part([distance(**half, bare=0.2)])  # its calibration alone does as much
    close, far = {**half, "nominal": 0.3, "calibrated": 0.03}, {**half, "nominal": 1.3, "calibrated": 1.3}
    friction = [distance(**{**far, "after": 0.15, "log_ratios": np.tile(3.0 * BETTER, 2)})]
    other_day = {**close, "log_ratios": -0.2 * BETTER}  # this friction is another day's, still within 5 % of the motion
    assert explains_part([*friction, distance(**{**other_day, "after": 0.05})])
    assert not explains_part([*friction, distance(**{**other_day, "after": 0.2})])  # worse than on average
    assert not explains_part([])


def test_the_explained_share_is_of_the_mean_square():
    assert explained_share([distance(nominal=0.5, calibrated=0.4, after=0.2, noise=0.0)]) == pytest.approx(0.75)
    assert explained_share([distance(nominal=0.5, calibrated=0.4, after=0.2, noise=0.2)]) == pytest.approx(1.0)
    assert explained_share([distance(nominal=0.5, calibrated=0.4, after=0.2, noise=0.4)]) is None
    assert explained_share([distance(nominal=0.0, calibrated=0.0, after=0.0)]) is None
    assert explained_share([distance(nominal=np.inf, calibrated=np.inf, after=0.1)]) == 1.0


PLACE = Place(name="joint:a", kind="port", rows=np.ones((1, 1)))


def hypothesis(effect: str) -> Hypothesis:
    fit = fit_of(Term(effect=EFFECTS[effect], place=PLACE, values={}))
    return Hypothesis(fit=fit, normalised_residual=2.0, log_rms_residual=0.7, negative_log_prior=0.0)


def choice(**shares: float) -> Choice:
    (best, probability), *others = [(hypothesis(name.replace("_", "-")), p) for name, p in shares.items()]
    return Choice(best=best, alike=(), probability=probability, ranking=tuple(others), places={})


def test_a_partial_explanation_needs_the_larger_part_of_the_posterior_in_its_family():
    checked = (distance(nominal=0.5, calibrated=0.4, after=0.2, log_ratios=BETTER),)
    attempt = Attempt(findings=(finding("coulomb-friction"),), checked=checked, fit=fit_of())
    attempt = Attempt(
        findings=tuple(graded(attempt.findings, choice(coulomb_friction=0.5), 0.75)), checked=checked, fit=fit_of()
    )
    family = EFFECTS["coulomb-friction"].family
    attempt = replace(attempt, findings=(replace(attempt.findings[0], family=family),))
    assert is_partial_explanation(attempt, choice(coulomb_friction=0.5, added_mass=0.3))
    assert not is_partial_explanation(attempt, choice(coulomb_friction=0.3, added_mass=0.5))
    for error in (np.inf, 0.22):  # what hold-out data refute has no share, and a worse prediction has a smaller one
        errors = {frozenset({"added-mass@joint:a"}): error, frozenset({"coulomb-friction@joint:a"}): 0.2}
        assert is_partial_explanation(attempt, choice(coulomb_friction=0.3, added_mass=0.5), errors=errors)


def test_holdout_data_weigh_the_hypotheses_by_their_likelihood():
    of = choice(coulomb_friction=0.3, added_mass=0.5, stop=0.1)
    friction, mass, stop = (frozenset({f"{name}@joint:a"}) for name in ("coulomb-friction", "added-mass", "stop"))
    samples = EVIDENCE.model_error_samples
    after = of.given_predictions({friction: 0.2, mass: 0.2 * 2.0 ** (1.0 / samples)})
    assert [p for _, p in after.tried] == pytest.approx([0.3, 0.25, 0.1])  # the last one was not tried
    assert [p for _, p in of.given_predictions({friction: 0.2, stop: np.inf}).tried] == pytest.approx([0.3, 0.5, 0.0])
    assert [p for _, p in of.given_predictions({}).tried] == [0.3, 0.5, 0.1]


@pytest.mark.parametrize(("after", "stands"), [(0.32, False), (0.28, True)])
def test_effects_in_a_structure_explain_more_than_they_leave(after, stands):
    """Half of the mean square is left at 0.283 of 0.4; any effect absorbs a part of the mesh's errors."""
    checked = (distance(nominal=0.5, calibrated=0.4, after=after, log_ratios=BETTER),)
    own = replace(finding("added-mass"), family=EFFECTS["added-mass"].family)
    attempt, of = Attempt(findings=(own,), checked=checked, fit=fit_of()), choice(added_mass=0.9)
    assert is_partial_explanation(attempt, of)
    assert is_partial_explanation(attempt, of, model_kind=SimpleNamespace(has_mesh_error=True)) is stands


def test_an_attempt_that_closes_the_gap_is_a_partial_explanation():
    """Friction that differs from day to day spoils single blocks; the same holds for the first choice."""
    mixed = np.array([5.0, 5.0, 5.0, 5.0, -1.0, -1.0, -1.0, -1.0])
    own = replace(finding("coulomb-friction"), family=EFFECTS["coulomb-friction"].family)
    of, kind = choice(coulomb_friction=0.9), MjcfModel()
    checked = distance(nominal=0.5, calibrated=0.4, after=0.02, log_ratios=mixed)
    attempt = Attempt(findings=(own,), checked=(checked,), fit=fit_of())
    assert not is_partial_explanation(attempt, of)
    assert is_partial_explanation(attempt, of, model_kind=kind)
    left = replace(attempt, checked=(replace(checked, after=0.3),))
    assert not is_partial_explanation(left, of, model_kind=kind)
    # an effect whose size may be zero, however well the model with it predicts
    gain = Term(effect=EFFECTS["servo-torque-constant"], place=PLACE, values={"gain": 0.2})
    for spread, stands in ((0.1, True), (1e6, False)):
        undetermined = replace(attempt, fit=fit_of(gain, **{f"{gain.label}:gain": spread}))
        assert is_partial_explanation(undetermined, of, model_kind=kind) is stands


def test_another_error_of_a_refuted_model_is_as_likely_as_its_effect():
    of = [finding("coulomb-friction")], choice(coulomb_friction=0.9, added_mass=0.1), 0.6
    assert graded(*of, is_plausible=False)[0].probability == pytest.approx(0.5 * graded(*of)[0].probability)


def test_parameters_beyond_the_quantile_refute_a_model():
    fit = replace(fit_of(), cost=100.0, information=np.ones(4))
    # 99 % quantile of chi-squared with 4 degrees of freedom: 13.277 (any table)
    assert has_plausible_parameters(replace(fit, chi2=113.2))
    assert not has_plausible_parameters(replace(fit, chi2=113.3))
    # entries that no recording informs stay at their means: they do not hide the others
    assert not has_plausible_parameters(replace(fit, chi2=113.3, information=np.repeat([1.0, 0.0], [4, 40])))


def test_one_posterior_mode_in_a_hundred_is_refuted_whatever_the_data_tell():
    """Linear models of Gaussian noise and priors: the mode deviates by the variance that the data remove."""
    rng, refuted = np.random.default_rng(7), 0
    for _ in range(3000):
        columns = rng.standard_normal((6, 12)) * np.geomspace(30.0, 0.1, 12)
        truth = rng.standard_normal(12)
        normal = columns.T @ columns + np.eye(12)
        mode = np.linalg.solve(normal, columns.T @ (columns @ truth + rng.standard_normal(6)))
        fit = replace(fit_of(), cost=0.0, chi2=float(mode @ mode), information=information_on(normal, 12))
        refuted += not has_plausible_parameters(fit)
    assert 12 <= refuted <= 50  # 30 expected; 12 and 50 lie beyond three standard deviations


def test_what_is_left_bounds_a_small_finding_by_its_own_share():
    """2 % of the mismatch explained beside 2 % that is left: as likely as not of another law."""
    large, small = finding("coulomb-friction"), finding("added-mass")
    terms = [hypothesis(one.effect).terms[0] for one in (large, small)]
    both = Hypothesis(fit=fit_of(*terms), normalised_residual=2.0, log_rms_residual=0.7, negative_log_prior=0.0)
    of = Choice(best=both, alike=(), probability=1.0, ranking=(), places={})
    found = graded([replace(large, explained=0.96), replace(small, explained=0.02)], of, 0.98)
    whole = of.reserve + 1.0
    assert [f.probability * whole for f in found] == pytest.approx([0.96 / 0.98, 0.5], rel=1e-6)
    (alone,) = graded([replace(large, explained=0.98)], of, 0.98)  # what explains everything that is explained
    assert alone.probability * whole == pytest.approx(0.98)


def test_what_the_data_alone_show_keeps_its_probability_beside_a_search_that_thinks_little_of_it():
    seen = replace(finding("sensor-clipping"), probability=0.99)
    of = choice(coulomb_friction=0.9, sensor_clipping=1e-4)
    fitted = [hypothesis("coulomb-friction").terms[0]]
    _, clipped = graded([finding("coulomb-friction"), seen], of, 0.6, fitted=fitted)
    assert clipped.probability == pytest.approx(0.6 * 0.99)


def test_the_unexplained_share_bounds_the_probability():
    (one,) = graded([finding("coulomb-friction")], choice(coulomb_friction=0.9, added_mass=0.1), 0.6)
    assert one.probability == pytest.approx(0.54)
    # hold-out data alone prefer the set, and need both effects; no posterior speaks for the set
    fitted = [hypothesis(name).terms[0] for name in ("coulomb-friction", "added-mass")]
    found = [finding(term.effect.name) for term in fitted]
    both = graded(found, choice(coulomb_friction=0.9, stop=0.1), 0.6, fitted=fitted)
    assert [f.probability for f in both] == pytest.approx([0.54, 0.27])
    # once hypotheses are refuted, the reserve for other physics weighs more
    left = choice(coulomb_friction=0.04, added_mass=0.92).given_predictions(
        {frozenset({"added-mass@joint:a"}): np.inf, frozenset({"coulomb-friction@joint:a"}): 0.2}
    )
    assert graded([finding("coulomb-friction")], left, 0.6)[0].probability == pytest.approx(0.3)
    (of_data,) = graded([replace(finding("sensor-clipping"), probability=0.99)], choice(coulomb_friction=0.9), 0.6)
    assert of_data.probability == pytest.approx(0.6 * 0.99)  # read off the data, without rivals in the search


# ---- several effects -------------------------------------------------------------------------------------------------


def candidate(effect: str, place: str, gain: float) -> Candidate:
    where = Place(name=place, kind="port", rows=np.ones((1, 1)))
    return Candidate(effect=EFFECTS[effect], place=where, values={}, log_likelihood_gain=gain)


def test_the_same_law_may_join_at_another_place_and_one_friction_has_one_law():
    best = hypothesis("coulomb-friction")
    table = [
        candidate("coulomb-friction", "joint:a", 90.0),
        candidate("jenkins-slip", "joint:a", 80.0),
        candidate("coulomb-friction", "joint:b", 70.0),
        candidate("quadratic-drag", "joint:a", 60.0),
    ]
    labels = [c.label for c in further_effects(best, table)]
    assert labels == ["coulomb-friction@joint:b", "quadratic-drag@joint:a"]


def test_an_effect_that_gains_as_much_elsewhere_is_a_rival():
    # an offset of the command is a constant force where the actuator acts
    offset = candidate("actuator-offset", "actuator:shaker", 90.0)
    table = [
        offset,
        candidate("force-offset", "joint:payload", 89.0),
        candidate("force-offset", "joint:other", 80.0),
        candidate("cubic-stiffness", "joint:payload", 60.0),
    ]
    assert [c.label for c in rivals_of(offset, table)] == ["force-offset@joint:payload"]
    labels = [c.label for c in further_effects(hypothesis("actuator-lag"), table)]
    assert labels == ["actuator-offset@actuator:shaker", "cubic-stiffness@joint:payload", "force-offset@joint:payload"]
    far = [offset, candidate("force-offset", "joint:payload", 80.0)]
    assert rivals_of(offset, far) == []


def test_a_law_in_all_joints_is_a_start_with_its_forms_that_gain_as_much():
    gains = {
        "coulomb-friction": (90.0, 70.0, 50.0),
        "stribeck-friction": (90.0, 71.0, 51.0),
        "jenkins-slip": (85.0, 60.0, 40.0),
        "viscous-damping": (20.0, 10.0, 5.0),
    }
    table = [candidate(name, f"joint:{i}", gain) for name, all_of in gains.items() for i, gain in enumerate(all_of)]
    alone = candidate(
        "coulomb-friction", "tendon:a", 400.0
    )  # a place that moves with all joints explains much by itself
    laws = laws_in_all_joints([*table, alone])
    # another family that gains more than half as much is tried: the sums know no correlation between the joints
    assert [law[0].effect.name for law in laws] == ["coulomb-friction", "stribeck-friction", "jenkins-slip"]
    assert [c.place.name for c in laws[0]] == ["joint:0", "joint:1", "joint:2"]
    assert laws_in_all_joints([c for c in table if c.place.name == "joint:0"]) == []
    smooth = [candidate("smooth-friction", f"joint:{i}", gain) for i, gain in enumerate((120.0, 90.0, 60.0))]
    laws = laws_in_all_joints([*table, *smooth])  # the plainest form of the family is tried beside the best one
    assert [law[0].effect.name for law in laws] == ["smooth-friction", "coulomb-friction", "jenkins-slip"]
    offsets = [candidate("force-offset", f"joint:{i}", gain) for i, gain in enumerate((99.0, 80.0, 60.0))]
    friction = [candidate("coulomb-friction", f"joint:{i}", 80.0) for i in range(3)]
    names = [law[0].effect.name for law in laws_in_all_joints([*friction, *offsets])]
    assert names == ["coulomb-friction", "force-offset"]  # of another family, as good within the error of the screening


def test_joints_where_a_law_does_nothing_are_left_out():
    table = [candidate("coulomb-friction", f"joint:{i}", 10.0) for i in range(3)]
    asked = []

    def fit(terms, start):
        asked.append([t.place.name for t in terms])
        spread = {f"{t.label}:force": 1e3 if t.place.name == "joint:1" else 0.1 for t in terms}
        known = [replace(t, values={"force": 1e-6 if t.place.name == "joint:1" else 1.0}) for t in terms]
        return replace(hypothesis("coulomb-friction"), fit=replace(fit_of(*known), sd=spread))

    (found,) = in_all_joints(table, fit, fit_of())
    assert asked == [["joint:0", "joint:1", "joint:2"], ["joint:0", "joint:2"]]
    assert found.is_one_law


# ---- the horizon -----------------------------------------------------------------------------------------------------


def test_a_recording_is_predicted_where_a_model_explains_half_beyond_the_noise():
    assert is_predicted([1.5, 0.7, 1.0], 0.0)
    assert not is_predicted([1.5, 0.75, np.nan], 0.0)
    assert is_predicted([0.95, 0.9], 0.9)  # little can be predicted under so much noise, and most of that is
    assert is_predicted([1.4, 1.4], 1.0)


DOUBLE = """
<mujoco>
  <option timestep="0.001" integrator="RK4"><flag contact="disable"/></option>
  <worldbody>
    <body name="upper"><joint name="shoulder" type="hinge" axis="0 1 0" damping="{damping}"/>
      <geom name="rod1" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.2"/>
      <body name="lower" pos="0 0 -0.3"><joint name="elbow" type="hinge" axis="0 1 0" damping="{damping}"/>
        <geom name="rod2" type="capsule" fromto="0 0 0 0 0 -0.25" size="0.01" mass="0.15"/>
      </body></body>
  </worldbody>
  <sensor><jointpos name="q1" joint="shoulder"/><jointpos name="q2" joint="elbow"/></sensor>
</mujoco>
"""
CHAOTIC = """
title = "Two arms, let go from high up"
[model]
mjcf = "rig.xml"
[[recording]]
file = "{name}.csv"
role = "{role}"
rate_hz = 200.0
[[recording.channel]]
column = "q1"
at = "q1"
kind = "angle"
unit = "rad"
[[recording.channel]]
column = "q2"
at = "q2"
kind = "angle"
unit = "rad"
"""


def swing(start, seconds: float, damping: float) -> np.ndarray:
    """Two capsules on hinges by their Lagrangian, at 200 Hz: an integrator of its own."""
    masses, lengths, radius, gravity = (0.2, 0.15), (0.3, 0.25), 0.01, 9.81

    def inertia(mass: float, length: float) -> float:
        """Transverse moment of a capsule about its centre: cylinder and two hemispheres of one density."""
        cylinder, ball = np.pi * radius**2 * length, 4 / 3 * np.pi * radius**3
        rho = mass / (cylinder + ball)
        of_cylinder = rho * cylinder * (radius**2 / 4 + length**2 / 12)
        return of_cylinder + rho * ball * (0.4 * radius**2 + length**2 / 4 + 3 / 8 * length * radius)

    i1, i2 = (inertia(m, a) for m, a in zip(masses, lengths, strict=True))
    (m1, m2), (a1, a2) = masses, lengths

    def rate(_, x):
        q1, q2, w1, w2 = x
        both = q1 + q2
        m11 = i1 + m1 * a1**2 / 4 + i2 + m2 * (a1**2 + a2**2 / 4 + a1 * a2 * np.cos(q2))
        m12 = i2 + m2 * (a2**2 / 4 + 0.5 * a1 * a2 * np.cos(q2))
        m22 = i2 + m2 * a2**2 / 4
        h = 0.5 * m2 * a1 * a2 * np.sin(q2)
        f1 = h * (2 * w1 * w2 + w2**2) - gravity * ((0.5 * m1 + m2) * a1 * np.sin(q1) + 0.5 * m2 * a2 * np.sin(both))
        f2 = -h * w1**2 - 0.5 * gravity * m2 * a2 * np.sin(both)
        w = np.linalg.solve([[m11, m12], [m12, m22]], [f1 - damping * w1, f2 - damping * w2])
        return [w1, w2, *w]

    times = np.arange(0.0, seconds, 0.005)
    found = solve_ivp(rate, (0.0, seconds), start, t_eval=times, rtol=1e-10, atol=1e-12, method="DOP853")
    return found.y[:2].T


@pytest.fixture(scope="module")
def chaotic(tmp_path_factory):
    """A chaotic case whose model is exact, with 0.1 % of noise."""
    folder = tmp_path_factory.mktemp("chaotic")
    (folder / "rig.xml").write_text(DOUBLE.format(damping=1e-4))
    rng = np.random.default_rng(8)
    parts = CHAOTIC.split("[[recording]]")
    text = parts[0]
    for name, role, start in (("a", "fit", [2.9, 1.2, 0, 0]), ("b", "holdout", [2.7, -1.4, 0, 0])):
        data = swing(start, 14.0, 1e-4)
        data = data + 1e-3 * data.std(axis=0) * rng.standard_normal(data.shape)
        np.savetxt(folder / f"{name}.csv", data, delimiter=",", header="q1,q2", comments="", fmt="%.9g")
        text += "[[recording]]" + parts[1].format(name=name, role=role)
    (folder / "case.toml").write_text(text)
    return folder


@pytest.mark.slow
def test_a_chaotic_recording_is_predicted_over_its_horizon(chaotic):
    case = load_case(chaotic)
    model = ExtendedModel(plant=case.plant)
    (run,) = case.runs(("holdout",))
    (found,) = check([run], model, None, nominal=model)
    assert found.horizon_s < 10.0  # the whole is beyond any model
    assert found.before < 0.7
    assert len(found.simulated[1].data) == len(run.measured)


def test_the_parts_of_a_recording_are_the_recording(chaotic):
    (run,) = load_case(chaotic).runs(("fit",))
    parts = parts_of(run, 4)
    assert np.array_equal(np.concatenate([p.measured.data for p in parts]), run.measured.data)
    assert [p.initial for p in parts] == ["auto", "estimated", "estimated", "estimated"]
    assert parts_of(run, 1) == [run]
    assert len(parts[2].before) == len(parts[0].measured) + len(parts[1].measured)


@pytest.mark.slow
def test_an_exact_chaotic_model_lacks_nothing(chaotic):
    assert diagnose(load_case(chaotic)).diagnosis.verdict == "nothing-missing"


def test_one_law_at_several_places_is_one_finding_with_a_value_each():
    shoulder, elbow = (
        finding("coulomb-friction", "joint:a", force=0.4),
        finding("coulomb-friction", "joint:b", force=0.1),
    )
    shoulder, elbow = replace(shoulder, explained=0.5), replace(elbow, explained=0.2)
    first, second = one_per_law([shoulder, finding("quadratic-drag"), elbow])
    assert first.site == "joint:a, joint:b"
    assert first.explained == pytest.approx(0.7)
    assert [p["parameters"]["force"]["value"] for p in first.to_json()["places"]] == [0.4, 0.1]
    assert second.effect == "quadratic-drag"
