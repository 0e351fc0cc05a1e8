"""Effects that a case's model states on commands and readings are present in every hypothesis."""

import numpy as np
import pytest
from rig_folder import Channel, Record, multisine, write_case
from scipy.integrate import solve_ivp

from vlab.cases.case import load_case
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.search.model_class import choose_model_class
from vlab.physics.catalogue import EFFECTS

CART = """<mujoco><option timestep="0.001" integrator="RK4" gravity="0 0 0"/><worldbody>
<body name="cart"><joint name="slide" type="slide" axis="1 0 0" stiffness="300" damping="2"/><geom size="0.1" mass="1"/></body>
</worldbody><actuator><motor name="motor" joint="slide"/></actuator>
<sensor><jointpos name="encoder" joint="slide"/></sensor></mujoco>"""
ARM = CART.replace('gravity="0 0 0"', 'gravity="0 0 -9.81"').replace(
    'type="slide" axis="1 0 0" stiffness="300" damping="2"/><geom size="0.1"',
    'type="hinge" axis="0 1 0" damping="0.3"/><geom size="0.05" pos="0 0 -0.3"',
)
RATE, SECONDS = 200.0, 8.0
DEAD, FRICTION, GAIN = 0.8, 0.6, 1.02
"""Dead zone of the drive [N], friction of the slide [N] and gain of the encoder."""
STATED = f"""
[[model.effect]]
name = "actuator-dead-zone"
place = "actuator:motor"
parameters = {{ threshold = {DEAD} }}

[[model.effect]]
name = "sensor-gain"
place = "sensor:encoder"
parameters = {{ gain = {GAIN - 1:g} }}
"""

CROSSTALK = """
[[model.effect]]
name = "crosstalk"
place = "sensor:encoder/motor"
parameters = { share = 0.001 }

"""


def moved(push, friction, swings):
    """Integrate the rig by a method of order 8; the friction is smooth over 1 mm/s."""
    t = np.arange(round(RATE * SECONDS)) / RATE

    def slope(time, x):
        u = push(time)
        force = np.sign(u) * max(abs(u) - DEAD, 0.0) - friction * np.tanh(x[1] / 1e-3)
        if swings:
            return [x[1], (force - 0.3 * x[1] - 9.81 * 0.3 * np.sin(x[0])) / (0.3**2 + 0.4 * 0.05**2)]
        return [x[1], force - 2.0 * x[1] - 300.0 * x[0]]

    return t, solve_ivp(slope, (0, SECONDS), [0.0, 0.0], method="DOP853", t_eval=t, max_step=0.005).y[0]


def case_of(folder, *, friction=0.0, stated=STATED, swings=False):
    rng, records = np.random.default_rng(5), []
    for name, role, level in (("a", "fit", 1.2), ("b", "fit", 2.0), ("c", "holdout", 1.6)):
        push = multisine(rng, 0.4, 5.0, SECONDS, 1.5 * level)
        t, x = moved(push, friction, swings)
        x = GAIN * x + 3e-5 * rng.standard_normal(len(x))
        records.append(Record(name=name, role=role, columns={"u": push(t), "x": x}, rate_hz=RATE))
    unit = ("N m", "rad", "torque", "angle") if swings else ("N", "m", "force", "displacement")
    channels = [
        Channel(column="u", at="motor", kind=unit[2], unit=unit[0], is_input=True, hold="linear"),
        Channel(column="x", at="encoder", kind=unit[3], unit=unit[1]),
    ]
    uncertain = {"stiffness": 0.02, "damping": 0.2, "mass": 0.02, "gain": 0.02}
    write_case(folder, title="", mjcf=ARM if swings else CART, uncertain=uncertain, channels=channels, records=records)
    path = folder / "case.toml"
    text = path.read_text()
    at = text.index("[[recording]]")
    path.write_text(text[:at] + stated + "\n" + text[at:])
    return load_case(path)


def terms_of(problem):
    places = {place.name: place for place in problem.places}
    return [
        Term(effect=EFFECTS["actuator-dead-zone"], place=places["actuator:motor"], values={"threshold": DEAD}),
        Term(effect=EFFECTS["sensor-gain"], place=places["sensor:encoder"], values={"gain": GAIN - 1}),
    ]


@pytest.mark.parametrize("swings", [False, True])
def test_a_stated_effect_is_that_effect_as_a_term(tmp_path, swings):
    def residual(stated):
        folder = tmp_path / ("stated" if stated else "plain")
        screen = choose_model_class(case_of(folder, stated=stated, swings=swings)).screen
        whole = TrajectoryLeastSquares(screen, whole=True) if swings else LeastSquares(screen)
        terms = [] if stated else terms_of(screen.problem)
        assert len(screen.problem.known) == 2 - len(terms)
        values = [{name: np.array([value]) for name, value in term.values.items()} for term in terms]
        starts = np.array([run.start for run in whole.runs]) if swings else np.zeros((len(whole.runs), 2))
        return whole.simulate(list(whole.runs), terms, np.zeros((1, len(screen.theta))), values, starts[None])

    stated, plain = residual(STATED), residual("")
    assert np.std(stated) > 0
    if not swings:  # the motion about which the arm is linearised follows from the commands
        assert stated == pytest.approx(plain, rel=0, abs=1e-9 * np.std(plain))


def test_a_stated_effect_reaches_a_channel_of_any_name(tmp_path):
    case_of(tmp_path, stated="")
    path = tmp_path / "case.toml"
    text = path.read_text().replace('at = "encoder"', 'at = "encoder"\nname = "tip"')
    at = text.index("[[recording]]")
    path.write_text(text[:at] + STATED + CROSSTALK + text[at:])
    known = choose_model_class(load_case(path)).screen.problem.known
    places = [(t.effect.name, t.place.kind, t.place.index, t.place.other, t.place.tag) for t in known]
    assert places == [
        ("actuator-dead-zone", "actuator", 0, -1, ""),
        ("sensor-gain", "sensor", 0, -1, ""),
        ("crosstalk", "pick-up", 0, 0, "command"),
    ]


SMOOTH = f"""
[[model.effect]]
name = "smooth-friction"
place = "joint:slide"
parameters = {{ force = {0.5 * FRICTION}, rise = 0.001 }}
"""


def test_a_stated_port_law_is_a_term_along_a_motion(tmp_path):
    screen = choose_model_class(case_of(tmp_path, stated=STATED + SMOOTH, swings=True)).screen
    *_, law = screen.problem.known
    assert (law.label, dict(law.values)) == ("smooth-friction@joint:slide", {"force": 0.5 * FRICTION, "rise": 0.001})
    assert not any("tangent at rest" in note for note in screen.problem.notes)


@pytest.mark.slow
def test_nothing_is_missing_beside_a_stated_friction_without_element_of_mujoco(tmp_path):
    """The answer of a diagnosis may be stated as it is, and diagnosed further."""
    case = case_of(tmp_path, stated=STATED + SMOOTH, friction=0.5 * FRICTION, swings=True)
    assert diagnose(case).diagnosis.verdict == "nothing-missing"


@pytest.mark.slow
@pytest.mark.parametrize("swings", [False, True])
def test_what_is_missing_beside_a_stated_effect_is_found(tmp_path, swings):
    friction = 0.5 * FRICTION if swings else FRICTION
    found = diagnose(case_of(tmp_path / "friction", friction=friction, swings=swings)).diagnosis
    assert [(f.effect, f.place) for f in found.findings] == [("coulomb-friction", "joint:slide")]
    assert found.findings[0].parameters["force"]["value"] == pytest.approx(friction, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("swings", [False, True])
def test_a_stated_effect_is_not_found_again(tmp_path, swings):
    assert diagnose(case_of(tmp_path, swings=swings)).diagnosis.verdict == "nothing-missing"
