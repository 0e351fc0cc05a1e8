"""Counts with exact intervals, calibration, and the size at which something is detected."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize, stats

LEVEL = 0.95
BINS = 10
LEAST_FOR_LIMIT = 8
"""Cases of one effect below which no detection limit is fitted."""
RIDGE = 0.05
"""Weak penalty on the logistic slope: a sample that separates perfectly has none."""
DRAWS, SEED = 400, 0
"""Draws with replacement behind the intervals that have no closed form, and their seed: the same score at every count."""


@dataclass(frozen=True)
class Rate:
    """A count out of a number with its exact 95 % interval [1]_.

    References
    ----------
    .. [1] C. J. Clopper, E. S. Pearson, "The use of confidence or fiducial limits illustrated in the case of the
       binomial", *Biometrika* 26 (1934) 404-413.
    """

    count: int
    of: int

    @property
    def value(self) -> float | None:
        """The rate; None of nothing."""
        return self.count / self.of if self.of else None

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper and Pearson's interval; 0 to 1 of nothing."""
        if not self.of:
            return 0.0, 1.0
        found = stats.binomtest(self.count, self.of).proportion_ci(LEVEL, method="exact")
        return float(found.low), float(found.high)

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {"count": self.count, "of": self.of, "rate": self.value, "ci95": list(self.interval)}


def rate(flags: Sequence[bool]) -> Rate:
    """Count truth values."""
    return Rate(sum(bool(f) for f in flags), len(flags))


def clustered_interval(groups: Sequence[Sequence[bool]]) -> tuple[float, float]:
    """Return the 95 % interval of a rate with dependent groups of truth values.

    Without values the interval is 0 to 1.

    Whole groups are drawn with replacement, as parameters of one fit are right or wrong together.
    """
    count = np.array([[sum(g), len(g)] for g in groups if len(g)], dtype=float)
    if not len(count):
        return 0.0, 1.0
    drawn = count[np.random.default_rng(SEED).integers(0, len(count), (DRAWS, len(count)))].sum(axis=1)
    low, high = np.quantile(drawn[:, 0] / drawn[:, 1], (0.5 * (1 - LEVEL), 0.5 * (1 + LEVEL)))
    return float(low), float(high)


def brier(probability: Sequence[float], outcome: Sequence[bool]) -> float | None:
    """Return the mean squared distance of probabilities from what happened."""
    if not len(probability):
        return None
    return float(np.mean((np.asarray(probability) - np.asarray(outcome, dtype=float)) ** 2))


def calibration(probability: Sequence[float], outcome: Sequence[bool]) -> tuple[float | None, list[dict[str, float]]]:
    """Return the expected calibration error over ten even bins, and the curve.

    The curve has the mean probability and the rate of each bin.
    """
    p, hit = np.asarray(probability, dtype=float), np.asarray(outcome, dtype=float)
    if not p.size:
        return None, []
    which = np.minimum((p * BINS).astype(int), BINS - 1)
    curve, error = [], 0.0
    for b in range(BINS):
        inside = which == b
        if not inside.any():
            continue
        mean, share = float(p[inside].mean()), float(hit[inside].mean())
        low, high = Rate(int(hit[inside].sum()), int(inside.sum())).interval
        curve.append({"probability": mean, "rate": share, "cases": int(inside.sum()), "low": low, "high": high})
        error += float(inside.mean()) * abs(mean - share)
    return error, curve


def detection_limit(size: Sequence[float], detected: Sequence[bool]) -> dict[str, Any]:
    """Return the sizes detected at 50 % and 90 % with their 95 % intervals.

    Detection is fitted as a function of the logarithm of size.

    None where there are too few cases, or where detection does not grow with size in them; a limit outside the sizes that
    were tried is given as the nearest of them, with its side under ``"beyond"``, and intervals end there.
    """
    x, hit = np.log(np.asarray(size, dtype=float)), np.asarray(detected, dtype=float)
    out: dict[str, Any] = {
        "cases": int(x.size),
        "detected": int(hit.sum()),
        "size_50": None,
        "size_90": None,
        "beyond": {},
        "ci95": {},
    }
    if x.size < LEAST_FOR_LIMIT:
        return out
    if hit.all() or not hit.any():
        end = x.min() if hit.all() else x.max()
        return {
            **out,
            "size_50": float(np.exp(end)),
            "size_90": float(np.exp(end)),
            "beyond": dict.fromkeys(("size_50", "size_90"), "<" if hit.all() else ">"),
        }
    limits = _limits(x, hit)
    if not np.all(np.isfinite(limits)):
        return out
    rng = np.random.default_rng(SEED)
    picks = rng.integers(0, x.size, (DRAWS, x.size))
    drawn = np.array([_limits(x[pick], hit[pick]) for pick in picks])
    ends = np.quantile(np.clip(drawn, x.min(), x.max()), (0.5 * (1 - LEVEL), 0.5 * (1 + LEVEL)), axis=0)
    for k, name in enumerate(("size_50", "size_90")):
        out[name] = float(np.exp(np.clip(limits[k], x.min(), x.max())))
        out["ci95"][name] = np.exp(ends[:, k]).tolist()
        if not x.min() <= limits[k] <= x.max():
            out["beyond"][name] = "<" if limits[k] < x.min() else ">"
    return out


def _limits(x: Any, hit: Any) -> Any:
    """Return the logarithms of the sizes detected at 50 % and 90 %.

    They are infinite where detection does not grow with size.
    """
    if hit.all() or not hit.any():
        return np.full(2, -np.inf if hit.all() else np.inf)
    centre, spread = x.mean(), max(x.std(), 1e-9)
    z = (x - centre) / spread

    def loss(theta: Any) -> Any:
        logit = theta[0] + theta[1] * z
        left = 1.0 / (1.0 + np.exp(-logit)) - hit
        value = float(np.sum(np.logaddexp(0.0, logit) - hit * logit) + RIDGE * theta[1] ** 2)
        return value, np.array([left.sum(), left @ z + 2 * RIDGE * theta[1]])

    a, b = optimize.minimize(loss, np.zeros(2), jac=True).x
    if b <= 0.0:
        return np.full(2, np.inf)
    return centre + spread * (np.log([1.0, 9.0]) - a) / b
