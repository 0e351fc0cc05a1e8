"""Control laws outside the simulator."""

import numpy as np
import pytest

from vlab.controllers import Controller, DirectRateFeedback, ObserverFeedback
from vlab.errors import BadController, UnknownName
from vlab.lab.laws import published_law

PLACES = ("40in", "20in", "base")


def test_direct_rate_feedback_is_minus_gain_times_velocity():
    law = DirectRateFeedback([[2.0, 1.0], [0.0, 3.0]], sensors=("a", "b"), actuators=("a", "b"))
    assert law.step(np.array([1.0, -1.0])) == pytest.approx([-1.0, 3.0])
    assert isinstance(law, Controller)


def test_published_gains_are_table_7_in_si(beam):
    law = published_law(beam, "mfdrf")
    assert isinstance(law, DirectRateFeedback)
    assert law.gains[1, 2] == pytest.approx(-0.0139 * 4.4482216152605 / 0.0254)
    assert np.all(np.linalg.eigvalsh(law.gains) > 0)  # D > 0: it can only dissipate


def test_unknown_law_lists_the_known(beam):
    with pytest.raises(UnknownName, match="accepted: mfdrf, lqdrf"):
        published_law(beam, "mfdfr")


def observer(limit=None) -> ObserverFeedback:
    return ObserverFeedback(
        [[0.9, 0.1], [0.0, 0.8]], [[0.0], [1.0]], [[1.0, 0.0]], K=[[0.5, 1.0]], M=[[0.3], [0.2]], sensors=("tip",), actuators=("piezo",), limit=limit
    )  # fmt: skip


def test_observer_feedback_is_its_state_space_system():
    # u = -K x, x+ = (A - B K - M C) x + M y: compare with the closed form of the impulse response
    law = observer()
    A, B, C, K, M = law.A, law.B, law.C, law.K, law.M
    closed = A - B @ K - M @ C
    y = np.random.default_rng(1).standard_normal(30)
    given = np.array([law.step(np.array([v]))[0] for v in y])
    expected = [
        -(K @ sum((np.linalg.matrix_power(closed, k - 1 - i) @ M[:, 0] * y[i] for i in range(k)), np.zeros(2)))[0]
        for k in range(30)
    ]
    assert given == pytest.approx(expected, abs=1e-12)


def test_observer_is_told_the_limited_command():
    free, limited = observer(), observer(limit=0.05)
    y = np.full(20, 2.0)
    u = np.array([limited.step(np.array([v]))[0] for v in y])
    assert np.abs(u).max() == pytest.approx(0.05)
    x = np.zeros(2)
    for k in range(20):
        assert u[k] == pytest.approx(np.clip(-(limited.K @ x)[0], -0.05, 0.05))
        x = limited.A @ x + limited.B[:, 0] * u[k] + limited.M[:, 0] * (y[k] - (limited.C @ x)[0])
    assert np.abs([free.step(np.array([v]))[0] for v in y]).max() > 0.05


def test_reset_forgets():
    law = observer()
    first = [law.step(np.array([1.0]))[0] for _ in range(5)]
    law.reset()
    assert first == [law.step(np.array([1.0]))[0] for _ in range(5)]


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        (np.eye(2), r"3 x 3 is needed"),
        (np.full((3, 3), np.nan), "not finite"),
        ([["a"] * 3] * 3, "not a matrix of numbers"),
        ([[1.0], [1.0, 2.0]], "not a matrix"),
    ],
)
def test_gains_that_do_not_fit_are_refused(gains, message):
    with pytest.raises(BadController, match=message):
        DirectRateFeedback(gains, sensors=PLACES, actuators=PLACES)


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_a_limit_that_is_none_is_refused(limit):
    with pytest.raises(BadController, match="not a positive number"):
        observer(limit)
