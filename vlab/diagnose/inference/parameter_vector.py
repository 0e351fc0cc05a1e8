"""The vector that a fit in simulation moves: what its entries stand for, in which sizes and within which bounds."""

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
    """Which entry of a fitted vector is what: uncertain parameters along directions, offsets of channels, first states of runs,
    parameters of effects, in this order.

    Parameters
    ----------
    terms : sequence of Term
        The effects at their places whose parameters are fitted.
    limits : sequence of (float, float)
        Least and largest entry of every one of these parameters.
    directions : (n_changes, r) array
        Of the uncertain parameters, of unit prior variance.
    prior : (n_changes,) array
        Standard deviations of the uncertain parameters.
    offset_sd : (n_channels,) array
        Those of the channels' offsets.
    omega : (m,) array
        Angular frequencies of the twin's modes [rad/s].
    active : (n,) array of int
        Modes whose first state is fitted, in every run of `firsts`.
    firsts : (n_free, 2m) array
        First modal states, as estimated before, of the runs that do not start at rest nor from a state of their own.
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
        """Number of entries with a prior of unit variance: directions and offsets. They come first."""
        return self.r + len(self.offset_sd)

    @property
    def first_effect(self) -> int:
        """Where the effects' parameters begin."""
        return self.priors + 2 * len(self.active) * len(self.firsts)

    @cached_property
    def parameters(self) -> list[tuple[int, Parameter]]:
        """Of every effect's parameter the index of its term, and itself."""
        return [(i, parameter) for i, term in enumerate(self.terms) for parameter in term.effect.parameters]

    @property
    def shapes(self) -> list[int]:
        """The entries of parameters that a law is not linear in, of laws that have others."""
        return [
            k
            for k, (i, parameter) in enumerate(self.parameters, start=self.first_effect)
            if parameter.role == "shape" and self.terms[i].effect.amplitudes
        ]

    @cached_property
    def start_scale(self) -> Array:
        """Sizes that first states are fitted in, (2 n_active,)."""
        m, a = len(self.omega), self.active
        omega = np.maximum(np.abs(self.omega[a]), 1.0)
        if not len(a):
            return np.zeros(0)
        speed = max(float(np.max(np.abs(np.concatenate([x[a] * omega, x[m + a]])))) for x in self.firsts)
        speed = max(speed, 1e-9)
        return PARAMETER_VECTOR.start_size * np.concatenate([speed / omega, np.full(len(a), speed)])

    def project_prior(self, theta: Array) -> Array:
        """Return log-factors along the directions, in standard deviations of their prior; the rest is left out."""
        return np.asarray((self.directions / self.prior[:, None] ** 2).T @ theta)

    def packed(
        self, theta: Array, offsets: Array, states: Sequence[Array], values: Sequence[Mapping[str, float]]
    ) -> Array:
        """Return the vector, within its bounds, of log-factors, offsets, free runs' first states and terms' values."""
        m = len(self.omega)
        parts = [self.project_prior(theta), offsets / self.offset_sd]
        parts += [np.concatenate([x[self.active], x[m + self.active]]) / self.start_scale for x in states]
        parts.append(np.array([to_unbounded(p, values[i][p.name]) for i, p in self.parameters]))
        return np.asarray(self.bounded(np.concatenate(parts)[None])[0])

    def unpacked(self, X: Array) -> tuple[Array, Array, Array, list[dict[str, Array]]]:
        """Return log-factors (n_sets, n_changes), offsets, free runs' first states (n_sets, n_free, 2m) and terms' values of vectors."""
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
        """Return the steps of slopes at a vector."""
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
        """Return vectors brought back within their bounds."""
        out = X.copy()
        for k, (low, high) in enumerate(self.limits, start=self.first_effect):
            out[:, k] = np.clip(out[:, k], low, high)
        out[:, : self.r] = np.clip(out[:, : self.r], -PARAMETER_VECTOR.prior_bound, PARAMETER_VECTOR.prior_bound)
        return out


def limits_of(parameter: Parameter, value: float, reference: Callable[[str], float]) -> tuple[float, float]:
    """Return the least and the largest entry of a parameter that starts at a value; a shape's within its range, which says what it is:
    a damping ratio; a slip or a gap that is a share of the motion, for others are other laws. A size does not go beyond its range, wherever
    it starts: a gain of a thousand is a unit, not an amplifier.

    Parameters
    ----------
    reference : callable
        Gives by name what the parameter's range is in multiples of.
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
    """Return the entry that is fitted for a parameter's value: itself where it has a sign, else its logarithm."""
    return float(value) if parameter.signed else float(np.log(max(value, 1e-300)))


def from_unbounded(parameter: Parameter, x: Array) -> Array:
    """Return the values of fitted entries."""
    return x if parameter.signed else np.exp(np.clip(x, -80, 80))
