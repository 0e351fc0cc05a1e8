"""Parameter vector of a fit in time: order, transforms, scales and bounds."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

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
    """

    terms: Sequence[Term]
    limits: Sequence[tuple[float, float]]
    directions: Array
    prior: Array
    offset_sd: Array
    omega: Array
    active: Array
    firsts: Array

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
        return np.asarray((self.directions / self.prior[:, None] ** 2).T @ theta)

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
        theta = X[:, : self.r] @ self.directions.T
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
        for k, (_, parameter) in enumerate(self.parameters, start=self.first_effect):
            out[k] = (
                PARAMETER_VECTOR.step
                if not parameter.signed
                else max(PARAMETER_VECTOR.step * abs(x[k]), PARAMETER_VECTOR.least_step)
            )
        return out

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
    centre = to_unbounded(parameter, value)
    low, high = centre - PARAMETER_VECTOR.furthest, centre + PARAMETER_VECTOR.furthest
    if parameter.reference in ("displacement", "velocity"):
        of = reference(parameter.reference)
        low, high = max(low, np.log(0.5 * parameter.low * of)), min(high, np.log(2.0 * parameter.high * of))
    elif parameter.role == "shape" and not parameter.reference:
        low, high = max(low, np.log(parameter.low)), min(high, np.log(parameter.high))
    elif parameter.role == "amplitude" and not parameter.reference:
        most = float(np.log(parameter.high))
        return min(low, most), min(max(high, centre), most)
    return min(low, centre), max(high, centre)


def to_unbounded(parameter: Parameter, value: float) -> float:
    """Return the entry of a value: its log, or itself where signed."""
    return float(value) if parameter.signed else float(np.log(max(value, 1e-300)))


def from_unbounded(parameter: Parameter, x: Array) -> Array:
    """Return the values of entries."""
    return x if parameter.signed else np.exp(np.clip(x, -80, 80))
