"""Frequency responses against closed forms: transfer functions, noise bias, coherence."""

import numpy as np
import pytest

from vlab.errors import BadRecording, UnknownName
from vlab.modal.frf import differentiate, estimate_frf, integrate, peak_levels
from vlab.signals import Channel, FrequencyResponse, Recording

FS = 100.0


def recording(inputs, outputs, *, fs=FS, time=None):
    x, y = np.atleast_2d(inputs), np.atleast_2d(outputs)
    labels = [Channel(name=f"force{i}", kind="force", unit="N", is_input=True) for i in range(len(x))]
    labels += [Channel(name=f"speed{i}", kind="velocity", unit="m/s") for i in range(len(y))]
    time = np.arange(x.shape[1]) / fs if time is None else time
    return Recording(time=time, data=np.vstack([x, y]).T, channels=labels)


def multisine(rng, n, lines):
    spectrum = np.zeros(n // 2 + 1, complex)
    spectrum[lines] = n * np.exp(2j * np.pi * rng.uniform(size=len(lines)))
    return np.fft.irfft(spectrum, n)


def discrete_system(rng, n_out=2):
    """Two oscillators with poles 0.9 from the origin: 600 samples leave 0.9^600 = 1e-28 of the transient."""
    blocks = [0.9 * np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) for a in (0.3, 1.1)]
    A = np.block([[blocks[0], np.zeros((2, 2))], [np.zeros((2, 2)), blocks[1]]])
    return A, rng.normal(size=(4, 1)), rng.normal(size=(n_out, 4)), rng.normal(size=(n_out, 1))


def transfer(system, freq, fs=FS):
    A, B, C, D = system
    z = np.exp(2j * np.pi * freq / fs)
    return np.array([C @ np.linalg.solve(zk * np.eye(4) - A, B) + D for zk in z])


def simulate(system, u):
    from scipy.signal import dlsim

    return dlsim((*system, 1 / FS), u)[1].T


def test_periodic_response_is_the_transfer_function_of_the_discrete_system():
    rng = np.random.default_rng(1)
    lines = np.arange(3, 180, 2)
    u = np.tile(multisine(rng, 400, lines), 5)
    system = discrete_system(rng)
    frf = estimate_frf(recording(u, simulate(system, u)), period_s=4.0, skip_s=6.0)
    # only the lines that the multisine holds; there, no leakage: what is left is rounding of 400-sample sums
    np.testing.assert_allclose(frf.freq, lines / 4.0, rtol=1e-12)
    exact = transfer(system, frf.freq)
    assert np.max(np.abs(frf.H - exact)) < 1e-9 * np.max(np.abs(exact))
    assert frf.coherence.min() > 1 - 1e-12
    assert np.sqrt(frf.variance.max()) < 1e-9
    assert frf.unit == "(m/s)/N"


def test_period_to_period_variance_is_that_of_the_noise():
    rng = np.random.default_rng(2)
    n, periods, noise = 400, 40, 0.3
    u = np.tile(multisine(rng, n, np.arange(1, 200)), periods)
    frf = estimate_frf(recording(u, u + noise * rng.normal(size=u.size)), period_s=4.0)
    # |X| = n at every line; the spectrum of white noise has variance n noise^2; `periods` averages
    expected = noise**2 / n / periods
    # a mean over 199 lines of chi-square with 2 (periods - 1) degrees of freedom: 1.1 % deviation
    assert np.mean(frf.variance) == pytest.approx(expected, rel=0.05)
    assert np.mean(np.abs(frf.H - 1) ** 2) == pytest.approx(expected, rel=4 / np.sqrt(199))  # 4 deviations


def test_noise_on_one_side_biases_h1_or_h2_by_its_share_of_the_power():
    rng = np.random.default_rng(3)
    true, noise, gain = rng.normal(size=200_000), 0.5, 3.0

    def mean_level(x, y, estimator):
        return np.mean(np.abs(estimate_frf(recording(x, y), estimator=estimator, segment_s=1.0).H)) / gain

    share = 1 + noise**2
    noisy_x = true + noise * rng.normal(size=true.size)
    noisy_y = gain * true + noise * gain * rng.normal(size=true.size)
    # 2000 segments, 50 lines: each value is good to about 0.5 / sqrt(2000 * 50) = 0.2 %; 1 % is five deviations
    assert mean_level(noisy_x, gain * true, "H1") == pytest.approx(1 / share, rel=0.01)
    assert mean_level(noisy_x, gain * true, "H2") == pytest.approx(1.0, rel=0.01)
    assert mean_level(true, noisy_y, "H1") == pytest.approx(1.0, rel=0.01)
    assert mean_level(true, noisy_y, "H2") == pytest.approx(share, rel=0.01)
    assert mean_level(true, noisy_y, "Hv") == pytest.approx(np.sqrt(share), rel=0.01)
    # noise of the same share on both sides is what Hv is right for
    assert mean_level(noisy_x, noisy_y, "Hv") == pytest.approx(1.0, rel=0.01)


def test_coherence_is_that_of_the_signal_to_noise_ratio():
    rng = np.random.default_rng(4)
    x = rng.normal(size=100_000)
    for ratio in (0.25, 1.0, 9.0):
        y = x + rng.normal(size=x.size) / np.sqrt(ratio)
        frf = estimate_frf(recording(x, y), segment_s=2.0, window="hann")
        expected = ratio / (1 + ratio)
        # deviation of one line sqrt(2 g) (1 - g) / sqrt(n), n = 950: at most 1.3 %; of the mean of 100 lines 0.13 %;
        # bias (1 - g)^2 / n = 0.1 %  [Bendat and Piersol, table 9.6]
        assert np.mean(frf.coherence) == pytest.approx(expected, abs=0.006)
        assert frf.n_averages == pytest.approx(
            950, rel=0.01
        )  # hann, half overlap: 0.95 of the 1000 that do not overlap
        variance = (1 - expected) / expected / frf.n_averages
        assert np.mean(np.abs(frf.H - 1) ** 2) == pytest.approx(
            variance, rel=0.5
        )  # 4 deviations of 100 lines, correlated
        assert np.mean(frf.variance) == pytest.approx(variance, rel=0.05)


@pytest.fixture(scope="module")
def two_inputs():
    rng = np.random.default_rng(5)
    a, b, n = rng.normal(size=(3, 200_000))
    x = np.array([a, 0.6 * a + 0.8 * b])  # unit power, correlation 0.6
    y = np.array([2.0 * x[0] - 1.0 * x[1] + 0.5 * n, 1.0 * x[1]])
    return x, y


def test_two_correlated_inputs_are_told_apart(two_inputs):
    frf = estimate_frf(recording(*two_inputs), segment_s=1.0)
    gains = np.array([[2.0, -1.0], [0.0, 1.0]])
    # deviation of a mean over 49 lines and 1900 segments: 0.5 / 0.8 / sqrt(49 * 1900) = 0.2 %; 1 % is five deviations
    np.testing.assert_allclose(np.mean(frf.H, axis=0), gains, atol=0.01)
    signal = 4.0 + 1.0 - 2 * 2.0 * 0.6  # power of 2 x0 - x1
    assert np.mean(frf.coherence[:, 0]) == pytest.approx(
        signal / (signal + 0.25), abs=0.003
    )  # one line 0.35 %, 49 lines
    assert frf.coherence[:, 1].min() > 1 - 1e-10  # output 1 is input 1
    # one input alone gets the other's part that is coherent with it: 2 - 0.6
    alone = estimate_frf(recording(*two_inputs), inputs=["force0"], outputs=["speed0"], segment_s=1.0)
    assert np.mean(alone.H).real == pytest.approx(1.4, abs=0.01)


@pytest.mark.parametrize("estimator", ["H2", "Hv"])
def test_other_estimators_agree_with_two_inputs_without_noise(two_inputs, estimator):
    x, _ = two_inputs
    gains = np.array([[2.0, -1.0], [0.5, 1.0]])
    frf = estimate_frf(recording(x, gains @ x), segment_s=1.0, estimator=estimator)
    # the least eigenvalue of Hv is 0 to rounding, its vector good to the square root of nothing else: 1e-12 and a margin
    np.testing.assert_allclose(frf.H, np.broadcast_to(gains, frf.H.shape), atol=1e-8)


def test_order_of_channels_does_not_matter(two_inputs):
    x, y = two_inputs
    straight = recording(x[:, :20_000], y[:, :20_000])
    shuffled = straight.select(["speed1", "force1", "speed0", "force0"])
    a = estimate_frf(straight, segment_s=1.0)
    b = estimate_frf(shuffled, segment_s=1.0)
    assert b.outputs == ("speed1", "speed0")
    assert b.inputs == ("force1", "force0")
    np.testing.assert_allclose(b.H, a.H[:, ::-1, ::-1], rtol=1e-9, atol=1e-9)  # sums in another order: rounding
    np.testing.assert_allclose(b.coherence, a.coherence[:, ::-1], atol=1e-9)
    np.testing.assert_allclose(b.variance, a.variance[:, ::-1, ::-1], rtol=1e-6, atol=1e-15)  # 1 - coherence cancels


def test_integration_undoes_differentiation_and_names_the_unit():
    freq = np.linspace(0.5, 10, 50)
    s = 2j * np.pi * freq
    H = (1 / (s**2 + 0.4 * s + 100))[:, None, None]
    receptance = FrequencyResponse(freq=freq, H=H, outputs=["x"], inputs=["f"], unit="m/N")
    mobility = differentiate(receptance)
    np.testing.assert_allclose(mobility.H[:, 0, 0], s * H[:, 0, 0], rtol=1e-14)  # one product
    assert [r.unit for r in (mobility, differentiate(mobility), integrate(mobility))] == [
        "(m/s)/N",
        "(m/s^2)/N",
        "m/N",
    ]
    np.testing.assert_allclose(integrate(mobility).H, H, rtol=1e-14)


def test_integration_scales_the_variance_too():
    rng = np.random.default_rng(6)
    x = rng.normal(size=5000)
    mobility = estimate_frf(recording(x, x + rng.normal(size=x.size)), segment_s=2.0)
    receptance = integrate(mobility)
    omega = 2 * np.pi * mobility.freq[:, None, None]
    np.testing.assert_allclose(receptance.variance, mobility.variance / omega**2, rtol=1e-12)
    assert receptance.between(5, 10).variance.shape == receptance.between(5, 10).H.shape


def test_peak_levels_are_the_mode_shapes_of_separated_light_modes():
    freq = np.arange(1, 40, 0.01)
    omega, shapes, zeta = 2 * np.pi * np.array([5.0, 30.0]), np.array([[1.0, 0.5], [-0.4, 1.0], [0.0, 0.3]]), 1e-3
    s = 2j * np.pi * freq[:, None]
    modal = 1 / (s**2 + 2 * zeta * omega * s + omega**2)
    H = np.einsum("ok,fk->fo", shapes, modal)[:, :, None]
    frf = FrequencyResponse(freq=freq, H=H, outputs=list("abc"), inputs=["f"])
    levels = peak_levels(frf, [5.1, 29.9], 0.5)
    assert np.max(np.abs(levels), axis=1) == pytest.approx([1.0, 1.0])
    # the other mode adds at most 2 zeta (30 / 5)^2 of the first's peak to the second, 2 zeta / (1 - 1 / 36) the other way
    np.testing.assert_allclose(levels, shapes.T, atol=2.5 * zeta * 36)
    raw = peak_levels(frf, [5.0], 0.005, normalise=False)[0, 0]
    assert abs(raw) == pytest.approx(1 / (2 * zeta * omega[0] ** 2), rel=5e-3)  # the other mode: 0.5 * 2 zeta / 36
    with pytest.raises(BadRecording, match="no line within"):
        peak_levels(frf, [50.0], 0.1)


def uneven():
    time = np.arange(1000) / FS
    time[500:] += 0.003
    return recording(np.sin(time), np.cos(time), time=time)


def rising(n=1000, x=None):
    rng = np.random.default_rng(7)
    x = rng.normal(size=n) if x is None else x
    return recording(x, rng.normal(size=(2, n)))


@pytest.mark.parametrize(
    ("make", "arguments", "error", "match"),
    [
        (uneven, {}, BadRecording, "even sampling"),
        (rising, {"segment_s": 5.0}, BadRecording, "3 segments"),
        (rising, {"segment_s": 50.0}, BadRecording, "0 segments"),
        (rising, {"period_s": 6.0}, BadRecording, "1 whole periods"),
        (rising, {"period_s": 0.123}, BadRecording, "12.3 samples"),
        (rising, {"period_s": 1.0}, BadRecording, "does not repeat"),
        (rising, {"skip_s": 20.0}, BadRecording, "leaves nothing"),
        (rising, {"overlap": 1.0}, BadRecording, "overlap"),
        (rising, {"window": "triangel"}, BadRecording, "triangel"),
        (rising, {"estimator": "H3"}, BadRecording, "H3"),
        (rising, {"inputs": ["forse0"]}, UnknownName, "did you mean 'force0'"),
        (rising, {"outputs": ["speed7"]}, UnknownName, "speed7"),
        (rising, {"inputs": []}, BadRecording, "no input channel"),
        (rising, {"outputs": ["speed0", "force0"]}, BadRecording, "more than once"),
        (lambda: rising(x=np.zeros(1000)), {}, BadRecording, "'force0' is constant"),
        (lambda: rising(x=np.full(1000, 2.5)), {}, BadRecording, "'force0' is constant"),
        (lambda: rising(x=np.vstack([np.arange(1000.0) % 7] * 2)), {"segment_s": 1.0}, BadRecording, "fully coherent"),
        (
            rising,
            {"inputs": ["force0", "speed1"], "estimator": "H2", "segment_s": 0.5},
            BadRecording,
            "as many outputs",
        ),
    ],
)
def test_refuses_what_cannot_give_a_response(make, arguments, error, match):
    with pytest.raises(error, match=match):
        estimate_frf(make(), **arguments)
