"""Signals that a sensor picks up, and what all actuators share: places of their own, the same in the twin as in MuJoCo."""

import pytest
import rig_oscillator
from rigs import oscillator_case

from vlab.cases import load_case
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.locations import Place, admissible, reported_name
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.validation.simulation import extended
from vlab.physics.catalogue import EFFECTS

SHARE = {"crosstalk": 5e-4, "cross-axis": 0.2, "misplaced-sensor": 0.2}
"""Of the force [m/N] and of the other sensor."""


@pytest.fixture(scope="module")
def screen(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_oscillator, "SECONDS", 2.0)
        rig = oscillator_case(tmp_path_factory.mktemp("rig"))
        return ScoreTest(prepare(load_case(rig.folder)))


@pytest.mark.parametrize("name", sorted(SHARE))
def test_twin_and_mujoco_pick_up_the_same(screen, name):
    problem, effect = screen.problem, EFFECTS[name]
    refiner = LeastSquares(screen)
    place = next(p for p in problem.places if p.kind == "pick-up" and admissible(effect, p) and p.index == 1)
    fit = refiner.fit()
    term = Term(effect=effect, place=place, values={"share": SHARE[name]})
    run, recorded = problem.signals[0], problem.runs[0]
    with_effect = refiner.simulate(
        [run], (term,), fit.theta[None], [{"share": fit.theta[:1] * 0 + SHARE[name]}], refiner_start(refiner)
    )[:, 0, 0, 1]
    without = refiner.simulate([run], (), fit.theta[None], (), refiner_start(refiner))[:, 0, 0, 1]
    plain, picked = (
        extended(problem, fit if terms is None else type(fit)(**{**vars(fit), "terms": terms})).simulated(recorded)
        for terms in (None, (term,))
    )
    column = recorded.measured.index(problem.names[1])
    ours = with_effect - without
    theirs = (picked.data - plain.data)[: len(ours), column]
    assert ours.std() > 0.05 * without.std()
    # twin and MuJoCo differ by their integrators: some tenths of a per cent of the motion that is picked up
    assert (ours - theirs).std() < 0.01 * theirs.std()


def refiner_start(refiner):
    return refiner.first_state(refiner.runs[0])[None, None] * 0.0


def test_the_chain_takes_what_all_actuators_share_and_nothing_else():
    chain = Place(name="chain", kind="actuator", index=0, also=(1, 2))
    assert chain.indices == (0, 1, 2)
    assert admissible(EFFECTS["actuator-delay"], chain)
    assert admissible(EFFECTS["actuator-dead-zone"], chain)  # drives of one make
    assert not admissible(EFFECTS["coulomb-friction"], chain)
    assert not admissible(EFFECTS["sensor-delay"], chain)


def test_hardware_of_a_structure_goes_by_its_own_names():
    names = {
        (effect, driven): reported_name("actuator:base", EFFECTS[effect], driven)
        for effect in ("actuator-delay", "actuator-gain", "actuator-clipping")
        for driven in (1, 3)
    }
    assert names == {
        ("actuator-delay", 1): "chain",
        ("actuator-delay", 3): "coil:base",
        ("actuator-gain", 1): "coil:base",
        ("actuator-gain", 3): "coil:base",
        ("actuator-clipping", 1): "amplifier:base",
        ("actuator-clipping", 3): "amplifier:base",
    }
    assert reported_name("sensor:base", EFFECTS["sensor-gain"], 1) == "sensor:base"
