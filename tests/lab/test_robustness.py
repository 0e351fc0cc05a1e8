"""Margins of the sampled loop, against closed forms, bisection by simulation and python-control."""

from dataclasses import replace

import control
import numpy as np
import pytest
from toys import single_mode

from vlab.controllers import LinearLaw
from vlab.errors import BadController
from vlab.lab.laws import named_law, published_law
from vlab.lab.prediction import SampledLoop, loop_on
from vlab.lab.robustness import (
    damper_strengths,
    delay_margin,
    disc_margins,
    filter_margin,
    gain_margins,
    robustness_report,
    robustness_text,
)


@pytest.fixture(scope="module")
def lqg_loop(beam, fe, laboratory):
    return loop_on(fe, named_law(beam, "lqg", rate=1000.0), laboratory.at_rate(1000.0).converter)


def grows(loop: SampledLoop, samples: int = 40_000) -> bool:
    """Brute force: run the loop sample by sample from noise and see whether it grows in the second half."""
    A, B, C = loop.plant
    a, b, c, d = loop.law
    z = np.random.default_rng(0).standard_normal(len(A)) * 1e-3
    x, sizes = np.zeros(len(a)), []
    for k in range(samples):
        y = C @ z
        u = loop.gain * (c @ x + d @ y)
        x, z = a @ x + b @ y, A @ z + B @ u
        if k % 100 == 0:
            sizes.append(float(np.abs(y).max()))
    quarter = len(sizes) // 4
    return max(sizes[-quarter:]) > max(sizes[quarter : 2 * quarter])


def test_delay_margin_of_one_mode_is_a_quarter_turn(laboratory):
    # a dashpot through a lag turns into negative damping where the lag passes 90 degrees at the mode; a weak one leaves
    # the frequency where it is. Hold (half a sample), delay and no filter: omega (tau + T/2) = pi/2, for zeta -> 0
    loop = single_mode(laboratory, gain=0.005, zeta=0.0, corner=0.0)
    margin = delay_margin(loop, span=40.0)
    assert margin.value == pytest.approx(2000.0 / (4 * 20.0) - 0.5, rel=1e-4)  # the gain moves the frequency by 2e-5
    assert margin.first.hz == pytest.approx(20.0, rel=1e-4)


def test_filter_margin_follows_the_same_turn(laboratory):
    # atan(f/f_c) makes up what delay and half a sample of hold leave of the quarter turn; a first-order filter alone lags less
    margin = filter_margin(single_mode(laboratory, gain=0.005, zeta=0.0, delay=8.0))
    assert np.degrees(np.arctan(20.0 / margin.value)) == pytest.approx(90.0 - 360.0 * 20.0 * 8.5 / 2000.0, abs=0.01)
    assert filter_margin(single_mode(laboratory, gain=0.005, zeta=0.0, delay=0.0)).value is None
    assert filter_margin(single_mode(laboratory, corner=0.0)) is None


def test_gain_margin_is_where_det_of_i_plus_l_vanishes(lqg_loop):
    # independent of eigenvalues of the loop: 1/g is a real negative eigenvalue of L on the unit circle
    low, high = gain_margins(lqg_loop)
    assert low.value is None  # no control is stable
    L = lqg_loop.opened(np.array([high.first.hz]))[0] * high.value
    assert np.abs(np.linalg.eigvals(L) + 1.0).min() < 1e-3  # the crossing's frequency has six digits, the peak is sharp


@pytest.mark.slow
@pytest.mark.parametrize("which", ["gain", "delay"])
def test_margins_are_where_a_simulated_loop_begins_to_grow(lqg_loop, which):
    # 2 % to either side, brute force sample by sample; 40 s, in which the pole moves by a factor of 1.3 at least
    if which == "gain":
        value, at = gain_margins(lqg_loop)[1].value, lqg_loop.with_gain
    else:
        value, at = delay_margin(lqg_loop).value, lqg_loop.with_delay
    assert not grows(at(0.98 * value))
    assert grows(at(1.02 * value))


def test_margins_of_the_lqg_on_the_beam(lqg_loop):
    # with 1.35 samples at 1 ms stable, lightest 91.7 Hz at 8e-4: so its delay margin is small and that mode goes first
    assert lqg_loop.radius < 1
    margin = delay_margin(lqg_loop)
    assert 1.35 < margin.value < 2.0
    assert margin.first.mode == 10
    assert gain_margins(lqg_loop)[1].first.mode == 10


@pytest.mark.parametrize("law", ["mfdrf", "lqdrf"])
def test_direct_rate_feedback_is_stable_at_2_khz_and_not_at_any_delay(beam, fe, laboratory, law):
    # identified beforehand: with 1.35 samples and the filter at 2 kHz every direct design is stable
    loop = loop_on(fe, published_law(beam, law), laboratory.converter)
    assert loop.radius < 1
    margin = delay_margin(loop)
    assert margin.value < 5.0
    assert margin.first.mode > 10  # a mode above those of the design model goes first


def test_disc_margin_is_python_controls(lqg_loop, laboratory):
    # python-control's own, channel by channel on the same discrete loop transfer; one channel needs no slycot
    loop = single_mode(laboratory)
    A, B, C = loop.plant
    P = control.StateSpace(A, B, C, 0, 1 / 2000.0)
    freq = np.geomspace(15.0, 25.0, 4001)
    theirs = control.disk_margins(P * 2.0, 2 * np.pi * freq, skew=0.0)[0]
    together, (alone,) = disc_margins(loop)
    assert alone.size == pytest.approx(theirs, rel=1e-3)  # their lines against ours
    assert together.size == pytest.approx(alone.size, rel=1e-9)  # one channel: the same thing


def test_disc_margin_with_all_channels_is_below_each_and_holds(lqg_loop):
    together, alone = disc_margins(lqg_loop)
    assert together.size <= min(disc.size for disc in alone) + 1e-9
    # it promises these gains in any combination of channels
    for gains in np.array(np.meshgrid(*[[together.gain_low, 1.0, together.gain_high]] * 3)).reshape(3, -1).T:
        assert replace(lqg_loop, gain=0.9999 * (gains - 1) + 1).radius < 1


def test_disc_margin_finds_a_perturbation_that_is_nearly_enough(laboratory):
    # one mode: the disc touches the curve, so a gain and phase just outside at its frequency must destabilise
    loop = single_mode(laboratory, delay=8.0)
    _, (disc,) = disc_margins(loop)
    S = 1 / (1 + loop.opened(np.array([disc.hz]))[0, 0, 0])
    worst = 1 / (S - 0.5)  # delta of magnitude alpha with (1 + delta/2)/(1 - delta/2) L = -1
    factor = (1 + worst / 2) / (1 - worst / 2)
    assert abs(1 + factor * loop.opened(np.array([disc.hz]))[0, 0, 0]) < 1e-9
    assert abs(worst) == pytest.approx(disc.size, rel=1e-9)


def test_an_unstable_loop_has_no_margins(lqg_loop):
    unstable = lqg_loop.with_gain(3.0)
    assert unstable.radius > 1
    assert disc_margins(unstable)[0].size == 0.0
    assert delay_margin(unstable).value == unstable.converter.delay_samples
    assert "UNSTABLE" in robustness_text(robustness_report(unstable, sweeps=False))


def test_a_dashpots_strength_is_its_gain_times_the_cosine_of_the_lag(laboratory):
    loop = single_mode(laboratory, gain=3.0)
    freq = np.array([10.0, 41.0, 200.0, 400.0])
    lag = 2 * np.pi * freq * 1.85 / 2000.0 + np.arctan(freq / 677.0)
    size = np.sinc(freq / 2000.0) / np.hypot(1.0, freq / 677.0)
    assert damper_strengths(loop, freq)[:, 0] == pytest.approx(3.0 * size * np.cos(lag), rel=1e-9)


@pytest.mark.parametrize("hz", [30.0, 41.0, 45.0, 60.0])
def test_damper_strengths_bound_what_a_light_mode_gains(lqg_loop, hz):
    # a mode of unit mass that barely moves at the coils, added to the rest: its growth changes by -v^T H v / 2 with H
    # the law closed through the structure; without the structure's own answer the strengths bound it
    direction = np.array([0.8, -0.5, 0.3]) * 1e-3
    lonely = SampledLoop(
        omega=np.array([2 * np.pi * hz]), damping=np.zeros((1, 1)), at_coils=direction[:, None], at_sensors=direction[:, None], law=lqg_loop.law, converter=lqg_loop.converter,
    )  # fmt: skip
    pole = min((p for p in lonely.poles() if abs(p.hz / hz - 1) < 0.01), key=lambda p: abs(p.growth))
    low, high = damper_strengths(lonely, np.array([hz]))[0][[0, -1]] * (direction @ direction) / 2
    assert low - 1e-9 <= -pole.growth <= high + 1e-9


def test_damper_strengths_need_pairs(laboratory):
    loop = single_mode(laboratory)
    wide = LinearLaw(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[1.0, 0.0]], sensors="ab", actuators="a")
    uneven = replace(loop, at_sensors=np.ones((2, 1)), law=wide.matrices)
    with pytest.raises(BadController, match="as many sensors as coils"):
        damper_strengths(uneven, np.array([10.0]))


def test_report_is_plain_data_and_its_text_names_the_first_mode(lqg_loop):
    import json

    report = robustness_report(lqg_loop, modelled=range(1, 11))
    json.dumps(report, allow_nan=False)
    text = robustness_text(report)
    assert "mode 10, in the design model" in text
    assert len(report["delay_sweep"]) > 10
    nominal = min(report["delay_sweep"], key=lambda point: abs(point["samples"] - 1.35))
    assert nominal["growth_per_s"] < 0
    assert report["delay_margin"]["extra_s"] == pytest.approx((report["delay_margin"]["samples"] - 1.35) * 1e-3)
