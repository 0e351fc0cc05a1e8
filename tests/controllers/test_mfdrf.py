"""Minimised maximum force: closed forms, the published optimum, and what cannot be reached."""

import numpy as np
import pytest
from toys import oscillators, toy

from vlab import units
from vlab.controllers import mfdrf
from vlab.design import performance
from vlab.design.published_tables import published_table
from vlab.errors import BadDesign
from vlab.fe.reduced import build_reduced_model
from vlab.structure import load_structure

GAMMA = 0.0500
"""Largest row of Table 7, MFDRF [lbf s/in]."""


def gamma(design) -> float:
    return units.from_si(design.objective, "lbf s/in", "N s/m")


@pytest.fixture(scope="module")
def law(fe):
    return mfdrf.design(fe)


def test_single_mass_gets_the_dashpot_that_is_missing():
    # zeta = (c + d) / (2 m omega): d = 2 m omega zeta_L - c
    fe = toy([[2.0]], [[0.1]], [[50.0]], [[1.0]])
    law = mfdrf.design(fe, damping=0.05, modes=1, starts=3)
    assert law.D[0, 0] == pytest.approx(2 * 2.0 * 5.0 * 0.05 - 0.1, rel=1e-6)
    assert law.zeta(1)[0] == pytest.approx(0.05, rel=1e-7)
    assert set(law.search.active) == {"damping of mode 1", "force of coil0"}


def test_of_independent_masses_the_most_demanding_one_decides():
    law = mfdrf.design(oscillators([1.0, 2.0], np.eye(2)), damping=0.1, modes=2, starts=5)
    assert law.objective == pytest.approx(2 * 2.0 * 0.1, rel=1e-6)
    assert "force of coil1" in law.search.active
    assert "force of coil0" not in law.search.active


def test_beam_reaches_the_published_optimum_or_a_better_one(law):
    assert gamma(law) == pytest.approx(GAMMA, rel=0.01)  # four printed digits and an identified model
    assert gamma(law) <= GAMMA
    assert law.search.reached > law.search.starts // 4
    assert law.search.converged


def test_the_second_minimum_that_traps_is_seen_and_left(law):
    minima = units.from_si(np.array(law.search.local_minima), "lbf s/in", "N s/m")
    assert minima[0] == pytest.approx(0.0497, rel=0.005)
    assert minima[1] == pytest.approx(0.0506, rel=0.005)


def test_constraints_hold_on_exact_poles(law, fe):
    damped = fe.linear.with_rate_feedback(fe.coils, law.D)
    assert damped.complex_modes()[1][:6].min() >= 0.03 * (1 - 1e-5)  # what the search counts as no violation
    assert np.linalg.eigvalsh(law.D).min() > 0
    np.testing.assert_allclose(law.D, law.D.T, rtol=0, atol=1e-12)
    assert law.objective == performance.force_bounds(law.D).max()


def test_active_constraints_are_those_of_the_printed_design(law):
    # Table 8: modes 2, 4 and 6 at .0304, .0301, .0300
    active = law.search.active
    assert {"damping of mode 2", "damping of mode 4", "damping of mode 6"} <= set(active)
    assert {"force of 40in", "force of 20in"} <= set(active)
    assert "force of base" not in active


def test_price_of_damping_is_the_change_of_the_optimum(law, fe):
    # a multiplier is the relative change of gamma per relative change of its bound, and all bounds move together
    prices = sum(price for name, price in law.search.active.items() if name.startswith("damping"))
    more = mfdrf.design(fe, damping=0.03 * 1.01, starts=10)
    assert np.log(more.objective / law.objective) / np.log(1.01) == pytest.approx(prices, rel=0.03)


def test_the_same_seed_gives_the_same_bits(fe, law):
    assert mfdrf.design(fe).D.tobytes() == law.D.tobytes()


@pytest.mark.parametrize("seed", [1, 2])
def test_other_seeds_reach_the_same_optimum(fe, law, seed):
    assert mfdrf.design(fe, seed=seed).objective == pytest.approx(law.objective, rel=1e-4)


@pytest.mark.slow
def test_the_global_optimum_is_found_from_nearly_every_seed(fe, law):
    found = [mfdrf.design(fe, seed=seed).objective for seed in range(100, 120)]
    assert np.count_nonzero(np.array(found) < law.objective * (1 + 1e-3)) >= 19


def test_grid_needs_no_more_than_the_printed_gains():
    fe = build_reduced_model(load_structure("grid"), "exact")
    law = mfdrf.design(fe, modes=5)
    printed = published_table("grid", "11", "mfdrf").si("N s/m")
    # the printed D misses 3 % in mode 5 by up to 8 % on the reconstruction (grid.md); gamma is nearly proportional to it
    assert law.objective < 1.08 * performance.force_bounds(printed).max()
    assert law.zeta(5).min() >= 0.03 * (1 - 1e-5)


def test_a_mode_that_no_coil_moves_is_named():
    fe = oscillators([1.0, 2.0], [[1.0], [0.0]])
    with pytest.raises(BadDesign, match=r"mode 2 at 0\.3183 Hz cannot reach the damping ratio 0\.05"):
        mfdrf.design(fe, damping=0.05, modes=(0, 1))


def test_a_bound_beyond_reach_names_the_mode_and_what_it_can_reach():
    # A coil on one of two coupled masses locks it rather than damping the other beyond a limit
    fe = toy(np.eye(2), np.zeros((2, 2)), [[1.1, -0.1], [-0.1, 1.1]], [[1.0], [0.0]])
    with pytest.raises(BadDesign, match="highest ratio found") as refused:
        mfdrf.design(fe, damping=0.3, modes=2, starts=4)
    assert "no gain matrix gives modes 1, 2" in str(refused.value)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"damping": 1.2}, "between 0 and 1"),
        ({"modes": 99}, "99 modes cannot be bounded"),
        ({"modes": (0, 0)}, "distinct"),
        ({"modes": (0, 40)}, "from 1 to 19"),
        ({"starts": 0}, "0 starts"),
    ],
)
def test_what_cannot_be_asked_is_refused(fe, asked, words):
    with pytest.raises(BadDesign, match=words):
        mfdrf.design(fe, **asked)


def test_the_law_runs_and_goes_to_python_control(law):
    u = law.controller.step(np.array([0.1, 0.0, -0.2]))
    np.testing.assert_allclose(u, -law.D @ [0.1, 0.0, -0.2])
    np.testing.assert_allclose(law.to_control().D, -law.D)
