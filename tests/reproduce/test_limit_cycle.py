"""The 41 Hz study: what is reported is what the loop does."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

from vlab.fe.assembly import build_fe_model
from vlab.fe.string_modes import add_string_modes
from vlab.hardware import load_hardware
from vlab.lab.laws import named_law
from vlab.lab.prediction import loop_on
from vlab.lab.saturation import harmonic_balance
from vlab.reproduce.limit_cycle import odds, runs, study


@pytest.fixture(scope="module")
def law(beam):
    return named_law(beam, "lqg")


@pytest.fixture(scope="module")
def report(beam):
    return study.limit_cycle_report(beam)


def test_the_nominal_loop_is_stable_and_41_hz_is_not_its_weak_spot(report):
    nominal = report["nominal"]
    assert nominal["is_stable"]
    assert nominal["least_stable"]["hz"] == pytest.approx(91.7, abs=0.1)  # identified beforehand
    assert all(not 38 < pole["hz"] < 44 or pole["zeta"] > 0.05 for pole in nominal["poles"])


def test_more_delay_meets_other_modes_first(report):
    rows = report["delay_alone"]
    assert [round(row["hz"]) for row in rows[:4]] == [92, 69, 51, 37]
    assert all(a["delay_samples"] < b["delay_samples"] for a, b in itertools.pairwise(rows))


def test_41_hz_lies_in_the_first_band_in_which_the_law_mostly_drives(report):
    first = report["driven_bands"][0]
    assert first["from_hz"] < study.OBSERVED_HZ < first["to_hz"]


def test_nothing_that_was_tried_unforced_grows_near_41_hz(report):
    # the honest finding: only what was set there comes near, and it does not grow at the measured delay
    assert all("set for 41 Hz" in row["words"] for row in report["near"])
    assert all(row["growth_per_s"] < 0 for row in report["near"])


def test_a_light_own_mode_of_the_upper_cable_grows(report):
    (row,) = (r for r in report["candidates"] if r["growth_per_s"] > 0)
    assert "upper cable, solid wire" in row["words"]
    assert row["hz"] == pytest.approx(45.5, abs=0.3)
    assert row["own_zeta"] < row["needed_zeta"]


def test_needed_damping_is_what_makes_the_mode_steady(beam, law):
    # give the string that ratio more, and the pole is at the edge; light damping adds to the pole
    hardware = runs.bench()
    row, _ = study.cable_candidate(beam, law, hardware, "cable-upper", mass=1.0, zeta=2e-4, words="")
    extra = row.needed_zeta - row.own_zeta
    steady, _ = study.cable_candidate(beam, law, hardware, "cable-upper", mass=1.0, zeta=2e-4 + extra, words="")
    assert abs(steady.zeta) < 0.2 * abs(row.zeta)  # the string is 83 % of the mode


def test_delay_to_grow_is_where_the_mode_crosses(beam, law):
    row, fe = study.cable_candidate(beam, law, runs.bench(), "cable-lower", mass=0.62, zeta=2e-4, words="")
    loop = loop_on(fe, law, runs.bench().converter)
    mode = int(np.argmin(np.abs(fe.linear.freq - row.own_hz)))
    before, after = (loop.with_delay(row.delay_to_grow + step).mode_poles([mode])[0].growth for step in (-0.05, 0.0))
    assert before <= 0 < after


@pytest.mark.slow
def test_simulated_growth_is_the_predicted_one(beam, fe, law):
    # without structural damping of the strings the mode grows fast enough for a short run; noise starts it
    hardware = runs.bench(noise=1e-4)
    wider = add_string_modes(fe, zeta=0.0)
    predicted = loop_on(wider, law, hardware.converter).critical()
    run = runs.time_history(wider, law, hardware, seconds=60.0)
    facts = runs.growth(run, "command:base")
    assert predicted.hz == pytest.approx(45.5, abs=0.2)
    assert facts["hz"] == pytest.approx(predicted.hz, rel=3e-3)
    # step of 1/2 ms: 45 Hz is 0.08 % high, and growth depends on frequency; noise is still in the first windows
    assert facts["growth_per_s"] == pytest.approx(predicted.growth, rel=0.08)


@pytest.mark.slow
def test_the_limit_cycle_settles_where_harmonic_balance_says(beam, fe, law):
    hardware = runs.bench(noise=1e-4, limit=0.05)
    wider = add_string_modes(fe, zeta=0.0)
    found = harmonic_balance(loop_on(wider, law, hardware.converter), 0.05)
    run = runs.time_history(wider, law, hardware, seconds=240.0)
    facts = runs.growth(run, "command:base")
    # one harmonic, noise left out, and the step shifts the growth by 5 %
    assert np.sqrt(2) * facts["final_rms"] == pytest.approx(found.commands.max(), rel=0.15)
    released = runs.time_history(wider, law, hardware, seconds=240.0, release=1.0)
    assert runs.growth(released, "command:base")["final_rms"] == pytest.approx(facts["final_rms"], rel=0.03)


def test_the_nominal_beam_comes_to_rest_under_lqg(fe, law):
    run = runs.time_history(fe, law, runs.bench(noise=0.0), seconds=15.0, release=1.0)
    levels = runs.levels_of(run, "command:40in")[1]
    assert levels[-1] < 0.05 * levels[1]  # 91.7 Hz decays with 0.44 1/s, at this step with 0.3 1/s


def test_growth_is_read_off_a_made_signal():
    from vlab.signals import Channel, Recording

    t = np.arange(60_000) / 1000.0
    size = np.minimum(1e-4 * np.exp(0.3 * t), 1.0)
    made = Recording(
        time=t,
        data=(size * np.sin(2 * np.pi * 41 * t))[:, None],
        channels=(Channel(name="x", kind="other", unit="1"),),
        meta={},
    )
    facts = runs.growth(made, "x")
    assert facts["growth_per_s"] == pytest.approx(0.3, rel=0.01)
    assert facts["hz"] == pytest.approx(41.0, abs=0.05)
    assert facts["final_rms"] == pytest.approx(np.sqrt(0.5), rel=1e-3)
    assert facts["reached_s"] == pytest.approx(np.log(1e4) / 0.3, abs=1.5)


def test_the_report_is_plain_data_and_says_what_follows(report):
    json.dumps(report, allow_nan=False)
    assert report["verdict"][0].startswith("The nominal loop is stable")
    assert report["verdict"][-1].startswith("Of what was tried, nothing grows between 38 and 44 Hz")


def test_an_unstable_nominal_loop_would_be_said(beam, law, fe):
    loop = loop_on(fe, law, replace(runs.bench().converter, delay_samples=3.0))
    assert study.verdict(loop, [], [])[0].startswith("The nominal loop is unstable: 91.5 Hz")


def test_an_undisturbed_draw_is_the_nominal_loop(beam, law):
    bench = odds._Bench(beam, law, load_hardware().at_rate(1000.0).converter)
    ones = np.ones(bench.modes)
    loop = bench.loop(odds._Draw(cable=None, frequency=ones, damping=ones, delay=1.35))
    nominal = loop_on(build_fe_model(beam), law, load_hardware().at_rate(1000.0).converter)
    pair = [[(pole.hz, pole.growth) for pole in each.poles()] for each in (loop, nominal)]
    np.testing.assert_allclose(*pair, rtol=1e-9)


@pytest.mark.slow
def test_the_odds_of_explanations_are_the_shares_of_draws_that_do_what_was_seen(beam):
    found = odds.limit_cycle_odds(beam, draws=6, seed=1)
    assert found == odds.limit_cycle_odds(beam, draws=6, seed=1)
    rows = found["explanations"]
    assert sum(row["probability"] for row in rows) == pytest.approx(1.0)
    assert all(0 <= row["as_seen"] <= row["grows"] <= 6 for row in rows)
    shares = {row["name"]: (row["as_seen"] + 0.5) / 7 for row in rows}
    assert shares == {r["name"]: pytest.approx(r["probability"] * sum(shares.values())) for r in rows}


def test_a_measurement_decides_as_far_as_explanations_disagree_on_it():
    rows = [{"name": name, "probability": 0.5} for name in ("one", "two")]
    first, second, *others = odds.MEASUREMENTS
    yes, no = ({first: a, second: True, **dict.fromkeys(others, False)} for a in (True, False))
    told = {m["name"]: m["bits"] for m in odds._informative(rows, {"one": [yes] * 1000, "two": [no] * 1000})}
    assert told[first] == pytest.approx(1.0, abs=0.02)  # an even choice settled, but for the shares' estimate
    assert all(abs(told[name]) < 1e-9 for name in (second, *others))
    assert odds._informative(rows, {"one": [], "two": []}) == []
