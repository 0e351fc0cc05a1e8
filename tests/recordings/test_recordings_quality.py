"""Findings: each fault that is put into a sound recording is found, and a sound one has none."""

from itertools import pairwise

import numpy as np
import pytest

from vlab.recordings.quality import findings, sticks
from vlab.signals import Channel, Recording

RATE = 1000.0
TIME = np.arange(4000) / RATE


def signal(seed=0):
    rng = np.random.default_rng(seed)
    tones = sum(np.sin(2 * np.pi * f * TIME + rng.uniform(0, 6)) for f in (3.1, 7.7, 21.3))
    return tones + 0.01 * rng.normal(size=TIME.size)


def run(*columns, time=TIME, kind="velocity", **labels):
    channels = [Channel(name=f"c{i}", kind=kind, unit="m/s", **labels) for i in range(len(columns))]
    return Recording(time=time, data=np.column_stack(columns), channels=channels)


def kinds(recording):
    return [(found.channel, found.kind, found.severity) for found in findings(recording)]


def test_a_sound_recording_has_no_findings():
    assert findings(run(signal(0), signal(1), signal(2))) == ()


@pytest.mark.parametrize(("labels", "severity"), [({}, "warning"), ({"is_input": True}, "note")])
def test_clipping_is_a_loss_of_a_sensor_and_a_limit_of_a_drive(labels, severity):
    assert kinds(run(np.clip(signal(), -1.5, 9.0), **labels)) == [("c0", "clipping", severity)]
    assert len(findings(run(np.clip(signal(), -1.5, 1.5), **labels))) == 2


def test_clipping_says_where_and_how_much():
    (found,) = findings(run(np.clip(signal(), -9.0, 1.5)))
    assert "upper limit of 1.5 m/s" in found.text
    assert f"{100 * np.mean(signal() >= 1.5):.2g} %" in found.text


def test_a_smooth_top_flattened_by_quantisation_is_not_clipping():
    slow = np.rint(np.sin(2 * np.pi * 0.5 * TIME) * 200) / 200
    assert [found.kind for found in findings(run(slow))] == []


def test_rest_at_the_extreme_is_not_clipping():
    decay = np.where(TIME < 2.5, 0.0, np.abs(signal()))
    assert "clipping" not in [found.kind for found in findings(run(decay))]


def test_a_clipped_noisy_sensor_does_not_stick():
    """White noise of three steps holds equal samples by chance, at any level."""
    rng = np.random.default_rng(5)
    step = 0.01
    motion = 2.0 * np.sin(2 * np.pi * np.arange(6000) / 200)
    values = step * np.round(np.clip(motion + rng.normal(size=6000) * 3 * step, -1.5, 1.5) / step)
    rows = np.lib.stride_tricks.sliding_window_view(values, 3)
    slopes = np.abs(np.diff(values))
    held = np.flatnonzero((np.ptp(rows, axis=1) == 0) & (np.abs(rows[:, 0]) < 1.4))
    assert np.any(np.minimum(slopes[held - 1], slopes[held + 2]) > 3 * step)
    assert not sticks(values)
    assert "clipping" in [found.kind for found in findings(run(values, time=np.arange(6000) / RATE))]


def test_a_joint_that_sticks_at_every_turn_is_not_clipped():
    """Turns of several heights; dry friction holds the joint after every turn, also at the largest one."""
    rise = np.sin(np.linspace(-1.2, 1.2, 40)) / np.sin(1.2)
    levels = np.resize([0.8, -0.6, 1.0, -1.0, 0.6, -0.8], 41)
    legs = [np.append(a + (b - a) * (rise + 1) / 2, np.full(10, b)) for a, b in pairwise(levels)]
    stuck = np.rint(np.concatenate(legs) * 1e4) / 1e4
    time = np.arange(stuck.size) / 50.0
    assert "clipping" not in [found.kind for found in findings(run(stuck, time=time))]


def test_constant_channels():
    assert kinds(run(signal(), np.full(TIME.size, 3.0))) == [("c1", "constant", "warning")]


def test_duplicates_also_when_scaled_or_flipped():
    found = findings(run(signal(), signal(), -2.0 * signal() + 1.0, signal(1)))
    assert [(f.channel, f.kind) for f in found] == [("c1", "duplicate"), ("c2", "duplicate"), ("c2", "duplicate")]
    assert "same samples as c0" in found[0].text
    assert "times -2" in found[1].text


def test_coarse_quantisation():
    step = 0.2
    (found,) = findings(run(np.rint(signal() / step) * step))
    assert (found.kind, found.severity) == ("quantisation", "note")
    assert "steps of 0.2 m/s" in found.text
    (found,) = findings(run(np.rint(signal() / 1.0)))
    assert found.severity == "warning"


def test_commands_in_steps_are_no_fault():
    assert kinds(run(np.rint(signal()), is_input=True)) == [("c0", "quantisation", "note")]


def test_an_encoder_between_two_of_its_steps_has_lost_nothing():
    slow = np.rint(8.0 * (np.sin(2 * np.pi * 0.4 * TIME) + 0.2 * np.sin(2 * np.pi * 9.0 * TIME))) / 8.0
    assert "held" not in [found.kind for found in findings(run(slow))]


def test_gaps_and_jitter_of_the_time_stamps():
    keep = np.ones(TIME.size, bool)
    keep[1000:1040] = False
    (found,) = findings(run(signal()[keep], time=TIME[keep]))
    assert (found.channel, found.kind, found.severity) == ("time", "gap", "warning")
    assert "1 gap " in found.text
    assert "about 40 samples lost" in found.text
    jitter = TIME + np.random.default_rng(0).uniform(-0.1, 0.1, TIME.size) / RATE
    assert kinds(run(signal(), time=jitter)) == [("time", "jitter", "warning")]
    slight = TIME + np.random.default_rng(0).uniform(-0.01, 0.01, TIME.size) / RATE
    assert kinds(run(signal(), time=slight)) == [("time", "jitter", "note")]


@pytest.mark.parametrize(("period", "decimals"), [(0.0204, 3), (1 / 750, 6), (0.0333, 2)])
def test_rounded_stamps_of_even_samples_are_no_jitter(period, decimals):
    rounded = np.round(1.7e3 + period * np.arange(TIME.size), decimals)
    assert findings(run(signal(), time=rounded)) == ()
    uneven = rounded + 10.0**-decimals * np.random.default_rng(0).integers(-1, 2, TIME.size)
    assert [kind for _, kind, _ in kinds(run(signal(), time=uneven))] == ["jitter"]


def test_blocks_filled_with_the_last_value():
    held = np.column_stack([signal(0), signal(1)])
    held[1000:1040] = held[999]
    (found,) = findings(run(*held.T))
    assert (found.kind, found.severity) == ("held", "warning")
    assert "1 block of samples repeat the last value, up to 40 samples" in found.text
    rest = np.where(TIME < 1.0, 0.0, signal())  # at rest before the start is no fault
    assert "held" not in [f.kind for f in findings(run(rest))]


def test_the_shortest_recordings_are_judged_without_error():
    for n in range(2, 8):
        findings(run(signal()[:n], np.arange(float(n)), time=TIME[:n]))
        findings(run(np.r_[np.ones(n - 1), 0.0], time=TIME[:n]))


def test_findings_do_not_depend_on_the_unit():
    # Powers of two scale without rounding, so that the text may differ but the kinds may not.
    recording = np.clip(signal(), -1.5, 1.5)
    assert kinds(run(recording)) == kinds(run(recording * 2.0**-40)) == kinds(run(recording * 2.0**40))


def motion(order):
    """Return displacement, velocity or acceleration of a sum of tones."""
    phases = np.random.default_rng(3).uniform(0, 6, 3)
    tones = [(2 * np.pi * f, phase) for f, phase in zip((5.0, 12.3, 31.7), phases, strict=True)]
    return sum(w ** (order - 1) * np.sin(w * TIME + phase + order * np.pi / 2) for w, phase in tones)


def place(factor_v=1.0, factor_a=1.0, noise=0.0, at="tip"):
    rng = np.random.default_rng(4)
    data = np.column_stack([motion(0), motion(1) * factor_v, motion(2) * factor_a])
    data += noise * data.std(axis=0) * rng.normal(size=data.shape)
    labels = [("x", "displacement", "m"), ("v", "velocity", "m/s"), ("a", "acceleration", "m/s^2")]
    channels = [Channel(name=n, kind=kind, unit=unit, at=at) for n, kind, unit in labels]
    return Recording(time=TIME, data=data, channels=channels)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_derivatives_of_each_other_in_right_units_have_no_findings(noise):
    assert findings(place(noise=noise)) == ()


@pytest.mark.parametrize("factor", [1.0, 1.3])
def test_the_rate_of_a_joint_between_taught_positions_is_the_derivative_of_its_angle(factor):
    """Slow moves of a second at 50 Hz: their leakage must not look like a wrong unit."""
    time = np.arange(500) / 50.0
    rng = np.random.default_rng(11)
    angle, rate = np.zeros(time.size), np.zeros(time.size)
    for begin in (0.5, 2.0, 3.4, 5.2, 7.1, 8.3):
        travel, share = rng.uniform(-0.5, 0.5), np.clip(time - begin, 0.0, 1.0)
        angle += travel * (share - np.sin(2 * np.pi * share) / (2 * np.pi))
        rate += travel * (1 - np.cos(2 * np.pi * share))
    data = np.column_stack([angle, factor * rate]) + 1e-4 * rng.normal(size=(time.size, 2))
    labels = [("q", "angle", "rad"), ("w", "angular-velocity", "rad/s")]
    channels = [Channel(name=n, kind=kind, unit=unit, at="joint:elbow") for n, kind, unit in labels]
    found = [f for f in findings(Recording(time=time, data=data, channels=channels)) if f.kind == "units"]
    assert bool(found) == (factor != 1.0)
    assert all("1.3 times the derivative of q" in f.text for f in found)


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize(
    ("factor", "text"),
    [
        (1 / 9.80665, "g taken for m/s^2"),
        (386.0886, "g taken for in/s^2"),
        (39.37008, "inch taken for metre"),
        (2 * np.pi, "Hz taken for rad/s"),
        (1e-3, "milli left out"),
    ],
)
def test_a_wrong_unit_is_found_by_its_factor(factor, text, noise):
    found = [f for f in findings(place(factor_a=factor, noise=noise)) if f.kind == "units"]
    assert {f.channel for f in found} == {"a"}  # beside the velocity and beside the displacement
    assert len(found) == 2
    assert all(text in f.text and f.severity == "warning" for f in found)


def test_a_factor_that_no_unit_explains_is_a_note_and_a_flipped_sensor_a_warning():
    (one, two) = findings(place(factor_v=1.7))
    assert (one.kind, one.severity) == ("units", "note")
    assert "1.7 times the derivative of x" in one.text
    assert "0.588 times the derivative of v" in two.text
    assert kinds(place(factor_v=-1.0)) == [("v", "sign", "warning"), ("a", "sign", "warning")]


def test_channels_of_other_places_or_other_motions_are_not_compared():
    assert findings(place(factor_a=9.80665, at="")) == ()
    other = Recording(
        time=TIME,
        data=np.column_stack([motion(0), signal(5)]),
        channels=[
            Channel(name="x", kind="displacement", unit="m", at="tip"),
            Channel(name="v", kind="velocity", unit="m/s", at="tip"),
        ],
    )
    assert findings(other) == ()


def test_a_duplicate_in_another_unit_names_the_unit():
    (found,) = [f for f in findings(run(signal(), 39.37008 * signal())) if f.kind == "duplicate"]
    assert "times 39.3701, offset aside (as if inch taken for metre" in found.text
