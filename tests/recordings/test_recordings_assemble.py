"""Labelling columns: units to SI, and everything that does not fit together refused."""

import numpy as np
import pytest

from vlab.errors import BadRecording, BadUnit, UnknownName
from vlab.recordings.assemble import ColumnSpec, on_even_stamps, own_si, to_recording
from vlab.recordings.table import Table


@pytest.fixture
def table(tmp_path):
    t = np.arange(10) / 100.0
    columns = {"t": t, "ms": 1000 * t, "x": 1.0 + t, "u": 2.0 * t, "short": t[:4], "H": t * (1 + 1j), "back": t[::-1]}
    return Table(path=tmp_path / "run.mat", columns=columns)


X = ColumnSpec(column="x", kind="displacement", unit="mm", at="tip")
U = ColumnSpec(column="u", kind="command", unit="V", at="motor", scale=35.0, is_input=True)


def test_columns_are_labelled_and_converted(table):
    run = to_recording(table, [U, X], rate_hz=100.0)
    assert run.names == ("motor", "tip")
    assert run.inputs == ("motor",)
    assert [channel.unit for channel in run.channels] == ["", "m"]  # a scaled command is in the model's own unit
    np.testing.assert_array_equal(run["tip"], table["x"] * 1e-3)
    np.testing.assert_array_equal(run["motor"], table["u"] * 35.0)
    assert run.rate == pytest.approx(100.0, rel=1e-12)  # times k/100 carry rounding of 1e-16 each
    assert run.meta["file"].endswith("run.mat")


@pytest.mark.parametrize(
    ("kind", "unit", "si", "factor"),
    [
        ("acceleration", "g", "m/s^2", 9.80665),
        ("force", "lbf", "N", 4.4482216152605),  # 0.45359237 kg x 9.80665 m/s^2, exact by definition
        ("voltage", "mV", "V", 1e-3),
        ("strain", "%", "1", 0.01),
        ("command", "mV", "V", 1e-3),
        ("excitation", "lbf", "N", 4.4482216152605),
        ("command", "N m", "N m", 1.0),
        ("other", "deg", "rad", np.pi / 180),
        ("other", "counts", "1", 1.0),
        ("other", "kHz", "Hz", 1e3),
        ("other", "deg/s", "rad/s", np.pi / 180),
    ],
)
def test_units_become_si_by_kind_or_by_their_own_dimension(table, kind, unit, si, factor):
    run = to_recording(table, [ColumnSpec(column="x", kind=kind, unit=unit)], rate_hz=1.0)
    assert run.channels[0].unit == si
    np.testing.assert_allclose(run["x"], table["x"] * factor, rtol=1e-14)  # one rounding in pint, one here


def test_time_comes_from_a_column_or_from_a_rate(table):
    np.testing.assert_array_equal(to_recording(table, [X], time="t").time, table["t"])
    # 1000 * t * 1e-3 rounds twice, at most 2 x 1.1e-16 relative
    np.testing.assert_allclose(to_recording(table, [X], time="ms", time_unit="ms").time, table["t"], rtol=3e-16)
    for options, match in [
        ({}, "neither a rate nor a time column"),
        ({"rate_hz": 100.0, "time": "t"}, "both given"),
        ({"rate_hz": 0.0}, "must be positive"),
        ({"rate_hz": float("nan")}, "must be positive"),
        ({"time": "back"}, "do not increase"),
        ({"time": "H"}, "complex"),
        ({"time": "short"}, "'x' has 10 samples, the time column 'short' 4"),
    ]:
        with pytest.raises(BadRecording, match=match):
            to_recording(table, [X], **options)


def test_a_window_is_cut_on_the_time_of_the_file(table):
    run = to_recording(table, [X], time="t", start_s=0.02, stop_s=0.05)
    assert run.time.tolist() == [0.02, 0.03, 0.04]
    with pytest.raises(
        BadRecording, match=r"0 samples from start 5 to stop None s; the recording runs from 0 to 0\.09 s"
    ):
        to_recording(table, [X], time="t", start_s=5)


def test_what_does_not_fit_is_refused_by_name(table):
    for spec, error, match in [
        ({"column": "y", "kind": "force", "unit": "N"}, UnknownName, r"run\.mat: unknown column 'y'"),
        ({"column": "short", "kind": "force", "unit": "N"}, BadRecording, "'short' has 4 samples, column 'x' 10"),
        ({"column": "H", "kind": "other"}, BadRecording, r"'H' is complex; .*\[\[frf\]\]"),
        ({"column": "u", "kind": "force", "unit": "mm"}, BadUnit, r"run\.mat: column 'u' \(force\): .*dimension"),
        ({"column": "u", "kind": "other", "unit": "wombat"}, BadUnit, "unknown unit 'wombat'"),
        ({"column": "u", "kind": "other", "unit": "m^7"}, BadUnit, "give a scale"),
        ({"column": "x", "kind": "displacement", "unit": "mm", "at": "tip"}, BadRecording, "'tip' stands 2 times"),
        ({"column": "u", "kind": "force", "scale": 1e308, "name": "f"}, None, ""),
    ]:
        columns = [X, ColumnSpec(**spec)]
        if error is None:
            assert to_recording(table, columns, rate_hz=1.0).names == ("tip", "f")
        else:
            with pytest.raises(error, match=match):
                to_recording(table, columns, rate_hz=1.0)
    with pytest.raises(BadRecording, match="no column was chosen"):
        to_recording(table, [], rate_hz=1.0)


def test_an_overflow_by_the_scale_is_refused(tmp_path):
    table = Table(path=tmp_path / "run.csv", columns={"x": np.array([1.0, 1e10, 3.0])})
    with pytest.raises(BadRecording, match="inf at sample 1"):
        to_recording(table, [ColumnSpec(column="x", kind="force", scale=1e300)], rate_hz=1.0)


@pytest.mark.parametrize("scale", [0.0, float("nan"), float("inf")])
def test_a_scale_that_loses_the_signal_is_refused(scale):
    with pytest.raises(BadRecording, match="scale"):
        ColumnSpec(column="x", kind="force", scale=scale)


def test_an_unknown_kind_is_refused_with_the_nearest():
    with pytest.raises(BadRecording, match="did you mean 'velocity'"):
        ColumnSpec(column="x", kind="velocty")


def test_si_units_of_their_own_stay_as_they_are():
    assert [own_si(unit) for unit in ("Hz", "rad", "", "J", "psi")] == ["Hz", "rad", "1", "N m", "Pa"]


def stamped(time):
    columns = {"t": time, "x": np.sin(time)}
    return to_recording(Table(path="run.csv", columns=columns), [X], time="t")


def test_stamps_with_few_digits_are_put_on_their_grid():
    exact = np.arange(24000) / 1024.0
    rounded = stamped(np.round(exact, 6))
    assert not rounded.is_uniform
    even = on_even_stamps(rounded)
    assert even.is_uniform
    # the two ends are rounded, too, by half of the last decimal each
    assert np.abs(even.time - exact).max() <= 0.5e-6
    assert even.rate == pytest.approx(1024.0, rel=1e-6 / exact[-1])
    assert "at most" in even.meta["stamps"]
    np.testing.assert_array_equal(even.data, rounded.data)


@pytest.mark.parametrize("moved", [0.1, 1.0])  # of a step: a sample taken late, and one that was lost before it
def test_stamps_that_are_not_even_stay_as_they_are(moved):
    time = np.arange(100) / 1024.0
    time[50:] += moved / 1024.0
    assert on_even_stamps(stamped(time)).time.tolist() == time.tolist()
    even = stamped(np.arange(100) / 1024.0)
    assert on_even_stamps(even) is even
