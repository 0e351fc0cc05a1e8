"""Universal files: against pyuff on sound files; what pyuff believes or drops silently is refused here."""

import struct
import warnings

import numpy as np
import pytest
import pyuff
import sound

from vlab.errors import BadRecording
from vlab.recordings import open_table, read_recording, write_recording
from vlab.recordings.assemble import ColumnSpec, to_recording
from vlab.recordings.formats.uff import write_uff_response
from vlab.signals import Channel, FrequencyResponse, Recording


def opened(tmp_path, content, name="run.uff"):
    (tmp_path / name).write_bytes(content)
    return open_table(tmp_path / name)


@pytest.mark.parametrize("is_binary", [False, True])
@pytest.mark.parametrize("is_even", [False, True])
@pytest.mark.parametrize("is_complex", [False, True])
def test_functions_are_read_as_pyuff_reads_them(tmp_path, is_binary, is_even, is_complex):
    table = opened(tmp_path, sound.uff(is_binary=is_binary, is_even=is_even, is_complex=is_complex))
    abscissa = "f" if is_complex else "time"
    assert table.names == (abscissa, "12+Y/1-X", "12+Z/1-X")
    theirs = [s for s in pyuff.UFF(str(tmp_path / "run.uff")).read_sets() if s["type"] == 58]
    for name, other in zip(table.names[1:], theirs, strict=True):
        np.testing.assert_array_equal(table[name], other["data"])
        np.testing.assert_array_equal(table[abscissa], other["x"])
    expected = np.exp(1j * sound.TIMES) if is_complex else np.cos(sound.TIMES)
    # text keeps 12 digits, binary all
    np.testing.assert_allclose(table["12+Z/1-X"], expected, rtol=0, atol=0 if is_binary else 1e-11)
    assert any("1 data sets 151 skipped" in note for note in table.notes)


def test_units_of_the_file_are_held_against_the_given_ones(tmp_path):
    table = opened(tmp_path, sound.uff(is_binary=True, is_complex=False), "run.unv")
    spec = {"column": "12+Z/1-X", "kind": "acceleration"}
    run = to_recording(table, [ColumnSpec(unit="m/s^2", **spec)], time="time")
    np.testing.assert_array_equal(run.data[:, 0], np.cos(sound.TIMES))
    with pytest.raises(ValueError, match=r"states 'm/s\^2' and the description 'g', a factor of 9\.80665"):
        to_recording(table, [ColumnSpec(unit="g", **spec)], time="time")
    with pytest.raises(ValueError, match="states 's' and the description 'ms', a factor of 0.001"):
        to_recording(table, [ColumnSpec(unit="m/s^2", **spec)], time="time", time_unit="ms")
    complex_table = opened(tmp_path, sound.uff(is_binary=True))
    with pytest.raises(BadRecording, match=r"is complex; a frequency response is described in \[\[frf\]\]"):
        to_recording(complex_table, [ColumnSpec(unit="m/s^2", **spec)], rate_hz=1.0)


def text_of(data, *changes):
    for old, new in changes:
        assert old in data
        data = data.replace(old, new, 1)
    return data


ASCII, BINARY = sound.uff(is_binary=False, is_complex=False), sound.uff(is_binary=True)
HEADER = b"         4         7         1"


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (ASCII[:-7], "does not end with -1: the file is truncated"),
        (ASCII[: len(ASCII) // 2], "truncated|cut short|left"),
        (BINARY[:-40], "no end of a data set follows|left"),
        (b"garbage\n" * 30, "where a data set begins with -1"),
        (b"    -1\n", "a data set without a number"),
        (b"\n\n", "no data set 58 in the file"),
        (b"    -1\n   151\nx\n    -1\n", r"no data set 58 in the file \(found: 151\)"),
        (text_of(ASCII, (HEADER, b"         4 400000000         1")), "declares 400000000 samples in the .* bytes"),
        (text_of(ASCII, (HEADER, b"         4         8         1")), "samples"),
        (text_of(ASCII, (HEADER, b"         4         6         1")), "samples"),
        (text_of(ASCII, (HEADER, b"         4        -7         1")), "declares -7 samples"),
        (text_of(ASCII, (HEADER, b"         3         7         1")), "ordinate data type is 3"),
        (text_of(ASCII, (HEADER, b"         4         7         2")), "abscissa spacing is 2"),
        (text_of(ASCII, (HEADER + b"  0.00000e+00  3.33333e-01", HEADER + b"  0.00000e+00 -3.33333e-01")), "increment"),
        (text_of(ASCII, (HEADER + b"  0.00000e+00", HEADER + b"          nan")), "first abscissa is 'nan'"),
        (text_of(ASCII, (b" 1.00000000000e+00", b"               nan")), "NaN, infinite or overflown samples"),
        (text_of(ASCII, (b" 1.00000000000e+00", b" *****************")), "NaN, infinite or overflown samples"),
        (text_of(ASCII, (b" 1.00000000000e+00", b" 1.0000000x000e+00")), "only numbers may stand"),
        (text_of(ASCII, (b" 1.00000000000e+00", b" 1.00000000000e+0")), "signs long, not"),
        (text_of(ASCII, (b" 1.00000000000e+00", b" 1.0000  00000e+00")), "samples are not numbers"),
        (text_of(BINARY, (b"    58b     1     2", b"    58b     1     1")), "its binary form is 1, 1, 11"),
        (text_of(BINARY, (b"    58b     1     2", b"    58b     7     2")), "its binary form is 7, 2, 11"),
        (text_of(BINARY, (b"          56     0", b"          48     0")), "no end of a data set follows"),
    ],
)
def test_what_lies_or_is_cut_is_refused(tmp_path, content, match):
    with pytest.raises(BadRecording, match=match) as caught:
        opened(tmp_path, content)
    assert str(caught.value).isprintable()


def test_pyuff_reads_what_is_refused_here(tmp_path):
    # why vlab has a reader of its own: a truncated file has no data sets, and no error, and NaN is lost
    path = tmp_path / "cut.uff"
    path.write_bytes(ASCII[:300])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert pyuff.UFF(str(path)).get_n_sets() == 0


def test_nan_in_binary_samples_is_refused(tmp_path):
    (real,) = (struct.pack("<d", value) for value in np.exp(1j * sound.TIMES).real[3:4])
    with pytest.raises(BadRecording, match=r"NaN at sample 3 \(1 of 7"):
        opened(tmp_path, text_of(BINARY, (real, struct.pack("<d", np.nan))))


def test_functions_over_several_abscissae_have_each_its_own(tmp_path):
    table = opened(
        tmp_path,
        sound.uff(is_binary=True, is_complex=False) + sound.uff(is_binary=True, is_complex=False, is_even=False),
    )
    assert "time of 12+Z/1-X" in table.names
    np.testing.assert_allclose(table["time of 12+Z/1-X #2"], sound.TIMES**2, rtol=1e-15)  # one rounding of the square
    np.testing.assert_array_equal(table["12+Y/1-X #2"], np.cos(sound.TIMES))


CHANNELS = (
    Channel(name="u:base", kind="command", unit="N", at="base", is_input=True),
    Channel(name="sensor:tip", kind="velocity", unit="m/s", at="tip"),
)


def recording(time, **more):
    data = np.random.default_rng(1).normal(size=(time.size, 2))
    return Recording(**({"time": time, "data": data, "channels": CHANNELS} | more))


@pytest.mark.parametrize(
    "time",
    [
        np.arange(500) / 2000.0,
        np.arange(500) * 0.0007,
        np.arange(500) / 2048.0,
        0.25 + np.arange(500) / 441.7,
        np.arange(500) * (1 / 3),
    ],
)
def test_a_round_trip_of_an_even_recording_is_exact(tmp_path, time):
    original = recording(time)
    assert write_recording(original, tmp_path / "run.uff") == ()
    read = read_recording(tmp_path / "run.uff")
    assert read.time.tobytes() == original.time.tobytes()
    assert read.data.tobytes() == original.data.tobytes()
    assert read.channels == original.channels
    theirs = pyuff.UFF(str(tmp_path / "run.uff")).read_sets()
    np.testing.assert_array_equal(theirs[1]["data"], original["sensor:tip"])
    np.testing.assert_allclose(theirs[1]["x"], time, rtol=1e-5, atol=0)  # the header has six digits
    assert theirs[1]["ordinate_axis_units_lab"] == "m/s"


def test_what_is_lost_is_said(tmp_path):
    rng = np.random.default_rng(0)
    time = np.arange(500) / 2000.0 + rng.uniform(-1e-9, 1e-9, 500)
    notes = write_recording(recording(time, meta={"seed": 1}), tmp_path / "run.uff")
    assert "the time stamps became even: they change by up to" in notes[0]
    assert "the notes (meta) are not kept in UFF 58" in notes
    assert np.abs(read_recording(tmp_path / "run.uff").time - time).max() == pytest.approx(
        float(notes[0].split()[-2]), rel=0.01
    )
    with pytest.raises(BadRecording, match="uneven time stamps in single precision only; resample it, or write"):
        write_recording(recording(np.cumsum(rng.uniform(1, 2, 500))), tmp_path / "uneven.uff")
    assert not (tmp_path / "uneven.uff").exists()


@pytest.mark.parametrize("labels", [{"name": "µ"}, {"name": "x" * 90}, {"at": "a;b"}, {"unit": "m" * 30}, {"name": ""}])
def test_labels_that_the_format_cannot_hold_are_refused(tmp_path, labels):
    channel = Channel(**({"name": "x", "kind": "other", "unit": "m"} | labels))
    with pytest.raises(BadRecording, match="cannot be written as UFF text"):
        write_recording(recording(np.arange(5.0), data=np.ones((5, 1)), channels=(channel,)), tmp_path / "run.uff")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"sensor:tip", b"sensor:top"),
        (b"velocity; m/s", b"velocity; m/2"),
        (b"+ k / 2000.0", b"+ k / 2000.1"),
        (b"recording 1 2 2", b"recording 1 3 3"),
    ],
)
def test_edited_labels_are_found(tmp_path, old, new):
    write_recording(recording(np.arange(50) / 2000.0), tmp_path / "run.uff")
    with pytest.raises(BadRecording):
        opened(tmp_path, text_of((tmp_path / "run.uff").read_bytes(), (old, new)))


def test_a_file_without_its_last_channel_is_found(tmp_path):
    write_recording(recording(np.arange(50) / 2000.0), tmp_path / "run.uff")
    data = (tmp_path / "run.uff").read_bytes()
    with pytest.raises(BadRecording, match="function 1 of 1 is labelled .*1 2'; the file is truncated"):
        opened(tmp_path, data[: len(data) // 2])


def test_frequency_responses_are_written_exactly(tmp_path):
    rng = np.random.default_rng(2)
    H = rng.normal(size=(60, 2, 2)) + 1j * rng.normal(size=(60, 2, 2))
    response = FrequencyResponse(
        freq=np.arange(60) * 0.3, H=H, outputs=("a", "b"), inputs=("u", "v"), unit="m/s/N", coherence=np.ones((60, 2))
    )
    assert write_uff_response(response, tmp_path / "frf.uff") == ("the coherence is not kept",)
    table = open_table(tmp_path / "frf.uff")
    np.testing.assert_array_equal(table["f"], response.freq)
    np.testing.assert_array_equal(table["2/1"], H[:, 1, 0])
    assert table.units["2/1"] == "m/s/N"
    assert "2/1: b / u" in table.notes
    np.testing.assert_array_equal(pyuff.UFF(str(tmp_path / "frf.uff")).read_sets(2)["data"], H[:, 1, 0])
    uneven = FrequencyResponse(freq=np.geomspace(1, 100, 60), H=H, outputs=("a", "b"), inputs=("u", "v"))
    with pytest.raises(BadRecording, match="uneven frequencies"):
        write_uff_response(uneven, tmp_path / "uneven.uff")
