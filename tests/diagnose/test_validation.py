"""The share of the gap that is closed, errors over recordings, the amended model, and work on several processes."""

import dataclasses
import os
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import rig_oscillator
from rig_folder import Channel, Record, write_case
from rigs import oscillator_case

from vlab import signals
from vlab.cases import load_case, simulate
from vlab.diagnose.advice import coloured_noise_note, residual_note
from vlab.diagnose.data.quality import DataQuality
from vlab.diagnose.inference.sensor_offset import explained_sensor_offsets
from vlab.diagnose.model_kinds.meshed_structure import MeshedStructure
from vlab.diagnose.model_kinds.mjcf_model import MjcfModel
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.validation.checked import Checked
from vlab.diagnose.validation.gap import gap_closed, total
from vlab.diagnose.validation.simulation import ExtendedModel, check, coarse_steps, with_finer_steps
from vlab.diagnose.verdict import (
    closes_gap,
    decide_verdict,
    is_incoherent,
    is_needed,
    is_needed_beside_data,
)
from vlab.files.assets import asset
from vlab.parallel import side_by_side
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import EFFECTS, effect_named
from vlab.structure import load_structure

BEAM = MeshedStructure(structure=load_structure("beam"), variant="physical")
"""Model with mesh error."""


@pytest.mark.parametrize(
    ("before", "after", "noise", "share"),
    [
        (1.0, 0.1, 0.1, 1.0),
        (0.5, 0.2, 0.1, 0.75),
        (0.5, 0.5, 0.1, 0.0),
        (0.5, 0.9, 0.1, -1.0),
        (0.109, 0.05, 0.1, None),  # nothing to close
        (np.inf, 0.3, 0.1, 1.0),  # only the amended model can follow at all
        (np.inf, np.inf, 0.1, 0.0),
        (0.5, np.inf, 0.1, -np.inf),
    ],
)
def test_the_share_of_the_gap(before, after, noise, share):
    got = gap_closed(before, after, noise)
    assert got == (None if share is None else pytest.approx(share))


def test_the_error_over_recordings_is_their_root_mean_square():
    checked = [SimpleNamespace(before=3.0), SimpleNamespace(before=4.0)]
    assert total(checked, "before") == pytest.approx(np.sqrt(12.5))
    assert np.isnan(total([], "before"))


def test_a_residual_that_a_model_predicts_is_no_noise():
    def checked(after, role="holdout", incoherent=0.025):
        return [SimpleNamespace(before=0.03, incoherent=incoherent, after=after, role=role)]

    assert is_incoherent(checked(0.03))
    assert is_incoherent(checked(0.021))  # a spurious effect may follow noise a little
    assert not is_incoherent(checked(0.015))
    assert is_incoherent(checked(0.015, role="fit"))  # to which it was fitted
    assert not is_incoherent(checked(0.03, role="fit", incoherent=0.018))


@pytest.mark.slow
def test_the_true_physics_leaves_nothing_but_noise(tmp_path, monkeypatch):
    monkeypatch.setattr(rig_oscillator, "SECONDS", 4.0)
    rig = oscillator_case(tmp_path, effect="cubic-stiffness", benign=0.0)
    case = load_case(tmp_path)
    runs = case.runs(("holdout",))
    one = Attached(effect=effect_named(rig.effect), place=rig.place, values=rig.parameters)
    after = ExtendedModel(plant=attach(case.plant, [one], channels=[]))
    results = check(runs, ExtendedModel(plant=case.plant), after, nominal=ExtendedModel(plant=case.plant))
    assert [c.name for c in results] == ["sweep", "other multisine"]
    for c in results:
        assert c.role == "holdout"
        assert c.nominal == c.before > 10 * c.after
        # noise of 0.5 %, to the 5 % that 2000 samples and its own estimate allow; the law is integrated at 1 ms and 0.5 ms
        assert c.after == pytest.approx(rig_oscillator.NOISE, rel=0.1)
        assert c.noise == pytest.approx(rig_oscillator.NOISE, rel=0.3)
        assert c.gap_closed == pytest.approx(1.0, abs=0.02)


def held_out_run(folder, monkeypatch):
    """Return a short case, its first hold-out, the nominal model's run of it and the compared channels."""
    monkeypatch.setattr(rig_oscillator, "SECONDS", 4.0)
    oscillator_case(folder)
    case = load_case(folder)
    (run, *_) = case.runs(("holdout",))
    return case, run, simulate(case.plant, run).recording, tuple(c.channel for c in run.compared)


def test_an_amended_models_gains_and_offsets_act_on_its_channels(tmp_path, monkeypatch):
    case, run, plain, names = held_out_run(tmp_path, monkeypatch)
    gains, offsets = np.array([1.0, 1.1, 0.9]), np.array([0.0, 0.0, 2e-3])
    changed = ExtendedModel(plant=case.plant, names=names, sensor_gain=gains, offset=offsets).simulated(run)
    for name, gain, offset in zip(names, gains, offsets, strict=True):
        np.testing.assert_allclose(changed[name], gain * plain[name] + offset)


def test_a_gain_counts_from_what_is_read_at_rest(tmp_path, monkeypatch):
    case, run, plain, names = held_out_run(tmp_path, monkeypatch)
    gains, rest = np.full(3, 1.02), np.array([0.5, 9.81, 0.0])  # a height, an accelerometer upright
    model = ExtendedModel(plant=case.plant, names=names, sensor_gain=gains, offset=np.zeros(3), about=rest)
    for name, about in zip(names, rest, strict=True):
        np.testing.assert_allclose(model.simulated(run)[name], 1.02 * plain[name] - 0.02 * about)


def checked(before, after, noise=0.01):
    one = Checked(
        name="run", role="holdout", nominal=before, before=before, after=after, noise=noise, channels={},
        run=None, simulated=(None, None, None),
    )  # fmt: skip
    return [one, dataclasses.replace(one, name="other")]


@pytest.mark.parametrize("has_bursts", [False, True])
def test_a_residual_with_bursts_is_not_said_to_be_noise_alone(has_bursts):
    rng, t = np.random.default_rng(3), 0.01 * np.arange(3000)
    motion, noise = np.sin(7.0 * t), 0.05 * rng.standard_normal(t.size)
    noise *= (np.sin(2 * np.pi * 0.3 * t) > 0.8) if has_bursts else 1.0
    channels = (signals.Channel(name="x", kind="displacement", unit="m"),)
    recorded = signals.Recording(time=t, data=(motion + noise)[:, None], channels=channels)
    simulated = dataclasses.replace(recorded, data=motion[:, None])
    (one, _) = checked(0.05, 0.05)
    one = dataclasses.replace(
        one,
        channels={"x": (0.05, 0.05, 0.05, 0.01)},
        run=SimpleNamespace(measured=recorded),
        simulated=(simulated,) * 3,
    )
    (note,) = coloured_noise_note("nothing-missing", [one], model_kind=MjcfModel())
    assert ("bursts" in note) is has_bursts


SWING = """<mujoco><option timestep="{step}" integrator="{integrator}"/><worldbody><body name="arm">
  <joint name="pivot" type="hinge" axis="0 1 0" damping="0.002"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass="0.5"/></body></worldbody>
  <sensor><jointpos name="angle" joint="pivot"/></sensor></mujoco>"""


def swing(folder, *, step=0.002, integrator="RK4", made="RK4", gain=1.0, zero=0.0, noise=1e-4):
    """The run of an arm let go at a radian for ten seconds, whose sensor has a gain and a zero; and the model of it."""
    model = mujoco.MjModel.from_xml_string(SWING.format(step=0.002, integrator=made))
    data, time = mujoco.MjData(model), np.arange(0.0, 10.0, 0.01)
    y = np.zeros(len(time))
    data.qpos[0] = 1.0
    for k in range(len(time)):
        y[k] = data.qpos[0]
        mujoco.mj_step(model, data, 5)
    y = gain * y + zero + noise * np.random.default_rng(1).standard_normal(len(y))
    record = Record(name="a", role="holdout", columns={"y": y}, rate_hz=100.0, initial="estimated")
    channel = Channel(column="y", at="angle", kind="angle", unit="rad")
    write_case(
        folder,
        title="Swing",
        mjcf=SWING.format(step=step, integrator=integrator),
        uncertain={},
        channels=[channel],
        records=[record],
    )
    case = load_case(folder)
    (run,) = case.runs(("holdout",))
    return ExtendedModel(plant=case.plant, names=("angle",), sensor_gain=np.array([gain]), offset=np.array([zero])), run


def test_a_start_is_read_off_the_motion_and_not_off_a_sensor_that_is_off(tmp_path):
    """Three per cent more of a radian swings half a per cent slower: a tenth of a cycle in ten seconds."""
    model, run = swing(tmp_path, gain=1.03, zero=0.02)
    (name,) = model.simulated(run).names
    model = dataclasses.replace(model, names=(name,))
    error = (model.simulated(run)[name] - run.measured[name]).std() / run.measured[name].std()
    assert error < 2e-3  # the noise is 2e-4; what the reading of a start leaves comes to some times that


@pytest.mark.slow
def test_steps_that_are_too_coarse_for_a_motion_are_said(tmp_path):
    coarse, run = swing(tmp_path / "coarse", step=0.01, integrator="Euler")
    fine, _ = swing(tmp_path / "fine")
    words, left = [], []
    for model in (coarse, fine):
        own, finer = (check([run], m, None) for m in (model, with_finer_steps(model)))
        words.append(coarse_steps(model, [run]))
        left.append((own[0].before, finer[0].before))
    assert "2.5 ms instead of 10 ms" in words[0]
    assert "RK4" in words[0]
    assert words[1] == ""
    assert left[0][1] < 0.6 * left[0][0]  # of first order: a quarter, and what the reading of the start leaves


@pytest.mark.slow
def test_steps_are_compared_over_the_same_parts(tmp_path):
    """A model that loses a recording is simulated in parts; the parts are not a matter of its steps."""
    model, run = swing(tmp_path, step=0.002)
    stiff = Attached(effect=EFFECTS["stiffness-to-ground"], place="joint:pivot", values={"stiffness": 0.15})
    wrong = dataclasses.replace(model, plant=attach(model.plant, [stiff], channels=[]))
    (alone,), (with_right,) = check([run], wrong, None), check([run], wrong, model)
    assert (
        alone.before < 0.5 * with_right.before
    )  # in parts, and over all of the recording that the right model explains
    assert coarse_steps(wrong, [run]) == ""


def test_what_loses_a_recording_explains_nothing_however_far_off_the_other_model_is():
    assert closes_gap(checked(np.inf, 0.02), model_kind=MjcfModel())
    assert not closes_gap(checked(np.inf, 40.0), model_kind=MjcfModel())
    assert not closes_gap(checked(100.0, 2.0), model_kind=MjcfModel())  # 98 % of a gap


def test_findings_from_the_data_alone_suffice_only_where_they_explain_the_recordings():
    likely = SimpleNamespace(gained=0.0, is_prior_driven=False)

    def is_kept(before, after):
        return is_needed_beside_data(likely, checked(before, after, noise=0.006), model_kind=MjcfModel())

    assert is_kept(0.36, 0.16)  # a stop beside coarse steps of an encoder: the steps explain nothing of the stop
    assert not is_kept(0.36, 0.355)
    assert not is_kept(0.0065, 0.0055)


def test_what_priors_ask_for_is_needed_while_recordings_kept_aside_are_no_worse_with_it():
    def choice(gained, of_priors):
        return SimpleNamespace(gained=gained, is_prior_driven=of_priors)

    same, worse, better = (checked(0.02, after, noise=0.019) for after in (0.0201, 0.022, 0.0195))
    assert is_needed(choice(3.0, True), same, model_kind=MjcfModel())
    assert not is_needed(choice(3.0, True), worse, model_kind=MjcfModel())
    assert not is_needed(choice(-1.0, True), same, model_kind=MjcfModel())
    alike = checked(0.00104, 0.00119, noise=0.00066)  # within the model error to which fits converge
    assert is_needed(choice(20.0, True), alike, model_kind=MjcfModel())
    assert not is_needed(choice(20.0, False), alike, model_kind=MjcfModel())
    law = checked(0.0015, 0.0026, noise=0.0008)  # a law that acts a little otherwise than the parameter of the model
    assert is_needed(choice(3.0, True), law, model_kind=MjcfModel())
    assert not is_needed(choice(3.0, True), checked(0.0015, 0.0056, noise=0.0008), model_kind=MjcfModel())
    assert is_needed(choice(3.0, False), better, model_kind=MjcfModel())
    assert not is_needed(choice(3.0, False), same, model_kind=MjcfModel())
    assert not is_needed(
        choice(3.0, False), checked(0.04, 0.03, noise=0.019), model_kind=MjcfModel()
    )  # a gap, for `closes_gap`


def test_what_a_mesh_leaves_is_no_gap_but_much_of_it_gone_is_a_finding():
    choice = SimpleNamespace(gained=3.0, is_prior_driven=False)
    assert is_needed(choice, checked(0.0028, 0.0022, noise=0.0016), model_kind=BEAM)
    assert not is_needed(choice, checked(0.0028, 0.0027, noise=0.0016), model_kind=BEAM)
    assert is_needed(choice, checked(0.0067, 0.0062, noise=0.0060), model_kind=BEAM)  # beside the noise a half is gone
    assert not is_needed(choice, checked(0.0060, 0.0050, noise=0.0016), model_kind=BEAM)


def test_a_residual_within_mesh_error_shows_no_linear_element():
    seen = SimpleNamespace(damage=SimpleNamespace(fatal=(), warnings=()), is_missing=False, steps=(), stops=())

    def verdict(effect, before, after):
        term = SimpleNamespace(effect=EFFECTS[effect])
        choice = SimpleNamespace(
            gained=30.0, is_prior_driven=False, best=SimpleNamespace(terms=(term,), normalised_residual=1.0)
        )
        return decide_verdict(choice, checked(before, after, noise=0.0082), seen, model_kind=BEAM)

    assert verdict("stiffness-to-ground", 0.0121, 0.0090) == "nothing-missing"
    assert verdict("cubic-stiffness", 0.0121, 0.0090) == "missing-physics"  # a mesh is linear
    assert verdict("stiffness-to-ground", 0.0286, 0.0090) == "missing-physics"


@pytest.mark.parametrize(("first", "verdict"), [(20.0, "bad-recording"), (5.0, "none-of-these")])
def test_damage_decides_where_no_mismatch_precedes_it(first, verdict):
    rng, t = np.random.default_rng(3), 0.01 * np.arange(3000)
    motion = np.sin(7.0 * t)
    read = motion + 0.01 * rng.standard_normal(t.size) + 0.3 * (t > first) * np.sin(3.0 * t)
    channels = (signals.Channel(name="x", kind="displacement", unit="m"),)
    recorded = signals.Recording(time=t, data=read[:, None], channels=channels)
    simulated = dataclasses.replace(recorded, data=motion[:, None])
    one = dataclasses.replace(
        checked(0.3, 0.3)[0],
        channels={"x": (0.3, 0.3, 0.3, 0.014)},
        noise=0.014,
        run=SimpleNamespace(measured=recorded),
        simulated=(simulated,) * 3,
    )
    assert one.error_until(first) == pytest.approx(0.014, rel=0.1)
    damage = DataQuality(fatal=(), warnings=("run: 1 gap",), notes=(), since={"run": 20.0})
    seen = SimpleNamespace(damage=damage, is_missing=False, steps=(), stops=())
    choice = SimpleNamespace(
        gained=-1.0, is_prior_driven=False, best=SimpleNamespace(terms=(), normalised_residual=30.0)
    )
    assert decide_verdict(choice, [one], seen, model_kind=MjcfModel(), is_plausible=False) == verdict


def test_the_zero_that_an_effect_names_is_no_zero_of_the_refit():
    signals = [SimpleNamespace(scale=np.array([1.0, 1.0, 2.0]))]
    problem = SimpleNamespace(signals=signals, names=["a", "b", "c"])

    def offset(index, value):
        return SimpleNamespace(
            effect=EFFECTS["sensor-offset"], place=SimpleNamespace(index=index), values={"offset": value}
        )

    fit = SimpleNamespace(terms=(offset(0, -0.05), offset(2, 0.015)), error=np.full((1, 3), 0.002))
    assert explained_sensor_offsets(problem, fit) == ("a",)  # that of c is less than a hundredth of its rms


def test_side_by_side_is_the_serial_map_in_order():
    offset = 7  # a closure, which need not be pickled

    def work(x):
        return (x * x + offset, np.sqrt(np.arange(x, x + 3.0)).tolist())

    items = list(range(9))
    assert side_by_side(work, items) == [work(x) for x in items]
    assert side_by_side(work, []) == []
    assert side_by_side(work, [3]) == [work(3)]


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2, reason="one core")
def test_side_by_side_nested_and_failing():
    def outer(x):
        return sum(side_by_side(lambda y: x * y, [1, 2, 3]))

    assert side_by_side(outer, [1, 2]) == [6, 12]

    def fails(x):
        raise ZeroDivisionError(str(x))

    with pytest.raises(ZeroDivisionError):
        side_by_side(fails, [1, 2])
    assert side_by_side(outer, [1]) == [6]  # the failure left nothing behind


# ---- the whole way --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_loop_with_a_limited_voltage_is_diagnosed():
    done = diagnose(load_case(asset("cases/avc_cantilever/closed_loop_identified_observer.toml")))
    diagnosis = done.diagnosis
    assert diagnosis.verdict == "partly-explained"  # the loop leaves seven to ten times the noise
    first = diagnosis.findings[0]
    assert (first.effect, first.place) == ("actuator-clipping", "actuator:piezo")
    assert first.probability > 0.95
    assert first.parameters["limit"]["value"] == pytest.approx(119.0, rel=0.02)
    assert diagnosis.is_verified
    assert [r["name"] for r in diagnosis.heldout["per_recording"]] == ["release 2", "release 3"]
    assert diagnosis.heldout["gap_closed"] >= 0.8
    document = diagnosis.to_json()
    assert document["findings"][0]["class"][0] == "actuator-clipping"


@pytest.mark.slow
@pytest.mark.parametrize(("case", "effect"), [("silverbox", "quadratic-cubic-stiffness"), ("emps", "coulomb-friction")])
def test_real_recordings_are_diagnosed(case, effect):
    diagnosis = diagnose(load_case(asset(f"cases/{case}"))).diagnosis
    assert diagnosis.verdict == "missing-physics"
    assert effect in [f.effect for f in diagnosis.findings]
    assert diagnosis.heldout["gap_closed"] >= 0.8


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["coulomb-friction", "cubic-stiffness", "actuator-clipping"])
def test_hidden_effects_are_found_verified_and_sized(tmp_path, effect):
    rig = oscillator_case(tmp_path, effect=effect)
    diagnosis = diagnose(load_case(tmp_path)).diagnosis
    assert diagnosis.verdict == "missing-physics"
    (first, *_) = diagnosis.findings
    assert (first.effect, first.place) == (rig.effect, rig.place)
    for name, true in rig.parameters.items():
        assert first.parameters[name]["value"] == pytest.approx(true, rel=0.1)  # the gain alone is 2 % uncertain
    assert diagnosis.heldout["gap_closed"] >= 0.8


def test_what_an_amended_model_leaves_is_said():
    (line,) = residual_note("missing-physics", checked(0.5, 0.12), model_kind=MjcfModel())
    assert "12 times the noise" in line
    assert not residual_note("missing-physics", checked(0.5, 0.012), model_kind=MjcfModel())
    assert not residual_note("none-of-these", checked(0.5, 0.5), model_kind=MjcfModel())


def test_a_channel_that_is_lost_is_no_gap_closed():
    one, _ = checked(200.0, 0.9)
    assert closes_gap([one], model_kind=MjcfModel())
    lost = dataclasses.replace(one, channels={"a": (300.0, 200.0, 0.4, 0.01), "b": (300.0, 200.0, 1.2, 0.01)})
    assert not closes_gap([lost], model_kind=MjcfModel())
