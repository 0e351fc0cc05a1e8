"""NPZ: numbers only; pickles are never opened, and sizes and checksums are held against the bytes."""

import io
import os
import struct
import zipfile

import numpy as np
import pytest
import sound

from vlab.errors import BadRecording
from vlab.recordings import files, open_table


def opened(tmp_path, content):
    (tmp_path / "run.npz").write_bytes(content)
    return open_table(tmp_path / "run.npz")


def archive(**members):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as made:
        for name, content in members.items():
            made.writestr(name.replace("_npy", ".npy"), content)
    return stream.getvalue()


def array(values, **header):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": values.dtype.str, "fortran_order": False, "shape": values.shape} | header
    )
    return stream.getvalue() + values.tobytes()


@pytest.mark.parametrize("is_packed", [True, False])
def test_arrays_are_columns(tmp_path, is_packed):
    table = opened(tmp_path, sound.npz(is_packed=is_packed, F=np.asfortranarray([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])))
    np.testing.assert_array_equal(table["t"], sound.TIMES)
    np.testing.assert_array_equal(table["H"], np.exp(1j * sound.TIMES))
    np.testing.assert_array_equal(table["m_2"], np.arange(1.0, 12.0, 2.0))
    np.testing.assert_array_equal(table["F_2"], [2.0, 4.0, 6.0])
    assert table.meta == {"who": "me"}


@pytest.mark.parametrize("dtype", ["?", "i1", "u2", ">i4", "u8", "f2", ">f4", "f8", "c8", ">c16"])
def test_every_number_type_is_read_as_numpy_reads_it(tmp_path, dtype):
    values = np.array([0, 1, 3, 100]).astype(dtype)
    table = opened(tmp_path, sound.npz(x=values))
    np.testing.assert_array_equal(table["x"], np.load(tmp_path / "run.npz")["x"])


class Payload:
    def __init__(self, marker):
        self.marker = marker

    def __reduce__(self):
        return os.system, (f"touch {self.marker}",)


def test_a_pickle_is_never_opened(tmp_path):
    marker = tmp_path / "executed"
    stream = io.BytesIO()
    np.savez(stream, x=np.arange(3.0), evil=np.array([Payload(marker)], dtype=object))
    table = opened(tmp_path, stream.getvalue())
    assert table.names == ("x",)
    with pytest.raises(BadRecording, match="a pickle, which could run a program and is never opened"):
        table["evil"]
    assert not marker.exists()
    np.load(tmp_path / "run.npz", allow_pickle=True)["evil"]  # the test can fail: this is what would happen
    assert marker.exists()


@pytest.mark.parametrize(
    ("values", "why"),
    [
        (np.array(["2024-01-01"], dtype="M8[s]"), "a time must be in seconds"),
        (np.array(["a", "b"]), "an array of text"),
        (np.zeros(2, dtype=[("t", "f8"), ("x", "f8")]), "a structured array"),
        (np.array([1, 2**60 + 1]), "beyond the precision of a float"),
        (np.array([1.0, np.nan]), "NaN at sample 1"),
        (np.array([[]]), "empty"),
        (np.array([1 / np.longdouble(3)]), "128 bits beyond the precision"),
    ],
)
def test_what_is_no_column_is_refused_by_name(tmp_path, values, why):
    table = opened(tmp_path, sound.npz(x=values))
    with pytest.raises(BadRecording, match=why):
        table["x"]


X = np.arange(4.0)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (array(X, shape=(10**12,)), "declares .*8000000000000 bytes, and holds 32"),
        (array(X, shape=(3,)), "24 bytes, and holds 32"),
        (array(X, shape=(-1,)), "and holds 32"),
        (array(X, shape=(2, 3)), "48 bytes, and holds 32"),
        (array(X, descr="<f4"), "16 bytes, and holds 32"),
        (array(X, descr="no such"), "damaged header"),
        (array(X)[:-3], "32 bytes, and holds 29"),
        (array(X)[:40], "damaged header"),
        (b"not an array", "damaged header"),
        (b"", "damaged header"),
        (b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**31) + b"{", "damaged header"),
        (b"\x93NUMPY\x01\x00" + struct.pack("<H", 60_000) + b"(" * 60_000, "damaged header"),
    ],
)
def test_headers_that_lie_are_refused(tmp_path, content, match):
    with pytest.raises(BadRecording, match=match):
        opened(tmp_path, archive(x_npy=content))


def test_a_bomb_is_not_unpacked(tmp_path, monkeypatch):
    content = sound.npz(x=np.zeros(10**6))
    assert len(content) < 20_000
    assert opened(tmp_path, content)["x"].size == 10**6  # within what any file may unpack to
    monkeypatch.setattr(files, "_ALWAYS", 10**6)
    with pytest.raises(BadRecording, match="more than .* bytes when unpacked"):
        opened(tmp_path, content)


def test_a_declared_size_that_is_too_small_does_not_cut_the_samples(tmp_path):
    content = bytearray(sound.npz(is_packed=False))
    where = content.index(b"PK\x01\x02")  # the first entry of the directory: sizes at 20 and 24
    for offset in (20, 24):
        (size,) = struct.unpack_from("<I", content, where + offset)
        struct.pack_into("<I", content, where + offset, size - 8)
    with pytest.raises(BadRecording, match="is damaged: Bad CRC"):
        opened(tmp_path, bytes(content))


def test_damaged_archives_are_refused(tmp_path):
    whole = sound.npz()
    with pytest.raises(BadRecording, match="not a whole NPZ file"):
        opened(tmp_path, whole[:-30])
    flipped = bytearray(sound.npz(is_packed=False))
    flipped[150] ^= 1  # a sample
    with pytest.raises(BadRecording, match="'t.npy' is damaged: Bad CRC"):
        opened(tmp_path, bytes(flipped))
    with pytest.raises(BadRecording, match="no numeric column"):
        opened(tmp_path, archive(readme="text"))
    (tmp_path / "run.npz").write_bytes(whole)
    with pytest.raises(BadRecording, match="names its own arrays"):
        open_table(tmp_path / "run.npz", names=["x"])
