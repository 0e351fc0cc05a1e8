"""Readings that are lost count neither as data, nor as noise, nor as motion."""

from dataclasses import replace

import numpy as np
import pytest

from vlab.cases.channel_map import Compared, Run
from vlab.diagnose.data.noise import noise_levels
from vlab.diagnose.data.quality import is_informative
from vlab.diagnose.validation.horizon import parts_of
from vlab.recordings.clocks import filled
from vlab.signals import Channel, Recording, longest_read, strung_together

N, DT, NOISE = 4000, 1e-3, 0.02
TIME = np.arange(N) * DT


def run_with(lost):
    rng = np.random.default_rng(3)
    values = np.sin(2 * np.pi * 1.5 * TIME) + NOISE * rng.normal(size=N)
    between, is_read = filled(np.where(lost, np.nan, values))
    measured = Recording(
        time=TIME,
        data=between[:, None],
        channels=(Channel(name="x", kind="displacement", unit="m"),),
        missing=~is_read[:, None] if lost.any() else None,
    )
    return Run(
        name="run",
        role="fit",
        measured=measured,
        before=None,
        drives=(),
        compared=(Compared(channel="x"),),
        law=None,
        hardware=None,
        initial="auto",
        start=(np.zeros(1), np.zeros(1)),
    )


@pytest.mark.parametrize("every", [2, 4])
def test_the_noise_is_that_of_the_readings_left(every):
    lost = np.arange(N) % every != 0
    assert noise_levels(run_with(lost), ["x"])[0] == pytest.approx(NOISE, rel=0.3)


def test_lost_readings_are_not_informative():
    lost = (np.arange(N) // 50) % 7 == 3
    run = run_with(lost)
    np.testing.assert_array_equal(is_informative(run, run.compared)[:, 0], ~lost)


def test_parts_of_a_recording_keep_their_lost_readings_and_one_stated_start():
    lost = (np.arange(N) // 50) % 7 == 3
    run = run_with(lost)
    parts = parts_of(run, 4)
    whole = strung_together([part.measured for part in parts])
    np.testing.assert_array_equal(whole.missing, run.measured.missing)
    np.testing.assert_array_equal(whole.time, run.measured.time)
    assert [part.start is not None for part in parts] == [True, False, False, False]
    assert parts[1].initial == "estimated"


def test_the_longest_stretch_of_readings():
    lost = np.zeros(N, dtype=bool)
    lost[1000], lost[3500:] = True, True
    assert longest_read(run_with(lost).measured, "x") == slice(1001, 3500)
    whole = run_with(np.zeros(N, dtype=bool)).measured
    assert longest_read(whole, "x") == slice(0, N)
    assert longest_read(replace(whole, missing=np.ones((N, 1), dtype=bool)), "x") == slice(0, 0)
