"""CSV: what is read, and that every fault is named with its line and column."""

import io

import numpy as np
import pytest

from vlab.errors import BadRecording, BadUnit
from vlab.recordings import open_table
from vlab.recordings.assemble import ColumnSpec, to_recording
from vlab.recordings.formats import csv
from vlab.recordings.formats.csv_head import layout_of


def table(tmp_path, text, **options):
    path = tmp_path / "run.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return open_table(path, **options)


@pytest.mark.parametrize("sign", [",", ";", "\t"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_delimiters_and_line_ends(tmp_path, sign, end):
    text = end.join([sign.join(row) for row in (["t [s]", "x"], ["0", "1.5"], [" .5 ", "-2e-3"], ["+1", "7."])]) + end
    found = table(tmp_path, text)
    assert found.names == ("t [s]", "x")
    np.testing.assert_array_equal(found["t [s]"], [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(found["x"], [1.5, -2e-3, 7.0])
    assert not found.notes


def test_numbers_without_header_are_numbered_columns(tmp_path):
    assert table(tmp_path, "1,2\n3,4\n").names == ("c1", "c2")
    assert table(tmp_path, "1\n2\n").names == ("c1",)
    assert table(tmp_path, "1,2\n3,4\n", names=["t", "x"])["t"].tolist() == [1.0, 3.0]


def test_given_names_take_the_place_of_the_header(tmp_path):
    assert table(tmp_path, "a,b\n3,4\n", names=["t", "x"])["t"].tolist() == [3.0]
    with pytest.raises(BadRecording, match="3 names were given for 2 columns"):
        table(tmp_path, "a,b\n3,4\n", names=["t", "x", "y"])


def test_comments_quotes_blank_ends_and_byte_order_mark(tmp_path):
    text = '\ufeff# rig 3\n"time, local";"x"\n# started\n0;"1"\n\n'.encode()
    found = table(tmp_path, text)
    assert found.names == ("time, local", "x")
    assert found["x"].tolist() == [1.0]


def test_the_header_that_numpy_writes_as_a_comment_names_the_columns(tmp_path):
    stream = io.StringIO()
    np.savetxt(stream, [[1.0, 2.0]], delimiter=",", header="t,x")
    assert table(tmp_path, stream.getvalue()).names == ("t", "x")


def test_a_delimiter_at_the_end_of_every_line_is_no_column(tmp_path):
    found = table(tmp_path, "V1,V2,\n1,2,\n3,4,\n")
    assert found.names == ("V1", "V2")
    assert found["V2"].tolist() == [2.0, 4.0]


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        ("1.2+3.4j", 1.2 + 3.4j),
        ("(1.2+3.4j)", 1.2 + 3.4j),
        ("1.2 + 3.4i", 1.2 + 3.4j),
        (" (1.0e+00+-2.0e-01j)", 1.0 - 0.2j),  # numpy.savetxt before 1.14
        ("-1.5e-3-2E2J", -1.5e-3 - 200j),
        ("3.4i", 3.4j),
        ("-1e-3j", -1e-3j),
        ("2 - 3*i", 2 - 3j),
    ],
)
def test_complex_numbers_in_the_forms_of_numpy_and_matlab(tmp_path, cell, value):
    assert table(tmp_path, f"f;H\n0.5;{cell}\n1;0\n")["H"].tolist() == [value, 0.0]


def test_a_complex_column_with_no_imaginary_part_is_real(tmp_path):
    # three_storey/Experimental.csv writes its frequencies as 0.03125+0j
    found = table(tmp_path, "0.03125+0j;1+2j\n0.0625+0j;3-4j")
    assert found["c1"].dtype == float
    assert found["c2"].tolist() == [1 + 2j, 3 - 4j]
    assert "no line end" in found.notes[0]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("a,b\n1,2\n3\n", r"line 3: 1 cells where 2 are expected"),
        ("a,b\n1,2\n3,4,5\n", r"line 3: 3 cells where 2"),
        ("a,b\n1,\n3,4\n", r"line 2: column 2 \('b'\) is empty"),
        ("a,b\n1,2\n3,x\n5,6\n", r"line 3: column 2 \('b'\) is 'x', not a number"),
        ("a,b\n1,2\n3,1_000\n", r"line 3: column 2 \('b'\) is '1_000'"),
        ("a,b\n1,2\n٣,1\n", r"line 3: column 1 \('a'\)"),
        ("a,b\n1,2\nNaN,3\n4,5\n", r"line 3: column 1 \('a'\) is NaN"),
        ("a,b\n1,2\n-inf,3\n", r"line 3: column 1 \('a'\) is infinite"),
        ("a,b\n1,2\n1e999,3\n", r"line 3: column 1 \('a'\) is infinite"),
        ("a,b\n1,nan+nanj\n", r"line 2: column 2 \('b'\) is NaN"),
        ("a;b\n1.5;2,5\n", r"line 2: .*decimal sign"),
        ("a,b\n1,2\n\n3,4\n", r"line 3: an empty line"),
        ("a,b\n1,2\n3", r"line 3: the file is truncated: 1 of 2 cells"),
        ("a,b\n1,2\n3,", r"line 3: the file is truncated"),
        ("a,b\n1,2\n3,4.5e", r"line 3: the file is truncated: column 2 \('b'\) is '4.5e'"),
        ("a,b\n1,2\nx,4", r"line 3: column 1 \('a'\) is 'x', not a number"),
        ("a,b\n", "no numbers after it"),
        ("# only\n\n", "no numbers in the file"),
        ("a,a\n1,2\n", r"'a' stands 2 times"),
        ("a,,b\n1,2,3\n", "has no name"),
        ("time,1,2\n0,1,2\n", "neither a header nor numbers"),
        ('a,"b\n1,2\n', "quotes do not close"),
        ('a,b\n1,"2\n', "line 2: the quotes do not close"),
        ("a,b,\n1,2,\n3,4,5\n", "line 3: 3 cells for 2 names"),
        (b"a,\x81m\n1,2\n", "line 1 is not UTF-8"),
        (b"\xff\xfea", "not UTF-16 text"),
        (b"PK\x03\x04\0\0\0", "not a UTF-8 text"),
        (b"1," * 600_000, "a line of more than"),
        (b"1" + b",1" * 10_000 + b"\n", "at most 10000"),
        (b"#\n" * 20_001, "no numbers in the first 20000 lines"),
    ],
)
def test_a_fault_is_named_with_its_place(tmp_path, text, match):
    with pytest.raises(BadRecording, match=match):
        table(tmp_path, text)


def test_columns_that_are_not_wanted_may_have_gaps_and_text(tmp_path):
    text = "u,y,Ts,when\n1,2,4,mon\n3,5,,tue\n"
    assert table(tmp_path, text, columns=["y", "u"])["y"].tolist() == [2.0, 5.0]
    with pytest.raises(BadRecording, match=r"line 3: column 3 \('Ts'\) is empty"):
        table(tmp_path, text, columns=["u", "Ts"])


def test_fast_and_slow_path_give_the_same_bits(tmp_path):
    rng = np.random.default_rng(1)
    values = np.frombuffer(rng.bytes(8 * 3000), dtype=float)
    values = values[np.isfinite(values)][:2700].reshape(-1, 3)
    body = "a,b,c\n" + "\n".join(",".join(map(repr, row)) for row in values.tolist()) + "\n"
    layout = layout_of(body.encode(), tmp_path / "run.csv", None)
    fast, slow = csv._fast(body.encode(), layout), csv._slow(body.encode(), layout)
    assert fast is not None
    for i in range(3):  # no tolerance: both round correctly
        assert fast[i].tobytes() == slow[i].tobytes() == values[:, i].tobytes()


def test_a_million_rows_take_the_fast_path(tmp_path):
    # A row-wise reader of 200 000 x 5 would need about a second; only that pyarrow takes it is asserted, not a time.
    text = b"a,b,c,d,e\n" + b"0.125,-1.5,3.25e-3,4,5.0625\n" * 200_000
    layout = layout_of(text, tmp_path / "run.csv", None)
    fast = csv._fast(text, layout)
    assert fast is not None
    assert fast[2].shape == (200_000,)


def test_a_delimiter_at_the_ends_of_the_lines_takes_the_fast_path(tmp_path):
    text = '"a","b",\n1,2,\n3,4,\n'
    layout = layout_of(text.encode(), tmp_path / "run.csv", None)
    fast = csv._fast(text.encode(), layout)
    assert fast is not None
    assert [column.tolist() for column in fast] == [[1.0, 3.0], [2.0, 4.0]]
    damaged = text.replace("3,4,", "3,4,5").encode()
    assert csv._fast(damaged, layout) is None
    with pytest.raises(BadRecording, match="line 3: 3 cells for 2 names"):
        csv._slow(damaged, layout)


def test_decimal_commas_between_semicolons(tmp_path):
    (tmp_path / "x.csv").write_text("t;x\n0,000;-1,5e-3\n0,002;2\n")
    table = open_table(tmp_path / "x.csv")
    assert table["t"].tolist() == [0.0, 0.002]
    assert table["x"].tolist() == [-1.5e-3, 2.0]
    assert any("decimal" in note for note in table.notes)
    (tmp_path / "bare.csv").write_text("0,5\t1\n1,5\t2\n")  # without a header
    assert open_table(tmp_path / "bare.csv")["c1"].tolist() == [0.5, 1.5]


@pytest.mark.parametrize("text", ["t,F [kN],a (g)\n0,1,2\n1,3,4\n", "t,F,a\ns,[kN],g\n0,1,2\n1,3,4\n"])
def test_units_in_the_header_or_below_it_are_held_against_the_description(tmp_path, text):
    (tmp_path / "x.csv").write_text(text)
    table = open_table(tmp_path / "x.csv")
    force, acceleration = table.names[1:]
    assert {table.units[force], table.units[acceleration]} == {"kN", "g"}
    table.check_unit(acceleration, "g", "m/s^2")
    with pytest.raises(BadUnit, match="the file states 'kN' and the description 'N', a factor of 0.001"):
        table.check_unit(force, "N", "N")


def test_a_time_column_in_milliseconds_is_not_read_as_seconds(tmp_path):
    (tmp_path / "x.csv").write_text("t [ms],x\n0,1\n2,3\n4,5\n")
    table, columns = open_table(tmp_path / "x.csv"), [ColumnSpec(column="x", kind="displacement", unit="m")]
    with pytest.raises(BadUnit, match='time_unit = "ms"'):
        to_recording(table, columns, time="t [ms]")
    assert to_recording(table, columns, time="t [ms]", time_unit="ms").time.tolist() == [0.0, 0.002, 0.004]


def test_lines_of_titles_above_the_header_are_passed_over_and_said(tmp_path):
    text = "Rig two-mass, run of 2024-05-03\nsampled at 500 Hz\n\nt;x [mm]\n0;1\n0.002;2\n"
    found = table(tmp_path, text)
    assert found.names == ("t", "x [mm]")
    assert found["t"].tolist() == [0.0, 0.002]
    assert found.notes == ("2 lines before the header not read",)
    units_too = table(tmp_path, "Logger 7\nt,F\ns,N\n0,1\n1,2\n")
    assert (units_too.names, dict(units_too.units)) == (("t", "F"), {"t": "s", "F": "N"})
    assert table(tmp_path, "one\nx\n1\n2\n").names == ("x",)
