"""MuJoCo plants against the independent FE model."""

import dataclasses

import mujoco
import numpy as np
import pytest

from vlab.errors import BadExperiment, BadStructure, Diverged, UnknownName
from vlab.fe import build_fe_model
from vlab.fe.statics import cable_tensions
from vlab.plants import build_plant
from vlab.plants.base import check_run
from vlab.plants.composite import CompositeOptions, build_composite
from vlab.plants.linearise import linearise
from vlab.plants.modal import build_modal
from vlab.reproduce.cross_check import check_plant, cross_check, numerical_damping
from vlab.signals import FrequencyResponse
from vlab.structure import load_structure

PAIRS = ["40in", "20in", "base"]


def response(plant, freq) -> FrequencyResponse:
    rows = plant.port_rows(PAIRS)
    return plant.linearise().frequency_response(freq, rows.T, rows)


@pytest.mark.parametrize("variant", ["published", "physical"])
def test_composite_matches_the_fe_model(beam, variant):
    check = cross_check(beam, variant, plants=["composite"], seconds=4.0)
    composite = check.plants["composite"]
    fe_hz = check.fe.linear.freq[check.modes]
    assert composite.freq == pytest.approx(fe_hz, rel=2e-3)  # the discretisation error asked for: 0.2 % on six modes
    assert composite.mac.min() > 0.995
    assert composite.zeta == pytest.approx(beam.damping.ratios, rel=1e-2)  # prescribed modal damping
    assert abs(composite.numerical_damping) < 1e-4  # symplectic Euler: none but rounding


def test_modal_plant_is_the_fe_model_in_its_modes(modal, fe, beam):
    check = check_plant(modal, fe, np.arange(6), seconds=2.0)  # the free run is not looked at
    assert check.freq == pytest.approx(fe.linear.freq[:6], rel=1e-8)  # carrier bodies of 1e-9 kg beside unit masses
    assert check.mac == pytest.approx(1.0, abs=1e-9)
    assert check.zeta == pytest.approx(beam.damping.ratios, rel=1e-6)


def test_composite_converges_to_the_physical_fe_model(beam):
    # gravity on the deflected crosspiece included: two formulations of the same physics, no fitted number between them
    reference = build_fe_model(beam, "physical", refine=2).linear.freq[:7]
    errors = {}
    for links, arm_links in ((8, 3), (16, 6), (32, 12)):
        plant = build_composite(
            beam, "physical", options=CompositeOptions(links=links, arm_links=arm_links), damped=False
        )
        errors[links] = np.abs(plant.linearise().freq[:7] / reference - 1).max()
    order = -np.polyfit(np.log(list(errors)), np.log(list(errors.values())), 1)[0]
    assert order > 1.7  # at least second order over all modes; most are better
    assert errors[32] < 1e-3


def test_frequency_responses_agree_within_half_a_decibel_away_from_resonance(composite, fe):
    # Near a pole or zero a response changes without bound, so 0.2 % of frequency shows as decibels there; "away" is
    # 3 % from every pole and zero, where 0.12 % (mode 6, two thirds of it the FE mesh's own error) makes 0.35 dB.
    freq = np.linspace(0.5, 25.0, 4000)
    H_fe = fe.linear.frequency_response(freq, fe.deflections(PAIRS).T, fe.deflections(PAIRS)).H
    H = response(composite, freq).H
    for j in range(3):  # the three collocated pairs
        size = np.abs(H_fe[:, j, j])
        turns = np.flatnonzero(np.diff(np.sign(np.diff(size))) != 0) + 1
        away = np.all(np.abs(freq[:, None] / freq[turns] - 1) > 0.03, axis=1)
        assert away.mean() > 0.25
        assert np.abs(20 * np.log10(np.abs(H[away, j, j]) / size[away])).max() < 0.5, PAIRS[j]


def test_response_of_a_mujoco_run_is_that_of_the_linearised_plant(composite):
    # one second of a hammer-like impulse against the modal sum: time integration, actuators and sensors together
    model, data = composite.model, composite.new_data()
    linear = composite.linearise()
    omega, shapes = linear.eigen
    impulse, steps = 1e-3, 2000
    at = composite.actuator_index("base")
    force = np.zeros(len(composite.actuators))
    velocity = np.zeros(steps)
    for k in range(steps):
        force[at] = impulse / composite.timestep if k == 0 else 0.0
        data.ctrl[:] = composite.control_matrix @ force
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        velocity[k] = composite.read(data)[composite.sensor_index("sensor:base")]
    check_run(model, data, steps * composite.timestep)
    row = composite.port_rows(["base"])[0] @ shapes
    t = (np.arange(steps) + 0.5) * composite.timestep  # the impulse's middle is half a step after the first sample
    exact = impulse * np.cos(np.outer(t, omega)) @ row**2
    low = np.abs(np.fft.rfft(velocity - exact)[:30]).max() / np.abs(np.fft.rfft(exact)[:30]).max()
    assert (
        low < 0.02
    )  # below 30 Hz; frequency error of the step (omega h)^2/24 = 4e-4 at 30 Hz, times 190 rad in a second


def test_tension_and_gravity_are_native(beam):
    # raising the stated tension must raise the frequencies as the FE model says, through nothing but tendons and gravity
    for factor in (0.9, 1.1):
        cables = tuple(dataclasses.replace(c, tension=c.tension * factor) if c.tension else c for c in beam.cable)
        other = dataclasses.replace(beam, cable=cables)
        expected = build_fe_model(other).linear.freq[:6] / build_fe_model(beam).linear.freq[:6]
        plant = (
            build_composite(other, damped=False).linearise().freq[:6]
            / build_composite(beam, damped=False).linearise().freq[:6]
        )
        assert plant == pytest.approx(expected, abs=3e-4)  # differences of 0.2 % models
        assert abs(expected[0] - 1) > 0.02  # and the effect is there to see


def test_gravity_holds_the_drawing_and_tension_grows_upwards(composite, beam):
    data = composite.new_data()
    left = data.qfrc_passive - data.qfrc_bias
    assert np.abs(left).max() < 1e-8 * np.abs(data.qfrc_bias).max() + 1e-8
    pull = {}
    for cable in beam.cable:
        ids = [composite.model.tendon(f"{cable.name}:{k + 1}").id for k in range(cable.count)]
        stiffness = composite.model.tendon_stiffness.reshape(composite.model.ntendon, -1)[ids, 0]
        stretch = data.ten_length[ids] - composite.model.tendon_lengthspring[ids, 1]
        pull[cable.name] = float(np.sum(stiffness * stretch) * abs(cable.height) / cable.length)
    for name, tension in cable_tensions(beam).items():
        assert pull[name] == pytest.approx(tension, rel=1e-9)


def test_without_gravity_the_composite_loses_its_balance(beam):
    weightless = dataclasses.replace(beam, gravity=0.0)
    spec = build_composite(beam, damped=False).spec
    spec.option.gravity = [0, 0, 0]
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    vertical = model.joint("clamp:z").dofadr[0]
    weight = sum(b for b in model.body_mass) * beam.gravity
    assert data.qfrc_passive[vertical] == pytest.approx(weight, rel=1e-6)  # the springs still pull the whole weight up
    assert build_fe_model(weightless).linear.freq[0] < build_fe_model(beam).linear.freq[0]


def test_large_motion_stiffens_the_cables(composite):
    # what a linear model cannot have: the cables lengthen as the beam swings, so the restoring force grows with x^3
    model, data = composite.model, composite.new_data()
    y = model.joint("clamp:y").qposadr[0]
    forces = []
    for x in (1e-3, 0.2):
        data.qpos[:] = model.qpos0
        data.qpos[y] = x
        mujoco.mj_forward(model, data)
        forces.append(-data.qfrc_passive[model.joint("clamp:y").dofadr[0]] / x)
    assert forces[1] > 1.05 * forces[0]


def test_native_damping_tendons_equal_the_applied_dissipation(composite):
    # the written-out model carries the damping as tendons; while running it acts as -C qvel: the same motion
    start = composite.linearise().eigen[1][:, [0, 2, 5]] @ [1e-4, 1e-4, 1e-4]
    ends = []
    for model, dissipation in ((composite.spec.compile(), None), (composite.model, composite.dissipation)):
        data = mujoco.MjData(model)
        data.qpos[:] = start
        for _ in range(2000):
            if dissipation is not None:
                data.qfrc_applied[:] = -dissipation @ data.qvel
            mujoco.mj_step(model, data)
        ends.append(data.qpos.copy())
    assert ends[1] == pytest.approx(
        ends[0], rel=0, abs=1e-9 * np.abs(start).max()
    )  # the same forces, summed in another order


def test_written_model_runs_by_itself(composite, tmp_path):
    path = tmp_path / "beam.xml"
    path.write_text(composite.spec.to_xml())
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.nv == composite.model.nv
    assert model.ntendon > composite.model.ntendon  # the dampers are in it


def test_planar_chain_stays_planar_under_noise(composite):
    model, data = composite.model, composite.new_data()
    rng = np.random.default_rng(0)
    data.qvel[:] = 1e-7 * rng.standard_normal(model.nv)
    mujoco.mj_step(model, data, nstep=20000)
    check_run(model, data, 20000 * composite.timestep)
    assert np.abs(data.qvel).max() < 1e-5  # ten seconds from 1e-7: bounded, no hidden instability


def test_the_measure_of_numerical_damping_sees_an_integrator_that_damps(beam):
    # implicit integration treats velocity-dependent forces implicitly and leaves springs explicit: it damps nothing here;
    # the "discrete" integrator damps, by some per cent at 22 Hz and 0.5 ms
    plant = build_plant(beam, "modal")
    linear = plant.linearise()
    assert abs(numerical_damping(plant, linear, 5, seconds=3.0)) < 1e-10
    plant.spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    assert numerical_damping(plant, linear, 5, seconds=3.0) > 1e-3


def test_a_diverged_run_is_an_error(composite):
    model, data = mujoco.MjModel.__copy__(composite.model), composite.new_data()
    model.opt.timestep = 5e-3  # far beyond the limit of the links
    data.qvel[:] = 1e-3
    mujoco.mj_step(model, data, nstep=500)
    with pytest.raises(Diverged, match="diverged"):
        check_run(model, data, 500 * 5e-3)


@pytest.mark.parametrize("rate", [1900.0, 0.0, -5.0, float("nan"), 3000.0])
def test_rates_that_are_no_multiple_of_the_step_are_refused(composite, rate):
    with pytest.raises(BadExperiment):
        composite.substeps(rate)


def test_rates_that_fit_are_counted(composite):
    assert [composite.substeps(rate) for rate in (2000.0, 1000.0, 2.0)] == [1, 2, 1000]


def test_names_that_match_nothing_list_the_known(composite, beam):
    for wrong in (composite.actuator_index, composite.sensor_index, composite.port):
        with pytest.raises(UnknownName, match="accepted"):
            wrong("nowhere")
    with pytest.raises(UnknownName, match="did you mean 'composite'"):
        build_plant(beam, "compsite")


def test_modal_plant_refuses_what_it_cannot_hold(fe):
    with pytest.raises(BadStructure, match="needs a step below"):
        build_modal(fe, modes=19, timestep=2e-3)
    with pytest.raises(BadStructure, match="19 degrees of freedom"):
        build_modal(fe, modes=20)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["beam", "grid"])
def test_fe_plant_is_the_fe_model_inside_mujoco(name):
    # asked for: 0.1 %; what is left is the selective mass scaling, (omega h/1.8)^2/2 at most: 1.7e-4 at 12 modes
    structure = load_structure(name)
    fe = build_fe_model(structure)
    check = check_plant(build_plant(structure, "fe"), fe, np.arange(12), seconds=4.0)
    assert check.freq == pytest.approx(fe.linear.freq[:12], rel=5e-4)
    assert check.mac == pytest.approx(1.0, abs=1e-3)  # modes 12 and 13 of the grid are 0.04 % apart
    assert check.zeta == pytest.approx(fe.linear.zeta[:12], rel=1e-2)
    assert abs(check.numerical_damping) < 1e-6


@pytest.mark.parametrize("variant", ["published", "physical"])
def test_no_mode_of_the_fe_plant_is_too_fast_for_its_step(beam, variant):
    plant = build_plant(beam, "fe", variant)
    # 1.8 by the mass scaling; beyond 2 explicit steps run away
    assert plant.linearise().eigen[0][-1] * plant.timestep < 1.81


def test_written_fe_plant_has_its_dampers(beam):
    plant = build_plant(beam, "fe")
    written = mujoco.MjModel.from_xml_string(plant.spec.to_xml())
    assert linearise(written).zeta[:6] == pytest.approx(beam.damping.ratios, rel=1e-2)  # XML prints six digits
