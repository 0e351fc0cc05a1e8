"""What a fit may make of an effect's parameters: what the catalogue says of them, and no more."""

from types import SimpleNamespace

import numpy as np
import pytest

from vlab.diagnose.inference.parameter_vector import (
    ParameterVector,
    bounded_step,
    from_unbounded,
    limits_of,
    to_unbounded,
)
from vlab.diagnose.parameters.mjcf import log_factors, prior_deviations
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.settings import PARAMETER_VECTOR
from vlab.physics.catalogue import EFFECTS

SIZES = [
    (effect.name, parameter)
    for effect in EFFECTS.values()
    for parameter in effect.parameters
    if parameter.role == "amplitude" and not parameter.reference
]


@pytest.mark.parametrize(("name", "parameter"), SIZES, ids=[f"{name}:{p.name}" for name, p in SIZES])
@pytest.mark.parametrize("times", [1e-2, 1.0, 1e6])
def test_a_size_stays_within_the_catalogues_range_wherever_it_starts(name, parameter, times):
    start = times * parameter.high
    low, high = limits_of(parameter, start, lambda reference: 1.0)
    assert low <= high
    reached = from_unbounded(parameter, np.array([low, np.clip(to_unbounded(parameter, start), low, high), high]))
    assert np.all(np.abs(reached) <= parameter.high * (1 + 1e-9))


def test_a_gain_of_a_thousand_is_no_gain():
    (gain,) = EFFECTS["actuator-gain"].parameters
    assert limits_of(gain, 1007.0, lambda reference: 1.0) == (-3.0, 3.0)


@pytest.mark.parametrize("parameter", [p for e in EFFECTS.values() for p in e.parameters], ids=lambda p: p.name)
def test_a_value_of_the_catalogue_lies_within_the_limits_that_start_from_it(parameter):
    reference = 0.37
    size = reference if parameter.reference else 1.0
    least = 0.0 if parameter.signed else 1e-3 * parameter.low
    for share in (least, parameter.low, np.sqrt(abs(parameter.low) * parameter.high), parameter.high):
        for value in (share * size, *([-share * size] if parameter.signed else [])):
            low, high = limits_of(parameter, value, lambda name: reference)
            assert low <= to_unbounded(parameter, value) <= high


def test_a_shape_that_is_a_share_of_the_motion_keeps_its_share_however_it_is_counted():
    """Limits in metres and in millimetres differ by the logarithm of a thousand."""
    for effect in EFFECTS.values():
        for p in effect.parameters:
            if p.signed or p.reference not in ("displacement", "velocity"):
                continue
            metres = limits_of(p, 0.3 * p.high, lambda name: 1.0)
            millimetres = limits_of(p, 300 * p.high, lambda name: 1e3)
            np.testing.assert_allclose(np.subtract(millimetres, metres), np.log(1e3))
            assert metres[1] - metres[0] <= 2 * PARAMETER_VECTOR.furthest


# ---- the vector -----------------------------------------------------------------------------------------------------

VALUES = ({"k2": -30.0, "k3": 4e3}, {"force": 0.4, "slip": 2e-3})
PRIOR = np.array([0.02, 0.3, 0.05])


def entries(r=2, active=(0, 2), n_free=2) -> ParameterVector:
    """Three modes, three uncertain parameters, two channels; a law with signs and one of logarithms."""
    rng = np.random.default_rng(0)
    place = SimpleNamespace(name="joint:a")
    names = ("quadratic-cubic-stiffness", "jenkins-slip")
    terms = [Term(effect=EFFECTS[n], place=place, values=v) for n, v in zip(names, VALUES, strict=True)]
    firsts = rng.standard_normal((n_free, 6))
    return ParameterVector(
        terms=terms,
        limits=[limits_of(p, t.values[p.name], lambda name: 3e-3) for t in terms for p in t.effect.parameters],
        directions=PRIOR[:, None] * np.linalg.qr(rng.standard_normal((3, 3)))[0][:, :r],
        prior=PRIOR,
        offset_sd=np.array([1e-3, 0.2]),
        omega=np.array([3.0, 20.0, 90.0]),
        active=np.array(active, dtype=int),
        firsts=firsts,
    )


@pytest.mark.parametrize(("active", "n_free"), [((0, 2), 2), ((), 0), ((0, 1, 2), 1)])
def test_what_is_packed_comes_out_again(active, n_free):
    """The part of log-factors beside the directions is lost, and inactive modes keep their first state."""
    own, rng = entries(active=active, n_free=n_free), np.random.default_rng(1)
    theta, offsets = own.directions @ np.array([1.5, -0.7]), np.array([2e-3, -0.1])
    states = own.firsts + rng.standard_normal(own.firsts.shape)
    x = own.packed(theta, offsets, states, VALUES)
    assert x.shape == (2 + 2 + 2 * len(active) * n_free + 4,)
    back, zeros, starts, values = own.unpacked(x[None])
    np.testing.assert_allclose(back[0], theta, rtol=1e-12)
    np.testing.assert_allclose(zeros[0], offsets, rtol=1e-12)
    moved = np.array([i in active for i in range(3)] * 2)
    np.testing.assert_allclose(starts[0], np.where(moved, states, own.firsts), rtol=1e-12)
    for found, given in zip(values, VALUES, strict=True):
        assert {k: v[0] for k, v in found.items()} == pytest.approx(given, rel=1e-12)


def test_packing_log_factors_is_the_nearest_point_of_the_directions():
    """Nearest in standard deviations of the prior: what is left out is at right angles to all directions."""
    own, theta = entries(), np.array([0.03, -0.2, 0.04])
    x = own.packed(theta, np.zeros(2), own.firsts, VALUES)
    left = (theta - own.unpacked(x[None])[0][0]) / PRIOR
    np.testing.assert_allclose((own.directions / PRIOR[:, None]).T @ left, 0.0, atol=1e-12)
    assert np.linalg.norm(left) > 0.1
    np.testing.assert_allclose(
        entries(r=3).unpacked(entries(r=3).packed(theta, np.zeros(2), own.firsts, VALUES)[None])[0][0], theta
    )


def test_vectors_side_by_side_are_unpacked_as_each_alone():
    own, X = entries(), np.random.default_rng(2).standard_normal((5, 16))
    theta, offsets, starts, values = own.unpacked(X)
    for i, x in enumerate(X):
        one = own.unpacked(x[None])
        np.testing.assert_array_equal(offsets[i], one[1][0])
        np.testing.assert_array_equal(starts[i], one[2][0])
        np.testing.assert_allclose(theta[i], one[0][0], rtol=1e-12)
        assert all(v[i] == w[k][0] for v, w in zip(values, one[3], strict=True) for k, v in v.items())


def test_bounds_stop_uncertain_parameters_and_laws_and_nothing_else():
    own, rng = entries(), np.random.default_rng(3)
    X = 1e3 * rng.standard_normal((20, 16))
    out = own.bounded(X)
    free = slice(own.r, own.first_effect)
    np.testing.assert_array_equal(out[:, free], X[:, free])
    assert np.abs(out[:, : own.r]).max() == PARAMETER_VECTOR.prior_bound
    low, high = np.array(own.limits).T
    assert np.all((low <= out[:, own.first_effect :]) & (out[:, own.first_effect :] <= high))
    np.testing.assert_array_equal(own.bounded(out), out)
    inside = own.packed(np.zeros(3), np.zeros(2), own.firsts, VALUES)[None]
    np.testing.assert_array_equal(own.bounded(inside), inside)


def test_the_parts_of_the_vector_follow_each_other():
    own = entries()
    assert (own.r, own.priors, own.first_effect) == (2, 4, 4 + 2 * 2 * 2)
    assert [(i, p.name) for i, p in own.parameters] == [(0, "k2"), (0, "k3"), (1, "force"), (1, "slip")]
    assert own.shapes == [own.first_effect + 3]  # the slip; all others are sizes


def test_a_step_moves_every_value_by_a_hundredth():
    own = entries()
    x = own.packed(np.zeros(3), np.zeros(2), own.firsts, VALUES)
    steps = own.steps(x)
    assert np.all(steps > 0)
    before, after = own.unpacked(x[None])[3], own.unpacked((x + steps)[None])[3]
    for was, now in zip(before, after, strict=True):
        for name in was:
            assert abs(now[name][0] / was[name][0] - 1) == pytest.approx(0.01, rel=0.01)
    assert np.all(own.steps(0 * x) > 0)  # of a law that is nothing as well


def test_first_states_count_in_speeds_of_the_largest_motion():
    """All times faster and as many times smaller: the same motion in the same entries."""
    own = entries()
    fast = ParameterVector(**{**{k: getattr(own, k) for k in own.__dataclass_fields__}, "omega": 7.0 * own.omega,
                      "firsts": np.hstack([own.firsts[:, :3] / 7.0, own.firsts[:, 3:]])})  # fmt: skip
    one, other = (e.packed(np.zeros(3), np.zeros(2), 1.3 * e.firsts, VALUES) for e in (own, fast))
    np.testing.assert_allclose(one[4:12], other[4:12], rtol=1e-12)
    assert np.abs(one[4:12]).max() < 1.3 / 0.01 + 1e-9  # in hundredths of the largest one


@pytest.mark.parametrize("parameter", EFFECTS["one-sided-stiffness"].parameters + EFFECTS["stop"].parameters)
def test_an_entry_is_the_inverse_of_its_value(parameter):
    values = np.array([1e-9, 0.3, 40.0])
    values = np.concatenate([-values, values]) if parameter.signed else values
    np.testing.assert_allclose(
        from_unbounded(parameter, np.array([to_unbounded(parameter, v) for v in values])), values
    )
    assert np.all(np.isfinite(from_unbounded(parameter, np.array([-1e4, 1e4]))))  # a wild trial as well


# ---- values that may vanish -----------------------------------------------------------------------------------------


def test_log_factors_and_deviations_are_inverse_and_smooth_at_the_prior_mean():
    theta = np.linspace(-5.0, 3.0, 33)
    for may_vanish in (np.ones(33, dtype=bool), np.zeros(33, dtype=bool)):
        np.testing.assert_allclose(log_factors(prior_deviations(theta, may_vanish), may_vanish), theta, atol=1e-12)
    step = 1e-6
    slopes = prior_deviations(np.array([-step, step]), True) / np.array([-step, step])
    np.testing.assert_allclose(slopes, 1.0, atol=1e-6)


def test_absent_damping_is_two_standard_deviations_of_half_and_a_multiple_is_no_farther_than_its_logarithm():
    assert prior_deviations(np.array([-50.0]), True)[0] / 0.5 == pytest.approx(-2.0)
    assert prior_deviations(np.array([0.7]), True)[0] == 0.7
    assert log_factors(np.array([-3.0]), True)[0] < -6.0  # beyond zero is zero


def test_a_bounded_step_is_the_minimum_within_the_bounds():
    """Against a fine grid; the first gradient points across the bound, the joint minimum does not."""
    normal, gradient = np.array([[1.0, -0.95], [-0.95, 1.0]]), np.array([0.3, -1.0])
    room = (np.array([0.0, -5.0]), np.array([2.0, 1.5]))
    step = bounded_step(normal, gradient, room)
    a, b = np.meshgrid(np.linspace(0.0, 2.0, 801), np.linspace(-5.0, 1.5, 2601), indexing="ij")
    cost = 2 * (gradient[0] * a + gradient[1] * b) + a**2 - 1.9 * a * b + b**2
    best = np.unravel_index(np.argmin(cost), cost.shape)
    np.testing.assert_allclose(step, [a[best], b[best]], atol=5e-3)
    assert step[0] > 0.5
