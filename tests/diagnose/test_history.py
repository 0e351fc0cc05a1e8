"""Parts of a recording that begin in motion, under laws that remember what came before."""

from dataclasses import replace

import numpy as np
import pytest
from rig_folder import Channel, Record, write_case

from vlab.cases import load_case
from vlab.cases.history import from_file_start, remembers
from vlab.cases.simulate import simulate
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import EFFECTS

MODEL = """<mujoco><option timestep="0.001" gravity="0 0 0" integrator="implicitfast"/><worldbody><body>
  <inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
  <joint name="slide" type="slide" axis="1 0 0" stiffness="320" damping="0.2"/>
  <geom size="0.01" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><motor name="coil" joint="slide"/></actuator></mujoco>"""
OSCILLATOR = {"mass": 0.2, "frequency": 1.9, "damping_ratio": 0.02}
RATE, SECONDS = 100.0, 12.0


def release(law, start=0.01):
    """Positions of the mass with its oscillator after a static displacement of both, in closed form."""
    m, k = law["mass"], law["mass"] * (2 * np.pi * law["frequency"]) ** 2
    c = 2.0 * law["damping_ratio"] * np.sqrt(k * m)
    A = np.array(
        [
            [0, 0, 1, 0],
            [0, 0, 0, 1],
            [-(320 + k) / 2, k / 2, -(0.2 + c) / 2, c / 2],
            [k / m, -k / m, c / m, -c / m],
        ]
    )
    values, vectors = np.linalg.eig(A)
    at_start = np.linalg.solve(vectors, np.array([start, start, 0.0, 0.0], dtype=complex))
    time = np.arange(int(RATE * SECONDS)) / RATE
    return np.real(vectors[0] @ (at_start[:, None] * np.exp(values[:, None] * time)))


@pytest.fixture
def parts(tmp_path):
    """Plant with the oscillator, and the run from the sixth second on, with the samples before it."""
    q = release(OSCILLATOR)
    write_case(
        tmp_path,
        title="tuned mass",
        mjcf=MODEL,
        uncertain={},
        channels=[
            Channel(column="u", at="coil", kind="command", unit="N", is_input=True),
            Channel(column="q", at="joint:slide", kind="displacement", unit="m"),
        ],
        records=[Record(name="one", role="fit", columns={"u": 0 * q, "q": q}, rate_hz=RATE, initial="auto")],
    )
    case = load_case(tmp_path / "case.toml")
    (run,) = case.runs()
    law = Attached(effect=EFFECTS["attached-oscillator"], place="joint:slide", values=OSCILLATOR)
    split, measured = int(6 * RATE), run.measured
    later = replace(run, measured=measured.rows(slice(split, None)), before=measured.rows(slice(split)))
    return attach(case.plant, [law]), case.plant, later


def error(plant, run):
    name = run.compared[0].channel
    return np.std(simulate(plant, run).recording[name] - run.measured[name]) / np.std(run.measured[name])


def test_an_oscillator_swings_at_the_start_of_a_later_part(parts):
    plant, bare, later = parts
    assert remembers(plant)
    assert not remembers(bare)
    assert error(plant, later) < 0.05
    assert error(plant, replace(later, before=None)) > 0.2  # nothing tells what the oscillator does


def test_only_what_stands_before_a_run_is_taken(parts):
    _, _, later = parts
    whole = from_file_start(later)
    assert whole is not None
    assert len(whole.measured) == len(later.measured) + len(later.before)
    assert np.array_equal(whole.measured.time[-len(later.measured) :], later.measured.time)
    assert from_file_start(replace(later, before=None)) is None
