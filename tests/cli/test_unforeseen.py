"""What nobody foresaw and interrupts: one line, a status of their own, nothing half-written."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command import run

import vlab.cli.effects as verb
from vlab.parallel import side_by_side

COMMAND = [sys.executable, "-m", "vlab"]


def broken(arguments):
    return [][1]


def in_a_worker(arguments):
    return side_by_side(lambda i: 1 // i, [1, 0])


class Panic(BaseException):
    """As libraries in Rust raise it."""


def panicking(arguments):
    raise Panic("boom\n\x1b[2J")


@pytest.mark.parametrize(("fault", "kind"), [(broken, "IndexError"), (panicking, "Panic")])
def test_an_unforeseen_error_is_one_line_with_its_kind_and_how_to_report_it(capsys, monkeypatch, fault, kind):
    monkeypatch.setattr(verb, "run", fault)
    status, out, err = run(capsys, "effects")
    assert (status, out) == (3, "")
    assert err.startswith(f"error: unforeseen {kind} at vlab.cli:")
    assert err.count("\n") == 1
    assert err.strip().isprintable()
    assert "please report" in err
    assert "--debug" in err
    assert "Traceback" not in err


def test_where_it_happened_is_the_innermost_line_of_vlab_also_in_a_worker(capsys, monkeypatch):
    monkeypatch.setattr(verb, "run", in_a_worker)
    status, _, err = run(capsys, "effects")
    assert status == 3
    assert "ZeroDivisionError at vlab.parallel:" in err
    assert err.count("\n") == 1


def test_debug_shows_the_traceback_of_every_verb(capsys, monkeypatch):
    monkeypatch.setattr(verb, "run", broken)
    status, _, err = run(capsys, "effects", "--debug")
    assert status == 3
    assert "Traceback" in err
    assert "return [][1]" in err
    assert err.splitlines()[-1].startswith("error: unforeseen IndexError")
    status, _, err = run(capsys, "compare", "nowhere", "--debug")
    assert status == 2
    assert "Traceback" in err


@pytest.mark.slow
def test_what_the_system_refuses_is_no_fault_of_vlab():
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    with open("/dev/full", "w") as full:
        done = subprocess.run([*COMMAND, "effects"], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1


@pytest.mark.slow
def test_what_a_terminal_has_no_signs_for_is_written_as_escapes():
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    done = subprocess.run(
        [*COMMAND, "compare", "gr\u00f6\u00dfe"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "gr\\xf6\\xdfe" in done.stderr


HANGING = """
import sys, time
from vlab.interrupts import LeavingAtOnce
with LeavingAtOnce():
    print("importing", flush=True)
    try:
        while True:  # a signal that comes just before one long sleep would wait for its end
            time.sleep(0.01)
    except KeyboardInterrupt:
        raise ImportError("as some libraries have it")
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_modules_are_imported_is_one_line(number):
    process = subprocess.Popen(
        [sys.executable, "-c", HANGING], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "importing\n"
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err == "error: interrupted; nothing half-written was left\n"


def test_the_command_is_guarded_from_its_first_import_on():
    process = subprocess.Popen([*COMMAND, "modes", "beam"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    table, handled = Path(f"/proc/{process.pid}/status"), 0
    if not table.exists():
        process.kill()
        pytest.skip("no /proc here")
    while not handled & 1 << signal.SIGTERM - 1:  # Python itself handles SIGINT from its start on, SIGTERM never
        assert process.poll() is None
        handled = int(table.read_text().split("SigCgt:")[1].split()[0], 16)
        time.sleep(0.001)
    assert "numpy" not in Path(f"/proc/{process.pid}/maps").read_text()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "error: interrupted; nothing half-written was left\n")


def test_an_interrupt_that_a_library_turns_into_its_own_error_stays_an_interrupt(capsys, monkeypatch):
    def turned(arguments):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("half a module") from None

    monkeypatch.setattr(verb, "run", turned)
    status, _, err = run(capsys, "effects")
    assert (status, err) == (130, "error: interrupted; nothing half-written was left\n")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
