"""Reduced modal model of a plant about rest.

The modes of the nominal plant are fixed coordinates (modal truncation). M, C and K are sums of parts, each times the
exponential of a sum of uncertain log factors.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vlab.diagnose.parameters.effort_channels import EffortChannels
from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.settings import REDUCED_MODEL
from vlab.fe.damping import driven_modes
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """Uncertain parameter: a log factor.

    Parameters
    ----------
    name : str
        Name in the report: ``"stiffness"``, ``"joint:hinge:damping"``, ``"gain:motor"``.
    sd : float
        Prior standard deviation about zero.
    actuator, sensor : int or None
        Actuator or channel whose gain is multiplied; matrix parts are in `ReducedModel.parts`.
    start : float
        Log factor at which the search begins.
    """

    name: str
    sd: float
    actuator: int | None = None
    sensor: int | None = None
    start: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Shift:
    """Uncertain position of a sensor.

    Parameters
    ----------
    by : int
        Index of the parameter [m].
    sensor : int
        Index of the channel, a displacement or velocity.
    at_q, at_v : (m,) array
        Additional rows per metre.
    """

    by: int
    sensor: int
    at_q: Array
    at_v: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class CoilShift:
    """Uncertain position of an actuator's force.

    Parameters
    ----------
    by : int
        Index of the parameter [m].
    actuator : int
        Index of the actuator.
    force : (m,) array
        Additional modal force per metre and unit command.
    """

    by: int
    actuator: int
    force: Array


Matrices = tuple[Array | None, Array | None, Array | None]
"""M, C and K of a part, None where zero."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """Part of the matrices under the same uncertain parameters.

    An example is one spring under its own factor and the common one.

    Parameters
    ----------
    by : tuple of int
        Indices of the parameters; the part is multiplied by the product of their factors.
    M, C, K : (m, m) array or None
        Modal matrices.
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
    """Damping stated as ratios of the modes in order of frequency.

    A stiffness error of a hundredth can swap two close modes, and each mode takes the ratio of its place in the order.
    A proportional damping matrix errs there by the difference of both ratios.

    Parameters
    ----------
    M, K : (m, m) array
        Nominal modal matrices.
    at_coils : (n_coils, m) array
        Coil motion per modal coordinate; modes without coil motion have the ratio `higher`.
    places : (k,) array
        Numbers of the reduced model's modes among all driven modes.
    ratios : (n,) array
        Damping ratios of the first driven modes [1].
    higher : float
        Damping ratio of all other modes [1].
    common : tuple of int
        Uncertain parameters that multiply all ratios.
    own : mapping of int to int
        Uncertain parameter of a driven mode's own ratio, by the mode's number from zero.
    follows_shapes : bool
        Whether a mode's ratio is the mean of the nominal ratios, weighted by its shares in the nominal shapes. The mean
        is smooth, as measured modes suggest. A rebuilt structure follows the order instead.
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
        """Return the change of damping for parameter sets.

        Parameters
        ----------
        M, K : (n_sets, m, m) array
            Changes of mass and stiffness.
        theta : (n_sets, n_changes) array
            Log factors.

        Returns
        -------
        (n_sets, m, m) array
            Change of the damping matrix.
        """
        return self._matrix(self.M + M, self.K + K, theta) - self._nominal

    @cached_property
    def _nominal(self) -> Array:
        most = max((*self.common, *self.own.values()), default=0)
        return self._matrix(self.M[None], self.K[None], np.zeros((1, most + 1)))[0]

    @cached_property
    def _silent(self) -> Array:
        """Indices of the nominal modes without coil motion."""
        return np.setdiff1d(np.arange(self.at_coils.shape[1]), driven_modes(self.at_coils))

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
        """Return the damping ratio of every mode, (n_sets, m)."""
        by_place = np.full((len(theta), max(len(self.ratios), int(self.places.max(initial=-1)) + 1) + 1), self.higher)
        by_place[:, : len(self.ratios)] = self.ratios
        for place, i in self.own.items():
            by_place[:, place] *= np.exp(theta[:, i])
        by_place *= np.exp(theta[:, self.common].sum(axis=1))[:, None]
        out = np.empty(shapes.shape[::2])
        for i, own in enumerate(shapes):
            driven = driven_modes(self.at_coils @ own)
            if self._silent.size:  # coupled by a deviation, such a mode keeps the ratio of the modes between
                driven = np.setdiff1d(driven, np.abs(own[self._silent]).argmax(axis=1))
            driven = driven[: len(self.places)]
            out[i] = by_place[i, -1]
            out[i, driven] = by_place[i, self.places[: len(driven)]]
        return out


def _modes(M: Array, K: Array) -> tuple[Array, Array, Array]:
    """Return squared frequencies (n, m), shapes and momenta (n, m, m)."""
    root = np.linalg.cholesky(M)
    half = np.linalg.solve(root, K)
    squares, turned = np.linalg.eigh(np.linalg.solve(root, half.swapaxes(1, 2)))
    return squares, np.linalg.solve(root.swapaxes(1, 2), turned), root @ turned


@dataclass(frozen=True, kw_only=True, eq=False)
class TruncatedModes:
    """Elastic modes outside a reduced model.

    Parameters
    ----------
    omega : (t,) array
        Natural frequencies [rad/s], above 0.
    shapes : (nv, t) array
        Mass-normalised mode shapes.
    C : (t, t) array
        Modal damping matrix.
    rows : ChannelRows
        Channels per modal coordinate.
    forces : (t, n_actuators) array
        Modal force of a unit command.
    loads : (t, n_loads) array
        Modal force of a unit force at directly driven ports.
    """

    omega: Array
    shapes: Array
    C: Array
    rows: ChannelRows
    forces: Array
    loads: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedModel:
    """Reduced modal model of a plant near rest.

    Parameters
    ----------
    omega : (m,) array
        Natural frequencies [rad/s].
    shapes : (nv, m) array
        Mass-normalised mode shapes.
    M, C, K : (m, m) array
        Modal matrices.
    forces : (m, n_actuators) array
        Modal force of a unit command.
    loads : (m, n_loads) array
        Modal force of a unit force at directly driven ports.
    rows : ChannelRows
        Channels per modal coordinate.
    changes : tuple of Change
        Uncertain parameters.
    parts : tuple of Part
        Matrix parts under uncertain parameters.
    shifts : tuple of Shift
        Uncertain sensor positions.
    coil_shifts : tuple of CoilShift
        Uncertain positions of the actuators' forces.
    damping : ModalDamping or None
        Damping stated as modal ratios.
    outside : TruncatedModes or None
        Elastic modes outside; None for none.
    efforts : EffortChannels or None
        Channels that read forces of actuators; None for none.
    read_commands : (n_channels, n_actuators) array or None
        Readings per unit command beyond those of the nominal model; None for none.
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
    coil_shifts: tuple[CoilShift, ...] = ()
    damping: ModalDamping | None = None
    outside: TruncatedModes | None = None
    efforts: EffortChannels | None = None
    read_commands: Array | None = None

    @property
    def truncated(self) -> TruncatedModes:
        """Elastic modes outside, or an empty set of them."""
        if self.outside is not None:
            return self.outside
        none = np.zeros((len(self.shapes), 0))
        rows = self.rows.onto(np.zeros((self.m, 0)))
        forces, loads = (np.zeros((0, inputs.shape[1])) for inputs in (self.forces, self.loads))
        return TruncatedModes(omega=np.zeros(0), shapes=none, C=np.zeros((0, 0)), rows=rows, forces=forces, loads=loads)

    def with_loads(self, loads: Array, truncated: Array | None = None) -> "ReducedModel":
        """Return the model with further inputs.

        Parameters
        ----------
        loads : (m, k) array
            Modal forces of unit inputs.
        truncated : (t, k) array or None
            Forces on the truncated modes; zero by default.

        Returns
        -------
        ReducedModel
            Model.
        """
        outside = self.outside
        if outside is not None:
            more = np.zeros((len(outside.omega), loads.shape[1])) if truncated is None else truncated
            outside = replace(outside, loads=np.hstack([outside.loads, more]))
        return replace(self, loads=np.hstack([self.loads, loads]), outside=outside)

    @property
    def m(self) -> int:
        """Number of modes."""
        return len(self.omega)

    @property
    def prior(self) -> Array:
        """Prior standard deviations (n_changes,) of the uncertain parameters."""
        return np.array([c.sd for c in self.changes])

    @property
    def start(self) -> Array:
        """Log factors (n_changes,) at which the search begins."""
        return np.array([c.start for c in self.changes])

    @property
    def at_start(self) -> "ReducedModel":
        """The model at the start of the search, where the channels see every mode."""
        if not np.any(self.start):
            return self
        M, C, K = (part[0] for part in self.matrices(self.start[None])[:3])
        return replace(self, M=M, C=C, K=K)

    def matrices(self, theta: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return modal matrices and gains for parameter sets.

        Parameters
        ----------
        theta : (n_sets, n_changes) array
            Log factors.

        Returns
        -------
        M, C, K : (n_sets, m, m) array
            Modal matrices.
        actuators : (n_sets, n_actuators) array
            Actuator gains.
        channels : (n_sets, n_channels) array
            Channel gains.
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
        """Return actuator and channel gains for parameter sets.

        Parameters
        ----------
        theta : (n_sets, n_changes) array
            Log factors.

        Returns
        -------
        actuators : (n_sets, n_actuators) array
            Actuator gains.
        channels : (n_sets, n_channels) array
            Channel gains.
        """
        actuators, channels = (np.ones((len(theta), k)) for k in (self.forces.shape[1], len(self.rows.at_q)))
        for change, factor in zip(
            self.changes, np.exp(np.clip(theta, -REDUCED_MODEL.most, REDUCED_MODEL.most)).T, strict=True
        ):
            if change.actuator is not None:
                actuators[:, change.actuator] *= factor
            if change.sensor is not None:
                channels[:, change.sensor] *= factor
        return actuators, channels

    def forces_at(self, theta: Array) -> Array:
        """Return modal forces (n_sets, m, n_actuators) of unit commands, with gains and shifted coils."""
        out = np.repeat(self.forces[None], len(theta), axis=0)
        for shift in self.coil_shifts:
            out[:, :, shift.actuator] += theta[:, shift.by, None] * shift.force
        return out * self.gains(theta)[0][:, None, :]

    def rows_at(self, theta: Array) -> ChannelRows:
        """Return the channels' rows at parameters (n_changes,), with shifted sensors."""
        if not self.shifts and self.efforts is None:
            return self.rows
        more = self.shifted(theta[None])[0]
        return replace(self.rows, at_q=self.rows.at_q + more[:, : self.m], at_v=self.rows.at_v + more[:, self.m :])

    def shifted(self, theta: Array) -> Array:
        """Return additional rows of the channels.

        Shifted sensors and changed gains of actuators add rows.

        Parameters
        ----------
        theta : (n_sets, n_changes) array
            Log factors, and shifts.

        Returns
        -------
        (n_sets, n_channels, 2m) array
            Rows per [p, p'].
        """
        out = np.zeros((len(theta), len(self.rows.at_q), 2 * self.m))
        for shift in self.shifts:
            out[:, shift.sensor] += theta[:, shift.by, None] * np.concatenate([shift.at_q, shift.at_v])
        if self.efforts is not None and self.efforts.changes:
            out += self.efforts.more_rows(theta)
        return out

    def slopes(self, theta: Array) -> list[Matrices]:
        """Return the derivatives of M, C and K by parameter.

        Parameters
        ----------
        theta : (n_changes,) array
            Log factors.

        Returns
        -------
        list of Matrices
            Derivatives, None where zero.
        """
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


def observable(rows: ChannelRows, shapes: Array, omega: Array) -> Array:
    """Return the mask of modes that some channel observes.

    At equal speed a mode must move a channel by `REDUCED_MODEL.least_seen` of the largest mode's motion.

    Parameters
    ----------
    rows : ChannelRows
        Channels per generalised coordinate.
    shapes : (nv, n) array
        Mode shapes.
    omega : (n,) array
        Natural frequencies [rad/s].

    Returns
    -------
    (n,) array of bool
        Observable modes.
    """
    size = np.abs(rows.at_q @ shapes) + np.abs(rows.at_v @ shapes) * np.maximum(np.abs(omega), 1.0)
    size = size + np.abs(rows.at_a @ shapes) * np.maximum(omega**2, 1.0)
    moved = size / np.maximum(np.abs(omega), 1.0)
    largest = moved.max(axis=1, keepdims=True)
    return np.asarray((moved > REDUCED_MODEL.least_seen * np.maximum(largest, 1e-300)).any(axis=0))
