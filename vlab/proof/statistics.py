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


def brier(probability: Sequence[float], outcome: Sequence[bool]) -> float | None:
    """Return the mean squared distance of probabilities from what happened."""
    if not len(probability):
        return None
    return float(np.mean((np.asarray(probability) - np.asarray(outcome, dtype=float)) ** 2))


def calibration(probability: Sequence[float], outcome: Sequence[bool]) -> tuple[float | None, list[dict[str, float]]]:
    """Return the expected calibration error over ten even bins, and the curve: per bin its mean probability and rate."""
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
    """Fit how detection grows with the logarithm of size, and return the sizes at 50 % and 90 %.

    None where there are too few cases, or where detection does not grow with size in them; a limit outside the sizes that
    were tried is given as the nearest of them, with its side under ``"beyond"``.
    """
    x, hit = np.log(np.asarray(size, dtype=float)), np.asarray(detected, dtype=float)
    out: dict[str, Any] = {
        "cases": int(x.size),
        "detected": int(hit.sum()),
        "size_50": None,
        "size_90": None,
        "beyond": {},
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
    centre, spread = x.mean(), max(x.std(), 1e-9)
    z = (x - centre) / spread

    def loss(theta: Any) -> float:
        logit = theta[0] + theta[1] * z
        return float(np.sum(np.logaddexp(0.0, logit) - hit * logit) + RIDGE * theta[1] ** 2)

    a, b = optimize.minimize(loss, np.zeros(2)).x
    if b <= 0.0:
        return out
    for name, share in (("size_50", 0.5), ("size_90", 0.9)):
        at = centre + spread * (np.log(share / (1 - share)) - a) / b
        out[name] = float(np.exp(np.clip(at, x.min(), x.max())))
        if not x.min() <= at <= x.max():
            out["beyond"][name] = "<" if at < x.min() else ">"
    return out
