"""What units of effects do along a given motion, and runs that are filtered side by side."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from vlab.diagnose.parameters.discrete import discretise
from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.predictors.innovations import Cause, Group, convolved, impulses_of, middles
from vlab.diagnose.predictors.kalman import FilterGains, filter_gains, run_filter
from vlab.diagnose.predictors.unit_effects import commands_changed, port_series, unit_amplitudes
from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import ActuatorEffect, PortEffect, Step
from vlab.physics.servo import Servo, ServoEffect, at_servo

H = 0.004
SERVO = Servo(gain=2.0, damping=0.3)
_PORTS = [e for e in EFFECTS.values() if isinstance(e, PortEffect)]
PORTS = [at_servo(e, SERVO) if isinstance(e, ServoEffect) else e for e in _PORTS]
SIGNS = [e for e in EFFECTS.values() if isinstance(e, ActuatorEffect)]


def shape_of(effect) -> dict[str, float]:
    """Return values of an effect's shape that its law is not the same without."""
    usual = {"frequency": 5.0, "centre": 5.0, "damping_ratio": 0.05, "delay": 2.5 * H, "period": 3 * H, "jitter": H}
    return {p.name: usual.get(p.name, float(np.sqrt(abs(p.low) * p.high))) for p in effect.shapes}


def motion(n=200, runs=3):
    """Return a smooth motion of several runs, about as large as one, and its speed."""
    t = (np.arange(n) + 0.5)[:, None] * H
    phase = np.arange(runs)[None, :]
    return np.sin(20 * t + phase), 20 * np.cos(20 * t + phase)


# ---- units of amplitudes --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("effect", [e for e in PORTS if e.amplitudes], ids=lambda e: e.name)
def test_a_force_is_the_sum_of_its_amplitudes_times_their_units(effect):
    """Of the whole law along a motion, its memory included: the regression of a screening rests on it."""
    z, v = motion()
    shape, rng = shape_of(effect), np.random.default_rng(0)
    units = unit_amplitudes(effect, shape)
    sizes = rng.uniform(0.3, 2.0, len(units))
    values = {**shape, **{p.name: s for p, s in zip(effect.amplitudes, sizes, strict=True)}}
    whole = port_series(effect, z, v, values, H, command=0.7)
    parts = [s / effect.probe * port_series(effect, z, v, u, H, command=0.7) for s, u in zip(sizes, units, strict=True)]
    assert np.abs(whole).max() > 0
    np.testing.assert_allclose(sum(parts), whole, atol=1e-9 * np.abs(whole).max())


def test_a_law_without_amplitudes_is_tried_as_its_shape_alone():
    clipping = EFFECTS["actuator-clipping"]
    assert unit_amplitudes(clipping, {"limit": 0.4}) == [{"limit": 0.4}]
    assert unit_amplitudes(EFFECTS["sinusoidal-force"], {"frequency": 3.0}) == [
        {"frequency": 3.0, "sine": 1.0, "cosine": 0.0},
        {"frequency": 3.0, "sine": 0.0, "cosine": 1.0},
    ]


@pytest.mark.parametrize("effect", SIGNS, ids=lambda e: e.name)
def test_a_changed_command_is_the_given_one_and_the_change(effect):
    rng = np.random.default_rng(1)
    command, shape = rng.standard_normal((100, 2)).cumsum(axis=0), shape_of(effect)
    changed = commands_changed(effect, command, shape, H)
    assert changed.shape == (*command.shape, len(unit_amplitudes(effect, shape)))
    values = {**shape, **{p.name: 0.3 for p in effect.amplitudes}}
    size = 0.3 if effect.amplitudes else 1.0
    np.testing.assert_allclose(command + size * changed.sum(axis=-1), effect.actuate(command, values, H), atol=1e-12)
    alone = commands_changed(effect, command[:, :1], shape, H)
    np.testing.assert_allclose(changed[:, :1], alone, atol=1e-12)  # runs know nothing of each other


# ---- forces along a motion ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("effect", [e for e in PORTS if not e.is_fast], ids=lambda e: e.name)
def test_a_force_along_a_motion_is_that_of_its_steps(effect):
    z, v = motion()
    values = {**{p.name: 1.3 for p in effect.amplitudes}, **shape_of(effect)}
    starts = np.array([0.0, 0.4, 2.0])
    found = port_series(effect, z, v, values, H, starts=starts)
    memory, out = effect.memory(z.shape[1:]), []
    for k in range(len(z)):
        force, memory = effect.force(z[k], v[k], values, Step(h=H, t=starts + (k + 0.5) * H), memory)
        out.append(force + 0.0 * z[k])
    np.testing.assert_allclose(found, out, atol=1e-9 * max(np.abs(out).max(), 1e-12))


def test_a_fast_law_is_followed_between_the_samples():
    # complex amplitudes of motor and train, with the joint moved as sin(20 t)
    servo, w = Servo(gain=12.0, damping=0.35, inertia=0.006, drag=0.08), 20.0
    k, share = 140.0, 0.5
    values = {"stiffness": k, "damping_ratio": 0.1, "motor_share": share}
    train = k + 2j * w * 0.1 * np.sqrt(k * servo.inertia)
    loop, drag = servo.gain + 1j * w * servo.damping, 1j * w * share * servo.drag
    motor = train / (train + loop + drag - servo.inertia * w**2)
    force = train * (motor - 1) + loop - servo.inertia * w**2 + drag
    t = (np.arange(400) + 0.5) * H
    z, v = np.sin(w * t)[:, None], w * np.cos(w * t)[:, None]
    found = port_series(at_servo(EFFECTS["servo-compliance"], servo), z, v, values, H)[:, 0]
    exact = np.imag(force * np.exp(1j * w * t))
    settled = t > 0.8
    assert np.abs(found - exact)[settled].max() < 0.02 * np.abs(exact).max()


def test_a_force_of_time_counts_from_the_start_of_its_run():
    z, v = motion()
    starts, values = np.array([0.0, 0.13, 5.0]), {"sine": 2.0, "cosine": -0.5, "frequency": 7.0}
    found = port_series(EFFECTS["sinusoidal-force"], z, v, values, H, starts=starts)
    angle = 2 * np.pi * 7.0 * ((np.arange(len(z)) + 0.5)[:, None] * H + starts)
    np.testing.assert_allclose(found, 2.0 * np.sin(angle) - 0.5 * np.cos(angle), atol=1e-12)


@pytest.mark.parametrize("name", ["bouc-wen", "plastic-set"])
def test_a_law_that_runs_away_is_nothing_in_that_run_alone(name):
    z, v = motion()
    values = {**{p.name: 1.0 for p in EFFECTS[name].amplitudes}, **shape_of(EFFECTS[name])}
    wild, fast = z.copy(), v.copy()
    wild[50:, 1] = fast[50:, 1] = np.inf
    wild[80:, 1] = fast[80:, 1] = np.nan
    found = port_series(EFFECTS[name], wild, fast, values, H)
    usual = port_series(EFFECTS[name], z, v, values, H)
    np.testing.assert_array_equal(found[:, 1], 0.0)
    np.testing.assert_array_equal(found[:, [0, 2]], usual[:, [0, 2]])
    assert np.abs(usual).max() > 0


# ---- impulses -------------------------------------------------------------------------------------------------------


def observed(n=300, runs=2):
    """Return a twin of two modes seen by a position and an accelerometer, sampled, and its filter's last gain."""
    rng = np.random.default_rng(2)
    rows = ChannelRows(
        at_q=np.array([[1.0, 0.5], [0.0, 0.0]]),
        at_v=np.zeros((2, 2)),
        at_a=np.array([[0.0, 0.0], [1.0, -0.7]]),
        rest=np.zeros(2),
    )
    M, C, K = np.eye(2), np.diag([0.5, 2.0]), np.diag([300.0, 4000.0])
    system = discretise(M[None], C[None], K[None], np.eye(2), rows, H)
    gains = filter_gains(system, np.array([1e-4, 1e-2]), 0.1, 1e-4 * np.eye(4))
    return system, FilterGains(K=gains.K[-1:], S=gains.S[-1:], P=gains.P[-1:]), rng.standard_normal((n, runs, 2))


@pytest.mark.slow
def test_a_filter_shows_a_force_that_it_does_not_know_as_the_impulses_say():
    """Marched sample by sample without a filter's knowledge of it, then filtered."""
    system, gains, force = observed()
    A, B, C, D = system.A[0], system.B[0], system.C[0], system.D[0]
    n, runs, _ = force.shape
    x, y = np.zeros((runs, 4)), np.zeros((n, runs, 2))
    for k in range(n):
        y[k] = x @ C.T + force[k] @ D.T
        x = x @ A.T + force[k] @ B.T
    seen = run_filter(system, gains, 0 * force, y, np.full(runs, n), smooth=False).e
    impulses = impulses_of(system, gains.K[0], n)
    np.testing.assert_allclose(
        convolved(impulses[:, :, :2], force[..., None])[..., 0], seen, atol=1e-6 * np.abs(seen).max()
    )
    readings = run_filter(system, gains, 0 * force, force, np.full(runs, n), smooth=False).e
    np.testing.assert_allclose(
        convolved(impulses[:, :, 2:], force[..., None])[..., 0], readings, atol=1e-6 * np.abs(readings).max()
    )


@pytest.mark.parametrize("k", [1, 3])
def test_convolutions_are_those_of_sums(k):
    rng = np.random.default_rng(3)
    n, decay = 120, 0.8 ** np.arange(120)
    impulses = decay[:, None, None] * rng.standard_normal((n, 2, 3 if k == 3 else 1))
    series = rng.standard_normal((n, 2, impulses.shape[2], k))
    found = convolved(impulses, series)
    direct = np.zeros((n, 2, 2, k))
    for lag in range(n):
        direct[lag:] += np.einsum("pq,nrqk->nrpk", impulses[lag], series[: n - lag])
    np.testing.assert_allclose(found, direct, atol=1e-6 * np.abs(direct).max())


def test_a_decaying_impulse_response_is_a_filter_of_first_order():
    n, series = 400, np.random.default_rng(4).standard_normal((400, 1, 1, 1))
    found = convolved((0.9 ** np.arange(n))[:, None, None], series)[:, 0, 0, 0]
    np.testing.assert_allclose(found, lfilter([1.0], [1.0, -0.9], series[:, 0, 0, 0]), atol=1e-5)
    np.testing.assert_array_equal(convolved(np.zeros((n, 1, 1)), series), 0.0)


def test_causes_that_enter_alike_have_their_way_in_common():
    series, force = np.zeros((5, 1, 1)), np.array([1.0, -2.0])
    assert Cause(series=series, force=force).way == Cause(series=series + 1, force=force.copy()).way
    assert Cause(series=series, force=force).way != Cause(series=series, force=-force).way
    assert Cause(series=series, channel=2).way == Cause(series=series + 1, channel=2).way
    assert Cause(series=series, channel=2).way != Cause(series=series, channel=1).way


# ---- runs side by side ----------------------------------------------------------------------------------------------


def group_of(lengths, usable=None, first=0) -> Group:
    n = max(lengths)
    rng = np.random.default_rng(5)
    runs = [SimpleNamespace(h=H, t0=0.25 * i) for i in range(len(lengths))]
    y = rng.standard_normal((n, len(lengths), 2))
    own = Group(runs, None, None, None, y[..., :0], y[..., :0], y, np.array(lengths), usable, e=y)
    own.first, own.white = first, rng.standard_normal((2, 2))
    return own


def test_rows_are_the_whitened_samples_that_count_run_after_run_within_a_sample():
    usable = np.ones((9, 2, 2))
    usable[4, 1, 0] = usable[7, 0] = 0.0
    own = group_of((9, 6), usable, first=2)
    columns = np.random.default_rng(6).standard_normal((9, 2, 2, 3))
    rows = [own.white @ columns[k, r] for k in range(2, 9) for r in range(2) if k < (9, 6)[r] and usable[k, r].all()]
    np.testing.assert_allclose(own.rows(columns), np.concatenate(rows))
    assert own.counts.sum() == len(rows) == 7 + 4 - 2


def test_a_matrix_for_every_sample_whitens_as_one_for_all():
    own = group_of((9, 6), first=1)
    columns, one = np.random.default_rng(7).standard_normal((9, 2, 2, 3)), own.white
    all_alike = own.rows(columns)
    own.white = np.broadcast_to(one, (9, 2, 2, 2))
    np.testing.assert_allclose(own.rows(columns), all_alike)


def test_times_count_from_the_starts_of_the_recordings():
    own = group_of((9, 6))
    np.testing.assert_allclose(own.times[0], [0.0, 0.25])
    np.testing.assert_allclose(np.diff(own.times, axis=0), H)


def test_middles_of_a_free_motion_are_those_of_a_cosine():
    """Displacements are off by the third power of the step, speeds by its square, which an analytic motion shows."""
    omega = 12.0
    reduced_model = SimpleNamespace(m=1, M=np.eye(1), C=np.zeros((1, 1)), K=np.array([[omega**2]]))

    def off(h):
        t = np.arange(0.0, 1.0, h)[:, None, None]
        known = np.concatenate([np.cos(omega * t), -omega * np.sin(omega * t)], axis=2)
        own = SimpleNamespace(h=h, smoothed=SimpleNamespace(filtered=known), forces=np.zeros(t.shape))
        p, v, a = middles(reduced_model, own)
        mid = t + 0.5 * h
        exact = np.cos(omega * mid), -omega * np.sin(omega * mid), -(omega**2) * np.cos(omega * mid)
        return np.array([np.abs(x - y).max() for x, y in zip((p, v, a), exact, strict=True)])

    ratio = off(0.004) / off(0.002)
    assert ratio[0] == pytest.approx(8.0, rel=0.05)
    assert ratio[1] == pytest.approx(4.0, rel=0.05)
    assert ratio[2] == pytest.approx(8.0, rel=0.05)  # without a damper that of the displacement


def test_the_middle_under_a_constant_force_is_that_of_a_falling_mass():
    reduced_model = SimpleNamespace(m=1, M=np.array([[2.0]]), C=np.zeros((1, 1)), K=np.zeros((1, 1)))
    known = np.array([[[0.3, -1.0]]])
    own = SimpleNamespace(h=0.1, smoothed=SimpleNamespace(filtered=known), forces=np.array([[[5.0]]]))
    p, v, a = (float(x[0, 0, 0]) for x in middles(reduced_model, own))
    assert (p, v, a) == pytest.approx((0.3 - 0.05 + 0.5 * 2.5 * 0.05**2, -1.0 + 2.5 * 0.05, 2.5))
