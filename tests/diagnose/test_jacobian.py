"""Derivatives of what a fit leaves, beside residuals whose derivatives are written out."""

from types import SimpleNamespace

import numpy as np
import pytest

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.jacobian import (
    by_period,
    differences_by_strength,
    forward_differences,
    is_nonsmooth,
    update_broyden,
    with_scale,
)
from vlab.diagnose.inference.parameter_vector import ParameterVector, limits_of
from vlab.diagnose.parameters.terms import Term
from vlab.physics.catalogue import EFFECTS

PRIOR, OFFSET_SD = np.array([0.02, 0.3]), np.array([1e-3, 0.2])


class Answers:
    """Two runs of two channels whose answer to every entry is a formula.

    The channels are c exp(-a) s(t) + sin(b) r(t) + offset: c is a damper's constant, a and b are the log-factors.
    """

    def __init__(self, periods=(0.02, 0.01), counts=(30, 40)) -> None:
        rng = np.random.default_rng(5)
        self.free_starts: dict = {}
        self.sigma = np.array([[0.01, 0.5], [0.02, 0.7]])
        self.runs, self.shapes = [], []
        for i, (h, n) in enumerate(zip(periods, counts, strict=True)):
            y, valid = rng.standard_normal((n, 2)), rng.random((n, 2)) > 0.2
            none = np.zeros((n, 0))
            self.runs.append(
                Signals(name=f"{i}", role="fit", h=h, u=none, load=none, y=y, noise=self.sigma[i], scale=np.ones(2),
                        at_rest=True, valid=valid)
            )  # fmt: skip
            self.shapes.append(rng.standard_normal((2, n, 2)))

    def parts(self, entries, x):
        """Return the residual at one vector and its derivatives by a, b, the offsets and c."""
        theta, offsets, _, values = entries.unpacked(x[None])
        (a, b), c = theta[0], values[0]["damping"][0]
        rows, slopes = [x[: entries.priors]], [np.eye(entries.priors, x.size)]
        for i in np.argsort([run.h for run in self.runs], kind="stable"):
            run, (s, r) = self.runs[i], self.shapes[i]
            weight = run.usable / self.sigma[i]
            y = c * np.exp(-a) * s + np.sin(b) * r + offsets[0]
            rows.append((weight * (y - run.y)).ravel())
            by = np.zeros((*y.shape, x.size))
            by[..., :2] = np.stack([-c * np.exp(-a) * s, np.cos(b) * r], axis=-1) @ entries.directions
            by[:, 0, 2], by[:, 1, 3] = entries.offset_sd
            by[..., 4] = np.exp(-a) * s
            slopes.append((weight[..., None] * by).reshape(-1, x.size))
        return np.concatenate(rows), np.vstack(slopes)

    def residual(self, entries, X):
        return np.array([self.parts(entries, x)[0] for x in X])


def entries_of(effect="viscous-damping", **values) -> ParameterVector:
    values = values or {"damping": 0.7}
    term = Term(effect=EFFECTS[effect], place=SimpleNamespace(name="joint:a"), values=values)
    return ParameterVector(
        terms=[term],
        limits=[limits_of(p, values[p.name], lambda name: 1.0) for p in term.effect.parameters],
        directions=np.diag(PRIOR),
        prior=PRIOR,
        offset_sd=OFFSET_SD,
        omega=np.array([3.0]),
        active=np.zeros(0, dtype=int),
        firsts=np.zeros((0, 2)),
    )


X = np.array([0.4, -0.8, 1.1, -2.0, 0.7])


def test_slopes_are_those_of_the_formula():
    """Forward differences miss them by half a step times the curvature.

    The step is a ten thousandth, and a hundredth along the law.
    """
    of, entries = Answers(), entries_of()
    raw, exact = of.parts(entries, X)
    found = forward_differences(of, entries, X, raw)
    size = np.abs(exact).max(axis=0)
    assert np.abs(found - exact)[:, :2].max() < 1e-4 * size[:2].max()
    assert np.abs(found - exact)[:, 4].max() < 0.51e-2 * size[4]
    np.testing.assert_array_equal(found[:, 2:4], exact[:, 2:4])  # these are known


@pytest.mark.parametrize("periods", [(0.02, 0.01), (0.01, 0.02), (0.01, 0.01)])
def test_slopes_by_offsets_are_differences_where_starts_are_loose(periods):
    """A loose start explains a part of an offset, which no formula knows; without that part both agree."""
    of, entries = Answers(periods), entries_of()
    raw = of.residual(entries, X[None])[0]
    known = forward_differences(of, entries, X, raw)[:, 2:4]
    of.free_starts = {0: (np.zeros(0),) * 3}
    by_steps = forward_differences(of, entries, X, raw)[:, 2:4]
    assert np.abs(known).max() > 0.1
    np.testing.assert_allclose(by_steps, known, atol=1e-9 * np.abs(known).max())


def test_a_law_with_edges_takes_wide_steps():
    """Chatter of a hundredth of a step's change drowns a step of a ten thousandth, and not one of a hundredth."""
    smooth, edged = entries_of(), entries_of("coulomb-friction", force=0.7)
    assert not is_nonsmooth(smooth)
    assert is_nonsmooth(edged)

    class Linear:
        runs, sigma, free_starts = (), np.zeros((0, 2)), {0: None}

        def residual(self, entries, trials):
            rng = np.random.default_rng(1)
            return np.array([MATRIX @ x + 1e-4 * rng.standard_normal(len(MATRIX)) for x in trials])

    def off(entries):
        return np.abs(forward_differences(Linear(), entries, X, MATRIX @ X) - MATRIX)[:, :2].max()

    assert off(edged) < 0.1
    assert off(smooth) > 10 * off(edged)


MATRIX = np.random.default_rng(7).standard_normal((200, 5))


def test_slopes_by_strength_tell_what_cancels_where_single_steps_drown_in_chatter():
    """Two columns cancel but for a thousandth; the chatter of an edged law is a share of every step's change."""
    entries = entries_of("coulomb-friction", force=0.7)
    matrix = np.vstack([np.eye(4, 5), MATRIX[4:]])
    matrix[4:, 1] = -matrix[4:, 0] + 1e-3 * matrix[4:, 1]

    class Chattering:
        runs, sigma, free_starts = (), np.zeros((0, 2)), {0: None}

        def residual(self, entries, trials):
            rng = np.random.default_rng(2)
            noise = np.array([rng.standard_normal(len(matrix)) for _ in trials])
            noise[:, :4] = 0.0
            return trials @ matrix.T + 1e-4 * noise

    raw, weak = matrix @ X, np.array([1.0, 1.0, 0.0, 0.0, 0.0])
    single = forward_differences(Chattering(), entries, X, raw)
    found = differences_by_strength(Chattering(), entries, X, raw, single)
    true = np.linalg.norm((matrix @ weak)[4:])

    def miss(slopes):
        return np.linalg.norm(((slopes - matrix) @ weak)[4:]) / true

    assert miss(single) > 1.0
    assert miss(found) < 0.05 * miss(single)  # the step may be as wide as a standard deviation, not a hundredth of it


def test_slopes_by_strength_of_a_linear_residual_are_its_matrix_wherever_they_began():
    class Linear:
        runs, sigma, free_starts = (), np.zeros((0, 2)), {}

        def residual(self, entries, trials):
            return trials @ MATRIX.T

    began = np.random.default_rng(8).standard_normal(MATRIX.shape)
    found = differences_by_strength(Linear(), entries_of(), X, MATRIX @ X, began)
    np.testing.assert_allclose(found, MATRIX, atol=1e-9)


def test_the_part_along_the_common_scale_is_exact_whatever_the_slopes_say_of_it():
    """All impedances and gains larger by a factor change the answers as a damper that is smaller by it does."""
    entries = entries_of()

    class Scaled(Answers):
        def parts(self, entries, x):
            """As above, but c exp(-a) s(t) + sin(b - a) r(t): a larger scale adds the same to a and b."""
            theta, _, _, values = entries.unpacked(x[None])
            (a, b), c = theta[0], values[0]["damping"][0]
            s, r = (shape.ravel() for shape in self.shapes[0])
            by_a, by_b = -c * np.exp(-a) * s - np.cos(b - a) * r, np.cos(b - a) * r
            slopes = np.zeros((len(s), x.size))
            slopes[:, :2] = np.stack([by_a, by_b], axis=-1) @ entries.directions
            slopes[:, 4] = np.exp(-a) * s
            rows = np.concatenate([x[: entries.priors], c * np.exp(-a) * s + np.sin(b - a) * r])
            return rows, np.vstack([np.eye(entries.priors, x.size), slopes])

    of = Scaled()
    _, exact = of.parts(entries, X)
    scale = 1.0 / PRIOR  # in standard deviations
    along = np.zeros(5)
    along[:2] = scale / np.linalg.norm(scale)
    spoilt_note = exact + np.outer(np.random.default_rng(3).standard_normal(len(exact)), along)
    assert np.abs(spoilt_note - exact).max() > 1.0
    np.testing.assert_allclose(with_scale(entries, X, spoilt_note, scale), exact, atol=1e-12)


def test_carried_slopes_agree_with_the_last_step_and_keep_the_rest():
    rng = np.random.default_rng(4)
    slopes, step, change = rng.standard_normal((30, 5)), rng.standard_normal(5), rng.standard_normal(30)
    found = update_broyden(slopes, step, change)
    np.testing.assert_allclose(found @ step, change, rtol=1e-12)
    across = np.linalg.svd(step[None])[2][1:]
    np.testing.assert_allclose(found @ across.T, slopes @ across.T, atol=1e-12)
    np.testing.assert_allclose(update_broyden(slopes, step, slopes @ step), slopes, atol=1e-12)
    assert np.isfinite(update_broyden(slopes, 0 * step, 0 * change)).all()


def test_runs_come_by_sample_period_and_then_as_they_are():
    runs = [SimpleNamespace(h=h) for h in (0.02, 0.01, 0.02, 0.005, 0.01)]
    assert by_period(runs) == [3, 1, 4, 0, 2]
