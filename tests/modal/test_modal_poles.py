"""Poles and shapes against the closed form of chains: eigenvalues, partial fractions, noise that is known."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from vlab.errors import BadRecording
from vlab.modal.frf import MeasuredFrequencyResponse, estimate_frf
from vlab.modal.mac import mac
from vlab.modal.poles import estimate_poles
from vlab.signals import Channel, FrequencyResponse, Recording

LINES = np.linspace(0.1, 12, 400)


def chain(n=8):
    """Fixed-fixed chain: frequencies 10 sin(k pi / (2 n + 2)) Hz, sine shapes of unit modal mass (closed form)."""
    k = np.arange(1, n + 1)
    shapes = np.sqrt(2 / (n + 1)) * np.sin(np.pi * np.outer(k, k) / (n + 1))
    return 10 * np.sin(k * np.pi / (2 * n + 2)), shapes


def mobility(freq, zeta, shapes, participation, lines=LINES):
    s, omega = 2j * np.pi * lines[:, None], 2 * np.pi * np.asarray(freq)
    modal = s / (s**2 + 2 * np.asarray(zeta) * omega * s + omega**2)
    return np.einsum("ok,ik,fk->foi", shapes, participation, modal)


def response(H, lines=LINES, **more):
    outputs, inputs = [f"v{i}" for i in range(H.shape[1])], [f"f{i}" for i in range(H.shape[2])]
    kind = MeasuredFrequencyResponse if more else FrequencyResponse
    return kind(freq=lines, H=H, outputs=outputs, inputs=inputs, unit="(m/s)/N", **more)


def noise(rng, H, share):
    """Complex noise, its deviation a share of the rms of each response."""
    sd = share * np.sqrt(np.mean(np.abs(H) ** 2, axis=0)) * np.ones(H.shape)
    return sd, sd / np.sqrt(2) * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))


def diagonal_mac(estimate, shapes):
    return np.diag(mac(shapes, estimate.shapes))


def test_exact_chain_with_damping_from_a_thousandth_to_a_half():
    freq, shapes = chain()
    zeta = np.array([0.001, 0.5, 0.002, 0.3, 0.01, 0.1, 0.001, 0.05])
    found = estimate_poles(response(mobility(freq, zeta, shapes, shapes[:1])))
    # the fit stops when misfits are below 1e-8 of the data; conditioning leaves 1e-6 and 1e-4 far away
    np.testing.assert_allclose(found.freq, freq, rtol=1e-6)
    np.testing.assert_allclose(found.zeta, zeta, rtol=1e-4)
    np.testing.assert_allclose(found.s, 2 * np.pi * freq * (-zeta + 1j * np.sqrt(1 - zeta**2)), rtol=1e-6)
    assert diagonal_mac(found, shapes).min() > 1 - 1e-9
    np.testing.assert_allclose(found.real_shapes(), shapes / _largest(shapes), atol=1e-6)
    assert found.n_nuisance == 0
    assert found.residual < 1e-7
    assert found.confidence.min() > 0.9


def _largest(shapes):
    """The first of the largest components: sine shapes have several alike."""
    size = np.abs(shapes)
    return shapes[np.argmax(size > (1 - 1e-6) * size.max(axis=0), axis=0), np.arange(shapes.shape[1])]


def test_poles_of_a_closed_loop_are_its_eigenvalues():
    # velocity feedback at three masses, not proportional: complex shapes, light and heavy damping side by side
    n = 6
    K = (2 * np.pi * 5) ** 2 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    C = 2e-5 * K + 0.02 * np.eye(n)
    C[0, 0] += 25.0
    C[2, 2] += 2.0
    C[5, 5] += 80.0
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -C]])
    poles, vectors = np.linalg.eig(A)
    keep = np.flatnonzero(poles.imag > 0)
    keep = keep[np.argsort(np.abs(poles[keep]))]
    poles, vectors = poles[keep], vectors[n:, keep]
    zeta = -poles.real / np.abs(poles)
    assert zeta.min() < 0.05
    assert zeta.max() > 0.3
    B = np.zeros((2 * n, 1))
    B[n + 1] = 1.0
    H = np.array([np.linalg.solve(2j * np.pi * f * np.eye(2 * n) - A, B)[n:] for f in LINES])
    found = estimate_poles(response(H))
    np.testing.assert_allclose(found.s, poles, rtol=1e-6)  # as above
    assert diagonal_mac(found, vectors).min() > 1 - 1e-8


@pytest.mark.parametrize("apart", [0.02, 0.003])
def test_a_close_pair_is_two_modes(apart):
    freq, zeta = np.array([3.0, 6.0, 6.0 * (1 + apart), 9.0]), np.array([0.004, 0.003, 0.003, 0.01])
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(4, 4))
    H = mobility(freq, zeta, shapes, np.ones((1, 4)))
    exact = estimate_poles(response(H))
    np.testing.assert_allclose(exact.freq, freq, rtol=1e-6)
    np.testing.assert_allclose(exact.zeta, zeta, rtol=1e-4)
    noisy = estimate_poles(response(H + noise(rng, H, 0.01)[1]))
    np.testing.assert_allclose(noisy.freq, freq, rtol=1e-4)  # the Cramer-Rao deviation is about 1e-5
    np.testing.assert_allclose(noisy.zeta, zeta, rtol=0.05)  # 0.5 % by the same bound at 2 % apart, 1.5 % at 0.3 %
    assert diagonal_mac(noisy, shapes).min() > 0.98


@pytest.fixture(scope="module")
def noisy_estimates():
    freq, shapes = chain()
    zeta = np.array([0.002, 0.01, 0.005, 0.03, 0.01, 0.02, 0.004, 0.01])
    H = mobility(freq, zeta, shapes, shapes[:1])
    runs = []
    for seed in range(4):
        sd, error = noise(np.random.default_rng(seed), H, 0.01)
        known = {"variance": sd**2, "n_averages": 100.0} if seed % 2 else {}
        runs.append(estimate_poles(response(H + error, **known)))
    return freq, zeta, shapes, runs


def test_one_per_cent_noise_is_withstood_with_every_seed(noisy_estimates):
    freq, zeta, shapes, runs = noisy_estimates
    for found in runs:
        np.testing.assert_allclose(found.freq, freq, rtol=1e-3)  # required; deviations by the estimate are below 2e-4
        np.testing.assert_allclose(found.zeta, zeta, rtol=0.05)  # required; deviations below 1.5 %
        assert diagonal_mac(found, shapes).min() >= 0.98  # required
        assert found.confidence.min() > 0.8
        assert found.residual == pytest.approx(0.01, rel=0.1)  # the noise, less the few numbers fitted to it


def test_standard_deviations_are_those_of_the_estimates(noisy_estimates):
    freq, zeta, _, runs = noisy_estimates
    freq_error = np.array([(found.freq - freq) / found.freq_sd for found in runs])
    zeta_error = np.array([(found.zeta - zeta) / found.zeta_sd for found in runs])
    # the rms of 32 normal numbers is 1 within 12.5 %; 2.4 deviations
    assert np.sqrt(np.mean(freq_error**2)) == pytest.approx(1.0, abs=0.3)
    assert np.sqrt(np.mean(zeta_error**2)) == pytest.approx(1.0, abs=0.3)


def test_twelve_modes_of_twenty_responses():
    rng = np.random.default_rng(1)
    freq = np.array([0.9, 1.3, 2.1, 2.2, 3.4, 4.4, 5.1, 6.3, 7.0, 8.2, 9.6, 9.75])
    zeta = np.geomspace(0.03, 0.003, 12)
    shapes = rng.normal(size=(20, 12))
    lines = np.arange(0.3, 10.3, 0.025)
    H = mobility(freq, zeta, shapes, np.ones((1, 12)), lines)
    found = estimate_poles(response(H + noise(rng, H, 0.01)[1], lines))
    # the heaviest damped first mode is lowest above the noise; its own deviation is 0.03 % and 1 %
    np.testing.assert_allclose(found.freq, freq, rtol=2e-3)
    np.testing.assert_allclose(found.zeta, zeta, rtol=0.05)
    assert diagonal_mac(found, shapes).min() > 0.98


def test_two_inputs_give_participation_and_residues():
    freq, shapes = chain(4)
    zeta = np.array([0.01, 0.2, 0.003, 0.05])
    found = estimate_poles(response(mobility(freq, zeta, shapes, shapes[[0, 2]])))
    np.testing.assert_allclose(found.zeta, zeta, rtol=1e-4)
    # s / ((s - p)(s - p*)) has the residue p / (p - p*) at p
    factor = found.s / (2j * found.s.imag)
    exact = np.einsum("ok,ik,k->koi", shapes, shapes[[0, 2]], factor)
    np.testing.assert_allclose(np.einsum("ok,ik->koi", found.shapes, found.participation), exact, atol=1e-8)


@pytest.mark.parametrize(("low", "high"), [(2.0, 8.0), (6.0, 9.2)])
def test_modes_outside_the_band_do_not_spoil_those_inside(low, high):
    freq, shapes = chain()
    zeta = np.array([0.004, 0.002, 0.01, 0.003, 0.005, 0.02, 0.001, 0.01])
    lines = np.linspace(0.1, 12, 600)
    found = estimate_poles(response(mobility(freq, zeta, shapes, shapes[:1], lines), lines), band_hz=(low, high))
    inside = (freq > low) & (freq < high)
    # five powers of s stand for what is outside; near the edge of the band a pole outside joins the fit
    np.testing.assert_allclose(found.freq, freq[inside], rtol=1e-5)
    np.testing.assert_allclose(found.zeta, zeta[inside], rtol=1e-3)


def test_uneven_lines_do():
    freq, shapes = chain(5)
    zeta = np.array([0.002, 0.3, 0.01, 0.001, 0.05])
    lines = np.sort(np.random.default_rng(3).choice(LINES, 110, replace=False))
    found = estimate_poles(response(mobility(freq, zeta, shapes, shapes[:1], lines), lines))
    np.testing.assert_allclose(found.freq, freq, rtol=1e-6)
    np.testing.assert_allclose(found.zeta, zeta, rtol=1e-4)


def sampled_recording(freq, zeta, shapes, fs, period, n_periods):
    """A periodic record of a sampled system with zero-order hold (each mode by itself, exactly)."""
    rng = np.random.default_rng(4)
    n = int(period * fs)
    spectrum = np.zeros(n // 2 + 1, complex)
    spectrum[4 : n // 2] = np.exp(2j * np.pi * rng.uniform(size=n // 2 - 4))
    u = np.tile(np.fft.irfft(spectrum, n) * np.sqrt(n), n_periods)
    y = np.zeros((u.size, len(shapes)))
    for omega, z, shape in zip(2 * np.pi * freq, zeta, shapes.T, strict=True):
        A, B = np.array([[0, 1], [-(omega**2), -2 * z * omega]]), np.array([[0.0], [1.0]])
        Ad, Bd, *_ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), 1 / fs)
        # velocity from force: second row of (zI - A)^-1 B, its numerator z B2 + (A21 B1 - A11 B2)
        numerator = [0.0, Bd[1, 0], Ad[1, 0] * Bd[0, 0] - Ad[0, 0] * Bd[1, 0]]
        y += np.outer(lfilter(numerator, np.poly(Ad), u), shape * shape[0])
    channels = [Channel(name="f", kind="force", unit="N", is_input=True)]
    channels += [Channel(name=f"v{i}", kind="velocity", unit="m/s") for i in range(y.shape[1])]
    return Recording(time=np.arange(u.size) / fs, data=np.column_stack([u, y]), channels=channels)


def test_sampled_system_up_to_half_its_rate():
    freq, shapes = chain(4)
    freq, zeta = freq / 2, np.array([0.02, 0.5, 0.03, 0.04])  # 1.5 to 4.8 Hz of 6: far from continuous
    test = sampled_recording(freq, zeta, shapes, fs=12.0, period=20.0, n_periods=12)
    frf = estimate_frf(test, period_s=20.0, skip_s=180.0)  # exp(-0.02 * 2 pi * 1.5 * 180) = 1e-15 of the transient
    found = estimate_poles(frf, sample_rate=12.0)
    np.testing.assert_allclose(found.freq, freq, rtol=1e-6)
    np.testing.assert_allclose(found.zeta, zeta, rtol=1e-4)
    assert diagonal_mac(found, shapes).min() > 1 - 1e-8


def test_order_of_responses_does_not_matter():
    freq, shapes = chain(5)
    rng = np.random.default_rng(5)
    H = mobility(freq, np.full(5, 0.01), shapes, shapes[:2])
    H = H + noise(rng, H, 0.003)[1]
    a = estimate_poles(response(H))
    b = estimate_poles(response(H[:, ::-1, ::-1]))
    # sums in another order: the fit stops within 1 % of the deviation of a parameter
    assert np.max(np.abs(a.freq - b.freq) / a.freq_sd) < 0.02
    assert np.max(np.abs(a.zeta - b.zeta) / a.zeta_sd) < 0.02
    assert np.min(diagonal_mac(b, a.shapes[::-1])) > 1 - 1e-6


def test_number_of_modes_can_be_asked_for_and_the_chart_marks_stable_poles():
    freq, shapes = chain(5)
    zeta = np.full(5, 0.01)
    H = mobility(freq, zeta, shapes, shapes[:1])
    found = estimate_poles(
        response(H + noise(np.random.default_rng(6), H, 0.001)[1]), n_modes=3, orders=range(4, 30, 2)
    )
    assert found.freq == pytest.approx(freq[:3], rel=1e-3)  # the first ones, not the largest
    assert found.n_nuisance == 2
    chart = found.stabilisation
    assert set(chart.order) <= set(range(4, 30, 2))
    stable = chart.freq[chart.is_stable]
    assert (
        np.min(np.abs(stable[:, None] / freq - 1), axis=0).max() < 1e-3
    )  # each mode shows as a column of stable poles
    assert np.all(chart.zeta > 0)
    model = found.to_modal_model()
    assert model.coordinates == ("v0", "v1", "v2", "v3", "v4")
    assert np.isrealobj(model.shapes)
    assert np.iscomplexobj(found.to_modal_model(is_real=False).shapes)
    np.testing.assert_allclose(np.max(np.abs(model.shapes), axis=0), 1.0)


@pytest.mark.parametrize("unit", [1e-9, 1e6])
def test_units_and_a_dead_channel_do_not_matter(unit):
    freq, shapes = chain(3)
    H = mobility(freq, [0.01, 0.1, 0.003], shapes, shapes[:1])
    H = H + noise(np.random.default_rng(8), H, 0.01)[1]
    plain = estimate_poles(response(H))
    other = estimate_poles(response(unit * np.concatenate([H, 0 * H[:, :1]], axis=1)))
    # the dead channel counts as data, which moves nothing but the deviations; the fit stops within 1 % of one
    assert np.max(np.abs(other.freq - plain.freq) / plain.freq_sd) < 0.02
    assert np.max(np.abs(other.zeta - plain.zeta) / plain.zeta_sd) < 0.02
    np.testing.assert_allclose(other.shapes[3], 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"band_hz": (20.0, 30.0)}, "0 usable lines"),
        ({"band_hz": (5.0, 4.0)}, "not a band"),
        ({"orders": [2, 1000]}, "can carry"),
        ({"orders": []}, "can carry"),
        ({"sample_rate": 0.1}, "0 usable lines"),
        ({"sample_rate": -1.0}, "must be positive"),
    ],
)
def test_refuses_what_cannot_give_poles(arguments, match):
    freq, shapes = chain(3)
    with pytest.raises(BadRecording, match=match):
        estimate_poles(response(mobility(freq, [0.01] * 3, shapes, shapes[:1])), **arguments)


def test_refuses_noise_and_nothing():
    rng = np.random.default_rng(7)
    H = rng.normal(size=(200, 3, 1)) + 1j * rng.normal(size=(200, 3, 1))
    with pytest.raises(BadRecording, match="no mode found"):
        estimate_poles(response(H, np.linspace(1, 10, 200)))
    with pytest.raises(BadRecording, match="zero"):
        estimate_poles(response(0 * H, np.linspace(1, 10, 200)))
