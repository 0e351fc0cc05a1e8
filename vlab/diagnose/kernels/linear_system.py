"""Compiled time integration of linear systems in modal form."""

import numpy as np

from vlab.compilation import compiled
from vlab.diagnose.settings import KERNELS
from vlab.signals import Array

BLOCK = KERNELS.block
"""BLOCK [samples]: samples of a matrix product, a constant of the compiled loops."""


@compiled(error_model="numpy")
def _copy(row: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Copy a row; a slice assignment takes seconds to compile."""
    for j in range(len(row)):
        out[j] = row[j]


@compiled(error_model="numpy", fastmath={"reassoc", "contract"})
def _turned(
    turn: Array, drive_re: Array, drive_im: Array, re: Array, im: Array, count: int, substeps: int
) -> None:  # pragma: no cover - compiled
    """Step modal coordinates from sample 0 to `count`, in place."""
    m = re.shape[1]
    per_sample = len(drive_re) // count
    for k in range(count):
        for j in range(m):
            re[k + 1, j], im[k + 1, j] = re[k, j], im[k, j]
        for sub in range(substeps):
            now = k * per_sample + min(sub, per_sample - 1)
            for j in range(m):
                x, z = re[k + 1, j], im[k + 1, j]
                re[k + 1, j] = x * turn[0, j] - z * turn[1, j] + drive_re[now, j]
                im[k + 1, j] = x * turn[1, j] + z * turn[0, j] + drive_im[now, j]


@compiled(error_model="numpy", fastmath={"reassoc", "contract"})
def _multiplied(step: Array, drive: Array, x: Array, count: int, substeps: int) -> None:  # pragma: no cover - compiled
    """Step states from sample 0 to `count`, in place."""
    per_sample = len(drive) // count
    for k in range(count):
        _copy(x[k], x[k + 1])
        for sub in range(substeps):
            moved = np.dot(x[k + 1], step)
            for j in range(len(moved)):
                x[k + 1, j] = moved[j] + drive[k * per_sample + min(sub, per_sample - 1), j]


@compiled(error_model="numpy", fastmath={"reassoc", "contract"})
def integrate_linear(
    turn: Array,
    dense: Array,
    into: Array,
    rows: Array,
    direct: Array,
    inputs: Array,
    state: Array,
    substeps: int,
    y: Array,
) -> None:  # pragma: no cover - compiled
    """Integrate linear systems under inputs, in place.

    Inputs and outputs are matrix products over blocks of samples; only the modes are integrated one by one.

    Parameters
    ----------
    turn : (n_sets, 2, m) array
        Real and imaginary parts of the step's eigenvalues.
    dense : (n_sets, m, m) array
        Step matrices, acting on rows from the right; empty in modal form.
    into : (n_sets, n_inputs, 2m) array
        Effect of a unit input on the state.
    rows : (n_sets, 2m, p) array
        Output columns.
    direct : (n_sets, n_inputs, p) array
        Feedthrough.
    inputs : (1 or n_sets, n_runs, n, 1 or substeps, n_inputs) array
        Inputs [SI].
    state : (n_sets, n_runs, 2m) array
        Initial states, overwritten by the final ones.
    substeps : int
        Steps per sample.
    y : (n_sets, n_runs, n, p) array
        Channels [SI], overwritten.
    """
    n_sets, n_runs, n, _ = y.shape
    per_sample, n_inputs = inputs.shape[3], inputs.shape[4]
    m = state.shape[2] // 2
    re, im = np.zeros((BLOCK + 1, m)), np.zeros((BLOCK + 1, m))
    for s in range(n_sets):
        of = min(s, inputs.shape[0] - 1)
        into_re, into_im = np.ascontiguousarray(into[s, :, :m]), np.ascontiguousarray(into[s, :, m:])
        for r in range(n_runs):
            _copy(state[s, r, :m], re[0])
            _copy(state[s, r, m:], im[0])
            for first in range(0, n, BLOCK):
                count = min(BLOCK, n - first)
                u = inputs[of, r, first : first + count]
                held = u.reshape(count * per_sample, n_inputs)
                drive_re, drive_im = np.dot(held, into_re), np.dot(held, into_im)
                if dense.shape[0] > 0:
                    _multiplied(dense[s], drive_re, re, count, substeps)
                else:
                    _turned(turn[s], drive_re, drive_im, re, im, count, substeps)
                out = y[s, r, first : first + count]
                of_re, of_im = np.dot(re[:count], rows[s, :m]), np.dot(im[:count], rows[s, m:])
                for k in range(count):
                    for c in range(out.shape[1]):
                        out[k, c] = of_re[k, c] + of_im[k, c]
                if n_inputs > 0:
                    passed = np.dot(np.ascontiguousarray(u[:, 0]), direct[s])
                    for k in range(count):
                        for c in range(out.shape[1]):
                            out[k, c] += passed[k, c]
                _copy(re[count], re[0])
                _copy(im[count], im[0])
            _copy(re[0], state[s, r, :m])
            _copy(im[0], state[s, r, m:])
