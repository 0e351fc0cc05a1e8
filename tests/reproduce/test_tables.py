"""The published tables beside ours, and what is claimed about them."""

import numpy as np
import pytest

from vlab.design.published_tables import published_design, published_table
from vlab.errors import UnknownName
from vlab.reproduce.study import Study
from vlab.reproduce.tables.cells import Cell, ReproducedTable, share, widened
from vlab.reproduce.tables.registry import NOT_REPRODUCIBLE, REPRODUCED, reproduce_tables

BEAM = [number for number, (structure, _) in REPRODUCED.items() if structure == "beam"]
GRID = [number for number, (structure, _) in REPRODUCED.items() if structure == "grid"]


@pytest.fixture(scope="module")
def beam_tables():
    return {table.table: table for table in reproduce_tables(BEAM)}


@pytest.fixture(scope="module")
def grid_tables():
    return {table.table: table for table in reproduce_tables(GRID)}


@pytest.fixture(scope="module")
def grid():
    return Study("grid")


def test_every_determined_cell_of_the_beam_is_inside_its_tolerance(beam_tables):
    counted = share(beam_tables.values())
    assert counted.inside == counted.of >= 74  # 6 + 18 + 8 + 18 + 24 cells of Tables 1, 7, its optima, 8 and 9
    assert share(beam_tables.values(), determined=False).of == 0


@pytest.mark.slow
def test_every_determined_cell_of_the_grid_is_inside_its_tolerance(grid_tables):
    for table in grid_tables.values():
        assert table.ok, [cell for cell in table.cells if cell.determined and not cell.ok]


@pytest.mark.slow
def test_the_claimed_tolerances_are_the_honest_ones(beam_tables, grid_tables):
    # what the reconstruction can hold; nothing wider may slip in
    assert {c.tolerance for c in beam_tables["8"].cells if c.column == "lqg"} == {0.01}
    assert sorted({c.tolerance for c in beam_tables["9"].cells}) == [0.02, 0.035]
    widest = {"11": 0.15, "12": 0.16, "13": 0.50, "17": 0.20, "18": 0.20}
    for number, limit in widest.items():
        assert max(c.tolerance for c in grid_tables[number].cells if c.determined) <= limit


def test_what_was_widened_is_said(beam_tables, grid_tables):
    assert widened(beam_tables.values()) == []
    honest = {"12": 0.08, "17": 0.08, "18": 0.15}  # what the reconstruction was said to hold beforehand
    wide = widened(grid_tables.values())
    assert {number for number, _ in wide} == {*honest, "13"}
    for number, cell in wide:
        assert cell.ok
        assert cell.row == "mode 1" or (number, cell.column, cell.row) == ("13", "lqdrf, reduced model", "mode 10")
        assert cell.honest == honest.get(number, 0.25 if cell.row == "mode 10" else 0.15)
    counted = share(grid_tables.values(), honest=True)
    assert counted.inside >= 233  # of 247


def test_designed_anew_lqdrf_is_not_above_the_printed_gains():
    # the printed D reaches its largest index on the same model; an optimum may not be worse
    study = Study("beam")
    printed = study.rate_feedback_index("full", study.printed_gains("7", "lqdrf"), 6).max()
    assert study.lqdrf("full").objective <= printed


def test_columns_of_the_corrected_model_decide_nothing(grid_tables):
    for number in ("4", "6", "14", "15", "16"):
        assert not any(cell.determined for cell in grid_tables[number].cells)
    for number in ("17", "18"):
        for cell in grid_tables[number].cells:
            assert cell.determined == cell.column.endswith(", exact")


def test_guyan_mass_suits_the_measured_shapes_and_the_exact_mass_does_not(grid_tables):
    # section 3.3: largest .58, mean .13 in Guyan's mass; the finding is that the exact mass is much worse
    off = {n: {c.column: c.ours for c in grid_tables[n].cells if c.row == "off the diagonal"} for n in ("4", "6")}
    assert off["6"]["largest"] == pytest.approx(
        0.58, abs=0.015
    )  # the shapes hold Table 6 to .007 rms on another variant
    assert off["6"]["mean"] == pytest.approx(0.13, abs=0.005)
    assert off["4"]["mean"] > 2 * off["6"]["mean"]


def test_direct_rate_feedback_takes_damping_from_no_mode_and_lqg_does(grid_tables):
    # section 6.2.1; D of Table 11 is positive semidefinite to its last printed digit
    assert grid_tables["6.2.1"].ok
    _, spilled = Study("grid").lqg("exact").poles_on(Study("grid").state())
    losing = [mode for mode in spilled.losing(1e-6) if mode > 12]
    assert losing
    lost = [-spilled.change[spilled.modes.index(mode)] for mode in losing]
    assert max(lost) < 1e-4  # the honest statement: some modes above 12 lose at most 1e-4


def test_reduction_costs_the_regulator_little(grid):
    # section 6.2.1: applying the reduced controller to the full model raises the indices of modes 1-5 by under 2 %
    law, full = grid.lqg("exact"), grid.lqg("full")
    reduced = law.indices_on(grid.state(), full.weights, 5)
    assert reduced == pytest.approx(full.indices(grid.published_modes(5)), rel=0.02)


def test_correction_leaves_or_improves_the_twelfth_frequency(grid):
    # section 3.3: 11.32 Hz moved towards the measured 9.60 Hz by eleven other modes; ours from 12.13 Hz
    before, after = grid.fe("guyan").linear.freq[-1], grid.fe("corrected-guyan").linear.freq[-1]
    assert 9.60 < after < before - 0.5


def test_designs_say_what_they_were_asked_for():
    assert published_design("beam").r == 0.22
    assert published_design("grid", "corrected-guyan").r == 1.387
    with pytest.raises(UnknownName, match="accepted: identity, energy, corrected-guyan"):
        published_design("grid", "identty")


@pytest.mark.parametrize(
    ("structure", "number", "laws"),
    [
        ("beam", "7", ("mfdrf", "lqdrf")),
        ("grid", "11", ("mfdrf", "lqdrf", "lqdrf-diagonal")),
        ("grid", "15", ("mfdrf", "lqdrf-diagonal")),
    ],
)
def test_printed_gains_are_symmetric_and_dissipate(structure, number, laws):
    for law in laws:
        D = np.array(published_table(structure, number, law).cells)
        assert pytest.approx(D.T) == D
        assert np.linalg.eigvalsh(D).min() >= -2e-4  # rounding of the fourth digit; MFDRF's D of Table 11 is singular


def test_one_printed_gain_matrix_is_indefinite():
    # Table 15, LQDRF: D > 0 was demanded; with the other sign between joints 1 and 2 (or 2 and 5) it would be
    table = published_table("grid", "15", "lqdrf")
    D = np.array(table.cells)
    assert np.linalg.eigvalsh(D).min() < -1e-3  # ten times what rounding of the fourth digit can do
    D[0, 1] = D[1, 0] = -D[0, 1]
    assert np.linalg.eigvalsh(D).min() > 0


def test_every_table_is_reproduced_or_says_why():
    named = " ".join([*REPRODUCED, *NOT_REPRODUCIBLE]).replace(",", " ").replace("-", " to ")
    words, numbers = named.split(), set()
    for i, word in enumerate(words):
        if word.isdigit():
            numbers.add(int(word))
            if i + 2 < len(words) and words[i + 1] == "to" and words[i + 2].isdigit():
                numbers |= set(range(int(word), int(words[i + 2]) + 1))
    assert numbers >= set(range(1, 22))


def test_cells_judge_by_their_rule():
    def cell(ours, **rule):
        return Cell(row="", column="", published=2.0, ours=ours, unit="1", **rule)

    assert cell(2.19, tolerance=0.1).ok
    assert not cell(2.21, tolerance=0.1).ok
    assert cell(2.3, tolerance=0.4, rule="absolute").ok
    assert not cell(1.5, tolerance=0.4, rule="absolute").ok
    assert cell(1.01, tolerance=2.0, rule="factor").ok
    assert not cell(0.99, tolerance=2.0, rule="factor").ok
    assert not cell(-2.0, tolerance=2.0, rule="factor").ok
    late = cell(2.15, tolerance=0.1, honest=0.05)
    assert late.ok
    assert not late.is_honest
    assert late.off == pytest.approx(0.075)
    shown = cell(9.0, tolerance=0.1, determined=False)
    table = ReproducedTable(table="0", title="", cells=(cell(2.0, tolerance=0.1), shown))
    assert table.ok
    assert not shown.ok
    assert str(share([table])) == "1 of 1"
    assert cell(2.0, tolerance=2.0, rule="factor").allowed == "factor 2"


def test_unknown_tables_are_refused():
    with pytest.raises(UnknownName, match="unknown table '42'"):
        reproduce_tables(["42"])
