"""The continuous loops of a design, for Bode, Nyquist and pole plots and as python-control objects."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from vlab.controllers.catalogue import Design
from vlab.controllers.lqg import LqgDesign
from vlab.controllers.lqr import LqrDesign

from vlab.design import performance
from vlab.signals import Array

CHUNK = 100
"""Lines that are solved at once: enough to save calls, few enough for the memory of a large model."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Loops:
    """Structure, loop gain and closed loop of a design on the model it was made on.

    Parameters
    ----------
    plant, closed : StateSpace
        From forces at the coils to velocities there, without and with the law.
    gain : StateSpace
        The loop opened at the coils, from force to minus the law's answer: L of the return difference I + L.
    """

    plant: Any
    closed: Any
    gain: Any


def loops_of(design: Design) -> Loops:
    """Return the loops of a design as python-control's `StateSpace`."""
    import control

    model = design.model
    A, B, C = model.A, model.B, model.C
    zero = np.zeros((len(C), B.shape[1]))
    plant = control.StateSpace(A, B, C, zero)
    if isinstance(design, LqgDesign):
        closed_A = performance.reduced_controller_loop(model, model, design.F, design.K)
        law = control.StateSpace(design.A_estimator, design.K, design.F, np.zeros((B.shape[1], len(C))))
        none = np.zeros((len(design.A_estimator), B.shape[1]))
        closed = control.StateSpace(closed_A, np.vstack([B, none]), np.hstack([C, none.T[: len(C)]]), zero)
        return Loops(plant=plant, closed=closed, gain=law * plant)
    F = design.F if isinstance(design, LqrDesign) else design.D @ C
    square = np.zeros((B.shape[1], B.shape[1]))
    return Loops(
        plant=plant,
        closed=control.StateSpace(design.A_closed, B, C, zero),
        gain=control.StateSpace(A, B, F, square),
    )


def response(system: Any, freq: Array) -> Array:
    """Return the frequency response of a `StateSpace` at frequencies [Hz], (n, n_outputs, n_inputs).

    Many lines are solved at once, where python-control takes them one by one.
    """
    A, B, C, D = (np.asarray(part) for part in (system.A, system.B, system.C, system.D))
    lines = 2j * np.pi * np.asarray(freq, dtype=float)
    parts = [
        C @ np.linalg.solve(s[:, None, None] * np.eye(len(A)) - A, B.astype(complex)) + D
        for s in np.array_split(lines, max(1, len(lines) // CHUNK))
    ]
    return np.concatenate(parts)
