"""How large something hidden is: what is left of it, in units of the noise, when everything benign is fitted to it."""

from dataclasses import dataclass

import numpy as np

from vlab.proof.generator.bench import Bench, Benign, Blueprint
from vlab.proof.generator.hardware import Output
from vlab.proof.generator.march import Poles, port_rows
from vlab.signals import Array

STEP = 1e-2
"""Of the log-factors in the differences that give the derivatives."""
CYCLES = 4
"""Gauss-Newton steps with fixed derivatives; the sizes need two digits."""
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
    left_alone : float
        The largest of any one recording, refitted alone.
    of_signal : float
        Change over the rms of the signals.
    """

    change: float
    left: float
    left_alone: float
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
        columns = []
        for i in range(len(self._benign)):
            theta = np.zeros(len(self._benign))
            theta[i] = STEP
            columns.append((self._simulated(theta) - self._null) / STEP)
        self._J = np.stack(columns, axis=-1)  # (samples, sensors, runs, parameters)

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
        return self._left(change, range(y.shape[2])), _rms(change * weight) / max(_rms(null[thin] * weight), 1e-300)

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
        together = self._left(y[thin] - null[thin], range(y.shape[2]))
        alone = [self._left(y[thin] - null[thin], [r]) for r in range(y.shape[2])]
        signal = null[thin] * weight
        return Size(
            change=_rms(change),
            left=together,
            left_alone=max(alone),
            of_signal=_rms(change) / max(_rms(signal), 1e-300),
        )

    def _left(self, change: Array, runs: "range | list[int]") -> float:
        """Return the rms over the noise of what is left of a change in some recordings, all together."""
        runs = list(runs)
        sd = np.array([b.sd for b in self._benign])
        weight = 1.0 / self._sigma[None, :, None]
        J = (self._J[:, :, runs] * weight[..., None]).reshape(-1, len(sd)) * sd
        normal = J.T @ J + np.eye(len(sd))
        theta, best, left = np.zeros(len(sd)), np.inf, np.inf
        for _ in range(CYCLES):
            model = self._simulated(theta * sd)[:, :, runs] - self._null[:, :, runs]
            rest = ((change[:, :, runs] - model) * weight).reshape(-1)
            cost = float(rest @ rest + theta @ theta)
            if cost >= best:
                break
            best, left = cost, _rms(rest)
            theta = np.clip(theta + np.linalg.solve(normal, J.T @ rest - theta), -MOST, MOST)
        return left


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
