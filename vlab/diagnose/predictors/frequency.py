"""Frequency response of a plant, with derivatives.

The dynamic stiffness is Z = K + i omega C - omega^2 M plus port impedances; derivatives use dH = -H dZ H.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from vlab.diagnose.data.responses import Response
from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.frequency_model import View, Wires
from vlab.diagnose.settings import FREQUENCY
from vlab.physics.effect import ActuatorEffect, LinearPortEffect, PickUp, PortEffect, SensorEffect, Values
from vlab.physics.small_signal import SmallSignal, channel_response, is_linear, small_signal
from vlab.signals import Array, ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """Matrices of a plant at one set of uncertain parameters.

    Parameters
    ----------
    M, C, K : (m, m) array
        Modal matrices.
    changes : tuple of (M, C, K)
        Derivatives by each uncertain parameter; None where zero.
    input_gain : (n_columns,) array
        Gains of the inputs.
    output_gain : (n_outputs,) array
        Gains of the outputs.
    """

    M: Array
    C: Array
    K: Array
    changes: tuple[tuple[Array | None, Array | None, Array | None], ...] = ()
    input_gain: Array
    output_gain: Array


def at_port(term: Term, values: Values, fastest: float) -> SmallSignal:
    """Return the linearised force of a term at a port."""
    assert isinstance(term.effect, (PortEffect, LinearPortEffect))
    return small_signal(term.effect, values, term.place.stiffness, fastest)


def is_port(term: Term) -> bool:
    """Return whether a term is a force at a port."""
    return term.effect.kind == "port"


def is_level_dependent(term: Term) -> bool:
    """Return whether a term's response depends on the level."""
    return not is_linear(term.effect)


# ---- responses ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """Frequency response of the model.

    Parameters
    ----------
    H : (n, n_outputs) complex array
        Response [SI].
    by_theta : (n_parameters, n, n_outputs) complex array
        Derivatives by the uncertain parameters, where requested.
    by_term : (n_values, n, n_outputs) complex array
        Derivatives by the logarithm of every effect parameter; by the scaled value where signed.
    """

    H: ComplexArray
    by_theta: ComplexArray = field(default_factory=lambda: np.zeros((0, 0, 0), dtype=complex))
    by_term: ComplexArray = field(default_factory=lambda: np.zeros((0, 0, 0), dtype=complex))


@dataclass(frozen=True, kw_only=True, eq=False)
class Solved:
    """Structural part of a response on its lines.

    Parameters
    ----------
    motion : (n, m) complex array
        Modal motion per unit input.
    reading : (n, m, n_all) complex array
        Modal motion per unit load on every output; by reciprocity the output per modal force.
    H : (n, n_all) complex array
        Response of every output, before gains and chains.
    loaded : (n, m, n_loads) complex array
        Modal motion per unit of further loads, where requested.
    rows : (n, n_all, m) complex array
        Outputs per modal motion.
    """

    motion: ComplexArray
    reading: ComplexArray
    H: ComplexArray
    loaded: ComplexArray
    rows: ComplexArray


def output_rows(rows: ChannelRows, orders: Sequence[int], order: int, omega: Array) -> ComplexArray:
    """Return the outputs per modal motion.

    Parameters
    ----------
    rows : ChannelRows
        Outputs per modal coordinate.
    orders : sequence of int
        Time derivatives of displacement in every output.
    order : int
        Time derivatives of displacement in the response.
    omega : (n,) array
        Circular frequencies [rad/s].

    Returns
    -------
    (n, n_outputs, m) complex array
        Rows.
    """
    s = 1j * omega[:, None, None]
    read = rows.at_q[None] + s * rows.at_v[None] + s**2 * rows.at_a[None]
    power = order - np.array(orders, dtype=float)
    return np.asarray(read * (1j * omega[:, None, None]) ** power[None, :, None])


def dynamic(state: State, omega: Array, terms: Sequence[Term]) -> ComplexArray:
    """Return the dynamic stiffness with linear port effects.

    Parameters
    ----------
    state : State
        Matrices.
    omega : (n,) array
        Circular frequencies [rad/s].
    terms : sequence of Term
        Effects.

    Returns
    -------
    (n, m, m) complex array
        Dynamic stiffness.
    """
    w = omega[:, None, None]
    out = state.K - w**2 * state.M + 1j * w * state.C
    for term in terms:
        if is_port(term) and not is_level_dependent(term):
            z = at_port(term, term.values, float(omega[-1])).impedance(1j * omega)
            out = out + z[:, None, None] * (term.place.rows.T @ term.place.rows)
    return np.asarray(out)


Shared = dict[tuple[int, int], tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]]
"""Solutions of one state by lines and order, for several inputs on equal lines."""


def solve(
    view: View,
    state: State,
    response: Response,
    column: int,
    terms: Sequence[Term],
    shared: Shared | None = None,
    loads: Array | None = None,
) -> Solved:
    """Solve the structural part of a response.

    Nonlinear terms are omitted.

    Parameters
    ----------
    view : View
        Linearised plant.
    state : State
        Matrices.
    response : Response
        Lines and outputs.
    column : int
        Input column.
    terms : sequence of Term
        Effects.
    shared : dict or None
        Cache for responses on equal lines and equal loads.
    loads : (n_loads, m) array or None
        Rows of further unit loads.

    Returns
    -------
    Solved
        Motion and response.
    """
    loads = np.zeros((0, view.m)) if loads is None else loads
    key = (id(response.freq), response.order)
    if shared is None or key not in shared:
        omega = response.omega
        rows = output_rows(view.rows, view.orders, response.order, omega)
        n, n_all, m = rows.shape
        used = list(view.columns)
        k = len(used)
        right = np.empty((n, m, k + n_all + len(loads)), dtype=complex)
        right[:, :, :k] = view.forces[:, used]
        right[:, :, k : k + n_all] = rows.transpose(0, 2, 1)
        right[:, :, k + n_all :] = loads.T
        every = np.linalg.solve(dynamic(state, omega, terms), right)
        found = rows, every[:, :, :k], every[:, :, k : k + n_all], every[:, :, k + n_all :]
        if shared is not None:
            shared[key] = found
    else:
        found = shared[key]
    rows, motions, reading, loaded = found
    motion = motions[:, :, view.columns.index(column)]
    H = (rows @ motion[:, :, None])[:, :, 0]
    return Solved(motion=motion, reading=reading, H=H, loaded=loaded, rows=rows)


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Measurement chain, H_recorded = gain (source mix H + beside).

    Parameters
    ----------
    mix : (n, n_outputs, n_outputs) complex array
        Transfer from the motion at every output to every channel.
    beside : (n, n_outputs) complex array
        Crosstalk of the command.
    source : (n,) complex array
        Transfer from command to force.
    gain : (n_outputs,) array
        Gains of the channels.
    """

    mix: ComplexArray
    beside: ComplexArray
    source: ComplexArray
    gain: Array

    def apply(self, H: ComplexArray) -> ComplexArray:
        """Return recorded responses (..., n, n_outputs) without crosstalk of the command."""
        mixed = (self.mix @ H[..., None])[..., 0]
        return np.asarray(mixed * self.source[:, None] * self.gain)

    def recorded(self, H: ComplexArray) -> ComplexArray:
        """Return the recorded responses (n, n_outputs)."""
        return np.asarray(self.apply(H) + self.beside * self.gain)


def chain_of(view: View, state: State, response: Response, wires: Wires, terms: Sequence[Term]) -> Chain:
    """Return the measurement chain of a response, without nonlinear terms.

    Parameters
    ----------
    view : View
        Linearised plant.
    state : State
        Matrices and gains.
    response : Response
        Lines and outputs.
    wires : Wires
        Inputs and outputs.
    terms : sequence of Term
        Effects in their order.

    Returns
    -------
    Chain
        Chain.
    """
    j = wires.inputs.index(response.input)
    n, n_out = len(response.freq), len(wires.outputs)
    mix = np.repeat(np.eye(n_out, dtype=complex)[None], n, axis=0)
    beside = np.zeros((n, n_out), dtype=complex)
    source = np.full(n, complex(state.input_gain[view.columns[j]]))
    for term in terms:
        effect, k = term.effect, term.place.index
        if is_level_dependent(term):
            continue
        if isinstance(effect, ActuatorEffect):
            if wires.actuators[j] in term.place.indices:
                source = source * channel_response(effect, term.values, response.freq)
        elif isinstance(effect, PickUp):
            p = {name: float(v) for name, v in term.values.items()}
            own, share = complex(effect.mix(1.0, 0.0, p)), complex(effect.mix(0.0, 1.0, p))
            mix[:, k], beside[:, k] = own * mix[:, k], own * beside[:, k]
            if "sensor" in effect.needs:
                mix[:, k] += share * mix[:, term.place.other]
                beside[:, k] += share * beside[:, term.place.other]
            elif term.place.other == wires.actuators[j]:
                beside[:, k] += share
        elif isinstance(effect, SensorEffect):
            factor = channel_response(effect, term.values, response.freq)
            mix[:, k], beside[:, k] = factor[:, None] * mix[:, k], factor * beside[:, k]
    return Chain(mix=mix, beside=beside, source=source, gain=state.output_gain)


def answer(
    view: View,
    state: State,
    response: Response,
    wires: Wires,
    terms: Sequence[Term] = (),
    *,
    gains: Sequence[tuple[int | None, int | None]] = (),
    with_derivatives: bool = False,
    shared: Shared | None = None,
) -> Answer:
    """Return the linear frequency response of the model on measured lines.

    Nonlinear terms are omitted.

    Parameters
    ----------
    view : View
        Linearised plant.
    state : State
        Matrices and gains.
    response : Response
        Measured lines and outputs.
    wires : Wires
        Inputs and outputs.
    terms : sequence of Term
        Effects.
    gains : sequence of (column, output)
        Input or output whose gain each uncertain parameter is; (None, None) for matrix parameters.
    with_derivatives : bool
        Whether to compute derivatives.
    shared : dict or None
        Cache of `solve`.

    Returns
    -------
    Answer
        Response with derivatives.
    """
    every = [*view.fixed, *terms]
    j = wires.inputs.index(response.input)
    column = view.columns[j]
    solved = solve(view, state, response, column, every, shared)
    chain = chain_of(view, state, response, wires, every)
    own = [wires.names.index(o) for o in response.outputs]
    H = chain.recorded(solved.H)
    if not with_derivatives:
        return Answer(H=H[:, own])
    by_theta = np.zeros((len(state.changes), len(response.freq), len(own)), dtype=complex)
    direct = chain.apply(solved.H)
    pushes: list[tuple[int, ComplexArray]] = []
    for i, ((M, C, K), (gain_column, gain_output)) in enumerate(zip(state.changes, gains, strict=True)):
        if gain_column is not None:
            by_theta[i] = direct[:, own] if gain_column == column else 0.0
        elif gain_output is not None:
            part = np.zeros_like(H)
            part[:, gain_output] = H[:, gain_output]
            by_theta[i] = part[:, own]
        else:
            push = modal_force(M, C, K, solved.motion, response.omega)
            if push is not None:
                pushes.append((i, push))
    if pushes:
        every_push = np.stack([push for _, push in pushes], axis=1)  # (n, parameters, m)
        moved = chain.apply(-(every_push @ solved.reading).transpose(1, 0, 2))[:, :, own]
        for (i, _), part in zip(pushes, moved, strict=True):
            by_theta[i] = part
    by_term = [
        part
        for k, term in enumerate(terms)
        for part in _by_term(view, state, response, wires, every, len(view.fixed) + k, term, solved, chain, own)
    ]
    shape = (0, len(response.freq), len(own))
    return Answer(H=H[:, own], by_theta=by_theta, by_term=np.array(by_term) if by_term else np.zeros(shape, complex))


def modal_force(
    M: Array | None, C: Array | None, K: Array | None, motion: ComplexArray, omega: Array
) -> ComplexArray | None:
    """Return the modal force of changed matrices.

    Parameters
    ----------
    M, C, K : (m, m) array or None
        Changes of the matrices; None where zero.
    motion : (n, m) complex array
        Modal motion.
    omega : (n,) array
        Circular frequencies [rad/s].

    Returns
    -------
    (n, m) complex array or None
        Modal force; None without changes.
    """
    out: ComplexArray | None = None
    for part, power in ((K, 0), (C, 1), (M, 2)):
        if part is not None:
            push = (motion @ part.T) * ((1j * omega) ** power)[:, None]
            out = push if out is None else out + push
    return out


def stepped(term: Term, name: str, step: float) -> tuple[Term, float]:
    """Return a term with one stepped parameter.

    Parameters
    ----------
    term : Term
        Term.
    name : str
        Parameter.
    step : float
        Step of the logarithm, or relative step of a signed value.

    Returns
    -------
    term : Term
        Stepped term.
    step : float
        Step in the fitted coordinate.
    """
    parameter, value = term.effect.parameter(name), float(term.values[name])
    if parameter.signed:
        size = max(abs(value), 1e-6 * max(abs(parameter.low), 1e-12))
        return Term(
            effect=term.effect, place=term.place, values={**term.values, name: value + step * size}
        ), step * size
    moved = value * float(np.exp(step))
    return Term(effect=term.effect, place=term.place, values={**term.values, name: moved}), step


def _by_term(
    view: View,
    state: State,
    response: Response,
    wires: Wires,
    every: Sequence[Term],
    index: int,
    term: Term,
    solved: Solved,
    chain: Chain,
    own: list[int],
) -> list[ComplexArray]:
    out = []
    for parameter in term.effect.parameters:
        moved, by = stepped(term, parameter.name, FREQUENCY.step)
        if is_level_dependent(term):
            out.append(np.zeros((len(response.freq), len(own)), dtype=complex))
        elif is_port(term):
            omega = response.omega
            z = [at_port(t, t.values, float(omega[-1])).impedance(1j * omega) for t in (term, moved)]
            there = solved.motion @ term.place.rows.T  # (n, k)
            push = there @ term.place.rows  # (n, m)
            change = -(push[:, None, :] @ solved.reading)[:, 0] * ((z[1] - z[0]) / by)[:, None]
            out.append(chain.apply(change)[:, own])
        else:
            other = chain_of(view, state, response, wires, [*every[:index], moved, *every[index + 1 :]])
            out.append(((other.recorded(solved.H) - chain.recorded(solved.H)) / by)[:, own])
    return out
