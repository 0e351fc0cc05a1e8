"""An effect of a user's own, in their own file, is sought, named, placed and sized beside those of the catalogue."""

import json

import numpy as np
import pytest
from command import run
from rig_folder import Channel, Record, multisine, write_case
from scipy.integrate import solve_ivp

from vlab.api.diagnosis import candidate_effects
from vlab.files.assets import asset

RIG = """<mujoco><option timestep="0.001" integrator="RK4" gravity="0 0 0"/><worldbody>
<body name="cart"><joint name="slide" type="slide" axis="1 0 0" stiffness="{k}" damping="{c}"/><geom size="0.1" mass="{m}"/></body>
</worldbody><actuator><motor name="motor" joint="slide"/></actuator>
<sensor><jointpos name="encoder" joint="slide"/></sensor></mujoco>"""
M, C, K, FORCE, SPEED = 1.0, 2.0, 300.0, 1.5, 0.8
RATE, SECONDS = 200.0, 8.0
OWN = f"{asset('examples/magnetic_brake.py')}:MagneticBrake"


def moved(push):
    """Integrate the cart with its brake by a method of order 8."""
    t = np.arange(round(RATE * SECONDS)) / RATE

    def slope(time, x):
        brake = 2 * FORCE * (x[1] / SPEED) / (1 + (x[1] / SPEED) ** 2)
        return [x[1], (push(time) - K * x[0] - C * x[1] - brake) / M]

    return t, solve_ivp(slope, (0, SECONDS), [0.0, 0.0], method="DOP853", t_eval=t, rtol=1e-9, atol=1e-12).y[0]


def test_an_effect_of_ones_own_is_listed(capsys):
    status, text, _ = run(capsys, "effects", OWN, "--json")
    assert status == 0
    (entry,) = json.loads(text)
    assert entry["name"] == "magnetic-brake"
    assert [p["name"] for p in entry["parameters"]] == ["force", "speed"]


def test_an_effect_of_ones_own_needs_a_name_of_its_own(capsys):
    status, _, err = run(capsys, "diagnose", str(asset("cases/emps/case.toml")), "--effect", "coulomb-friction")
    assert status == 2
    assert "another effect named 'coulomb-friction'" in err


def test_a_search_may_be_restricted_to_an_effect_of_ones_own():
    assert [e.name for e in candidate_effects([OWN], only=["magnetic-brake"])] == ["magnetic-brake"]
    assert [e.name for e in candidate_effects([OWN], only=["stop"])] == ["stop", "magnetic-brake"]


@pytest.mark.slow
def test_an_effect_of_ones_own_is_found(capsys, tmp_path):
    rng, records = np.random.default_rng(3), []
    for name, role, level in (("a", "fit", 3.0), ("b", "fit", 6.0), ("c", "fit", 10.0), ("d", "holdout", 7.0)):
        push = multisine(rng, 0.4, 5.0, SECONDS, level)
        t, x = moved(push)
        x = x + 2e-5 * rng.standard_normal(len(x))
        records.append(Record(name=name, role=role, columns={"u": push(t), "x": x}, rate_hz=RATE))
    channels = [
        Channel(column="u", at="motor", kind="force", unit="N", is_input=True, hold="linear"),
        Channel(column="x", at="encoder", kind="displacement", unit="m"),
    ]
    mjcf, uncertain = RIG.format(k=K, c=C, m=M), {"stiffness": 0.02, "damping": 0.2, "mass": 0.02, "gain": 0.02}
    case, out = tmp_path / "case", tmp_path / "out"
    case.mkdir()
    write_case(case, title="", mjcf=mjcf, uncertain=uncertain, channels=channels, records=records)
    status, text, _ = run(capsys, "diagnose", str(case), "--effect", OWN, "--json", "--out", str(out))
    assert status == 0
    found = json.loads(text)
    assert found["verdict"] == "missing-physics"
    assert found["findings"][0]["effect"] == "magnetic-brake"
    assert found["findings"][0]["place"] == "joint:slide"
    parameters = found["findings"][0]["parameters"]
    assert parameters["speed"]["value"] == pytest.approx(SPEED, rel=0.1)
    assert parameters["force"]["value"] == pytest.approx(FORCE, rel=0.05)  # the motor's gain is 2 % uncertain
    assert found["heldout"]["gap_closed"] > 0.9
    assert "magnetic-brake is an effect of your own" in (out / "report.html").read_text()
