"""Logs as people have them: stamps in two columns, footers, separators of thousands, ticks of a coarse clock."""

import json
from pathlib import Path

import numpy as np
import pytest

from vlab.cases.draft.logs import choose_clock, open_log
from vlab.errors import BadRecording
from vlab.recordings.overview import kind_of, overview
from vlab.recordings.stamp_pairs import parts_of
from vlab.recordings.table import EVERY, Table, open_table
from vlab.recordings.ticks import even_in_ticks

STAMPS_NS = 1_741_523_412 * 10**9 + 991_234_567 + 4_000_000 * np.arange(50)
ROWS = "".join(f"{0.01 * k:.2f},{np.sin(k):.4f}\n" for k in range(30))


def stamped(path, names=("header.stamp.sec", "header.stamp.nanosec"), unit=1):
    rows = [(int(s // 10**9), int(s % 10**9 // unit), 0.5 * k) for k, s in enumerate(STAMPS_NS)]
    if path.suffix == ".jsonl":
        keys = (*names, "x")
        path.write_text("".join(json.dumps(dict(zip(keys, row, strict=True))) + "\n" for row in rows))
    else:
        path.write_text(",".join((*names, "x")) + "\n" + "".join(",".join(map(str, row)) + "\n" for row in rows))
    return path


@pytest.mark.parametrize("suffix", [".csv", ".jsonl"])
def test_seconds_and_nanoseconds_are_one_clock(tmp_path, suffix):
    path, name = stamped(tmp_path / f"log{suffix}"), "header.stamp.sec + header.stamp.nanosec"
    clock = choose_clock(open_log(path))
    assert (clock.time, clock.unit, clock.is_sure) == (name, "s", True)
    alone, whole = open_table(path, columns=[name, "x"], blanks=[name, "x"]), open_table(path, blanks=EVERY)
    assert np.array_equal(alone[name], whole[name])
    assert np.allclose(np.diff(alone[name]), 4e-3, rtol=0.0, atol=1e-9)
    assert any("times count from 1740000000 s" in note for note in alone.notes)


@pytest.mark.parametrize(
    ("names", "unit"),
    [(("sec", "nanosec"), 1), (("stamp/secs", "stamp/nsecs"), 1), (("tv_sec", "tv_usec"), 1000)],
)
def test_pairs_of_ros_and_posix(tmp_path, names, unit):
    path = stamped(tmp_path / "log.csv", names, unit)
    joined = " + ".join(names)
    assert parts_of(joined) == names
    assert kind_of(joined) == "time"
    assert np.allclose(open_table(path)[joined] % 1.0, STAMPS_NS % 10**9 / 1e9, rtol=0.0, atol=1e-6)


def test_total_times_are_no_pair(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("sec,nanosec\n" + "".join(f"{0.1 * k},{int(1e8) * k}\n" for k in range(20)))
    assert open_table(path).names == ("sec", "nanosec")
    assert parts_of("a.sec + b.nanosec") is None


@pytest.mark.parametrize(
    ("end", "said"),
    [
        (
            "\nEnd of recording\nSamples: 30\n",
            "line 33: text after the numbers: 'End of recording'; delete lines 33 to 34",
        ),
        ("Stopped by user\n", "line 32: text after the numbers: 'Stopped by user'; delete line 32"),
        ("Total,30,ok\n", "line 32: text after the numbers: 'Total,30,ok'; delete line 32"),
    ],
)
def test_a_footer_is_named_with_its_lines(tmp_path, end, said):
    path = tmp_path / "log.csv"
    path.write_text("t,x\n" + ROWS + end)
    with pytest.raises(BadRecording, match=said):
        open_table(path)


@pytest.mark.parametrize("odd", ["oops,1\n0.3,0.5\n", "\n0.3,0.5\n"])
def test_numbers_below_an_odd_line_make_no_footer(tmp_path, odd):
    path = tmp_path / "log.csv"
    path.write_text("t,x\n" + ROWS + odd)
    with pytest.raises(BadRecording, match="'oops', not a number|an empty line between the numbers"):
        open_table(path)


def test_rows_that_begin_with_text_are_no_footer(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("state,x\n" + "".join(f"on,{k}.5\n" for k in range(20)) + "on,\n")
    with pytest.raises(BadRecording, match=r"line 22: column 2 \('x'\) is empty"):
        open_table(path, columns=["x"])


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("t;f\n" + "".join(f"{0.1 * k:.1f};{1200.5 + k:,.1f}\n" for k in range(9)), "line 2: column 2 .* '1,200.5'"),
        ("t,f\n" + "".join(f'{0.1 * k:.1f},"{1200.5 + k:,.1f}"\n' for k in range(9)), "line 2: column 2 .* '1,200.5'"),
        ("t,f\n" + "".join(f"{0.1 * k:.1f},{1200.5 + k:,.1f}\n" for k in range(9)), "line 2: 3 cells where 2 are"),
        ("t,f\n0.0,1.5\n0.1,1,200.5\n", "line 3: 3 cells where 2 are"),
        ("t;f\n0,0;1.200,5\n0,1;1.300,5\n", "line 2: '1.200' has a point beside decimal commas"),
        ("t;f\n0,0;990,5\n0,1;-1.300\n", "line 3: '1.300' has a point beside decimal commas"),
    ],
)
def test_separators_of_thousands_are_named(tmp_path, text, where):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(BadRecording, match=f"{where}.*export numbers without separators of thousands"):
        open_table(path)


def test_an_element_in_brackets_is_no_unit(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t [ms],position[elbow],effort[Nm],force [kip]\n" + "".join(f"{k},1.5,2,{k}\n" for k in range(9)))
    assert open_table(path).units == {"t [ms]": "ms", "effort[Nm]": "Nm", "force [kip]": "kip"}


@pytest.mark.parametrize(("rate", "tick"), [(100.0, 4e-3), (200.0, 4e-3), (90.0, 2e-3)])
@pytest.mark.parametrize("cut", [np.rint, np.floor])
def test_ticks_of_a_coarse_clock_are_no_jitter(rate, tick, cut):
    time = tick * cut(np.arange(2000) / rate / tick)
    coarse = even_in_ticks(time)
    assert coarse is not None
    assert coarse.tick_s == pytest.approx(tick)
    assert coarse.rate_hz == pytest.approx(rate, rel=1e-3)
    assert f"ticks of {1e3 * tick:g} ms" in coarse.advice


def test_jitter_on_ticks_is_jitter():
    late = np.random.default_rng(0).integers(0, 3, 2000)
    assert even_in_ticks(4e-3 * (5 * np.arange(2000) + late)) is None
    assert even_in_ticks(np.round(np.arange(2000) / 300.0, 3)) is None


@pytest.mark.parametrize(
    ("name", "unit", "kind"),
    [
        ("joint_1_angle_deg", "deg", "position"),
        ("cart_pos_mm", "mm", "position"),
        ("acc_m_s2", "m/s2", "acceleration"),
        ("gyro_z_rad_per_s", "rad/s", "velocity"),
        ("torque_N_m", "N m", "moment"),
        ("accX_g", "g", "acceleration"),
        ("arm_pos_A", "", "position"),  # a part A
        ("mass_g", "", ""),
        ("motor_pos_min", "", "position"),  # the least position
        ("tool position [mm]", "mm", "position"),
        ("Force in N", "N", "force"),
        ("speed in rpm", "rpm", "velocity"),
        ("time in s", "s", "time"),
        ("tau_1_Nm", "Nm", "moment"),
        ("accel_m_s^2", "m/s^2", "acceleration"),
        ("pos_m_min", "", "position"),
        ("level_V_s", "", ""),
    ],
)
def test_a_unit_of_one_or_more_words_ends_a_name(name, unit, kind):
    table = Table(path=Path("log.csv"), columns={name: np.arange(3.0)})
    (column,) = overview(table)
    assert (column.unit, column.kind) == (unit, kind)
