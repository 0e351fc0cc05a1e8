"""A force that repeats with the position is found, with its pitch; the recordings come from a method of order 8."""

import json

import numpy as np
import pytest
from command import run
from rig_folder import Channel, Record, multisine, write_case
from scipy.integrate import solve_ivp

from vlab.diagnose.inference.trial_scan import Scales, scan_values
from vlab.physics.catalogue import EFFECTS

RIG = """<mujoco><option timestep="0.00025" integrator="implicitfast" gravity="0 0 0"/><worldbody>
<body name="cart"><joint name="slide" type="slide" axis="1 0 0" damping="{c}"/><geom size="0.1" mass="{m}"/></body>
</worldbody><actuator><position name="servo" joint="slide" kp="{kp}" kv="{kv}"/></actuator>
<sensor><jointpos name="encoder" joint="slide"/></sensor></mujoco>"""
M, C, KP, KV = 1.0, 2.0, 300.0, 8.0
FORCE, PITCH = 1.2, 0.03
RATE, SECONDS = 200.0, 6.0


def moved(command, force):
    """Integrate the cart on its servo."""
    t = np.arange(round(RATE * SECONDS)) / RATE

    def slope(time, x):
        servo = KP * (command(time) - x[0]) - KV * x[1]
        return [x[1], (servo - C * x[1] - force * np.sin(2 * np.pi * x[0] / PITCH)) / M]

    return t, solve_ivp(slope, (0, SECONDS), [0.0, 0.0], method="DOP853", t_eval=t, rtol=1e-9, atol=1e-12).y[0]


def test_trial_pitches_shift_the_force_by_an_eighth_of_a_period_at_most():
    (pitch,) = (p for p in EFFECTS["cogging"].parameters if p.scan == "pitch")
    values = scan_values(pitch, Scales(step=1e-3, duration=1.0, highest_hz=10.0, travel=0.2))
    assert np.all(np.diff(values) > 0)
    assert values[-1] == pytest.approx(0.2 * pitch.high)
    assert values[0] < 1.02 * 0.2 * pitch.low
    for true in np.linspace(0.04, 0.25, 300) * 0.2:
        # the phase is free, so the middle of the travel from -0.2 to 0.2 m agrees
        assert np.min(np.abs(0.2 / values - 0.2 / true)) <= 0.1251


@pytest.mark.slow
@pytest.mark.parametrize("force", [FORCE, 0.0])
def test_cogging_of_a_servo_is_found_with_its_pitch(force, capsys, tmp_path):
    rng, records = np.random.default_rng(3), []
    for name, role, level in (("a", "fit", 0.03), ("b", "fit", 0.06), ("c", "fit", 0.1), ("d", "holdout", 0.07)):
        command = multisine(rng, 0.3, 2.5, SECONDS, level)
        t, x = moved(command, force)
        x = x + 2e-5 * rng.standard_normal(len(x))
        records.append(Record(name=name, role=role, columns={"u": command(t), "x": x}, rate_hz=RATE))
    channels = [
        Channel(column="u", at="servo", kind="command", unit="m", is_input=True, hold="linear"),
        Channel(column="x", at="encoder", kind="displacement", unit="m"),
    ]
    mjcf, uncertain = RIG.format(kp=KP, kv=KV, c=C, m=M), {"damping": 0.2, "mass": 0.02, "gain": 0.02}
    case, out = tmp_path / "case", tmp_path / "out"
    case.mkdir()
    write_case(case, title="", mjcf=mjcf, uncertain=uncertain, channels=channels, records=records)
    status, text, _ = run(capsys, "diagnose", str(case), "--effect", "cogging", "--json", "--out", str(out))
    assert status == 0
    found = json.loads(text)
    if force == 0.0:
        assert found["verdict"] == "nothing-missing"
        return
    assert [(f["effect"], f["place"]) for f in found["findings"]] == [("cogging", "joint:slide")]
    parameters = found["findings"][0]["parameters"]
    assert parameters["pitch"]["value"] == pytest.approx(PITCH, rel=0.01)
    size = np.hypot(parameters["sine"]["value"], parameters["cosine"]["value"])
    assert size == pytest.approx(FORCE, rel=0.05)  # the servo's gains are 2 % uncertain
    assert found["heldout"]["gap_closed"] > 0.9
