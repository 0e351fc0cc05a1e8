"""Progress in a log: lines that a person can read, and none from short works."""

import itertools

import pytest
import tqdm.std

from vlab.cli.common import LOG_S, count_bar, share_bar


@pytest.fixture
def clock(monkeypatch):
    """Every look at the time is this many seconds after the last one."""
    step = [0.0]
    past = itertools.accumulate(iter(lambda: step[0], None))
    monkeypatch.setattr(tqdm.std, "time", lambda: next(past))
    return step


def test_a_log_gets_a_line_now_and_then(clock, capsys):
    with share_bar("diagnose") as report:
        clock[0] = LOG_S / 5
        for i in range(20):
            report(i / 20, f"step {i}")
    shown = capsys.readouterr().err
    assert "\r" not in shown
    lines = shown.splitlines()
    assert 2 <= len(lines) <= 5
    assert all(line.startswith("diagnose: ") and "step" in line and " left" in line for line in lines)


def test_a_short_work_leaves_the_log_alone(clock, capsys):
    with count_bar("prove", 20) as report:
        clock[0] = LOG_S / 100
        for i in range(20):
            report(i + 1, 20)
    assert not capsys.readouterr().err
