"""Minimised maximum force direct rate feedback (equation 4.32).

The design finds the smallest actuators that still damp the first modes. The largest force of coil i per bound of all
velocities is f_i = sum_j |d_ij| (4.31). The design minimises gamma >= f_i with bounds on exact closed-loop damping
ratios and D > 0. Variables t_ij >= +-d_ij represent |d_ij| exactly, so zeros of D come out as zeros. The published
design approximates |d_ij| by a quartic.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from vlab.controllers.rate_feedback_design import PRINTED, RateFeedbackDesign

from vlab import units
from vlab.design import performance
from vlab.design.closed_loop import ClosedLoop, RateFeedbackLoop
from vlab.design.gain_search import GainSearch, bounded_modes
from vlab.design.sequential import LinearConstraints
from vlab.design.state_model import state_model
from vlab.fe.model import FeModel
from vlab.signals import Array

STARTS = 20
"""STARTS [1]: random starts of a design. On the beam each start reaches the global optimum with a probability above
0.5."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MfdrfDesign(RateFeedbackDesign):
    """Direct rate feedback of minimised maximum force."""

    law: str = field(default="mfdrf", init=False)

    @property
    def objective(self) -> float:
        """gamma: the largest force ratio f_i (4.31) [N s/m]."""
        return float(performance.force_bounds(self.D).max())

    def goal(self, bounded: Array) -> dict[str, Any]:
        """See `Design`."""
        printed = units.from_si(self.objective, PRINTED, "N s/m")
        found = {"name": "gamma, largest force ratio", "value": self.objective, "unit": "N s/m"}
        return {**found, f"value_{PRINTED}": printed}


def design(
    fe: FeModel, *, damping: float = 0.03, modes: int | Sequence[int] = 6, starts: int = STARTS, seed: int = 0
) -> MfdrfDesign:
    """Design minimised maximum force direct rate feedback.

    Parameters
    ----------
    fe : FeModel
        Full or reduced model.
    damping : float
        Smallest damping ratio zeta_L of the bounded modes.
    modes : int or sequence of int
        Number n_m of the first coil-driven modes, or their numbers from 0.
    starts, seed : int
        Number of random starts, and their seed.

    Returns
    -------
    MfdrfDesign
        Gains with their evaluation.

    Raises
    ------
    BadDesign
        The bounds cannot be met (the message names the mode), or sizes do not fit.
    """
    model = state_model(fe)
    search = GainSearch(loop=RateFeedbackLoop(fe.linear, fe.coils), damping=damping, modes=bounded_modes(fe, modes))
    linear, names = _force_constraints(search, model.channels)
    random = search.random_gains(starts, seed)
    rows, columns = search.entries
    aside = rows != columns
    force = np.abs(random).sum(axis=2).max(axis=1)
    points = np.hstack([random[:, rows, columns], np.abs(random[:, rows[aside], columns[aside]]), force[:, None]])
    solution, evaluator = search.run(_no_more, points, linear)
    D = search.gains(solution.x[[solution.best]])[0]
    return MfdrfDesign(
        model=model,
        loop=search.loop,
        D=D,
        damping=damping,
        bounded=search.modes,
        search=search.report(
            solution,
            evaluator,
            linear_names=names,
            values=search.scale * solution.f,
            price=1 / float(solution.f[solution.best]),
        ),
    )


def _no_more(closed: ClosedLoop, extra: Array) -> tuple[Array, Array, Array, Sequence[str]]:
    """Return no smooth constraint.

    The force ratios are linear in the variables.
    """
    k, coils = len(extra), closed.gains.shape[1]
    return np.zeros((k, 0)), np.zeros((k, 0, coils, coils)), np.zeros((k, 0, extra.shape[1])), ()


def _force_constraints(search: GainSearch, channels: Sequence[str]) -> tuple[LinearConstraints, list[str]]:
    """Return t_ij >= +-d_ij and gamma >= sum_j |d_ij|, with names.

    The diagonal is positive. Only reported constraints have names.
    """
    rows, columns = search.entries
    aside = np.flatnonzero(rows != columns)
    n = search.count + len(aside) + 1
    constraints, names = [], []
    for j, entry in enumerate(aside):
        for sign in (1.0, -1.0):
            row = np.zeros(n)
            row[entry], row[search.count + j] = sign, 1.0
            constraints.append(row)
            names.append("")
    for i, channel in enumerate(channels):
        row = np.zeros(n)
        row[-1] = 1.0
        row[np.flatnonzero((rows == i) & (columns == i))] = -1.0
        row[search.count + np.flatnonzero((rows[aside] == i) | (columns[aside] == i))] = -1.0
        constraints.append(row)
        names.append(f"force of {channel}")
    A = np.array(constraints)
    return LinearConstraints(A=A, lower=np.zeros(len(A)), upper=np.full(len(A), np.inf)), names
