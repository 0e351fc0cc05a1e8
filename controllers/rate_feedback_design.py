"""Common result of direct rate feedback designs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from vlab.controllers.direct_rate_feedback import DirectRateFeedback

from vlab.design import performance
from vlab.design.closed_loop import RateFeedbackLoop
from vlab.design.gain_search import Search
from vlab.design.state_model import StateModel
from vlab.design.weights import Weights
from vlab.signals import Array

PRINTED = "lbf s/in"
"""PRINTED: unit of printed rate feedback gains beside SI, as in Tables 7, 11 and 15."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RateFeedbackDesign:
    """A law u = -D y and its performance.

    Parameters
    ----------
    model : StateModel
        Design model in state form.
    loop : RateFeedbackLoop
        Model with its coils in modal coordinates.
    D : (n_c, n_c) array
        Symmetric positive definite gains [N s/m].
    damping : float
        Required damping ratio zeta_L.
    bounded : tuple of int
        Modes with the bound, from 0.
    search : Search
        Report of the search and its reliability.
    """

    model: StateModel
    loop: RateFeedbackLoop
    D: Array
    damping: float
    bounded: tuple[int, ...]
    search: Search

    @property
    def controller(self) -> DirectRateFeedback:
        """The law for a loop."""
        return DirectRateFeedback(self.D, sensors=self.model.channels, actuators=self.model.channels)

    @property
    def in_loop(self) -> DirectRateFeedback:
        """See `Design`."""
        return self.controller

    @property
    def state_gain(self) -> Array:
        """See `Design`: D C."""
        return self.D @ self.model.C

    @property
    def filter_gain(self) -> None:
        """See `Design`."""
        return

    @property
    def A_closed(self) -> Array:
        """Closed-loop matrix A - B D C (4.35)."""
        return performance.rate_feedback_loop(self.model, self.D)

    @property
    def poles(self) -> performance.Poles:
        """Modes of the closed loop, by frequency."""
        return performance.poles(self.A_closed)

    def gains(self) -> dict[str, Any]:
        """See `Design`."""
        channels = list(self.model.channels)
        return {"actuators": channels, "sensors": channels, "D": self.D, "unit": "N s/m"}

    def closed_modes(self, modes: Sequence[int]) -> tuple[Array, Array]:
        """See `Design`: each mode is followed from the open loop."""
        tracked = self.loop.track(self.D, max(modes) + 1)
        return tracked.freq[0, list(modes)], tracked.zeta[0, list(modes)]

    def shape_indices(self, modes: Sequence[int], weights: Weights) -> Array:
        """See `Design`."""
        return self.indices(weights, modes)

    def zeta(self, modes: int) -> Array:
        """Return the damping ratios of the first modes.

        Each mode is followed from the open loop.
        """
        return self.loop.track(self.D, modes).zeta[0]

    def indices(self, weights: Weights, modes: int | Sequence[int] | Array) -> Array:
        """Return J of initial shapes: equation (4.33).

        `modes` is the number of first modes, or their numbers from 0.
        """
        return performance.rate_feedback_index(
            self.model, self.D, weights, performance.initial_states(self.model, modes)
        )

    def to_control(self) -> Any:
        """Return the law in python-control's form.

        Inputs are velocities, outputs forces.
        """
        import control

        names = self.model.channels
        return control.StateSpace(
            [],
            [],
            [],
            -self.D,
            inputs=[f"velocity {name}" for name in names],
            outputs=[f"force {name}" for name in names],
        )
