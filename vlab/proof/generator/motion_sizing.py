"""Size of a hidden effect on a mechanism: its residual after calibration, over the noise."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from vlab.proof.generator.bench import Benign
from vlab.proof.generator.sizing import Size
from vlab.signals import Array, rms

STEP = 1e-2
"""STEP [-]: difference of log-factors in the derivatives, over their standard deviation if that is smaller."""
CYCLES, SHARES, ENOUGH = 6, (1.0, 0.4, 0.15, 0.05), 0.98
"""CYCLES, SHARES, ENOUGH [-]: Gauss-Newton steps with the derivatives of the mechanism as built, tried step lengths, and cost
ratio of a step that is worth another one."""
MOST = 3.0
"""MOST [-]: largest change of a benign parameter in standard deviations."""


class MotionRefit:
    """Calibration of the benign parameters to a changed response.

    Parameters
    ----------
    run : callable
        Maps log-factors to the readings of the fit recordings, (n_samples, channels, runs).
    factors : mapping
        Log-factors of the mechanism as built; missing ones are zero.
    benign : sequence of Benign
        Parameters with the standard deviations that the case states.
    sigma : (channels,) array
        Standard deviation of the noise.
    """

    def __init__(
        self,
        run: Callable[[Mapping[str, float]], Array],
        factors: Mapping[str, float],
        benign: Sequence[Benign],
        sigma: Array,
    ) -> None:
        self._run, self._names = run, [b.name for b in benign]
        self._factors = {**dict.fromkeys(self._names, 0.0), **factors}
        self._sd = np.array([b.prior for b in benign])
        self._weight = 1.0 / sigma[None, :, None]
        self.null = run(self._factors)
        """Readings of the mechanism as built."""
        columns = []
        for name, sd in zip(self._names, self._sd, strict=True):
            by = min(STEP, sd)
            moved = run({**self._factors, name: self._factors[name] + by})
            columns.append(((moved - self.null) * self._weight).ravel() * (sd / by))
        self._J = np.stack(columns, axis=1)
        self._inverse = np.linalg.inv(self._J.T @ self._J + np.eye(len(columns)))

    def size(self, y: Array) -> Size:
        """Measure the size of a change.

        Parameters
        ----------
        y : (n_samples, channels, runs) array
            Readings with the hidden effect, integrated as those of `run`.

        Returns
        -------
        Size
            Sizes of the change; signals count from their mean.
        """
        change = (y - self.null) * self._weight
        signal = (self.null - self.null.mean(axis=0)) * self._weight
        return Size(change=rms(change), left=self._left(y), of_signal=rms(change) / rms(signal))

    def _left(self, y: Array) -> float:
        """Return the rms residual over the noise after Gauss-Newton steps."""
        theta = np.zeros(len(self._sd))
        rest = ((y - self.null) * self._weight).ravel()
        cost = float(rest @ rest)
        for _ in range(CYCLES):
            direction = self._inverse @ (self._J.T @ rest - theta)
            before = cost
            for share in SHARES:
                tried = np.clip(theta + share * direction, -MOST, MOST)
                factors = {
                    name: self._factors[name] + t * sd for name, t, sd in zip(self._names, tried, self._sd, strict=True)
                }
                left = ((y - self._run({**self._factors, **factors})) * self._weight).ravel()
                new = float(left @ left + tried @ tried)
                if new < cost:
                    theta, rest, cost = tried, left, new
                    break
            if cost > ENOUGH * before:
                break
        return float(np.sqrt(np.mean(rest**2)))

    def quick(self, y: Array) -> float:
        """Return the residual over the noise after one linear step.

        Parameters
        ----------
        y : (n_samples, channels, runs) array
            Readings with the hidden effect.

        Returns
        -------
        float
            Residual over the noise.
        """
        change = ((y - self.null) * self._weight).ravel()
        return float(np.sqrt(np.mean((change - self._J @ (self._inverse @ (self._J.T @ change))) ** 2)))
