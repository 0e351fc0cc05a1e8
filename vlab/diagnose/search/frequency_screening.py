"""Score test of effects and locations in frequency.

The structure is solved once at a fitted state, with unit loads at all locations. A port force changes all responses by
a low-rank update (Sherman-Morrison-Woodbury). Uncertain parameters are refitted to first order.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.diagnose.data.responses import Modes, Response
from vlab.diagnose.inference.frequency_least_squares import Fitter, Point
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.frequency import (
    Answer,
    Chain,
    State,
    at_port,
    chain_of,
    dynamic,
    is_level_dependent,
    is_port,
    output_rows,
)
from vlab.diagnose.predictors.frequency_model import View
from vlab.diagnose.predictors.frequency_residual import modal_residual, quick_modal_residual, response_residual
from vlab.diagnose.predictors.level_answer import operating_point, sensor_gains
from vlab.diagnose.predictors.level_modes import acts_in_table
from vlab.diagnose.predictors.level_response import Element, source_gain
from vlab.diagnose.search.level_trials import LevelMotion, Levels, level_trials
from vlab.diagnose.search.trial_values import trials
from vlab.diagnose.settings import FREQUENCY_SCREENING
from vlab.parallel import side_by_side
from vlab.physics.effect import Effect
from vlab.physics.small_signal import is_linear
from vlab.signals import Array, ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """Best trial of one effect at one location.

    Parameters
    ----------
    term : Term
        Effect with the best values.
    log_likelihood_gain : float
        Decrease of the cost with a first-order refit.
    others : tuple of Term
        Next best distant trials, as further starts.
    theta : (n_parameters,) array or None
        Log factors about which the trial was made.
    """

    term: Term
    log_likelihood_gain: float
    others: tuple[Term, ...] = ()
    theta: Array | None = None

    @property
    def label(self) -> str:
        """Effect and location in one string."""
        return self.term.label


class _Lines:
    """Response at a state, solved with unit loads at all locations."""

    def __init__(self, view: View, state: State, data: Response, fitter: Fitter, point: Point) -> None:
        self.view, self.state, self.data, self.fitter = view, state, data, fitter
        self.terms = [*view.fixed, *point.terms]
        problem = fitter.problem
        omega = data.omega
        whole = dynamic(state, omega, self.terms)
        self.chain: Chain = chain_of(view, state, data, problem.wires, self.terms)
        self.sensing: ComplexArray | float = 1.0
        if data.level is not None and any(is_level_dependent(t) for t in self.terms):
            at = operating_point(view, state, data, problem.wires, self.terms)
            for e, element in enumerate(at.elements):
                whole = whole + at.stiffness[:, e, None, None] * np.outer(element.row, element.row)
            self.chain, self.sensing = at.chain, at.sensor_gain()[0]
        self.inverse = np.linalg.inv(whole)
        rows = output_rows(view.rows, view.orders, data.order, omega)
        j = problem.wires.inputs.index(data.input)
        self.motion = self.inverse @ view.forces[:, view.columns[j]]  # (n, m)
        self.reading = np.einsum("nom,nmk->nok", rows, self.inverse)  # (n, n_outputs, m)
        self.H = np.einsum("nom,nm->no", rows, self.motion)
        self.own = [problem.names.index(o) for o in data.outputs]

    def at(self, place: Place) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return the transfer of loads at a location.

        The result holds outputs (n, o, k), motion (n, k) and compliance (n, k, k).
        """
        rows = place.rows
        return self.reading @ rows.T, self.motion @ rows.T, rows @ self.inverse @ rows.T

    def with_port(self, z: ComplexArray, seen: tuple[ComplexArray, ComplexArray, ComplexArray]) -> Answer:
        """Return the response with an impedance (n,) at a location."""
        reading, there, own = seen
        k = own.shape[1]
        if k == 1:
            held = (z / (1 + z * own[:, 0, 0]))[:, None] * there
        else:
            held = np.linalg.solve(np.eye(k) + z[:, None, None] * own, (z[:, None] * there)[..., None])[..., 0]
        H = self.H - np.einsum("nok,nk->no", reading, held)
        return self._recorded(self.chain, H)

    def _recorded(self, chain: Chain, H: ComplexArray) -> Answer:
        return Answer(H=(chain.recorded(H) * self.sensing)[:, self.own])

    def with_channel(self, term: Term) -> Answer:
        """Return the response with an actuator or sensor effect."""
        wires = self.fitter.problem.wires
        linear = chain_of(self.view, self.state, self.data, wires, self.terms)
        chain = chain_of(self.view, self.state, self.data, wires, [*self.terms, term])
        return self._recorded(replace(chain, source=chain.source * self.chain.source / linear.source), self.H)

    def with_law(
        self, term: Term, motion: LevelMotion, seen: tuple[ComplexArray, ComplexArray, ComplexArray] | None
    ) -> Answer:
        """Return the response with a nonlinear effect in a known motion."""
        excitation = motion.excitation
        assert excitation is not None
        if seen is not None:
            row = term.place.rows[0]
            element = Element(row=row, terms=(term,))
            size, omega = motion.amplitude(row), motion.omega(row)
            return self.with_port(element.stiffness(size, omega, excitation.omega, excitation.is_random).value, seen)
        j = self.fitter.problem.wires.inputs.index(self.data.input)
        if term.effect.kind == "actuator":
            gain = source_gain([term], self.fitter.problem.wires.actuators[j], excitation).value
            return self._recorded(replace(self.chain, source=self.chain.source * gain), self.H)
        orders = self.fitter.problem.wires.orders
        gain = sensor_gains([term], motion.outputs, orders, self.data.order, excitation)[0]
        found = self.chain.recorded(self.H) * self.sensing * gain
        return Answer(H=found[:, self.own])


class ScoreTest:
    """Trials about a fitted hypothesis.

    Parameters
    ----------
    fitter : Fitter
        Data and problem.
    point : Point
        Parameters of the hypothesis.
    bands : float
        Relative bandwidth of the coarse residual; 0 for single lines.
    levels : Levels or None
        Motion at several levels, for nonlinear effects.
    start : float or None
        Cost from which gains count; that of the hypothesis by default.
    """

    def __init__(
        self,
        fitter: Fitter,
        point: Point,
        bands: float = 0.0,
        *,
        levels: Levels | None = None,
        start: float | None = None,
    ) -> None:
        self.fitter, self.point, self.bands, self.levels = fitter, point, bands, levels
        problem = fitter.problem
        self.state = problem.state(point.theta)
        self.lines = [
            _Lines(problem.view, self.state, d, fitter, point) if isinstance(d, Response) else None
            for d in fitter.measured
        ]
        parts = fitter.differences(point, bands=bands, with_derivatives=True)
        prior = point.theta / fitter.sd
        self.e = np.concatenate([*(r.e for r in parts), prior])
        jacobian = np.vstack([*(r.by_theta * fitter.sd for r in parts), np.eye(len(prior))])
        self.prior = prior
        self.q = np.linalg.qr(jacobian)[0]
        self.cost = self._left(self.e)
        self.start = self.cost if start is None else start
        high = max(d.freq[-1] for d in fitter.measured)
        self.fastest = 2 * np.pi * float(high)
        self.small = self._reduced()

    def _reduced(self) -> tuple[View, State] | None:
        """Return the model truncated some modes above the tables."""
        tables = [d for d in self.fitter.measured if isinstance(d, Modes)]
        if not tables:
            return None
        view, state = self.fitter.problem.view, self.state
        keep = max(d.n for d in tables) + FREQUENCY_SCREENING.modes_tried
        if keep >= view.m:
            return view, state
        return cut(view, keep), State(
            M=state.M[:keep, :keep],
            C=state.C[:keep, :keep],
            K=state.K[:keep, :keep],
            input_gain=state.input_gain,
            output_gain=state.output_gain,
        )

    def _left(self, e: Array) -> float:
        inside = self.q.T @ e
        return float(e @ e - inside @ inside)

    def best(self, effect: Effect, place: Place) -> Trial | None:
        """Return the best finite trial of an effect at a location.

        Parameters
        ----------
        effect : Effect
            Effect.
        place : Place
            Location.

        Returns
        -------
        Trial or None
            Best trial.
        """
        found = []
        seen = [None if lines is None or not len(place.rows) else lines.at(place) for lines in self.lines]
        problem = self.fitter.problem
        is_nonlinear = not is_linear(effect)
        if is_nonlinear:
            assert self.levels is not None
            listed = level_trials(problem, self.levels, effect, place)
        else:
            listed = trials(problem, effect, place)
        for term in listed:
            with np.errstate(all="ignore"):
                log_likelihood_gain = self.start - self._left(self._with(term, seen))
            if np.isfinite(log_likelihood_gain):
                found.append((log_likelihood_gain, term))
        if not found:
            return None
        found.sort(key=lambda pair: -pair[0])
        first = found[0][1]
        others = [term for _, term in found[1:] if _apart(term, first)]
        theta = self.point.theta if is_nonlinear else None
        return Trial(term=first, log_likelihood_gain=found[0][0], others=tuple(others[:1]), theta=theta)

    def _with(self, term: Term, seen: Sequence[tuple[ComplexArray, ComplexArray, ComplexArray] | None]) -> Array:
        parts = []
        motions = [None] * len(self.lines) if self.levels is None else self.levels.motions
        for data, lines, there, motion in zip(self.fitter.measured, self.lines, seen, motions, strict=True):
            if isinstance(data, Modes):
                assert self.small is not None
                view, state = self.small
                own = [_cut_term(t, view.m) for t in (*self.point.terms, term)]
                if acts_in_table(view, data, own) or any(
                    t.effect.is_force for t in (*view.fixed, *own)
                ):  # forces with memory
                    parts.append(modal_residual(view, state, data, own).e)
                else:
                    parts.append(quick_modal_residual(view, state, data, own))
                continue
            assert lines is not None
            if is_level_dependent(term):
                assert motion is not None
                found = lines.with_law(term, motion, there)
            elif is_port(term):
                assert there is not None
                z = at_port(term, term.values, self.fastest).impedance(1j * data.omega)
                found = lines.with_port(z, there)
            else:
                found = lines.with_channel(term)
            parts.append(response_residual(data, found, self.bands).e)
        return np.concatenate([*parts, self.prior])


def cut(view: View, keep: int) -> View:
    """Return a view truncated to its lowest modes.

    Parameters
    ----------
    view : View
        Linearised plant.
    keep : int
        Number of modes.

    Returns
    -------
    View
        Truncated plant.
    """
    rows = replace(
        view.rows, at_q=view.rows.at_q[:, :keep], at_v=view.rows.at_v[:, :keep], at_a=view.rows.at_a[:, :keep]
    )
    return replace(
        view,
        omega=view.omega[:keep],
        shapes=view.shapes[:, :keep],
        M=view.M[:keep, :keep],
        C=view.C[:keep, :keep],
        K=view.K[:keep, :keep],
        forces=view.forces[:keep],
        rows=rows,
        at={name: row[:keep] for name, row in view.at.items()},
        fixed=tuple(_cut_term(t, keep) for t in view.fixed),
    )


def _cut_term(term: Term, keep: int) -> Term:
    if not is_port(term):
        return term
    return Term(effect=term.effect, place=replace(term.place, rows=term.place.rows[:, :keep]), values=term.values)


def _apart(a: Term, b: Term) -> bool:
    """Return whether trials differ by sign or factor four."""
    for p in a.effect.parameters:
        x, y = float(a.values[p.name]), float(b.values[p.name])
        if x * y < 0 or abs(np.log(abs(x) / abs(y))) > np.log(4.0):
            return True
    return False


def screened(screen: ScoreTest, pairs: Sequence[tuple[Effect, Place]]) -> list[Trial]:
    """Return the best trial of every effect and location, best first."""
    shares = [list(pairs[k :: FREQUENCY_SCREENING.shares]) for k in range(FREQUENCY_SCREENING.shares)]
    found = side_by_side(lambda share: [screen.best(effect, place) for effect, place in share], shares)
    return sorted((t for part in found for t in part if t is not None), key=lambda t: -t.log_likelihood_gain)
