"""MAT files: against scipy on sound files; damaged ones are refused where scipy.io.loadmat ends the process."""

import struct
import zlib

import numpy as np
import pytest
import scipy.io

from vlab.errors import BadRecording
from vlab.recordings import files, open_table


def mat(tmp_path, variables, **options):
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, variables, **options)
    return path


@pytest.mark.parametrize("do_compression", [False, True])
def test_variables_structs_and_matrices_become_columns(tmp_path, do_compression):
    t = np.arange(7) / 3.0
    variables = {
        "t": t[:, None],
        "row": t[None, :],
        "fs": 100.0,
        "counts": np.arange(5, dtype=np.int16),
        "on": np.array([True, False, True]),
        "H": np.exp(1j * t),
        "exp": {"off": t**2, "inner": {"u": t**3}},
        "Y": np.column_stack([t, -t]),
        "operator": "me",
    }
    table = open_table(mat(tmp_path, variables, do_compression=do_compression))
    for name, expected in {
        "t": t,
        "row": t,
        "fs": [100.0],
        "counts": np.arange(5),
        "on": [1, 0, 1],
        "H": np.exp(1j * t),
        "exp.off": t**2,
        "exp.inner.u": t**3,
        "Y_1": t,
        "Y_2": -t,
    }.items():
        np.testing.assert_array_equal(table[name], expected)
    assert table.meta == {"operator": "me"}
    for name, hint in [("exp", "a struct; name what is in it, such as 'exp.off'"), ("Y", "a 7 x 2 matrix; .*'Y_1'")]:
        with pytest.raises(BadRecording, match=hint):
            table[name]


@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8", "c8", "c16"])
def test_every_number_type_is_read_as_scipy_reads_it(tmp_path, dtype):
    rng = np.random.default_rng(3)
    values = (np.abs(rng.normal(size=40) * 50 + 60) + (1j * rng.normal(size=40) if dtype[0] == "c" else 0)).astype(
        dtype
    )
    path = mat(tmp_path, {"x": values}, do_compression=True)
    np.testing.assert_array_equal(open_table(path)["x"], scipy.io.loadmat(path)["x"].ravel())


def test_samples_run_along_the_longest_axis(tmp_path):
    wide, cube = np.arange(12.0).reshape(2, 6), np.arange(40.0).reshape(2, 2, 10)
    table = open_table(mat(tmp_path, {"wide": wide, "H": cube, "flat": cube[:, :1, :]}))
    np.testing.assert_array_equal(table["wide_2"], wide[1])
    np.testing.assert_array_equal(table["H_2_1"], cube[1, 0])
    np.testing.assert_array_equal(table["flat_2"], cube[1, 0])
    assert any("axis 2" in note for note in table.notes)


def test_struct_arrays_and_cells_are_numbered(tmp_path):
    runs = np.empty((1, 2), dtype=[("y", object)])
    runs[0, 0]["y"], runs[0, 1]["y"] = np.arange(3.0), np.arange(4.0)
    cells = np.array([np.arange(5.0), "text"], dtype=object)
    table = open_table(mat(tmp_path, {"run": runs, "c": cells}))
    assert (table["run_1.y"].size, table["run_2.y"].size, table["c_1"].size) == (3, 4, 5)
    assert table.meta == {"c_2": "text"}


def test_what_is_no_column_does_not_spoil_the_rest(tmp_path):
    gap = np.array([1.0, np.nan, 3.0])
    path = mat(
        tmp_path, {"ok": np.arange(3.0), "gap": gap, "none": [], "S": scipy.sparse.eye(3), "map": np.ones((1001, 1001))}
    )
    table = open_table(path)
    assert table.names == ("ok",)
    for name, why in [
        ("gap", "NaN at sample 1"),
        ("none", "empty"),
        ("S", "a sparse matrix"),
        ("map", "more than 1000 columns"),
    ]:
        with pytest.raises(BadRecording, match=why):
            table[name]


@pytest.mark.parametrize(("array_class", "what"), [(16, "a function handle"), (3, "an object")])
def test_objects_and_functions_are_skipped_with_a_note(tmp_path, array_class, what):
    path = mat(tmp_path, {"x": np.arange(3.0), "y": np.arange(3.0)})
    data = bytearray(path.read_bytes())
    assert struct.unpack_from("<II", data, 136) == (6, 8)  # the array flags of the first variable
    data[144] = array_class
    path.write_bytes(data)
    table = open_table(path)
    assert table.names == ("y",)
    assert what in table.notes[0]


def test_two_things_of_one_name_are_neither(tmp_path):
    table = open_table(mat(tmp_path, {"Y": np.ones((4, 2)), "Y_1": np.zeros(3)}))
    with pytest.raises(BadRecording, match="two things"):
        table["Y_1"]
    assert table["Y_2"].size == 4


def test_versions_that_are_not_read_say_how_to_save(tmp_path):
    with pytest.raises(BadRecording, match=r"not a MAT file of version 5 to 7\.3; save as -v7"):
        open_table(mat(tmp_path, {"x": np.arange(30.0)}, format="4"))


@pytest.mark.parametrize("dtype", [np.int64, np.uint64])
def test_integers_that_a_double_cannot_hold_are_refused(tmp_path, dtype):
    table = open_table(mat(tmp_path, {"clock": np.arange(4, dtype=dtype) + 2**60, "x": np.arange(4.0)}))
    with pytest.raises(BadRecording, match="beyond the precision of a float; subtract the start of a clock"):
        table["clock"]


def element(order, kind, content):
    return struct.pack(order + "II", kind, len(content)) + content + b"\0" * (-len(content) % 8)


def vector(order, name, *values):
    flags, shape = (
        element(order, 6, struct.pack(order + "II", 6, 0)),
        element(order, 5, struct.pack(order + "ii", len(values), 1)),
    )
    return element(
        order,
        14,
        flags + shape + element(order, 1, name) + element(order, 9, struct.pack(f"{order}{len(values)}d", *values)),
    )


def test_big_endian_files_are_read(tmp_path):
    path = tmp_path / "run.mat"
    path.write_bytes(b"MATLAB 5.0".ljust(124) + b"\x01\x00MI" + vector(">", b"x", 1.0, 2.0, 3.0))
    assert open_table(path)["x"].tolist() == [1.0, 2.0, 3.0]


def test_opaque_objects_and_their_data_are_skipped(tmp_path):
    # MATLAB classes (string, table, datetime) have no dimensions; their data stand in a variable without a name.
    flags = element("<", 6, struct.pack("<II", 17, 0))
    opaque = element("<", 14, flags + b"".join(element("<", 1, text) for text in (b"when", b"MCOS", b"datetime")))
    path = tmp_path / "run.mat"
    path.write_bytes(
        b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + opaque + vector("<", b"x", 1.0, 2.0) + vector("<", b"", 7.0)
    )
    table = open_table(path)
    assert table.names == ("x",)
    assert table.notes == ("when: an object skipped", "unnamed data for objects skipped")


def test_declared_sizes_are_not_believed(tmp_path):
    path = mat(tmp_path, {"x": np.arange(30.0)})
    sound = path.read_bytes()
    for offset, size in [
        (132, 2**31),
        (156, 2**30),
        (164, 2**31 - 1),
    ]:  # the variable, its dimensions, the first of them
        data = bytearray(sound)
        struct.pack_into("<I", data, offset, size)
        path.write_bytes(data)
        with pytest.raises(BadRecording, match=r"declare|dimensions"):
            open_table(path)


def test_a_compressed_bomb_is_stopped_by_the_budget(tmp_path, monkeypatch):
    path = mat(tmp_path, {"x": np.zeros(10_000)}, do_compression=True)
    assert path.stat().st_size < 1000
    monkeypatch.setattr(files, "MAX_BYTES", 50_000)
    with pytest.raises(BadRecording, match="more than 50000 bytes when unpacked"):
        open_table(path)


def test_a_wrong_checksum_is_found(tmp_path):
    path = mat(tmp_path, {"x": np.arange(30.0)}, do_compression=True)
    data = bytearray(path.read_bytes())
    packed = bytes(data[136:])
    content = bytearray(zlib.decompress(packed))
    content[-3] ^= 1  # stored again with the old checksum
    compressor = zlib.compressobj(level=0)
    body = compressor.compress(bytes(content)) + compressor.flush()
    data[132:] = struct.pack("<I", len(body)) + body[:-4] + packed[-4:]
    path.write_bytes(data)
    with pytest.raises(BadRecording, match="compressed variable is"):
        open_table(path)


def test_structs_nested_without_end_are_refused(tmp_path):
    value = np.arange(3.0)
    for _ in range(30):
        value = {"a": value}
    with pytest.raises(BadRecording, match="nested more than"):
        open_table(mat(tmp_path, {"s": value}))


def test_names_are_not_for_mat_files(tmp_path):
    with pytest.raises(BadRecording, match="names its own variables"):
        open_table(mat(tmp_path, {"x": np.arange(3.0)}), names=["y"])
