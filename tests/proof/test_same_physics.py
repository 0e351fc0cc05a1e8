"""What the generator hides under a name of the catalogue is what the catalogue means by it: signs, units, conventions.

Two implementations that share no line, one in MuJoCo, answer the same commands with and without an effect of the same
parameters at the same place. What differs is measured in what the effect itself changes.
"""

from dataclasses import replace

import numpy as np
import pytest

from vlab.cases import load_case, simulate
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import EFFECTS
from vlab.proof.case_folder import write_case
from vlab.proof.generator.concealed import Concealed
from vlab.proof.generator.excite import excite
from vlab.proof.generator.hardware import Output
from vlab.proof.generator.hidden import Hidden
from vlab.proof.generator.library import LIBRARY
from vlab.proof.generator.plan import Plan, Recording
from vlab.proof.generator.rigs import shaft, slider
from vlab.proof.generator.simulate import Setup, scale_at

RATE, SECONDS, BAND = 500.0, 3.0, (0.8, 24.0)
FINER = {"slew-limit": 32}
"""How many times finer the generator's commands are: here the force ramps, there the commands do, which are then held."""
OWN = [kind for kind in LIBRARY if kind.same]


def compared(kind, folder):
    """Return what an effect changes in the generator and in MuJoCo, (n, n_sensors) each, channels over their rms without it."""
    blueprint = shaft() if kind.angular or kind.on == "coil" else slider()
    bench = blueprint.build({}, {})
    actuator, size = blueprint.exciters[0], 5.0 * (0.1 if blueprint.name == "shaft" else 1.0)
    sensors = list(bench.sensors)
    places = {"actuator": f"actuator:{actuator}", "sensor": f"sensor:{sensors[0]}", "coil": "joint:rotor"}
    places |= {
        "sensor and coil": f"sensor:{sensors[1]}/coil:{actuator}",
        "two sensors": f"sensor:{sensors[0]}/{sensors[1]}",
    }
    place = "joint:rotor" if kind.angular else places.get(kind.on, "joint:drive")
    time = np.arange(round(RATE * SECONDS)) / RATE
    u = np.zeros((len(time), len(bench.actuators), 1))
    u[:, 0, 0] = size * excite("multisine", np.random.default_rng(1), time, BAND)
    setup = Setup(bench=bench, output=Output(), rate_hz=RATE, substeps=8)
    null = setup.run(u, ())
    scale = scale_at(setup, u[:, :, 0], place, null[:, :, 0], BAND)
    shapes = kind.draw(np.random.default_rng(2))
    hidden = Hidden(kind=kind, place=place, shapes=shapes, scale=scale, size=min(max(0.1, kind.start), kind.most))
    fine = FINER.get(kind.name, 1)
    finer, commands = replace(setup, rate_hz=fine * RATE, substeps=max(1, 8 // fine)), np.repeat(u, fine, axis=0)
    changed = (finer.read(finer.sensed(commands, [hidden]), [hidden]) - finer.run(commands, ()))[::fine]

    names = tuple((name, s.kind, s.unit) for name, s in bench.sensors.items())
    one = Recording(signal="multisine", level=1.0, actuator=actuator, role="fit")
    case = Concealed(
        blueprint=blueprint, plan=Plan(recordings=(one,), commands=u), sensors=names, outputs=null, law=None, truth={}
    )
    write_case(case, folder)
    loaded = load_case(folder)
    (run,) = loaded.runs()
    values = {k: float(v) for k, v in hidden.parameters.items()}
    plant = attach(loaded.plant, [Attached(effect=EFFECTS[kind.name], place=place, values=values)], channels=sensors)
    ours = [simulate(p, run).recording.select(sensors).data for p in (loaded.plant, plant)]
    rms = null[:, :, 0].std(axis=0)
    return changed[:, :, 0] / rms, (ours[1] - ours[0]) / rms


APART = {"crosstalk": 0.25}
"""Shares of the effect where the sides differ in time: here a sample is read just before its command comes out, there just after."""


@pytest.mark.parametrize("kind", OWN, ids=lambda k: k.name)
def test_a_name_means_the_same_on_both_sides(kind, tmp_path):
    theirs, ours = compared(kind, tmp_path / "case")
    if kind.name == "actuator-jitter":  # draws of two generators: only the size is the same
        assert np.sqrt(np.mean(ours**2) / np.mean(theirs**2)) == pytest.approx(1.0, abs=0.5)
        return
    # dry friction turns round within a step of a hundredth of the shortest period: 3 % of what it changes
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < APART.get(kind.name, 0.05) * np.sqrt(np.mean(theirs**2))
