"""The march of the twin: laws folded into it move it as they do step by step; what a law says of itself is true."""

from dataclasses import replace

import numpy as np
import pytest

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.parameters.discrete import discretise
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors import integration as marching
from vlab.diagnose.predictors.integration import _remember, acting_order, integrate
from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import Parameter, PortEffect, Step
from vlab.physics.servo import Servo, ServoEffect, at_servo

H, N, SETS = 0.004, 477, 3
LAWS = {
    "attached-oscillator": {"mass": 0.2, "frequency": 4.0, "damping_ratio": 0.02},
    "structural-damping": {"loss": 30.0, "centre": 3.0},
    "sinusoidal-force": {"sine": 2.0, "cosine": -1.0, "frequency": 7.0},
    "force-offset": {"force": 0.4},
    "cubic-stiffness": {"k3": 3e3},
    "coulomb-friction": {"force": 0.3},
    "bouc-wen": {"force": 0.5, "yield": 0.02},
    "coil-force-over-travel": {"loss": 3.0},
    "stribeck-friction": {"force": 0.2, "excess": 0.2, "speed": 0.1},
}
SERVO = Servo(gain=2.0, damping=0.3)
_PORTS = [e for e in EFFECTS.values() if isinstance(e, PortEffect)]
PORTS = [at_servo(e, SERVO) if isinstance(e, ServoEffect) else e for e in _PORTS]


def place(name: str, row: list[float]) -> Place:
    return Place(name=name, kind="port", rows=np.array([row]), coil=0)


def integrated(names: list[str], substeps: int) -> np.ndarray:
    """Two modes seen by a displacement, a velocity and an accelerometer, in a whole run and one that starts in motion."""
    rng = np.random.default_rng(1)
    spread = np.linspace(0.9, 1.1, SETS)[:, None, None]
    M = np.eye(2) * spread
    K, C = np.diag([300.0, 4000.0]) * np.ones_like(spread), np.diag([0.5, 2.0]) * spread
    rows = ChannelRows(
        at_q=np.array([[1.0, 0.5], [0.0, 0.0], [0.0, 0.0]]),
        at_v=np.array([[0.0, 0.0], [1.0, -1.0], [0.0, 0.0]]),
        at_a=np.array([[0.0, 0.0], [0.0, 0.0], [0.3, 1.0]]),
        rest=np.zeros(3),
    )
    at = [place("one", [1.0, 0.4]), place("two", [-0.3, 1.0])]
    terms = [Term(effect=EFFECTS[name], place=at[i % 2], values=LAWS[name]) for i, name in enumerate(names)]
    values = [{k: v * np.linspace(0.8, 1.2, SETS) for k, v in t.values.items()} for t in terms]
    ports = acting_order(terms)
    inputs = np.hstack([np.array([[1.0], [0.7]]), *(terms[i].place.rows.T for i in ports)])
    system = discretise(M, C, K, inputs, rows, H / substeps)
    y, u = np.zeros((N, 3)), rng.standard_normal((N, 1))
    empty = {"load": np.zeros((N, 0)), "noise": np.ones(3), "scale": np.ones(3)}
    runs = [
        Signals(name="whole", role="fit", h=H, y=y, u=u, at_rest=True, **empty),
        Signals(
            name="part", role="fit", h=H, y=y, u=u, at_rest=False, t0=1.3, before=rng.standard_normal((30, 4)), **empty
        ),
    ]
    starts = np.zeros((SETS, 2, 4))
    starts[:, 1] = rng.standard_normal(4)
    forces = np.repeat(10 * rng.standard_normal((N, 1, 2, 1)), SETS, axis=1)
    return integrate(
        system, forces, 1, terms, values, (ports, [terms[i].place.rows[0] for i in ports]), starts, runs, substeps
    )


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize(
    "names",
    [
        ["attached-oscillator"],
        ["structural-damping"],
        ["sinusoidal-force"],
        ["structural-damping", "attached-oscillator"],
        ["attached-oscillator", "force-offset"],
        ["structural-damping", "coulomb-friction"],
        ["attached-oscillator", "cubic-stiffness"],
    ],
)
def test_laws_folded_into_the_twin_move_it_as_they_do_step_by_step(names, substeps, monkeypatch):
    """What stands for a force that is not known yet is its last value there and a first guess here: both are of second order. Of
    a law in the loop those folded into the twin know nothing in its step, which is of first order."""
    folded, finer = integrated(names, substeps), integrated(names, 2 * substeps)
    given = (
        [n for n in names if type(EFFECTS[n]).response == "none"] if len(names) == 1 else []
    )  # beside others it comes first
    for name in [*given, *(n for n in names if type(EFFECTS[n]).response == "linear")]:
        monkeypatch.setattr(type(EFFECTS[name]), "response", "any")
    off, less = (np.abs(integrated(names, n * substeps) - f).max() for n, f in ((1, folded), (2, finer)))
    assert off < 2e-3 * np.abs(folded).max() / substeps
    assert less < 0.6 * off + 1e-11 * np.abs(folded).max()
    assert np.abs(folded - integrated([], substeps)).max() > 1e-3 * np.abs(folded).max()


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize(
    "names",
    [
        ["cubic-stiffness"],
        ["coulomb-friction"],
        ["coulomb-friction", "cubic-stiffness", "sinusoidal-force"],
        ["bouc-wen", "attached-oscillator", "coulomb-friction"],
        ["coil-force-over-travel", "stribeck-friction"],
    ],
)
def test_laws_played_from_tapes_move_the_twin_as_those_written(names, substeps, monkeypatch):
    """To rounding, which friction that sticks or slips makes a little more of."""
    evaluated = integrated(names, substeps)
    monkeypatch.setattr(marching, "trace_expression", lambda *given: None)
    written = integrated(names, substeps)
    assert np.abs(written - integrated([], substeps)).max() > 1e-3 * np.abs(written).max()
    np.testing.assert_allclose(evaluated, written, atol=1e-8 * np.abs(written).max())


def test_a_mass_that_nothing_holds_or_brakes_falls():
    """Its step has one direction of its own only, so it is marched as it is: s = a t^2/2."""
    n, a, one = 3000, 0.7, np.ones((2, 1, 1))
    rows = ChannelRows(at_q=np.ones((1, 1)), at_v=np.zeros((1, 1)), at_a=np.zeros((1, 1)), rest=np.zeros(1))
    system = discretise(one, 0 * one, 0 * one, np.ones((1, 1)), rows, H)
    empty = {"load": np.zeros((n, 0)), "noise": np.ones(1), "scale": np.ones(1)}
    run = Signals(name="r", role="fit", h=H, y=np.zeros((n, 1)), u=np.zeros((n, 1)), at_rest=True, **empty)
    y = integrate(system, np.full((n, 1, 1, 1), a), 1, [], [], ([], []), np.zeros((2, 1, 2)), [run], 1)
    np.testing.assert_allclose(y[:, 1, 0, 0], 0.5 * a * (H * np.arange(n)) ** 2, rtol=1e-9, atol=1e-12)


def test_a_trial_that_no_number_holds_is_marched_without_a_word():
    rows = ChannelRows(at_q=np.ones((1, 1)), at_v=np.zeros((1, 1)), at_a=np.zeros((1, 1)), rest=np.zeros(1))
    one = np.ones((1, 1, 1))
    system = replace(discretise(one, one, one, np.ones((1, 1)), rows, H), A=np.full((1, 2, 2), np.inf))
    empty = {"load": np.zeros((9, 0)), "noise": np.ones(1), "scale": np.ones(1)}
    run = Signals(name="r", role="fit", h=H, y=np.zeros((9, 1)), u=np.zeros((9, 1)), at_rest=True, **empty)
    with np.errstate(all="ignore"):
        y = integrate(system, np.ones((9, 1, 1, 1)), 1, [], [], ([], []), np.zeros((1, 1, 2)), [run], 1)
    assert not np.isfinite(y[-1]).any()


def test_modes_are_marched_as_their_matrices_say():
    """Against a plain recursion, with a brake so strong that one mode does not swing."""
    n, rng = 700, np.random.default_rng(4)
    M, K, C = np.eye(3)[None], np.diag([30.0, 500.0, 4000.0])[None], np.diag([0.1, 200.0, 2.0])[None]
    C = C + 0.05
    at_q, at_v, at_a = rng.standard_normal((3, 2, 3))
    rows = ChannelRows(at_q=at_q, at_v=at_v, at_a=at_a, rest=np.zeros(2))
    system = discretise(M, C, K, rng.standard_normal((3, 2)), rows, H)
    u, x = rng.standard_normal((n, 1, 1, 2)), rng.standard_normal(6)
    empty = {"load": np.zeros((n, 0)), "noise": np.ones(2), "scale": np.ones(2)}
    run = Signals(name="r", role="fit", h=H, y=np.zeros((n, 2)), u=u[:, 0, 0], at_rest=False, **empty)
    y = integrate(system, u, 2, [], [], ([], []), x[None, None], [run], 1)[:, 0, 0]
    for k in range(n):
        np.testing.assert_allclose(y[k], system.C[0] @ x + system.D[0] @ u[k, 0, 0], atol=1e-9)
        x = system.A[0] @ x + system.B[0] @ u[k, 0, 0]


def evaluated(effect: PortEffect, z: np.ndarray, v: np.ndarray, t0: float = 0.0, command: float = 0.0) -> np.ndarray:
    values = {p.name: float(np.sqrt(p.low * p.high)) for p in effect.parameters}
    memory, out = effect.memory(z.shape[1:]), []
    for k in range(len(z)):
        force, memory = effect.force(z[k], v[k], values, Step(h=H, t=t0 + k * H, command=command), memory)
        out.append(force + 0.0 * z[k])
    return np.array(out)


@pytest.mark.parametrize("effect", [e for e in PORTS if e.response != "any"], ids=lambda e: e.name)
def test_what_a_law_says_of_its_response_is_true(effect):
    rng = np.random.default_rng(2)
    z, v = rng.standard_normal((2, 50, 1)), rng.standard_normal((2, 50, 1))
    one, two = (evaluated(effect, z[i], v[i]) for i in range(2))
    if effect.response == "none":
        np.testing.assert_array_equal(one, two)
        return
    np.testing.assert_allclose(
        evaluated(effect, z[0] - 2 * z[1], v[0] - 2 * v[1]), one - 2 * two, atol=1e-9 * np.abs(one).max()
    )
    np.testing.assert_array_equal(evaluated(effect, z[0], v[0], t0=3.0, command=2.0), one)


def test_some_laws_of_every_response_are_in_the_catalogue():
    assert {e.response for e in PORTS} == {"any", "linear", "none"}


@pytest.mark.parametrize("name", ["jenkins-slip", "bouc-wen", "viscous"])
def test_a_force_of_the_velocity_takes_off_the_energy_that_it_should(name):
    """A mass on a spring rings down 250 cycles of 16 steps. A force that is late by half a step would feed or brake it by
    omega h/2 of the energy in its loop's stiffness, which is many times what friction takes here."""
    h, n = 1.0 / 16.0, 4000
    rows = ChannelRows(at_q=np.array([[1.0]]), at_v=np.zeros((1, 1)), at_a=np.zeros((1, 1)), rest=np.zeros(1))
    values = {"jenkins-slip": {"force": 2.0, "slip": 5.0}, "bouc-wen": {"force": 4.0, "yield": 20.0}}
    values |= {"viscous": {"damping": 2e-3}}
    effect = Viscous() if name == "viscous" else EFFECTS[name]
    term = Term(effect=effect, place=place("one", [1.0]), values=values[name])

    def last_amplitude(substeps: int) -> float:
        omega = (2 * np.pi) ** 2
        one = np.ones((1, 1, 1))
        system = discretise(one, 1e-3 * one, omega * one, np.ones((1, 1)), rows, h / substeps)
        empty = {"load": np.zeros((n, 0)), "noise": np.ones(1), "scale": np.ones(1)}
        run = Signals(name="r", role="fit", h=h, y=np.zeros((n, 1)), u=np.zeros((n, 0)), at_rest=False, **empty)
        own = [{k: np.array([v]) for k, v in values[name].items()}]
        y = integrate(
            system,
            np.zeros((n, 1, 1, 0)),
            0,
            [term],
            own,
            ([0], [term.place.rows[0]]),
            np.array([[[1.0, 0.0]]]),
            [run],
            substeps,
        )
        return float(np.abs(y[-16:, 0, 0, 0]).max())

    assert last_amplitude(1) == pytest.approx(last_amplitude(16), rel=0.02)


class Viscous(PortEffect):
    """A damper as a force at a port: a law that the march does not fold."""

    name, family, law, words = "viscous", "damping", "F = -c v", "a damper"
    parameters = (Parameter(name="damping", unit="N s/m", low=1e-6, high=1e6),)

    def force(self, z, v, p, step, memory):
        return -p["damping"] * v, memory


@pytest.mark.parametrize("name", [e.name for e in PORTS if e.response == "linear"])
def test_what_a_linear_law_remembers_is_what_its_steps_leave(name):
    rng, effect = np.random.default_rng(2), EFFECTS[name]
    p = {k: np.array([v, 1.5 * v, 0.7 * v])[:, None] for k, v in LAWS[name].items()}
    y, before = np.zeros((5, 1)), rng.standard_normal((700, 4)).cumsum(axis=0)
    run = Signals(
        name="part", role="fit", h=H, y=y, u=y, load=y[:, :0], noise=y[0], scale=y[0], at_rest=False, t0=0.0,
        before=before, start=before[-1],
    )  # fmt: skip
    row = np.array([1.0, -0.4])
    (whole,) = np.asarray(_remember(effect, row, p, [run], SETS)).transpose(2, 0, 1)
    memory, seen = effect.memory((SETS, 1)), np.vstack([before, before[-1]])
    z, v = seen[:, :2] @ row, seen[:, 2:] @ row
    for k in range(700):
        middle = [np.full((SETS, 1), 0.5 * (x[k] + x[k + 1])) for x in (z, v)]
        memory = effect.force(*middle, p, Step(h=H), memory)[1]
    by_steps = np.array(memory)[..., 0]
    assert np.abs(by_steps).max() > 0.1
    assert whole == pytest.approx(by_steps, rel=1e-9, abs=1e-9)
