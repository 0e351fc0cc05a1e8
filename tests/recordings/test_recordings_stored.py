"""vlab's own recordings on disk: the same bits come back, and damage is found."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vlab.errors import BadRecording, OutputRefused
from vlab.recordings import open_table, read_recording, write_recording
from vlab.signals import Channel, Recording

SUFFIXES = ("csv", "parquet", "mat")
CHANNELS = (
    Channel(name="u:base", kind="command", unit="N", at="base", is_input=True),
    Channel(name="sensor:base", kind="velocity", unit="m/s", at="base"),
    Channel(name='odd, "name"; with [signs]', kind="other", unit="", at="a; b"),
)
META = {"seed": 7, "law": "lqg", "gains": [[0.1, 2.0], [1e-300, -0.5]], "ok": True, "none": None, "text": 'µ\n;,"'}


def recording(n=50, **changes):
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.5, 1.5, n)) / 2000
    return Recording(**({"time": time, "data": rng.normal(size=(n, 3)), "channels": CHANNELS, "meta": META} | changes))


def same(one, other):
    return (
        one.time.tobytes() == other.time.tobytes()
        and one.data.tobytes() == other.data.tobytes()
        and one.channels == other.channels
        and dict(one.meta) == dict(other.meta)
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_round_trip_is_exact(tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    write_recording(recording(), path)
    assert same(read_recording(path), recording())
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.slow
@pytest.mark.parametrize("suffix", SUFFIXES)
@given(values=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=20))
@settings(derandomize=True, max_examples=100, deadline=None)
def test_every_finite_double_survives(tmp_path_factory, suffix, values):
    path = tmp_path_factory.mktemp("run") / f"run.{suffix}"
    original = Recording(time=np.arange(len(values)), data=np.array(values)[:, None], channels=CHANNELS[:1])
    write_recording(original, path)
    assert same(read_recording(path), original)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", SUFFIXES)
@given(name=st.text(min_size=1, max_size=12), at=st.text(max_size=8))
@settings(derandomize=True, max_examples=150, deadline=None)
def test_any_label_survives_or_is_refused_before_writing(tmp_path_factory, suffix, name, at):
    path = tmp_path_factory.mktemp("run") / f"run.{suffix}"
    original = recording(3, data=np.ones((3, 1)), channels=[Channel(name=name, kind="force", unit="N", at=at)])
    try:
        write_recording(original, path)
    except BadRecording:
        assert not path.exists()
    else:
        assert same(read_recording(path), original)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_arrays_in_the_notes_become_lists_and_objects_are_refused(tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    write_recording(recording(meta={"K": np.eye(2), "n": np.int64(3)}), path)
    assert dict(read_recording(path).meta) == {"K": [[1.0, 0.0], [0.0, 1.0]], "n": 3}
    with pytest.raises(BadRecording, match="object is not a JSON value"):
        write_recording(recording(meta={"x": object()}), path)


def test_other_suffixes_and_folders_are_refused(tmp_path):
    with pytest.raises(BadRecording, match=r"accepted: \.parquet, \.csv, \.mat, \.uff"):
        write_recording(recording(), tmp_path / "run.npz")
    with pytest.raises(OutputRefused, match="cannot be written"):
        write_recording(recording(), tmp_path / "missing" / "run.csv")
    with pytest.raises(BadRecording, match="'time'"):
        write_recording(
            recording(3, data=np.ones((3, 1)), channels=[Channel(name="time", kind="other", unit="s")]),
            tmp_path / "run.parquet",
        )


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_labelled_files_open_as_tables_by_channel_name(tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    write_recording(recording(), path)
    assert open_table(path).names == ("time", *(channel.name for channel in CHANNELS))
    table = open_table(path, columns=["sensor:base"])
    assert table.names == ("sensor:base",)
    assert table.channels == CHANNELS[1:2]


def test_csv_is_readable_by_people(tmp_path):
    write_recording(recording(channels=CHANNELS[:2], data=np.ones((50, 2))), tmp_path / "run.csv")
    lines = (tmp_path / "run.csv").read_text().splitlines()
    assert lines[0] == "# vlab-recording 1"
    assert "# channel: sensor:base; velocity; m/s; base; output" in lines
    assert lines[5] == "time [s],u:base [N],sensor:base [m/s]"


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("# samples: 50", "# samples: 51", "truncated: 50 of 51 samples"),
        ("# vlab-recording 1", "# vlab-recording 9", "update vlab"),
        ("velocity; m/s", "velocty; m/s", "did you mean 'velocity'"),
        ("; output", "; maybe", "labels .* are damaged"),
        ("sensor:base [m/s]", "sensor:base [mm/s]", "do not agree"),
        ('{"seed"', '{"seed', r"notes \(meta\) are damaged"),
        ("# channel: u:base", "# chanel: u:base", "do not agree"),
    ],
)
def test_edited_csv_labels_are_found(tmp_path, old, new, match):
    path = tmp_path / "run.csv"
    write_recording(recording(), path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(BadRecording, match=match):
        read_recording(path)


def test_every_truncation_is_found(tmp_path):
    # Parquet has its labels at the end; the CSV counts its samples and ends with a line end.
    for suffix in SUFFIXES:
        path = tmp_path / f"run.{suffix}"
        write_recording(recording(8), path)
        whole = path.read_bytes()
        for length in range(1, len(whole), 3 if suffix == "csv" else 13):
            path.write_bytes(whole[:length])
            with pytest.raises(BadRecording):
                read_recording(path)


def test_a_flipped_bit_in_parquet_samples_is_found_by_the_checksum(tmp_path):
    path = tmp_path / "run.parquet"
    write_recording(recording(), path)
    data = bytearray(path.read_bytes())
    data[100] ^= 4
    path.write_bytes(data)
    with pytest.raises(BadRecording, match="CRC"):
        read_recording(path)


@pytest.mark.parametrize(
    ("damage", "match"),
    [
        (lambda t: t.drop_columns(["time"]), "'time' is missing"),
        (
            lambda t: t.set_column(0, pa.field("time", pa.float64()), pa.array([0.0] * 50)),
            "do not increase at sample 1",
        ),
        (lambda t: t.set_column(0, t.schema.field(0), pa.array([0.0] * 50)), "'time' are not those that were written"),
        (lambda t: t.set_column(1, t.schema.field(1), pa.array([float("nan")] * 50)), "NaN at sample 0"),
        (lambda t: t.replace_schema_metadata({"vlab-recording": "2", "meta": "{}"}), "update vlab"),
        (lambda t: t.replace_schema_metadata({"vlab-recording": "1", "meta": "[]"}), "not a JSON table"),
        (lambda t: t.replace_schema_metadata({"vlab-recording": "1", "meta": "[" * 100_000}), "damaged"),
        (lambda t: t.append_column(t.schema.field(1), pa.array([0.0] * 50)), "more than once"),
        (lambda t: t.set_column(1, pa.field("u", pa.float64()), pa.array([0.0] * 50)), "labels .* are damaged"),
    ],
)
def test_parquet_that_contradicts_its_labels_is_refused(tmp_path, damage, match):
    path = tmp_path / "run.parquet"
    write_recording(recording(), path)
    pq.write_table(damage(pq.read_table(path)), path)
    with pytest.raises(BadRecording, match=match):
        read_recording(path)
