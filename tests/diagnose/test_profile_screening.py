"""Screening on whole recordings: every shape of a candidate is tried in one batch, as if it were tried alone."""

from dataclasses import replace

import numpy as np
import pytest
import rig_oscillator
from rigs import oscillator_case

from vlab.cases import load_case
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.terms import Candidate
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.search import profile_screening
from vlab.diagnose.search.profile_screening import profile
from vlab.physics.catalogue import EFFECTS

HIDDEN = "jenkins-slip"
SOME = (HIDDEN, "coulomb-friction", "viscous-damping", "dead-band")


@pytest.fixture(scope="module")
def screened(tmp_path_factory):
    """Return fits to whole runs of an oscillator, the plain fit, the candidates at its port, and what hides there."""
    folder = tmp_path_factory.mktemp("profile")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_oscillator, "SECONDS", 2.0)
        rig = oscillator_case(folder, effect=HIDDEN)
    problem = prepare(load_case(folder))
    screen = ScoreTest(problem)
    whole = LeastSquares(screen, problem.in_role("fit"))
    found = screen.candidates([EFFECTS[name] for name in SOME])
    return whole, whole.fit(()), [c for c in found if c.place.name == rig.place], rig


def test_what_hides_is_first_among_the_candidates_at_its_place(screened):
    whole, plain, candidates, _ = screened
    first, *others = profile(whole, plain, candidates)
    assert first.effect.name == HIDDEN
    assert all(first.log_likelihood_gain > other.log_likelihood_gain for other in others)
    assert first.log_likelihood_gain > 0.5 * whole.effective_samples * np.log(4.0)


def test_shapes_tried_in_one_batch_give_what_each_gives_alone(screened):
    whole, plain, candidates, _ = screened
    base = profile_screening._Base.of(whole, plain)
    tried = 0
    for candidate in candidates:
        if not candidate.effect.amplitudes:
            continue
        shapes = profile_screening._shapes(candidate)
        together = profile_screening._amplitudes(base, candidate, shapes)
        alone = [v for shape in shapes for v in profile_screening._amplitudes(base, candidate, [shape])]
        assert len(together) == len(alone)
        for one, other in zip(together, alone, strict=True):
            assert one == pytest.approx(other, rel=1e-9)
        tried += len(shapes) > 1
    assert tried  # at least one law has several shapes


def test_a_law_that_does_nothing_gains_nothing(screened):
    """A gap beyond all motion: no amplitude changes the residual, so the candidate keeps its values without gain."""
    whole, plain, candidates, _ = screened
    gap = next(c for c in candidates if c.effect.name == "dead-band")
    idle: Candidate = replace(gap, values={**gap.values, "gap": 1e6})
    (found,) = profile(whole, plain, [idle])
    assert found.log_likelihood_gain == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("hertz", [2.0, 6.0, 9.0])
def test_a_resonance_is_found_far_from_the_first_screening(screened, hertz):
    """Recordings of the model with a mass that swings at the port; the first screening proposes another frequency."""
    whole, plain, candidates, _ = screened
    values = {"mass": 0.02, "frequency": 40.0, "damping_ratio": 0.04}
    far = replace(candidates[0], effect=EFFECTS["attached-oscillator"], values=values)
    base = profile_screening._Base.of(whole, plain)
    simulated = base.residuals
    recorded = simulated(far, [{**far.values, "frequency": hertz}])[0]
    base.residuals = lambda candidate, values: simulated(candidate, values) - recorded
    base.residual = base.residual - recorded
    best, *_ = profile_screening._resonances(base, far)
    # half of the half-power bandwidth beside it, or half of the resolution of a recording
    assert best["frequency"] == pytest.approx(hertz, rel=0.04, abs=0.5 / rig_oscillator.SECONDS)
