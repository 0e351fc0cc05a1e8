"""SEP005 dictionaries: units to SI, one clock, nothing guessed."""

import numpy as np
import pytest

from vlab.errors import BadRecording, BadUnit, UnknownName
from vlab.recordings.formats.sep005 import from_sep005, to_sep005
from vlab.signals import Channel, Recording

X = np.array([1.0, -2.0, 3.0])


def entry(**changes):
    given = {"data": X, "name": "x", "unit_str": "mm", "fs": 100} | changes
    return {key: value for key, value in given.items() if value is not None}


@pytest.mark.parametrize(
    ("unit", "kind", "si", "factor"),
    [
        ("mm", "displacement", "m", 1e-3),
        ("m/s²", "acceleration", "m/s^2", 1.0),
        ("g", "acceleration", "m/s^2", 9.80665),
        ("kN", "force", "N", 1e3),
        ("in/s", "velocity", "m/s", 0.0254),
        ("V", "voltage", "V", 1.0),
        ("deg", "angle", "rad", np.pi / 180),
        ("MPa", "other", "Pa", 1e6),
        ("Hz", "other", "Hz", 1.0),
    ],
)
def test_the_unit_says_the_kind_and_is_converted(unit, kind, si, factor):
    run = from_sep005([entry(unit_str=unit)])
    (channel,) = run.channels
    assert (channel.kind, channel.unit) == (kind, si)
    np.testing.assert_allclose(run["x"], X * factor, rtol=1e-14)  # one rounding in pint, one here
    np.testing.assert_array_equal(run.time, np.arange(3) / 100)


def test_kinds_and_inputs_can_be_given():
    run = from_sep005([entry(), entry(name="u", unit_str="V")], inputs=["u"], kinds={"u": "command"})
    assert run.inputs == ("u",)
    assert run.channels[1].kind == "command"
    strain = from_sep005([entry(unit_str="", quantity="e", start_timestamp="2025-08-16T01:00:00")])
    assert strain.channels[0].kind == "strain"
    assert strain.meta["sep005"]["x"] == {"quantity": "e", "start_timestamp": "2025-08-16T01:00:00"}


@pytest.mark.parametrize(
    ("channels", "error", "match"),
    [
        ([], BadRecording, "a list of dictionaries"),
        (entry(), BadRecording, "a list of dictionaries"),
        ([3], BadRecording, "entry 0 has no text 'name'"),
        ([entry(name=None)], BadRecording, "entry 0 has no text 'name'"),
        ([entry(unit_str=None)], BadRecording, "entry 0 has no text 'unit_str'"),
        ([entry(data=None)], BadRecording, "data is no list"),
        ([entry(data=[1.0, [2.0]])], BadRecording, "data is no list of numbers"),
        ([entry(data=["a", "b"])], BadRecording, "data is no list of real numbers"),
        ([entry(data=np.ones((2, 2)))], BadRecording, "data is no list of real numbers"),
        ([entry(data=X * 1j)], BadRecording, "data is no list of real numbers"),
        ([entry(data=[1.0, np.nan])], BadRecording, "NaN at sample 1"),
        ([entry(data=[1.0, None, 2.0])], BadRecording, "data is no list"),
        ([entry(fs=None)], BadRecording, "neither fs nor time"),
        ([entry(fs=-1)], BadRecording, "fs is -1; it must be a positive number"),
        ([entry(fs="fast")], BadRecording, "fs is fast"),
        ([entry(time=[0.0, 0.1, 0.2])], BadRecording, "fs is 100 Hz, the time stamps are 0.1 s apart"),
        ([entry(fs=None, time=[0.0, 0.1])], BadRecording, "not sampled together"),
        ([entry(fs=None, time=[0.2, 0.1, 0.0])], BadRecording, "do not increase"),
        ([entry(), entry(name="y", fs=50)], BadRecording, "'y' was not sampled together with 'x'"),
        ([entry(), entry()], BadRecording, "stands 2 times"),
        ([entry(timestamp="now")], BadRecording, "prohibits"),
        ([entry(unit_str="wombat")], BadUnit, "'x': unknown unit 'wombat'"),
    ],
)
def test_what_is_not_sep005_is_refused(channels, error, match):
    with pytest.raises(error, match=match):
        from_sep005(channels)


def test_unknown_inputs_and_kinds_that_do_not_fit_are_refused():
    with pytest.raises(UnknownName, match="unknown channel 'z'"):
        from_sep005([entry()], inputs=["z"])
    with pytest.raises(BadUnit, match="'x' .force."):
        from_sep005([entry()], kinds={"x": "force"})


@pytest.mark.parametrize("time", [np.arange(9) / 2048.0, 1.0 + np.arange(9) / 7.0, np.cumsum(np.arange(1.0, 10.0))])
def test_a_round_trip_is_exact(time):
    channels = (
        Channel(name="u:base", kind="command", unit="", at="base", is_input=True),
        Channel(name="tip", kind="velocity", unit="m/s", at="tip"),
    )
    data = np.random.default_rng(0).normal(size=(9, 2))
    original = Recording(time=time, data=data, channels=channels, meta={"seed": 3})
    given = to_sep005(original)
    assert [set(one) >= {"name", "data", "unit_str"} and ("fs" in one) != ("time" in one) for one in given] == [
        True
    ] * 2
    read = from_sep005(given)
    assert read.time.tobytes() == original.time.tobytes()
    assert read.data.tobytes() == original.data.tobytes()
    assert read.channels == channels
    assert dict(read.meta) == {"seed": 3}
