"""Responses and modes at known levels: against closed forms, direct integration and finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from level_rigs import LAWS, LINES, ROWS, TWO, Law, steady_response, two_matrices
from scipy.optimize import brentq

from vlab.cases.channel_map import Compared
from vlab.diagnose.data.responses import Modes, Response
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.frequency import State
from vlab.diagnose.predictors.frequency_model import View, Wires, view_of
from vlab.diagnose.predictors.frequency_residual import modal_residual
from vlab.diagnose.predictors.level_answer import answer_at_level, operating_point
from vlab.diagnose.predictors.level_response import Element, Excitation, solve_amplitudes
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import EFFECTS
from vlab.plants.mjcf import build_mjcf

MATRICES = two_matrices(np.random.default_rng(0), 0.0)
PORTS = {name: Place(name=name, kind="port", rows=np.array([row])) for name, row in ROWS.items()}


def view(matrices=MATRICES) -> View:
    M, C, K = matrices
    rows = ChannelRows(at_q=np.eye(2), at_v=np.zeros((2, 2)), at_a=np.zeros((2, 2)), rest=np.zeros(2))
    omega = np.sqrt(np.linalg.eigvalsh(K))
    force = np.array([[1.0], [0.0]])
    return View(
        omega=omega, shapes=np.eye(2), M=M, C=C, K=K, forces=force, columns=(0,), rows=rows, orders=(0, 0), at={}
    )


WIRES = Wires(
    outputs=(Compared(channel="a", port="a"), Compared(channel="b", port="b")),
    orders=(0, 0),
    inputs=("f",),
    actuators=(0,),
)


def state(theta=(0.0, 0.0, 0.0, 0.0)) -> State:
    """Return matrices with a spring, all damping, the input's gain and the second output's gain as parameters."""
    M, C, K = MATRICES
    spring, damping = np.diag([500.0, 0.0]), C * np.exp(theta[1])
    return State(
        M=M,
        C=damping,
        K=K + theta[0] * spring,
        changes=((None, None, spring), (None, damping, None), (None, None, None), (None, None, None)),
        input_gain=np.array([np.exp(theta[2])]),
        output_gain=np.array([1.0, np.exp(theta[3])]),
    )


GAINS = [(None, None), (None, None), (0, None), (None, 1)]


def data(H=None, *, level=1.0, lines=LINES, is_random=False) -> Response:
    H = np.full((len(lines), 2), 1e-3 + 0j) if H is None else H
    one = np.full(H.shape, 1e-5)
    return Response(
        name="frf1", role="fit", input="f", outputs=("a", "b"), order=0, freq=lines, H=H, noise=one, spread=one,
        is_magnitude=False, level=level, is_random=is_random,
    )  # fmt: skip


def term(law: Law) -> Term:
    effect = EFFECTS[law.effect]
    names = [p.name for p in effect.parameters]
    return Term(effect=effect, place=PORTS[law.place], values=dict(zip(names, law.values, strict=True)))


@pytest.mark.parametrize("name", ["coulomb", "drag", "hardening", "softening", "jenkins"])
def test_a_response_at_a_level_is_that_of_direct_integration(name):
    law, level = LAWS[name], 2.0
    measured = data(steady_response(law, LINES, np.sqrt(2) * level, MATRICES), level=level)
    found = answer_at_level(view(), state(), measured, WIRES, [term(law)]).H
    linear = answer_at_level(view(), state(), measured, WIRES).H
    error, change = np.abs(found - measured.H), np.abs(linear - measured.H)
    # harmonics above the first are left out: they turn round into it by some per cent of what the law does
    assert np.sqrt(np.sum(error**2) / np.sum(change**2)) < 0.06
    assert np.sqrt(np.sum(error**2) / np.sum(np.abs(measured.H) ** 2)) < 0.03


def test_a_folded_response_has_three_solutions_and_the_data_choose():
    """A hardening oscillator beyond its fold: x (k - m w^2 + i c w + 3/4 k3 x^2) = F."""
    m, c, k, k3, force = 1.0, 0.4, 1000.0, 5e5, 2.0
    omega = np.array([2 * np.pi * 5.6])
    free = 1.0 / (k - m * omega**2 + 1j * c * omega)
    element = Element(row=np.ones(1), terms=(term(Law(effect="cubic-stiffness", values=(k3,))),))
    powers = [(0.75 * k3) ** 2, 1.5 * k3 * (k - m * omega[0] ** 2), (k - m * omega[0] ** 2) ** 2 + (c * omega[0]) ** 2]
    roots = np.roots([*powers, -(force**2)])
    exact = np.sort(np.sqrt(roots[np.abs(roots.imag) < 1e-9 * np.abs(roots)].real))
    assert len(exact) == 3
    excitation = Excitation(omega=omega, amplitude=np.array([force]), is_random=False)
    for wanted in exact:
        z = 0.75 * k3 * wanted**2
        there = force * free / (1 + free * z)

        def distance(_, there=there):
            return lambda lines, index, trial: np.abs(force * free[lines] / (1 + free[lines] * trial) - there)

        found, _ = solve_amplitudes([element], free[:, None, None], force * free[:, None], excitation, distance)
        assert found[0, 0].real == pytest.approx(z, rel=1e-3)


def test_noise_moves_an_oscillator_as_its_statistical_linearisation():
    """The variance of a cubic oscillator solves s^2 = sum |x0/(1 + g 3 k3 s^2)|^2 over the lines."""
    lines, level, k3 = np.linspace(1.0, 16.0, 800), 3.0, 4e5
    measured = data(level=level, lines=lines, is_random=True)
    cubic = term(Law(effect="cubic-stiffness", place="joint:mass1", values=(k3,)))
    at = operating_point(view(), state(), measured, WIRES, [cubic])
    M, C, K = MATRICES
    s = 2j * np.pi * lines

    def variance(stiffness: float) -> float:
        added = np.diag([stiffness, 0.0])
        H = np.linalg.inv(K + added + s[:, None, None] * C + s[:, None, None] ** 2 * M)[:, 0, 0]
        return float(np.sum(np.abs(H * at.excitation.amplitude) ** 2))

    exact = brentq(lambda z: z - 3 * k3 * variance(z), 0.0, 1e6)
    assert at.stiffness[0, 0].real == pytest.approx(exact, rel=0.02)  # quantiles of the amplitude
    assert np.sum(at.excitation.amplitude**2) == pytest.approx(level**2)


CASES = {
    "friction and drag": [LAWS["coulomb"], LAWS["drag"]],
    "slip and hardening": [LAWS["jenkins"], Law(effect="cubic-stiffness", values=(1e4,))],
}


@pytest.mark.parametrize("name", list(CASES))
def test_derivatives_are_those_of_finite_differences(name):
    terms, measured, theta = [term(law) for law in CASES[name]], data(level=1.0), np.array([0.1, 0.05, 0.02, 0.03])
    own = answer_at_level(view(), state(theta), measured, WIRES, terms, gains=GAINS, with_derivatives=True)

    def difference(low, high, h):
        return (high.H - low.H) / (2 * h)

    for i in range(len(theta)):
        step = 1e-4 * np.eye(len(theta))[i]
        low, high = (answer_at_level(view(), state(theta + d), measured, WIRES, terms) for d in (-step, step))
        assert _relative(difference(low, high, 1e-4), own.by_theta[i]) < 0.01
    parameters = [(k, p) for k, t in enumerate(terms) for p in t.effect.parameters]
    for column, (k, p) in zip(own.by_term, parameters, strict=True):
        ends = []
        for h in (-1e-4, 1e-4):
            value = terms[k].values[p.name] * np.exp(h)
            moved = replace(terms[k], values={**terms[k].values, p.name: value})
            ends.append(answer_at_level(view(), state(theta), measured, WIRES, [*terms[:k], moved, *terms[k + 1 :]]))
        scale = terms[k].values[p.name] if p.signed else 1.0
        assert _relative(difference(*ends, 1e-4) / scale, column) < 0.01  # two ports are solved in turns, to 1e-6


def _relative(a, b):
    return float(np.sqrt(np.sum(np.abs(a - b) ** 2) / np.sum(np.abs(a) ** 2)))


def test_a_saturated_sensor_and_a_clipped_drive_act_by_their_gains():
    measured = data(level=2.0)
    drive = Place(name="motor", kind="actuator", index=0)
    sensor = Place(name="sensor:a", kind="sensor", index=0)
    linear = answer_at_level(view(), state(), measured, WIRES).H
    clipped = Term(effect=EFFECTS["actuator-clipping"], place=drive, values={"limit": 1.0})
    found = answer_at_level(view(), state(), measured, WIRES, [clipped]).H
    r = 1.0 / (2.0 * np.sqrt(2))
    assert np.allclose(found / linear, 2 / np.pi * (np.arcsin(r) + r * np.sqrt(1 - r**2)), rtol=1e-3)
    limit = 0.3 * float(np.abs(linear[:, 0]).max()) * 2.0 * np.sqrt(2)
    flat = Term(effect=EFFECTS["sensor-clipping"], place=sensor, values={"limit": limit})
    seen = answer_at_level(view(), state(), measured, WIRES, [flat]).H
    assert np.array_equal(seen[:, 1], linear[:, 1])
    assert np.abs(seen[:, 0]).max() * 2.0 * np.sqrt(2) < 4 / np.pi * limit * 1.001  # a square wave at most


def test_a_mode_at_an_amplitude_is_on_the_backbone():
    """w^2 = w0^2 + 3/4 k3 a^2 / m and zeta = 4/(3 pi) c a / m of a single mass with a cubic spring and drag."""
    M, C, K = np.array([[2.0]]), np.array([[0.2]]), np.array([[800.0]])
    k3, drag, a = 3e4, 0.8, np.array([0.02, 0.05])
    place = Place(name="joint", kind="port", rows=np.ones((1, 1)))
    laws = (("cubic-stiffness", {"k3": k3}), ("quadratic-drag", {"coefficient": drag}))
    terms = [Term(effect=EFFECTS[name], place=place, values=values) for name, values in laws]
    none = ChannelRows(at_q=np.zeros((0, 1)), at_v=np.zeros((0, 1)), at_a=np.zeros((0, 1)), rest=np.zeros(0))
    whole = View(
        omega=np.array([20.0]), shapes=np.ones((1, 1)), M=M, C=C, K=K, forces=np.ones((1, 1)), columns=(), rows=none,
        orders=(), at={"joint": np.ones(1)},
    )  # fmt: skip
    plain = State(M=M, C=C, K=K, input_gain=np.ones(1), output_gain=np.ones(0))
    for size in a:
        omega = np.sqrt((800.0 + 0.75 * k3 * size**2) / 2.0)
        zeta = (0.2 + 8 / (3 * np.pi) * drag * omega * size) / (2 * 2.0 * omega)
        one = np.ones(1)
        table = Modes(
            name="modal1", role="fit", freq=one * omega / (2 * np.pi), zeta=one * zeta, at=(), shapes=np.zeros((1, 0)),
            freq_sd=one, zeta_sd=one, shape_sd=one, amplitude=one * size, amplitude_at="joint",
        )  # fmt: skip
        assert np.abs(modal_residual(whole, plain, table, terms).e).max() < 1e-4
        assert np.abs(modal_residual(whole, plain, table, ()).e).max() > 5e-3


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("coulomb-friction", {"force": 0.3}),
        ("cubic-stiffness", {"k3": 1e5}),
        ("quadratic-drag", {"coefficient": 2.0}),
        ("stribeck-friction", {"force": 0.2, "excess": 0.1, "speed": 0.05}),
    ],
)
def test_laws_of_a_plant_act_whether_mujoco_has_them_or_not(name, values):
    plant = attach(build_mjcf(TWO), [Attached(effect=EFFECTS[name], place="joint:mass2", values=values)])
    ports = tuple(Compared(channel=f"joint:mass{k}", port=f"joint:mass{k}") for k in (1, 2))
    wires = Wires(outputs=ports, orders=(0, 0), inputs=("motor",), actuators=(0,))
    (fixed,) = view_of(plant, wires).fixed
    assert fixed.effect.name == name
    assert dict(fixed.values) == values
