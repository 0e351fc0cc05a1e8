"""Parquet files of others: numeric columns are read, everything else says why it is not."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from vlab.errors import BadRecording
from vlab.recordings import files, open_table, read_recording


def parquet(tmp_path, columns, **options):
    path = tmp_path / "run.parquet"
    pq.write_table(columns if isinstance(columns, pa.Table) else pa.table(columns), path, **options)
    return path


def test_numeric_columns_are_read_and_others_say_why_not(tmp_path):
    columns = {
        "exp.off": [0.5, 1.5, 2.5],
        "n": pa.array([1, 2, 3], pa.uint16()),
        "half": pa.array([1.0, 2.0, 3.0], pa.float32()),
        "on": [True, False, True],
        "who": ["a", "b", "c"],
        "gap": [1.0, None, 3.0],
        "nan": [1.0, float("nan"), 3.0],
        "clock": [2**62 + 1, 2**62 + 3, 2**62 + 5],
        "when": pa.array([0, 1, 2], pa.timestamp("ns")),
        "nested": [[1.0], [2.0], [3.0]],
        "words": [["a"], ["b"], ["c"]],
    }
    table = open_table(parquet(tmp_path, columns))
    assert table.names == ("exp.off", "n", "half", "on", "when", "nested[0]")
    assert table["when"].tolist() == [0.0, 1e-9, 2e-9]
    assert table.units == {"when": "s"}
    assert table["on"].tolist() == [1.0, 0.0, 1.0]
    reasons = {
        "who": "string",
        "gap": "empty at sample 1",
        "nan": "NaN at sample 1",
        "clock": "precision",
        "nested": r"lists of 1 numbers; name an element, such as nested\[0\]",
        "words": "list",
    }
    for name, why in reasons.items():
        with pytest.raises(BadRecording, match=why):
            table[name]
    assert open_table(tmp_path / "run.parquet", columns=["n"]).names == ("n",)


def test_names_that_stand_twice_are_refused(tmp_path):
    table = pa.Table.from_arrays([pa.array([1.0]), pa.array([2.0]), pa.array([3.0])], names=["x", "x", "y"])
    with pytest.raises(BadRecording, match="more than once"):
        open_table(parquet(tmp_path, table))["x"]


def test_foreign_files_are_no_recordings(tmp_path):
    path = parquet(tmp_path, {"time": [0.0, 1.0], "x": [1.0, 2.0]})
    with pytest.raises(BadRecording, match="no vlab labels"):
        read_recording(path)


def test_no_rows_and_no_numbers_are_refused(tmp_path):
    with pytest.raises(BadRecording, match="declares 0 rows"):
        open_table(parquet(tmp_path, {"x": pa.array([], pa.float64())}))
    with pytest.raises(BadRecording, match="no numeric column"):
        open_table(parquet(tmp_path, {"x": ["a"]}))


def test_a_small_file_that_unpacks_to_more_than_the_limit_is_refused(tmp_path, monkeypatch):
    path = parquet(tmp_path, {"x": np.zeros(1_000_000)})  # run lengths: 8 MB in about a kilobyte
    assert path.stat().st_size < 20_000
    monkeypatch.setattr(files, "MAX_BYTES", 1_000_000)
    with pytest.raises(BadRecording, match="8000000 bytes unpacked"):
        open_table(path)


def test_text_that_is_no_parquet_file_is_refused(tmp_path):
    (tmp_path / "run.parquet").write_text("t,x\n1,2\n")
    with pytest.raises(BadRecording, match="not a readable parquet file"):
        open_table(tmp_path / "run.parquet")
    with pytest.raises(BadRecording, match="names its own"):
        open_table(parquet(tmp_path, {"x": [1.0]}), names=["y"])
