"""Size of a hidden effect on a mechanism after calibration."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from vlab.proof.generator.bench import Benign
from vlab.proof.generator.sizing import Size
from vlab.signals import Array, rms

STEP = 1e-2
"""STEP [-]: difference of log-factors in the derivatives, over their standard deviation if that is smaller."""
FINE_STEP = 1e-3
"""FINE_STEP [-]: the same, over the standard deviation, for derivatives that each step takes anew."""
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
    is_relinearised : bool
        Whether each step takes its own derivatives, for motions whose period depends on unknown amplitudes.
    """

    def __init__(
        self,
        run: Callable[[Mapping[str, float]], Array],
        factors: Mapping[str, float],
        benign: Sequence[Benign],
        sigma: Array,
        *,
        is_relinearised: bool = False,
    ) -> None:
        self._run, self._names = run, [b.name for b in benign]
        self._factors = {**dict.fromkeys(self._names, 0.0), **factors}
        self._sd = np.array([b.prior for b in benign])
        self._weight = 1.0 / sigma[None, :, None]
        self._is_relinearised = is_relinearised
        self.null = run(self._factors)
        """Readings of the mechanism as built."""
        self._J, self._inverse = self._linearised(self._factors, self.null)

    def _linearised(self, factors: Mapping[str, float], y: Array) -> tuple[Array, Array]:
        """Return derivatives of the readings and the inverse normal matrix."""
        columns = []
        for name, sd in zip(self._names, self._sd, strict=True):
            by = FINE_STEP * sd if self._is_relinearised else min(STEP, sd)
            moved = self._run({**factors, name: factors[name] + by})
            columns.append(((moved - y) * self._weight).ravel() * (sd / by))
        J = np.stack(columns, axis=1)
        return J, np.linalg.inv(J.T @ J + np.eye(len(columns)))

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
        J, inverse = self._J, self._inverse
        for cycle in range(CYCLES):
            if cycle and self._is_relinearised:
                J, inverse = self._linearised(self._moved(theta), y - (rest.reshape(y.shape) / self._weight))
            direction = inverse @ (J.T @ rest - theta)
            before = cost
            for share in SHARES:
                tried = np.clip(theta + share * direction, -MOST, MOST)
                left = ((y - self._run(self._moved(tried))) * self._weight).ravel()
                new = float(left @ left + tried @ tried)
                if new < cost:
                    theta, rest, cost = tried, left, new
                    break
            if cost > ENOUGH * before:
                break
        return float(np.sqrt(np.mean(rest**2)))

    def _moved(self, theta: Array) -> dict[str, float]:
        """Return the log-factors at deviations in standard deviations."""
        moved = {n: self._factors[n] + t * sd for n, t, sd in zip(self._names, theta, self._sd, strict=True)}
        return {**self._factors, **moved}

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
