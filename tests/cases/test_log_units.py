"""Tables of a case are in the units of its logs; documents stay in SI."""

import dataclasses
import math

import pytest
from arm_logs import write_arm

from vlab.cases.case import load_case
from vlab.cases.log_units import in_log_unit, log_units
from vlab.cli import main
from vlab.cli.table import text_table


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    write_arm(folder, logs=2, seconds=2.0)
    assert main(["init", str(folder / "arm.xml"), *(str(folder / f"run{k}.csv") for k in (1, 2))]) == 0
    return folder / "case.toml"


def test_a_channel_has_the_unit_of_its_logs(case):
    table = load_case(case).table
    assert log_units(table)["joint:elbow_flex"] == "deg"
    first = table.recording[0]
    other = tuple(dataclasses.replace(c, unit="rad") if c.at == "joint:elbow_flex" else c for c in first.channel)
    mixed = dataclasses.replace(table, recording=(dataclasses.replace(first, channel=other), *table.recording[1:]))
    assert "joint:elbow_flex" not in log_units(mixed)


def test_values_follow_the_unit_of_the_log_where_it_measures_the_same():
    assert in_log_unit((math.pi, None), "rad", "deg") == ([pytest.approx(180.0), None], "deg")
    assert in_log_unit((1.0,), "rad", None) == ([1.0], "rad")
    assert in_log_unit((1.0,), "m/N", "mm") == ([1.0], "m/N")


def test_check_and_compare_print_degrees_where_the_log_has_them(case, capsys):
    for verb in ("check", "compare"):
        assert main([verb, str(case)]) == 0
        rows = [line for line in capsys.readouterr().out.splitlines() if "joint:elbow_flex" in line]
        assert rows
        assert all(" deg" in row and " rad" not in row for row in rows)


def test_a_table_prints_no_minus_before_zero():
    assert text_table(("from",), [[-0.0], [-0.5]]).splitlines()[2:] == ["   0", "-0.5"]
