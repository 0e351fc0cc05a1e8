"""Mutated files: a reader gives finite columns or one line of `BadRecording`, and never anything else."""

import gzip
import io
import warnings

import mutated
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import sound
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mutated import mutate

from vlab.errors import BadRecording
from vlab.recordings import open_table, read_recording, write_recording
from vlab.recordings.isolated import is_installed
from vlab.recordings.quality import findings
from vlab.recordings.table import READERS
from vlab.signals import Channel, Recording

LIBRARIES = {"xlsx": "openpyxl", "mcap": "mcap_ros2", "db3": "mcap_ros2"}
OPTIONAL = [kind for kind, library in LIBRARIES.items() if is_installed(library)]

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


def parquet(*, with_vector=False, **options):
    stream = io.BytesIO()
    columns = {"time": RUN.time, "n.m": [1, 2, 3] * 4, "s": ["a", "b", None] * 4}
    if with_vector:
        columns["l"] = [[1.0]] * 12
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
def files(tmp_path_factory):
    """Sound files by kind; a kind is a suffix, with a word for how it is written where there are several."""
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
        "parquet with vectors": [parquet(with_vector=True)],
        "mat": [mat(do_compression=False), mat(do_compression=True), own(tmp, "mat")],
        "npz": [sound.npz(), sound.npz(is_packed=False)],
        "uff": [
            own(tmp, "uff"),
            *(sound.uff(is_binary=binary, is_even=even) for binary in (False, True) for even in (False, True)),
            sound.uff(is_binary=False, is_complex=False),
        ],
        "h5": [sound.hdf5(), sound.hdf5(libver="latest")],
        "mat 7.3": [sound.matlab_73()],
        "tdms": [sound.tdms()],
        "txt": [b"# t x\n0.0 1.0\n 0.1  2.5\n", b"% t;x\nt x\n0,1 2,5\n0,2 3,5\n", b"Time (s)   F (N)\n1 2\n3 4\n"],
        "lvm": [sound.LVM.encode(), sound.LVM.replace("One", "No").replace("\n0.", "\n\t0.").encode()],
        "jsonl": [b'{"t": 0, "q": [1, 2.5], "s": "a"}\n{"t": 1, "q": [3, null], "v": {"x": true}}\n'],
        "json": [
            b'{"kp": 3, "e": [{"t": 0, "q": 1}, {"t": 1, "q": 2}], "m": [[1, 2], [3, 4]]}',
            b'[{"t": 0}, {"t": 1}]',
        ],
        "csv.gz": [gzip.compress(b"t,x\n0,1\n1,2.5\n", mtime=0)],
        "npy": [sound.npy(), sound.npy(np.zeros(3, dtype=[("t", "f8"), ("n", "i2")])), sound.npy(np.ones((4, 3, 2)))],
        **{kind: [getattr(sound, kind)()] for kind in OPTIONAL},
    }


HERE = ["csv", "parquet", "mat", "npz", "uff", "txt", "lvm", "jsonl", "json", "csv.gz", "npy"]
ISOLATED = ["parquet with vectors", "h5", "mat 7.3", "tdms", *OPTIONAL]
KINDS = HERE + ISOLATED


def suffix_of(kind):
    return kind.split()[0]


EDIT = st.tuples(
    st.sampled_from(mutated.EDITS),
    st.integers(0, 2**20),
    st.one_of(st.binary(min_size=1, max_size=8), st.sampled_from(mutated.SIGNS), st.sampled_from(mutated.SIZES)),
)


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


def check_mutated(folder, files, kind, choice, edits):
    path = folder / f"run.{suffix_of(kind)}"
    original = files[kind][choice % len(files[kind])]
    path.write_bytes(mutate(original, edits))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        survives(path)


FAST = settings(derandomize=True, max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])
THOUSANDS = settings(FAST, max_examples=4000)
EDITS = st.lists(EDIT, min_size=1, max_size=4)


@pytest.mark.parametrize("kind", HERE)
@given(choice=st.integers(0, 29), edits=EDITS)
@FAST
def test_mutated_files_give_finite_columns_or_bad_recording(tmp_path_factory, files, kind, choice, edits):
    check_mutated(tmp_path_factory.getbasetemp(), files, kind, choice, edits)


@pytest.mark.slow
@pytest.mark.usefixtures("workers")
@pytest.mark.parametrize("kind", ISOLATED)
@given(choice=st.integers(0, 29), edits=EDITS)
@settings(FAST, max_examples=60)
def test_mutated_files_that_are_read_in_a_process_of_their_own(tmp_path_factory, files, kind, choice, edits):
    check_mutated(tmp_path_factory.getbasetemp(), files, kind, choice, edits)


@pytest.mark.slow
@pytest.mark.parametrize("kind", HERE)
@given(choice=st.integers(0, 29), edits=EDITS)
@THOUSANDS
def test_thousands_of_mutated_files_give_finite_columns_or_bad_recording(tmp_path_factory, files, kind, choice, edits):
    check_mutated(tmp_path_factory.getbasetemp(), files, kind, choice, edits)


@pytest.mark.slow
@pytest.mark.usefixtures("workers")
@pytest.mark.parametrize("kind", ISOLATED)
@given(choice=st.integers(0, 29), edits=EDITS)
@settings(THOUSANDS, max_examples=1500)
def test_thousands_of_mutated_files_that_are_read_in_a_process_of_their_own(
    tmp_path_factory, files, kind, choice, edits
):
    check_mutated(tmp_path_factory.getbasetemp(), files, kind, choice, edits)


@pytest.mark.usefixtures("workers")
@pytest.mark.parametrize("kind", KINDS)
@given(data=st.binary(max_size=300))
@settings(FAST, max_examples=40)
def test_noise_gives_finite_columns_or_bad_recording(tmp_path_factory, kind, data):
    path = tmp_path_factory.getbasetemp() / f"noise.{suffix_of(kind)}"
    begin = {
        "csv": b"",
        "parquet": b"PAR1",
        "parquet with vectors": b"PAR1",
        "mat": b"MATLAB 5.0".ljust(124) + b"\0\1IM",
        "npz": b"PK\3\4",
        "uff": b"    -1\n    58\n",
        "h5": b"\x89HDF\r\n\x1a\n",
        "mat 7.3": b"MATLAB 7.3".ljust(124) + b"\0\2IM".ljust(388) + b"\x89HDF\r\n\x1a\n",
        "tdms": b"TDSm",
        "txt": b"0 1\n",
        "lvm": b"LabVIEW Measurement\n",
        "jsonl": b'{"t": ',
        "json": b"[",
        "csv.gz": gzip.compress(b"t\n1\n")[:10],
        "npy": b"\x93NUMPY\1\0",
        "xlsx": b"PK\3\4",
        "mcap": b"\x89MCAP0\r\n",
        "db3": b"SQLite format 3\0",
    }[kind]
    path.write_bytes(begin + data + (begin if kind == "parquet" else b"") or b"\n")
    survives(path)


# ------------------------------------------------------------------------------------------- no silent change of data


def check_own(folder, files, suffix, edits):
    """A mutated file of vlab's own is refused or gives every sample, time stamp and label as it was written."""
    path = folder / f"own.{suffix}"
    path.write_bytes(mutate(files[suffix][-1 if suffix == "mat" else 0], edits))
    read = opened(read_recording, path)
    if read is not None:
        assert read.time.tobytes() == RUN.time.tobytes()
        assert read.data.tobytes() == RUN.data.tobytes()
        assert read.channels == RUN.channels


@pytest.mark.parametrize("suffix", ["parquet", "mat", "uff"])
@given(edits=EDITS)
@FAST
def test_no_mutation_of_an_own_file_changes_a_sample_silently(tmp_path_factory, files, suffix, edits):
    check_own(tmp_path_factory.getbasetemp(), files, suffix, edits)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["parquet", "mat", "uff"])
@given(edits=EDITS)
@THOUSANDS
def test_none_of_thousands_of_mutations_of_an_own_file_changes_a_sample_silently(
    tmp_path_factory, files, suffix, edits
):
    check_own(tmp_path_factory.getbasetemp(), files, suffix, edits)


@given(choice=st.integers(0, 1), edits=EDITS)
@settings(FAST, max_examples=150)
def test_no_mutation_of_an_archive_changes_a_sample_silently(tmp_path_factory, files, choice, edits):
    # The members of an archive have checksums: whatever is accepted, under whatever name, was in the sound file.
    path = tmp_path_factory.getbasetemp() / "archive.npz"
    path.write_bytes(files["npz"][choice])
    sound_bits = {values.tobytes() for values in open_table(path).columns.values()}
    path.write_bytes(mutate(files["npz"][choice], edits))
    table = opened(open_table, path)
    if table is not None:
        assert {values.tobytes() for values in table.columns.values()} <= sound_bits


@pytest.mark.usefixtures("workers")
@pytest.mark.parametrize("kind", KINDS)
def test_sound_files_are_accepted(tmp_path, files, kind):
    for content in files[kind]:
        path = tmp_path / f"run.{suffix_of(kind)}"
        path.write_bytes(content)
        assert survives(path)


@pytest.mark.slow
@pytest.mark.usefixtures("workers")
@pytest.mark.parametrize("kind", KINDS)
def test_a_truncated_file_is_refused_or_gives_whole_columns(tmp_path, files, kind):
    for content in files[kind]:
        path = tmp_path / f"run.{suffix_of(kind)}"
        path.write_bytes(content)
        whole = open_table(path)
        for length in range(1, len(content), max(1, len(content) // 60)):
            path.write_bytes(content[:length])
            table = opened(open_table, path)
            if table is None or kind in ("csv", "txt", "lvm", "jsonl"):
                continue  # a text may end with any line, and says so where it ends within one; vlab's own counts them
            for name, values in table.columns.items():
                assert values.tobytes() == whole[name].tobytes(), (kind, length, name)


def test_pickles_in_any_disguise_are_not_opened(tmp_path):
    marker = tmp_path / "executed"
    payload = b"cposix\nsystem\n(S'touch " + str(marker).encode() + b"'\ntR."
    for suffix in READERS:
        path = tmp_path / f"run{suffix}"
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
