"""A pendulum whose drawing is wrong: the search with unknown geometry, against an integration of the equation of motion."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import vlab
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.search.model_class import choose_model_class
from vlab.diagnose.search.unknown_geometry import UNKNOWN_GEOMETRY, with_unknown_geometry
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


def swing(angle, seed):
    """Return noisy angles of the real pendulum, released at rest."""
    inertia = MASS * REAL**2 + 0.4 * MASS * RADIUS**2

    def slope(_, x):
        return [x[1], -(MASS * 9.81 * REAL * np.sin(x[0]) + DRAG * x[1] * abs(x[1])) / inertia]

    motion = solve_ivp(slope, (0.0, TIMES[-1]), [angle, 0.0], t_eval=TIMES, rtol=1e-10, atol=1e-12).y[0]
    return motion + 3e-4 * np.random.default_rng(seed).standard_normal(len(TIMES))


def recorded(uncertain=None):
    runs = [{"encoder": swing(angle, seed)} for seed, angle in enumerate((1.2, 0.9, 1.0))]
    return vlab.Case.from_arrays(
        PENDULUM, [TIMES] * 3, None, runs, uncertain=uncertain, holdout=[2], initial="estimated"
    )


def reopened(case):
    """Return the case that a search without effects leaves open."""
    model_class = choose_model_class(case, [EFFECTS["quadratic-drag"]])
    found = model_class.search([EFFECTS["quadratic-drag"]], lambda share, what: None)
    return with_unknown_geometry(model_class, found, case)


@pytest.mark.slow
def test_recordings_that_contradict_a_drawing_open_the_geometry():
    assert reopened(recorded()).table.model.uncertain == GEOMETRY.unknown


@pytest.mark.slow
def test_a_stated_geometry_is_believed():
    assert reopened(recorded({"inertia": 0.03, "length": 0.003})) is None


@pytest.mark.slow
def test_drag_of_a_pendulum_shorter_than_drawn_is_named():
    seen = []
    answer = diagnose(recorded(), progress=lambda share, what: seen.append((share, what))).diagnosis
    assert [f.effect for f in answer.findings] == ["quadratic-drag"]
    assert answer.findings[0].parameters["coefficient"]["value"] == pytest.approx(DRAG, rel=0.1)
    assert any(UNKNOWN_GEOMETRY in note for note in answer.notes)
    assert [share for share, what in seen if what == "reading"] == [0.0, 0.5]  # two passes, half of the bar each
