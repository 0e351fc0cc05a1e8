"""The search in frequency in its parts: a plant's view, the values that are tried, and what becomes of trials."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from frequency_rigs import CHAIN_EFFECTS, LINES, SENSORS, chain_response, write_chain
from rig_oscillator import CHAIN, DAMPING, MASS, STIFFNESS

from vlab.cases import load_case
from vlab.diagnose.data.responses import Modes, read_measured
from vlab.diagnose.inference.evidence import scored
from vlab.diagnose.inference.frequency_least_squares import Fitter, Point
from vlab.diagnose.parameters.locations import admissible
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.frequency_model import Wires, view_of, wires_of
from vlab.diagnose.predictors.frequency_problem import prepare_frequency
from vlab.diagnose.search import frequency_selection as searching
from vlab.diagnose.search.frequency_screening import ScoreTest, Trial, screened
from vlab.diagnose.search.frequency_selection import _pairs, _places, _quick_fit, _shortlist, search_frequency
from vlab.diagnose.search.trial_values import candidates, trials
from vlab.diagnose.settings import FREQUENCY_MODEL, FREQUENCY_SELECTION
from vlab.errors import BadCase
from vlab.physics.catalogue import EFFECTS
from vlab.physics.small_signal import is_linear
from vlab.plants.mjcf import build_mjcf

HIDDEN = CHAIN_EFFECTS["added-mass"]
FEW = [EFFECTS[name] for name in ("added-mass", "stiffness-to-ground", "sensor-gain")]


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Return the case of three masses in a row with a mass hidden at the third, on every fourth line."""
    folder = tmp_path_factory.mktemp("chain")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("frequency_rigs.LINES", LINES[::4])
        write_chain(folder, HIDDEN)
    return load_case(folder)


@pytest.fixture(scope="module")
def chain(case):
    return prepare_frequency(case)


@pytest.fixture(scope="module")
def screen(chain):
    fitter = Fitter(chain)
    fit = fitter.fit((), np.zeros(len(fitter.sd)))
    return ScoreTest(fitter, Point(theta=fit.theta, terms=()))


def place_of(problem, name):
    return next(p for p in problem.places if p.name == name)


# ---- the view -------------------------------------------------------------------------------------------------------


def matrices():
    relative = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])
    return MASS * np.eye(3), DAMPING * relative.T @ relative, STIFFNESS * relative.T @ relative


def test_a_view_has_the_modes_of_the_written_matrices(chain):
    M, C, K = matrices()
    squares, shapes = np.linalg.eigh(K / MASS)
    view = chain.view
    np.testing.assert_allclose(view.omega, np.sqrt(squares), rtol=1e-6)
    np.testing.assert_allclose(view.shapes.T @ M @ view.shapes, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(np.abs(view.shapes.T @ M @ shapes / np.sqrt(MASS)), np.eye(3), atol=1e-6)
    for own, given in ((view.M, M), (view.C, C), (view.K, K)):
        np.testing.assert_allclose(own, view.shapes.T @ given @ view.shapes, rtol=1e-6, atol=1e-6 * np.abs(given).max())


def test_a_view_answers_as_the_dynamic_stiffness_does(chain):
    """The rig's own equations of motion in its own coordinates, nothing hidden and nothing off."""
    view, omega = chain.view, 2 * np.pi * LINES
    dynamic = view.K[None] - omega[:, None, None] ** 2 * view.M + 1j * omega[:, None, None] * view.C
    (column,) = view.columns
    found = np.linalg.solve(dynamic, np.broadcast_to(view.forces[:, column, None], (len(omega), 3, 1)))[..., 0]
    exact = chain_response(
        CHAIN_EFFECTS["none"], LINES, np.array([1.0, 0, 0]), np.random.default_rng(0), 0.0, matrices()
    )
    np.testing.assert_allclose(found @ view.rows.at_q.T, exact, rtol=1e-6)
    assert view.orders == (0, 0, 0)
    assert not np.any(view.rows.at_a)


def test_an_input_at_a_port_is_a_unit_force_there(chain):
    plant = chain.plant
    ports = ("joint:mass3", "joint:mass1", "tendon:spring2")
    view = view_of(plant, Wires(outputs=chain.wires.outputs, orders=(0, 0, 0), inputs=ports, actuators=(None,) * 3))
    rows = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [-1.0, 1.0, 0.0]])
    np.testing.assert_allclose(view.forces[:, list(view.columns)], view.shapes.T @ rows.T, atol=1e-9)
    motor = view_of(plant, replace(chain.wires, inputs=("joint:mass3", "motor"), actuators=(None, 0)))
    np.testing.assert_allclose(motor.forces[:, motor.columns[1]], motor.shapes[0], atol=1e-9)


def named_alike():
    """Return the plant of the chain with an actuator that has the name of its joint."""
    return build_mjcf(CHAIN.format(sensors=SENSORS).replace('motor name="motor"', 'motor name="mass1"'))


def test_rows_of_shapes_are_deflections_whatever_reads_them():
    """By the port, by its sensor, and by the actuator that acts there."""
    view = view_of(named_alike(), Wires(at=("joint:mass1", "sensor1", "mass1", "tendon:spring3")))
    for name in ("joint:mass1", "sensor1", "mass1"):
        np.testing.assert_allclose(view.at[name], view.shapes[0], atol=1e-9)
    np.testing.assert_allclose(view.at["tendon:spring3"], view.shapes[2] - view.shapes[1], atol=1e-9)
    with pytest.raises(BadCase, match="no displacement"):
        view_of(build_mjcf(CHAIN.format(sensors=SENSORS)), Wires(at=("motor",)))


def test_only_modes_that_are_seen_are_kept(chain):
    """Of a mass beside the chain its sensors see nothing, and a sensor on it sees nothing of the chain."""
    other = '<body name="lone" pos="0 9 0"><joint name="lone" stiffness="500"/><geom/></body></worldbody>'
    plant = build_mjcf(CHAIN.format(sensors=SENSORS).replace("</worldbody>", other))
    assert view_of(plant, chain.wires).m == 3
    lone = view_of(plant, Wires(at=("joint:lone",)))
    np.testing.assert_allclose(lone.omega, [np.sqrt(500.0)], rtol=1e-6)
    assert view_of(plant, Wires()).m == 4  # without any word of it all ports count


def test_of_a_large_model_the_lowest_modes_are_kept():
    bodies = "".join(
        f'<body pos="{i} 0 0"><joint name="j{i}" stiffness="{100 * (i + 1)}"/><geom/></body>'
        for i in range(FREQUENCY_MODEL.most_modes + 4)
    )
    text = CHAIN.split("<worldbody>")[0] + f"<worldbody>{bodies}</worldbody></mujoco>"
    view = view_of(build_mjcf(text), Wires())
    np.testing.assert_allclose(view.omega, np.sqrt(100.0 * np.arange(1, FREQUENCY_MODEL.most_modes + 1)), rtol=1e-6)


def test_inputs_and_outputs_are_wired_by_name(case, chain):
    wires = wires_of(case, read_measured(case, ("fit", "holdout")))
    assert wires.inputs == ("motor",)
    assert wires.actuators == (0,)
    assert wires.names == ("sensor1", "sensor2", "sensor3")
    assert [c.sensor for c in wires.outputs] == [0, 1, 2]
    other = replace(chain.measured[0], input="joint:mass2", outputs=("joint:mass3", "mass1", "sensor2"))
    by_port = wires_of(SimpleNamespace(plant=named_alike(), path="case.toml"), [other])
    assert by_port.actuators == (None,)
    assert [(c.sensor, c.port) for c in by_port.outputs] == [(None, "joint:mass3"), (None, "joint:mass1"), (1, "")]


@pytest.mark.parametrize(
    ("change", "words"),
    [({"input": "sensor2"}, "is a sensor"), ({"outputs": ("nowhere",) * 3}, "measures no motion")],
)
def test_what_cannot_be_wired_is_said(case, chain, change, words):
    with pytest.raises(BadCase, match=words):
        wires_of(case, [replace(chain.measured[0], **change)])


def test_an_unstable_model_has_no_response(case, tmp_path):
    (tmp_path / "rig.xml").write_text(
        (case.path.parent / "rig.xml").read_text().replace('stiffness="2000"', 'stiffness="-20"')
    )
    for name in ("case.toml", "fit.csv", "holdout.csv"):
        (tmp_path / name).write_text((case.path.parent / name).read_text())
    with pytest.raises(BadCase, match="unstable"):
        prepare_frequency(load_case(tmp_path))


NOT_HERE = {"rotary-inertia", "tension-error"}
"""Effects that no place of the chain can have: nothing turns, no bar is stretched."""

# ---- trials ---------------------------------------------------------------------------------------------------------


def test_candidates_are_all_linear_effects_where_they_can_act_and_show(chain):
    pairs = candidates(chain, list(EFFECTS.values()))
    assert all(is_linear(effect) and admissible(effect, place) for effect, place in pairs)
    labels = {(effect.name, place.name) for effect, place in pairs}
    assert len(labels) == len(pairs)
    assert {(h.effect, h.place) for h in CHAIN_EFFECTS.values() if h.place} <= labels
    assert not any(effect.name == "magnetic-negative-stiffness" and place.stiffness > 0 for effect, place in pairs)


def test_channels_that_no_response_shows_are_no_places(chain):
    (data,) = chain.measured
    less = replace(chain, measured=(replace(data, outputs=data.outputs[:1], H=data.H[:, :1], noise=data.noise[:, :1]),))
    effects = [EFFECTS["sensor-gain"], EFFECTS["actuator-gain"]]
    found = {(e.name, p.name) for e, p in candidates(less, effects)}
    assert found == {("sensor-gain", "sensor:sensor1"), ("actuator-gain", "actuator:motor")}
    none = np.zeros(0)
    table = Modes(
        name="m", role="fit", freq=none, zeta=none, at=(), shapes=np.zeros((0, 0)), freq_sd=none, zeta_sd=none,
        shape_sd=none,
    )  # fmt: skip
    assert candidates(replace(chain, measured=(table,)), effects) == []  # a table of modes knows no channel


@pytest.mark.parametrize("name", [e.name for e in EFFECTS.values() if is_linear(e)])
def test_trials_stay_within_the_catalogues_range_and_are_all_different(chain, name):
    effect = EFFECTS[name]
    places = [p for e, p in candidates(chain, [effect])]
    assert bool(places) != (name in NOT_HERE)
    for place in places[:2]:
        tried = trials(chain, effect, place)
        keys = {tuple(float(t.values[p.name]) for p in effect.parameters) for t in tried}
        assert len(keys) == len(tried) > 1
        for term in tried:
            assert (term.effect, term.place) == (effect, place)
            for p in effect.parameters:
                value = term.values[p.name]
                assert p.signed or value > 0
                if not p.reference and p.unit not in ("s", "Hz"):
                    assert abs(value) <= p.high * (1 + 1e-12)


def test_a_force_that_may_have_either_sign_is_tried_with_both_alike(chain):
    effect = EFFECTS["tension-error"]
    place = replace(place_of(chain, "joint:mass2"), tag="tension")
    own = sorted(t.values["tension"] for t in trials(chain, effect, place))
    np.testing.assert_allclose(own, -np.array(own)[::-1])
    assert own[0] < 0 < own[-1]


@pytest.mark.parametrize(
    ("name", "parameter"),
    [("added-mass", "mass"), ("stiffness-to-ground", "stiffness"), ("viscous-damping", "damping")],
)
def test_trials_go_with_the_size_of_the_thing(chain, name, parameter):
    """A place that moves by half as much in every mode stands for four times the mass, stiffness and damping."""
    place = place_of(chain, "joint:mass2")
    heavy = replace(place, rows=0.5 * place.rows)
    one, four = ([t.values[parameter] for t in trials(chain, EFFECTS[name], p)] for p in (place, heavy))
    np.testing.assert_allclose(four, 4 * np.array(one), rtol=1e-9)


def test_trials_of_one_mode_are_about_its_mass_and_stiffness(chain):
    """The middle of either grid is within a factor of three of what moves there, the ends far beside it."""
    omega = 2 * np.pi * 5.0
    place = replace(place_of(chain, "joint:mass2"), rows=np.array([[1.0 / np.sqrt(2.0)]]))
    alone = replace(chain, view=replace(chain.view, omega=np.array([omega])))
    for name, parameter, size in (("added-mass", "mass", 2.0), ("stiffness-to-ground", "stiffness", 2.0 * omega**2)):
        grid = np.array([t.values[parameter] for t in trials(alone, EFFECTS[name], place)])
        assert np.abs(np.log(grid / (0.1 * size))).min() < np.log(2.7)
        assert grid.min() < 0.01 * size
        assert grid.max() > 2.0 * size


def test_what_is_hidden_has_a_trial_near_it(chain):
    """Of every effect of the rig: every value within a factor of three, or a share of it."""
    for hidden in CHAIN_EFFECTS.values():
        if not hidden.place:
            continue
        tried = trials(chain, EFFECTS[hidden.effect], place_of(chain, hidden.place))
        off = [
            max(abs(np.log(abs(t.values[k] / v))) + 9.0 * (t.values[k] * v < 0) for k, v in hidden.values.items())
            for t in tried
        ]
        assert min(off) < np.log(10.0 if len(hidden.values) > 1 else 3.0), hidden.effect


# ---- the search -----------------------------------------------------------------------------------------------------


def tried(name, place, gain):
    where = SimpleNamespace(name=place)
    return Trial(term=Term(effect=EFFECTS[name], place=where, values={}), log_likelihood_gain=gain)


def test_a_shortlist_has_the_best_of_both_views_and_of_every_family():
    """And with every one of them all that was tried of it."""
    by_lines = [tried("added-mass", f"p{i}", 100.0 - i) for i in range(FREQUENCY_SELECTION.shortlist + 5)]
    by_lines += [
        tried("viscous-damping", "p0", 1.0),
        tried("viscous-damping", "p1", 0.5),
        tried("sensor-gain", "s", -1.0),
    ]
    by_bands = [tried("lost-stiffness", "p3", 5.0), tried("added-mass", "p0", 4.0)]
    chosen = {own[0].label: own for own in _shortlist(by_lines, by_bands)}
    masses = {f"added-mass@p{i}" for i in range(FREQUENCY_SELECTION.shortlist)}
    assert set(chosen) == masses | {"viscous-damping@p0", "lost-stiffness@p3"}
    assert [t.log_likelihood_gain for t in chosen["added-mass@p0"]] == [100.0, 4.0]
    assert _shortlist([], []) == []


def test_what_gains_most_in_the_screening_is_what_is_hidden(screen, chain):
    ranked = screened(screen, candidates(chain, FEW))
    assert (ranked[0].term.effect.name, ranked[0].term.place.name) == (HIDDEN.effect, HIDDEN.place)
    assert [t.log_likelihood_gain for t in ranked] == sorted((t.log_likelihood_gain for t in ranked), reverse=True)


def test_a_quick_fit_is_the_best_of_its_starts(screen, chain):
    """From afar, the start that the coarse view gave counts as well."""
    fitter, place = screen.fitter, place_of(chain, HIDDEN.place)
    good, bad = (Term(effect=EFFECTS["added-mass"], place=place, values={"mass": m}) for m in (0.2, 1e-4))
    theta = screen.point.theta
    alone = [fitter.fit([t], theta, iterations=searching.FREQUENCY_SELECTION.quick).chi2 for t in (good, bad)]
    both = _quick_fit(fitter, [Trial(term=bad, log_likelihood_gain=1.0, others=(good,))], theta, ())
    assert both.chi2 == pytest.approx(min(alone))
    afar = _quick_fit(fitter, [Trial(term=bad, log_likelihood_gain=1.0)], theta, {bad.label})
    assert afar.chi2 <= alone[1]


def test_a_pair_leaves_no_more_than_the_effect_that_it_was_found_beside(screen, chain):
    """Seeds are of different kinds, and the second effect is another one."""
    fitter, theta = screen.fitter, screen.point.theta
    pairs = candidates(chain, FEW)
    terms = [Term(effect=EFFECTS["sensor-gain"], place=place_of(chain, "sensor:sensor2"), values={"gain": 0.05})]
    fit = fitter.fit(terms, theta, iterations=3)
    seed = scored(fit, fitter.effective_samples, fitter.effective_samples)
    found = _pairs(fitter, [seed, seed], pairs)
    assert found
    for pair in found:
        labels = [t.label for t in pair.terms]
        assert len(set(labels)) == 2
        assert seed.label in labels
    best = min(found, key=lambda f: f.chi2)
    assert f"{HIDDEN.effect}@{HIDDEN.place}" in [t.label for t in best.terms]
    assert best.chi2 < 0.1 * fit.chi2


def test_the_best_effect_is_compared_at_its_other_places(screen, chain):
    fitter, theta = screen.fitter, screen.point.theta
    ranked = screened(screen, candidates(chain, [EFFECTS["added-mass"]]))
    fit = fitter.fit([ranked[0].term], theta)

    def penalised(fit):
        return scored(fit, fitter.effective_samples, fitter.effective_samples)

    places = _places(fitter, [penalised(fit)], ranked, theta, penalised)
    assert next(iter(places)) == HIDDEN.place
    assert set(places) == {t.term.place.name for t in ranked}
    for name, h in places.items():
        assert [t.place.name for t in h.terms] == [name]
        assert h.score <= places[HIDDEN.place].score
    assert _places(fitter, [], ranked, theta, penalised) == {}


def test_the_search_finds_the_hidden_mass_and_prices_its_trials(chain):
    """The fewest effects that explain it come first, and a hypothesis pays for how many were tried."""
    said = []
    found = search_frequency(chain, [EFFECTS["added-mass"], EFFECTS["stop"]], lambda share, what: said.append(share))
    assert said == sorted(said)
    best = found.hypotheses[0]
    assert best.label == f"{HIDDEN.effect}@{HIDDEN.place}"
    assert best.terms[0].values["mass"] == pytest.approx(HIDDEN.values["mass"], rel=0.15)
    assert best.normalised_residual < 1.3 < found.before.normalised_residual
    assert best.score > found.before.score
    scores = [h.score for h in found.hypotheses]
    assert scores == sorted(scores, reverse=True)
    assert found.tried == len(candidates(chain, [EFFECTS["added-mass"]]))  # a stop is not linear
    assert best.negative_log_prior >= np.log(found.tried)
