"""Frequency response at a known level, by describing functions.

A nonlinear law at a port is a complex stiffness Z(a) that depends on the amplitude a of the port. The port has the
compliance g, and without the law the motion x0. Each line of a stepped sine solves a |1 + g Z(a)| = |x0|. A scan over
amplitudes finds every solution of that equation; where a response folds, the solution nearest to the data counts. Under
noise, a is the standard deviation of the port over all lines. Several ports are solved in turns. Derivatives follow from
the implicit function theorem.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.diagnose.data.responses import Response
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.equivalent_table import Equivalent, equivalent
from vlab.diagnose.settings import LEVEL_RESPONSE
from vlab.signals import Array, ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Element:
    """Nonlinear terms at one port.

    Parameters
    ----------
    row : (m,) array
        Displacement of the port per modal coordinate.
    terms : tuple of Term
        Nonlinear terms.
    """

    row: Array
    terms: tuple[Term, ...]

    def stiffness(self, amplitude: Array, motion_omega: Array, omega: Array, is_gaussian: bool) -> Equivalent:
        """Return the equivalent stiffness of all terms.

        Parameters
        ----------
        amplitude : array
            Amplitude or standard deviation of the port [m or rad].
        motion_omega : array
            Circular frequency of the motion [rad/s].
        omega : array
            Circular frequency of the lines [rad/s]; equal to `motion_omega` under a sine.
        is_gaussian : bool
            Whether the motion is noise.

        Returns
        -------
        Equivalent
            Stiffness and slope.
        """
        parts = [equivalent(t.effect, t.values, amplitude, motion_omega, is_gaussian=is_gaussian) for t in self.terms]
        value, slope = sum(p.value for p in parts), sum(p.slope for p in parts)
        if is_gaussian:  # the loss of a noisy motion is a damping
            ratio = omega / motion_omega
            value, slope = value.real + 1j * ratio * value.imag, slope.real + 1j * ratio * slope.imag
        return Equivalent(value=np.asarray(value), slope=np.asarray(slope))


def elements_of(terms: Sequence[Term]) -> list[Element]:
    """Return the nonlinear ports of a hypothesis, one element each.

    Parameters
    ----------
    terms : sequence of Term
        Nonlinear port terms.

    Returns
    -------
    list of Element
        One element for each distinct port.
    """
    out: list[Element] = []
    for term in terms:
        for row in term.place.rows:
            known = next((i for i, e in enumerate(out) if np.array_equal(e.row, row)), None)
            if known is None:
                out.append(Element(row=row, terms=(term,)))
            else:
                out[known] = replace(out[known], terms=(*out[known].terms, term))
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Excitation:
    """Excitation of one response.

    Parameters
    ----------
    omega : (n,) array
        Circular frequencies of the lines [rad/s].
    amplitude : (n,) array
        Amplitude of the command in a line; under noise the square root of its power in the line.
    is_random : bool
        Whether the excitation is noise.
    """

    omega: Array
    amplitude: Array
    is_random: bool

    def size(self, motion: ComplexArray) -> Array:
        """Return the amplitude of a motion (n, ...).

        Under noise the amplitude is the standard deviation, equal in all lines.
        """
        if not self.is_random:
            return np.abs(motion)
        return np.broadcast_to(np.sqrt(np.sum(np.abs(motion) ** 2, axis=0)), motion.shape)

    def change(self, motion: ComplexArray, by: ComplexArray) -> Array:
        """Return the log amplitude's change under changed motion.

        Parameters
        ----------
        motion, by : (n, ...) complex array
            Motion and its change.

        Returns
        -------
        (n, ...) array
            Change of the log amplitude.
        """
        product = np.real(np.conj(motion) * by)
        if not self.is_random:
            return np.asarray(product / np.maximum(np.abs(motion) ** 2, 1e-300))
        power = np.maximum(np.sum(np.abs(motion) ** 2, axis=0), 1e-300)
        return np.broadcast_to(np.sum(product, axis=0) / power, product.shape)

    def frequency(self, motion: ComplexArray) -> Array:
        """Return the circular frequency (n,) of a motion (n,).

        Under noise the frequency is the mean one of its zero crossings.
        """
        if not self.is_random:
            return self.omega
        power = np.abs(motion) ** 2
        return np.full(len(power), np.sqrt(np.sum(self.omega**2 * power) / max(float(np.sum(power)), 1e-300)))


def excitation_of(data: Response) -> Excitation:
    """Return the excitation of a response with a level.

    Noise has a flat spectrum over the band of the lines.

    Parameters
    ----------
    data : Response
        Response with a level.

    Returns
    -------
    Excitation
        Excitation.
    """
    assert data.level is not None
    if not data.is_random:
        amplitude = np.full(len(data.freq), np.sqrt(2.0) * data.level)
    else:
        width = np.gradient(data.freq)
        amplitude = data.level * np.sqrt(width / width.sum())
    return Excitation(omega=data.omega, amplitude=amplitude, is_random=data.is_random)


Distance = Callable[[Array, int, ComplexArray], Array]
"""Lines (k,), element and stiffness (k,) of the element to the distance (k,) of the response from the data."""


def solve_amplitudes(
    elements: Sequence[Element],
    compliance: ComplexArray,
    free: ComplexArray,
    excitation: Excitation,
    distance: Callable[[ComplexArray], Distance] | None = None,
) -> tuple[ComplexArray, ComplexArray]:
    """Return the stiffness of every element in its own motion.

    Parameters
    ----------
    elements : sequence of Element
        Nonlinear ports, E in number.
    compliance : (n, E, E) complex array
        Motion of the ports per unit load at the ports, without the elements.
    free : (n, E) complex array
        Motion of the ports without the elements.
    excitation : Excitation
        Excitation.
    distance : callable or None
        Receives the stiffness (n, E) of all elements and returns a `Distance`; None selects the largest amplitude.

    Returns
    -------
    stiffness, slope : (n, E) complex array
        Stiffness, and its derivative by the log amplitude of the element.
    """
    n, count = free.shape
    stiffness, slope = np.zeros((n, count), dtype=complex), np.zeros((n, count), dtype=complex)
    last = np.zeros((n, count))
    for sweep in range(LEVEL_RESPONSE.sweeps if count > 1 or excitation.is_random else 1):
        for e, element in enumerate(elements):
            others = stiffness.copy()
            others[:, e] = 0.0
            held = np.eye(count) + compliance * others[:, None, :]
            x = np.linalg.solve(held, free[..., None])[:, e, 0]
            g = np.linalg.solve(held, compliance[:, :, [e]])[:, e, 0]
            choose = None if distance is None else distance(stiffness)
            stiffness[:, e], slope[:, e] = _solve_one(element, e, g, x, stiffness[:, e], excitation, choose)
        moved = np.linalg.solve(np.eye(count) + compliance * stiffness[:, None, :], free[..., None])[..., 0]
        size = excitation.size(moved)
        if sweep and np.all(np.abs(size - last) <= LEVEL_RESPONSE.settled * size):
            break
        last = size
    return stiffness, slope


def _solve_one(
    element: Element,
    index: int,
    g: ComplexArray,
    x: ComplexArray,
    before: ComplexArray,
    excitation: Excitation,
    distance: Distance | None,
) -> tuple[ComplexArray, ComplexArray]:
    """Return stiffness and slope of one element, the others fixed."""
    omega = excitation.omega
    if excitation.is_random:
        motion_omega = excitation.frequency(x / (1 + g * before))

        def beyond(log_a: Array, lines: Array) -> Array:
            """Return the log of the amplitude over that of the response."""
            a = np.exp(log_a)[:, None] * np.ones(len(omega))
            z = element.stiffness(a, motion_omega, omega, True).value
            power = np.sum(np.abs(x / (1 + g * z)) ** 2, axis=1)
            return np.asarray(log_a - 0.5 * np.log(power))

        whole = float(excitation.size(x)[0])
        found, _ = _roots(beyond, np.array([np.log(whole)]))
        a = np.full(len(omega), np.exp(found.max()))
        own = element.stiffness(a, motion_omega, omega, True)
        return own.value, own.slope

    def over(log_a: Array, lines: Array) -> Array:
        z = element.stiffness(np.exp(log_a), omega[lines], omega[lines], False).value
        with np.errstate(divide="ignore"):
            return np.asarray(log_a + np.log(np.abs(1 + g[lines] * z)) - np.log(np.abs(x[lines])))

    found, lines = _roots(over, np.log(np.maximum(np.abs(x), 1e-300)))
    a = np.exp(_chosen(element, index, found, lines, omega, distance))
    own = element.stiffness(a, omega, omega, False)
    return own.value, own.slope


def _roots(function: Callable[[Array, Array], Array], linear: Array) -> tuple[Array, Array]:
    """Return all solutions in log amplitude, and their lines.

    Without a solution, the end of the scan nearest to zero counts: a port that sticks hardly moves.
    """
    below, above = LEVEL_RESPONSE.reach
    decade = np.log(10.0)
    step = decade / LEVEL_RESPONSE.per_decade
    grid = np.arange(linear.min() - below * decade, linear.max() + above * decade + step, step)
    n = len(linear)
    every = np.tile(grid, n), np.repeat(np.arange(n), len(grid))
    values = function(*every).reshape(n, len(grid))
    line, left = np.nonzero((values[:, :-1] < 0) != (values[:, 1:] < 0))
    low, high, at_low, at_high = grid[left], grid[left + 1], values[line, left], values[line, left + 1]
    for k in range(LEVEL_RESPONSE.refined if len(line) else 0):
        middle = 0.5 * (low + high) if k % 3 == 2 else low - at_low * (high - low) / (at_high - at_low)
        value = function(middle, line)
        same = (value < 0) == (at_low < 0)
        low, at_low = np.where(same, middle, low), np.where(same, value, at_low)
        high, at_high = np.where(same, high, middle), np.where(same, at_high, value)
    root = low - at_low * (high - low) / np.where(at_high == at_low, 1.0, at_high - at_low)
    none = np.setdiff1d(np.arange(n), line)
    ends = np.where(np.abs(values[none, 0]) < np.abs(values[none, -1]), grid[0], grid[-1])
    return np.concatenate([root, ends]), np.concatenate([line, none])


def _chosen(element: Element, index: int, log_a: Array, lines: Array, omega: Array, distance: Distance | None) -> Array:
    """Return the solution (n,) nearest to the data, or the largest."""
    order = np.lexsort((log_a, lines))
    log_a, lines = log_a[order], lines[order]
    out = np.zeros(len(omega))
    out[lines] = log_a  # the last entry of a line is the largest
    several = np.bincount(lines, minlength=len(omega)) > 1
    if distance is None or not several.any():
        return out
    open_ = np.flatnonzero(several[lines])
    z = element.stiffness(np.exp(log_a[open_]), omega[lines[open_]], omega[lines[open_]], False).value
    far = distance(lines[open_], index, z)
    for k in np.argsort(-far, kind="stable"):  # the nearest is written last
        out[lines[open_[k]]] = log_a[open_[k]]
    return out


def source_gain(terms: Sequence[Term], actuator: int | None, excitation: Excitation) -> Equivalent:
    """Return the gain of the nonlinear actuator terms of an input.

    Parameters
    ----------
    terms : sequence of Term
        Nonlinear terms.
    actuator : int or None
        Actuator of the input.
    excitation : Excitation
        Excitation by the command.

    Returns
    -------
    Equivalent
        Gain (n,); its slope is zero, because the command is given.
    """
    out = np.ones(len(excitation.omega), dtype=complex)
    none = np.zeros_like(out)
    for term in terms:
        if term.effect.kind == "actuator" and actuator is not None and actuator in term.place.indices:
            command = excitation.amplitude.astype(complex)
            omega = excitation.frequency(command)
            own = equivalent(
                term.effect, term.values, excitation.size(command), omega, is_gaussian=excitation.is_random
            )
            out = out * own.value
    return Equivalent(value=out, slope=none)
