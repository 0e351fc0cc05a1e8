"""Forward selection of any number of effects on whole recordings.

A machine has friction in every joint, and Coulomb friction, drag and viscous damping in one. Effects are added one by one,
each from a profile screening beside the effects that are there, and all are fitted together. The selection ends when the
approximate log evidence no longer grows. Then every law is exchanged for its relatives at the same locations (sequential
replacement): a delay found first as a lag would stay one, since the other effects were fitted beside the lag.

One effect alone explains little where every joint rubs, and the uncertain parameters absorb the rest. A law in all joints
at once is therefore a start of its own.

References
----------
A. Miller, Subset Selection in Regression, 2nd ed., Chapman and Hall, 2002, chapter 3.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from vlab.diagnose.inference.evidence import Hypothesis, cost_of_parameters
from vlab.diagnose.inference.hypothesis_fits import by_score, near_best, scored_by, terms_of
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.model_choice import gain_beyond
from vlab.diagnose.inference.whole_run_fits import fitted_on_both
from vlab.diagnose.parameters.terms import Candidate, Fit, Term
from vlab.diagnose.search.deadline import NO_DEADLINE, Deadline
from vlab.diagnose.search.profile_screening import profile
from vlab.diagnose.search.shortlist import plain_form, rivals_of
from vlab.diagnose.settings import FORWARD_SELECTION, HYPOTHESIS_FITS, MJCF_PRIORS, MODEL_CHOICE, SHORTLIST
from vlab.parallel import side_by_side


@dataclass(frozen=True, kw_only=True, eq=False)
class ForwardSelection:
    """Fits and candidates of a forward selection.

    Parameters
    ----------
    before : Hypothesis
        Calibrated model, fitted to whole runs.
    windows, whole : LeastSquares
        Fits in windows and to whole runs.
    candidates : sequence of Candidate
        First screening, by gain.
    enough : float
        Normalised residual of whole runs that needs no further effect.
    deadline : Deadline
        End of the time for further effects.
    report : callable
        Receives the current step.
    """

    before: Hypothesis
    windows: LeastSquares
    whole: LeastSquares
    candidates: Sequence[Candidate]
    enough: float = HYPOTHESIS_FITS.enough
    deadline: Deadline = NO_DEADLINE
    report: Callable[[str], None] = lambda what: None

    def extend(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return hypotheses with all that the selection fits, by score.

        The first effect is selected anew, since windows hide weak dissipation that whole runs show.

        Parameters
        ----------
        hypotheses : sequence of Hypothesis
            Hypotheses of an earlier search, fitted to whole runs.

        Returns
        -------
        list of Hypothesis
            All hypotheses; of each set of effects the one of best score.
        """
        out = list(hypotheses)
        if self._goes_on([*out, self.before]) and not any(h.is_one_law for h in out):
            out += in_all_joints(self.candidates, self.fitted, self.before.long_fit)
        best = by_score([*out, self.before])[0]
        # the uncertain parameters absorb what else is missing, so their prior says little about the law
        laws = [h for h in out if h.is_one_law and h.likelihood > self.before.likelihood]
        one_law = sorted(laws, key=lambda h: -h.likelihood)[:1]
        for start in [best] if best.is_one_law else [*one_law, self.before]:
            out = self._from(start, out)
        best = by_score([*out, self.before])[0]
        self.report("exchanging related effects")
        exchanged = [] if self.deadline.is_past else self._exchanged(best)
        out += exchanged
        if (better := by_score([*exchanged, best])[0]) is not best:
            out = self._from(better, out)
        return best_of_labels(out)

    def _exchanged(self, best: Hypothesis) -> list[Hypothesis]:
        """Return fits with one law exchanged for another of its family."""
        laws = {term.effect.name: term.effect for term in best.terms}
        sets: list[list[Term]] = []
        for law in laws.values() if len(laws) > 1 else ():
            own = {term.place.name: term.values for term in best.terms if term.effect.name == law.name}
            rest = [term for term in best.terms if term.effect.name != law.name]
            others: dict[str, dict[str, Candidate]] = {}
            for c in self.candidates:
                is_rival = c.effect.family == law.family and c.effect.name not in laws
                if is_rival and c.place.name in own and c.log_likelihood_gain > SHORTLIST.least_gain:
                    known = own[c.place.name]  # as the force of a friction in every form
                    values = {name: known.get(name, value) for name, value in c.values.items()}
                    others.setdefault(c.effect.name, {})[c.place.name] = replace(c, values=values)
            sets += [[*rest, *terms_of(list(other.values()))] for other in others.values() if len(other) == len(own)]
        return side_by_side(lambda terms: self.fitted(terms, best.long_fit), sets)

    def _from(self, start: Hypothesis, known: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return hypotheses with those of a selection that begins with a start."""
        out, level, most = list(known), [start], len(start.terms) + FORWARD_SELECTION.most_effects
        while self._goes_on([*out, self.before]) and len(level[0].terms) < most:
            further = by_score(*(self._beside(seed) for seed in self._seeds(level)))
            count = len(level[0].terms) + 1
            larger = best_of_labels([*further, *(h for h in out if len(h.terms) == count)])
            if not larger:
                break
            is_better = gain_beyond(larger[0], level[0]) > 0.0
            out += further
            if not is_better and count > len(start.terms) + 1:  # one of two effects alone may explain nothing
                break
            if start.is_one_law and larger[0] not in near_best(by_score(out)):
                break  # a law in all joints that fewer effects surpass by far
            level = larger
        return out

    def _goes_on(self, hypotheses: Sequence[Hypothesis]) -> bool:
        """Return whether time and residual are left for further effects."""
        if self.deadline.is_past:
            return False
        best = by_score(hypotheses)[0]
        return scored_by(self.whole, best.long_fit).normalised_residual > self.enough

    def _seeds(self, level: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return the hypotheses that further effects join.

        A law of many parameters stands in for two simple laws, and then hides the second.
        """
        best = level[0]
        if not best.terms:
            return [best]
        sites = {(t.effect.family, t.place.name) for t in best.terms}
        related = [h for h in level if {(t.effect.family, t.place.name) for t in h.terms} == sites]
        plainest = min(related, key=lambda h: (sum(len(t.effect.parameters) for t in h.terms), -h.score))
        return [best] if plainest is best else [best, plainest]

    def _beside(self, seed: Hypothesis) -> list[Hypothesis]:
        """Return fits of further effects beside a hypothesis."""
        here = f"beside {len(seed.terms)} effects" if seed.terms else "on whole recordings"
        self.report(f"screening effects {here}")
        table = profile(self.whole.about(seed.long_fit), seed.long_fit, self._pool())
        chosen = further_effects(seed, table)
        self.report(f"fitting {len(chosen)} effects {here}")
        return side_by_side(lambda c: self.fitted([*seed.long_fit.terms, *terms_of([c])], seed.long_fit), chosen)

    def fitted(self, terms: Sequence[Term], start: Fit) -> Hypothesis:
        """See `fitted_on_both`."""
        return fitted_on_both(self.whole, self.windows, terms, start)

    def _pool(self) -> list[Candidate]:
        """Return the candidates: the best places of every effect, in turn."""
        ranks: dict[str, int] = {}
        order = []
        for candidate in self.candidates:
            rank = ranks[candidate.effect.name] = ranks.get(candidate.effect.name, 0) + 1
            order.append((rank, candidate))
        order.sort(key=lambda item: item[0])
        return [candidate for _, candidate in order[: FORWARD_SELECTION.most_candidates]]


def best_of_labels(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the best hypothesis of each set of effects, by score."""
    best: dict[frozenset[str], Hypothesis] = {}
    for h in by_score(hypotheses):
        best.setdefault(frozenset(t.label for t in h.terms), h)
    return list(best.values())


def in_all_joints(
    candidates: Sequence[Candidate], fit: Callable[[Sequence[Term], Fit], Hypothesis], start: Fit
) -> list[Hypothesis]:
    """Return fits of laws in all joints at once.

    Joints where a law does nothing are left out.

    Parameters
    ----------
    candidates : sequence of Candidate
        Screening of every effect at every location.
    fit : callable
        Returns terms fitted from another fit.
    start : Fit
        Fit of the calibrated model.

    Returns
    -------
    list of Hypothesis
        One per law.
    """

    def acting(law: Sequence[Candidate]) -> Hypothesis:
        found = fit(terms_of(law), start)
        idle = set(found.long_fit.unidentified)
        terms = [term for term in found.long_fit.terms if term.label not in idle]
        return fit(terms, found.long_fit) if idle and terms else found

    return side_by_side(acting, laws_in_all_joints(candidates))


def laws_in_all_joints(candidates: Sequence[Candidate]) -> list[list[Candidate]]:
    """Return the laws of the largest gains over all joints.

    The sum of a law's score tests is approximate: it has no correlation between the joints. So the best law of every
    family is included that gains `MODEL_CHOICE.explained` of the best of all. Its other forms that gain as much and the
    plainest form of the family join it. Every parameter costs what it costs in the evidence.

    Parameters
    ----------
    candidates : sequence of Candidate
        Screening of every effect at every location.

    Returns
    -------
    list of list of Candidate
        One candidate for each joint. Models of one joint have none, nor do models of more than `most_elements`, which are
        chains of links.
    """
    laws: dict[str, dict[str, Candidate]] = {}
    for c in sorted(candidates, key=lambda c: -c.log_likelihood_gain):
        in_joint = c.effect.kind == "port" and c.place.name.startswith("joint:")
        in_drive = c.effect.traits.is_linear and c.place.name.startswith("actuator:")
        if in_joint or in_drive:
            laws.setdefault(c.effect.name, {}).setdefault(c.place.name, c)
    found = [list(joints.values()) for joints in laws.values() if 1 < len(joints) <= MJCF_PRIORS.most_elements]
    if not found:
        return []
    largest = max(_gain_of_law(law) for law in found)
    least = min(MODEL_CHOICE.explained * largest, largest)
    families: dict[str, list[list[Candidate]]] = {}
    for law in sorted(found, key=lambda law: -_gain_of_law(law)):
        families.setdefault(law[0].effect.family, []).append(law)
    return [form for forms in families.values() if _gain_of_law(forms[0]) >= least for form in _forms_of_best(forms)]


def _forms_of_best(forms: Sequence[list[Candidate]]) -> list[list[Candidate]]:
    """Return a family's best law, its equals and the plainest law.

    Parameters
    ----------
    forms : sequence of list of Candidate
        Laws of the family, best first.
    """
    gain = sum(c.log_likelihood_gain for c in forms[0])
    plainest = min(forms, key=lambda law: (len(law[0].effect.parameters), -_gain_of_law(law)))
    return [law for law in forms if law is plainest or sum(c.log_likelihood_gain for c in law) >= gain]


def _gain_of_law(law: Sequence[Candidate]) -> float:
    return sum(c.log_likelihood_gain - cost_of_parameters(c.effect.parameters) for c in law)


def further_effects(best: Hypothesis, table: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates that join a hypothesis.

    The candidates are the best of every family, and the hypothesis' own effects at their best other location. Effects
    that gain as much as the best one join them. Two slip laws at one location are one friction.

    Parameters
    ----------
    best : Hypothesis
        Hypothesis.
    table : sequence of Candidate
        Screening beside the hypothesis, by gain.

    Returns
    -------
    list of Candidate
        Candidates by gain.
    """
    places = {term.place.name for term in best.terms if term.effect.traits.is_slip}
    taken = {(term.effect.physics, term.place.name) for term in best.terms}
    own = {term.effect.physics for term in best.terms}
    eligible = [
        c
        for c in table
        if (c.effect.physics, c.place.name) not in taken
        and not (c.effect.traits.is_slip and c.place.name in places)
        and c.log_likelihood_gain > SHORTLIST.least_gain
    ]
    chosen: dict[str, Candidate] = {}
    for candidate in eligible:
        key = candidate.effect.physics if candidate.effect.physics in own else f"family:{candidate.effect.family}"
        chosen.setdefault(key, candidate)
        plain = plain_form(candidate, table)
        if plain is not candidate:
            chosen.setdefault(f"plain:{plain.label}", plain)
    order = sorted(chosen.values(), key=lambda c: -c.log_likelihood_gain)[: FORWARD_SELECTION.fitted]
    if not order:
        return []
    least, labels = order[0].log_likelihood_gain - MODEL_CHOICE.alike, {c.label for c in order}
    equal = [c for c in rivals_of(order[0], eligible) if c.log_likelihood_gain >= least and c.label not in labels]
    return [*order, *equal]
