"""State model of a structure with collocated coils."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from vlab.errors import BadDesign
from vlab.fe.model import FeModel
from vlab.signals import Array

TRANSLATIONS = ("v", "tip")
"""Translational coordinates; rx and rz are rotations."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StateModel:
    """State model of a structure: (3.2) and (4.2).

    x' = A x + B u, y = C x with x = [q', q], coil forces u and coil velocities y.

    Parameters
    ----------
    A : (2n, 2n) array
        System matrix, SI.
    B : (2n, n_c) array
        Input matrix, SI.
    C : (n_c, 2n) array
        Output matrix, SI.
    M, K : (n, n) array
        Mass and stiffness, for energy weights.
    coordinates : (n,) tuple of str
        Labels of q.
    channels : (n_c,) tuple of str
        Names of the coils in the order of u and y.
    shapes : (n, n) array
        Mass-normalised undamped modes as columns, by frequency.
    """

    A: Array
    B: Array
    C: Array
    M: Array
    K: Array
    coordinates: tuple[str, ...]
    channels: tuple[str, ...]
    shapes: Array

    @property
    def n(self) -> int:
        """Number of coordinates; half the number of states."""
        return len(self.coordinates)

    @property
    def is_translation(self) -> Array:
        """Whether each coordinate is a displacement, (n,)."""
        return np.array([label.partition(":")[0] in TRANSLATIONS for label in self.coordinates])

    @property
    def states(self) -> tuple[str, ...]:
        """Labels of x: the rates, then the coordinates."""
        return (*(f"{label}'" for label in self.coordinates), *self.coordinates)

    def to_control(self) -> Any:
        """Return python-control's `StateSpace` from forces to velocities.

        States and channels have names.
        """
        import control

        return control.StateSpace(
            self.A,
            self.B,
            self.C,
            np.zeros((len(self.C), self.B.shape[1])),
            states=list(self.states),
            inputs=[f"force {name}" for name in self.channels],
            outputs=[f"velocity {name}" for name in self.channels],
        )


def state_model(fe: FeModel) -> StateModel:
    """Return the state model of an FE model.

    The FE model may be full, reduced or corrected; its coils are collocated pairs.

    Parameters
    ----------
    fe : FeModel
        FE model.

    Returns
    -------
    StateModel
        State model.

    Raises
    ------
    BadDesign
        The structure has no coils.
    """
    names = tuple(coil.name for coil in fe.structure.coil)
    if not names:
        raise BadDesign(f"structure {fe.structure.name!r} has no coils; a control law needs at least one [[coil]]")
    A, B, C, _ = fe.linear.state_matrices(fe.coils, fe.coils.T)
    return StateModel(
        A=A,
        B=B,
        C=C,
        M=fe.linear.M,
        K=fe.linear.K,
        coordinates=fe.linear.coordinates,
        channels=names,
        shapes=fe.linear.eigen[1],
    )
