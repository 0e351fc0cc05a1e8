"""Linear quadratic regulator u = -F x (equations 4.3-4.7).

Every state must be measured.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from vlab.controllers.designed_law import largest_index
from vlab.controllers.linear import LinearLaw

from vlab.design import performance
from vlab.design.riccati import lqr
from vlab.design.state_model import StateModel, state_model
from vlab.design.weights import Weights
from vlab.errors import BadDesign
from vlab.fe.model import FeModel
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class LqrDesign:
    """A regulator and its performance on the design model.

    Parameters
    ----------
    model : StateModel
        Design model in state form.
    weights : Weights
        Weights Q and R.
    F : (n_c, 2n) array
        Gain on x = [q', q] in SI.
    S : (2n, 2n) array
        Solution of the Riccati equation.
    controller : LinearLaw
        u = -F y for y = x at any rate. The sensors are the states, so the law needs all of them measured.
    """

    law: str = field(default="lqr", init=False)
    model: StateModel
    weights: Weights
    F: Array
    S: Array
    controller: LinearLaw

    @property
    def A_closed(self) -> Array:
        """Closed-loop matrix A - B F."""
        return self.model.A - self.model.B @ self.F

    @property
    def poles(self) -> performance.Poles:
        """Modes of the closed loop, by frequency."""
        return performance.poles(self.A_closed)

    @property
    def in_loop(self) -> None:
        """See `Design`: no sensors measure every state."""
        return

    @property
    def state_gain(self) -> Array:
        """See `Design`."""
        return self.F

    @property
    def filter_gain(self) -> None:
        """See `Design`."""
        return

    @property
    def search(self) -> None:
        """See `Design`."""
        return

    def gains(self) -> dict[str, Any]:
        """See `Design`."""
        return {"actuators": list(self.model.channels), "states": list(self.model.states), "F": self.F, "unit": "SI"}

    def closed_modes(self, modes: Sequence[int]) -> tuple[Array, Array]:
        """See `Design`."""
        return self.poles.freq[list(modes)], self.poles.zeta[list(modes)]

    def shape_indices(self, modes: Sequence[int], weights: Weights) -> Array:
        """See `Design`: the design's own weights apply."""
        return self.indices(modes)

    def goal(self, bounded: Array) -> dict[str, Any]:
        """See `Design`."""
        return largest_index(bounded)

    def indices(self, modes: int | Sequence[int] | Array) -> Array:
        """Return J of initial shapes: equation (4.7).

        `modes` is the number of first modes, or their numbers from 0.
        """
        x0 = performance.initial_states(self.model, modes)
        return np.einsum("ik,ij,jk->k", x0, self.S, x0)

    def to_control(self) -> Any:
        """Return the closed loop in python-control's form.

        Inputs are forces added to u, outputs velocities at the coils.
        """
        import control

        zero = np.zeros((len(self.model.C), self.model.B.shape[1]))
        return control.StateSpace(self.A_closed, self.model.B, self.model.C, zero)


def design(fe: FeModel | StateModel, weights: Weights) -> LqrDesign:
    """Design a regulator on a full or reduced model.

    Parameters
    ----------
    fe : FeModel or StateModel
        Model for the design.
    weights : Weights
        Weights, see `vlab.design.weights`.

    Returns
    -------
    LqrDesign
        Gain and law.

    Raises
    ------
    BadDesign
        The weights do not fit the model, or the Riccati equation has no stabilising solution; the message has the
        reason.
    """
    model = fe if isinstance(fe, StateModel) else state_model(fe)
    if weights.Q.shape != model.A.shape or len(weights.R) != model.B.shape[1]:
        raise BadDesign(
            f"weights Q {weights.Q.shape} and R {weights.R.shape} do not fit the model's {2 * model.n} states and "
            f"{model.B.shape[1]} coils; make them from the same model"
        )
    regulator = lqr(model.A, model.B, weights.Q, weights.R)
    return LqrDesign(
        model=model,
        weights=weights,
        F=regulator.F,
        S=regulator.S,
        controller=_static(-regulator.F, model.states, model.channels),
    )


def _static(gain: Array, sensors: Sequence[str], actuators: Sequence[str]) -> LinearLaw:
    n_u, n_y = gain.shape
    return LinearLaw(
        np.zeros((0, 0)), np.zeros((0, n_y)), np.zeros((n_u, 0)), gain, sensors=sensors, actuators=actuators
    )
