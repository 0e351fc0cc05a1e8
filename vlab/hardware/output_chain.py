"""Output chain: zero-order hold, loop delay and RC low-pass, discretised exactly.

A command u_k taken at t_k = k T reaches the converter's output at t_k + tau and is held for T. The RC filter follows
with x' = a (w - x), a = 2 pi f_c. Both are linear and w is a staircase. A constant matrix therefore gives the filter
state at the samples and the mean force over every integration step exactly. A fractional delay (1.35 samples) puts the
step of w inside an integration step; its share is exact too.
"""

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from vlab.controllers.sampling import delay_split
from vlab.errors import BadExperiment
from vlab.hardware.laboratory import Converter
from vlab.signals import Array


class OutputChain:
    """Conversion of commands to mean forces of integration steps.

    Parameters
    ----------
    converter : Converter
        Rate, delay and filter.
    channels : int
        Number of outputs.
    substeps : int
        Integration steps per sample.
    """

    def __init__(self, converter: Converter, *, channels: int, substeps: int = 1) -> None:
        if channels < 1 or substeps < 1:
            raise BadExperiment(f"an output chain of {channels} channels and {substeps} steps a sample makes no sense")
        self.substeps = substeps
        self._whole, late = delay_split(converter.delay_samples)
        self._matrix = _transition(1.0 / converter.rate, late, self._whole, converter.filter_corner, substeps)
        # Two buffers of rows [means of the steps | filter state, last commands | new command]. A sample's means and
        # next memory go into the other buffer. The memory is then in place for the next sample, without a copy.
        rows, columns = self._matrix.shape
        buffers = [np.zeros((substeps + columns, channels)) for _ in range(2)]
        self._sides = [(b[-1], b[substeps:], other[:rows], other[:substeps]) for b, other in (buffers, buffers[::-1])]
        self._buffers = buffers
        self.push = self._bind()

    def reset(self) -> None:
        """Discharge the filter and drop pending commands."""
        for buffer in self._buffers:
            buffer[:] = 0.0

    def _bind(self) -> Callable[[Array], Array]:
        """Return the step function with local names.

        The function runs two thousand times a simulated second. Array methods are faster than numpy's functions.
        """
        (new, state, out, forces), other = self._sides
        follow = self._matrix.dot

        def push(command: Array) -> Array:
            """Take a sample's command and return its mean forces.

            Returns
            -------
            array
                View, (substeps, channels).
            """
            nonlocal new, state, out, forces, other
            new[:] = command
            follow(state, out)
            given = forces
            (new, state, out, forces), other = other, (new, state, out, forces)
            return given

        return push

    def response(self, commands: Array) -> Array:
        """Return the mean forces for a run of commands, from rest.

        Parameters
        ----------
        commands : (n_samples, channels) array

        Returns
        -------
        (n_samples * substeps, channels) array
            Same result as `push`, sample by sample.
        """
        lagged = [
            np.concatenate([np.zeros((lag, commands.shape[1])), commands[: len(commands) - lag]])
            for lag in range(1, self._whole + 2)
        ]
        inputs = np.stack([*lagged, commands])  # order of the matrix's columns after the filter state
        means, state_row = self._matrix[: self.substeps], self._matrix[self.substeps]
        drive = np.einsum("i,ikc->kc", state_row[1:], inputs)
        filtered = lfilter([0.0, 1.0], [1.0, -state_row[0]], drive, axis=0)
        steps = means[:, :1, None] * filtered[None] + np.einsum("ji,ikc->jkc", means[:, 1:], inputs)
        return np.asarray(np.moveaxis(steps, 0, 1).reshape(-1, commands.shape[1]))

    @property
    def matrix(self) -> Array:
        """Constant matrix of the chain.

        Rows are the substeps' means and the next memory, columns the memory and the command.
        """
        return self._matrix


def _transition(period: float, late: float, whole: int, corner: float, substeps: int) -> Array:
    """Return the matrix of `OutputChain`.

    Columns: filter state x, commands u_(k-1) ... u_(k-whole-1), u_k. In sample k the output is u_(k-whole-1) until
    `late` periods have passed, then u_(k-whole).
    """
    n_memory = 1 + whole + 1
    old = whole + 1  # column of u_(k-whole-1)
    new = whole if whole >= 1 else n_memory  # column of u_(k-whole): a memory or the new command
    x = np.zeros(n_memory + 1)
    x[0] = 1.0
    rows = []
    for j in range(substeps):
        begin, end = j / substeps, (j + 1) / substeps
        total = np.zeros(n_memory + 1)
        for a, b, column in ((begin, min(max(late, begin), end), old), (min(max(late, begin), end), end, new)):
            if b > a:
                held = np.eye(n_memory + 1)[column]
                x, mean = _follow(x, held, (b - a) * period, corner)
                total += mean * (b - a)
        rows.append(total * substeps)
    shift = np.zeros((n_memory - 1, n_memory + 1))
    shift[0, n_memory] = 1.0
    for i in range(1, n_memory - 1):
        shift[i, i] = 1.0
    return np.vstack([*rows, x, shift])


def _follow(x: Array, held: Array, duration: float, corner: float) -> tuple[Array, Array]:
    """Return the filter's output and mean under a held input.

    Both belong to the interval `duration`.
    """
    if corner == 0.0:
        return held, held
    a = 2 * np.pi * corner * duration
    left = np.exp(-a)
    return held + (x - held) * left, held + (x - held) * (-np.expm1(-a) / a)


def theoretical_response(converter: Converter, freq: Array, *, hold: bool = True) -> Array:
    """Return the continuous response of hold, delay and filter.

    The fundamental of the staircase is the sampled command times sinc(f T) with half a sample of lag. Delay and filter
    follow as exp(-j omega tau) and 1/(1 + j f/f_c).

    Parameters
    ----------
    converter : Converter
        Rate, delay and filter.
    freq : array
        Frequencies [Hz].
    hold : bool
        Whether to include the hold.

    Returns
    -------
    array
        Complex response, (n,).
    """
    freq = np.asarray(freq, dtype=float)
    period = 1.0 / converter.rate
    response = np.exp(-2j * np.pi * freq * converter.delay_samples * period)
    if hold:
        response = response * np.sinc(freq * period) * np.exp(-1j * np.pi * freq * period)
    if converter.filter_corner > 0:
        response = response / (1 + 1j * freq / converter.filter_corner)
    return np.asarray(response)
