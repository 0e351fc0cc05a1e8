"""Progress in a log: lines that a person can read, and none from short works."""

import itertools

import pytest
import tqdm.std

from vlab.cli.common import LOG_S, count_bar, progress_bar, share_bar


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


def test_the_time_before_the_first_report_is_no_measure_of_the_rest(clock, capsys):
    with progress_bar("experiment", 10.0) as report:
        clock[0] = 10 * LOG_S
        tqdm.std.time()  # a compilation
        clock[0] = LOG_S / 100
        for i in range(200):
            report(1.0 + 8.0 * i / 200)
    shown = capsys.readouterr().err.splitlines()
    assert "1.0/10.0" in shown[0]
    left = [text for line in shown if (text := line.split(", ")[1].removesuffix(" left")) != "?"]
    assert left
    for text in left:
        minutes, seconds = map(int, text.split(":"))
        assert 60 * minutes + seconds < 20 * LOG_S
