"""What every design of direct rate feedback leaves, whatever it optimised."""

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


@dataclass(frozen=True, kw_only=True, eq=False)
class RateFeedbackDesign:
    """A law u = -D y with what it achieves on the model it was designed on.

    Parameters
    ----------
    model : StateModel
        The model in state form.
    loop : RateFeedbackLoop
        The model with its coils, in modes.
    D : (n_c, n_c) array
        Symmetric, positive definite [N s/m].
    damping : float
        zeta_L, the bound that the design was given.
    bounded : tuple of int
        Modes that it holds for, from 0.
    search : Search
        How the optimum was found and how far it may be trusted.
    """

    model: StateModel
    loop: RateFeedbackLoop
    D: Array
    damping: float
    bounded: tuple[int, ...]
    search: Search

    @property
    def controller(self) -> DirectRateFeedback:
        """The law, ready to run."""
        return DirectRateFeedback(self.D, sensors=self.model.channels, actuators=self.model.channels)

    @property
    def A_closed(self) -> Array:
        """A - B D C (4.35)."""
        return performance.rate_feedback_loop(self.model, self.D)

    @property
    def poles(self) -> performance.Poles:
        """Modes of the closed loop, by frequency."""
        return performance.poles(self.A_closed)

    def zeta(self, modes: int) -> Array:
        """Return the damping ratios of the first modes, each followed from the open loop."""
        return self.loop.track(self.D, modes).zeta[0]

    def indices(self, weights: Weights, modes: int | Sequence[int] | Array) -> Array:
        """Return J of initial shapes, the first so many or which (from 0): equation (4.33)."""
        return performance.rate_feedback_index(
            self.model, self.D, weights, performance.initial_states(self.model, modes)
        )

    def to_control(self) -> Any:
        """Return the law, velocities in and forces out, in python-control's form."""
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
