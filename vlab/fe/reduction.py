"""Reduction to physical coordinates: exact, Guyan, and search of the coordinates.

Both reductions are q = T q_R with a different T. Hence M_R = T^T M T, loads T^T U and outputs rows @ T. The exact
reduction [3]_ keeps modes; Guyan's [1]_ keeps the static response. The search starts from the elimination of [2]_.
Equation numbers are the dissertation's. Its (3.12)-(3.14) and (3.16) are misprinted and corrected here.

References
----------
.. [1] R. J. Guyan, Reduction of stiffness and mass matrices, AIAA Journal 3 (1965) 380.
.. [2] R. D. Henshell and J. H. Ong, Automatic masters for eigenvalue economization, Earthquake Engineering and
       Structural Dynamics 3 (1975) 375-383.
.. [3] J. O'Callahan, P. Avitabile and R. Riemer, System equivalent reduction expansion process, IMAC VII, 1989: the
       exact reduction for as many coordinates as modes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from vlab.errors import BadStructure, unknown_name
from vlab.fe.second_order import SecondOrderModel
from vlab.signals import Array

INVISIBLE = 1e-7
"""INVISIBLE [1]: smallest singular value of the modes at the retained coordinates, each of unit length over all
modes. The reduced mass squares the value, to 1e-14."""
SINGULAR = 1e-12
"""SINGULAR [1]: smallest eigenvalue of a stiffness with unit diagonal that exceeds rounding."""
RIGID = 1e-4
"""RIGID [1]: frequency relative to the highest compared one below which a mode is a rigid motion, without relative
error."""
IMPROVES = 1e-6
"""IMPROVES [1]: smallest relative improvement of an exchange, so that rounding does not decide between equivalent
coordinates."""

Method = Literal["elimination", "exchange"]
Measure = Literal["worst", "rms"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Reduction:
    """A model in a subset of a larger model's coordinates.

    Parameters
    ----------
    model : SecondOrderModel
        Reduced matrices in the order of `retained`.
    retained : (n_R,) tuple of int
        Kept rows of the full model.
    T : (n, n_R) array
        Motion of all full coordinates per retained one; the identity in the retained rows.
    """

    model: SecondOrderModel
    retained: tuple[int, ...]
    T: Array

    def reduce_loads(self, U: Array) -> Array:
        """Return the load distribution T^T U, (n_R, n_inputs).

        `U` holds loads (n, n_inputs) at any coordinate.
        """
        return self.T.T @ self._of_full_model("loads", np.asarray(U, dtype=float))

    def reduce_outputs(self, rows: Array) -> Array:
        """Return the reduced output rows, (n_outputs, n_R).

        `rows` are output rows (n_outputs, n) of the full model.
        """
        return self._of_full_model("output rows, transposed,", np.asarray(rows, dtype=float).T).T @ self.T

    def _of_full_model(self, what: str, given: Array) -> Array:
        if given.ndim != 2 or len(given) != len(self.T) or not np.all(np.isfinite(given)):
            raise BadStructure(f"{what} of shape {given.shape} are no finite ({len(self.T)}, k): one row a coordinate")
        return given


@dataclass(frozen=True, kw_only=True, eq=False)
class GuyanReduction(Reduction):
    """Static condensation: equations (3.9)-(3.16).

    Condensed coordinates follow the retained ones statically. The static response to any load is exact at the retained
    coordinates; no frequency is below the true one.
    """


@dataclass(frozen=True, kw_only=True, eq=False)
class ExactReduction(Reduction):
    """Exact reduction to n_R modes: equations (3.4)-(3.8).

    Frequencies, ratios and shapes are exact. `model` is the symmetric form for mass-normalised modes, M_R = Phi_R^-T
    Phi_R^-1. A load on a condensed coordinate acts through its modal forces.

    Parameters
    ----------
    modes : (n_R,) tuple of int
        Kept columns of the full model's `eigen`.
    omega, zeta : (n_R,) array
        Circular frequencies [rad/s] and damping ratios.
    shapes : (n_R, n_R) array
        Phi_R: mass-normalised shapes at the retained coordinates.
    condition : float
        Condition of `shapes` with each coordinate scaled by its mobility. Up to twice its decimal logarithm of digits
        are lost.
    """

    modes: tuple[int, ...]
    omega: Array
    zeta: Array
    shapes: Array
    condition: float

    @property
    def Minv_C(self) -> Array:
        """Matrix m_R^-1 c_R of equation (3.6)."""
        return self._in_coordinates(2 * self.zeta * np.abs(self.omega))

    @property
    def Minv_K(self) -> Array:
        """Matrix m_R^-1 k_R of equation (3.7)."""
        return self._in_coordinates(self.omega * np.abs(self.omega))

    def Minv_U(self, U: Array) -> Array:
        """Return m_R^-1 U_R = Phi_R Phi^T U of equation (3.8).

        `U` holds loads (n, n_inputs) at any coordinate.
        """
        return self.shapes @ (self.shapes.T @ self.reduce_loads(U))

    @property
    def A(self) -> Array:
        """State matrix A_R of equation (3.3) for x = [q', q]."""
        n = self.model.n
        return np.block([[-self.Minv_C, -self.Minv_K], [np.eye(n), np.zeros((n, n))]])

    def B(self, U: Array) -> Array:
        """Return the input matrix B_R of equation (3.3).

        `U` holds loads (n, n_inputs) on the full model.
        """
        upper = self.Minv_U(U)
        return np.vstack([upper, np.zeros_like(upper)])

    def _in_coordinates(self, modal: Array) -> Array:
        return linalg.solve(self.shapes.T, (self.shapes * modal).T).T


@dataclass(frozen=True, kw_only=True, eq=False)
class RetainedSearch:
    """Result of a search for coordinates, with its errors.

    Parameters
    ----------
    retained : tuple of str
        Coordinates in the order of the model.
    freq_error : (modes,) array
        Relative error of each frequency under Guyan's reduction, in order of frequency. For a rigid motion the error is
        relative to the highest compared frequency.
    eliminated : tuple of str
        Dropped candidates in order of elimination.
    exchanges : tuple of (str, str)
        Pairs of dropped and added coordinates in the exchange.
    """

    retained: tuple[str, ...]
    freq_error: Array
    eliminated: tuple[str, ...]
    exchanges: tuple[tuple[str, str], ...]


def exact_reduction(
    model: SecondOrderModel,
    retained: Sequence[str | int],
    *,
    modes: Sequence[int] | None = None,
    zeta: ArrayLike | None = None,
) -> ExactReduction:
    """Keep n_R coordinates and modes exactly: equations (3.4)-(3.8).

    Parameters
    ----------
    model : SecondOrderModel
        The full model.
    retained : sequence of str or int
        Labels or numbers (from 0) of the coordinates, in the wanted order.
    modes : sequence of int or None
        Kept columns of `model.eigen` (from 0); None for the lowest n_R. A selection that splits a repeated frequency is
        ill-defined, as are its shapes.
    zeta : array_like or None
        Damping ratio of each retained mode, or one for all; None for the model's own. Modal coupling by the model's C
        is lost in any case.

    Returns
    -------
    ExactReduction
        Reduced model with its modes.

    Raises
    ------
    UnknownName
        No such coordinate.
    BadStructure
        A coordinate or mode is repeated, the numbers differ, or the modes are indistinguishable at the coordinates.
    """
    keep = _rows(model, retained)
    columns = _columns(model, modes, len(keep))
    omega, full = model.eigen[0][columns], model.eigen[1][:, columns]
    shapes = full[keep]
    condition = _visibility(model, keep, columns)
    ratios = model.zeta[columns] if zeta is None else _ratios(zeta, len(keep))
    inverse = linalg.inv(shapes)
    return ExactReduction(
        model=SecondOrderModel(
            M=inverse.T @ inverse,
            C=(inverse.T * (2 * ratios * np.abs(omega))) @ inverse,
            K=(inverse.T * (omega * np.abs(omega))) @ inverse,
            coordinates=tuple(model.coordinates[i] for i in keep),
        ),
        retained=tuple(keep),
        T=full @ inverse,
        modes=tuple(columns),
        omega=omega,
        zeta=ratios,
        shapes=shapes,
        condition=condition,
    )


def guyan_reduction(
    model: SecondOrderModel, retained: Sequence[str | int], *, zeta: ArrayLike | None = None
) -> GuyanReduction:
    """Condense statically: equations (3.9)-(3.16), corrected.

    With G_0 = -K22^-1 K12^T and q_2 = G_0 q_1, K_R = K11 - K12 K22^-1 K12^T and M_R = M11 + M12 G_0 + G_0^T M12^T +
    G_0^T M22 G_0 [1]_.

    Parameters
    ----------
    model : SecondOrderModel
        The full model.
    retained : sequence of str or int
        Labels or numbers (from 0) of the coordinates, in the wanted order.
    zeta : array_like or None
        Damping ratio of each mode of the reduced model, or one for all; None for T^T C T.

    Returns
    -------
    GuyanReduction
        Reduced model.

    Raises
    ------
    UnknownName
        No such coordinate.
    BadStructure
        A coordinate is repeated, or the condensed coordinates move without strain while the retained ones are held.

    References
    ----------
    .. [1] R. J. Guyan, Reduction of stiffness and mass matrices, AIAA Journal 3 (1965) 380.
    """
    keep = _rows(model, retained)
    T = _static_transformation(model.K, keep, model.coordinates)
    reduced = model.transformed(T, [model.coordinates[i] for i in keep])
    if zeta is not None:
        reduced = reduced.with_modal_damping(_ratios(zeta, len(keep)))
    return GuyanReduction(model=reduced, retained=tuple(keep), T=T)


def search_retained(
    model: SecondOrderModel,
    candidates: Sequence[str | int],
    count: int,
    *,
    modes: int,
    method: Method = "exchange",
    measure: Measure = "worst",
) -> RetainedSearch:
    """Search the coordinates of the best Guyan reduction.

    The criterion is the error of the lowest frequencies. The elimination condenses the coordinate of the largest
    K_ii/M_ii, one after the other, with matrices reduced each time [1]_. The exchange then swaps retained and dropped
    candidates while the best swap improves the criterion. The result is independent of the candidates' order; it is a
    local optimum without proof of being the best set.

    Parameters
    ----------
    model : SecondOrderModel
        Full model.
    candidates : sequence of str or int
        Measurable coordinates; all further coordinates are always condensed.
    count : int
        Number of coordinates to keep.
    modes : int
        Number of lowest frequencies in the criterion.
    method : {"exchange", "elimination"}
        With or without the exchange.
    measure : {"worst", "rms"}
        Criterion of the exchange: largest or root-mean-square frequency error.

    Returns
    -------
    RetainedSearch
        Coordinates, errors and steps of the search.

    References
    ----------
    .. [1] R. D. Henshell and J. H. Ong, Automatic masters for eigenvalue economization, Earthquake Engineering and
           Structural Dynamics 3 (1975) 375-383.
    """
    if method not in ("elimination", "exchange"):
        raise unknown_name("method", str(method), ("elimination", "exchange"), where="search_retained")
    if measure not in ("worst", "rms"):
        raise unknown_name("measure", str(measure), ("worst", "rms"), where="search_retained")
    rows = sorted(_rows(model, candidates))
    if not 1 <= modes <= count <= len(rows):
        raise BadStructure(
            f"{modes} modes, {count} coordinates to keep and {len(rows)} candidates: 1 <= modes <= count <= candidates must hold"
        )
    base = guyan_reduction(model, rows).model
    true = model.freq[:modes]
    keep, eliminated = _eliminate(base, count)
    exchanges: list[tuple[int, int]] = []
    while method == "exchange":
        swap = _best_swap(base, keep, true, measure)
        if swap is None:
            break
        exchanges.append(swap)
        keep = sorted({*keep, swap[1]} - {swap[0]})
    label = base.coordinates
    return RetainedSearch(
        retained=tuple(label[i] for i in keep),
        freq_error=_freq_error(*_condense(base, keep), true),
        eliminated=tuple(label[i] for i in eliminated),
        exchanges=tuple((label[i], label[j]) for i, j in exchanges),
    )


def _rows(model: SecondOrderModel, retained: Sequence[str | int]) -> list[int]:
    if isinstance(retained, str):
        raise BadStructure(f"the retained coordinates must be a sequence of labels, not the one text {retained!r}")
    rows = []
    for item in retained:
        if isinstance(item, str):
            if item not in model.coordinates:
                raise unknown_name("coordinate", item, model.coordinates)
            rows.append(model.coordinates.index(item))
        else:
            rows.append(_number("coordinate", item, model.n))
    if not rows:
        raise BadStructure("no coordinate is retained; name at least one")
    for row in rows:
        if rows.count(row) > 1:
            raise BadStructure(f"the coordinate {model.coordinates[row]!r} is retained {rows.count(row)} times")
    return rows


def _columns(model: SecondOrderModel, modes: Sequence[int] | None, count: int) -> list[int]:
    columns = list(range(count)) if modes is None else [_number("mode", item, model.n) for item in modes]
    for column in columns:
        if columns.count(column) > 1:
            raise BadStructure(f"mode {column} is retained {columns.count(column)} times")
    if len(columns) != count:
        why = "they cannot carry more" if len(columns) > count else "with fewer the reduced mass is singular"
        raise BadStructure(f"{len(columns)} modes for {count} retained coordinates: {why}; retain as many of each")
    return columns


def _number(kind: str, item: object, n: int) -> int:
    if isinstance(item, bool) or not isinstance(item, int | np.integer):
        raise BadStructure(f"{item!r} is no {kind}; give a whole number{' or a label' if kind == 'coordinate' else ''}")
    if not 0 <= item < n:
        raise BadStructure(f"there is no {kind} {item}; the model has {kind}s 0 to {n - 1}")
    return int(item)


def _ratios(zeta: ArrayLike, count: int) -> Array:
    ratios = np.asarray(zeta, dtype=float)
    if ratios.ndim == 0:
        ratios = np.full(count, ratios)
    if ratios.shape != (count,) or not np.all(np.isfinite(ratios)):
        raise BadStructure(f"the damping ratios must be {count} finite numbers, one a retained mode, not {ratios}")
    return ratios


def _visibility(model: SecondOrderModel, keep: list[int], columns: list[int]) -> float:
    """Return the condition of the modes at the coordinates.

    Each coordinate is scaled to unit length over all modes. A bad condition raises.
    """
    every = model.eigen[1][keep]
    left = every[:, columns] / np.linalg.norm(every, axis=1)[:, None]
    _, values, right = np.linalg.svd(left)
    if values[-1] > INVISIBLE:
        return float(values[0] / values[-1])
    mixed = np.flatnonzero(np.abs(right[-1]) > 0.1 * np.abs(right[-1]).max())
    named = ", ".join(f"{columns[k]} ({model.freq[columns[k]]:.6g} Hz)" for k in mixed)
    where = ", ".join(model.coordinates[i] for i in keep)
    what = f"mode {named} does not move" if len(mixed) == 1 else f"modes {named} cannot be told apart at"
    raise BadStructure(f"{what} the retained coordinates {where}; retain other coordinates, or other modes")


def _static_transformation(K: Array, keep: Sequence[int], labels: Sequence[str]) -> Array:
    n = len(K)
    kept, rest = np.asarray(keep), np.setdiff1d(np.arange(n), keep)
    T = np.zeros((n, len(keep)))
    T[kept, np.arange(len(keep))] = 1.0
    if rest.size:
        K22 = K[np.ix_(rest, rest)]
        diagonal = np.abs(np.diag(K22))
        scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        values, vectors = linalg.eigh(scale[:, None] * K22 * scale)
        weakest = int(np.argmin(np.abs(values)))
        if abs(values[weakest]) <= SINGULAR:
            motion = np.abs(vectors[:, weakest])
            named = ", ".join(labels[rest[i]] for i in np.flatnonzero(motion > 0.5 * motion.max()))
            raise BadStructure(
                f"the stiffness K22 of the condensed coordinates is singular: {named} can move without strain while the "
                "retained ones are held; retain one of them"
            )
        scaled = vectors.T @ (scale[:, None] * K[np.ix_(rest, kept)])
        T[rest] = -scale[:, None] * (vectors @ (scaled / values[:, None]))
    return T


def _eliminate(base: SecondOrderModel, count: int) -> tuple[list[int], list[int]]:
    M, K = base.M, base.K
    keep, dropped = list(range(base.n)), []
    while len(keep) > count:
        ratio = np.diag(K) / np.diag(M)
        # last of equal coordinates, whatever the rounding
        weakest = int(np.flatnonzero(ratio >= ratio.max() - 1e-9 * np.abs(ratio).max())[-1])
        if K[weakest, weakest] <= SINGULAR * np.abs(base.K[keep[weakest], keep[weakest]]):
            raise BadStructure(
                f"{count} coordinates are too few: {base.coordinates[keep[weakest]]} moves without strain"
            )
        M, K = _condense_one(M, K, weakest)
        dropped.append(keep.pop(weakest))
    return keep, dropped


def _best_swap(base: SecondOrderModel, keep: list[int], true: Array, measure: Measure) -> tuple[int, int] | None:
    best = _size(_freq_error(*_condense(base, keep), true), measure) * (1 - IMPROVES) - 1e-12
    found = None
    for entering in range(base.n):
        if entering in keep:
            continue
        joint = [*keep, entering]
        M, K = _condense(base, joint)
        for place, leaving in enumerate(keep):
            if K[place, place] <= SINGULAR * abs(base.K[leaving, leaving]):
                continue
            size = _size(_freq_error(*_condense_one(M, K, place), true), measure)
            if size < best:
                best, found = size * (1 - IMPROVES) - 1e-12, (leaving, entering)
    return found


def _condense(base: SecondOrderModel, keep: Sequence[int]) -> tuple[Array, Array]:
    T = _static_transformation(base.K, keep, base.coordinates)
    return T.T @ base.M @ T, T.T @ base.K @ T


def _condense_one(M: Array, K: Array, i: int) -> tuple[Array, Array]:
    others = np.delete(np.arange(len(K)), i)
    follow = -K[i, others] / K[i, i]
    coupling = np.outer(M[others, i], follow)
    kept = np.ix_(others, others)
    return (
        M[kept] + coupling + coupling.T + M[i, i] * np.outer(follow, follow),
        K[kept] + np.outer(K[others, i], follow),
    )


def _freq_error(M: Array, K: Array, true: Array) -> Array:
    squared = linalg.eigh(K, M, eigvals_only=True)[: len(true)]
    freq = np.sign(squared) * np.sqrt(np.abs(squared)) / (2 * np.pi)
    top = np.abs(true).max()
    return (freq - true) / np.where(np.abs(true) > RIGID * top, np.abs(true), top)


def _size(error: Array, measure: Measure) -> float:
    return float(np.abs(error).max() if measure == "worst" else np.sqrt(np.mean(error**2)))
