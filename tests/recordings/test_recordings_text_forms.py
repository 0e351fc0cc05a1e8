"""Text separated by blanks, LabVIEW measurement files, JSON, NPY and packed files."""

import gzip
import json

import numpy as np
import pytest
import sound

from vlab.errors import BadRecording, UnknownName
from vlab.recordings import open_table
from vlab.recordings.table import EVERY

TIME = np.arange(6) / 10
VALUES = np.column_stack([TIME, np.sin(TIME), TIME**2])


def write(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


# ---- text ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["txt", "dat"])
def test_what_numpy_writes_as_text_is_read_to_the_last_digit(tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    np.savetxt(path, VALUES, header="t force x", fmt="%.17g")
    table = open_table(path)
    assert table.names == ("t", "force", "x")
    np.testing.assert_array_equal(np.column_stack([table[name] for name in table.names]), VALUES)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("0.0 1.0\n0.1  2.0\n", ("c1", "c2")),
        ("t   x\n 0.0 1.0\n 0.1 2.0\n", ("t", "x")),
        ("A title of the test\nTime (s)   Force (N)\n0 1\n0.1 2\n", ("Time (s)", "Force (N)")),
        ("% made by Octave\n% t x\n0 1\n0.1 2\n", ("t", "x")),
        ("t;x\n0,0;1,0\n0,1;2,0\n", ("t", "x")),
        ("t\tx\n0.0\t1.0\n0.1\t2.0\n", ("t", "x")),
    ],
)
def test_layouts_of_text(tmp_path, text, names):
    table = open_table(write(tmp_path, "run.txt", text))
    assert table.names == names
    np.testing.assert_allclose(table[names[0]], [0.0, 0.1])
    np.testing.assert_allclose(table[names[1]], [1.0, 2.0])


def test_the_unit_in_brackets_of_text_is_stated(tmp_path):
    assert open_table(write(tmp_path, "run.txt", "Time (s)   Force (N)\n0 1\n1 2\n")).units == {
        "Time (s)": "s",
        "Force (N)": "N",
    }


def test_a_fault_in_text_names_the_line_of_the_file(tmp_path):
    with pytest.raises(BadRecording, match=r"line 4: column 2 \('x'\) is 'oops'"):
        open_table(write(tmp_path, "run.txt", "t x\n0 1\n1 2\n2 oops\n"))
    with pytest.raises(BadRecording, match="line 3: 1 cells where 2"):
        open_table(write(tmp_path, "run.txt", "t x\n0 1\n1\n"))


# ---- LabVIEW ---------------------------------------------------------------------------------------------------------


def test_a_labview_file_gives_times_channels_and_no_comment(tmp_path):
    table = open_table(write(tmp_path, "run.lvm", sound.LVM))
    assert table.names == ("X_Value", "Force", "Acceleration")
    np.testing.assert_allclose(table["X_Value"], [0.5, 0.6, 0.7])
    np.testing.assert_allclose(table["Acceleration"], [2.0, 2.5, 2.6])
    assert table.units["X_Value"] == "s"


def test_a_labview_file_without_times_takes_them_from_its_header(tmp_path):
    text = (
        sound.LVM.replace("One", "No")
        .replace("0.500000\t", "\t")
        .replace("0.600000\t", "\t")
        .replace("0.700000\t", "\t")
    )
    table = open_table(write(tmp_path, "run.lvm", text), columns=["Force", "X_Value"])
    np.testing.assert_allclose(table["X_Value"], [0.5, 0.6, 0.7])
    np.testing.assert_allclose(table["Force"], [1.0, 1.5, 1.6])


def test_segments_of_a_labview_file_follow_each_other(tmp_path):
    head, _, segment = sound.LVM.partition("***End_of_Header***\t\n")
    more = segment.replace("0.500000", "0.800000").replace("0.600000", "0.900000").replace("0.700000", "1.000000")
    table = open_table(write(tmp_path, "run.lvm", f"{head}***End_of_Header***\t\n{segment}\n{more}"))
    np.testing.assert_allclose(table["X_Value"], np.arange(5, 11) / 10)
    assert "2 segments are strung together" in table.notes
    other = more.replace("Acceleration", "Velocity")
    with pytest.raises(BadRecording, match="different channels"):
        open_table(write(tmp_path, "run.lvm", f"{head}***End_of_Header***\t\n{segment}\n{other}"))


# ---- JSON ------------------------------------------------------------------------------------------------------------


def test_json_lines_are_flattened(tmp_path):
    lines = [{"t": k / 10, "joint": {"q": [k, -k]}, "on": k > 1, "who": "me"} for k in range(4)]
    table = open_table(write(tmp_path, "run.jsonl", "\n".join(map(json.dumps, lines))))
    assert table.names == ("t", "joint.q[0]", "joint.q[1]", "on")
    np.testing.assert_array_equal(table["joint.q[1]"], [0, -1, -2, -3])
    with pytest.raises(BadRecording, match="it is text"):
        table["who"]


def test_a_value_that_a_line_lacks_is_blank(tmp_path):
    path = write(tmp_path, "run.jsonl", '{"t": 0, "u": 1}\n{"t": 1}\n{"t": 2, "u": null}\n{"t": 3, "u": 4}\n')
    with pytest.raises(BadRecording, match="NaN at sample 1 .2 of 4"):
        open_table(path)["u"]
    np.testing.assert_array_equal(open_table(path, columns=["u"], blanks=["u"])["u"], [1, np.nan, np.nan, 4])


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ('{"t": 0}\n{"t": 1', "line 2 is not JSON.*cut short"),
        ('{"t": 0}\n[1]\n', "line 2 is list, not an object"),
        ("\n\n", "no numeric column"),
        ('{"t": 12345678901234567890}\n', "precision"),
        ('{"t": ' + "[" * 5000 + "]" * 5000 + "}\n", "line 1 is not JSON|nested"),
    ],
)
def test_damaged_json_lines_are_refused(tmp_path, text, match):
    with pytest.raises(BadRecording, match=match):
        open_table(write(tmp_path, "run.jsonl", text))


def test_a_json_document_gives_lists_and_records(tmp_path):
    content = {"kp": 3, "entries": [{"t": 0.0, "q": 1}, {"t": 0.1, "q": 2}], "x": [1, 2, 3], "motor": "text"}
    table = open_table(write(tmp_path, "run.json", json.dumps(content)))
    assert table.names == ("kp", "entries.t", "entries.q", "x")
    np.testing.assert_array_equal(table["entries.q"], [1, 2])
    assert table.meta["motor"] == "text"
    rows = open_table(write(tmp_path, "rows.json", json.dumps([{"t": 0}, {"t": 1}])))
    np.testing.assert_array_equal(rows["t"], [0, 1])
    with pytest.raises(BadRecording, match="no names"):
        open_table(write(tmp_path, "bare.json", "[1, 2]"))


# ---- NPY and arrays of three dimensions -----------------------------------------------------------------------------


def test_columns_of_an_npy_file(tmp_path):
    table = open_table(write(tmp_path, "run.npy", sound.npy(VALUES)))
    assert table.names == ("col0", "col1", "col2")
    np.testing.assert_array_equal(table["col1"], VALUES[:, 1])
    np.testing.assert_array_equal(open_table(tmp_path / "run.npy", columns=["data[:, 2]"])["data[:, 2]"], VALUES[:, 2])
    turned = open_table(write(tmp_path, "turned.npy", sound.npy(VALUES.T)))
    np.testing.assert_array_equal(turned["col1"], VALUES[:, 1])
    assert "along axis 2" in turned.notes[0]


def test_fields_of_a_structured_npy_file(tmp_path):
    array = np.zeros(3, dtype=[("t", "f8"), ("n", "i2"), ("who", "U2")])
    array["t"] = [0.0, 0.5, 1.0]
    table = open_table(write(tmp_path, "run.npy", sound.npy(array)))
    assert table.names == ("t", "n")
    np.testing.assert_array_equal(table["t"], array["t"])


def test_a_pickled_npy_file_is_never_opened(tmp_path):
    path = tmp_path / "run.npy"
    np.save(path, np.array([1, "a", {}], dtype=object), allow_pickle=True)
    with pytest.raises(BadRecording, match="pickle, which could run a program"):
        open_table(path)


def test_parts_of_an_array_of_three_dimensions(tmp_path):
    """Samples, periods and realisations: the periods of one realisation follow each other in time."""
    array = np.arange(24.0).reshape(4, 3, 2)
    np.savez(tmp_path / "run.npz", y=array)
    wanted = ["y[:, :, 1]", "y[:,0,0]", "y[:, -1, 0]"]
    table = open_table(tmp_path / "run.npz", columns=wanted)
    np.testing.assert_array_equal(table[wanted[0]], np.concatenate([array[:, p, 1] for p in range(3)]))
    np.testing.assert_array_equal(table[wanted[1]], array[:, 0, 0])
    np.testing.assert_array_equal(table[wanted[2]], array[:, 2, 0])
    for name in ("y[:, 5, 0]", "y[:, 0]", "y[0, 0, 0]", "z[:, 0, 0]"):
        with pytest.raises(UnknownName, match="unknown column"):
            open_table(tmp_path / "run.npz", columns=[name])


# ---- packed ----------------------------------------------------------------------------------------------------------


def test_packed_text_is_read_by_its_inner_suffix(tmp_path):
    content = b"t,x\n0,1\n1,2.5\n"
    packed = open_table(write(tmp_path, "run.csv.gz", gzip.compress(content)))
    assert packed.names == ("t", "x")
    np.testing.assert_array_equal(packed["x"], [1.0, 2.5])
    np.testing.assert_array_equal(
        open_table(write(tmp_path, "run.txt.gz", gzip.compress(b"t x\n0 1\n1 2\n")))["x"], [1, 2]
    )


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("run.csv.gz", gzip.compress(bytes(70 * 2**20), mtime=0), "more than 67108864 bytes when unpacked"),
        ("run.csv.gz", gzip.compress(b"t,x\n0,1\n1,2\n", mtime=0)[:-9], "cut short"),
        ("run.csv.gz", b"t,x\n0,1\n", "not a whole gzip file"),
        ("run.gz", gzip.compress(b"t\n1\n", mtime=0), "accepted before .gz: .csv"),
        ("run.mat.gz", gzip.compress(b"t\n1\n", mtime=0), "packed file of kind '.mat'"),
    ],
    ids=["large", "cut", "unpacked", "no kind", "other kind"],
)
def test_packed_files_that_are_refused(tmp_path, name, content, match):
    with pytest.raises(BadRecording, match=match):
        open_table(write(tmp_path, name, content))


# ---- blank cells -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("blank", ["", "NaN", "nan", "null", "NA"])
def test_blank_cells_are_read_only_where_they_are_allowed(tmp_path, blank):
    path = write(tmp_path, "run.csv", f"t,u,x\n0,{blank},1\n0.1,2,1\n0.2,{blank},1\n")
    with pytest.raises(BadRecording, match="line 2: column 2"):
        open_table(path, columns=["u"])
    np.testing.assert_array_equal(open_table(path, columns=["u"], blanks=["u"])["u"], [np.nan, 2.0, np.nan])


def test_fast_and_slow_reading_of_blank_cells_agree(tmp_path):
    fast = write(tmp_path, "fast.csv", "t,u\n0,1\n1,\n2,3\n")
    slow = write(tmp_path, "slow.csv", '"t",u\n0,1\n1,""\n2,3\n')
    for path in (fast, slow):
        np.testing.assert_array_equal(open_table(path, columns=["u"], blanks=["u"])["u"], [1.0, np.nan, 3.0])


def test_infinite_samples_are_refused_beside_blank_cells(tmp_path):
    with pytest.raises(BadRecording, match="inf"):
        open_table(write(tmp_path, "run.csv", "t,u\n0,1\n1,inf\n2,3\n"), columns=["u"], blanks=["u"])


def test_an_overview_reads_what_is_numbers_and_names_the_rest(tmp_path):
    table = open_table(write(tmp_path, "run.csv", "t,who,u\n0,me,1\n1,me,\n2,me,3\n"), blanks=EVERY)
    assert table.names == ("t", "u")
    assert "'me', not a number" in table.refused["who"]


@pytest.mark.parametrize(
    ("cut", "match"),
    [
        ("2.5\n0.700000\t1.6\t2.6\n", "line 15: 2 numbers where 3"),
        ("0.700000\t1.6\t2.6\n", "states 3 samples, the file has 2"),
    ],
)
def test_a_labview_file_that_is_cut_short_is_refused(tmp_path, cut, match):
    with pytest.raises(BadRecording, match=match):
        open_table(write(tmp_path, "run.lvm", sound.LVM.removesuffix(cut).rstrip("\t")))
