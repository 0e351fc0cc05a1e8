"""Closed-loop performance: poles, quadratic indices, spillover, force bounds.

The index is J = integral of x^T Q x + u^T R u (4.4), from a Lyapunov equation. The weights of `vlab.design.weights`
carry their units. J of a shape of one inch is therefore the dissertation's number.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg
from scipy.optimize import linear_sum_assignment

from vlab.design.state_model import StateModel
from vlab.design.weights import Weights
from vlab.errors import BadDesign
from vlab.signals import Array

INCH = 0.0254
"""INCH [m]: largest deflection of an initial shape (section 4.1.1)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Poles:
    """Modes of a linear system x' = A x by frequency.

    Each pair is represented by its upper pole, a real pole by itself.

    Parameters
    ----------
    s : (k,) complex array
        Poles [rad/s] with Im s >= 0.
    """

    s: Array

    @property
    def freq(self) -> Array:
        """Frequencies |s|/(2 pi) [Hz]."""
        return np.abs(self.s) / (2 * np.pi)

    @property
    def zeta(self) -> Array:
        """Damping ratios -Re s/|s|.

        A stable real pole has 1, a pole at the origin 0.
        """
        size = np.abs(self.s)
        return np.where(size > 0, -self.s.real / np.where(size > 0, size, 1.0), 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Spillover:
    """Damping of the truncated modes before and after control.

    The controller, designed on a reduced model, acts on the full model. Its action on truncated modes is spillover
    [1]_.

    Parameters
    ----------
    modes : (k,) tuple of int
        Numbers of the modes of the full model, from 1.
    freq : (k,) array
        Undisturbed frequency [Hz].
    before, after : (k,) array
        Damping ratio without and with the controller.

    References
    ----------
    .. [1] M. J. Balas, Feedback control of flexible systems, IEEE Transactions on Automatic Control 23 (1978) 673-679.
    """

    modes: tuple[int, ...]
    freq: Array
    before: Array
    after: Array

    @property
    def change(self) -> Array:
        """Change of each damping ratio; negative for destabilisation."""
        return self.after - self.before

    def losing(self, least: float = 1e-9) -> tuple[int, ...]:
        """Return the modes that lose more than `least` of damping ratio.

        The default excludes rounding.
        """
        return tuple(mode for mode, change in zip(self.modes, self.change, strict=True) if change < -least)


def poles(A: ArrayLike) -> Poles:
    """Return the poles of x' = A x by frequency."""
    s = linalg.eigvals(np.asarray(A, dtype=float))
    s = s[s.imag >= 0]
    return Poles(s=s[np.argsort(np.abs(s), kind="stable")])


def damping_ratios(A: ArrayLike, count: int | None = None) -> Array:
    """Return the damping ratios of x' = A x by frequency.

    `count` limits the number.
    """
    return poles(A).zeta[:count]


def match_poles(expected: ArrayLike, found: ArrayLike) -> Array:
    """Return the found pole of each expected pole, one to one.

    The assignment minimises the sum of distances relative to |expected|. Sorting would confuse two modes that cross in
    frequency.

    Parameters
    ----------
    expected : (k,) complex array
    found : (m,) complex array
        Computed poles, m >= k.
    """
    have = np.asarray(found, dtype=complex)
    return have[_matched(np.asarray(expected, dtype=complex), have)]


def initial_shapes(model: StateModel, modes: int | Sequence[int] | Array, peak: float = INCH) -> Array:
    """Return undamped mode shapes of given peak, (n, k): section 4.1.1.

    Parameters
    ----------
    model : StateModel
        State model.
    modes : int or sequence of int
        Number of first modes, or their numbers from 0.
    peak : float
        Largest translation of each shape [m].

    Returns
    -------
    array
        Shapes, (n, k).
    """
    chosen = np.arange(modes) if isinstance(modes, int | np.integer) else np.asarray(modes, dtype=int)
    if not chosen.size or chosen.min() < 0 or chosen.max() >= model.n:
        raise BadDesign(
            f"initial shapes {modes} of a model with {model.n} modes; give 1 to {model.n}, or numbers from 0"
        )
    shapes = model.shapes[:, chosen]
    return shapes * (peak / np.abs(shapes[model.is_translation]).max(axis=0))


def initial_states(model: StateModel, modes: int | Sequence[int] | Array, peak: float = INCH) -> Array:
    """Return the states x_0 = [0, phi_i] of `initial_shapes`, (2n, k)."""
    shapes = initial_shapes(model, modes, peak)
    return np.vstack([np.zeros_like(shapes), shapes])


def shared_modes(model: StateModel, reduced: StateModel) -> Array:
    """Return the model's mode (from 0) of each reduced mode.

    Modes correspond by shape at the common coordinates (MAC in the reduced mass) and by pole. An exact reduction agrees
    to rounding in both.

    Parameters
    ----------
    model : StateModel
        Full model.
    reduced : StateModel
        Reduced model.

    Returns
    -------
    array
        Mode numbers, one to one.
    """
    if reduced.n > model.n:
        raise BadDesign(f"the reduced model has {reduced.n} modes, the model only {model.n}")
    distance = _distance(_modal_poles(reduced), _modal_poles(model))
    common = [label for label in reduced.coordinates if label in model.coordinates]
    if common:
        theirs, ours = ([part.coordinates.index(label) for label in common] for part in (reduced, model))
        mass, phi, seen = reduced.M[np.ix_(theirs, theirs)], reduced.shapes[theirs], model.shapes[ours]
        lengths = np.outer(*(np.einsum("ij,ik,kj->j", shape, mass, shape) for shape in (phi, seen)))
        distance = distance + 1 - (phi.T @ mass @ seen) ** 2 / np.maximum(lengths, 1e-300)
    return linear_sum_assignment(distance)[1]


def quadratic_index(A: ArrayLike, Q: ArrayLike, x0: ArrayLike) -> Array:
    """Return the integral of x^T Q x for x' = A x.

    For each column x0 the value is x0^T P x0, with A^T P + P A + Q = 0.

    Parameters
    ----------
    A, Q : (m, m) array
    x0 : (m, k) or (m,) array

    Returns
    -------
    (k,) array

    Raises
    ------
    BadDesign
        The loop is not asymptotically stable, so the integral diverges.
    """
    a, q, start = (np.asarray(part, dtype=float) for part in (A, Q, x0))
    start = start.reshape(len(start), -1)
    if a.ndim != 2 or a.shape != (len(start),) * 2 or q.shape != a.shape:
        raise BadDesign(f"A {a.shape}, Q {q.shape} and the initial states {start.shape} do not fit together")
    found = poles(a)
    if found.s.real.max() >= 0:
        worst = int(np.argmax(found.s.real))
        raise BadDesign(
            f"the closed loop is unstable at {found.freq[worst]:.4g} Hz (damping ratio {found.zeta[worst]:.3g}): "
            "its quadratic index is infinite; lower the gain or design on a model that has this mode"
        )
    P = linalg.solve_continuous_lyapunov(a.T, -q)
    return np.einsum("ik,ij,jk->k", start, P, start)


def regulator_index(model: StateModel, F: ArrayLike, weights: Weights, x0: Array) -> Array:
    """Return J of u = -F x for each column of x0 (2n, k).

    Equation (4.7) for the optimal F; the result holds for any stabilising F.
    """
    gain = _gain(F, "the state feedback F", (model.B.shape[1], 2 * model.n))
    return quadratic_index(model.A - model.B @ gain, weights.Q + gain.T @ weights.R @ gain, x0)


def rate_feedback_index(model: StateModel, D: ArrayLike, weights: Weights, x0: Array) -> Array:
    """Return J of u = -D y for each column of x0 (2n, k).

    Equations (4.33)-(4.36) with F_D = D C.
    """
    gain = _gain(D, "the gain matrix D", (model.B.shape[1], len(model.C)))
    return regulator_index(model, gain @ model.C, weights, x0)


def rate_feedback_loop(model: StateModel, D: ArrayLike) -> Array:
    """Return A - B D C: equation (4.35)."""
    return model.A - model.B @ _gain(D, "the gain matrix D", (model.B.shape[1], len(model.C))) @ model.C


def lqg_loop(model: StateModel, F: Array, K: Array) -> Array:
    """Return the matrix of (4.16) for [x, e], e = x - x_est.

    The shape is (4n, 4n).
    """
    A, B, C = model.A, model.B, model.C
    return np.block([[A - B @ F, B @ F], [np.zeros_like(A), A - K @ C]])


def lqg_index(model: StateModel, F: Array, K: Array, weights: Weights, x0: Array) -> Array:
    """Return J of estimated state feedback: (4.18)-(4.22).

    The model is the design model, and x_est(0) = 0.
    """
    force = F.T @ weights.R @ F
    Q = np.block([[weights.Q + force, -force], [-force, force]])
    return quadratic_index(lqg_loop(model, F, K), Q, np.vstack([x0, x0]))


def reduced_controller_loop(model: StateModel, reduced: StateModel, F: Array, K: Array) -> Array:
    """Return A_E of (4.24): a model under a reduced controller.

    The state is [x, x_R,est].
    """
    if model.channels != reduced.channels:
        raise BadDesign(f"the model has the coils {model.channels}, the controller's {reduced.channels}")
    estimator = reduced.A - K @ reduced.C - reduced.B @ F
    return np.block([[model.A, -model.B @ F], [K @ model.C, estimator]])


def reduced_controller_index(
    model: StateModel, reduced: StateModel, F: Array, K: Array, weights: Weights, x0: Array
) -> Array:
    """Return J of a reduced controller on a model: (4.26)-(4.29).

    The estimate starts at x_R,est(0) = 0.

    Parameters
    ----------
    model : StateModel
        Full model.
    reduced : StateModel
        Design model of the controller.
    F : array
        Regulator gain.
    K : array
        Filter gain.
    weights : Weights
        Q for the states of `model` (not of `reduced`), and R.
    x0 : (2n, k) array
        Initial states of `model`.
    """
    Q = linalg.block_diag(weights.Q, F.T @ weights.R @ F)
    start = np.vstack([x0, np.zeros((2 * reduced.n, x0.shape[1]))])
    return quadratic_index(reduced_controller_loop(model, reduced, F, K), Q, start)


def reduced_controller_poles(model: StateModel, reduced: StateModel, F: Array, K: Array) -> tuple[Poles, Spillover]:
    """Return the regulator's poles on a larger model, and spillover.

    For an exact reduction without coupling, the poles of A_E are those of regulator, filter and truncated modes. Each
    is matched to its pole of A_E.

    Parameters
    ----------
    model : StateModel
        Full model.
    reduced : StateModel
        Design model of the controller.
    F : array
        Regulator gain.
    K : array
        Filter gain.

    Returns
    -------
    Poles
        One for each pole of A_R - B_R F, in its order.
    Spillover
        Modes of `model` that `reduced` lacks, see `shared_modes`.
    """
    s = poles(reduced_controller_loop(model, reduced, F, K)).s
    regulator = poles(reduced.A - reduced.B @ F).s
    kalman = poles(reduced.A - K @ reduced.C).s
    open_loop = Poles(s=_modal_poles(model))
    left_out = np.setdiff1d(np.arange(model.n), shared_modes(model, reduced))
    found = match_poles(np.concatenate([regulator, kalman, open_loop.s[left_out]]), s)
    spilled = Spillover(
        modes=tuple(int(mode) + 1 for mode in left_out),
        freq=open_loop.freq[left_out],
        before=open_loop.zeta[left_out],
        after=Poles(s=found[regulator.size + kalman.size :]).zeta,
    )
    return Poles(s=found[: regulator.size]), spilled


def force_bounds(D: ArrayLike) -> Array:
    """Return f_i = sum_j |d_ij|: equation (4.31).

    f_i is the largest force of coil i per bound of all velocities.
    """
    gain = np.asarray(D, dtype=float)
    if gain.ndim != 2:
        raise BadDesign(f"the gain matrix D of shape {gain.shape} is no matrix")
    return np.abs(gain).sum(axis=1)


def _modal_poles(model: StateModel) -> Array:
    """Return the poles of the undamped modes with modal damping."""
    omega = np.sqrt(np.abs(np.einsum("ij,ik,kj->j", model.shapes, model.K, model.shapes)))
    C = -model.M @ model.A[: model.n, : model.n]
    decay = np.einsum("ij,ik,kj->j", model.shapes, C, model.shapes) / 2
    return -decay + 1j * np.sqrt(np.maximum(omega**2 - decay**2, 0))


def _matched(expected: Array, found: Array) -> Array:
    if found.size < expected.size:
        raise BadDesign(f"{expected.size} poles are expected but only {found.size} with Im s >= 0 were found")
    return linear_sum_assignment(_distance(expected, found))[1]


def _distance(expected: Array, found: Array) -> Array:
    return np.abs(expected[:, None] - found[None, :]) / np.maximum(np.abs(expected), 1e-12)[:, None]


def _gain(given: ArrayLike, name: str, shape: tuple[int, int]) -> Array:
    gain = np.asarray(given, dtype=float)
    if gain.shape != shape or not np.all(np.isfinite(gain)):
        raise BadDesign(f"{name} of shape {gain.shape} is not a finite {shape[0]} x {shape[1]} matrix")
    return gain
