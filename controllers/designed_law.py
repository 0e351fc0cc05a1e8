"""Interface of a designed law: gains and performance on the design model."""

from collections.abc import Sequence
from typing import Any, Protocol

from vlab.controllers.linear import LinearController

from vlab.design.gain_search import Search
from vlab.design.state_model import StateModel
from vlab.design.weights import Weights
from vlab.signals import Array


class Design(Protocol):
    """A designed law.

    A new law provides this interface and one entry in `vlab.controllers.catalogue.LAWS`.
    """

    @property
    def model(self) -> StateModel:
        """Design model in state form."""

    @property
    def in_loop(self) -> LinearController | None:
        """The law on sensors; None if every state must be measured."""

    @property
    def state_gain(self) -> Array:
        """Gain F of u = -F x or u = -F x_est, (n_c, 2n)."""

    @property
    def filter_gain(self) -> Array | None:
        """Gain K of the filter, (2n, n_s); None for a law without states."""

    @property
    def A_closed(self) -> Array:
        """Closed-loop matrix on the design model."""

    @property
    def search(self) -> Search | None:
        """Report of the search; None for a law in closed form."""

    def gains(self) -> dict[str, Any]:
        """Return gains, channels and unit as plain data."""

    def closed_modes(self, modes: Sequence[int]) -> tuple[Array, Array]:
        """Return frequencies [Hz] and damping ratios of modes, numbered from 0."""

    def shape_indices(self, modes: Sequence[int], weights: Weights) -> Array:
        """Return the performance index J of initial shapes, numbered from 0."""

    def goal(self, bounded: Array) -> dict[str, Any]:
        """Return name, value and unit of the minimised quantity.

        Parameters
        ----------
        bounded : array
            Performance indices of the bounded modes.
        """


def largest_index(bounded: Array) -> dict[str, Any]:
    """Return the goal of a law whose design minimises every index.

    Parameters
    ----------
    bounded : array
        Performance indices of the bounded modes.
    """
    return {"name": "largest index of the bounded modes", "value": float(bounded.max()), "unit": "1"}
