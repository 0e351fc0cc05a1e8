"""Linear systems marched along their own directions, beside plain recursions and scipy's integration."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag, expm

from vlab.diagnose.predictors.modal_integration import LoopLaw, Marched, integrate_modes, modes_of
from vlab.physics.catalogue import EFFECTS
from vlab.physics.expression import trace_expression


def steps(seed=0, n_sets=2) -> np.ndarray:
    """Return stable steps of two turning pairs and one direction that only shrinks, in mixed coordinates."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(n_sets):
        a, b = rng.uniform(0.1, 1.5, 2)
        turns = [0.99 * np.array([[np.cos(x), np.sin(x)], [-np.sin(x), np.cos(x)]]) for x in (a, b)]
        mix = rng.standard_normal((5, 5))
        out.append(mix @ block_diag(*turns, [[0.7]]) @ np.linalg.inv(mix))
    return np.array(out)


# ---- own directions -------------------------------------------------------------------------------------------------


def test_states_turned_along_own_directions_are_states_stepped():
    step, x = steps(), np.random.default_rng(1).standard_normal((2, 3, 5))
    modes = modes_of(step)
    assert modes.dense.size == 0
    assert modes.turn.shape == (2, 2, 3)  # a pair is one number
    turn = modes.turn[0] + 1j * modes.turn[1]
    for k in range(5):
        there = (x @ modes.into) * turn[:, None] ** k
        np.testing.assert_allclose((there @ modes.back).real, x @ np.linalg.matrix_power(step, k), atol=1e-10)


@pytest.mark.parametrize(
    "step", [np.array([[[1.0, 0.0], [0.01, 1.0]]]), np.array([[[np.nan, 0.0], [0.0, 1.0]]])], ids=["drift", "nan"]
)
def test_a_step_without_own_directions_is_kept_as_it_is(step):
    """As of a mass that nothing holds or brakes, and of a trial that no number holds."""
    modes = modes_of(step)
    np.testing.assert_array_equal(modes.dense, step)
    x = np.random.default_rng(2).standard_normal((1, 3, 2))
    np.testing.assert_array_equal((x @ modes.into @ modes.back).real, x)


# ---- the march under inputs -----------------------------------------------------------------------------------------


def system(step, n_inputs=3, p=2, seed=3) -> Marched:
    rng, (n_sets, width, _) = np.random.default_rng(seed), step.shape
    return Marched(
        step=step,
        into=rng.standard_normal((n_sets, n_inputs, width)),
        channels=rng.standard_normal((n_sets, width, p)),
        direct=rng.standard_normal((n_sets, n_inputs, p)),
        seen=rng.standard_normal((width, 2)),
    )


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("is_dense", [False, True])
def test_a_march_is_the_recursion_that_its_matrices_say(substeps, is_dense):
    """The first inputs stand over a sample; the others have a value for every substep, and channels read the first."""
    rng, n = np.random.default_rng(4), 40
    step = np.array([[[1.0, 0.0], [0.01, 1.0]]] * 2) if is_dense else steps()
    own = system(step)
    part, given = rng.standard_normal((n, 1, 2, 1)), rng.standard_normal((n, substeps, 2, 2, 2))
    starts = rng.standard_normal((2, 2, step.shape[1]))
    y = integrate_modes(own, [], part, given, starts, np.zeros(2), 0.01)
    x = starts.copy()
    for k in range(n):
        u = [np.concatenate([np.broadcast_to(part[k], (2, 2, 1)), given[k, j]], axis=-1) for j in range(substeps)]
        np.testing.assert_allclose(y[k], x @ own.channels + u[0] @ own.direct, atol=1e-9)
        for j in range(substeps):
            x = x @ own.step + u[j] @ own.into


def test_marches_add_up():
    rng, n = np.random.default_rng(5), 30
    own = system(steps())
    parts = rng.standard_normal((2, n, 1, 2, 3))
    none = np.zeros((n, 1, 2, 2, 0))
    starts = rng.standard_normal((2, 2, 2, 5))

    def integrate(part, start):
        return integrate_modes(own, [], part, none, start, np.zeros(2), 0.01)

    whole = integrate(parts[0] - 2 * parts[1], starts[0] - 2 * starts[1])
    np.testing.assert_allclose(whole, integrate(parts[0], starts[0]) - 2 * integrate(parts[1], starts[1]), atol=1e-9)


# ---- laws in the loop -----------------------------------------------------------------------------------------------

STIFFNESS, DAMPING, SECONDS = 40.0, 0.3, 2.0
LAWS = {
    "cubic-stiffness": {"k3": 60.0},
    "quadratic-drag": {"coefficient": 0.8},
    "sinusoidal-force": {"sine": 3.0, "cosine": -1.0, "frequency": 1.1},
    "bouc-wen": {"force": 2.0, "yield": 0.2},
}


def swung(name, h, late=(0.0, 0.35), sizes=(1.0, 0.5)):
    """Return a mass on a spring with a law at it, (n, sets, runs), and scipy's motion of the same."""
    rate = np.array([[0.0, 1.0], [-STIFFNESS, -DAMPING]])
    n, one = round(SECONDS / h), np.array([[0.0], [1.0]])
    whole = expm(np.block([[rate, one], [np.zeros((1, 3))]]) * h)
    own = Marched(
        step=np.array([whole[:2, :2].T] * len(sizes)),
        into=np.zeros((len(sizes), 0, 2)),
        channels=np.array([np.eye(2)[:, :1]] * len(sizes)),
        direct=np.zeros((len(sizes), 0, 1)),
        seen=np.eye(2),
    )
    effect, size = EFFECTS[name], np.array(sizes)[:, None]
    amplitudes = {p.name for p in effect.amplitudes}
    values = {k: v * (size if k in amplitudes else np.ones_like(size)) for k, v in LAWS[name].items()}
    graph = trace_expression(effect, h)
    assert graph is not None
    law = LoopLaw(
        graph=graph,
        values=[values[p.name] for p in effect.parameters],
        memory=effect.memory((len(sizes), len(late))) or [],
        push=np.array([whole[:2, 2]] * len(sizes)),
        direct=np.zeros((len(sizes), 1)),
        port=0,
        coil=None,
    )
    start = np.array([1.0, -2.0])
    starts = np.broadcast_to(start, (len(sizes), len(late), 2))
    none = np.zeros((n, 1, len(sizes), len(late), 0))
    y = integrate_modes(own, [law], np.zeros((n, 1, len(late), 0)), none, starts, np.array(late), h)[..., 0]
    exact = np.zeros_like(y)
    for s in range(len(sizes)):
        p = {k: v[s, 0] for k, v in values.items()}
        for r, t0 in enumerate(late):
            exact[:, s, r] = solve_ivp(
                equation(name, p, t0), (0, SECONDS), [*start, 0.0], "DOP853", np.arange(n) * h, rtol=1e-9, atol=1e-10,
                max_step=0.01,
            ).y[0]  # fmt: skip
    return y, exact


def equation(name, p, t0):
    """Return the rate of displacement, speed and the law's own state."""

    def rate(t, x):
        z, v, held = x
        slip = 0.0
        if name == "cubic-stiffness":
            force = -p["k3"] * z**3
        elif name == "quadratic-drag":
            force = -p["coefficient"] * abs(v) * v
        elif name == "sinusoidal-force":
            angle = 2 * np.pi * p["frequency"] * (t0 + t)
            force = p["sine"] * np.sin(angle) + p["cosine"] * np.cos(angle)
        else:  # of Bouc and Wen, with an exponent of two and equal weights
            force, slip = -p["force"] * held, (v - 0.5 * (abs(v) * abs(held) * held + v * held**2)) / p["yield"]
        return [v, -STIFFNESS * z - DAMPING * v + force, slip]

    return rate


@pytest.mark.parametrize("name", LAWS)
def test_a_law_in_the_loop_moves_a_mass_as_its_equation_of_motion(name):
    """The march is of second order: half the step leaves a quarter of the error."""
    coarse, fine = swung(name, 0.01), swung(name, 0.005)
    off, less = (np.abs(y - exact).max() for y, exact in (coarse, fine))
    size = np.abs(coarse[1]).max()
    assert off < 0.02 * size
    assert less < 0.35 * off
    assert np.abs(coarse[1][:, 0] - coarse[1][:, 1]).max() > 5 * off  # the law matters
