"""Size of a hidden effect: its residual after calibration, over the noise."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vlab.proof.generator.bench import Bench, Benign, Blueprint
from vlab.proof.generator.hardware import Output
from vlab.proof.generator.hidden import Hidden
from vlab.proof.generator.integration import Poles, port_rows
from vlab.signals import Array, rms

STEP = 1e-2
"""STEP [-]: difference of log-factors in the derivatives."""
CYCLES, SHARES, ENOUGH = 10, (1.0, 0.4, 0.15, 0.05), 0.9
"""CYCLES, SHARES, ENOUGH [-]: Gauss-Newton steps, tried step lengths, and cost ratio of an accepted step. A rejected
step with old derivatives causes new ones."""
GROWING = ((0.08, 10.0), (0.25, 10.0), (1.0, 10.0), (1.0, 3.0), (1.0, 1.0))
"""GROWING [-]: fitted shares of the recordings and noise factors, in turn. Over a whole recording a frequency error
beyond a line has many minima. Without effective priors parameters diverge."""
MOST = 3.0
"""MOST [-]: largest change of a benign parameter in standard deviations; a linearisation fails beyond."""


TRIES = 9
"""TRIES [-]: sizes per draw before the draw is given up."""
CLOSE = 1.25
"""CLOSE [-]: accepted factor between found and wanted size."""


def to_size(one: Hidden, target: float, left: Callable[[Hidden], float]) -> Hidden | None:
    """Change the size of an effect to a target after calibration.

    The search uses secants in the logarithm, and halves its bracket where a secant leaves it.

    Parameters
    ----------
    one : Hidden
        Effect.
    target : float
        Wanted residual after calibration, over the noise.
    left : callable
        Returns the residual of an effect; infinite if it is too large to measure.

    Returns
    -------
    Hidden or None
        Effect of the wanted size; None for an unreachable target.
    """
    low, high = 0.0, np.inf  # bracket: too small, too large
    for _ in range(TRIES):
        found = left(one)
        if target / CLOSE <= found <= target * CLOSE:
            return one
        if found < target:
            low = one.size
        else:
            high = one.size
        factor = 0.3 if not np.isfinite(found) else float(np.clip(target / max(found, 1e-12), 0.05, 20.0))
        new = one.size * factor
        if low > 0 and np.isfinite(high) and not low < new < high:
            new = float(np.sqrt(low * high))
        new = min(new, one.kind.most)
        if new == one.size or (np.isfinite(high) and low > 0.98 * high):
            return None
        one = replace(one, size=new)
    return None


@dataclass(frozen=True, kw_only=True)
class Size:
    """Sizes of a change of the fit recordings, rms over samples and channels.

    Parameters
    ----------
    change : float
        Change of the outputs in units of the noise.
    left : float
        Residual after calibration of everything benign.
    of_signal : float
        Change over the rms of the signals.
    """

    change: float
    left: float
    of_signal: float

    @property
    def absorbed(self) -> float:
        """Share of the change absorbed by calibration."""
        return 1.0 - self.left / self.change if self.change else 0.0


class Refit:
    """Calibration of the benign parameters to a changed response.

    Parameters
    ----------
    factors : mapping
        Log-factors of the bench as built.
    commands : (n_samples, n_actuators, runs) array
        Commands of the fit recordings.
    sigma : (n_sensors,) array
        Standard deviation of the noise.
    every : int
        Thinning of samples and averaging length of forces, on both sides of every difference.
    """

    def __init__(
        self,
        blueprint: Blueprint,
        factors: dict[str, float],
        bench: Bench,
        output: Output,
        commands: Array,
        sigma: Array,
        every: int,
    ) -> None:
        if np.isfinite(blueprint.refit_hz):  # resting actuators cost time
            driven = [i for i in range(commands.shape[1]) if np.any(commands[:, i])]
            names = [list(bench.actuators)[i] for i in driven]
            commands = commands[:, driven]
            bench = replace(bench, actuators={name: bench.actuators[name] for name in names})
        self._bench, self._sigma, self._every = bench, sigma, every
        self._step = every / blueprint.rate_hz
        forces = output.forces(commands, 1.0 / blueprint.rate_hz, 1)
        whole = len(forces) // every * every
        self._forces = forces[:whole].reshape(-1, every, *forces.shape[1:]).mean(axis=1)
        self._benign = tuple(b for b in blueprint.benign if b.prior and not _is_resting(b, bench))
        here = blueprint.matrices(factors)
        self._changes = [_matrices(blueprint, factors, bench, b, here) for b in self._benign]
        self._null = self._simulated(np.zeros(len(self._benign)))
        self._J = self._jacobian(np.zeros(len(self._benign)), self._null)

    def _jacobian(self, theta: Array, here: Array) -> Array:
        """Return the derivatives of the outputs by the log-factors."""
        columns = []
        for i in range(len(theta)):
            moved = theta.copy()
            moved[i] += STEP
            columns.append((self._simulated(moved) - here) / STEP)
        return np.stack(columns, axis=-1)

    def _simulated(self, theta: Array) -> Array:
        bench = self._bench
        gains = np.ones(len(bench.actuators))
        seen = np.ones(len(bench.sensors))
        M, C, K = bench.M.copy(), bench.C.copy(), bench.K.copy()
        for value, benign, change in zip(theta, self._benign, self._changes, strict=True):
            if benign.kind == "gain":
                gains[list(bench.actuators).index(benign.name.partition(":")[2])] *= np.exp(value)
            elif benign.kind == "sensor":
                seen[_find(bench, benign.name.partition(":")[2])] *= np.exp(value)
            elif change is not None:
                M, C, K = M + value * change[0], C + value * change[1], K + value * change[2]
        changed = Bench(M=M, C=C, K=K, places={}, actuators=bench.actuators, sensors=bench.sensors)
        rows = np.array([port_rows(s.row, s.order) for s in bench.sensors.values()])
        y = Poles.of(changed).response(changed.loads * gains, self._forces, rows, self._step)
        return np.asarray(y * seen[None, :, None])

    def left(self, y: Array, null: Array) -> tuple[float, float]:
        """Return residual over noise and change over signal; see `size`."""
        thin = slice(None, len(self._forces) * self._every, self._every)
        weight = 1.0 / self._sigma[None, :, None]
        change = y[thin] - null[thin]
        return self._left(change), rms(change * weight) / max(rms(null[thin] * weight), 1e-300)

    def size(self, y: Array, null: Array) -> Size:
        """Measure the size of a change.

        Parameters
        ----------
        y, null : (n_samples, n_sensors, runs) array
            True outputs with and without the hidden effect, in the fit recordings.

        Returns
        -------
        Size
            Sizes of the change.
        """
        weight = 1.0 / self._sigma[None, :, None]
        thin = slice(None, len(self._forces) * self._every, self._every)
        change = (y - null)[thin] * weight
        left = self._left(y[thin] - null[thin])
        return Size(change=rms(change), left=left, of_signal=rms(change) / max(rms(null[thin] * weight), 1e-300))

    def _left(self, change: Array) -> float:
        """Return the rms residual over the noise."""
        sd = np.array([b.prior for b in self._benign])
        target = change + self._null
        theta, rest = np.zeros(len(sd)), np.zeros(0)
        for share, louder in GROWING:
            theta, rest = self._fitted(theta, target[: round(share * len(target))], sd, louder)
        return rms(rest)

    def _fitted(self, theta: Array, target: Array, sd: Array, louder: float) -> tuple[Array, Array]:
        """Fit the beginning of the recordings; return parameters and residual."""
        weight, count = 1.0 / (louder * self._sigma[None, :, None]), len(target)

        def missed(theta: Array) -> tuple[Array, float, Array]:
            outputs = self._simulated(theta * sd)
            rest = ((target - outputs[:count]) * weight).reshape(-1)
            return rest, float(rest @ rest + theta @ theta), outputs

        def scaled(J: Array) -> Array:
            return np.asarray((J[:count] * weight[..., None]).reshape(-1, len(sd)) * sd)

        rest, cost, outputs = missed(theta)
        J, is_fresh = scaled(self._J), not np.any(theta)
        for _ in range(CYCLES):
            direction = np.linalg.solve(J.T @ J + np.eye(len(sd)), J.T @ rest - theta)
            before = cost
            for share in SHARES:
                tried = np.clip(theta + share * direction, -MOST, MOST)
                found = missed(tried)
                if found[1] < cost:
                    theta, (rest, cost, outputs) = tried, found
                    break
            if cost <= ENOUGH * before:
                is_fresh = False
            elif is_fresh:
                break
            else:
                J, is_fresh = scaled(self._jacobian(theta * sd, outputs)), True
        return theta, rest


def _matrices(
    blueprint: Blueprint, factors: dict[str, float], bench: Bench, benign: Benign, here: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array] | None:
    """Return the derivatives of M, C and K by a log-factor."""
    if benign.kind in ("gain", "sensor"):
        return None
    T = np.eye(bench.n) if bench.basis is None else bench.basis
    moved = {**factors, benign.name: factors.get(benign.name, 0.0) + STEP}
    M, C, K = ((a - b) / STEP for a, b in zip(blueprint.matrices(moved), here, strict=True))
    return T.T @ M @ T, T.T @ C @ T, T.T @ K @ T


def _is_resting(benign: Benign, bench: Bench) -> bool:
    return benign.kind == "gain" and benign.name.partition(":")[2] not in bench.actuators


def _find(bench: Bench, name: str) -> int:
    return next(i for i, s in enumerate(bench.sensors) if (s.partition(":")[2] or s) == name)
