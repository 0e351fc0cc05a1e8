"""Score test of every effect at every location, on Kalman innovations.

The innovations of the nominal model are white where nothing is missing. A missing force leaves its response through the
observer, which forgets quickly even where the structure rings for minutes. No phase drifts, and free decays serve as
well as driven records. Every law is evaluated along the smoothed motion, and linear regression gives its amplitude next
to the uncertain parameters with their priors. The score test (Rao 1948) gives a log-likelihood gain for each effect and
location.

References
----------
C. R. Rao, Large sample tests of statistical hypotheses concerning several parameters, Proc. Camb. Phil. Soc. 44 (1948)
50-57.
"""

import copy
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.innovation_regression import (
    EffectColumns,
    Regression,
    candidates_of,
    joint_estimate,
)
from vlab.diagnose.inference.nuisance_columns import columns_of_changes, columns_of_offsets, modal_forces_of_changes
from vlab.diagnose.inference.port_forces import PortForces
from vlab.diagnose.inference.reference_scales import reference_quantity
from vlab.diagnose.inference.residual_tones import (
    Tones,
    response_to_unit_force,
    spectra_of_residual,
    strongest_tones,
)
from vlab.diagnose.inference.screening_cache import ScreeningCache
from vlab.diagnose.inference.trial_shapes import Shape, TrialShapes
from vlab.diagnose.parameters.locations import Place, admissible, at_place
from vlab.diagnose.parameters.terms import Candidate, Term
from vlab.diagnose.predictors.filtered_runs import filter_runs
from vlab.diagnose.predictors.innovations import Cause, Group, carried, convolved
from vlab.diagnose.predictors.kalman import stack_runs
from vlab.diagnose.predictors.unit_causes import subtract_own_innovations, unit_causes
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import SCORE_TEST
from vlab.parallel import side_by_side
from vlab.physics.effect import Effect, PickUp
from vlab.physics.rest_position import has_rest_position
from vlab.signals import Array


class ScoreTest:
    """Screening of a problem's fit runs.

    Parameters
    ----------
    problem : Problem
        Problem.
    signals : sequence of Signals or None
        Runs; the fit runs of the problem by default.
    trust : float
        Factor on the unknown-force intensity; below 1 the filter forgets more slowly.
    like : ScoreTest or None
        Screening whose uncertain parameters and intensities are taken over.
    theta : (n_changes,) array or None
        Initial log factors of the uncertain parameters.
    """

    keeps_plans: ClassVar[bool] = False
    """Whether the columns of all locations are cached, which needs a single process."""
    slower: "tuple[ScoreTest, ...]" = ()
    """Screenings by slower observers."""
    theta: Array
    """Log factors of the uncertain parameters in the filters."""
    estimate: tuple[Array, list[dict[str, float]]]
    """Joint estimate of uncertain parameters and candidates, set by `given`."""
    cautious: tuple[Array, list[dict[str, float]]]
    """Joint estimate at a small effective sample size, with stronger priors."""
    regression: Regression
    """Regression of the innovations on uncertain parameters, offsets and effects taken as present."""

    def __init__(
        self,
        problem: Problem,
        signals: Sequence[Signals] | None = None,
        *,
        trust: float = 1.0,
        like: "ScoreTest | None" = None,
        theta: Array | None = None,
    ) -> None:
        self.problem, self.reduced_model, self.trust = problem, problem.reduced_model, trust
        self._intensity: dict[float, float] = dict(problem.intensity if like is None else like._intensity)
        self.runs = self._shortened(list(signals if signals is not None else problem.in_role("fit")))
        self._cache = ScreeningCache()
        start = self.reduced_model.start if like is None else like.theta
        self.theta = start if theta is None else theta
        for _ in range(SCORE_TEST.refits if like is None else 1):
            self._linearise()
            step = self._step
            if np.all(np.abs(step) <= SCORE_TEST.settled[0] * self.reduced_model.prior + SCORE_TEST.settled[1]):
                break
            self.theta = np.clip(self.theta + step, -SCORE_TEST.most_theta, SCORE_TEST.most_theta)
        else:
            self._linearise()

    def _shortened(self, runs: list[Signals]) -> list[Signals]:
        """Return the first parts of runs within `SCORE_TEST.most_rows` values."""
        most = SCORE_TEST.most_rows // (len(runs) * len(self.reduced_model.rows.at_q))
        return [run if len(run) <= most else run.first(most) for run in runs]

    def _linearise(self) -> None:
        """Filter all runs at the current parameters and regress the innovations."""
        periods = sorted({run.h for run in self.runs})
        M, C, K, _, self.sensor_gain = (part[0] for part in self.reduced_model.matrices(self.theta[None]))
        forces, rows = self.reduced_model.forces_at(self.theta[None])[0], self.reduced_model.rows_at(self.theta)
        efforts = self.reduced_model.efforts
        read = None if efforts is None else efforts.more_per_command(self.theta[None])[0]
        self.now = replace(self.reduced_model, M=M, C=C, K=K, forces=forces, rows=rows, read_commands=read)
        self.groups = [self._group([run for run in self.runs if run.h == h]) for h in periods]
        e = np.concatenate([g.rows(g.e[..., None])[:, 0] for g in self.groups])
        changes = columns_of_changes(
            self.reduced_model, self.groups, self.changed_forces, self.changed_readings, self.through
        )
        nuisance = np.hstack([changes, columns_of_offsets(self.groups, self.through)])
        precision = np.concatenate([1.0 / np.maximum(self.reduced_model.prior, 1e-9) ** 2, 1.0 / self.offset_sd**2])
        present = np.concatenate([self.theta, np.zeros(len(self.offset_sd))])
        plain = Regression.of(e, nuisance, precision, precision * present, np.linalg.inv)
        self.regression = self._plain = plain.beside([self.columns_of(term) for term in self.problem.known])
        self._step = self.regression.cautious()[: len(self.theta)]

    def given(self, candidates: Sequence[Candidate]) -> "ScoreTest":
        """Return the screening with free amplitudes of some candidates.

        Parameters
        ----------
        candidates : sequence of Candidate
            Candidates taken as present.

        Returns
        -------
        ScoreTest
            Conditional screening.
        """
        other = copy.copy(self)
        other._cache = self._cache.for_other_residual()
        other.regression = self._plain.beside([self.columns_of(candidate) for candidate in candidates])
        offsets = self._plain.nuisance.shape[1] - len(self.theta)  # with the effects of the case's model
        other.estimate = joint_estimate(self.theta, offsets, candidates, other.regression.solution)
        other.cautious = joint_estimate(self.theta, offsets, candidates, other.regression.cautious())
        return other

    def forget(self) -> None:
        """Drop the caches of the candidates."""
        self._cache.series.clear()
        if not self.keeps_plans:
            self._cache.columns.clear()

    def columns_of(self, candidate: Term) -> Array:
        """Return the whitened columns (rows, k) of a candidate's amplitudes.

        Parameters
        ----------
        candidate : Term
            Candidate.

        Returns
        -------
        (rows, k) array
            Columns.
        """
        plans = [(candidate.effect, self._plan_of(candidate))]
        known = self._cache.columns.get(candidate.place.name)
        columns = None if known is None else known.of(*plans[0])
        if columns is not None:
            return columns
        return np.concatenate([g.rows(self.effect_responses(g, candidate.place, plans)[0]) for g in self.groups])

    def _plan_of(self, term: Term) -> Shape:
        """Return the values on which a term's columns depend."""
        return {p.name: term.values[p.name] for p in term.effect.shapes}

    def _group(self, runs: list[Signals]) -> Group:
        """Return runs of one sample period, filtered."""
        h = runs[0].h
        group, intensity = filter_runs(runs, self.now, self.sensor_gain, self._intensity.get(h, 0.0), self.trust)
        if self.trust == 1.0:
            self._intensity[h] = intensity
        return group

    # ---- innovations' response to signals ---------------------------------------------------------------------------

    def through(self, group: Group, modal: Array | None, reading: Array | None) -> Array:
        """Return the innovations' response to forces and channel additions.

        Parameters
        ----------
        group : Group
            Filtered runs.
        modal : (n, n_runs, m, k) array or None
            Modal forces.
        reading : (n, n_runs, p, k) array or None
            Additions to the channels.

        Returns
        -------
        (n, n_runs, p, k) array
            Innovations.
        """
        parts = []
        if modal is not None:
            parts.append(convolved(group.impulses[:, :, : self.reduced_model.m], modal.astype(np.float32)))
        if reading is not None:
            parts.append(convolved(group.impulses[:, :, self.reduced_model.m :], reading.astype(np.float32)))
        return np.asarray(sum(parts))

    def changed_forces(self, group: Group) -> Array:
        """Return the forces of unit uncertain parameters.

        A model class with other dynamics overrides the method.

        Parameters
        ----------
        group : Group
            Filtered runs.

        Returns
        -------
        (n, n_runs, m, n_changes) array
            Modal forces.
        """
        return modal_forces_of_changes(group, self.reduced_model, self.now.forces, self.theta)

    def changed_readings(self, group: Group) -> Array:
        """Return readings (n, n_runs, p, n_changes) of actuators' unit parameters."""
        if self.reduced_model.efforts is None:
            return np.zeros((*group.y.shape, len(self.reduced_model.changes)))
        seen = stack_runs(group.runs, [run.seen for run in group.runs])[0]
        return self.reduced_model.efforts.slopes(self.theta, group.smoothed.x, seen)

    @property
    def offset_sd(self) -> Array:
        """Prior standard deviations (n_channels,) of the sensor offsets."""
        share = np.array([SCORE_TEST.offset_sd[order] for order in self.problem.orders])
        return np.asarray(share * np.max([run.scale for run in self.runs], axis=0))

    def input_difference(self, group: Group, runs: Sequence[Signals]) -> Array:
        """Return the change of forces under other inputs.

        A model class with other dynamics overrides the method.

        Parameters
        ----------
        group : Group
            Filtered runs.
        runs : sequence of Signals
            The same runs with other inputs.

        Returns
        -------
        (n, n_runs, m) array
            Difference of the modal forces.
        """
        u, _ = stack_runs(runs, [run.u for run in runs])
        load, _ = stack_runs(runs, [run.load for run in runs])
        return np.asarray(u @ self.now.forces.T + load @ self.now.loads.T - group.forces)

    # ---- the candidates ---------------------------------------------------------------------------------------------

    def candidates(self, effects: Sequence[Effect], among: Collection[str] | None = None) -> list[Candidate]:
        """Return every effect at every admissible location, best first.

        Parameters
        ----------
        effects : sequence of Effect
            Effects.
        among : collection of str or None
            Labels of the candidates to test; all by default.

        Returns
        -------
        list of Candidate
            Candidates by log-likelihood gain.
        """

        def at(places: Sequence[Place]) -> list[Candidate]:
            out: list[Candidate] = []
            for place in places:
                turns = self._turns(place)
                mine = [
                    at_place(effect, place)
                    for effect in effects
                    if admissible(effect, place)
                    and (among is None or f"{effect.name}@{place.name}" in among)
                    and not (turns and has_rest_position(effect))
                ]
                out += self._at(place, mine) if mine else []
            return out

        places = self.problem.places
        if self.keeps_plans:
            found = [at([place]) for place in places]
        else:
            found = side_by_side(at, [places[i :: SCORE_TEST.shares] for i in range(SCORE_TEST.shares)])
        return sorted((c for part in found for c in part), key=lambda c: (-c.log_likelihood_gain, c.label))

    def _turns(self, place: Place) -> bool:
        """Return whether a free location turns by more than a revolution."""
        is_shaft = place.kind == "port" and place.angular and len(place.rows) == 1
        if not is_shaft or place.is_held or place.stiffness > 0.0:
            return False
        return any(np.any(np.ptp(self.motion(group, place)[0], axis=0) > 2.0 * np.pi) for group in self.groups)

    def _columns(self, place: Place, plans: list[tuple[Effect, Shape]]) -> EffectColumns:
        """Return the columns of effects with given shapes at a location."""
        parts: list[Array] = []
        widths: list[int] = []
        for group in self.groups:
            left, widths = self.effect_responses(group, place, plans)
            parts.append(group.rows(left))
        return EffectColumns(plans, widths, np.concatenate(parts).astype(np.float32))

    def effect_responses(
        self, group: Group, place: Place, plans: Sequence[tuple[Effect, Shape]]
    ) -> tuple[Array, list[int]]:
        """Return the innovations' response to effects of unit amplitudes.

        A model class with other dynamics overrides the method.

        Parameters
        ----------
        group : Group
            Filtered runs.
        place : Place
            Location.
        plans : sequence of (Effect, dict)
            Effects with the values of their shape parameters.

        Returns
        -------
        response : (n, n_runs, p, sum of widths) array
            Innovations.
        widths : list of int
            Columns of every effect.
        """
        forces, series = self.now.forces, self._port_forces.along
        causes = [unit_causes(effect, shape, group, place, forces, series) for effect, shape in plans]
        left, widths = self.cause_responses(group, causes)
        start = 0
        for (effect, shape), width in zip(plans, widths, strict=True):
            if isinstance(effect, PickUp):
                subtract_own_innovations(left[..., start : start + width], effect, shape, group, place)
            start += width
        return left, widths

    def cause_responses(self, group: Group, causes: Sequence[Sequence[Cause]]) -> tuple[Array, list[int]]:
        """See `carried`; a model class with other dynamics overrides the method."""
        return carried(group, causes)

    def _at(self, place: Place, effects: Sequence[Effect]) -> list[Candidate]:
        """Return the best shape of every effect at a location."""
        columns, trials = self._cache.columns, self._trial_shapes
        if place.name not in columns:
            plans = [(effect, shape) for effect in effects for shape in trials.of(effect, place)]
            columns[place.name] = self._columns(place, plans)
        best: dict[str, Candidate] = {}
        for candidate in self._regressed(place, columns[place.name]):
            name = candidate.effect.name
            if name not in best or candidate.log_likelihood_gain > best[name].log_likelihood_gain:
                best[name] = candidate
        return list(best.values())

    def zoomed(self, candidate: Candidate) -> Candidate:
        """Return a candidate with its shape refined between grid values.

        A nonsmooth law has useful derivatives only near the correct shape, so a fit between coarse grid values fails.

        Parameters
        ----------
        candidate : Candidate
            Candidate.

        Returns
        -------
        Candidate
            Refined candidate.
        """
        best = candidate
        shapes = [p for p in candidate.effect.shapes if p.name != "frequency"]  # frequencies come from the recordings
        has_state = candidate.effect.has_state
        # laws with a state are smooth in their shapes, and slow to evaluate
        widths = SCORE_TEST.zoom[: SCORE_TEST.coarse_zoom] if has_state else SCORE_TEST.zoom
        for width in widths if shapes else ():
            values = self._plan_of(best)
            tried = [
                (candidate.effect, {**values, p.name: values[p.name] * f}) for p in shapes for f in (width, 1 / width)
            ]
            found = self._regressed(candidate.place, self._columns(candidate.place, tried))
            other = max(found, key=lambda c: c.log_likelihood_gain)
            best = other if other.log_likelihood_gain > best.log_likelihood_gain + SCORE_TEST.no_gain else best
        return best

    def _regressed(self, place: Place, columns: EffectColumns) -> list[Candidate]:
        """Return the candidates of columns with amplitudes and gains."""
        channels = len(self.reduced_model.rows.at_q)
        return candidates_of(columns, place, self.regression, self.groups[0].h, channels)

    def motion(self, group: Group, place: Place) -> tuple[Array, Array]:
        """Return port displacement and velocity (n, n_runs) at mid-step."""
        if place.name not in group.at_places:
            row = place.rows[0]
            group.at_places[place.name] = (group.motion[0] @ row, group.motion[1] @ row)
        return group.at_places[place.name]

    def reference(self, name: str, place: Place) -> float:
        """Return the reference quantity of a relative parameter range.

        Parameters
        ----------
        name : str
            Name of the quantity.
        place : Place
            Location.

        Returns
        -------
        float
            Quantity [SI].
        """
        return reference_quantity(name, place, self.groups, self.motion)

    def tones(self, place: Place) -> Tones:
        """Return the frequencies of the strongest tones in the residual.

        A force of one frequency stands out of its neighbours; a resonance need not.

        Parameters
        ----------
        place : Place
            Port of the force.

        Returns
        -------
        tuple of (float, bool)
            Frequency [Hz], and whether the tone stands out.
        """
        cache = self._cache
        if place.name not in cache.tones:
            if cache.spectra is None:
                cache.spectra = spectra_of_residual(self.groups, self.regression.base)
            answer = self.force_response(cache.spectra.group, place, cache.spectra.frequency)
            cache.tones[place.name] = strongest_tones(cache.spectra, answer)
        return cache.tones[place.name]

    def force_response(self, group: Group, place: Place, frequency: Array) -> Any:
        """Return the whitened innovations of a unit force by frequency.

        A model class with other dynamics overrides the method.

        Parameters
        ----------
        group : Group
            Filtered runs.
        place : Place
            Port of the force.
        frequency : (nf,) array
            Frequencies [Hz].

        Returns
        -------
        (nf, p) complex array
            Innovations.
        """
        return response_to_unit_force(group, place.rows[0], frequency)

    @property
    def _trial_shapes(self) -> TrialShapes:
        """Trial shapes of effects at the locations."""

        def gains(place: Place, effect: Effect, shapes: Sequence[Shape]) -> list[float]:
            columns = self._columns(place, [(effect, shape) for shape in shapes])
            return [c.log_likelihood_gain for c in self._regressed(place, columns)]

        return TrialShapes(
            groups=self.groups,
            runs=self.runs,
            highest_hz=self.problem.highest_hz,
            motion=self.motion,
            tones=self.tones,
            gains=gains,
            scans=self._cache.scans,
        )

    @property
    def _port_forces(self) -> PortForces:
        """Forces of laws along the filtered motion."""
        return PortForces(
            places=self.problem.places, motion=self.motion, shapes=self._trial_shapes.of, kept=self._cache.series
        )
