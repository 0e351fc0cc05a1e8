"""A pendulum whose drawing is wrong: the search with unknown geometry, against an integration of the equation of motion."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_honest_gap import distance, finding

import vlab
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.search.model_class import choose_model_class
from vlab.diagnose.search.unknown_geometry import (
    is_better_with_geometry,
    is_geometry_contradicted,
    may_be_simpler,
    unknown_geometry_note,
    unstated_geometry,
)
from vlab.diagnose.settings import GEOMETRY
from vlab.physics.catalogue import EFFECTS

MASS, RADIUS = 0.2, 0.02
DRAWN, REAL = 0.30, 0.27
DRAG = 4e-4
TIMES = 0.005 * np.arange(1200)
PENDULUM = f"""
<mujoco>
  <option timestep="0.001" integrator="RK4"/>
  <worldbody>
    <body name="bob">
      <joint name="pivot" type="hinge" axis="0 1 0"/>
      <geom type="sphere" size="{RADIUS}" mass="{MASS}" pos="0 0 -{DRAWN}"/>
    </body>
  </worldbody>
  <sensor><jointpos name="encoder" joint="pivot"/></sensor>
</mujoco>
"""


def swing(angle, seed, length):
    """Return noisy angles of the real pendulum, released at rest."""
    inertia = MASS * length**2 + 0.4 * MASS * RADIUS**2

    def slope(_, x):
        return [x[1], -(MASS * 9.81 * length * np.sin(x[0]) + DRAG * x[1] * abs(x[1])) / inertia]

    motion = solve_ivp(slope, (0.0, TIMES[-1]), [angle, 0.0], t_eval=TIMES, rtol=1e-10, atol=1e-12).y[0]
    return motion + 3e-4 * np.random.default_rng(seed).standard_normal(len(TIMES))


def recorded(uncertain=None, real=REAL):
    runs = [{"encoder": swing(angle, seed, real)} for seed, angle in enumerate((1.2, 0.9, 1.0))]
    return vlab.Case.from_arrays(
        PENDULUM, [TIMES] * 3, None, runs, uncertain=uncertain, holdout=[2], initial="estimated"
    )


def contradicted(case):
    """Return the kinds that a case does not state, and whether recordings contradict them."""
    model_class = choose_model_class(case, [EFFECTS["quadratic-drag"]])
    found = model_class.search([EFFECTS["quadratic-drag"]], lambda share, what: None)
    kinds = unstated_geometry(model_class.problem, case)
    return kinds, is_geometry_contradicted(model_class, found, kinds)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stated", "kinds", "is_open"),
    [
        ({}, {"inertia", "length"}, True),
        ({"body:bob:inertia": 0.03}, {"length"}, True),
        ({"inertia": 0.03, "length": 0.003}, set(), False),
    ],
)
def test_recordings_that_contradict_a_drawing_open_unstated_kinds(stated, kinds, is_open):
    found, is_contradicted = contradicted(recorded(stated))
    assert set(found) == kinds
    assert all(found[kind] == GEOMETRY.unknown[kind] for kind in kinds)
    assert is_contradicted is is_open


def judged(verdict, findings, after):
    return SimpleNamespace(verdict=verdict, tried=SimpleNamespace(findings=findings, checked=(distance(after=after),)))


def answered(verdict, findings, after):
    return SimpleNamespace(verdict=verdict, findings=findings, checked=(distance(after=after),))


def test_the_fewer_parameters_of_two_complete_answers_stand():
    slip, drag = finding("iwan-slip", force=1.0, limit=1.0, exponent=1.0), finding("quadratic-drag", coefficient=1.0)
    ours = judged("missing-physics", (slip, drag), 0.02)
    assert is_better_with_geometry(answered("missing-physics", (drag,), 0.02), ours, 2)  # 1 + 2 of 4
    assert not is_better_with_geometry(answered("missing-physics", (slip,), 0.02), ours, 2)
    assert not is_better_with_geometry(answered("missing-physics", (drag,), 0.03), ours, 2)  # predicts worse
    assert not is_better_with_geometry(answered("none-of-these", (), 0.02), ours, 2)


def test_a_law_in_many_places_has_the_parameters_of_all():
    rubs = [finding("coulomb-friction", place=f"joint:{name}", force=1.0) for name in "abcd"]
    merged = replace(rubs[0], elsewhere=tuple((f.place, f.parameters) for f in rubs[1:]))
    ours = judged("missing-physics", tuple(rubs), 0.02)
    assert not is_better_with_geometry(answered("missing-physics", (merged,), 0.02), ours, 2)


def test_a_partial_answer_is_replaced_by_a_better_prediction_alone():
    drag = finding("quadratic-drag", coefficient=1.0)
    ours = judged("partly-explained", (drag,), 0.1)
    assert is_better_with_geometry(answered("partly-explained", (drag,), 0.05), ours, 2)
    assert not is_better_with_geometry(answered("partly-explained", (drag,), 0.2), ours, 2)
    assert not is_better_with_geometry(answered("none-of-these", (), 0.05), ours, 2)
    nothing = judged("none-of-these", (), 0.1)
    assert is_better_with_geometry(answered("none-of-these", (), 0.05), nothing, 2)
    assert not is_better_with_geometry(answered("bad-recording", (), 0.05), nothing, 2)


def test_a_complete_answer_of_few_parameters_is_not_searched_again():
    drag = finding("quadratic-drag", coefficient=1.0)
    assert not may_be_simpler(judged("missing-physics", (drag,), 0.02), 2)
    assert not may_be_simpler(judged("nothing-missing", (), 0.02), 2)
    assert may_be_simpler(judged("partly-explained", (drag,), 0.02), 2)


@pytest.mark.slow
def test_drag_of_a_pendulum_shorter_than_drawn_is_named():
    seen = []
    answer = diagnose(recorded(), progress=lambda share, what: seen.append((share, what))).diagnosis
    assert [f.effect for f in answer.findings] == ["quadratic-drag"]
    assert answer.findings[0].parameters["coefficient"]["value"] == pytest.approx(DRAG, rel=0.1)
    assert unknown_geometry_note(["inertia", "length"]) in answer.notes
    assert [share for share, what in seen if what == "reading"] == [0.0, 0.5]  # two passes, half of the bar each


@pytest.mark.slow
def test_a_right_drawing_is_kept_beside_missing_drag():
    answer = diagnose(recorded(real=DRAWN)).diagnosis
    assert [f.effect for f in answer.findings] == ["quadratic-drag"]
    assert answer.findings[0].parameters["coefficient"]["value"] == pytest.approx(DRAG, rel=0.1)
    assert unknown_geometry_note(["inertia", "length"]) not in answer.notes
