"""Short forms of a case: shared channels, patterns, rows, clocks of channels, blank cells."""

import numpy as np
import pytest
from form_rigs import DT, SHARED, TIME, N, Q, U, channel, columns, write_case, write_csv

from vlab.cases import compare_case, load_case
from vlab.cases.simulate import simulate
from vlab.errors import BadCase, BadRecording, VlabError
from vlab.files.toml_writer import toml_text
from vlab.recordings.selection import parse_where

# ---- shared channels and patterns -----------------------------------------------------------------------------------


def test_shared_channels_and_a_pattern_are_the_plain_form(folder):
    plain = "".join(
        f'[[recording]]\nfile = "run{k}.csv"\nrole = "{role}"\ntime = "t"\n{U}{Q}'
        for k, role in ((1, "fit"), (2, "fit"), (10, "holdout"))
    )
    expected = load_case(write_case(folder, plain)).runs()
    short = (
        '[[recording]]\nfiles = "run?.csv"\nrole = "fit"\ntime = "t"\n'
        '[[recording]]\nfile = "run10.csv"\nrole = "holdout"\ntime = "t"\n'
    )
    case = load_case(write_case(folder, short + SHARED))
    assert [name for name, _ in case.recordings()] == ["run1", "run2", "recording3"]
    for run, other in zip(case.runs(), expected, strict=True):
        assert run.role == other.role
        assert run.measured.names == other.measured.names
        np.testing.assert_array_equal(run.measured.data, other.measured.data)


def test_the_plain_form_of_a_case_is_written_and_read_again(folder):
    case = load_case(write_case(folder, f'[[recording]]\nfiles = "run*.csv"\nrole = "fit"\ntime = "t"\n{SHARED}'))
    (folder / "plain.toml").write_text(toml_text(case.raw))
    again = load_case(folder / "plain.toml")
    assert again.table == case.table
    assert "channel" not in again.raw


def test_files_of_a_pattern_are_in_the_order_of_their_numbers(folder):
    case = load_case(
        write_case(folder, f'[[recording]]\nfiles = ["run1*.csv", "run2.csv"]\nrole = "fit"\ntime = "t"\n{SHARED}')
    )
    assert [table.file for _, table in case.recordings()] == ["run1.csv", "run10.csv", "run2.csv"]
    case = load_case(
        write_case(folder, f'[[recording]]\nname = "lab"\nfiles = "run*.csv"\nrole = "fit"\ntime = "t"\n{SHARED}')
    )
    assert [name for name, _ in case.recordings()] == ["lab run1", "lab run2", "lab run10"]


def test_a_channel_of_its_own_takes_the_place_of_the_shared_one(folder):
    case = load_case(write_case(folder, f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\n{SHARED}'))
    text = f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\n{channel("q", "joint:shoulder_pan", "angle", "deg")}'
    (plain,) = case.runs()
    (run,) = load_case(write_case(folder, text + SHARED)).runs()
    np.testing.assert_allclose(run.measured["joint:shoulder_pan"], np.deg2rad(plain.measured["joint:shoulder_pan"]))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (f'[[recording]]\nfiles = "log*.csv"\nrole = "fit"\ntime = "t"\n{SHARED}', r"no file matches 'log\*.csv'; files .*run1.csv"),
        (f'[[recording]]\nfile = "run1.csv"\nfiles = "run*.csv"\nrole = "fit"\ntime = "t"\n{SHARED}', "both given"),
        (f'[[recording]]\nfiles = "../*.csv"\nrole = "fit"\ntime = "t"\n{SHARED}', "leaves the case's folder.*--allow-outside"),
        (f'[[recording]]\nfiles = 3\nrole = "fit"\ntime = "t"\n{SHARED}', "a pattern such as"),
        ('[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\n' + SHARED.replace('"angle"', '"angel"'), r"case.toml: channel"),
        ('[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\n' + SHARED.replace("joint:shoulder_pan", "joint:x"), r"case.toml: channel\[1\]: unknown sensor"),
        ('[[modal]]\nrole = "fit"\nfrequency_hz = [1.0]\n' + SHARED, "shared channels belong to recordings"),
        (f'[recording]\nfile = "run1.csv"\n{SHARED}', r"write \[\[recording\]\]"),
        (f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\nepisode = -1\n{SHARED}', "numbers of episodes from 0"),
        (f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\nepisode = 0\nepisodes = [1]\n{SHARED}', "both given"),
    ],
)  # fmt: skip
def test_short_forms_that_are_refused(folder, text, match):
    with pytest.raises(VlabError, match=match) as caught:
        load_case(write_case(folder, text))
    assert "\n" not in str(caught.value)


# ---- rows -----------------------------------------------------------------------------------------------------------


def test_rows_are_chosen_by_comparisons(folder):
    table = columns()
    table["level_V"] = np.where(TIME < 1.0, np.float32(0.1), 0.3)
    write_csv(folder / "levels.csv", table)
    text = "".join(
        f'[[recording]]\nfile = "levels.csv"\nrole = "{role}"\ntime = "t"\nwhere = "{where}"\n'
        for role, where in (("fit", "level_V == 0.1"), ("holdout", "level_V == 0.3 and t < 1.5"))
    )
    fit, held = load_case(write_case(folder, text + SHARED)).runs()
    assert (fit.measured.time[0], fit.measured.time[-1]) == (0.0, pytest.approx(0.99))
    assert (held.measured.time[0], held.measured.time[-1]) == (pytest.approx(1.0), pytest.approx(1.49))
    without = text.replace('time = "t"', "rate_hz = 100.0")
    _, held = load_case(write_case(folder, without + SHARED)).runs()
    assert held.measured.time[0] == 0.0
    assert held.measured.rate == pytest.approx(100.0)


def test_the_same_rows_are_not_both_fitted_and_held_out(folder):
    table = {**columns(), "run": np.where(TIME < 1.0, 1, 2)}
    write_csv(folder / "runs.csv", table)
    text = "".join(
        f'[[recording]]\nfile = "runs.csv"\nrole = "{role}"\ntime = "t"\nwhere = "{where}"\n'
        for role, where in (("fit", "run == 1"), ("holdout", "run >= 1"))
    )
    with pytest.raises(BadCase, match="held out and fitted"):
        load_case(write_case(folder, text + SHARED))


@pytest.mark.parametrize(
    "where",
    [
        "level",
        "level = 1",
        "level == x",
        "__import__('os') == 1 or 1",
        "level == 1 or run == 2",
        "level == nan",
        "== 1",
        "",
    ],
)
def test_what_is_no_comparison_is_refused(where):
    with pytest.raises(BadCase, match="is no comparison; accepted: 'COLUMN OPERATOR NUMBER'"):
        parse_where(where)


def test_names_in_quotes_may_hold_operators():
    (condition,) = parse_where('"a <b> c" >= -1.5e-3')
    assert (condition.column, condition.operator, condition.number) == ("a <b> c", ">=", -1.5e-3)


def test_a_comparison_that_no_row_meets_names_the_values(folder):
    text = '[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\nwhere = "u == 77"\n'
    with pytest.raises(BadRecording, match="0 rows meet u == 77; values of 'u': "):
        load_case(write_case(folder, text + SHARED)).runs()


# ---- clocks of channels and blank cells -----------------------------------------------------------------------------


def test_a_held_input_on_its_own_clock_keeps_the_impulse_of_every_step(folder):
    """Mean over a step times its length is the integral of the held input, whatever the two clocks are."""
    own = np.sort(np.random.default_rng(1).uniform(0.0, TIME[-1], 70))
    own[0] = 0.0
    values = np.random.default_rng(2).normal(size=70)
    write_csv(folder / "two.csv", {"t": TIME, "q": columns()["q"], "t_u": own, "u": values})
    text = f'[[recording]]\nfile = "two.csv"\nrole = "fit"\ntime = "t"\n{U}time = "t_u"\n{Q}'
    (run,) = load_case(write_case(folder, text)).runs()
    fine = np.linspace(0.0, TIME[-1], 400_001)[:-1]
    exact = np.cumsum(values[np.searchsorted(own, fine, side="right") - 1]) * (fine[1] - fine[0])
    steps = np.cumsum(run.measured["pan_motor"][:-1]) * DT
    np.testing.assert_allclose(steps, np.interp(TIME[1:], fine, exact), atol=2e-4)
    (note,) = run.measured.meta["reading"]
    assert note.startswith("u: 70 samples at ")
    assert note.endswith("on their own clock, as means over the steps of the recording")


def test_a_reading_on_its_own_clock_is_compared_near_its_times_only(folder):
    own = TIME[::4] + 0.001
    angle = 0.1 * np.sin(3 * own)
    write_csv(folder / "two.csv", {"t": TIME, "u": columns()["u"], "q": columns()["q"], "t_e": own, "e": angle})
    more = channel("e", "joint:elbow_flex", "angle", "rad", 'time = "t_e"')
    text = f'[[recording]]\nfile = "two.csv"\nrole = "fit"\ntime = "t"\n{U}{Q}{more}'
    (run,) = load_case(write_case(folder, text)).runs()
    is_read = run.measured.is_read("joint:elbow_flex")
    np.testing.assert_array_equal(np.flatnonzero(is_read), np.arange(0, N, 4))
    assert run.measured.is_read("joint:shoulder_pan").all()
    at = run.measured.time[is_read][1:]  # a straight line between readings 40 ms apart: 0.1 * 9 * 0.04^2 / 8
    np.testing.assert_allclose(run.measured["joint:elbow_flex"][is_read][1:], 0.1 * np.sin(3 * at), atol=2e-4)
    part = run.measured.between(0.5, 1.0)
    assert part.is_read("joint:elbow_flex").sum() == 12


def test_channels_with_times_of_their_own_need_no_common_time(folder):
    write_csv(folder / "own.csv", {"t_q": TIME, "q": columns()["q"], "t_u": TIME[::2], "u": columns()["u"][::2]})
    text = f'[[recording]]\nfile = "own.csv"\nrole = "fit"\n{U}time = "t_u"\n{Q}time = "t_q"\n'
    (run,) = load_case(write_case(folder, text)).runs()
    np.testing.assert_array_equal(run.measured.time, TIME)
    np.testing.assert_allclose(run.measured["pan_motor"], columns()["u"], atol=1e-12)  # even rows hold the tens
    with pytest.raises(BadCase, match="give rate_hz, or time"):
        load_case(write_case(folder, text.replace('time = "t_q"\n', "")))
    write_csv(folder / "own.csv", {"t_q": TIME, "q": columns()["q"], "t_u": TIME[::-1], "u": columns()["u"]})
    case = load_case(write_case(folder, text))
    with pytest.raises(BadRecording, match="the times 't_u' of column 'u' do not increase at sample 1"):
        case.runs()


def test_blank_cells_of_an_input_stand_only_where_the_case_says_so(folder):
    table = columns()
    blank = np.arange(N) % 5 != 0
    write_csv(folder / "blank.csv", {**table, "u": np.where(blank, np.nan, table["u"])})
    text = f'[[recording]]\nfile = "blank.csv"\nrole = "fit"\ntime = "t"\n{U}{Q}'
    with pytest.raises(BadRecording, match=r"'u' drives the model and is blank at sample 1 .*blank = \"hold\""):
        load_case(write_case(folder, text)).runs()
    (run,) = load_case(write_case(folder, text.replace("input = true", 'input = true\nblank = "hold"'))).runs()
    np.testing.assert_array_equal(run.measured["pan_motor"], table["u"])
    assert run.measured.meta["reading"] == ("u: 160 of 200 cells are blank; the last value stands",)
    with pytest.raises(BadCase, match="is for inputs"):
        load_case(write_case(folder, text.replace(Q, Q + 'blank = "hold"\n')))


def test_rows_before_the_first_value_of_an_input_are_left_out(folder):
    table = columns()
    write_csv(folder / "late.csv", {**table, "u": np.where(np.arange(N) < 7, np.nan, table["u"])})
    text = f'[[recording]]\nfile = "late.csv"\nrole = "fit"\ntime = "t"\n{U}blank = "hold"\n{Q}'
    (run,) = load_case(write_case(folder, text)).runs()
    assert run.measured.time[0] == pytest.approx(0.07)
    assert "7 samples without a known input left out" in run.measured.meta["reading"][1]


def test_samples_without_a_reading_are_not_compared(folder):
    """The residual of a channel with lost readings is that of the readings left."""
    case = load_case(
        write_case(folder, f'[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\ninitial = "rest"\n{SHARED}')
    )
    (run,) = case.runs()
    own = simulate(case.plant, run).recording["joint:shoulder_pan"]
    lost = (np.arange(N) // 20) % 3 == 1
    write_csv(folder / "lost.csv", {**columns(1), "q": np.where(lost, np.nan, columns(1)["q"])})
    comparison = compare_case(
        write_case(folder, f'[[recording]]\nfile = "lost.csv"\nrole = "fit"\ntime = "t"\ninitial = "rest"\n{SHARED}')
    )
    (result,) = comparison.runs
    kept = columns(1)["q"][~lost]
    assert result.misfits[0].nrmse == pytest.approx(np.sqrt(np.mean((own[~lost] - kept) ** 2)) / kept.std(), rel=1e-9)
    said = f"q: {lost.sum()} of {N} samples have no reading and are not compared"
    assert any(said in remark for remark in comparison.remarks)
