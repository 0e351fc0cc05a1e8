"""Linear quadratic direct rate feedback (equation 4.38).

The design finds the best constant gains for initial shapes of the first modes. The index of each shape is the linear
quadratic regulator's (4.4). The objective is the largest index, or the largest ratio to the regulator's index (section
6.2.1), which keeps high modes from dominating. D is coupled or diagonal. If several D reach the same objective, D is
not determined: on the beam the sixth mode alone decides.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from vlab.controllers.rate_feedback_design import RateFeedbackDesign

from vlab.design import performance
from vlab.design.closed_loop import ClosedLoop, RateFeedbackLoop
from vlab.design.gain_search import GainSearch, bounded_modes
from vlab.design.index_gradients import IndexGradients
from vlab.design.riccati import lqr
from vlab.design.state_model import state_model
from vlab.design.weights import Weights
from vlab.errors import unknown_name
from vlab.fe.model import FeModel
from vlab.signals import Array

Kind = Literal["largest", "ratio"]
KINDS = ("largest", "ratio")
"""Kinds of objective."""
STARTS = 8
"""STARTS [1]: random starts of a design. On both structures most starts reach the optimum."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LqdrfDesign(RateFeedbackDesign):
    """Direct rate feedback of least quadratic index.

    Parameters
    ----------
    weights : Weights
        Weights Q and R.
    shapes : tuple of int
        Modes of the initial shapes, from 0.
    regulator_indices : (n_f,) array
        Index of the linear quadratic regulator for each shape (4.7), a lower bound of every law.
    kind : str
        Objective: the largest index, or the largest ratio to the regulator's.
    """

    law: str = field(default="lqdrf", init=False)
    weights: Weights
    shapes: tuple[int, ...]
    regulator_indices: Array
    kind: Kind

    @property
    def objective(self) -> float:
        """beta: the largest index, or the largest ratio."""
        J = self.indices(self.weights, self.shapes)
        return float((J / self.regulator_indices if self.kind == "ratio" else J).max())

    def goal(self, bounded: Array) -> dict[str, Any]:
        """See `Design`."""
        ratio = self.kind == "ratio"
        name = "beta, largest ratio to the regulator's index" if ratio else "beta, largest index"
        return {"name": name, "value": self.objective, "unit": "1"}


def design(
    fe: FeModel,
    weights: Weights,
    *,
    shapes: int | Sequence[int] = 6,
    kind: Kind = "largest",
    diagonal: bool = False,
    damping: float = 0.03,
    modes: int | Sequence[int] = 6,
    starts: int = STARTS,
    seed: int = 0,
) -> LqdrfDesign:
    """Design linear quadratic direct rate feedback.

    Parameters
    ----------
    fe : FeModel
        Full or reduced model.
    weights : Weights
        Weights Q and R, see `vlab.design.weights`.
    shapes : int or sequence of int
        Initial shapes: number n_f of the first coil-driven modes, or their numbers from 0.
    kind : str
        ``"largest"``: minimise the largest index (4.37). ``"ratio"``: minimise the largest ratio to the regulator's
        index.
    diagonal : bool
        Whether each coil uses its own sensor only.
    damping : float
        Smallest damping ratio zeta_L of the bounded modes.
    modes : int or sequence of int
        Bounded modes: number n_m of the first coil-driven modes, or their numbers from 0.
    starts, seed : int
        Number of random starts, and their seed.

    Returns
    -------
    LqdrfDesign
        Gains with their evaluation.

    Raises
    ------
    BadDesign
        The bounds cannot be met (the message names the mode), or sizes do not fit.
    UnknownName
        No such objective.
    """
    if kind not in KINDS:
        raise unknown_name("objective", kind, KINDS, where="lqdrf")
    model = state_model(fe)
    loop = RateFeedbackLoop(fe.linear, fe.coils)
    search = GainSearch(loop=loop, damping=damping, modes=bounded_modes(fe, modes), diagonal=diagonal)
    chosen = bounded_modes(fe, shapes)
    x0 = performance.initial_states(model, chosen)
    indices = IndexGradients(loop=loop, weights=weights, x0=x0)
    best = np.einsum("ik,ij,jk->k", x0, lqr(model.A, model.B, weights.Q, weights.R).S, x0)
    unit = best if kind == "ratio" else np.full(len(best), best.max())

    # the search uses the logarithm of the index, which spans decades far from the optimum
    def objective(closed: ClosedLoop, beta: Array) -> tuple[Array, Array, Array, Sequence[str]]:
        J, slopes = indices(closed)
        names = [f"index of mode {mode + 1}" for mode in chosen]
        return beta - np.log(J / unit), -slopes / J[..., None, None], np.ones((*J.shape, 1)), names

    D0 = search.random_gains(starts, seed)
    J0 = indices(loop.closed(search.scale * D0))[0]
    points = np.hstack([D0[:, search.entries[0], search.entries[1]], np.log(J0 / unit).max(axis=1, keepdims=True)])
    linear = search.no_constraints(1)
    solution, evaluator = search.run(objective, points, linear)
    D = search.gains(solution.x[[solution.best]])[0]
    names = [f"d > 0 of {channel}" for channel in model.channels] if diagonal else []
    scale = 1.0 if kind == "ratio" else float(best.max())
    return LqdrfDesign(
        model=model,
        loop=loop,
        D=D,
        damping=damping,
        bounded=search.modes,
        search=search.report(
            solution,
            evaluator,
            linear_names=names,
            values=scale * np.exp(solution.f),
            price=1.0,
            lower_bound=scale,
        ),
        weights=weights,
        shapes=chosen,
        regulator_indices=best,
        kind=kind,
    )
