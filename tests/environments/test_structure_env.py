"""The environments follow the interface of Gymnasium, and their physics is that of the bench."""

import numpy as np
import pytest

from vlab.errors import BadExperiment

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed (pip install 'vlab-vibration[test]')")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from vlab.controllers import DirectRateFeedback  # noqa: E402
from vlab.environments import StructureEnv, register  # noqa: E402
from vlab.lab import Experiment, run_experiment  # noqa: E402
from vlab.lab.excitation import Release  # noqa: E402
from vlab.plants import build_plant  # noqa: E402
from vlab.structure import load_structure  # noqa: E402

GAIN = 5.0  # N s/m, at the base
FORCE = 0.2  # N


@pytest.fixture(scope="module")
def env() -> StructureEnv:
    return StructureEnv("beam", seconds=1.0, decisions_hz=2000.0, limit=1.0)


def played(env: StructureEnv, gain: float) -> tuple[np.ndarray, float, float]:
    """Return observations under rate feedback at the base, the sum of rewards, and the last energy share."""
    base = env.sensors.index("sensor:base"), env.actuators.index("coil:base")
    seen, info = env.reset(options={"forces": FORCE * (np.arange(len(env.actuators)) == base[1])})
    out, total, first = [seen], 0.0, info["energy"]
    over = False
    while not over:
        action = np.zeros(len(env.actuators))
        action[base[1]] = -gain * seen[base[0]]
        seen, reward, _, over, info = env.step(action)
        out.append(seen)
        total += reward
    return np.array(out[:-1]), total, info["energy"] / first


@pytest.mark.filterwarnings("ignore:.*Box observation space m:UserWarning")
def test_the_checker_of_gymnasium_accepts_the_environment():
    check_env(StructureEnv("beam", seconds=0.2), skip_render_check=True)


def test_registered_names_make_the_structures():
    register()
    made = gymnasium.make("vlab/Beam-v0", seconds=0.1)
    assert made.unwrapped.sensors == ("sensor:40in", "sensor:20in", "sensor:base")
    assert made.action_space.shape == (3,)
    _, info = made.reset(seed=1)
    _, again = made.reset(seed=1)
    assert np.array_equal(info["forces"], again["forces"])
    assert {"vlab/Beam-v0", "vlab/Grid-v0"} <= set(gymnasium.registry)


def test_an_agent_that_plays_a_law_moves_the_beam_as_the_experiment_with_that_law(env):
    beam = load_structure("beam")
    law = DirectRateFeedback([[GAIN]], sensors=["base"], actuators=["base"])
    done = run_experiment(
        Experiment(plant=build_plant(beam), seconds=1.0, controller=law, excitation=Release(level=FORCE), excite="base")
    )
    seen, _, _ = played(env, GAIN)
    expected = done.recording.select(list(env.sensors)).data
    assert np.abs(seen - expected).max() < 1e-9 * np.abs(expected).max()


def test_energy_only_falls_without_action_and_feedback_is_rewarded(env):
    _, idle, left = played(env, 0.0)
    _, damped, less = played(env, GAIN)
    assert left < 1.0
    assert less < 0.7 * left
    assert damped > idle


def test_impossible_settings_are_refused():
    with pytest.raises(BadExperiment, match="no whole part of the converter's 2000 Hz"):
        StructureEnv("beam", decisions_hz=300.0)
    with pytest.raises(BadExperiment, match="limit is -1; give a positive number"):
        StructureEnv("beam", limit=-1.0)
    fresh = StructureEnv("beam", seconds=0.1)
    with pytest.raises(BadExperiment, match=r"call reset\(\)"):
        fresh.step(np.zeros(3))
