"""Continuous loops of a design, for Bode, Nyquist and pole plots.

The results are python-control objects.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from vlab.controllers.designed_law import Design
from vlab.controllers.lqg import estimator

from vlab.design import performance
from vlab.signals import Array

CHUNK = 100
"""CHUNK [lines]: number of lines solved at once. A larger value saves calls and takes more memory."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Loops:
    """Plant, loop gain and closed loop on the design model.

    Parameters
    ----------
    plant, closed : StateSpace
        Systems from coil forces to coil velocities, without and with the law.
    gain : StateSpace
        Loop opened at the coils, from force to minus the law's response: L of the return difference I + L.
    """

    plant: Any
    closed: Any
    gain: Any


def loops_of(design: Design) -> Loops:
    """Return a design's loops as python-control's `StateSpace`.

    Parameters
    ----------
    design : Design
        Design of a law.

    Returns
    -------
    Loops
        Plant, gain and closed loop.
    """
    import control

    model = design.model
    A, B, C = model.A, model.B, model.C
    zero = np.zeros((len(C), B.shape[1]))
    plant = control.StateSpace(A, B, C, zero)
    F, K = design.state_gain, design.filter_gain
    if K is not None:
        closed_A, own = performance.reduced_controller_loop(model, model, F, K), estimator(model, F, K)
        law = control.StateSpace(own, K, F, np.zeros((B.shape[1], len(C))))
        none = np.zeros((len(own), B.shape[1]))
        closed = control.StateSpace(closed_A, np.vstack([B, none]), np.hstack([C, none.T[: len(C)]]), zero)
        return Loops(plant=plant, closed=closed, gain=law * plant)
    square = np.zeros((B.shape[1], B.shape[1]))
    return Loops(
        plant=plant,
        closed=control.StateSpace(design.A_closed, B, C, zero),
        gain=control.StateSpace(A, B, F, square),
    )


def response(system: Any, freq: Array) -> Array:
    """Return the frequency response of a `StateSpace`.

    Many lines are solved at once; python-control solves lines one by one.

    Parameters
    ----------
    system : object
        State-space system.
    freq : array
        Frequencies [Hz].

    Returns
    -------
    array
        Response, (n, n_outputs, n_inputs).
    """
    A, B, C, D = (np.asarray(part) for part in (system.A, system.B, system.C, system.D))
    lines = 2j * np.pi * np.asarray(freq, dtype=float)
    parts = [
        C @ np.linalg.solve(s[:, None, None] * np.eye(len(A)) - A, B.astype(complex)) + D
        for s in np.array_split(lines, max(1, len(lines) // CHUNK))
    ]
    return np.concatenate(parts)
