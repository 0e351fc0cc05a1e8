"""The limit on recorded commands of a law in the loop, and laws with limits."""

import numpy as np
import pytest
from command import run

from vlab.cases import load_case
from vlab.diagnose.data.command_limit import Limited, find_limit, limited
from vlab.files.assets import asset


class Doubler:
    """A law without a limit of its own."""

    sensors, actuators = (0,), (0,)

    def __init__(self):
        self.past = 0

    def reset(self):
        self.past = 0

    def step(self, y):
        self.past += 1
        return 2.0 * np.asarray(y)


@pytest.fixture(scope="module")
def loop():
    case = load_case(asset("cases/avc_cantilever/closed_loop_identified_observer.toml"))
    plant, runs = case.plant, case.runs(("fit",))
    return plant, runs, find_limit(plant, runs)


def test_the_amplifiers_limit_is_read_off_the_recorded_commands(loop):
    _, runs, found = loop
    assert found is not None
    # Largest voltage in experiment.mat: 119 V, where the record is flat; the replay may be off by what its limits are apart.
    assert found.limit == pytest.approx(119.0, rel=0.02)
    largest = np.abs(runs[0].measured[next(c.channel for c in runs[0].compared if c.actuator is not None)]).max()
    assert found.limit * runs[0].law.per_actuator[0] == pytest.approx(largest, rel=0.02)
    assert found.is_known  # the observer is told the limited voltage
    assert found.actuator == "piezo"
    assert found.after < 0.5 * found.before


def test_a_run_with_the_limit_has_a_law_that_keeps_it(loop):
    plant, runs, found = loop
    changed = found.on(runs[0])
    law = changed.law.controller
    law.reset()
    assert np.abs(law.step(np.array([50.0]))).max() <= found.limit * (1 + 1e-12)
    assert runs[0].law.controller is not law
    assert find_limit(plant, [changed]) is None  # a law that has a limit needs none


def test_runs_without_a_law_have_no_limit():
    case = load_case(asset("cases/avc_cantilever/free_decay.toml"))
    assert find_limit(case.plant, case.runs(("fit",))) is None


def test_a_limit_behind_a_law_that_does_not_know_it():
    law = limited(Doubler(), 3.0, True)
    assert isinstance(law, Limited)  # it has no limit to be told of
    assert law.step(np.array([1.0])) == 2.0
    assert law.step(np.array([-7.0])) == -3.0
    law.reset()
    assert law.law.past == 0


CASE = """[model]
mjcf = "rig.xml"
[[{table}]]
{body}
"""
RIG = """<mujoco><worldbody><body name="cart"><joint name="rail" type="slide" axis="1 0 0" stiffness="40"/>
<geom size="0.1" mass="1"/></body></worldbody><sensor><jointpos name="laser" joint="rail"/></sensor></mujoco>"""
RECORDING = """file = "run.csv"
role = "{role}"
rate_hz = 100.0
[[recording.channel]]
column = "x"
at = "{at}"
kind = "displacement"
unit = "m"
"""


@pytest.mark.parametrize(
    ("table", "body", "words"),
    [
        ("recording", RECORDING.format(role="holdout", at="laser"), ("role", "fit")),
        ("recording", RECORDING.format(role="fit", at="lazer"), ("lazer", "laser")),
        ("modal", 'role = "holdout"\nfrequency_hz = [1.0]\nzeta = [0.01]', ("role", "fit")),
    ],
)
def test_a_case_that_cannot_be_diagnosed_is_refused_in_one_line(tmp_path, capsys, table, body, words):
    (tmp_path / "rig.xml").write_text(RIG)
    lines = "\n".join(f"{x:.6f}" for x in np.sin(0.06 * np.arange(300)))
    (tmp_path / "run.csv").write_text(f"x\n{lines}\n")
    (tmp_path / "case.toml").write_text(CASE.format(table=table, body=body))
    status, out, err = run(capsys, "diagnose", str(tmp_path))
    assert (status, out) == (2, "")
    assert len(err.strip().splitlines()) == 1
    assert "Traceback" not in err
    for word in words:
        assert word in err


def test_no_such_case_is_refused_in_one_line(tmp_path, capsys):
    status, out, err = run(capsys, "diagnose", str(tmp_path / "nowhere"))
    assert (status, out) == (2, "")
    assert len(err.strip().splitlines()) == 1
    assert "nowhere" in err


def test_the_limit_belongs_to_the_actuator_that_stands_at_it(tmp_path):
    """Two coils under one law, the second at its limit; the first one's commands stay small."""
    (tmp_path / "rig.xml").write_text(
        '<mujoco><option gravity="0 0 0"/><worldbody>'
        '<body name="a"><joint name="a" type="slide" axis="1 0 0" stiffness="9"/><geom size="0.1" mass="1"/></body>'
        '<body name="b" pos="1 0 0"><joint name="b" type="slide" axis="1 0 0" stiffness="4"/><geom size="0.1" mass="1"/></body>'
        '</worldbody><actuator><motor name="one" joint="a"/><motor name="two" joint="b"/></actuator>'
        '<sensor><jointvel name="va" joint="a"/><jointvel name="vb" joint="b"/></sensor></mujoco>'
    )
    t = np.arange(600) / 100
    va, vb = 0.1 * np.sin(3 * t), np.sin(2 * t)
    columns = np.column_stack([va, vb, -2 * va, np.clip(-2 * vb, -1.2, 1.2)])
    np.savetxt(tmp_path / "run.csv", columns, delimiter=",", header="va,vb,one,two", comments="")
    text = '[model]\nmjcf = "rig.xml"\n[[recording]]\nfile = "run.csv"\nrole = "fit"\nrate_hz = 100.0\n'
    for name in ("va", "vb"):
        text += f'[[recording.channel]]\ncolumn = "{name}"\nat = "{name}"\nkind = "velocity"\nunit = "m/s"\n'
    for name in ("one", "two"):
        text += f'[[recording.channel]]\ncolumn = "{name}"\nat = "{name}"\nkind = "command"\nunit = "N"\n'
    text += '[recording.controller]\nsensors = ["va", "vb"]\nactuators = ["one", "two"]\nrate_hz = 100.0\n'
    (tmp_path / "case.toml").write_text(text + "gains = [[2.0, 0.0], [0.0, 2.0]]\n")
    case = load_case(tmp_path)
    found = find_limit(case.plant, case.runs(("fit",)))
    assert found is not None
    assert found.actuator == "two"
    assert found.limit == pytest.approx(1.2, rel=0.01)
