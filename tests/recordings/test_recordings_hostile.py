"""Mutated files: a reader gives finite columns or one line of `BadRecording`, and never anything else."""

import io
import warnings

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from vlab.errors import BadRecording
from vlab.recordings import open_table, read_recording, write_recording
from vlab.recordings.quality import findings
from vlab.signals import Channel, Recording

RUN = Recording(
    time=np.arange(12) / 7,
    data=np.random.default_rng(0).normal(size=(12, 2)),
    channels=[
        Channel(name="u", kind="force", unit="N", is_input=True),
        Channel(name="sensor:y", kind="velocity", unit="m/s"),
    ],
    meta={"seed": 1},
)


def own(tmp, suffix):
    write_recording(RUN, tmp / f"run.{suffix}")
    return (tmp / f"run.{suffix}").read_bytes()


def parquet(**options):
    stream = io.BytesIO()
    columns = {"time": RUN.time, "n.m": [1, 2, 3] * 4, "s": ["a", "b", None] * 4, "l": [[1.0]] * 12}
    pq.write_table(pa.table(columns), stream, **options)
    return stream.getvalue()


def mat(*, do_compression):
    stream = io.BytesIO()
    cells = np.array([np.arange(3.0), "text"], dtype=object)
    inner = {"off": np.arange(9.0), "on": {"u": np.arange(4.0) * 1j}}
    variables = {"t": RUN.time, "exp": inner, "name": "abc", "m": np.ones((5, 3), np.int16), "c": cells}
    scipy.io.savemat(stream, variables, do_compression=do_compression)
    return stream.getvalue()


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    tmp = tmp_path_factory.mktemp("sound")
    complex_csv = b"f;H\n0+0j;(1.5+3.4j)\n0.5+0j;1 + 2i\n1+0j;-7\n"
    return {
        "csv": [
            own(tmp, "csv"),
            complex_csv,
            b'# c\r\n"a, b",c\r\n1,2\r\n\r\n',
            b"1\t2\n3\t4.5e3\n-1\t0",
            b"a,b,\n1,2,\n3,4,\n",
        ],
        "parquet": [own(tmp, "parquet"), parquet(), parquet(compression="none", use_dictionary=False)],
        "mat": [mat(do_compression=False), mat(do_compression=True)],
    }


SIGNS = st.sampled_from([b"\n", b",", b";", b'"', b"#", b"-", b"e", b"j", b"nan", b"inf", b"1_0", b"\0", b"\r"])
SIZES = st.sampled_from([b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0" * 4, b"\0\0\0\x40", b"\xff" * 8])
EDIT = st.tuples(
    st.sampled_from(["flip", "insert", "overwrite", "delete", "cut"]),
    st.integers(0, 2**20),
    st.one_of(st.binary(min_size=1, max_size=8), SIGNS, SIZES),
)


def mutate(data, edits):
    data = bytearray(data)
    for what, where, content in edits:
        at = where % max(len(data), 1)
        if what == "flip" and data:
            data[at] ^= content[0] or 1
        elif what == "insert":
            data[at:at] = content
        elif what == "overwrite":
            data[at : at + len(content)] = content
        elif what == "delete":
            del data[at : at + len(content)]
        elif what == "cut" and where % 4 == 0:
            del data[at:]
    return bytes(data)


def opened(read, path):
    """Return what a reader gives, or None where it refuses in one line that names the file."""
    try:
        return read(path)
    except BadRecording as refusal:
        text = str(refusal)
    assert text.isprintable()
    assert text.startswith(str(path))
    return None


def survives(path):
    """Open the file in every way; return whether it was accepted."""
    table = opened(open_table, path)
    recording = opened(read_recording, path)
    if recording is not None:
        findings(recording)
    if table is None:
        return False
    assert table.names
    for values in table.columns.values():
        assert values.ndim == 1
        assert values.dtype in (np.dtype(float), np.dtype(complex))
        assert np.isfinite(values).all()
    return True


@pytest.mark.parametrize("suffix", ["csv", "parquet", "mat"])
@given(choice=st.integers(0, 9), edits=st.lists(EDIT, min_size=1, max_size=4))
@settings(derandomize=True, max_examples=300, deadline=None)
def test_mutated_files_give_finite_columns_or_bad_recording(tmp_path_factory, sound, suffix, choice, edits):
    path = tmp_path_factory.mktemp("hostile") / f"run.{suffix}"
    path.write_bytes(mutate(sound[suffix][choice % len(sound[suffix])], edits))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        survives(path)


@pytest.mark.parametrize("suffix", ["csv", "parquet", "mat"])
@given(data=st.binary(max_size=300))
@settings(derandomize=True, max_examples=100, deadline=None)
def test_noise_gives_finite_columns_or_bad_recording(tmp_path_factory, suffix, data):
    path = tmp_path_factory.mktemp("hostile") / f"run.{suffix}"
    magic = {"csv": b"", "parquet": b"PAR1", "mat": b"MATLAB 5.0".ljust(124) + b"\0\1IM"}[suffix]
    path.write_bytes(magic + data + (magic if suffix == "parquet" else b"") or b"\n")
    survives(path)


def test_sound_files_are_accepted(tmp_path, sound):
    for suffix, contents in sound.items():
        for content in contents:
            path = tmp_path / f"run.{suffix}"
            path.write_bytes(content)
            assert survives(path)


def test_every_cut_of_a_mat_or_parquet_file_is_refused_or_whole_variables(tmp_path, sound):
    for suffix in ("mat", "parquet"):
        whole = sound[suffix][0]
        for length in range(1, len(whole), 11):
            path = tmp_path / f"run.{suffix}"
            path.write_bytes(whole[:length])
            survives(path)


def test_pickles_in_any_disguise_are_not_opened(tmp_path):
    marker = tmp_path / "executed"
    payload = b"cposix\nsystem\n(S'touch " + str(marker).encode() + b"'\ntR."
    for suffix in ("csv", "parquet", "mat"):
        path = tmp_path / f"run.{suffix}"
        path.write_bytes(payload)
        with pytest.raises(BadRecording):
            open_table(path)
    path = tmp_path / "run.parquet"
    schema = pa.schema(
        [
            pa.field(
                "x",
                pa.float64(),
                metadata={"ARROW:extension:name": "arrow.py_extension_type", "ARROW:extension:metadata": payload},
            )
        ]
    )
    pq.write_table(pa.table({"x": [1.0]}, schema=schema), path)  # CVE-2023-47248
    survives(path)
    assert not marker.exists()
