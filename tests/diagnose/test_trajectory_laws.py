"""Laws at work along a motion, and their march: a law does the same about whichever motion."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.trajectory_integration import integrate_trajectory, trace_laws
from vlab.diagnose.predictors.trajectory_laws import Law, path_of
from vlab.diagnose.settings import TRAJECTORY_INTEGRATION
from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import PortEffect

MASS, DAMPING, STIFFNESS = np.diag([1.0, 0.6]), np.diag([0.3, 0.2]), np.array([[50.0, -20.0], [-20.0, 35.0]])
ROW = np.array([1.0, -0.4])
LAWS = {
    "viscous-damping": {"damping": 0.8},
    "added-mass": {"mass": 0.3},
    "stiffness-to-ground": {"stiffness": 15.0},
    "cubic-stiffness": {"k3": 30.0},
    "quadratic-drag": {"coefficient": 0.6},
    "coulomb-friction": {"force": 0.7},
    "bouc-wen": {"force": 1.5, "yield": 0.3},
    "sinusoidal-force": {"sine": 2.0, "cosine": -1.0, "frequency": 1.3},
}


def stepped(h):
    """Return what a step of the system does to a state, and what a force that is held over it adds."""
    rate = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(MASS, STIFFNESS), -np.linalg.solve(MASS, DAMPING)]]
    )
    force = np.vstack([np.zeros((2, 2)), np.linalg.inv(MASS)])
    whole = expm(np.block([[rate, force], [np.zeros((2, 6))]]) * h)
    return whole[:4, :4], whole[:4, 4:]


def term_of(name, values=None) -> Term:
    place = SimpleNamespace(name="joint:a", stiffness=0.0)
    return Term(effect=EFFECTS[name], place=place, values=values or LAWS[name])


def moved(name, motion, h, *, steps=1, starts=None, row=ROW, values=None, weight=0.0, compiled=True):
    """Return the states that a law gives along a motion (n, 4): of the motion and the deviation from it together."""
    n = len(motion)
    A, G = stepped(h / steps)
    defect = np.zeros((n, 1, 4))
    defect[:-1, 0] = motion[1:] - motion[:-1] @ stepped(h)[0].T
    rows = np.broadcast_to(row, (1, n, 1, 2))
    z, v = (np.einsum("lkwn,kn->lkw", rows, part) for part in (motion[:, :2], motion[:, 2:]))
    everywhere = np.broadcast_to(G, (n, 1, 4, 2))
    path = path_of(rows, z, v, defect, np.full((n, 1), h), everywhere, np.array([weight]), steps, h)
    term = term_of(name, values)
    own = {k: np.array([x]) for k, x in term.values.items()}
    memory = term.effect.memory((1, 1)) if isinstance(term.effect, PortEffect) else None
    law = Law(term, own, path, (np.arange(n) * h)[:, None], None, memory)
    start = np.zeros((1, 1, 4)) if starts is None else (starts - motion[0])[None, None]
    still = np.zeros((n, 1, 1, 4))
    if compiled:
        graphs = trace_laws([law])
        assert graphs is not None
        system = np.broadcast_to(A, (n, 1, 4, 4))
        states = integrate_trajectory(
            [law], graphs, system, still, defect[:, None], start, np.zeros((0, 1, 1, 2)), steps
        )
    else:
        states, x = still, start.copy()
        for k in range(n):
            states[k] = x
            for j in range(steps):
                free = x @ A.T
                law.push(k, j, x, free)
                x = free
            x = x - defect[k]
    return motion + states[:, 0, 0]


def far_motion(n, h):
    """Return some smooth motion that is none of the system's own, (n, 4)."""
    t = np.arange(n)[:, None] * h
    omega, phase = np.array([4.0, 9.0]), np.array([0.3, 1.0])
    return np.hstack([0.5 * np.sin(omega * t + phase), 0.5 * omega * np.cos(omega * t + phase)])


# ---- which motion a system is linear about --------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("name", LAWS)
def test_the_motion_that_a_system_is_linear_about_changes_nothing(name, compiled):
    """Of a linear system under a law: deviations from any motion add up with it to the same."""
    h, n = 0.01, 150
    start = np.array([0.4, -0.2, 1.0, 0.5])
    about_rest = moved(name, np.zeros((n, 4)), h, starts=start, compiled=compiled)
    about_motion = moved(name, far_motion(n, h), h, starts=start, compiled=compiled)
    np.testing.assert_allclose(about_motion, about_rest, atol=1e-9)
    free = moved(name, np.zeros((n, 4)), h, starts=start, compiled=compiled, values=dict.fromkeys(LAWS[name], 1e-9))
    assert np.abs(about_rest - free).max() > 0.02  # the law acts


@pytest.mark.slow
@pytest.mark.parametrize("name", ["viscous-damping", "cubic-stiffness", "quadratic-drag"])
def test_finer_steps_between_samples_go_on_along_the_same_motion(name):
    """Between samples the motion is a cubic, which is off by the fourth power of the interval."""
    start = np.array([0.4, -0.2, 1.0, 0.5])

    def apart(h):
        n = round(1.5 / h)
        rest = moved(name, np.zeros((n, 4)), h, starts=start, steps=4)
        return np.abs(moved(name, far_motion(n, h), h, starts=start, steps=4) - rest).max()

    assert apart(0.01) < 2e-3
    assert apart(0.005) < 0.3 * apart(0.01)


@pytest.mark.parametrize("name", LAWS)
def test_compiled_laws_march_as_those_written(name):
    h, n = 0.01, 120
    motion, start = far_motion(n, h), np.array([0.4, -0.2, 1.0, 0.5])
    for steps in (1, 4):
        fast, slow = (moved(name, motion, h, starts=start, steps=steps, compiled=c) for c in (True, False))
        np.testing.assert_allclose(fast, slow, atol=1e-10)


# ---- beside scipy's integration -------------------------------------------------------------------------------------


def force_of(name, p, z, v, t):
    if name == "cubic-stiffness":
        return -p["k3"] * z**3
    if name == "quadratic-drag":
        return -p["coefficient"] * abs(v) * v
    if name == "sinusoidal-force":
        angle = 2 * np.pi * p["frequency"] * t
        return p["sine"] * np.sin(angle) + p["cosine"] * np.cos(angle)
    return -p.get("damping", 0.0) * v - p.get("stiffness", 0.0) * z


@pytest.mark.parametrize(
    "name",
    ["viscous-damping", "stiffness-to-ground", "added-mass", "cubic-stiffness", "quadratic-drag", "sinusoidal-force"],
)
def test_a_law_moves_a_system_as_its_equation_of_motion(name):
    """The march is of second order: half the step leaves a quarter of the error."""
    start, p = np.array([0.4, -0.2, 1.0, 0.5]), LAWS[name]
    mass = MASS + p.get("mass", 0.0) * np.outer(ROW, ROW)

    def rate(t, x):
        force = force_of(name, p, ROW @ x[:2], ROW @ x[2:], t)
        return np.concatenate([x[2:], np.linalg.solve(mass, ROW * force - STIFFNESS @ x[:2] - DAMPING @ x[2:])])

    def off(h):
        time = np.arange(0.0, 1.5, h)
        exact = solve_ivp(rate, (0, time[-1]), start, "DOP853", time, rtol=1e-10, atol=1e-11).y.T
        return np.abs(moved(name, np.zeros_like(exact), h, starts=start) - exact)[:, :2].max()

    assert off(0.01) < 0.01
    assert off(0.005) < 0.3 * off(0.01)


def test_friction_stops_what_slides_after_its_braking_distance():
    """A free mass that slides at v0 under a force F comes to rest after m v0^2/(2 F), and stays there."""
    h, n, speed, force = 0.002, 600, 1.5, 2.0
    A, G = expm(np.array([[0.0, 1.0], [0.0, 0.0]]) * h), np.array([[0.5 * h * h], [h]])
    rows = np.ones((1, n, 1, 1))
    still, intervals = np.zeros((1, n, 1)), np.full((n, 1), h)
    everywhere = np.broadcast_to(G, (n, 1, 2, 1))
    path = path_of(rows, still, still, np.zeros((n, 1, 2)), intervals, everywhere, np.zeros(1), 1, h)
    law = Law(term_of("coulomb-friction"), {"force": np.array([force])}, path, np.zeros((n, 1)), None, None)
    x, states = np.array([[[0.0, speed]]]), []
    for k in range(n):
        states.append(x[0, 0].copy())
        free = x @ A.T
        law.push(k, 0, x, free)
        x = free
    states = np.array(states)
    assert states[-1, 0] == pytest.approx(speed**2 / (2 * force), rel=1e-3)
    np.testing.assert_allclose(states[-50:, 1], 0.0, atol=1e-12)
    slides = np.arange(n) * h < speed / force
    np.testing.assert_allclose(states[slides, 1], speed - force * np.arange(n)[slides] * h, atol=1e-9)


# ---- invariances of a law -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "power"),
    [
        ("viscous-damping", 2),
        ("stiffness-to-ground", 2),
        ("added-mass", 2),
        ("cubic-stiffness", 4),
        ("coulomb-friction", 1),
    ],
)
def test_a_coordinate_may_be_counted_in_any_unit(name, power):
    """A port that reads twice as much needs a constant that is less by a power of two."""
    h, n, start = 0.01, 100, np.array([0.4, -0.2, 1.0, 0.5])
    less = {k: v / 2**power for k, v in LAWS[name].items()}
    one = moved(name, np.zeros((n, 4)), h, starts=start)
    other = moved(name, np.zeros((n, 4)), h, starts=start, row=2 * ROW, values=less)
    np.testing.assert_allclose(other, one, atol=1e-10)


@pytest.mark.parametrize("name", LAWS)
def test_a_port_that_is_a_joint_is_read_as_any_other_row(name):
    """A joint is read off one coordinate; a row that is one but for rounding is multiplied out."""
    h, n, start = 0.01, 60, np.array([0.4, -0.2, 1.0, 0.5])
    motion = far_motion(n, h)
    joint, near = np.array([0.0, 1.0]), np.array([0.0, 1.0 + 1e-12])
    one, other = (moved(name, motion, h, starts=start, row=row, compiled=False) for row in (joint, near))
    np.testing.assert_allclose(other, one, atol=1e-9)


def test_added_mass_has_weight_along_gravity():
    """On springs it hangs lower by the springs' answer to its weight, once the swinging has died down."""
    h, n, gravity, mass = 0.01, 4000, -9.81, 0.3
    static = np.linalg.solve(STIFFNESS, ROW * mass * gravity)
    hung = moved("added-mass", np.zeros((n, 4)), h, values={"mass": mass}, weight=gravity)
    np.testing.assert_allclose(hung[-1, :2], static, atol=0.02 * np.abs(static).max())


@pytest.mark.parametrize("lines", [1, 3])
def test_an_impedance_answers_the_motion_that_it_causes_itself(lines):
    """Mass, damping and stiffness act on the means over a step of the motion with their own force in it."""
    rng, h = np.random.default_rng(1), 0.01
    A, G = stepped(h)
    rows = np.broadcast_to(rng.standard_normal((lines, 1, 1, 2)), (lines, 2, 1, 2))
    z, v = rng.standard_normal((2, lines, 2, 1))
    everywhere = np.broadcast_to(G, (2, 1, 4, 2))
    weight = rng.standard_normal(lines)
    path = path_of(rows, z, v, np.zeros((2, 1, 4)), np.full((2, 1), h), everywhere, weight, 1, h)

    class Both(type(EFFECTS["added-mass"])):
        def impedance(self, p, own_stiffness):
            return p["mass"], 5.0, 70.0

    term = Term(effect=Both(), place=SimpleNamespace(name="a", stiffness=0.0), values={})
    law = Law(term, {"mass": np.array([0.4])}, path, np.zeros((2, 1)), None, None)
    x = rng.standard_normal((1, 1, 4))
    free = x @ A.T
    alone = free.copy()
    push = law.push(0, 0, x, free)[0, 0]
    np.testing.assert_allclose(free, alone + G @ push, rtol=1e-12)
    row = rows[:, 0, 0]
    z0, v0 = path.z[0, :, 0, 0] + row @ x[0, 0, :2], path.v[0, :, 0, 0] + row @ x[0, 0, 2:]
    z1, v1 = path.z[1, :, 0, 0] + row @ free[0, 0, :2], path.v[1, :, 0, 0] + row @ free[0, 0, 2:]
    bend = h * (v1 - v0) / 12.0 if lines == 1 else 0.0
    force = -0.4 * ((v1 - v0) / h - weight) - 5.0 * 0.5 * (v0 + v1) - 70.0 * (0.5 * (z0 + z1) - bend)
    share = 1e-2 if lines == 3 else 1e-10  # of several rows the stiffness sees what is there without it
    np.testing.assert_allclose(row.T @ force, push, atol=share * np.abs(push).max())


# ---- paths ----------------------------------------------------------------------------------------------------------


def test_a_path_between_samples_is_the_cubic_through_both_states():
    """Of a motion that is a cubic of time it is that motion; its rates are the derivatives of its coordinates."""
    h, n, steps = 0.1, 6, 4
    t = np.arange(n) * h
    cubic = np.polynomial.Polynomial([0.3, -1.0, 2.0, 5.0])
    rows = np.ones((1, n, 1, 1))
    z, v = cubic(t)[None, :, None], cubic.deriv()(t)[None, :, None]
    path = path_of(rows, z, v, np.zeros((n, 1, 2)), np.full((n, 1), h), np.zeros((n, 1, 2, 1)), np.zeros(1), steps, h)
    assert path.steps == steps
    assert path.even == pytest.approx(h / steps)
    np.testing.assert_allclose(path.h, h / steps)
    for j in range(steps + 1):
        fine = (t + j / steps * h)[:-1]
        np.testing.assert_allclose(path.z[j, 0, :-1, 0], cubic(fine), atol=1e-12)
        np.testing.assert_allclose(path.v[j, 0, :-1, 0], cubic.deriv()(fine), atol=1e-12)


def test_a_path_ends_where_the_model_goes_and_not_where_the_motion_is():
    rng, h, n = np.random.default_rng(2), 0.1, 5
    rows, defect = rng.standard_normal((2, n, 3, 2)), rng.standard_normal((n, 3, 4))
    z, v = rng.standard_normal((2, 2, n, 3))
    path = path_of(rows, z, v, defect, np.full((n, 3), h), np.zeros((n, 3, 4, 2)), np.zeros(2), 3)
    np.testing.assert_allclose(path.z[0], z)
    np.testing.assert_allclose(path.v[0], v)
    np.testing.assert_allclose(path.rows[-1][:, :-1], rows[:, 1:])
    off = np.einsum("lkwn,kwn->lkw", rows[:, 1:], defect[:-1, :, :2])
    np.testing.assert_allclose(path.z[-1][:, :-1], z[:, 1:] - off)
    assert path.even is None


# ---- what the march says of itself ----------------------------------------------------------------------------------


def test_uneven_steps_have_graphs_and_linear_laws_need_none():
    n, h = 5, 0.01
    rows, still = np.broadcast_to(ROW, (1, n, 1, 2)), np.zeros((1, n, 1))

    def law(name, even):
        G = np.broadcast_to(stepped(h)[1], (n, 1, 4, 2))
        path = path_of(rows, still, still, np.zeros((n, 1, 4)), np.full((n, 1), h), G, np.zeros(1), 1, even)
        own = {k: np.array([v]) for k, v in LAWS[name].items()}
        return Law(term_of(name), own, path, np.zeros((n, 1)), None, None)

    assert trace_laws([law("viscous-damping", None)]) == [None]
    for even in (h, None):
        graphs = trace_laws([law("viscous-damping", even), law("cubic-stiffness", even)])
        assert graphs is not None
        assert [graph is None for graph in graphs] == [True, False]


def test_a_march_without_laws_is_the_recursion_of_its_matrices():
    rng, n = np.random.default_rng(3), 50
    A = 0.3 * rng.standard_normal((n, 3, 4, 4))
    drive, defect, starts = (
        rng.standard_normal((n, 2, 3, 4)),
        rng.standard_normal((n, 3, 4)),
        rng.standard_normal((2, 3, 4)),
    )
    states = integrate_trajectory([], [], A, drive, defect[:, None], starts, np.zeros((0, 2, 3, 2)), 2)
    x = starts
    for k in range(n):
        np.testing.assert_allclose(states[k], x, atol=1e-9)
        for _ in range(2):
            x = np.einsum("wab,swb->swa", A[k], x) + drive[k]
        x = x - defect[k]


def test_what_runs_away_in_one_set_stays_finite_and_leaves_the_others_alone():
    n = 400
    A = np.broadcast_to(np.diag([1.5, 0.5, 1.0, 1.0]), (n, 1, 4, 4))
    starts = np.array([[[1.0, 1.0, 1.0, 0.0]], [[0.0, 1.0, 1.0, 0.0]]])
    states = integrate_trajectory(
        [], [], A, np.zeros((n, 2, 1, 4)), np.zeros((n, 1, 1, 4)), starts, np.zeros((0, 2, 1, 2)), 1
    )
    assert np.isfinite(states).all()
    assert np.abs(states).max() <= TRAJECTORY_INTEGRATION.far * 1.5**8
    np.testing.assert_allclose(states[:, 1, 0, 1], 0.5 ** np.arange(n))


def test_the_forces_that_a_sensor_sees_are_those_of_the_first_step():
    """The change that a step makes beyond the free one is the force's, which here is the only one."""
    n, h = 40, 0.01
    A, G = stepped(h)
    rows, still = np.broadcast_to(ROW, (1, n, 1, 2)), np.zeros((1, n, 1))
    everywhere = np.broadcast_to(G, (n, 1, 4, 2))
    path = path_of(rows, still, still, np.zeros((n, 1, 4)), np.full((n, 1), h), everywhere, np.zeros(1), 1, h)
    law = Law(term_of("cubic-stiffness"), {"k3": np.array([30.0])}, path, np.zeros((n, 1)), None, None)
    forces, starts = np.zeros((n, 1, 1, 2)), np.array([[[0.4, -0.2, 1.0, 0.5]]])
    system = np.broadcast_to(A, (n, 1, 4, 4))
    states = integrate_trajectory(
        [law], trace_laws([law]), system, np.zeros((n, 1, 1, 4)), np.zeros((n, 1, 1, 4)), starts, forces, 1
    )
    beyond = states[1:, 0, 0] - states[:-1, 0, 0] @ A.T
    np.testing.assert_allclose(beyond, forces[:-1, 0, 0] @ G.T, atol=1e-12)
    assert np.abs(forces).max() > 0.1
