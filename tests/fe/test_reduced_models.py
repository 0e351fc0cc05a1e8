"""Reduced models by name, in the coordinates that the structure files retain."""

import dataclasses

import numpy as np
import pytest

from vlab.design.published_tables import published_table
from vlab.errors import BadStructure, UnknownName
from vlab.fe import build_fe_model
from vlab.fe.measured_modes import measured_modes
from vlab.fe.reduced import build_reduced_model
from vlab.reproduce.cross_check import NEAR, cross_check
from vlab.reproduce.tables.registry import reproduce_tables
from vlab.structure import load_structure
from vlab.structure.discretisation import Reduction


@pytest.mark.slow
def test_modes_of_a_reduction_are_compared_with_near_modes_and_its_own_table():
    check = cross_check(load_structure("grid"), model="guyan", plants=["fe"], seconds=2.0)
    # Table 5 as printed; 13 points make modes far above look like those that static condensation bends
    assert check.published == pytest.approx(published_table("grid", "5").column("guyan reduction"))
    found = check.plants["fe"].freq / check.fe.linear.freq[check.modes]
    assert np.all((found > 1 / NEAR) & (found < NEAR))


@pytest.mark.parametrize("name", ["beam", "grid"])
def test_exact_reduction_keeps_frequencies_shapes_and_damping(name):
    structure = load_structure(name)
    full, reduced = build_fe_model(structure), build_reduced_model(structure, "exact")
    n = reduced.linear.n
    assert n == len(structure.reduction.retained)
    modes = [mode - 1 for mode in structure.reduction.exact_modes] or slice(n)  # the grid keeps mode 13 for mode 12
    assert reduced.linear.freq == pytest.approx(full.linear.freq[modes], rel=1e-9)  # exact by construction; rounding
    assert reduced.linear.zeta == pytest.approx(full.linear.zeta[modes], rel=1e-6)
    places = [p.name for p in structure.point]
    shapes = [m.deflections(places) @ m.linear.eigen[1][:, 0] for m in (full, reduced)]
    assert np.abs(shapes[1]) == pytest.approx(np.abs(shapes[0]), abs=1e-7 * np.abs(shapes[0]).max())


def test_guyan_reduction_keeps_static_deflections(beam):
    full, reduced = build_fe_model(beam), build_reduced_model(beam, "guyan")
    static = [m.deflection("35in") @ np.linalg.solve(m.linear.K, m.deflection("base")) for m in (full, reduced)]
    assert static[1] == pytest.approx(static[0], rel=1e-9)  # load and coordinates retained: no approximation


def test_guyan_frequencies_lie_above_the_full_ones():
    for name in ("beam", "grid"):
        structure = load_structure(name)
        full, guyan = build_fe_model(structure), build_reduced_model(structure, "guyan")
        assert np.all(guyan.linear.freq >= full.linear.freq[: guyan.linear.n] * (1 - 1e-12))  # Rayleigh's quotient


def test_table_5_within_the_honest_tolerance():
    (table,) = reproduce_tables(["5"])
    assert table.ok, [c for c in table.cells if not c.ok]


def test_names_that_do_not_exist_are_refused(beam):
    with pytest.raises(UnknownName, match="did you mean 'guyan'"):
        build_reduced_model(beam, "guyam")
    wrong = dataclasses.replace(beam, reduction=Reduction(retained=("v:base", "v:11in"), source="test"))
    with pytest.raises(UnknownName, match="v:11in"):
        build_reduced_model(wrong, "guyan")
    with pytest.raises(BadStructure, match="names no coordinates"):
        build_reduced_model(dataclasses.replace(beam, reduction=None), "exact")


def test_the_corrected_model_has_the_measured_modes():
    grid = load_structure("grid")
    corrected, measured = build_reduced_model(grid, "corrected-guyan").linear, measured_modes("grid")
    assert corrected.freq[:11] == pytest.approx(measured.frequencies, rel=1e-8)  # Table 3, experimental
    assert corrected.zeta[:11] == pytest.approx(measured.ratios, rel=1e-6)
    assert corrected.zeta[11] == pytest.approx(0.005, rel=1e-6)  # the mode without a measured shape
    shapes = measured.at(corrected.coordinates).shapes
    ours = corrected.eigen[1][:, :11]
    for i in range(11):
        k = np.abs(shapes[:, i]).argmax()
        assert ours[:, i] / ours[k, i] == pytest.approx(shapes[:, i] / shapes[k, i], abs=1e-7)


def test_measured_modes_say_what_is_missing(beam):
    with pytest.raises(BadStructure, match="no measured modes of structure 'beam'"):
        build_reduced_model(beam, "corrected-guyan")
    with pytest.raises(BadStructure, match="no shapes at v:point16"):
        measured_modes("grid").at(("v:joint1", "v:point16"))


def test_the_exact_reduction_of_the_grid_keeps_its_twelve_joints():
    grid = load_structure("grid")
    exact = build_reduced_model(grid, "exact")
    assert exact.linear.coordinates == tuple(f"v:joint{i}" for i in range(1, 13))  # section 3.3
    assert exact.linear.zeta[11] == pytest.approx(0.003929, rel=1e-6)


def test_guyan_modes_have_the_ratio_of_the_mode_they_are_like(beam):
    full, guyan = build_fe_model(beam), build_reduced_model(beam, "guyan")
    assert guyan.linear.zeta[:6] == pytest.approx(full.linear.zeta[:6], rel=1e-6)
