"""Residual vectors beside the receptance of the whole model."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from vlab.cases.channel_map import Compared
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.parameters.locations import Place, places_of
from vlab.diagnose.parameters.observation import channel_rows
from vlab.diagnose.parameters.reduced_model import ReducedModel, TruncatedModes
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.modal import channels
from vlab.diagnose.predictors.residual_flexibility import residual_vectors
from vlab.physics.catalogue import EFFECTS
from vlab.plants.mjcf import build_mjcf

SHORT = 1e-6
"""SHORT [s]: integration step at which no coordinate is slowed."""
ENDS = ("crosspiece-left", "tip-left", "beam:base-10in")
"""Ports whose flexibility lies in truncated modes, or in modes that no sensor of the beam sees."""


CHAIN = (
    "<mujoco><worldbody>{}</worldbody><actuator><position name='servo' joint='q2' kp='40'/></actuator>"
    "<sensor><jointpos name='q0' joint='q0'/></sensor></mujoco>"
).format("".join(f"<body name='b{i}'><joint name='q{i}' type='slide' axis='1 0 0' stiffness='{30 + 9 * i}' damping='.01'/>"
         "<geom size='.01' mass='.1' contype='0' conaffinity='0'/>" for i in range(6)) + 6 * "</body>")  # fmt: skip
"""CHAIN [-]: six masses in a row, the third one under a position servo."""


@pytest.fixture(scope="module")
def beam_modes(composite):
    """Return a reduced model of eight modes of the beam, the whole linear model and its channels."""
    kept = np.arange(composite.model.nv) < 9
    kept[2] = False  # as an antisymmetric mode, which no sensor sees
    return reduced_to(composite, kept)


def reduced_to(plant, kept):
    linear = plant.linearise()
    omega, shapes = linear.eigen
    names = [tap.name for tap in plant.sensors]
    rows = channel_rows(plant, [Compared(channel=n, sensor=i) for i, n in enumerate(names)])
    outside = shapes[:, ~kept]
    pushes = plant.actuator_forces()
    truncated = TruncatedModes(
        omega=omega[~kept],
        shapes=outside,
        C=outside.T @ linear.C @ outside,
        rows=rows.onto(outside),
        forces=outside.T @ pushes,
        loads=np.zeros((int((~kept).sum()), 0)),
    )
    basis = shapes[:, kept]
    M, C, K = (basis.T @ part @ basis for part in (linear.M, linear.C, linear.K))
    reduced = ReducedModel(
        omega=omega[kept],
        shapes=basis,
        M=M,
        C=C,
        K=K,
        forces=basis.T @ plant.actuator_forces(),
        loads=np.zeros((kept.sum(), 0)),
        rows=rows.onto(basis),
        changes=(),
        outside=truncated,
    )
    return reduced, linear, rows


def place_at(plant, reduced, name):
    row = plant.port_rows([name])
    return Place(name=name, kind="port", rows=row @ reduced.shapes, truncated=row @ reduced.truncated.shapes)


def receptances(vectors, reduced, place, hz):
    """Return motion of the port and the channels' velocities under a unit force."""
    M, C, K = (part[0] for part in vectors.matrices(reduced.M[None], reduced.C[None], reduced.K[None]))
    row, channels = vectors.motion(place)[0], vectors.channels(reduced.rows)
    s = 2j * np.pi * hz
    motion = np.linalg.solve(s**2 * M + s * C + K, vectors.push(place)[0])
    return row @ motion, (channels.at_q + s * channels.at_v) @ motion


@pytest.mark.parametrize("name", ENDS)
def test_the_receptance_is_that_of_the_whole_model(name, composite, beam_modes):
    reduced, linear, rows = beam_modes
    place, force = place_at(composite, reduced, name), composite.port_rows([name])[0]
    vectors = residual_vectors(reduced, [place], SHORT)
    bare = residual_vectors(reduced, [], SHORT)
    for hz in (0.0, 1.0, 6.0, 12.0, 30.0):
        s = 2j * np.pi * hz
        motion = np.linalg.solve(s**2 * linear.M + s * linear.C + linear.K, force)
        whole, seen = force @ motion, (rows.at_q + s * rows.at_v) @ motion
        port, channels = receptances(vectors, reduced, place, hz)
        assert abs(port - whole) < (1e-9 if hz == 0.0 else 2e-3) * abs(whole)
        assert np.abs(channels - seen).max() < 5e-3 * np.abs(seen).max() + 1e-12
        assert abs(receptances(bare, reduced, place, hz)[0] - whole) > 0.02 * abs(whole)  # modal truncation alone


def test_two_ends_of_one_element_have_one_basis(composite, beam_modes):
    reduced, linear, _ = beam_modes
    places = [place_at(composite, reduced, name) for name in ("crosspiece-left", "crosspiece-left", "clamp")]
    vectors = residual_vectors(reduced, places, SHORT)
    assert vectors.r == 6
    force = composite.port_rows(["crosspiece-left", "clamp"])
    K = vectors.matrices(reduced.M[None], reduced.C[None], reduced.K[None])[2][0]
    rows, pushes = (np.vstack([at(places[0]), at(places[2])]) for at in (vectors.motion, vectors.push))
    assert rows @ np.linalg.solve(K, pushes.T) == pytest.approx(force @ np.linalg.solve(linear.K, force.T), rel=1e-8)


def test_more_ports_than_truncated_modes_have_the_whole_space(composite, beam_modes):
    reduced, _linear, _ = beam_modes
    names = [name for name, port in composite.ports.items() if not port.tag]
    places = [place_at(composite, reduced, name) for name in names]
    vectors = residual_vectors(reduced, places, SHORT)
    assert vectors.r <= len(reduced.truncated.omega) < 3 * len(places)
    apart = np.abs(vectors.omega[:, None] / reduced.truncated.omega - 1.0).min(axis=1)
    assert apart.max() < 1e-6  # the modes themselves, but those that no port moves
    assert np.isfinite(vectors.basis).all()


@pytest.mark.parametrize("which", ["none", "one"])
def test_without_truncated_modes_nothing_changes(which, composite, beam_modes):
    reduced, _, _ = beam_modes
    whole = replace(reduced, outside=None)
    places = [place_at(composite, whole, "clamp")] if which == "one" else []
    vectors = residual_vectors(whole, places, SHORT)
    assert vectors.r == 0
    assert vectors.matrices(reduced.M, reduced.C, reduced.K)[0] is reduced.M
    assert np.array_equal(vectors.channels(whole.rows).at_q, whole.rows.at_q)


def test_every_place_of_a_force_has_its_truncated_motion():
    plant = build_mjcf(CHAIN)
    reduced, linear, _ = reduced_to(plant, np.arange(6) < 2)
    places = places_of(plant, reduced, ["q0"], [0])
    forces = [place for place in places if place.rows.size]
    assert any(place.servo is not None for place in forces)  # a servo acts along its joint
    static = np.linalg.inv(linear.K)
    for place in forces:
        assert place.truncated.shape == (len(place.rows), 4)
        vectors = residual_vectors(reduced, [place], SHORT)
        row = np.hstack([place.rows, place.truncated]) @ np.linalg.inv(
            np.hstack([reduced.shapes, reduced.truncated.shapes])
        )
        K = vectors.matrices(reduced.M[None], reduced.C[None], reduced.K[None])[2][0]
        assert vectors.motion(place) @ np.linalg.solve(K, vectors.push(place).T) == pytest.approx(
            row @ static @ row.T, rel=1e-8
        )


def test_slow_coordinates_keep_the_flexibility(composite, beam_modes):
    reduced, linear, _ = beam_modes
    place, force = place_at(composite, reduced, "crosspiece-left"), composite.port_rows(["crosspiece-left"])[0]
    h = 2e-3
    vectors = residual_vectors(reduced, [place], h)
    assert vectors.omega.max() <= (1.0 + 1e-12) / h
    static, _ = receptances(vectors, reduced, place, 0.0)
    assert static == pytest.approx(force @ np.linalg.solve(linear.K, force), rel=1e-9)


def test_states_of_the_modes_stay(composite, beam_modes):
    reduced, _, _ = beam_modes
    vectors = residual_vectors(reduced, [place_at(composite, reduced, "clamp")], SHORT)
    states, r = np.arange(32.0).reshape(2, 16), 2 * vectors.r
    wide = vectors.states(states)
    assert wide.shape == (2, 16 + 2 * r)
    assert np.array_equal(wide[:, [*range(8), *range(8 + r, 16 + r)]], states)


# ---- in time, beside the model with all modes --------------------------------------------------------------------------

H, N, HIGHEST = 0.005, 400, 60.0  # so short steps that the whole model follows its law
LONG = "".join(f"<body name='b{i}'><joint name='q{i}' type='slide' axis='1 0 0' stiffness='3000' damping='.02'/>"
               "<geom size='.01' mass='.1' contype='0' conaffinity='0'/>" for i in range(24))  # fmt: skip
LONG = (
    f"<mujoco><worldbody>{LONG}{24 * '</body>'}</worldbody><actuator><motor name='motor' joint='q12'/></actuator>"
    "<sensor><jointpos name='end' joint='q12'/><jointvel name='speed' joint='q12'/></sensor></mujoco>"
)
"""LONG [-]: a chain of 24 masses, pushed at the joint of the law."""
OF_LAWS = {"stiffness-to-ground": {"stiffness": 3000.0}, "cubic-stiffness": {"k3": 1e11}, "bouc-wen": {"force": 0.3, "yield": 1e-4}}  # fmt: skip


def quasi_static(plant, law):
    """Return a state of the chain whose 21 higher modes are in equilibrium with the law while the lowest ones swing."""
    row, linear, stiff = plant.port_rows(["joint:q12"])[0], plant.linearise(), OF_LAWS[law]
    omega, shapes = linear.eigen
    yields = shapes[:, 3:] @ (shapes[:, 3:].T @ row / omega[3:] ** 2)
    swing = 0.03 * shapes[:, 0], 0.3 * shapes[:, 0]

    def displacement(t):
        slow = swing[0] + t * swing[1]
        law_of = (lambda z: stiff["stiffness"] * z) if "stiffness" in stiff else (lambda z: stiff["k3"] * z**3)
        force = brentq(lambda f: f + law_of(row @ (slow + f * yields)), -1e3, 1e3, xtol=1e-14)
        return slow + force * yields

    return np.concatenate([displacement(0.0), (displacement(1e-5) - displacement(-1e-5)) / 2e-5])


def in_time(plant, model, law, *, pushed):
    """Return the channels of a run; of a driven run the effect of the law."""
    rng = np.random.default_rng(3)
    slow = np.convolve(rng.standard_normal(N + 200), np.hanning(200), mode="valid")[:N, None]
    u = slow * np.hanning(2 * N)[:N, None] if pushed else np.zeros((N, 1))
    start = np.zeros(2 * 24) if pushed else quasi_static(plant, law)
    onto = model.shapes.T @ plant.linearise().M
    run = Signals(
        name="run", role="fit", h=H, y=np.zeros((N, 2)), u=u, load=np.zeros((N, 0)), noise=np.ones(2), scale=np.ones(2),
        at_rest=pushed,
    )  # fmt: skip
    term = Term(effect=EFFECTS[law], place=place_at(plant, model, "joint:q12"), values=OF_LAWS[law])
    values = [{name: np.array([value]) for name, value in term.values.items()}]
    starts = np.concatenate([onto @ start[:24], onto @ start[24:]])[None, None]
    y = channels(model, HIGHEST, [run], [term], np.zeros((1, 0)), values, starts)[:, 0, 0]
    # the recordings of a search are without the static response of truncated modes to inputs
    return y - channels(model, HIGHEST, [run], [], np.zeros((1, 0)), [], starts)[:, 0, 0] if pushed else y


@pytest.mark.parametrize(("law", "pushed"), [*((law, True) for law in OF_LAWS), *((law, False) for law in list(OF_LAWS)[:2])])  # fmt: skip
def test_the_effect_of_a_law_is_that_in_the_whole_model(law, pushed):
    """Driven from rest where the law acts, and released in motion."""
    plant = build_mjcf(LONG)
    whole, reduced = (reduced_to(plant, np.arange(24) < count)[0] for count in (24, 3))
    truth = in_time(plant, whole, law, pushed=pushed)
    error, bare = (
        np.sqrt(np.mean((in_time(plant, model, law, pushed=pushed) - truth) ** 2, axis=0) / np.mean(truth**2, axis=0))
        for model in (reduced, replace(reduced, outside=None))
    )
    assert error[0] < 0.1
    assert error[0] < 0.2 * bare[0]
    assert error[1] < bare[1]  # other modes of the chain weigh more in the velocity


def test_further_inputs_act_on_the_dynamic_modes_alone():
    plant = build_mjcf(LONG)
    reduced = reduced_to(plant, np.arange(24) < 3)[0]
    more = reduced.with_loads(np.eye(3))
    vectors = residual_vectors(more, [place_at(plant, more, "joint:q12")], SHORT)
    own = np.hstack([more.forces, more.loads])[None]
    forces = vectors.inputs(own, np.ones((1, 1)))[0]
    assert forces.shape == (3 + 2 * vectors.r, 4)
    assert np.array_equal(forces[:3], own[0])
    assert not forces[3:, 1:].any()
    assert np.abs(forces[3 + vectors.r :, 0]).max() > 0.0  # the motor
