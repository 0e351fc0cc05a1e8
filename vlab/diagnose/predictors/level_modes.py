"""Modes of a model at the amplitudes of a modal table.

A mode at an amplitude has the equivalent stiffness and damping of every nonlinear law in the mode's own motion. Shape,
frequency and equivalents of a mode are iterated together.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vlab.diagnose.data.responses import Modes
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.frequency import State, is_level_dependent, is_port
from vlab.diagnose.predictors.frequency_model import View
from vlab.diagnose.predictors.frequency_modes import ModelModes, model_modes, state_matrix
from vlab.diagnose.predictors.level_response import Element, elements_of
from vlab.diagnose.settings import LEVEL_MODES
from vlab.signals import Array, ComplexArray


def acts_in_table(view: View, data: Modes, terms: Sequence[Term]) -> bool:
    """Return whether a modal table's amplitudes are known."""
    every = (*view.fixed, *terms)
    return data.amplitude is not None and any(is_port(t) and is_level_dependent(t) for t in every)


def modes_at_amplitude(
    view: View, state: State, data: Modes, terms: Sequence[Term], linear: ModelModes, pairs: Array
) -> tuple[ModelModes, Array]:
    """Return the modes of a table at its amplitudes.

    Parameters
    ----------
    view : View
        Linearised plant.
    state : State
        Matrices.
    data : Modes
        Modal table with amplitudes.
    terms : sequence of Term
        Effects.
    linear : ModelModes
        Modes without the nonlinear terms.
    pairs : (n,) int array
        Index of the linear mode of every mode of the table; -1 without one.

    Returns
    -------
    modes : ModelModes
        Modes in the order of the table.
    pairs : (n,) int array
        Index of each mode; -1 without one.
    """
    assert data.amplitude is not None
    every = [*view.fixed, *terms]
    elements = elements_of([t for t in every if is_port(t) and is_level_dependent(t)])
    at, fastest = view.at[data.amplitude_at], 2 * np.pi * 2 * float(data.freq[-1])
    poles, shapes = np.zeros(data.n, dtype=complex), np.zeros((view.m, data.n), dtype=complex)
    for k, j in enumerate(pairs):
        if j < 0:
            continue
        s, shape = linear.s[j], linear.shapes[:, j]
        if np.isfinite(data.amplitude[k]):
            for _ in range(LEVEL_MODES.passes):
                scale = float(data.amplitude[k] / np.maximum(np.abs(at @ shape), 1e-300))
                softer = _equivalent(state, elements, s, shape, scale)
                modes = model_modes(state_matrix(softer, every, fastest), view.m)
                if not len(modes.s):
                    break
                same = int(np.argmax(_alike(modes.shapes, shape) / (1 + np.abs(np.log(np.abs(modes.s / s))))))
                moved = abs(modes.s[same] / s - 1)
                s, shape = modes.s[same], modes.shapes[:, same]
                if moved < LEVEL_MODES.settled:
                    break
        poles[k], shapes[:, k] = s, shape
    none = np.zeros((0, 0), dtype=complex)
    out = ModelModes(
        s=poles, left=none, right=shapes, poles=poles, index=np.arange(data.n), m=view.m, part=np.ones(data.n)
    )
    return out, np.where(pairs >= 0, np.arange(data.n), -1)


def _equivalent(state: State, elements: Sequence[Element], s: complex, shape: ComplexArray, scale: float) -> State:
    """Return the matrices with all equivalents in one mode's motion."""
    omega, C, K = np.array([abs(s)]), state.C, state.K
    for element in elements:
        size = np.array([max(abs(element.row @ shape) * scale, 1e-300)])
        z = complex(element.stiffness(size, omega, omega, False).value[0])
        outer = np.outer(element.row, element.row)
        K, C = K + z.real * outer, C + z.imag / float(omega[0]) * outer
    return replace(state, C=C, K=K)


def _alike(shapes: ComplexArray, shape: ComplexArray) -> Array:
    """Return the MAC of shapes (m, k) with one shape (m,)."""
    product = np.abs(np.conj(shape) @ shapes) ** 2
    return np.asarray(product / np.maximum(np.sum(np.abs(shapes) ** 2, axis=0) * np.sum(np.abs(shape) ** 2), 1e-300))
