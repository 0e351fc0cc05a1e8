"""Text logs whose cells hold lists of numbers, as exports of robot data sets write them."""

import numpy as np
import pytest

from vlab.errors import BadRecording
from vlab.recordings import open_table
from vlab.recordings.table import EVERY

VALUES = [(0.0, 0.5, -1e-3), (0.1, 1.5, 2.0), (0.2, -2.5, 3.25)]


def table(folder, text, name="log.csv", **options):
    path = folder / name
    path.write_text(text)
    return open_table(path, **options)


@pytest.mark.parametrize(
    ("cell", "delimiter"),
    [
        ('"[{0}, {1}]"', ","),
        ('"[{0},{1}]"', ";"),
        ("[{0}, {1}]", "\t"),
        ("[{0}, {1}]", ","),
        ("[{0} {1}]", ","),
        ("{0};{1}", ","),
        ('"({0}, {1})"', ","),
        ('"array([{0}, {1}], dtype=float32)"', ","),
        ('"[ {0}\n {1}]"', ","),  # numpy breaks long lines
    ],
)
def test_each_element_of_a_list_is_a_column(tmp_path, cell, delimiter):
    text = delimiter.join(["t", "action", "x"]) + "\n"
    text += "".join(delimiter.join([str(t), cell.format(a, b), str(t)]) + "\n" for t, a, b in VALUES)
    found = table(tmp_path, text)
    assert found.names == ("t", "action[0]", "action[1]", "x")
    np.testing.assert_array_equal(np.column_stack([found[n] for n in found.names[:3]]), VALUES)
    assert not found.units
    assert any("action (2)" in note for note in found.notes)


def test_titles_units_and_text_beside_lists(tmp_path):
    text = 'Export 7\n\n,t,q,task\n,s,deg,\n0,0.0,"[1, 2]",pick\n1,0.1,"[3, 4]",place\n'
    found = table(tmp_path, text, columns=["t", "q[1]"])
    np.testing.assert_array_equal(found["q[1]"], [2.0, 4.0])
    assert found.units["q[1]"] == "deg"


def test_a_cell_without_a_list_has_no_readings(tmp_path):
    found = table(tmp_path, 't,q\n0,"[1, 2]"\n1,\n2,"[3, nan]"\n', blanks=EVERY)
    np.testing.assert_array_equal(found["q[0]"], [1.0, np.nan, 3.0])
    np.testing.assert_array_equal(found["q[1]"], [2.0, np.nan, np.nan])


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (
            't,q\n0,"[1, 2]"\n1,"[1]"\n',
            r"line 3: column 2 \('q'\) is a list of 1 numbers, and a list of 2 numbers above",
        ),
        ('t,q\n0,"[1, 2]"\n1,__import__("os")\n', "line 3: column 2"),
        ('t,q\n0,"[1, x]"\n', r"line 2: column 2 \('q'\) is '\[1, x\]'"),
        ("t,q\n0,[" + " ".join(["1"] * 10_001) + "]\n", "at most 10000 columns"),
    ],
)
def test_faults_of_lists_are_named(tmp_path, text, match):
    with pytest.raises(BadRecording, match=match):
        table(tmp_path, text)


def test_decimal_commas_and_complex_numbers_are_no_lists(tmp_path):
    assert table(tmp_path, "t;x\n0,5;1,5\n1,5;2,5\n").names == ("t", "x")
    found = table(tmp_path, "F,kN;x,mm\n0,5;1,5\n1,5;2,5\n")  # commas in the names, too
    np.testing.assert_array_equal(found["x,mm"], [1.5, 2.5])
    assert table(tmp_path, "f,H\n0.5,(1+2j)\n1,(0+1j)\n").names == ("f", "H")
