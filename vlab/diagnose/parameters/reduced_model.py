"""The linear twin: a plant about rest in its own modes, with everything uncertain as parameters, for many sets at once."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.settings import REDUCED_MODEL
from vlab.fe.damping import driven_modes
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """One uncertain parameter, the logarithm of a factor.

    Parameters
    ----------
    name : str
        For reports: ``"stiffness"``, ``"joint:hinge:damping"``, ``"gain:motor"``.
    sd : float
        Its prior standard deviation about zero.
    actuator, sensor : int or None
        The actuator or channel whose gain it multiplies; what it multiplies of the matrices is in the twin's parts.
    """

    name: str
    sd: float
    actuator: int | None = None
    sensor: int | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Shift:
    """A sensor that stands beside its place by as much as an uncertain parameter says.

    Parameters
    ----------
    by : int
        Index of the parameter.
    sensor : int
        Index of the channel, which reads displacements or velocities.
    at_q, at_v : (m,) array
        What it reads more per unit.
    """

    by: int
    sensor: int
    at_q: Array
    at_v: Array


Matrices = tuple[Array | None, Array | None, Array | None]
"""M, C and K of something, None where it has none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """The share of the matrices that the same uncertain parameters multiply: one spring, under a factor of its own and of all.

    Parameters
    ----------
    by : tuple of int
        Indices of the parameters; it grows with the product of their factors.
    M, C, K : (m, m) array or None
        In modal coordinates.
    """

    by: tuple[int, ...]
    M: Array | None = None
    C: Array | None = None
    K: Array | None = None

    @property
    def matrices(self) -> Matrices:
        """M, C and K."""
        return self.M, self.C, self.K


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalDamping:
    """Damping that is stated in ratios of the modes in order of their frequencies, whichever modes these are.

    Of two modes that lie close together, a stiffness that is off by a hundredth turns one into the other, and each takes the damping
    that belongs to its place in the order: a damping matrix that follows in proportion is off by as much as the two ratios differ.

    Parameters
    ----------
    M, K : (m, m) array
        Of the twin.
    at_coils : (n_coils, m) array
        Motion at the coils per modal coordinate: modes that no coil drives have the ratio of the higher ones.
    places : (k,) array
        Which of all driven modes those of the twin are.
    ratios : (n,) array
        Of the first driven modes.
    higher : float
        Of all other modes.
    common : tuple of int
        Indices of the uncertain parameters that multiply all ratios.
    own : mapping of int to int
        Of driven modes, by their number from zero, the parameter that multiplies theirs.
    follows_shapes : bool
        Every mode takes the ratios of the nominal modes in the shares in which it is made of their shapes, whatever its place in the
        order: smooth, and what measured modes suggest. A structure that is built anew follows the order.
    """

    M: Array
    K: Array
    at_coils: Array
    places: Array
    ratios: Array
    higher: float
    common: tuple[int, ...]
    own: Mapping[int, int]
    follows_shapes: bool = False

    def change(self, M: Array, K: Array, theta: Array) -> Array:
        """Return what uncertain parameters (n_sets, n_changes) add to the damping, (n_sets, m, m).

        Parameters
        ----------
        M, K : (n_sets, m, m) array
            What they add to mass and stiffness.
        """
        return self._matrix(self.M + M, self.K + K, theta) - self._nominal

    @cached_property
    def _nominal(self) -> Array:
        most = max((*self.common, *self.own.values()), default=0)
        return self._matrix(self.M[None], self.K[None], np.zeros((1, most + 1)))[0]

    @cached_property
    def _nominal_shapes(self) -> Array:
        return _modes(self.M[None], self.K[None])[1]

    def _matrix(self, M: Array, K: Array, theta: Array) -> Array:
        theta = np.clip(theta, -REDUCED_MODEL.most, REDUCED_MODEL.most)
        squares, shapes, momenta = _modes(M, K)
        if self.follows_shapes:
            nominal = self._nominal_shapes
            shares = (nominal.swapaxes(1, 2) @ momenta) ** 2
            zeta = np.einsum("kj,kji->ki", self._ratios(nominal.repeat(len(theta), axis=0), theta), shares)
            zeta /= shares.sum(axis=1)
        else:
            zeta = self._ratios(shapes, theta)
        size = 2.0 * zeta * np.sqrt(np.maximum(squares, 0.0))
        return np.asarray((momenta * size[:, None, :]) @ momenta.swapaxes(1, 2))

    def _ratios(self, shapes: Array, theta: Array) -> Array:
        """Return the ratio of every mode, (n_sets, m)."""
        by_place = np.full((len(theta), max(len(self.ratios), int(self.places.max(initial=-1)) + 1) + 1), self.higher)
        by_place[:, : len(self.ratios)] = self.ratios
        for place, i in self.own.items():
            by_place[:, place] *= np.exp(theta[:, i])
        by_place *= np.exp(theta[:, self.common].sum(axis=1))[:, None]
        out = np.empty(shapes.shape[::2])
        for i, own in enumerate(shapes):
            driven = driven_modes(self.at_coils @ own)[: len(self.places)]
            out[i] = by_place[i, -1]
            out[i, driven] = by_place[i, self.places[: len(driven)]]
        return out


def _modes(M: Array, K: Array) -> tuple[Array, Array, Array]:
    """Return squared frequencies (n, m), mass-normalised shapes, and M times the shapes, (n, m, m), of many systems."""
    root = np.linalg.cholesky(M)
    half = np.linalg.solve(root, K)
    squares, turned = np.linalg.eigh(np.linalg.solve(root, half.swapaxes(1, 2)))
    return squares, np.linalg.solve(root.swapaxes(1, 2), turned), root @ turned


@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedModel:
    """The plant near rest.

    Parameters
    ----------
    omega : (m,) array
        Circular frequencies of the modes that are kept [rad/s].
    shapes : (nv, m) array
        Mass-normalised mode shapes.
    M, C, K : (m, m) array
        In modal coordinates.
    forces : (m, n_actuators) array
        Modal force of a unit command.
    loads : (m, n_loads) array
        Modal force of a unit force at the ports that recordings drive directly.
    rows : ChannelRows
        The channels per modal coordinate.
    changes : tuple of Change
        What is uncertain.
    parts : tuple of Part
        What that multiplies of the matrices.
    shifts : tuple of Shift
        What it moves of the sensors.
    damping : ModalDamping or None
        Of a structure whose damping is stated in ratios of its modes.
    """

    omega: Array
    shapes: Array
    M: Array
    C: Array
    K: Array
    forces: Array
    loads: Array
    rows: ChannelRows
    changes: tuple[Change, ...]
    parts: tuple[Part, ...] = ()
    shifts: tuple[Shift, ...] = ()
    damping: ModalDamping | None = None

    @property
    def m(self) -> int:
        """Number of modes."""
        return len(self.omega)

    @property
    def prior(self) -> Array:
        """Prior standard deviations of the uncertain parameters."""
        return np.array([c.sd for c in self.changes])

    def matrices(self, theta: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return M, C, K (n_sets, m, m), actuator gains and channel gains (n_sets, ...) for parameter sets.

        Parameters
        ----------
        theta : (n_sets, n_changes) array
            Log-factors.
        """
        out = [np.repeat(x[None], len(theta), axis=0) for x in (self.M, self.C, self.K)]
        for part in self.parts:
            more = np.expm1(np.clip(theta[:, part.by].sum(axis=1), -REDUCED_MODEL.most, REDUCED_MODEL.most))[
                :, None, None
            ]
            for whole, own in zip(out, part.matrices, strict=True):
                if own is not None:
                    whole += more * own
        M, C, K = out
        if self.damping is not None:
            C = C + self.damping.change(M - self.M, K - self.K, theta)
        return M, C, K, *self.gains(theta)

    def gains(self, theta: Array) -> tuple[Array, Array]:
        """Return actuator gains and channel gains (n_sets, ...) for parameter sets (n_sets, n_changes)."""
        actuators, channels = (np.ones((len(theta), k)) for k in (self.forces.shape[1], len(self.rows.at_q)))
        for change, factor in zip(
            self.changes, np.exp(np.clip(theta, -REDUCED_MODEL.most, REDUCED_MODEL.most)).T, strict=True
        ):
            if change.actuator is not None:
                actuators[:, change.actuator] *= factor
            if change.sensor is not None:
                channels[:, change.sensor] *= factor
        return actuators, channels

    def rows_at(self, theta: Array) -> ChannelRows:
        """Return the channels per modal coordinate with sensors where (n_changes,) parameters have them."""
        if not self.shifts:
            return self.rows
        more = self.shifted(theta[None])[0]
        return replace(self.rows, at_q=self.rows.at_q + more[:, : self.m], at_v=self.rows.at_v + more[:, self.m :])

    def shifted(self, theta: Array) -> Array:
        """Return what channels read more of [p, p'] because sensors stand beside their places, (n_sets, n_channels, 2m)."""
        out = np.zeros((len(theta), len(self.rows.at_q), 2 * self.m))
        for shift in self.shifts:
            out[:, shift.sensor] += theta[:, shift.by, None] * np.concatenate([shift.at_q, shift.at_v])
        return out

    def slopes(self, theta: Array) -> list[Matrices]:
        """Return the derivatives of M, C and K by every uncertain parameter at (n_changes,) log-factors."""
        out: list[list[Array | None]] = [[None, None, None] for _ in self.changes]
        for part in self.parts:
            factor = float(np.exp(np.clip(theta[list(part.by)].sum(), -REDUCED_MODEL.most, REDUCED_MODEL.most)))
            for i in part.by:
                for k, own in enumerate(part.matrices):
                    if own is not None:
                        before = out[i][k]
                        out[i][k] = factor * own if before is None else before + factor * own
        if self.damping is not None:
            n = len(self.changes)
            step = REDUCED_MODEL.slope * np.diag(self.prior)
            C = self.matrices(np.vstack([theta + step, theta - step]))[1]
            for i, change in enumerate((C[:n] - C[n:]) / (2.0 * REDUCED_MODEL.slope)):
                if self.prior[i] > 0 and np.any(change):
                    out[i][1] = change / self.prior[i]
        return [(M, C, K) for M, C, K in out]


@dataclass(frozen=True, kw_only=True, eq=False)
class Discrete:
    """Parameter sets of a twin, sampled: x+ = A x + B f with x = [p, p'], y = C x + D f, f held over the step.

    Parameters
    ----------
    A : (n_sets, 2m, 2m) array
    B : (n_sets, 2m, k) array
        Of the modal forces' columns asked for.
    C : (n_sets, n_channels, 2m) array
    D : (n_sets, n_channels, k) array
    """

    A: Array
    B: Array
    C: Array
    D: Array


def discretise(M: Array, C: Array, K: Array, inputs: Array, rows: ChannelRows, h: float) -> Discrete:
    """Sample parameter sets exactly for inputs that are constant from sample to sample.

    Parameters
    ----------
    M, C, K : (n_sets, m, m) array
    inputs : (n_sets, m, k) or (m, k) array
        Modal force of each input.
    """
    n_sets, m = M.shape[0], M.shape[1]
    inputs = np.broadcast_to(inputs, (n_sets, m, inputs.shape[-1]))
    k = inputs.shape[-1]
    solved = np.linalg.solve(M, np.concatenate([K, C, inputs], axis=2))
    block = np.zeros((n_sets, 2 * m + k, 2 * m + k))
    block[:, :m, m : 2 * m] = np.eye(m)
    block[:, m : 2 * m, :m], block[:, m : 2 * m, m : 2 * m] = -solved[:, :, :m], -solved[:, :, m : 2 * m]
    block[:, m : 2 * m, 2 * m :] = solved[:, :, 2 * m :]
    whole = linalg.expm(block * h)
    out = np.concatenate(
        [
            rows.at_q - rows.at_a @ solved[:, :, :m],
            rows.at_v - rows.at_a @ solved[:, :, m : 2 * m],
        ],
        axis=2,
    )
    return Discrete(
        A=whole[:, : 2 * m, : 2 * m], B=whole[:, : 2 * m, 2 * m :], C=out, D=rows.at_a @ solved[:, :, 2 * m :]
    )


def observable(rows: ChannelRows, shapes: Array, omega: Array) -> Array:
    """Return which modes some channel sees: above three parts in ten thousand of what it sees of its largest mode, where all move as
    fast. A mode that is free to move is no measure of how far the others do."""
    size = np.abs(rows.at_q @ shapes) + np.abs(rows.at_v @ shapes) * np.maximum(np.abs(omega), 1.0)
    size = size + np.abs(rows.at_a @ shapes) * np.maximum(omega**2, 1.0)
    moved = size / np.maximum(np.abs(omega), 1.0)
    largest = moved.max(axis=1, keepdims=True)
    return np.asarray((moved > REDUCED_MODEL.least_seen * np.maximum(largest, 1e-300)).any(axis=0))
