"""Time stamps as text, and timestamps of Parquet, in seconds from the first stamp."""

import datetime
import gzip
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from vlab.cases.draft.logs import choose_clock, open_log
from vlab.errors import BadRecording
from vlab.recordings.assemble import ColumnSpec, to_recording
from vlab.recordings.stamps import first_stamp, read_stamp, seconds_from
from vlab.recordings.table import EVERY, open_table

START = datetime.datetime(2025, 3, 1, 23, 59, 59, 900_000)
TIMES = 0.02 * np.arange(20)
MOMENTS = [START + datetime.timedelta(microseconds=20_000 * k) for k in range(20)]
FORMS = {
    "T": [m.isoformat(timespec="milliseconds") for m in MOMENTS],
    "blank": [m.isoformat(sep=" ", timespec="milliseconds") for m in MOMENTS],
    "whole": [m.isoformat() for m in MOMENTS],
    "Z": [m.isoformat(timespec="milliseconds") + "Z" for m in MOMENTS],
    "offset": [m.isoformat(timespec="milliseconds") + "+01:00" for m in MOMENTS],
    "nanoseconds": [m.isoformat(timespec="microseconds") + "000" for m in MOMENTS],
    "clock over midnight": [m.time().isoformat(timespec="milliseconds") for m in MOMENTS],
}


def lines(stamps, delimiter=",", head="timestamp,x\n"):
    return head.replace(",", delimiter) + "".join(f"{s}{delimiter}{k + 0.5}\n" for k, s in enumerate(stamps))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".txt", ".csv.gz", ".jsonl", ".json"])
def test_stamps_are_seconds_from_the_first_one(tmp_path, form, suffix):
    path, stamps = tmp_path / f"log{suffix}", FORMS[form]
    records = [{"timestamp": s, "x": k + 0.5} for k, s in enumerate(stamps)]
    content = {
        ".csv": lines(stamps).encode(),
        ".tsv": lines(stamps, "\t").encode(),
        ".txt": lines(stamps, " ").encode(),
        ".csv.gz": gzip.compress(lines(stamps).encode()),
        ".jsonl": "".join(json.dumps(r) + "\n" for r in records).encode(),
        ".json": json.dumps({"timestamp": stamps, "x": [r["x"] for r in records]}).encode(),
    }[suffix]
    path.write_bytes(content)
    for options in ({}, {"columns": ["timestamp", "x"]}, {"blanks": EVERY}):
        table = open_table(path, **options)
        assert np.allclose(table["timestamp"], TIMES, rtol=0.0, atol=1e-12)
        assert table["x"].tolist() == [k + 0.5 for k in range(20)]
        assert table.units["timestamp"] == "s"
    clock = choose_clock(open_log(path))
    assert (clock.time, clock.unit, clock.is_sure) == ("timestamp", "s", True)


def test_a_recording_takes_its_time_from_stamps(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(lines(FORMS["T"]))
    spec = ColumnSpec(column="x", kind="other")
    recording = to_recording(open_table(path), [spec], time="timestamp")
    assert np.allclose(recording.time, TIMES, rtol=0.0, atol=1e-12)


def test_stamps_of_a_workbook(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["timestamp", "x"])
    for k, moment in enumerate(MOMENTS):
        book.active.append([moment, k + 0.5])
    book.save(tmp_path / "log.xlsx")
    assert np.allclose(open_table(tmp_path / "log.xlsx")["timestamp"], TIMES, atol=1e-5)  # Excel keeps microseconds


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_timestamps_of_parquet(tmp_path, unit):
    columns = {
        "when": pa.array(MOMENTS, pa.timestamp(unit)),
        "utc": pa.array(MOMENTS, pa.timestamp(unit, tz="UTC")),
        "clock": pa.array([m.time() for m in MOMENTS]).cast(pa.time32("ms")),
        "late": pa.array([m + datetime.timedelta(seconds=3) for m in MOMENTS], pa.timestamp(unit)),
        "x": TIMES,
    }
    pq.write_table(pa.table(columns), tmp_path / "log.parquet")
    table = open_table(tmp_path / "log.parquet")
    for name in ("when", "utc", "clock"):
        assert np.allclose(table[name], TIMES, rtol=0.0, atol=1e-12)
    # the zero is that of the file, whichever columns are read
    for read in (table, open_table(tmp_path / "log.parquet", columns=["late", "x"])):
        assert np.allclose(read["late"], TIMES + 3.0, rtol=0.0, atol=1e-12)
    assert table.units["when"] == "s"


def test_columns_of_one_file_count_from_the_same_stamp(tmp_path):
    path = tmp_path / "log.csv"
    stamps = FORMS["T"]
    rows = [f"{stamps[k + 1]},{stamps[k]},{k}\n" for k in range(10)]
    path.write_text("sent,read,x\n" + "".join(rows))
    for read in (open_table(path), open_table(path, columns=["sent", "x"])):
        assert np.allclose(read["sent"], TIMES[1:11], rtol=0.0, atol=1e-12)


def test_decimal_commas_beside_stamps(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("Datum;x\n" + "".join(f"{s};{k},5\n" for k, s in enumerate(FORMS["blank"])))
    assert open_table(path)["x"].tolist() == [k + 0.5 for k in range(20)]


def test_a_stamp_above_the_header_is_a_title(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("2025-03-01 10:00:00\ntime,x\n0.0,1.0\n0.1,2.0\n")
    assert open_table(path).names == ("time", "x")


@pytest.mark.parametrize(
    ("bad", "match"),
    [
        ("soon", r"line 5: column 1 \('timestamp'\) is 'soon', not a time stamp; write all stamps .* ISO 8601"),
        ("2025-02-30T10:00:00", r"line 5: .* '2025-02-30T10:00:00', not a time stamp"),
        ("10:00:00.1", r"line 5: .* '10:00:00.1', a clock time; the first stamp is a date with time"),
        ("2025-03-02T00:00:00Z", r"line 5: .*Z', a date with time with an offset to UTC; the first"),
        ("12.5", r"line 5: .* '12.5', not a time stamp"),
        ("", r"line 5: .* '', not a time stamp"),
    ],
)
def test_a_stamp_of_another_form_is_named_with_its_row(tmp_path, bad, match):
    path, stamps = tmp_path / "log.csv", list(FORMS["T"])
    stamps[3] = bad
    path.write_text(lines(stamps))
    with pytest.raises(BadRecording, match=match) as error:
        open_table(path)
    assert "\n" not in str(error.value)
    if bad:  # a draft reads blank cells as such
        with pytest.raises(BadRecording, match=match):
            choose_clock(open_log(path))


def test_a_stamp_after_numbers_is_named_with_its_row(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(lines(["0.0", "0.1", FORMS["blank"][0]]))
    with pytest.raises(BadRecording, match=r"line 4: .*not a number; write time stamps in every line, or numbers"):
        open_table(path)


@pytest.mark.parametrize("bad", ["soon", 3.5, "10:00:00"])
def test_a_record_with_another_stamp_is_refused(tmp_path, bad):
    path = tmp_path / "log.jsonl"
    stamps = [*FORMS["T"][:3], bad]
    path.write_text("".join(json.dumps({"t": s, "x": k}) + "\n" for k, s in enumerate(stamps)))
    with pytest.raises(BadRecording, match="record 4 is '|time stamps and numbers"):
        open_table(path)["t"]


def test_blank_stamps_are_missing_times(tmp_path):
    path, stamps = tmp_path / "log.csv", list(FORMS["T"])
    stamps[3] = ""
    path.write_text(lines(stamps))
    times = open_table(path, blanks={"timestamp"})["timestamp"]
    assert np.isnan(times[3])
    assert times[4] == pytest.approx(0.08)


def test_offsets_to_utc_count():
    first = read_stamp("2025-03-30T01:30:00+01:00")
    assert seconds_from(first, ["2025-03-30T03:30:00+02:00"])[0] == 3600.0
    assert first_stamp(["10:00:01", "2025-03-01T00:00:00", "9:00:00"], "10:00:01") == read_stamp("09:00:00")
    assert read_stamp("1:2") is None


@pytest.mark.parametrize(
    "stamps",
    [
        ("2025/03/01 23:59:59.500", "2025/3/2 00:00:01.000"),
        ("01.03.2025 23:59:59,500", "02.03.2025 00:00:01,000"),
        ("20250301T235959.500", "20250302T000001"),
        ("11:59:59.500 PM", "12:00:01.000 AM"),
        ("23:59:59:500", "00:00:01:000"),
        ("2025-03-01 11:59:59.500 PM", "2025-03-02 12:00:01.000 AM"),
    ],
)
def test_stamps_of_loggers_count_over_midnight(tmp_path, stamps):
    path = tmp_path / "log.csv"
    path.write_text("time;x\n" + "".join(f"{stamp};{k}\n" for k, stamp in enumerate(stamps)))
    np.testing.assert_allclose(open_table(path)["time"], [0.0, 1.5])


@pytest.mark.parametrize("stamp", ["03/01/2025 23:59:59.5", "59:57.250", "13:00:00 PM", "23:59:59:5", "2025-03-01"])
def test_ambiguous_times_are_refused_with_the_accepted_forms(tmp_path, stamp):
    path = tmp_path / "log.csv"
    path.write_text(f"time,x\n{stamp},1\n{stamp},2\n")
    with pytest.raises(BadRecording, match="ISO 8601|time stamp"):
        open_table(path)
