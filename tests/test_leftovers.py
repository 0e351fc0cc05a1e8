"""Outputs of runs that were killed are swept, those of living ones are not; a lock lasts as long as its process."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from vlab.errors import OutputRefused
from vlab.files.containment import NotInside, file_inside, path_inside
from vlab.files.leftovers import OLD, PART, WAS, make_held, release, sweep
from vlab.files.locks import LOCK, lock, sole_use
from vlab.files.output_folder import output_folder, write_manifest
from vlab.recordings.files import written_whole

posix = pytest.mark.skipif(sys.platform == "win32", reason="folders are not locked there, so nothing is swept")

WORKER = """
import sys, time
from pathlib import Path
from vlab.files.locks import sole_use
from vlab.files.output_folder import output_folder
from vlab.recordings.files import written_whole
here = Path(sys.argv[1])
with sole_use(here / "answers", of="vlab prove"), output_folder(here / "run") as fresh, \\
        written_whole(here / "file.json") as stream:
    stream.write(b"half")
    (fresh / "half").write_text("half")
    print("at work", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def worker(tmp_path):
    """Another process in the middle of writing a folder and a file, with a third folder to itself."""
    process = subprocess.Popen([sys.executable, "-c", WORKER, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "at work"
    yield process
    process.kill()
    process.wait()


def hidden(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir() if p.name.startswith("."))


@posix
def test_what_a_killed_run_left_is_swept_and_what_a_living_one_writes_is_not(worker, tmp_path):
    begun = hidden(tmp_path)
    assert [name.endswith(PART) for name in begun] == [True, True]
    sweep(tmp_path)
    with output_folder(tmp_path / "run") as fresh:
        write_manifest(fresh)
    with written_whole(tmp_path / "file.json") as stream:
        stream.write(b"whole")
    assert hidden(tmp_path) == begun
    worker.kill()  # as SIGKILL does: no handler runs
    worker.wait()
    with output_folder(tmp_path / "other") as fresh:
        write_manifest(fresh)
    assert hidden(tmp_path) == []
    assert (tmp_path / "file.json").read_bytes() == b"whole"


@posix
def test_what_is_swept_before_it_is_held_is_made_again(tmp_path):
    made: list[Path] = []

    def make() -> Path:
        path = tmp_path / f".run-{len(made)}{PART}"
        path.mkdir()
        made.append(path)
        if len(made) == 1:
            path.rmdir()  # as another process does that sweeps just then
        return path

    path, held = make_held(make)
    assert (path, held is not None) == (made[1], True)
    release(held)


@posix
def test_names_of_others_are_not_swept(tmp_path):
    for name in (".run-settings", ".run-old-abcdefgh", ".git", f"run{PART}"):
        (tmp_path / name).mkdir()
    (tmp_path / ".notes.0123abcd.part").write_text("mine")
    before = sorted(p.name for p in tmp_path.iterdir())
    sweep(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == before


@posix
def test_a_folder_that_was_being_replaced_when_its_run_was_killed_is_put_back(tmp_path):
    moved = tmp_path / f".run-abcd1234{OLD}" / WAS
    moved.mkdir(parents=True)
    (moved / "recording").write_text("of yesterday")
    sweep(tmp_path)
    assert (tmp_path / "run" / "recording").read_text() == "of yesterday"
    moved.mkdir(parents=True)  # and where the new one had come into its place, the old one goes
    sweep(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_one_process_at_a_time_has_a_folder_and_a_dead_one_blocks_nobody(worker, tmp_path):
    folder = tmp_path / "answers"
    with pytest.raises(OutputRefused, match="another vlab prove is at work in"), sole_use(folder, of="vlab prove"):
        pass
    worker.kill()
    worker.wait()
    with sole_use(folder, of="vlab prove"):
        assert (folder / LOCK).exists()
        with pytest.raises(OutputRefused), sole_use(folder, of="vlab prove"):
            pass
    with sole_use(folder, of="vlab prove"):
        pass


def test_whoever_waits_gets_the_folder_when_it_is_free(worker, tmp_path):
    begun = time.monotonic()
    waiting = subprocess.Popen(
        [sys.executable, "-c", "import sys; from pathlib import Path; from vlab.files.locks import sole_use\n"
         "with sole_use(Path(sys.argv[1]), of='x', wait=True): print('mine')", str(tmp_path / "answers")],
        stdout=subprocess.PIPE,
    )  # fmt: skip
    with pytest.raises(subprocess.TimeoutExpired):
        waiting.wait(timeout=1.0)
    worker.kill()
    assert waiting.communicate(timeout=60)[0].strip() == b"mine"
    assert time.monotonic() > begun


@posix
def test_a_lock_of_a_file_that_was_removed_meanwhile_counts_for_nothing(tmp_path):
    path = tmp_path / "file"
    path.touch()
    held = os.open(path, os.O_RDONLY)
    path.unlink()
    path.touch()  # another file of that name
    again = lock(path)
    assert again is not None
    os.close(again)
    os.close(held)


def test_a_file_that_must_be_new_is_never_written_over(tmp_path):
    path = tmp_path / "frozen.json"
    with written_whole(path, is_new=True) as stream:
        stream.write(b"first")
    with pytest.raises(OutputRefused, match="never written over"), written_whole(path, is_new=True) as stream:
        stream.write(b"second")
    with pytest.raises(OutputRefused), written_whole(tmp_path / "late.json", is_new=True) as stream:
        (tmp_path / "late.json").write_bytes(b"came meanwhile")
    assert path.read_bytes() == b"first"
    assert (tmp_path / "late.json").read_bytes() == b"came meanwhile"
    assert hidden(tmp_path) == []


def test_a_file_system_without_hard_links_keeps_what_is_there_too(tmp_path, monkeypatch):
    def refuse(*paths):
        raise PermissionError(1, "no links here")

    monkeypatch.setattr(os, "link", refuse)
    with written_whole(tmp_path / "a", is_new=True) as stream:
        stream.write(b"first")
    with pytest.raises(OutputRefused, match="never written over"), written_whole(tmp_path / "a", is_new=True) as stream:
        stream.write(b"second")
    assert (tmp_path / "a").read_bytes() == b"first"


@pytest.mark.parametrize("name", ["../out", "/etc/hostname", "link", "ring", "a/../../out", "x" * 5000, "nul\0l"])
def test_a_name_that_leads_out_of_its_folder_is_refused(tmp_path, name):
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "out").write_text("secret")
    (folder / "link").symlink_to(tmp_path / "out")
    (folder / "ring").symlink_to(folder / "ring")
    with pytest.raises(NotInside):
        file_inside(name, folder)


def test_links_inside_the_folder_are_followed(tmp_path):
    (tmp_path / "real").write_text("here")
    (tmp_path / "link").symlink_to("real")
    assert file_inside("link", tmp_path) == (tmp_path / "real").resolve()
    assert path_inside("not there", tmp_path) == tmp_path.resolve() / "not there"
    with pytest.raises(NotInside, match="is not there"):
        file_inside("not there", tmp_path)
    with pytest.raises(NotInside, match="is a folder"):
        file_inside(".", tmp_path)


@posix
def test_a_pipe_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(NotInside, match="a pipe"):
        file_inside("pipe", tmp_path)
