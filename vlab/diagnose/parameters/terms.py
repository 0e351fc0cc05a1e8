"""Hypothesis terms, candidates and fits, as plain data."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.settings import TERMS
from vlab.physics.attach import Attached, attach
from vlab.physics.effect import Effect, Parameter
from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Term:
    """Effect at a location with starting values.

    Parameters
    ----------
    effect : Effect
        Effect.
    place : Place
        Location.
    values : mapping of str to float
        Parameter values [SI].
    """

    effect: Effect
    place: Place
    values: Mapping[str, float]

    @property
    def label(self) -> str:
        """Effect and location in one string."""
        return f"{self.effect.name}@{self.place.name}"


def of_element(term: Term) -> Term:
    """Return a term with values from the local elastic element."""
    values = term.effect.of_element(term.values, term.place.stiffness)
    return term if values is None else replace(term, values=values)


def attached(terms: Sequence[Term]) -> list[Attached]:
    """Return the effects of terms at their locations."""
    return [Attached(effect=t.effect, place=t.place.name, values=dict(t.values)) for t in terms]


def with_effects(plant: Plant, terms: Sequence[Term], channels: Sequence[str]) -> Plant:
    """Return a plant with the effects of terms, for its named channels."""
    return attach(plant, attached(terms), channels=channels) if terms else plant


def is_meant(terms: Sequence[Term]) -> bool:
    """Return whether all laws have values within their description."""
    return all(t.effect.is_meant(t.values, t.place.stiffness) for t in terms)


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate(Term):
    """Term with the best shape of the screening.

    Parameters
    ----------
    log_likelihood_gain : float
        Log-likelihood gain of the regression at the best shape and amplitude [nat].
    """

    log_likelihood_gain: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Fitted hypothesis.

    Parameters
    ----------
    terms : tuple of Term
        Terms with fitted values.
    theta : (n_changes,) array
        Log factors of the uncertain parameters.
    offsets : (n_channels,) array
        Sensor offsets [SI].
    starts : mapping of str to (2m,) array
        Initial modal state of every run without rest at the start.
    error : (n_runs, n_channels) array
        Rms residual over the channel's rms, runs in the order of the fit.
    chi2 : float
        Weighted sum of squares with priors.
    cost : float
        Weighted sum of squares without priors.
    sd : mapping of str to float
        Standard deviation of every effect parameter (of the log where unsigned), by ``"label:name"``.
    departure : float
        Squared deviations of the uncertain parameters over prior variance and sampling variance together.
    information : (k,) array
        Shares of the prior variance that the recordings remove, along principal directions of the entries with a prior.
    """

    terms: tuple[Term, ...]
    theta: Array
    offsets: Array
    starts: dict[str, Array]
    error: Array
    chi2: float
    cost: float
    sd: dict[str, float] = field(default_factory=dict)
    departure: float = 0.0
    information: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def prior_cost(self) -> float:
        """Sum of squared deviations from the priors over their variances."""
        return self.chi2 - self.cost

    @property
    def unidentified(self) -> tuple[str, ...]:
        """Labels of terms whose amplitudes are all indistinguishable from zero."""
        return tuple(t.label for t in self.terms if all(self._may_be_none(t, p) for p in _sizes(t.effect)))

    def nested_model(self, effects: Sequence[Effect]) -> tuple[Term, ...]:
        """Return the terms with nested laws for vanishing amplitudes."""
        return tuple(self._nested_model(term, effects) for term in self.terms)

    def nested(self, effects: Sequence[Effect]) -> list[tuple[Term, ...]]:
        """Return the hypotheses with one nested law, simplest first.

        A nested law has some of the parameters of its family member. An example is dry friction without stiction.

        Parameters
        ----------
        effects : sequence of Effect
            Available laws.

        Returns
        -------
        list of tuple of Term
            Nested hypotheses.
        """
        out = []
        for i, term in enumerate(self.terms):
            own = {(p.name, p.unit) for p in term.effect.parameters}
            lesser = [
                effect
                for effect in effects
                if effect.family == term.effect.family
                and effect.kind == term.effect.kind
                and {(p.name, p.unit) for p in effect.parameters} < own
            ]
            for effect in sorted(lesser, key=lambda e: len(e.parameters)):
                values = {p.name: term.values[p.name] for p in effect.parameters}
                out.append((*self.terms[:i], replace(term, effect=effect, values=values), *self.terms[i + 1 :]))
        return out

    def _nested_model(self, term: Term, effects: Sequence[Effect]) -> Term:
        nothing = {p.name for p in term.effect.amplitudes if self._is_nothing(term, p)}
        if not nothing or len(nothing) == len(term.effect.amplitudes):
            return term
        left = {p.name for p in term.effect.parameters} - nothing
        lesser = [
            e
            for e in effects
            if e.family == term.effect.family and e.kind == term.effect.kind and {p.name for p in e.parameters} <= left
        ]
        if not lesser:
            return term
        effect = max(lesser, key=lambda e: len(e.parameters))
        return replace(term, effect=effect, values={p.name: term.values[p.name] for p in effect.parameters})

    def _is_nothing(self, term: Term, parameter: Parameter) -> bool:
        alike = [abs(term.values[p.name]) for p in term.effect.amplitudes if p.unit == parameter.unit]
        return self._may_be_none(term, parameter) or abs(term.values[parameter.name]) < TERMS.nothing * max(alike)

    def _may_be_none(self, term: Term, parameter: Parameter) -> bool:
        sd = self.sd.get(f"{term.label}:{parameter.name}", 0.0)
        return sd > (abs(term.values[parameter.name]) if parameter.signed else TERMS.unidentifiable)


def _sizes(effect: Effect) -> Sequence[Parameter]:
    """Return the amplitudes of an effect, or all parameters without amplitudes."""
    return effect.amplitudes or effect.parameters
