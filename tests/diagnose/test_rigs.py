"""The made-up rigs: complete cases, integrated as MuJoCo would where nothing is hidden, and not where something is."""

import numpy as np
import pyarrow.parquet as pq
import pytest
import rig_oscillator
import rigs
from rigs import EFFECTS, oscillator_case, pendulum_case, two_link_case
from scipy.integrate import solve_ivp

from vlab.cases import compare_case, load_case, simulate
from vlab.cases.initial_state import InitialState


def samples(rig, column, record):
    return pq.read_table(rig.folder / f"{record}.parquet")[column].to_numpy()


def change(rig, null, record, columns):
    """Rms change of the columns against the null case of the same seed, over their rms."""
    pairs = [(samples(rig, c, record), samples(null, c, record)) for c in columns]
    return max(np.std(a - b) / np.std(b) for a, b in pairs)


def test_a_pendulum_without_drag_swings_as_in_mujoco(tmp_path):
    rig = pendulum_case(tmp_path, effect=False, benign=0.0)
    case = load_case(tmp_path)
    for run in case.runs():
        assert np.ptp(np.diff(run.measured.time)) > 0.01  # irregular: 4 to 16 ms
        (angle, rate) = rig.starts[run.name]
        start = InitialState(qpos=np.array([angle]), qvel=np.array([rate]), how="given")
        left = simulate(case.plant, run, initial=start).recording["angle"] - run.measured["angle"]
        # Noise of 1 mrad and nothing else: 2000 samples give its rms within 5 % (three standard deviations).
        assert left.std() == pytest.approx(rigs.NOISE, rel=0.05)


def test_the_start_of_a_small_swing_is_found(tmp_path):
    pendulum_case(tmp_path, effect=False, benign=0.0)
    run = next(r for r in compare_case(tmp_path, roles=("fit",)).runs if r.run.name == "45 degrees")
    assert run.misfits[0].nrmse < 0.01  # noise of 1 mrad on 0.5 rad rms; the estimate of the start


def test_drag_takes_the_pendulum_down(tmp_path):
    rig, null = pendulum_case(tmp_path / "drag"), pendulum_case(tmp_path / "null", effect=False)
    assert (rig.effect, rig.place) == ("quadratic-drag", "joint:pivot")
    for record, least in (("120_degrees", 0.4), ("45_degrees", 0.2)):  # it goes with the amplitude
        ends = [np.abs(samples(r, "angle", record)[-300:]).max() for r in (rig, null)]
        assert ends[0] < (1 - least) * ends[1]
    assert np.degrees(np.abs(samples(null, "angle", "120_degrees")).max()) > 110
    assert load_case(rig.folder).recordings(("holdout",))[0][0] == "105 degrees"


def test_an_arm_without_friction_moves_as_in_mujoco(tmp_path):
    two_link_case(tmp_path, effect=False, benign=0.0)
    for name, nrmse in compare_case(tmp_path).nrmse.items():
        # Noise of 1e-3 rad on 0.15 to 0.8 rad rms is at most 0.7 %.
        assert nrmse < 0.01, name


@pytest.mark.slow
def test_friction_in_the_elbow_changes_the_arm(tmp_path):
    rig, null = two_link_case(tmp_path / "dry"), two_link_case(tmp_path / "null", effect=False)
    assert (rig.effect, rig.place) == ("coulomb-friction", "joint:elbow")
    changes = [change(rig, null, record, ["elbow"]) for record in ("small", "large")]
    assert changes[0] > changes[1] > 0.1  # dry friction matters most where the motion is small
    assert max(np.abs(samples(rig, "elbow", "large"))) > np.pi / 4  # far beyond a linearisation
    assert all(nrmse < 1.0 for nrmse in compare_case(rig.folder).nrmse.values())  # no run away from the recording


def test_three_masses_without_an_effect_move_as_in_mujoco(tmp_path):
    oscillator_case(tmp_path, benign=0.0)
    for name, nrmse in compare_case(tmp_path).nrmse.items():
        assert nrmse == pytest.approx(rig_oscillator.NOISE, rel=0.05), name  # nothing but the noise


def test_a_nonlinear_chain_moves_as_scipy_says():
    chain = rig_oscillator._built(np.random.default_rng(0), 1.0)
    row, k3, u = rig_oscillator._row("tendon:spring2"), 4e6, np.full((200, 1), 5.0)
    got = rig_oscillator._integrate(chain, u, row, rig_oscillator._law("cubic-stiffness", {"k3": k3}, 0.0), 0.0)[
        :, :, 0
    ]
    k, c = chain.stiffness, chain.damping

    def rate(_, x):
        d = np.array([x[0], x[1] - x[0], x[2] - x[1]])
        v = np.array([x[3], x[4] - x[3], x[5] - x[4]])
        pull = k * d + c * v + np.array([0, k3 * d[1] ** 3, 0])
        force = np.array([5.0 * chain.gain - pull[0] + pull[1], pull[2] - pull[1], -pull[2]])
        return np.concatenate([x[3:], force / chain.masses])

    time = np.arange(200) / rig_oscillator.RATE
    exact = solve_ivp(rate, (0, time[-1]), np.zeros(6), "DOP853", time, rtol=1e-10, atol=1e-12).y.T
    # Second order in the force: (70 rad/s x 0.5 ms)^2/12 of its change.
    np.testing.assert_allclose(got, exact, atol=1e-4 * np.abs(exact).max())


def test_dry_friction_holds_and_then_lets_go():
    chain = rig_oscillator._built(np.random.default_rng(0), 0.0)
    row = rig_oscillator._row("joint:mass1")
    held, free_starts = (
        rig_oscillator._integrate(chain, np.full((500, 1), force), row, None, 1.0)[:, 0, 0] for force in (0.99, 1.01)
    )
    assert np.abs(held).max() < 1e-12
    assert free_starts.max() > 0


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_makes_a_case_of_its_own(effect, tmp_path, monkeypatch):
    monkeypatch.setattr(rig_oscillator, "SECONDS", 4.0)  # two seconds of lines 0.5 Hz apart, twice
    rig = oscillator_case(tmp_path / "rig", effect=effect, seed=1)
    case = load_case(rig.folder)
    assert [len(case.recordings((role,))) for role in ("fit", "holdout")] == [3, 2]
    null = oscillator_case(tmp_path / "null", seed=1)
    changed = change(rig, null, "multisine_4_N", ["y1", "y2", "y3"])
    # 0 is the null case itself; hum and offset were sized at the middle level (an offset has no standard deviation).
    least = {"none": -1.0, "sensor-offset": -1.0}.get(effect, 0.05)
    assert changed > least
    if effect == "none":
        assert changed == 0.0
    if effect == "sensor-offset":
        shift = samples(rig, "y1", "multisine_4_N") - samples(null, "y1", "multisine_4_N")
        np.testing.assert_allclose(shift, rig.parameters["offset"])


def test_an_effect_can_be_moved_and_sized_and_comes_out_the_same_twice(tmp_path, monkeypatch):
    monkeypatch.setattr(rig_oscillator, "SECONDS", 4.0)
    first, again, larger, elsewhere = (
        oscillator_case(tmp_path / str(i), effect="coulomb-friction", sensors="velocity", **given)
        for i, given in enumerate(({}, {}, {"size": 2.0}, {"place": "tendon:spring1"}))
    )
    assert (first.folder / "sweep.parquet").read_bytes() == (again.folder / "sweep.parquet").read_bytes()
    assert larger.parameters["force"] == 2 * first.parameters["force"]
    assert elsewhere.place == "tendon:spring1"
    assert change(elsewhere, first, "sweep", ["y1"]) > 0.01
    assert compare_case(first.folder, roles=("holdout",)).nrmse.keys() == {"sweep", "other multisine"}
