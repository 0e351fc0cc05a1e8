"""Statistics of a score: exact intervals, calibration, detection limits."""

import numpy as np
import pytest

from vlab.proof.statistics import Rate, brier, calibration, detection_limit


def test_intervals_are_exact():
    """Clopper and Pearson: for 0 of n the upper limit is 1 - (alpha/2)^(1/n), for n of n its mirror."""
    for n in (5, 40):
        low, high = Rate(0, n).interval
        assert (low, high) == (0.0, pytest.approx(1 - 0.025 ** (1 / n)))
        assert Rate(n, n).interval == (pytest.approx(0.025 ** (1 / n)), 1.0)
    assert Rate(0, 0).interval == (0.0, 1.0)
    assert Rate(0, 0).value is None


def test_brier_and_calibration_of_counted_cases():
    assert brier([1.0, 0.0, 0.5], [True, False, True]) == pytest.approx(0.25 / 3)
    error, curve = calibration([0.95] * 10 + [0.55] * 10, [True] * 8 + [False] * 2 + [True] * 5 + [False] * 5)
    # ten at .95 of which .8 hold, ten at .55 of which .5 hold: (.15 + .05)/2
    assert error == pytest.approx(0.1)
    assert [c["cases"] for c in curve] == [10, 10]
    assert calibration([], [])[0] is None


@pytest.mark.slow
def test_the_detection_limit_is_where_detection_turns_over():
    rng = np.random.default_rng(1)
    size = np.exp(rng.uniform(np.log(0.1), np.log(30), 4000))
    chance = 1 / (1 + np.exp(-2.0 * (np.log(size) - np.log(1.5))))
    found = detection_limit(size, rng.random(4000) < chance)
    # 4000 draws fix the middle to some per cent; 90 % is at 1.5 exp(ln 9/2) = 4.5
    assert found["size_50"] == pytest.approx(1.5, rel=0.1)
    assert found["size_90"] == pytest.approx(4.5, rel=0.15)


def test_a_detection_limit_is_not_made_up():
    assert detection_limit([1.0, 2.0], [True, False])["size_50"] is None  # too few
    every = detection_limit(np.arange(1.0, 11.0), [True] * 10)
    assert (every["size_50"], every["beyond"]["size_50"]) == (pytest.approx(1.0), "<")
    none = detection_limit(np.arange(1.0, 11.0), [False] * 10)
    assert (none["size_90"], none["beyond"]["size_90"]) == (pytest.approx(10.0), ">")
    most = detection_limit(np.arange(1.0, 21.0), [True, False] + [True] * 18)
    assert (most["size_50"], most["beyond"]) == (
        1.0,
        {"size_50": "<"},
    )  # half are found below all sizes that were tried
    falls = detection_limit(np.arange(1.0, 11.0), [True] * 5 + [False] * 5)
    assert falls["size_50"] is None
