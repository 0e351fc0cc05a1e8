"""State-space models with a small nonlinear part, fitted to free runs.

The model is ``x(k+1) = A x(k) + B u(k) + W tanh(V [x(k); u(k)] + b)`` with the outputs ``y(k) = C x(k) + D u(k) + y0``
[1]_. Without hidden units the model is linear. A fit minimises the error of the free run with a damped Gauss-Newton
method; every recording has an initial state of its own. The hyperbolic tangents are bounded, so free runs seldom diverge.

References
----------
.. [1] J. A. K. Suykens, B. L. R. De Moor, J. Vandewalle, Nonlinear system identification using neural state space models,
   applicable to robust control design, International Journal of Control 62 (1995) 129-152.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from vlab.proof.real.kernels import free_run, normal_equations
from vlab.signals import Array

DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-12, 1e8
"""DAMPING [-]: first ratio of the damping to the diagonal of the normal equations.
LEAST_DAMPING [-]: smallest ratio.
MOST_DAMPING [-]: ratio at which a fit ends, because no step decreases the error."""
FLOOR = 1e-9
"""FLOOR [-]: damping of directions that no recording informs, relative to the largest diagonal entry."""
CONVERGED = 1e-5
"""CONVERGED [-]: relative decrease of the squared error at which a fit ends after `PATIENCE` such steps."""
PATIENCE = 3
"""PATIENCE [-]: consecutive small steps that end a fit."""
STAGES = (32, 8, 2, 1)
"""STAGES [-]: parts into which every recording is cut in successive fits; short parts have no distant minima."""
MOST_STARTS = 300
"""MOST_STARTS [-]: most unknowns in the initial states of all parts of a fit."""
LEAST_PART = 60
"""LEAST_PART [samples]: shortest part."""
START_STEPS = 20
"""START_STEPS [-]: most steps of a fit of an initial state alone."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Evenly sampled recording in scaled units.

    Parameters
    ----------
    u : (N, m) array
        Inputs; m = 0 for a free motion.
    y : (N, p) array
        Outputs.
    weight : (N, p) array
        Weights of the output errors; zero without a reading.
    """

    u: Array
    y: Array
    weight: Array

    def rows(self, rows: slice) -> "Samples":
        """Return some samples."""
        return Samples(u=self.u[rows], y=self.y[rows], weight=self.weight[rows])


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """State-space model with a layer of hyperbolic tangents.

    Parameters
    ----------
    A, B, C, D : array
        Linear part: (n, n), (n, m), (p, n), (p, m).
    y0 : (p,) array
        Outputs at rest.
    W, V, b : array
        Nonlinear part of h units: (n, h), (h, n + m), (h,); h = 0 for a linear model.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    y0: Array
    W: Array = field(default_factory=lambda: np.zeros((0, 0)))
    V: Array = field(default_factory=lambda: np.zeros((0, 0)))
    b: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if self.W.shape[0] != self.order:
            object.__setattr__(self, "W", np.zeros((self.order, 0)))
            object.__setattr__(self, "V", np.zeros((0, self.order + self.B.shape[1])))

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.A.shape[0])

    @property
    def units(self) -> int:
        """Number of hyperbolic tangents."""
        return int(self.b.size)

    @property
    def parts(self) -> tuple[Array, ...]:
        """Matrices in the order of the compiled loops."""
        given = (self.A, self.B, self.C, self.D, self.y0, self.W, self.V, self.b)
        return tuple(np.ascontiguousarray(part, dtype=float) for part in given)

    @property
    def vector(self) -> Array:
        """Parameters in the order of `normal_equations`, without initial states."""
        parts = (self.A, self.B, self.W, self.V, self.b, self.C, self.D, self.y0)
        return np.concatenate([np.ravel(part) for part in parts])

    def with_vector(self, values: Array) -> "Model":
        """Return the model with other parameters.

        Parameters
        ----------
        values : array
            Parameters in the order of `vector`.

        Returns
        -------
        Model
            Model.
        """
        names = ("A", "B", "W", "V", "b", "C", "D", "y0")
        shapes = [getattr(self, name).shape for name in names]
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1]
        pieces = np.split(values, ends)
        changed = {name: piece.reshape(shape) for name, piece, shape in zip(names, pieces, shapes, strict=True)}
        return replace(self, **changed)

    def simulated(self, x0: Array, u: Array) -> Array:
        """Simulate a free run.

        Parameters
        ----------
        x0 : (n,) array
            State at the first sample.
        u : (N, m) array
            Inputs.

        Returns
        -------
        (N, p) array
            Outputs; NaN after divergence.
        """
        arrays = (*self.parts, np.ascontiguousarray(x0), np.ascontiguousarray(u))
        return np.asarray(free_run(*arrays))

    def with_units(self, count: int, spread: Array, seed: int = 0) -> "Model":
        """Return the model with hyperbolic tangents that do nothing yet.

        Parameters
        ----------
        count : int
            Number of units.
        spread : (n + m,) array
            Standard deviations of states and inputs.
        seed : int
            Seed of the directions.

        Returns
        -------
        Model
            Model with the same free run: the units have random directions and zero output.
        """
        generator = np.random.default_rng(seed)
        directions = generator.normal(size=(count, spread.size)) / np.sqrt(spread.size)
        return replace(
            self,
            W=np.zeros((self.order, count)),
            V=2.0 * directions / np.maximum(spread, 1e-12),
            b=generator.uniform(-1.0, 1.0, size=count),
        )

    def scaled(self, spread: Array) -> "Model":
        """Return the same linear model with states over their spread (n,)."""
        return replace(self, A=self.A / spread[:, None] * spread, B=self.B / spread[:, None], C=self.C * spread)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """Model with the initial states of the fitted recordings.

    Parameters
    ----------
    model : Model
        Model.
    starts : tuple of (n,) array
        Initial state of every recording.
    cost : float
        Sum of squared weighted errors, and of the ridge.
    """

    model: Model
    starts: tuple[Array, ...]
    cost: float

    def states(self, samples: Sequence[Samples]) -> Array:
        """Return the states of the free runs over all recordings.

        Parameters
        ----------
        samples : sequence of Samples
            Fitted recordings, in their order.

        Returns
        -------
        (N, n) array
            States.
        """
        found = []
        for own, x0 in zip(samples, self.starts, strict=True):
            seen = replace(self.model, C=np.eye(self.model.order), D=np.zeros_like(self.model.B))
            seen = replace(seen, y0=np.zeros(self.model.order))
            found.append(seen.simulated(x0, own.u))
        return np.vstack(found)


def fit(
    model: Model,
    samples: Sequence[Samples],
    starts: Sequence[Array],
    *,
    steps: int,
    only: Sequence[str] = (),
    ridge: float = 0.0,
) -> Fitted:
    """Fit a model and the initial states to free runs.

    Parameters
    ----------
    model : Model
        Start.
    samples : sequence of Samples
        Recordings.
    starts : sequence of (n,) array
        First estimates of the initial states, which are always free.
    steps : int
        Most accepted or rejected steps.
    only : sequence of str
        Free matrices of the model; all by default. ``"x0"`` frees the initial states alone.
    ridge : float
        Weight of the squared entries of W and V beside the squared errors.

    Returns
    -------
    Fitted
        Model, initial states and error.
    """
    free = _freed(model, only)
    best = Fitted(model=model, starts=tuple(np.array(x) for x in starts), cost=np.inf)
    matrix, right, cost = _assembled(best, samples, ridge)
    best = replace(best, cost=cost)
    if not np.isfinite(cost):
        return best
    damping, small = DAMPING, 0
    kept = np.concatenate([free, np.ones(matrix.shape[0] - free.size, dtype=bool)])
    for _ in range(steps):
        own, force = matrix[np.ix_(kept, kept)], right[kept]
        diagonal = np.diag(own).copy()
        loaded = own + np.diag(damping * diagonal + FLOOR * diagonal.max(initial=0.0) * min(1.0, damping))
        move = np.zeros(kept.size)
        move[kept] = np.linalg.lstsq(loaded, force, rcond=1e-15)[0]
        trial = _moved(best, move)
        found, force, cost = _assembled(trial, samples, ridge)
        if cost < best.cost:
            small = small + 1 if cost > (1.0 - CONVERGED) * best.cost else 0
            best, matrix, right = replace(trial, cost=cost), found, force
            damping = max(0.2 * damping, LEAST_DAMPING)
            if small >= PATIENCE or cost == 0.0:
                break
        else:
            damping *= 5.0
            if damping > MOST_DAMPING:
                break
    return best


def estimated_start(model: Model, own: Samples, window: int) -> Array:
    """Return the initial state that fits the first samples of a recording.

    Parameters
    ----------
    model : Model
        Model.
    own : Samples
        Recording.
    window : int
        Number of samples that the estimate may use.

    Returns
    -------
    (n,) array
        Initial state.
    """
    early = own.rows(slice(window))
    return fit(model, [early], [np.zeros(model.order)], steps=START_STEPS, only=("x0",)).starts[0]


def fit_in_stages(model: Model, samples: Sequence[Samples], *, steps: int, window: int, ridge: float = 0.0) -> Fitted:
    """Fit a nonlinear model to short parts first, then to whole recordings.

    The free run of a wrong nonlinear model departs soon, and the error then has many minima. Parts with initial states of
    their own avoid them (multiple shooting [1]_).

    Parameters
    ----------
    model : Model
        Start.
    samples : sequence of Samples
        Recordings.
    steps : int
        Most steps of every stage.
    window : int
        Samples for the first estimate of an initial state.
    ridge : float
        See `fit`.

    Returns
    -------
    Fitted
        Model and the initial states of the whole recordings.

    References
    ----------
    .. [1] H. G. Bock, Recent advances in parameter identification techniques for O.D.E., in Numerical Treatment of Inverse
       Problems in Differential and Integral Equations, Birkhäuser, 1983, 95-121.
    """
    whole = model
    found = Fitted(model=model, starts=(), cost=np.inf)
    for count in STAGES:
        parts = [part for own in samples for part in _parts(own, count)]
        is_whole = count == STAGES[-1]
        if not is_whole and (len(parts) * model.order > MOST_STARTS or len(parts) == len(samples)):
            continue
        starts = [estimated_start(whole, part, window) for part in parts]
        found = fit(whole, parts, starts, steps=steps, ridge=ridge)
        whole = found.model
    return found


def _parts(own: Samples, count: int) -> list[Samples]:
    """Return parts of equal length, fewer where too short."""
    edges = np.linspace(0, len(own.y), max(1, min(count, len(own.y) // LEAST_PART)) + 1).astype(int)
    return [own.rows(slice(a, b)) for a, b in pairwise(edges)]


def _freed(model: Model, only: Sequence[str]) -> Array:
    """Return which entries of `Model.vector` are free."""
    names = ("A", "B", "W", "V", "b", "C", "D", "y0")
    return np.concatenate([np.full(getattr(model, name).size, not only or name in only) for name in names])


def _moved(fitted: Fitted, move: Array) -> Fitted:
    vector, n = fitted.model.vector, fitted.model.order
    rest = move[vector.size :].reshape(len(fitted.starts), n)
    starts = tuple(x + dx for x, dx in zip(fitted.starts, rest, strict=True))
    return Fitted(model=fitted.model.with_vector(vector + move[: vector.size]), starts=starts, cost=np.inf)


def _assembled(fitted: Fitted, samples: Sequence[Samples], ridge: float) -> tuple[Array, Array, float]:
    """Return the normal equations over all recordings.

    The unknowns are `Model.vector` and then every initial state.
    """
    model = fitted.model
    n, count = model.order, model.vector.size
    before = n * n + model.B.size + model.W.size + model.V.size + model.units  # entries before the initial state
    total = count + n * len(samples)
    matrix, right, cost = np.zeros((total, total)), np.zeros(total), 0.0
    for i, (own, x0) in enumerate(zip(samples, fitted.starts, strict=True)):
        arrays = (np.ascontiguousarray(a) for a in (x0, own.u, own.y, own.weight))
        found, force, error = normal_equations(*model.parts, *arrays)
        start = np.arange(count + i * n, count + (i + 1) * n)
        at = np.concatenate([np.arange(before), start, np.arange(before, count)])
        matrix[np.ix_(at, at)] += found
        right[at] += force
        cost += float(error)
    if ridge > 0.0:
        first = n * n + model.B.size
        shrunk = np.arange(first, first + model.W.size + model.V.size)
        values = model.vector[shrunk]
        matrix[shrunk, shrunk] += ridge
        right[shrunk] -= ridge * values
        cost += ridge * float(values @ values)
    return matrix, right, cost if np.all(np.isfinite(right)) else np.inf
