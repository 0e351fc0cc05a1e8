"""A user's MJCF as a bench, against plain MuJoCo and closed forms."""

import json
import tomllib

import mujoco
import numpy as np
import pytest
from arm_logs import ARM
from command import run

from vlab.errors import VlabError
from vlab.lab.model_bench import SHARE, bench_plant
from vlab.lab.run_folder import RunSettings, load_run, perform, simulate_run
from vlab.lab.suited import LINES, suited

MOTORS = """<motor name="shoulder_motor" joint="shoulder_pan"/><motor name="elbow_motor" joint="elbow_flex"/>"""
SENSORS = """<sensor><jointpos name="elbow_angle" joint="elbow_flex"/><jointvel name="elbow_rate" joint="elbow_flex"/>
<accelerometer name="hand" site="hand"/></sensor>"""
SERVOS = ARM[ARM.index("<position") : ARM.index("</actuator>")]
ARM_ON_MOTORS = (
    ARM.replace(SERVOS, MOTORS)
    .replace("</actuator>", f"</actuator>{SENSORS}")
    .replace('size="0.015" mass="0.3"/>', 'size="0.015" mass="0.3"/><site name="hand" pos="0 0 -0.2"/>')
)
"""Two torque motors on hinges, with an angle, a rate and an accelerometer."""
MASS, DAMPING, STIFFNESS = 2.0, 1.2, 90.0  # kg, N s/m, N/m
CART = f"""<mujoco model="cart"><option timestep="0.001" gravity="0 0 0"/><worldbody><body name="cart">
<joint name="rail" type="slide" axis="1 0 0" stiffness="{STIFFNESS}" damping="{DAMPING}" range="-0.2 0.3"/>
<geom size="0.1" mass="{MASS}" contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor name="push" joint="rail" ctrlrange="-4 4"/></actuator></mujoco>"""
"""A mass on a spring and a dashpot, without sensors."""
LAW = """
class Damper:
    sensors, actuators = ("elbow_rate",), ("elbow_motor",)
    def reset(self): pass
    def step(self, y): return -0.05 * y
"""


@pytest.fixture
def arm(tmp_path) -> str:
    (tmp_path / "arm.xml").write_text(ARM_ON_MOTORS)
    return str(tmp_path / "arm.xml")


@pytest.fixture
def cart(tmp_path) -> str:
    (tmp_path / "cart.xml").write_text(CART)
    return str(tmp_path / "cart.xml")


def stepped(xml: str, commands: np.ndarray, *, gain: float = 0.0) -> np.ndarray:
    """Return angle, rate and acceleration of plain MuJoCo steps; a law adds ``-gain rate`` at the elbow."""
    model = mujoco.MjModel.from_xml_string(xml)
    data, out = mujoco.MjData(model), []
    mujoco.mj_forward(model, data)
    for command in commands:
        rate = data.qvel[1]
        data.ctrl[:] = command + np.array([0.0, -gain * rate])
        mujoco.mj_forward(model, data)
        out.append(data.sensordata.copy())
        mujoco.mj_step(model, data)
    return np.array(out)


def test_a_recording_holds_all_that_drives_the_model(arm):
    recording = simulate_run(RunSettings(structure=arm, seconds=2.0, seed=3).prepare()).recording
    commands = np.column_stack([recording["moment:shoulder_motor"], recording["moment:elbow_motor"]])
    assert np.abs(commands).min(axis=0).tolist() != [0.0, 0.0]
    assert abs(np.corrcoef(commands.T)[0, 1]) < 0.9  # a signal of its own for each
    own = stepped(ARM_ON_MOTORS, commands)
    names = ["elbow_angle", "elbow_rate", "hand.x", "hand.y", "hand.z"]
    np.testing.assert_allclose(np.column_stack([recording[n] for n in names]), own, rtol=0, atol=1e-9)


def test_a_law_of_the_user_acts_in_the_sample_that_it_reads(arm, tmp_path):
    (tmp_path / "law.py").write_text(LAW)
    settings = RunSettings(structure=arm, law=f"{tmp_path}/law.py:Damper", seconds=2.0)
    recording = simulate_run(settings.prepare()).recording
    added = np.column_stack([recording["excitation:shoulder_motor"], recording["excitation:elbow_motor"]])
    own = stepped(ARM_ON_MOTORS, added, gain=0.05)
    np.testing.assert_allclose(recording["elbow_rate"], own[:, 1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(recording["command:elbow_motor"], -0.05 * own[:, 1], rtol=0, atol=1e-9)


def test_a_released_mass_moves_as_the_closed_form(cart):
    settings = suited(RunSettings(structure=cart, excite="release")).settings
    recording = simulate_run(settings.prepare()).recording
    start = SHARE * 0.2  # of the way to the nearest limit
    omega, decay = np.sqrt(STIFFNESS / MASS), DAMPING / (2 * MASS)
    damped, t = np.sqrt(omega**2 - decay**2), recording.time
    x = start * np.exp(-decay * t) * (np.cos(damped * t) + decay / damped * np.sin(damped * t))
    # semi-implicit Euler shifts the position by half a step of its velocity, omega h / 2 = 0.3 % of the amplitude
    np.testing.assert_allclose(recording["joint:rail"], x, rtol=0, atol=0.01 * start)
    assert settings.seconds >= 3 / decay - 1


def test_levels_keep_joints_in_their_room_and_commands_in_their_range(cart):
    settings = suited(RunSettings(structure=cart)).settings
    run = simulate_run(settings.prepare())
    assert np.abs(run.recording["joint:rail"]).max() == pytest.approx(SHARE * 0.2, rel=0.25)  # with its transient
    assert np.abs(run.recording["force:push"]).max() <= 4.0
    signal = run.prepared.experiment.excitation.parts[0]
    assert signal.high_hz == pytest.approx(2 * np.sqrt(STIFFNESS / MASS) / (2 * np.pi), rel=0.05)  # two digits
    assert settings.seconds == 4 * settings.period_s
    assert settings.period_s * (signal.high_hz - signal.low_hz) >= LINES


@pytest.mark.parametrize(
    "excite", ["multisine", "pseudo-random", "burst-random", "sweep", "stepped-sine", "hammer", "dwell:hz=1"]
)
def test_every_excitation_drives_a_model(arm, excite):
    recording = simulate_run(RunSettings(structure=arm, excite=excite, seconds=3.0).prepare()).recording
    assert np.ptp(recording["elbow_angle"]) > 0.0
    assert np.abs(recording["moment:shoulder_motor"]).max() > 0.0


def test_a_run_folder_needs_no_file_outside(arm, tmp_path):
    (tmp_path / "part.xml").write_text("<mujocoinclude><size njmax='200'/></mujocoinclude>")
    text = ARM_ON_MOTORS.replace("<default>", '<include file="part.xml"/><default>', 1)
    (tmp_path / "arm.xml").write_text(text)
    settings, folder = RunSettings(structure=arm, seconds=0.5), tmp_path / "run"
    folder.mkdir()
    perform(settings.prepare(), folder)
    (tmp_path / "arm.xml").unlink()
    (tmp_path / "part.xml").unlink()
    recording, stored = load_run(folder)
    again = simulate_run(stored.inside(folder).prepare()).recording
    np.testing.assert_array_equal(again.data, recording.data)


def test_a_command_range_without_zero_is_driven_about_its_middle(tmp_path):
    path = tmp_path / "cart.xml"
    path.write_text(CART.replace('ctrlrange="-4 4"', 'ctrlrange="1 3"'))
    recording = simulate_run(RunSettings(structure=str(path), seconds=4.0).prepare()).recording
    force = recording["force:push"]
    assert 1.0 <= force.min() < 2.0 < force.max() <= 3.0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--law", "mfdrf"], "unknown law 'mfdrf'"),
        (["--plant", "fe"], "plant = 'fe' is for beam, grid and structure files"),
        (["--at", "elbow_moto"], "did you mean 'elbow_motor'?"),
        (["--effect", "coulomb-friction@joint:elbow:force=1"], "joint:elbow_flex"),
        (["--excite", "noise"], "unknown excitation 'noise'"),
        (["--rate", "300"], "a rate of 300 Hz"),
        (["--band", "1", "900"], "the band reaches 900 Hz"),
        (["--excite", "dwell:hz=1,forces=1/2"], "an excitation of 2 forces"),
        (["--power-up", "computers"], "power_up = 'computers'"),
    ],
)
def test_bad_input_is_one_line_with_its_name(capsys, arm, tmp_path, words, said):
    status, out, err = run(capsys, "experiment", arm, "--out", str(tmp_path / "run"), *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("xml", "said"),
    [
        (CART.replace('name="push"', ""), "no actuator with a name"),
        (
            CART.replace('name="rail"', "")
            .replace('joint="rail"', 'site="s"')
            .replace("<geom", '<site name="s"/><geom'),
            "no sensor",
        ),
        ("<mujoco>", "malformed XML"),
        (CART.replace("90.0", "nan"), "stiffness"),
    ],
)
def test_a_model_that_is_no_bench_is_refused(tmp_path, xml, said):
    (tmp_path / "m.xml").write_text(xml)
    with pytest.raises(VlabError, match=said):
        bench_plant(str(tmp_path / "m.xml"))
    with pytest.raises(VlabError, match="there is no model file"):
        bench_plant(str(tmp_path / "absent.xml"))


def test_a_free_mass_is_not_released(tmp_path):
    (tmp_path / "m.xml").write_text(CART.replace(f'stiffness="{STIFFNESS}"', ""))
    with pytest.raises(VlabError, match="no spring holds against 'push'"):
        RunSettings(structure=str(tmp_path / "m.xml"), excite="release").prepare()


def test_the_command_says_what_it_drives_and_writes(capsys, cart, tmp_path):
    status, out, err = run(
        capsys, "experiment", cart, "--seconds", "3", "--report", "--csv", "--out", str(tmp_path / "r")
    )
    assert (status, err) == (0, "")
    assert "excited: push" in out
    names = {path.name for path in (tmp_path / "r").iterdir()}
    assert names >= {
        "recording.parquet",
        "recording.csv",
        "run.toml",
        "manifest.json",
        "run.rrd",
        "report.html",
        "model",
    }
    assert tomllib.loads((tmp_path / "r" / "run.toml").read_text())["structure"] == cart
    status, out, _ = run(capsys, "init", cart, str(tmp_path / "r"), "--out", str(tmp_path / "case"), "--json")
    assert status == 0
    places = {channel["at"]: channel["input"] for channel in json.loads(out)["channels"]}
    assert places == {"push": True, "joint:rail": False}


def test_the_modes_of_a_model_are_found(capsys, cart, tmp_path):
    both = '<sensor><jointpos name="x" joint="rail"/><jointvel name="v" joint="rail"/></sensor></mujoco>'
    (tmp_path / "cart.xml").write_text(CART.replace("</mujoco>", both))  # one sensor has no MAC
    assert run(capsys, "experiment", cart, "--out", str(tmp_path / "r"))[0] == 0
    _, out, _ = run(capsys, "modal-test", str(tmp_path / "r"), "--against-plant", "--json")
    (mode,) = json.loads(out)["against_plant"]
    h = mujoco.MjModel.from_xml_path(
        cart
    ).opt.timestep  # the damper is implicit: (m + h c) z^2 - (2 m + h c - h^2 k) z + m
    z = np.roots([MASS + h * DAMPING, -(2 * MASS + h * DAMPING - h**2 * STIFFNESS), MASS])
    assert mode["hz"] == pytest.approx(abs(np.log(z[0])) / h / (2 * np.pi), rel=1e-9)
    assert mode["hz"] == pytest.approx(np.sqrt(STIFFNESS / MASS) / (2 * np.pi), rel=1e-3)
    assert mode["found_hz"] == pytest.approx(mode["hz"], rel=0.01)
    assert mode["found_zeta"] == pytest.approx(DAMPING / (2 * np.sqrt(STIFFNESS * MASS)), rel=0.1)


def test_an_effect_at_a_hinge_is_told_with_units_of_rotation(capsys, arm, tmp_path):
    effect = ["--effect", "coulomb-friction@joint:elbow_flex:force=0.05", "--seconds", "1"]
    status, out, err = run(capsys, "experiment", arm, *effect, "--out", str(tmp_path / "run"))
    assert status == 0, err
    assert "effect in the plant: coulomb-friction at joint:elbow_flex: force = 0.05 N m\n" in out


@pytest.mark.slow
def test_a_diagnosis_of_the_recordings_names_the_effect_in_the_bench(capsys, arm, tmp_path):
    runs = [str(tmp_path / name) for name in ("run1", "run2")]
    effect = ["--effect", "coulomb-friction@joint:elbow_flex:force=0.05", "--noise", "1e-4"]
    for seed, folder in enumerate(runs):
        assert run(capsys, "experiment", arm, *effect, "--seed", str(seed), "--out", folder)[0] == 0
    status, out, err = run(capsys, "diagnose", arm, *runs, "--out", str(tmp_path / "d"), "--json")
    assert status == 0, err
    (finding,) = json.loads(out)["findings"]
    assert (finding["effect"], finding["place"]) == ("coulomb-friction", "joint:elbow_flex")
    low, high = finding["parameters"]["force"]["ci90"]
    assert low <= 0.05 <= high
