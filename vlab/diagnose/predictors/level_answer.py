"""Modelled response at the level of the data, with derivatives.

With unit loads at the nonlinear ports, a low-rank update (Sherman, Morrison and Woodbury) turns the linear response into
the one with equivalent stiffnesses. A change of a parameter acts directly, and through the amplitude on the stiffnesses.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vlab.diagnose.data.responses import Response
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.equivalent_table import equivalent
from vlab.diagnose.predictors.frequency import (
    Answer,
    Chain,
    Shared,
    Solved,
    State,
    answer,
    at_port,
    chain_of,
    is_level_dependent,
    is_port,
    modal_force,
    solve,
    stepped,
)
from vlab.diagnose.predictors.frequency_model import View, Wires
from vlab.diagnose.predictors.level_response import (
    Distance,
    Element,
    Excitation,
    elements_of,
    excitation_of,
    solve_amplitudes,
    source_gain,
)
from vlab.diagnose.settings import FREQUENCY, LEVEL_RESPONSE
from vlab.signals import Array, ComplexArray


def answer_at_level(
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
    """Return the response of the model at the level of the data.

    Without nonlinear terms, or without a level, the response is linear.

    Parameters
    ----------
    view : View
        Linearised plant.
    state : State
        Matrices and gains.
    response : Response
        Measured lines, outputs and level.
    wires : Wires
        Inputs and outputs.
    terms : sequence of Term
        Effects.
    gains : sequence of (column, output)
        Input or output whose gain each uncertain parameter is; (None, None) for matrix parameters.
    with_derivatives : bool
        Whether to compute derivatives.
    shared : dict or None
        Cache of `vlab.diagnose.predictors.frequency.solve`.

    Returns
    -------
    Answer
        Response with derivatives.
    """
    every = [*view.fixed, *terms]
    if response.level is None or not any(is_level_dependent(t) for t in every):
        return answer(
            view, state, response, wires, terms, gains=gains, with_derivatives=with_derivatives, shared=shared
        )
    own = [wires.names.index(o) for o in response.outputs]
    at = operating_point(view, state, response, wires, every, shared)
    if not with_derivatives:
        return Answer(H=at.recorded[:, own])
    column = view.columns[wires.inputs.index(response.input)]
    by_theta = np.zeros((len(state.changes), len(response.freq), len(own)), dtype=complex)
    for i, ((M, C, K), (gain_column, gain_output)) in enumerate(zip(state.changes, gains, strict=True)):
        if gain_column is not None:
            if gain_column == column:
                by_theta[i] = at.follows(at.chain.apply(at.solved.H) / at.chain.gain, at.motion)[:, own]
        elif gain_output is not None:
            part = np.zeros_like(at.recorded)
            part[:, gain_output] = at.recorded[:, gain_output]
            by_theta[i] = part[:, own]
        else:
            push = modal_force(M, C, K, at.solved.motion, response.omega)
            if push is not None:
                by_theta[i] = at.pushed(push)[:, own]
    by_term = [part[:, own] for k in range(len(terms)) for part in _by_term(at, len(view.fixed) + k)]
    shape = (0, len(response.freq), len(own))
    out = np.array(by_term) if by_term else np.zeros(shape, complex)
    return Answer(H=at.recorded[:, own], by_theta=by_theta, by_term=out)


@dataclass(frozen=True, kw_only=True, eq=False)
class OperatingPoint:
    """Response in the motion at one level.

    Parameters
    ----------
    view, state, response, wires : View, State, Response, Wires
        Model and data.
    terms : tuple of Term
        All terms, those of the plant included.
    elements : tuple of Element
        Nonlinear ports, E in number.
    excitation : Excitation
        Excitation.
    stiffness, slope : (n, E) complex array
        Equivalent stiffness, and its derivative by the log amplitude.
    solved : Solved
        Structural response with these stiffnesses.
    chain : Chain
        Measurement chain with the gains of nonlinear actuators, without nonlinear sensors.
    motion : (n, E) complex array
        Motion of the ports under the excitation [m or rad].
    compliance : (n, E, E) complex array
        Motion of the ports per unit load at the ports.
    outputs : (n, n_all, E) complex array
        Outputs per unit load at the ports, before the chain.
    """

    view: View
    state: State
    response: Response
    wires: Wires
    terms: tuple[Term, ...]
    elements: tuple[Element, ...]
    excitation: Excitation
    stiffness: ComplexArray
    slope: ComplexArray
    solved: Solved
    chain: Chain
    motion: ComplexArray
    compliance: ComplexArray
    outputs: ComplexArray

    @property
    def recorded(self) -> ComplexArray:
        """Recorded responses (n, n_all)."""
        return np.asarray(self.sensed * self.sensor_gain()[0] * self.chain.gain)

    @property
    def sensed(self) -> ComplexArray:
        """Responses (n, n_all) before nonlinear sensors and gains."""
        return np.asarray(self.chain.recorded(self.solved.H) / self.chain.gain)

    def sensor_gain(self, terms: Sequence[Term] | None = None) -> tuple[ComplexArray, ComplexArray]:
        """Return nonlinear sensors' gain (n, n_all) and its log-amplitude derivative."""
        chosen = self.terms if terms is None else terms
        return sensor_gains(chosen, self.sensed, self.wires.orders, self.response.order, self.excitation)

    def follows(self, change: ComplexArray, moved: ComplexArray) -> ComplexArray:
        """Return the change of recorded responses with the feedback through amplitudes.

        Parameters
        ----------
        change : (n, n_all) complex array
            Direct change of the responses before nonlinear sensors and gains.
        moved : (n, E) complex array
            Direct change of the motion of the ports.

        Returns
        -------
        (n, n_all) complex array
            Change of the recorded responses.
        """
        excitation = self.excitation
        stiffened = self._stiffened(excitation.change(self.motion, moved))
        push = stiffened * self._unit_motion
        change = change - self._chained((self.outputs @ push[..., None])[..., 0])
        gain, slope = self.sensor_gain()
        out = gain * change
        if np.any(slope):
            sensed = self.sensed
            scale = excitation.amplitude[:, None]
            out = out + slope * sensed * excitation.change(sensed * scale, change * scale)
        return np.asarray(out * self.chain.gain)

    @property
    def _unit_motion(self) -> ComplexArray:
        """Motion of the ports per unit of the structural input (n, E)."""
        rows = np.array([e.row for e in self.elements]).reshape(-1, self.view.m)
        return np.asarray(self.solved.motion @ rows.T)

    def _chained(self, H: ComplexArray) -> ComplexArray:
        return np.asarray(self.chain.apply(H) / self.chain.gain)

    def _stiffened(self, rate: Array) -> ComplexArray:
        """Return stiffness changes (n, E) under changes of log amplitudes (n, E)."""
        count = len(self.elements)
        if not count:
            return np.zeros(rate.shape, dtype=complex)
        # motion of port e under a change of the log amplitude of port f
        answers = -self.compliance * (self.slope * self.motion)[:, None, :]
        excitation = self.excitation
        if excitation.is_random:
            power = np.maximum(np.sum(np.abs(self.motion) ** 2, axis=0), 1e-300)
            loop = np.sum(np.real(np.conj(self.motion)[:, :, None] * answers), axis=0) / power[:, None]
            loop = np.broadcast_to(loop, answers.shape)
        else:
            size = np.maximum(np.abs(self.motion) ** 2, 1e-300)
            loop = np.real(np.conj(self.motion)[:, :, None] * answers) / size[:, :, None]
        held = np.eye(count) - loop
        turn = np.linalg.det(held)
        least = LEVEL_RESPONSE.least_turn
        held = np.where((np.abs(turn) < least)[:, None, None], np.eye(count), held)
        return np.asarray(self.slope * np.linalg.solve(held, rate[..., None])[..., 0])

    def pushed(self, push: ComplexArray) -> ComplexArray:
        """Return the change of recorded responses under a resisting modal force.

        Parameters
        ----------
        push : (n, m) complex array
            Modal force per unit input.

        Returns
        -------
        (n, n_all) complex array
            Change of the recorded responses.
        """
        direct = -self._chained((push[:, None, :] @ self.solved.reading)[:, 0])
        scale = (self.chain.source * self.excitation.amplitude)[:, None]
        moved = -scale * (push[:, None, :] @ self.solved.loaded)[:, 0]
        return self.follows(direct, moved)


def sensor_gains(
    terms: Sequence[Term], H: ComplexArray, orders: Sequence[int], order: int, excitation: Excitation
) -> tuple[ComplexArray, ComplexArray]:
    """Return the gains of nonlinear sensors.

    Parameters
    ----------
    terms : sequence of Term
        Terms.
    H : (n, n_all) complex array
        Responses before the sensors.
    orders : sequence of int
        Time derivatives of displacement in every output.
    order : int
        Time derivatives of displacement in the responses.
    excitation : Excitation
        Excitation.

    Returns
    -------
    gain, slope : (n, n_all) complex array
        Gains, and their derivatives by the log amplitude.
    """
    gain, slope = np.ones_like(H), np.zeros_like(H)
    for term in terms:
        if term.effect.kind != "sensor" or not is_level_dependent(term):
            continue
        k = term.place.index
        signal = H[:, k] * excitation.omega ** float(orders[k] - order) * excitation.amplitude
        size, omega = np.maximum(excitation.size(signal), 1e-300), excitation.frequency(signal)
        own = equivalent(term.effect, term.values, size, omega, is_gaussian=excitation.is_random)
        slope[:, k] = slope[:, k] * own.value + gain[:, k] * own.slope
        gain[:, k] = gain[:, k] * own.value
    return gain, slope


def operating_point(
    view: View, state: State, response: Response, wires: Wires, terms: Sequence[Term], shared: Shared | None = None
) -> OperatingPoint:
    """Solve the response at the level of the data.

    Parameters
    ----------
    view : View
        Linearised plant.
    state : State
        Matrices and gains.
    response : Response
        Measured lines, outputs and level.
    wires : Wires
        Inputs and outputs.
    terms : sequence of Term
        All terms.
    shared : dict or None
        Cache of `vlab.diagnose.predictors.frequency.solve`.

    Returns
    -------
    OperatingPoint
        Solution.
    """
    nonlinear = [t for t in terms if is_level_dependent(t)]
    elements = elements_of([t for t in nonlinear if is_port(t)])
    rows = np.array([e.row for e in elements]).reshape(-1, view.m)
    j = wires.inputs.index(response.input)
    excitation = excitation_of(response)
    chain = chain_of(view, state, response, wires, terms)
    actuator = source_gain(nonlinear, wires.actuators[j], excitation).value
    chain = Chain(mix=chain.mix, beside=chain.beside, source=chain.source * actuator, gain=chain.gain)
    free = solve(view, state, response, view.columns[j], terms, shared, rows)
    start, compliance = free.motion @ rows.T, rows @ free.loaded
    outputs = free.rows @ free.loaded
    scale = chain.source * excitation.amplitude
    stiffness, slope = np.zeros(start.shape, dtype=complex), np.zeros(start.shape, dtype=complex)
    if elements:
        distance = _distances(response, wires, chain, free.H, outputs, compliance, start)
        stiffness, slope = solve_amplitudes(elements, compliance, scale[:, None] * start, excitation, distance)
    count = len(elements)
    # (I + Z G)^-1 on the right of every response to loads
    held = np.linalg.inv(np.eye(count) + stiffness[:, :, None] * compliance)
    resisted = (held @ (stiffness * start)[..., None])[..., 0]  # forces of the ports per unit input
    loaded = free.loaded @ held
    solved = Solved(
        motion=free.motion - (free.loaded @ resisted[..., None])[..., 0],
        reading=free.reading - loaded @ (stiffness[:, :, None] * (rows @ free.reading)),
        H=free.H - (outputs @ resisted[..., None])[..., 0],
        loaded=loaded,
        rows=free.rows,
    )
    return OperatingPoint(
        view=view,
        state=state,
        response=response,
        wires=wires,
        terms=tuple(terms),
        elements=tuple(elements),
        excitation=excitation,
        stiffness=stiffness,
        slope=slope,
        solved=solved,
        chain=chain,
        motion=scale[:, None] * (solved.motion @ rows.T),
        compliance=compliance @ held,
        outputs=outputs @ held,
    )


def _distances(
    response: Response,
    wires: Wires,
    chain: Chain,
    H: ComplexArray,
    outputs: ComplexArray,
    compliance: ComplexArray,
    start: ComplexArray,
) -> Callable[[ComplexArray], Distance]:
    """Return the distance of responses from the data, for trial stiffnesses."""
    own = [wires.names.index(o) for o in response.outputs]

    def with_others(stiffness: ComplexArray) -> Distance:
        def distance(lines: Array, index: int, z: ComplexArray) -> Array:
            every = stiffness[lines].copy()
            every[:, index] = z
            count = every.shape[1]
            held = np.eye(count) + every[:, :, None] * compliance[lines]
            force = np.linalg.solve(held, (every * start[lines])[..., None])
            moved = H[lines] - (outputs[lines] @ force)[..., 0]
            part = Chain(mix=chain.mix[lines], beside=chain.beside[lines], source=chain.source[lines], gain=chain.gain)
            found, data = part.recorded(moved)[:, own], response.H[lines]
            apart = np.abs(found) - np.abs(data) if response.is_magnitude else found - data
            return np.asarray(np.sum(np.abs(apart) ** 2, axis=1))

        return distance

    return with_others


def _by_term(at: OperatingPoint, index: int) -> list[ComplexArray]:
    """Return the derivatives of recorded responses (n, n_all) by a term's parameters."""
    term, out = at.terms[index], []
    for parameter in term.effect.parameters:
        moved, by = stepped(term, parameter.name, FREQUENCY.step)
        terms = [*at.terms[:index], moved, *at.terms[index + 1 :]]
        if is_port(term):
            out.append(_by_port(at, term, moved, by))
        elif is_level_dependent(term) and term.effect.kind == "sensor":
            change = (at.sensor_gain(terms)[0] - at.sensor_gain()[0]) / by
            out.append(at.sensed * change * at.chain.gain)
        else:
            out.append(_by_channel(at, terms, by))
    return out


def _by_port(at: OperatingPoint, term: Term, moved: Term, by: float) -> ComplexArray:
    omega = at.response.omega
    push = np.zeros((len(omega), at.view.m), dtype=complex)
    for row in term.place.rows:
        there = at.solved.motion @ row
        if is_level_dependent(term):
            e = next(i for i, element in enumerate(at.elements) if np.array_equal(element.row, row))
            size = np.maximum(at.excitation.size(at.motion[:, e]), 1e-300)
            motion_omega = at.excitation.frequency(at.motion[:, e])
            parts = [
                Element(row=row, terms=(t,)).stiffness(size, motion_omega, omega, at.excitation.is_random).value
                for t in (term, moved)
            ]
        else:
            parts = [at_port(t, t.values, float(omega[-1])).impedance(1j * omega) for t in (term, moved)]
        push += ((parts[1] - parts[0]) / by * there)[:, None] * row
    return at.pushed(push)


def _by_channel(at: OperatingPoint, terms: Sequence[Term], by: float) -> ComplexArray:
    j = at.wires.inputs.index(at.response.input)
    chain = chain_of(at.view, at.state, at.response, at.wires, terms)
    actuator = source_gain([t for t in terms if is_level_dependent(t)], at.wires.actuators[j], at.excitation).value
    chain = Chain(mix=chain.mix, beside=chain.beside, source=chain.source * actuator, gain=chain.gain)
    change = (chain.recorded(at.solved.H) - at.chain.recorded(at.solved.H)) / at.chain.gain / by
    ratio = chain.source / np.where(at.chain.source == 0, 1.0, at.chain.source) - 1.0
    return at.follows(change, at.motion * (ratio / by)[:, None])
