"""Weights and noise of the designs, converted from published units to SI.

The dissertation has x = [q', q] in inches and radians, forces in pounds and time in centiseconds (section 3.0). Q, R,
V_1, V_2 and alpha have the same units without explicit statement. In vlab the state stays in SI and the weights carry
the conversion. The index J and every gain then keep their meaning.
"""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from vlab import units
from vlab.design.state_model import StateModel
from vlab.errors import BadDesign
from vlab.signals import Array


class AskedWeights(Protocol):
    """Weights in published units, as in `vlab.design.published_tables.PublishedDesign`."""

    @property
    def weights(self) -> str:
        """``"energy"`` for Q = diag(M, K), else Q = q I."""

    @property
    def q(self) -> float:
        """Factor of Q."""

    @property
    def r(self) -> float:
        """Factor of R."""

    @property
    def si(self) -> frozenset[str]:
        """Names of the factors in SI; all others are in published units."""


class AskedNoise(Protocol):
    """Noise and filter margin in published units."""

    @property
    def v1(self) -> float:
        """Factor of V_1."""

    @property
    def v2(self) -> float:
        """Factor of V_2."""

    @property
    def alpha(self) -> float:
        """Stability margin of the filter."""

    @property
    def si(self) -> frozenset[str]:
        """Names of the factors in SI; all others are in published units."""


INDEFINITE = 1e-10
"""INDEFINITE [1]: negative eigenvalue of a scaled weight, relative to the largest, that counts as rounding."""


@dataclass(frozen=True, kw_only=True)
class PublishedUnits:
    """Units of the published weights.

    Parameters
    ----------
    time, length, force : str
        Unit names; angles are always in radians.
    """

    time: str = "cs"
    length: str = "in"
    force: str = "lbf"

    @property
    def seconds(self) -> float:
        """Seconds in a unit of time."""
        return units.factor(self.time, "s")

    @property
    def metres(self) -> float:
        """Metres in a unit of length."""
        return units.factor(self.length, "m")

    @property
    def newtons(self) -> float:
        """Newtons in a unit of force."""
        return units.factor(self.force, "N")

    def per_state(self, model: StateModel) -> Array:
        """Return the factors from SI states to published units, (2n,)."""
        size = np.where(model.is_translation, 1 / self.metres, 1.0)
        return np.concatenate([size * self.seconds, size])


PUBLISHED_UNITS = PublishedUnits()
"""Centiseconds, inches and pounds."""
SI_UNITS = PublishedUnits(time="s", length="m", force="N")
"""Seconds, metres and newtons."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Weights:
    """Q and R of the quadratic index in SI.

    J is the integral of x^T Q x + u^T R u over time [s].

    Parameters
    ----------
    Q : (2n, 2n) array
        Symmetric, positive semidefinite.
    R : (n_c, n_c) array
        Symmetric, positive definite.

    Raises
    ------
    BadDesign
        A matrix is not symmetric, indefinite or not finite.
    """

    Q: Array
    R: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "Q", checked_weight(self.Q, "the state weight Q", definite=False))
        object.__setattr__(self, "R", checked_weight(self.R, "the control weight R", definite=True))


@dataclass(frozen=True, kw_only=True, eq=False)
class Noise:
    """Kalman-filter intensities and stability margin in SI.

    Parameters
    ----------
    V1 : (2n, 2n) array
        Intensity of the state excitation w_1.
    V2 : (n_s, n_s) array
        Intensity of the measurement noise w_2; positive definite.
    alpha : float
        Margin [1/s]: every filter pole lies left of -alpha (4.9).

    Raises
    ------
    BadDesign
        A matrix fails as in `Weights`, or alpha is negative or not finite.
    """

    V1: Array
    V2: Array
    alpha: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "V1", checked_weight(self.V1, "the excitation intensity V1", definite=False))
        object.__setattr__(self, "V2", checked_weight(self.V2, "the measurement noise V2", definite=True))
        if not (np.isfinite(self.alpha) and self.alpha >= 0):
            raise BadDesign(f"the stability margin alpha = {self.alpha} 1/s is not zero or a positive number")


def identity_weights(model: StateModel, q: float, r: float, units: PublishedUnits = PUBLISHED_UNITS) -> Weights:
    """Return Q = q I and R = r I in the published convention.

    Parameters
    ----------
    model : StateModel
        State model.
    q, r : float
        Factors, such as 1 and 0.22 on the beam (section 6.1) or 0.01 and 0.84 on the grid (section 6.2.1).
    units : PublishedUnits
        Units of the factors.
    """
    scale = units.per_state(model)
    Q = _positive(q, "q") * np.diag(scale**2) / units.seconds
    return Weights(Q=Q, R=_control_weight(model, r, units))


def energy_weights(model: StateModel, r: float, units: PublishedUnits = PUBLISHED_UNITS) -> Weights:
    """Return Q = diag(M, K) and R = r I in published units.

    x^T Q x is twice the energy of the structure (6.1). J has the unit of force times length times time.
    """
    n = model.n
    Q = np.zeros((2 * n, 2 * n))
    Q[:n, :n], Q[n:, n:] = model.M, model.K
    return Weights(Q=Q / (units.newtons * units.metres * units.seconds), R=_control_weight(model, r, units))


def published_noise(
    model: StateModel, v1: float, v2: float, alpha: float, units: PublishedUnits = PUBLISHED_UNITS
) -> Noise:
    """Return V_1 = v1 I, V_2 = v2 I and alpha as published.

    Parameters
    ----------
    model : StateModel
        State model.
    v1, v2, alpha : float
        Values, such as 1e-6, 5e-4 and 0.2 per centisecond on the beam (section 6.1).
    units : PublishedUnits
        Units of the factors.

    Returns
    -------
    Noise
        Noise in SI.
    """
    scale, tick = units.per_state(model), units.seconds
    velocity = units.metres / tick
    return Noise(
        V1=_positive(v1, "v1") * np.diag(scale**-2.0) / tick,
        V2=_positive(v2, "v2") * velocity**2 * tick * np.eye(len(model.C)),
        alpha=alpha / tick,
    )


def weights_of(asked: AskedWeights, model: StateModel) -> Weights:
    """Return the required Q and R for a model's states.

    The energy Q = diag(M, K) has no factor and takes the units of R.

    Parameters
    ----------
    asked : AskedWeights
        Kind and factors of the weights.
    model : StateModel
        State model.

    Returns
    -------
    Weights
        Weights in SI.
    """
    of_r = _units_of(asked.si, "r")
    if asked.weights == "energy":
        return energy_weights(model, asked.r, of_r)
    Q = identity_weights(model, asked.q, asked.r, _units_of(asked.si, "q")).Q
    return Weights(Q=Q, R=_control_weight(model, asked.r, of_r))


def noise_of(asked: AskedNoise, model: StateModel) -> Noise:
    """Return the required noise and margin for a model's states.

    Parameters
    ----------
    asked : AskedNoise
        Factors of the intensities, and margin.
    model : StateModel
        State model.

    Returns
    -------
    Noise
        Noise in SI.
    """
    parts = {
        name: published_noise(model, asked.v1, asked.v2, asked.alpha, _units_of(asked.si, name))
        for name in ("v1", "v2", "alpha")
    }
    return Noise(V1=parts["v1"].V1, V2=parts["v2"].V2, alpha=parts["alpha"].alpha)


def _units_of(si: frozenset[str], name: str) -> PublishedUnits:
    return SI_UNITS if name in si else PUBLISHED_UNITS


def checked_weight(given: ArrayLike, name: str, *, definite: bool) -> Array:
    """Return a symmetric weight as a read-only array.

    Definiteness is judged after scaling to a unit diagonal, because states have different units.

    Parameters
    ----------
    given : array_like
        Matrix.
    name : str
        Name in messages.
    definite : bool
        Whether the matrix must be positive definite.

    Returns
    -------
    array
        Weight.

    Raises
    ------
    BadDesign
        The matrix is not finite, not symmetric or not definite.
    """
    try:
        matrix = np.array(given, dtype=float)
    except (TypeError, ValueError) as error:
        raise BadDesign(f"{name} is not a matrix of numbers: {error}") from error
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not np.all(np.isfinite(matrix)):
        raise BadDesign(f"{name} of shape {matrix.shape} is not a finite square matrix")
    if not np.allclose(matrix, matrix.T, rtol=0, atol=1e-9 * np.abs(matrix).max(initial=0.0)):
        raise BadDesign(f"{name} is not symmetric; give (X + X^T)/2")
    diagonal = np.diag(matrix)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values = np.linalg.eigvalsh(matrix * np.outer(scale, scale))
    least = INDEFINITE * max(float(np.abs(values).max(initial=0.0)), 1e-300)
    if definite and values.min(initial=np.inf) <= least:
        raise BadDesign(f"{name} is not positive definite: smallest scaled eigenvalue {values.min():.3g}")
    if not definite and values.min(initial=0.0) < -least:
        raise BadDesign(f"{name} is indefinite: smallest scaled eigenvalue {values.min():.3g}; it must be >= 0")
    matrix = (matrix + matrix.T) / 2
    matrix.setflags(write=False)
    return matrix


def _control_weight(model: StateModel, r: float, units: PublishedUnits) -> Array:
    return _positive(r, "r") / (units.newtons**2 * units.seconds) * np.eye(model.B.shape[1])


def _positive(value: float, name: Literal["q", "r", "v1", "v2"]) -> float:
    if not (np.isfinite(value) and value > 0):
        raise BadDesign(f"the factor {name} = {value} is not a positive number")
    return float(value)
