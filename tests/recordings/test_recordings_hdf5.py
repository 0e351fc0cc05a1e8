"""HDF5 and MAT 7.3: what is read, what is never followed, and the process that they are read in."""

import io

import h5py
import numpy as np
import pytest
import sound

from vlab.errors import BadRecording
from vlab.recordings import files, isolated, open_table
from vlab.recordings.assemble import ColumnSpec, to_recording


def opened(tmp_path, content, name="run.h5"):
    (tmp_path / name).write_bytes(content)
    return open_table(tmp_path / name)


@pytest.mark.parametrize("libver", ["earliest", "latest"])
def test_data_sets_are_columns_by_their_path(tmp_path, libver):
    table = opened(tmp_path, sound.hdf5(libver=libver))
    np.testing.assert_array_equal(table["run/inner/x"], sound.TIMES)
    np.testing.assert_array_equal(table["H"], np.exp(1j * sound.TIMES))
    np.testing.assert_array_equal(table["m_2"], np.arange(1.0, 12.0, 2.0))
    np.testing.assert_array_equal(table["packed"], np.arange(8.0))
    assert table["i"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert dict(table.meta) == {"operator": "me", "s": "hello"}
    assert table.units["run/inner/x"] == "mm"


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("ext", "a link to another file .*, which is never opened"),
        ("soft", "a soft link; name its target"),
        ("outside", "stored in another file, which is never opened"),
        ("view", "a view of other files"),
        ("part", "not whole: 1 of 5 blocks of samples were written"),
        ("never", "not whole: 0 of 80 bytes of samples were written"),
    ],
)
def test_what_is_elsewhere_or_was_never_written_is_refused_by_name(tmp_path, name, why):
    # h5py follows all of these, and gives zeros for what was never written
    with h5py.File(tmp_path / "secret.h5", "w") as secret:
        secret["x"] = np.full(7, 42.0)
    table = opened(tmp_path, sound.hdf5())
    with pytest.raises(BadRecording, match=why):
        table[name]
    assert not any((values == 42.0).any() for values in table.columns.values())
    assert any(name in note for note in table.notes)


def test_matlab_73_is_read_as_matlab_saved_it(tmp_path):
    table = opened(tmp_path, sound.matlab_73(), "run.mat")
    for name, expected in {
        "t": sound.TIMES,
        "Y_1": sound.TIMES,
        "Y_2": -sound.TIMES,
        "H": np.cos(sound.TIMES) + 1j * np.sin(sound.TIMES),
        "s.u": np.ones(3),
        "c_1": np.arange(3.0),
    }.items():
        np.testing.assert_array_equal(table[name], expected)
    assert dict(table.meta) == {"name": "héllo", "c_2": "xy"}
    for name, why in [("A", "a sparse matrix"), ("none", "empty"), ("s", "a struct; name what is in it")]:
        with pytest.raises(BadRecording, match=why):
            table[name]


def test_the_unit_in_the_file_is_held_against_the_given_one(tmp_path):
    table = opened(tmp_path, sound.hdf5())
    spec = {"column": "run/inner/x", "kind": "displacement"}
    run = to_recording(table, [ColumnSpec(unit="mm", **spec)], rate_hz=10.0)
    np.testing.assert_array_equal(run.data[:, 0], sound.TIMES * 1e-3)
    with pytest.raises(ValueError, match=r"states 'mm' and the description 'in', a factor of 25\.4 between them"):
        to_recording(table, [ColumnSpec(unit="in", **spec)], rate_hz=10.0)
    with pytest.raises(ValueError, match="states 'mm' and the description 'N', another dimension"):
        to_recording(table, [ColumnSpec(column="run/inner/x", kind="force", unit="N")], rate_hz=10.0)
    scaled = to_recording(table, [ColumnSpec(scale=2.0, **spec)], rate_hz=10.0)  # a scale is taken as it is
    np.testing.assert_array_equal(scaled.data[:, 0], sound.TIMES * 2.0)


def test_declared_sizes_are_not_believed(tmp_path, monkeypatch):
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        file.create_dataset("x", (2**40,), dtype="f8", chunks=(2**10,))
    with pytest.raises(BadRecording, match="declares more than .* bytes when unpacked"):
        opened(tmp_path, stream.getvalue())
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        file.create_dataset("x", data=np.zeros(10**5), compression="gzip", chunks=(10**5,))
    assert len(stream.getvalue()) < 10_000
    monkeypatch.setattr(files, "MAX_BYTES", 500_000)
    with pytest.raises(BadRecording, match="declares more than 500000 bytes when unpacked"):
        opened(tmp_path, stream.getvalue())


def test_a_truncated_or_empty_file_is_refused(tmp_path):
    with pytest.raises(BadRecording, match="truncated"):
        opened(tmp_path, sound.hdf5()[:-100])
    with pytest.raises(BadRecording, match="signature not found"):
        opened(tmp_path, b"no such thing" * 100)
    with pytest.raises(BadRecording, match="empty"):
        opened(tmp_path, b"")


def test_names_are_not_for_hdf5_files(tmp_path):
    (tmp_path / "run.h5").write_bytes(sound.hdf5())
    with pytest.raises(BadRecording, match="names its own data sets"):
        open_table(tmp_path / "run.h5", names=["x"])


NAUGHTY = {
    "crash": ("import os; os.kill(os.getpid(), 11)", "broke down on it: signal 11"),
    "hang": ("while True: pass", "takes more than 2 s"),
    "memory": ("return {'variables': [('x', 'y' * 10**11)]}", "needs more memory than a file of its size may take"),
    "file": ("open('/etc/passwd')", "Too many open files"),
    "exit": ("import os; os._exit(3)", r"broke down on it: .*\(status 3\)"),
    "nothing": ("return {'variables': [], 'units': {}, 'notes': [], 'meta': {}}", "no numeric column"),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", NAUGHTY)
def test_a_library_that_misbehaves_harms_nobody(tmp_path, monkeypatch, what):
    # The HDF5 library does the first two on damaged files: a few of each ten thousand mutated ones.
    body, match = NAUGHTY[what]
    (tmp_path / "sandbox.py").write_bytes((isolated.WORKERS / "sandbox.py").read_bytes())
    (tmp_path / "read_hdf5.py").write_text(f"def read(data, options):\n    {body}\n")
    monkeypatch.setattr(isolated, "WORKERS", tmp_path)
    with pytest.raises(BadRecording, match=match) as caught:
        opened(tmp_path, b"anything")
    assert str(caught.value).isprintable()


def test_a_library_that_is_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(isolated, "is_installed", lambda library: False)
    with pytest.raises(BadRecording, match=r"reading \.tdms files needs nptdms; pip install 'vlab-vibration\[tdms\]'"):
        opened(tmp_path, sound.tdms(), "run.tdms")
    with pytest.raises(BadRecording, match=r"reading \.mat files needs h5py; pip install h5py"):
        opened(tmp_path, sound.matlab_73(), "run.mat")
