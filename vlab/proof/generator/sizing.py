"""How large something hidden is: what is left of it, in units of the noise, when everything benign is fitted to it."""

from dataclasses import dataclass

import numpy as np

from vlab.proof.generator.bench import Bench, Benign, Blueprint
from vlab.proof.generator.hardware import Output
from vlab.proof.generator.integration import Poles, port_rows
from vlab.signals import Array

STEP = 1e-2
"""Of the log-factors in the differences that give the derivatives."""
CYCLES, SHARES, ENOUGH = 10, (1.0, 0.4, 0.15, 0.05), 0.9
"""Gauss-Newton steps, the shares of a step that are tried, and the share of the cost below which a step is worth it;
derivatives are taken again where a step with old ones is not."""
GROWING = ((0.08, 10.0), (0.25, 10.0), (1.0, 10.0), (1.0, 3.0), (1.0, 1.0))
"""Shares of the recordings that are fitted one after the other, and by how much the noise is taken for larger: over a whole
recording a frequency that is off by more than a line has many minima, and without priors that count parameters run off."""
MOST = 3.0
"""Standard deviations that a benign parameter may be refitted by at most: a linearisation is not trusted beyond."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """Sizes of a change of the recordings to fit, rms over samples and channels.

    Parameters
    ----------
    change : float
        Of the outputs, in units of their noise.
    left : float
        After the refit of everything benign.
    of_signal : float
        Change over the rms of the signals.
    """

    change: float
    left: float
    of_signal: float

    @property
    def absorbed(self) -> float:
        """Share of the change that the refit takes up."""
        return 1.0 - self.left / self.change if self.change else 0.0


class Refit:
    """Refits of the benign parameters of a bench as built to a changed response.

    Parameters
    ----------
    factors : mapping
        Log-factors that the bench was built with.
    commands : (n_samples, n_actuators, runs) array
        Of the recordings to fit.
    sigma : (n_sensors,) array
        Noise.
    every : int
        Samples are thinned by this, and forces are averaged over as many: both sides of every difference alike.
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
        self._bench, self._sigma, self._every = bench, sigma, every
        self._step = every / blueprint.rate_hz
        forces = output.forces(commands, 1.0 / blueprint.rate_hz, 1)
        whole = len(forces) // every * every
        self._forces = forces[:whole].reshape(-1, every, *forces.shape[1:]).mean(axis=1)
        self._benign = blueprint.benign
        here = blueprint.matrices(factors)
        self._changes = [_matrices(blueprint, factors, bench, b, here) for b in self._benign]
        self._null = self._simulated(np.zeros(len(self._benign)))
        self._J = self._jacobian(np.zeros(len(self._benign)), self._null)

    def _jacobian(self, theta: Array, here: Array) -> Array:
        """Return the derivatives of the outputs by the log-factors, (samples, sensors, runs, parameters)."""
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
        """Return what a refit leaves of a change over the noise, and the change over the signals; see `size`."""
        thin = slice(None, len(self._forces) * self._every, self._every)
        weight = 1.0 / self._sigma[None, :, None]
        change = y[thin] - null[thin]
        return self._left(change), _rms(change * weight) / max(_rms(null[thin] * weight), 1e-300)

    def size(self, y: Array, null: Array) -> Size:
        """Measure the size of a change.

        Parameters
        ----------
        y, null : (n_samples, n_sensors, runs) array
            True outputs with and without what is hidden, in the recordings to fit.
        """
        weight = 1.0 / self._sigma[None, :, None]
        thin = slice(None, len(self._forces) * self._every, self._every)
        change = (y - null)[thin] * weight
        left = self._left(y[thin] - null[thin])
        return Size(change=_rms(change), left=left, of_signal=_rms(change) / max(_rms(null[thin] * weight), 1e-300))

    def _left(self, change: Array) -> float:
        """Return the rms over the noise of what is left of a change."""
        sd = np.array([b.sd for b in self._benign])
        target = change + self._null
        theta, rest = np.zeros(len(sd)), np.zeros(0)
        for share, louder in GROWING:
            theta, rest = self._fitted(theta, target[: round(share * len(target))], sd, louder)
        return _rms(rest)

    def _fitted(self, theta: Array, target: Array, sd: Array, louder: float) -> tuple[Array, Array]:
        """Fit the beginning of the recordings from a start; return the parameters over their sd, and what is left."""
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
    """Return the derivatives of M, C and K by a log-factor, in the coordinates of the bench."""
    if benign.kind in ("gain", "sensor"):
        return None
    T = np.eye(bench.n) if bench.basis is None else bench.basis
    moved = {**factors, benign.name: factors.get(benign.name, 0.0) + STEP}
    M, C, K = ((a - b) / STEP for a, b in zip(blueprint.matrices(moved), here, strict=True))
    return T.T @ M @ T, T.T @ C @ T, T.T @ K @ T


def _find(bench: Bench, name: str) -> int:
    return next(i for i, s in enumerate(bench.sensors) if (s.partition(":")[2] or s) == name)


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))
