"""Heads of text logs as programs write them: comments, titles, names, units and repeated headers."""

import numpy as np
import pytest

from vlab.errors import BadRecording
from vlab.recordings import open_table
from vlab.recordings.overview import overview

ROWS = "0,1,2\n0.5,3,4\n1,5,6\n"
NAMED = "time,motor,encoder\n"


def table(folder, text, name="log.csv", **options):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return open_table(path, **options)


HEADS = {
    "comments of MATLAB": "% Simulink export\n% model: cart\n" + NAMED,
    "names in a comment of MATLAB": "% model: cart\n% time, motor, encoder\n",
    "names right behind the mark": "//time,motor,encoder\n",
    "keys and values": "Device: DAQ 7\nSample rate: 2 Hz\n\n" + NAMED,
    "keys and values between delimiters": "Device,DAQ\nRate,2\nGain,1,x\n\n" + NAMED,
    "quoted": '"Model: cart"\n"Ts","0.5"\n"time","motor","encoder"\n',
    "lines of delimiters": "\n,,\ntime,motor,encoder\n,,\n",
    "types": NAMED + "double,double,float\n",
    "a delimiter at the end of the names only": "time,motor,encoder,\n",
    "several lines of names": "Zeit,Motor,Geber\n" + NAMED,
}


@pytest.mark.parametrize("head", HEADS)
def test_names_are_found_below_any_head(tmp_path, head):
    found = table(tmp_path, HEADS[head] + ROWS)
    assert found.names == ("time", "motor", "encoder")
    np.testing.assert_array_equal(found["encoder"], [2.0, 4.0, 6.0])


@pytest.mark.parametrize(
    "head",
    [
        NAMED + "s,N,mm\n",
        '"time","motor","encoder"\n"s","N","mm"\n',
        NAMED + "[s],[N],[mm]\n",
        "s,N,mm\n" + NAMED,
        NAMED + "s,N,mm\nTime,Force of the motor,Place of the cart\n",
        "Cart,,\n" + NAMED + "s,N,mm\n",
        NAMED + "% s,N,mm\n",
        "# time,motor,encoder\n# s,N,mm\n",
        "Zeit,Motor,Geber\n" + NAMED + "(s),(N),(mm)\n",
    ],
)
def test_units_in_a_line_of_their_own_are_stated(tmp_path, head):
    found = table(tmp_path, head + ROWS)
    assert dict(found.units) == {"time": "s", "motor": "N", "encoder": "mm"}
    assert found.names == ("time", "motor", "encoder")


def test_counts_are_stated_and_no_names(tmp_path):
    found = table(tmp_path, NAMED + "s,counts,ticks\n" + ROWS)
    assert found.names == ("time", "motor", "encoder")
    assert found.units["encoder"] == "ticks"


def test_single_letters_are_names_not_units(tmp_path):
    assert table(tmp_path, "Date,Today\nt,u\n0,1\n1,2\n").names == ("t", "u")  # tonnes and atomic mass units otherwise


def test_a_delimiter_at_the_end_of_the_numbers_only(tmp_path):
    found = table(tmp_path, NAMED + ROWS.replace("\n", ",\n"))
    np.testing.assert_array_equal(found["encoder"], [2.0, 4.0, 6.0])
    with pytest.raises(BadRecording, match="line 2: column 2"):
        table(tmp_path, "a,b\n1,\n3,4\n")


def test_headers_between_the_numbers_are_passed_over_and_said(tmp_path):
    head = NAMED + "s,N,mm\n"
    for between in (head, "\n" + head, "\n\n" + NAMED, "\n" + head + "\n"):
        found = table(tmp_path, head + ROWS + between + "1.5,7,8\n")
        np.testing.assert_array_equal(found["time"], [0.0, 0.5, 1.0, 1.5])
        assert found.notes == ("the header is repeated 1 time between the numbers",)
    with pytest.raises(BadRecording, match="line 6: column 2"):  # numbers of lines stay those of the file
        table(tmp_path, NAMED + ROWS + NAMED + "1.5,x,8\n")
    with pytest.raises(BadRecording, match="an empty line"):
        table(tmp_path, NAMED + ROWS + "\n" + "1.5,7,8\n")


@pytest.mark.parametrize(
    ("data", "unit"),
    [
        ((NAMED + "s,N,µm\n" + ROWS).encode("cp1252"), "µm"),
        ((NAMED + "s,N,mm\n" + ROWS).encode("utf-16"), "mm"),
        (("\ufeff" + NAMED + "s,N,mm\n" + ROWS).replace("\n", "\r\n").encode(), "mm"),
        ((NAMED + "s,N,mm\n" + ROWS).replace("\n", "\r").encode(), "mm"),
        ((NAMED + "s,N,mm\n" + ROWS).replace(",", "|").encode(), "mm"),
        ((NAMED + "s,N,mm\n" + ROWS).replace(",", " ").encode(), "mm"),
    ],
)
def test_encodings_line_ends_and_delimiters(tmp_path, data, unit):
    found = table(tmp_path, data)
    np.testing.assert_array_equal(found["encoder"], [2.0, 4.0, 6.0])
    assert found.units["encoder"] == unit


def test_the_unnamed_numbers_of_the_rows_are_a_column(tmp_path):
    text = ",time,x\n" + "".join(f"{i},{0.1 * i},{i}\n" for i in range(3))  # as pandas writes
    assert table(tmp_path, text).names == ("c1", "time", "x")


def test_titles_above_columns_with_text(tmp_path):
    text = "Model: cart\n\ntime,x,ok\n0,1,True\n0.5,2,False\n"
    found = table(tmp_path, text, columns=["time", "x"])
    np.testing.assert_array_equal(found["x"], [1.0, 2.0])


@pytest.mark.parametrize(
    ("name", "step", "unit", "rate"),
    [("min", 0.001, "min", 1 / 0.06), ("t_h", 1e-5, "h", 1 / 0.036), ("time_min", 0.001, "min", 1 / 0.06)],
)
def test_minutes_and_hours_in_a_name_are_no_seconds(tmp_path, name, step, unit, rate):
    text = f"{name},x\n" + "".join(f"{step * i},{i % 3}\n" for i in range(10))
    column = overview(table(tmp_path, text))[0]
    assert (column.kind, column.unit) == ("time", unit)
    assert column.rate_hz == pytest.approx(rate)


def test_the_times_of_labview_in_a_text_file_are_times(tmp_path):
    text = "X_Value\tx\n" + "".join(f"{0.1 * i}\t{i}\n" for i in range(5))
    assert overview(table(tmp_path, text, "log.txt"))[0].kind == "time"
