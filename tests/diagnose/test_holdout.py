"""Cases that are stated badly or unevenly: hold-outs without a channel, silence, short records, names that mean nothing."""

import mujoco
import numpy as np
import pytest
from rig_folder import Channel, Record, write_case
from test_reduced_model_inputs import MOTOR, RIG

from vlab.cases import load_case
from vlab.diagnose.data.noise import estimate_noise
from vlab.diagnose.data.runs import liveliest
from vlab.diagnose.parameters.holdout import read_holdout
from vlab.diagnose.parameters.mjcf import uncertain_parameters
from vlab.diagnose.parameters.recorded_runs import read_runs
from vlab.diagnose.parameters.static_offset import remove_static_offsets
from vlab.diagnose.parameters.unused_entries import unused
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.search.model_class import choose_model_class
from vlab.diagnose.validation.simulation import ExtendedModel, check
from vlab.errors import BadCase, BadStructure, UnknownName
from vlab.physics.catalogue import EFFECTS
from vlab.plants.linearise import linearise

TIME = np.arange(1000) / 500
SWEEP = np.sin(2 * np.pi * (1 + 4 * TIME) * TIME)


def write(folder, files, *, model="", uncertain="", rig=RIG):
    """Write a case: files are (role, column names, data); columns are named for the model's elements."""
    (folder / "rig.xml").write_text(rig.format(actuator=MOTOR, step=0.0005, integrator="RK4"))
    text = f'[model]\nmjcf = "rig.xml"\n{model}\n'
    text += f"[model.uncertain]\n{uncertain}\n" if uncertain else ""
    kinds = {"drive": 'kind = "force"\nunit = "N"\ninput = true', "x": 'kind = "displacement"\nunit = "m"'}
    kinds["v"] = 'kind = "velocity"\nunit = "m/s"'
    for i, (role, names, data) in enumerate(files):
        np.savetxt(folder / f"run{i}.csv", np.column_stack(data), delimiter=",", header=",".join(names), comments="")
        text += (
            f'[[recording]]\nname = "run{i}"\nfile = "run{i}.csv"\nrole = "{role}"\nrate_hz = 500.0\ninitial = "rest"\n'
        )
        for name in names:
            text += f'[[recording.channel]]\ncolumn = "{name}"\nat = "{name}"\n{kinds[name]}\n'
    (folder / "case.toml").write_text(text)
    return load_case(folder)


ALL = ("drive", "x", "v")
FIT = ("fit", ALL, (SWEEP, 0.01 * SWEEP, 0.1 * SWEEP))


@pytest.mark.slow
def test_a_hold_out_may_lack_a_channel_or_stand_still(tmp_path):
    quiet = ("holdout", ALL, (0 * TIME, 0 * TIME, 0 * TIME))
    case = write(tmp_path, [FIT, ("holdout", ("drive", "x"), (SWEEP, 0.01 * SWEEP)), quiet])
    found = read_holdout(case, ("x", "v"))
    assert [run.name for run in found.runs] == ["run1"]
    assert found.notes == (
        "run1 lacks v; it is checked on its other channels",
        "run2: no compared sensor moves, so it verifies nothing and is left out",
    )
    model = ExtendedModel(plant=case.plant, names=("x", "v"), sensor_gain=np.array([2.0, 3.0]), offset=np.zeros(2))
    (checked,) = check(found.runs, model, None, nominal=ExtendedModel(plant=case.plant))
    assert set(checked.channels) == {"x"}
    # later parts start from states of their own, which no gain relates
    first = found.runs[0].measured.time < min(checked.horizon_s, np.inf)
    assert first.sum() > 100
    np.testing.assert_allclose(checked.simulated[1]["x"][first], 2.0 * checked.simulated[0]["x"][first])


def test_without_a_hold_out_nothing_is_verified(tmp_path):
    assert "nothing could be verified" in read_holdout(write(tmp_path, [FIT]), ("x", "v")).notes[0]


@pytest.mark.parametrize(("factor", "is_new"), [(1.0, False), (0.5, True)])
def test_the_same_inputs_show_no_other_motion(tmp_path, factor, is_new):
    noise = 1e-4 * np.random.default_rng(3).standard_normal(TIME.size)
    again = ("holdout", ALL, (factor * SWEEP, 0.01 * factor * SWEEP + noise, 0.1 * factor * SWEEP))
    case = write(tmp_path, [FIT, again])
    found = read_holdout(case, ("x", "v"), case.runs(("fit",)))
    assert found.is_new == is_new
    assert any("repeats the inputs of run0" in note for note in found.notes) != is_new


def test_a_copy_of_what_is_fitted_verifies_nothing(tmp_path):
    case = write(tmp_path, [FIT, ("holdout", *FIT[1:])])
    with pytest.raises(BadCase, match="run1 is held out and has the very samples of run0"):
        read_holdout(case, ("x", "v"), case.runs(("fit",)))


def test_what_a_sensor_reads_at_rest_beyond_the_model_is_taken_off_and_said(tmp_path):
    def run(static_offset):
        return ("fit", ALL, (SWEEP, 0.01 * SWEEP + static_offset, 0.1 * SWEEP))

    case, found = remove_static_offsets(write(tmp_path, [run(0.5), run(0.5)]))
    assert [(s.channel, s.unit) for s in found] == [("x", "m")]
    deflection = np.mean(SWEEP) * 300 / (1200 * 700 - 300**2)  # of b under a mean force on a: the inverse of K
    assert found[0].value == pytest.approx(0.5 + np.mean(0.01 * SWEEP) - deflection)
    assert "reads 0.5004 m more at rest" in found[0].line
    for measured in (r.measured for r in case.runs()):
        assert measured["x"].mean() == pytest.approx(deflection)
        np.testing.assert_allclose(measured["v"], 0.1 * SWEEP)
    for files in ([run(0.01), run(0.01)], [run(0.5), run(0.4)]):  # within the motion; not the same in all recordings
        case = write(tmp_path, files)
        assert remove_static_offsets(case) == (case, ())


def test_what_moves_freely_or_turns_stands_where_it_stands(tmp_path):
    run = ("fit", ALL, (SWEEP, 0.01 * SWEEP + 0.5, 0.1 * SWEEP))
    free = RIG.replace('stiffness="900"', "").replace('stiffness="400"', "")
    assert remove_static_offsets(write(tmp_path, [run], rig=free))[1] == ()


HELD = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="arm" axis="0 1 0" damping="2" armature="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="2"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="arm" kp="400" kv="20"/></actuator>
  <sensor><jointpos name="angle" joint="arm"/><actuatorfrc name="effort" actuator="servo"/></sensor>
</mujoco>
"""


@pytest.mark.parametrize("wrong", [0.0, 20.0])
def test_the_effort_of_a_servo_that_holds_a_pose_is_no_static_offset(tmp_path, wrong):
    """At 1 rad gravity takes 4 N m of the drive, ten times what a motion of 0.1 rad adds; the model hangs at zero."""
    command = 1.0 + 0.1 * np.sin(2 * np.pi * 0.5 * TIME)
    model = mujoco.MjModel.from_xml_string(HELD)
    data = mujoco.MjData(model)
    data.qpos[0] = 1.0
    read = []
    for value in command:
        data.ctrl[0] = value
        mujoco.mj_step(model, data)
        read.append(data.sensordata.copy())
    angle, effort = np.array(read).T
    channels = [
        Channel(column="u", at="servo", kind="command", unit="rad", is_input=True, hold="zero"),
        Channel(column="angle", at="angle", kind="angle", unit="rad"),
        Channel(column="effort", at="effort", kind="moment", unit="N m"),
    ]
    columns = {"u": command, "angle": angle, "effort": effort + wrong}
    record = Record(name="held", role="fit", columns=columns, rate_hz=500.0, initial="auto")
    write_case(tmp_path, title="held", mjcf=HELD, uncertain={}, channels=channels, records=[record])
    found = remove_static_offsets(load_case(tmp_path))[1]
    assert [offset.channel for offset in found] == (["effort"] if wrong else [])


def test_the_search_looks_where_a_long_record_moves():
    y = np.random.default_rng(0).standard_normal((10_000, 2))
    assert liveliest(y, 20_000) == slice(0, 10_000)
    assert liveliest(y, 4000) == slice(0, 4000)  # as lively as any
    y[:5000] *= 0.01
    part = liveliest(y, 4000)
    assert part.start >= 5000
    assert part.stop - part.start == 4000


def test_the_diagnosis_says_what_it_did_not_search(tmp_path):
    n = 20_000
    t = np.arange(n) / 500
    push = np.where(t > 20, np.sin(2 * np.pi * 35 * t), 0.0)  # so fast that nothing is thinned
    case = write(tmp_path, [("fit", ALL, (push, 1e-3 * push, push))], uncertain="tension = 0.1")
    problem = prepare(case)
    assert problem.signals[0].t0 > 19
    assert not problem.signals[0].at_rest
    said, idle_note = problem.notes[:2]
    assert said.startswith("run0: searched from ")
    assert "of 40 s" in said
    assert idle_note.startswith("[model.uncertain] tension: not used")


def test_a_record_that_is_too_short_is_refused(tmp_path):
    case = write(tmp_path, [("fit", ALL, tuple(x[:40] for x in (SWEEP, SWEEP, SWEEP)))])
    with pytest.raises(BadCase, match="run0 has 40 samples; at least 64"):
        choose_model_class(case)


def test_a_short_record_beside_a_longer_one_takes_its_noise(tmp_path):
    rng = np.random.default_rng(0)
    u, x, v = (c + 0.01 * np.std(c) * rng.standard_normal(c.size) for c in (SWEEP, SWEEP, SWEEP))
    short = tuple(c[500:540] for c in (u, x, v))
    case = write(
        tmp_path, [("fit", ALL, (u, x, v)), ("fit", ALL, short), ("holdout", ALL, tuple(c[700:740] for c in (u, x, v)))]
    )
    longer, brief = read_runs(case, ("fit",)).runs
    (held,) = read_holdout(case, ("x", "v"), (longer, brief)).runs
    for run in (brief, held):
        for name in ("x", "v"):
            assert estimate_noise(run, name).sigma == estimate_noise(longer, name).sigma
    few = write(tmp_path, [("fit", ALL, (u, x, v)), ("fit", ALL, tuple(c[:15] for c in short))])
    assert [run.name for run in read_runs(few, ("fit",)).runs] == ["run0"]


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ('"body:a:mas" = 0.1', "unknown quantity of a body 'mas'"),
        ('"site:a:mass" = 0.1', "unknown type of element 'site'"),
        ('"geom:arm:mass" = 0.1', "unknown geom 'arm'"),
    ],
)
def test_what_is_uncertain_must_mean_something(tmp_path, stated, words):
    with pytest.raises((BadCase, UnknownName), match=words):
        write(tmp_path, [FIT], uncertain=stated)


def test_the_mass_of_a_geom_is_that_of_its_body(tmp_path):
    rig = RIG.replace('<geom size="0.1" mass="1"/>', '<geom name="block" size="0.1" mass="1"/>')
    case = write(tmp_path, [FIT], uncertain='"geom:block:mass" = 0.11\n"joint:b:stiffness" = 0.07', rig=rig)
    given = case.table.model.uncertain
    stated = {p.name: p.sd for p in uncertain_parameters(case.plant, given, ("x",), (0,))}
    assert stated["body:a:mass"] == 0.11
    parameters = uncertain_parameters(case.plant, given, ("x",), (0,))
    assert unused(given, parameters) == []
    assert "joint:b:damping" in unused({"joint:b:damping": 0.1}, [p for p in parameters if p.kind != "damping"])[0]
    assert stated["joint:b:stiffness"] == 0.07


def test_a_loop_that_runs_away_by_negative_damping_is_said(tmp_path):
    """A drag of the wrong sign: recordings that stay at rest for minutes need something that holds them."""
    rig = RIG.replace('stiffness="400" damping="2"', 'stiffness="400" damping="-8"')
    still = 1e-3 * np.sin(TIME)
    folder = tmp_path
    case = write(folder, [("fit", ("x", "v"), (still, still))], rig=rig)
    with pytest.raises(BadCase, match="unstable in the model"):
        choose_model_class(case)


def test_equality_constraints_are_refused_in_one_line(tmp_path):
    tie = '</tendon><equality><joint name="gear" joint1="a" joint2="b" polycoef="0 1 9 0 0"/></equality>'
    case = write(tmp_path, [FIT], rig=RIG.replace("</tendon>", tie))
    with pytest.raises(BadStructure, match="'gear' ties coordinates together"):
        linearise(case.plant.model)
    with pytest.raises(BadStructure, match="'gear'"):
        choose_model_class(case)


ARM = """<mujoco model="arm at a voltage">
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody>
    <body name="arm">
      <joint name="theta" axis="0 0 1" armature="3e-4" damping="6e-4"/>
      <geom type="sphere" size="0.01" mass="0.01"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="theta"/></actuator>
  <sensor><jointpos name="theta" joint="theta"/></sensor>
</mujoco>
"""


def test_a_spring_is_named_on_a_recording_of_its_static_deflection(tmp_path):
    """The held-out recording hardly moves; a model without the spring runs away, one with the spring stays 0.15 rad off."""
    inertia, damping, stiffness, moment, step, coarse = 3.1e-4, 6e-4, 2.5e-3, -5.63e-3, 1e-4, 0.003
    angle, speed, angles = 0.0, 0.0, []
    for _ in range(42000):
        angles.append(angle)
        speed += step * (moment - damping * speed - stiffness * angle) / inertia
        angle += step * speed
    read = np.round(np.array(angles)[::100] / coarse) * coarse
    channels = [
        Channel(column="command", at="motor", kind="moment", unit="N m", is_input=True, hold="zero"),
        Channel(column="theta", at="theta", kind="angle", unit="rad"),
    ]
    records = [
        Record(
            name=name,
            role=role,
            columns={"command": np.full(len(own), moment), "theta": own},
            rate_hz=100.0,
            initial="auto",
        )
        for name, role, own in (("swing", "fit", read[:91]), ("settled", "holdout", read[330:415] + 0.15))
    ]
    write_case(tmp_path, title="arm", mjcf=ARM, uncertain={"inertia": 0.1}, channels=channels, records=records)
    found = diagnose(load_case(tmp_path)).diagnosis
    assert found.verdict in ("missing-physics", "partly-explained")
    assert found.findings[0].family == EFFECTS["stiffness-to-ground"].family
    assert found.findings[0].place == "joint:theta"
