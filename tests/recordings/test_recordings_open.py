"""The guarded opener: what is refused before any format is read, and what a table promises."""

import os

import numpy as np
import pytest

from vlab.errors import BadRecording, OutputRefused, UnknownName
from vlab.recordings import files, open_table
from vlab.recordings.files import written_whole
from vlab.recordings.table import READERS, Table

GOOD = b"t,x\n0,1\n1,2\n"


@pytest.fixture
def case(tmp_path):
    folder = tmp_path / "case"
    folder.mkdir()
    (folder / "run.csv").write_bytes(GOOD)
    (tmp_path / "secret.csv").write_bytes(GOOD)
    return folder


def test_a_file_in_the_folder_opens_relative_to_it(case):
    assert open_table("run.csv", folder=case).names == ("t", "x")
    assert open_table(case / "run.csv", folder=case).names == ("t", "x")


@pytest.mark.parametrize("path", ["../secret.csv", "{tmp}/secret.csv", "./../case/../secret.csv", "/etc/passwd.csv"])
def test_a_file_outside_the_folder_is_refused(case, tmp_path, path):
    with pytest.raises(BadRecording, match="outside"):
        open_table(path.format(tmp=tmp_path), folder=case)


def test_a_link_that_leaves_the_folder_is_refused(case, tmp_path):
    (case / "link.csv").symlink_to(tmp_path / "secret.csv")
    (case / "sub").symlink_to(tmp_path)
    for name in ("link.csv", "sub/secret.csv"):
        with pytest.raises(BadRecording, match="outside"):
            open_table(name, folder=case)


def test_a_link_within_the_folder_opens(case):
    (case / "link.csv").symlink_to("run.csv")
    assert open_table("link.csv", folder=case).names == ("t", "x")


def test_what_is_not_an_ordinary_file_is_refused(case):
    (case / "folder.csv").mkdir()
    (case / "empty.csv").touch()
    os.mkfifo(case / "pipe.csv")  # opening it would wait for ever
    (case / "loop.csv").symlink_to("loop.csv")
    (case / "device.csv").symlink_to("/dev/zero")
    expected = {
        "folder": "folder",
        "empty": "empty",
        "pipe": "pipe",
        "loop": "cannot be opened|no such file",
        "device": "device",
    }
    for name, match in expected.items():
        with pytest.raises(BadRecording, match=match):
            open_table(case / f"{name}.csv")


@pytest.mark.parametrize("path", ["missing.csv", "a\0b.csv", "x" * 5000 + ".csv", "run.csv/run.csv"])
def test_a_name_that_is_no_file_is_refused(case, path):
    with pytest.raises(BadRecording, match=r"no such file|cannot be opened"):
        open_table(case / path)


@pytest.mark.parametrize("name", ["run", "run.pkl", "run.bag"])
def test_an_unknown_suffix_lists_the_accepted_ones(case, name):
    (case / name).write_bytes(GOOD)
    with pytest.raises(BadRecording, match=r"\.csv, .*\.parquet, \.mat"):
        open_table(case / name)


def test_suffixes_are_read_in_any_case(case):
    (case / "RUN.CSV").write_bytes(GOOD)
    assert open_table(case / "RUN.CSV").names == ("t", "x")


def test_a_file_over_the_limit_is_refused(case, monkeypatch):
    monkeypatch.setattr(files, "MAX_BYTES", len(GOOD) - 1)
    with pytest.raises(BadRecording, match="at most 11 are opened"):
        open_table(case / "run.csv")


def test_whatever_a_reader_raises_is_one_line_of_bad_recording(case, monkeypatch):
    import vlab.recordings.formats.csv as reader

    for error, match in [
        (RuntimeError("boom\nbang"), "boom bang"),
        (MemoryError(), "more memory"),
        (RecursionError("deep"), "deep"),
    ]:

        def fail(*_, raised=error, **__):
            raise raised

        monkeypatch.setattr(reader, "read", fail)
        with pytest.raises(BadRecording, match=match) as caught:
            open_table(case / "run.csv")
        assert "\n" not in str(caught.value)
        assert caught.value.__cause__ is error


def test_every_reader_of_the_registry_is_there():
    import importlib

    for module in READERS.values():
        assert callable(importlib.import_module(module).read)


def test_names_from_a_file_cannot_forge_a_line_of_a_message(case):
    (case / "evil.csv").write_bytes(b"t,\x1b[31mred\n0,oops\n")
    with pytest.raises(BadRecording) as caught:
        open_table(case / "evil.csv")
    assert str(caught.value).isprintable()


def test_an_unknown_column_names_the_nearest(case):
    with pytest.raises(UnknownName, match="did you mean 'x'"):
        open_table(case / "run.csv")["xx"]
    with pytest.raises(UnknownName, match="accepted: t, x"):
        open_table(case / "run.csv", columns=["y"])


def test_a_table_is_finite_and_cannot_be_changed(tmp_path):
    table = Table(path=tmp_path, columns={"a": np.arange(3)})
    with pytest.raises(ValueError, match="read-only"):
        table["a"][0] = 1.0
    for bad, match in [
        (np.array([1.0, np.nan]), "NaN at sample 1"),
        (np.ones((2, 2)), "shape"),
        (np.array([]), "shape"),
    ]:
        with pytest.raises(BadRecording, match=match):
            Table(path=tmp_path, columns={"a": bad})
    with pytest.raises(BadRecording, match="b: it is text"):
        Table(path=tmp_path, columns={}, refused={"b": "it is text"})


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path):
    target = tmp_path / "run.csv"
    target.write_bytes(b"old")

    def interrupted():
        with written_whole(target) as stream:
            stream.write(b"half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        interrupted()
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_folder_that_cannot_be_written_is_said(tmp_path):
    with pytest.raises(OutputRefused, match="cannot be written"), written_whole(tmp_path / "missing" / "run.csv"):
        pass
    (tmp_path / "taken.csv").mkdir()
    with pytest.raises(OutputRefused, match="cannot be written"), written_whole(tmp_path / "taken.csv"):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["taken.csv"]


def test_a_name_without_a_file_is_said_before_its_ending(tmp_path):
    with pytest.raises(BadRecording, match="no such file"):
        open_table(tmp_path / "nothing")
    with pytest.raises(BadRecording, match="no such file"):
        open_table("nothing.png", folder=tmp_path)
    (tmp_path / "there.png").write_bytes(b"x")
    with pytest.raises(BadRecording, match="kind '.png'"):
        open_table("there.png", folder=tmp_path)
