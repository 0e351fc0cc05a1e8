"""Parameter vector of a fit in time: order, transforms, scales and bounds."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import optimize

from vlab.diagnose.parameters.mjcf import log_factors, prior_deviations
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.settings import PARAMETER_VECTOR
from vlab.physics.effect import Parameter
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ParameterVector:
    """Meaning of the entries of a fitted vector.

    The order is uncertain parameters along directions, sensor offsets, initial states, effect parameters.

    Parameters
    ----------
    terms : sequence of Term
        Effects with fitted parameters.
    limits : sequence of (float, float)
        Bounds of every effect parameter's entry.
    directions : (n_changes, r) array
        Directions of the uncertain parameters, of unit prior variance.
    prior : (n_changes,) array
        Prior standard deviations of the uncertain parameters.
    offset_sd : (n_channels,) array
        Prior standard deviations of the sensor offsets.
    omega : (m,) array
        Natural frequencies of the reduced model [rad/s].
    active : (n,) array of int
        Modes with an estimated initial state.
    firsts : (n_free, 2m) array
        Prior initial states of the runs with an estimated one.
    may_vanish : (n_changes,) array of bool
        Uncertain parameters whose relative decrease has the prior; others have one of the log factor.
    """

    terms: Sequence[Term]
    limits: Sequence[tuple[float, float]]
    directions: Array
    prior: Array
    offset_sd: Array
    omega: Array
    active: Array
    firsts: Array
    may_vanish: Array | bool = False

    @property
    def r(self) -> int:
        """Number of directions of the uncertain parameters."""
        return self.directions.shape[1]

    @property
    def priors(self) -> int:
        """Number of leading entries with unit prior variance.

        These are directions and offsets.
        """
        return self.r + len(self.offset_sd)

    @property
    def first_effect(self) -> int:
        """Index of the first effect parameter."""
        return self.priors + 2 * len(self.active) * len(self.firsts)

    @cached_property
    def parameters(self) -> list[tuple[int, Parameter]]:
        """Term index and parameter of every effect parameter's entry."""
        return [(i, parameter) for i, term in enumerate(self.terms) for parameter in term.effect.parameters]

    @property
    def shapes(self) -> list[int]:
        """Entries of shape parameters, of laws with amplitudes."""
        return [
            k
            for k, (i, parameter) in enumerate(self.parameters, start=self.first_effect)
            if parameter.role == "shape" and self.terms[i].effect.amplitudes
        ]

    @cached_property
    def start_scale(self) -> Array:
        """Scales (2 n_active,) of the initial states."""
        m, a = len(self.omega), self.active
        omega = np.maximum(np.abs(self.omega[a]), 1.0)
        if not len(a):
            return np.zeros(0)
        speed = max(float(np.max(np.abs(np.concatenate([x[a] * omega, x[m + a]])))) for x in self.firsts)
        speed = max(speed, 1e-9)
        return PARAMETER_VECTOR.start_size * np.concatenate([speed / omega, np.full(len(a), speed)])

    def project_prior(self, theta: Array) -> Array:
        """Return log factors along the directions, in prior standard deviations."""
        return self.project(prior_deviations(theta, np.asarray(self.may_vanish)))

    def project(self, direction: Array) -> Array:
        """Return small changes (n_changes,) along the directions, in prior standard deviations."""
        return np.asarray((self.directions / self.prior[:, None] ** 2).T @ direction)

    def packed(
        self, theta: Array, offsets: Array, states: Sequence[Array], values: Sequence[Mapping[str, float]]
    ) -> Array:
        """Return the bounded vector of given values.

        Parameters
        ----------
        theta : (n_changes,) array
            Log factors.
        offsets : (n_channels,) array
            Sensor offsets.
        states : sequence of (2m,) array
            Initial states of the free runs.
        values : sequence of mapping
            Parameter values of every term.

        Returns
        -------
        (n,) array
            Vector.
        """
        m = len(self.omega)
        parts = [self.project_prior(theta), offsets / self.offset_sd]
        parts += [np.concatenate([x[self.active], x[m + self.active]]) / self.start_scale for x in states]
        parts.append(np.array([to_unbounded(p, values[i][p.name]) for i, p in self.parameters]))
        return np.asarray(self.bounded(np.concatenate(parts)[None])[0])

    def unpacked(self, X: Array) -> tuple[Array, Array, Array, list[dict[str, Array]]]:
        """Return the values of vectors.

        Parameters
        ----------
        X : (n_sets, n) array
            Vectors.

        Returns
        -------
        theta : (n_sets, n_changes) array
            Log factors.
        offsets : (n_sets, n_channels) array
            Sensor offsets.
        states : (n_sets, n_free, 2m) array
            Initial states of the free runs.
        values : list of dict
            Parameter values (n_sets,) of every term.
        """
        m, half = len(self.omega), len(self.active)
        theta = log_factors(X[:, : self.r] @ self.directions.T, np.asarray(self.may_vanish))
        offsets = X[:, self.r : self.priors] * self.offset_sd
        states = np.repeat(self.firsts[None], len(X), axis=0)
        fitted = X[:, self.priors : self.first_effect].reshape(len(X), len(self.firsts), 2 * half) * self.start_scale
        states[:, :, self.active], states[:, :, m + self.active] = fitted[..., :half], fitted[..., half:]
        values: list[dict[str, Array]] = [{} for _ in self.terms]
        for k, (i, parameter) in enumerate(self.parameters, start=self.first_effect):
            values[i][parameter.name] = from_unbounded(parameter, X[:, k])
        return theta, offsets, states, values

    def steps(self, x: Array) -> Array:
        """Return the finite-difference steps (n,) at a vector.

        Parameters
        ----------
        x : (n,) array
            Vector.

        Returns
        -------
        (n,) array
            Steps.
        """
        out = np.full(x.size, PARAMETER_VECTOR.step)
        out[self.priors : self.first_effect] = PARAMETER_VECTOR.start_step
        for k, (i, parameter) in enumerate(self.parameters, start=self.first_effect):
            size = 1.0
            if not is_logarithm(parameter):
                size = abs(x[k])
                if not parameter.signed:  # zero has no size of its own
                    size = max(size, self.terms[i].values[parameter.name])
            out[k] = max(PARAMETER_VECTOR.step * size, PARAMETER_VECTOR.least_step)
        return out

    def room(self, x: Array) -> tuple[Array, Array]:
        """Return the largest moves down and up within the bounds.

        Parameters
        ----------
        x : (n,) array
            Vector.

        Returns
        -------
        down, up : (n,) array
            Moves, at most and at least zero.
        """
        low, high = np.full(x.size, -np.inf), np.full(x.size, np.inf)
        low[: self.r], high[: self.r] = -PARAMETER_VECTOR.prior_bound, PARAMETER_VECTOR.prior_bound
        for k, (least, most) in enumerate(self.limits, start=self.first_effect):
            low[k], high[k] = least, most
        return np.minimum(low - x, 0.0), np.maximum(high - x, 0.0)

    def bounded(self, X: Array) -> Array:
        """Return vectors clipped to their bounds.

        Parameters
        ----------
        X : (n_sets, n) array
            Vectors.

        Returns
        -------
        (n_sets, n) array
            Clipped vectors.
        """
        out = X.copy()
        for k, (low, high) in enumerate(self.limits, start=self.first_effect):
            out[:, k] = np.clip(out[:, k], low, high)
        out[:, : self.r] = np.clip(out[:, : self.r], -PARAMETER_VECTOR.prior_bound, PARAMETER_VECTOR.prior_bound)
        return out


def limits_of(parameter: Parameter, value: float, reference: Callable[[str], float]) -> tuple[float, float]:
    """Return the bounds of a parameter's entry.

    Shapes stay within the range that defines them: damping ratios, or slip and gap as share of the motion. Amplitudes
    stay within their range from any start.

    Parameters
    ----------
    parameter : Parameter
        Parameter.
    value : float
        Starting value.
    reference : callable
        Returns the reference quantity of a relative range, by name.

    Returns
    -------
    low, high : float
        Bounds.
    """
    if parameter.signed:
        most = np.inf if parameter.reference else parameter.high
        return -most, most
    if parameter.role == "amplitude":
        return 0.0, value * float(np.exp(PARAMETER_VECTOR.furthest)) if parameter.reference else parameter.high
    centre = to_unbounded(parameter, value)
    low, high = centre - PARAMETER_VECTOR.furthest, centre + PARAMETER_VECTOR.furthest
    if parameter.reference in ("displacement", "travel", "velocity"):
        of = reference(parameter.reference)
        low, high = max(low, np.log(0.5 * parameter.low * of)), min(high, np.log(2.0 * parameter.high * of))
    elif parameter.role == "shape" and not parameter.reference:
        low, high = max(low, np.log(parameter.low)), min(high, np.log(parameter.high))
    return min(low, centre), max(high, centre)


def bounded_step(normal: Array, gradient: Array, room: tuple[Array, Array]) -> Array:
    """Return the minimum of a quadratic cost within bounds.

    Bounded variables need the joint minimum: a gradient that points across a bound may turn with the other variables.

    Parameters
    ----------
    normal : (n, n) array
        Positive definite normal matrix.
    gradient : (n,) array
        Half the gradient of the cost.
    room : tuple of (n,) arrays
        Largest moves down and up.

    Returns
    -------
    (n,) array
        Step.
    """
    step = -np.linalg.solve(normal, gradient)
    down, up = room
    if np.all(step >= down) and np.all(step <= up):
        return np.asarray(step)
    size = np.sqrt(np.diag(normal))
    try:
        factor = np.linalg.cholesky(normal / np.outer(size, size))
    except np.linalg.LinAlgError:  # a direction without information
        return np.asarray(np.clip(step, down, up))
    wanted = np.linalg.solve(factor, -gradient / size)
    slack = 1e-12 * (1.0 + np.abs(size * step))  # the solver wants an interval
    bounds = (np.minimum(size * down, 0.0) - slack, np.maximum(size * up, 0.0) + slack)
    found = optimize.lsq_linear(factor.T, wanted, bounds=bounds, method="bvls")
    return np.asarray(np.clip(found.x / size, down, up))


def is_logarithm(parameter: Parameter) -> bool:
    """Return whether the entry of a parameter is its logarithm.

    Shapes are positive and enter by their ratio. A law is linear in its amplitudes, which may vanish.
    """
    return parameter.role == "shape" and not parameter.signed


def to_unbounded(parameter: Parameter, value: float) -> float:
    """Return the entry of a value: itself, or its logarithm."""
    return float(np.log(max(value, 1e-300))) if is_logarithm(parameter) else float(value)


def from_unbounded(parameter: Parameter, x: Array) -> Array:
    """Return the values of entries."""
    if is_logarithm(parameter):
        return np.exp(np.clip(x, -80, 80))
    return x if parameter.signed else np.maximum(x, 0.0)
