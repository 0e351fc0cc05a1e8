"""Trial values of shape parameters at a location."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.inference.reference_scales import Motion, reference_quantity
from vlab.diagnose.inference.residual_tones import Tones
from vlab.diagnose.inference.trial_scan import Scales, best_values, between_values, scan_values
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.predictors.innovations import Group
from vlab.diagnose.predictors.unit_causes import Shape
from vlab.physics.effect import Effect, Parameter


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialShapes:
    """Trial shapes of effects for a screening.

    Parameters
    ----------
    groups : sequence of Group
        Filtered runs.
    runs : sequence of Signals
        The same runs, unfiltered.
    highest_hz : float
        Frequency below which nearly all recorded power lies [Hz].
    motion : callable
        Displacement and velocity at a port.
    tones : callable
        Strongest tones of the residual at a port.
    gains : callable
        Log-likelihood gains of an effect's shapes at a location.
    scans : dict
        Best values of scanned parameters, by effect, parameter and location; extended by every scan.
    """

    groups: Sequence[Group]
    runs: Sequence[Signals]
    highest_hz: float
    motion: Motion
    tones: Callable[[Place], Tones]
    gains: Callable[[Place, Effect, Sequence[Shape]], list[float]]
    scans: dict[tuple[str, str, str], list[float]]

    def reference(self, name: str, place: Place) -> float:
        """Return the reference quantity of a relative range [SI]."""
        return reference_quantity(name, place, self.groups, self.motion)

    def of(self, effect: Effect, place: Place) -> list[Shape]:
        """Return the trial shapes of an effect.

        Parameters
        ----------
        effect : Effect
            Effect.
        place : Place
            Location.

        Returns
        -------
        list of dict
            All combinations of the parameters' trial values; one empty shape without shape parameters.
        """
        if not effect.shapes:
            return [{}]
        grids = [self._grid(effect, p, place) for p in effect.shapes]
        return [dict(zip((p.name for p in effect.shapes), values, strict=True)) for values in product(*grids)]

    def _grid(self, effect: Effect, parameter: Parameter, place: Place) -> list[float]:
        """Return the trial values of a shape parameter, with tones for frequencies."""
        values = [g * self.reference(parameter.reference, place) for g in parameter.grid]
        if effect.is_force and parameter.name == "frequency":
            values += [hz for hz, stands_out in self.tones(place) if stands_out or effect.response != "none"]
        is_scanned = parameter.scan not in ("", "resonance")  # whole recordings show resonances
        return values + (self._scanned(effect, parameter, place) if is_scanned else [])

    def _scanned(self, effect: Effect, parameter: Parameter, place: Place) -> list[float]:
        """Return the best values of a parameter over its whole range."""
        key = (effect.name, parameter.name, place.name)
        if key not in self.scans:
            others = {p.name: p.grid[0] * self.reference(p.reference, place) for p in effect.shapes}

            def gains(values: Sequence[float]) -> list[float]:
                return self.gains(place, effect, [{**others, parameter.name: value} for value in values])

            scales = self._scales(place)
            coarse = best_values(scan_values(parameter, scales), gains)
            finer = between_values(parameter, coarse, scales)
            self.scans[key] = best_values(finer, gains) if finer.size else coarse
        return self.scans[key]

    def _scales(self, place: Place) -> Scales:
        """Return the scales of the recordings at a location."""
        own = list(place.indices) if place.kind == "actuator" else []
        return Scales(
            step=max(g.h for g in self.groups),
            duration=self.reference("duration", place),
            highest_hz=self.highest_hz,
            span=max((float(np.ptp(run.u[:, own], axis=0).max()) for run in self.runs), default=0.0) if own else 0.0,
            steepest=self.reference("input-slope", place) if own else 0.0,
            largest=self.reference("input", place) if own else 0.0,
            travel=self.reference("travel", place) if place.kind == "port" else 0.0,
        )
