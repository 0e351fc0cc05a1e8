"""The hanging grid in three dimensions against closed forms, statics and the independent FE model."""

import dataclasses

import mujoco
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from vlab.errors import BadStructure
from vlab.fe import FeModel, build_fe_model
from vlab.fe.in_plane import in_plane_resultants
from vlab.modal.mac import mac
from vlab.plants import Plant
from vlab.plants.base import check_run
from vlab.plants.grillage import GrillageOptions, build_grillage
from vlab.plants.linearise import linearise
from vlab.reproduce.cross_check import SILENT, check_plant, numerical_damping
from vlab.structure import load_structure
from vlab.structure.model import Structure

MODES = np.arange(12)
WITHIN = 6e-3
"""Two elements a span against the converged FE model: second order, 0.44 % at worst on the grid, 0.54 % on its variations."""


@pytest.fixture(scope="module")
def grid() -> Structure:
    return load_structure("grid")


@pytest.fixture(scope="module")
def reference(grid) -> FeModel:
    return build_fe_model(grid, "physical")


@pytest.fixture(scope="module")
def plant(grid) -> Plant:
    return build_grillage(grid, damped=False)


@pytest.fixture(scope="module")
def damped(grid) -> Plant:
    return build_grillage(grid)


def errors(plant: Plant, reference: FeModel) -> np.ndarray:
    """Relative errors of twelve frequencies, matched by the deflections at the points."""
    names = [p.name for p in reference.structure.point]
    linear = plant.linearise()
    shapes = plant.port_rows(names) @ linear.eigen[1]
    seen = np.flatnonzero(np.abs(shapes).max(axis=0) > SILENT * np.abs(shapes).max())
    likeness = mac(reference.deflections(names) @ reference.linear.eigen[1][:, MODES], shapes[:, seen])
    matched = seen[linear_sum_assignment(-likeness)[1]]
    return linear.freq[matched] / reference.linear.freq[MODES] - 1


def pull(plant: Plant, data) -> np.ndarray:
    """Tension of every tendon [N]."""
    model = plant.model
    return model.tendon_stiffness.reshape(model.ntendon, -1)[:, 0] * (data.ten_length - model.tendon_lengthspring[:, 0])


# -- statics ---------------------------------------------------------------------------------------------------------


def test_the_drawing_is_the_equilibrium(plant):
    data = plant.new_data()
    weight = np.abs(data.qfrc_bias).max()
    assert np.abs(data.qfrc_smooth).max() < 1e-9 * weight + 1e-12


def test_the_pins_carry_the_weight_of_all_that_hangs(plant, grid):
    model, data = plant.model, plant.new_data()
    tension, up = pull(plant, data), 0.0
    for site in range(model.nsite):
        if model.body(int(model.site_bodyid[site])).name.endswith(":pin"):
            strut = model.site(site).name.rsplit(":", 1)[0]
            other = model.site(f"{strut}:{'b' if model.site(site).name.endswith(':a') else 'a'}").id
            along = data.site_xpos[other] - data.site_xpos[site]
            up -= tension[model.tendon(strut).id] * along[2] / np.linalg.norm(along)
    free = {
        b for b in range(model.nbody) if f"{model.body(b).name}:z" in {model.joint(j).name for j in range(model.njnt)}
    }
    assert up == pytest.approx(grid.gravity * sum(model.body_mass[b] for b in free), rel=1e-9)


def test_nothing_is_heavier_than_the_drawing(plant, grid):
    bars = sum(
        grid.section[bar.section].mass_per_length
        * np.hypot(*np.subtract(grid.position(bar.points[-1]), grid.position(bar.points[0])))
        for bar in grid.bar
    )
    lumps = sum(grid.point_mass(p.name) for p in grid.point)
    plates = sum(p.weight_moment / p.offset / grid.gravity for p in grid.plate)
    assert sum(plant.model.body_mass) == pytest.approx(bars + lumps + plates, rel=1e-9)


def test_the_struts_share_the_weight_as_the_frame_does(plant, grid, reference):
    # axial force at the top of each diagonal, against the FE model's plane frame: soft struts, real distribution
    data = plant.new_data()
    tension = pull(plant, data)
    forces = in_plane_resultants(grid, reference.mesh)
    for bar in (b for b in grid.bar if b.name.startswith("diagonal")):
        first, element = next((i, e) for i, e in enumerate(reference.mesh.elements) if e.bar == bar.name)
        length = 2 * element.length  # two struts' elements a span against four of the FE model's
        names = [plant.model.tendon(t).name for t in range(plant.model.ntendon)]
        top = min(int(n.split("/")[1].split(":")[0]) for n in names if n.startswith(f"{bar.name}/"))
        mine = sum(tension[plant.model.tendon(f"{bar.name}/{top}:along{k}").id] for k in (1, 2))
        assert mine == pytest.approx(forces[first].axial_at(length / 2), rel=0.03), bar.name


def test_plates_hang_as_pendulums(grid):
    # a beam with two equal plates and nothing else turns as one: omega^2 = 2 W Y/(2 I + polar inertia of the beam)
    beam = next(bar for bar in grid.bar if bar.carries)
    coil = dataclasses.replace(grid.coil[0], at="point17", mass=0.0)
    bare = dataclasses.replace(grid, bar=(beam,), mass=(), coil=(coil,), sensor=(), exciter=coil.name)
    linear = build_grillage(bare, damped=False).linearise()
    length = grid.position(beam.points[-1])[0] - grid.position(beam.points[0])[0]
    inertia = sum(p.inertia_about_beam for p in grid.plate)
    inertia += grid.section[beam.section].polar_inertia_per_length * length
    expected = np.sqrt(sum(p.weight_moment for p in grid.plate) / inertia) / (2 * np.pi)
    assert linear.freq[0] == pytest.approx(expected, rel=1e-4)  # the beam twists by 4e-5


# -- motion out of the plane -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_twelve_modes_match_the_fe_model(plant, grid):
    reference = build_fe_model(grid, "physical", refine=2)
    check = check_plant(plant, reference, MODES, seconds=4.0)
    assert check.freq == pytest.approx(reference.linear.freq[MODES], rel=WITHIN)
    assert check.mac[:11].min() > 0.99
    assert abs(check.numerical_damping) < 1e-5


def test_the_close_pair_spans_the_same_plane(plant, grid, reference):
    # modes 12 and 13 are 0.7 % apart, near the error of two elements a span: which mixture each is means nothing
    names = [p.name for p in grid.point]
    linear = plant.linearise()
    shapes = plant.port_rows(names) @ linear.eigen[1]
    pair = shapes[:, [i for i, f in enumerate(linear.freq) if 9.4 < f < 10 and np.abs(shapes[:, i]).max() > 1e-3]]
    target = reference.deflections(names) @ reference.linear.eigen[1][:, [11, 12]]
    assert pair.shape[1] == 2
    cosines = np.linalg.svd(np.linalg.qr(pair)[0].T @ np.linalg.qr(target)[0], compute_uv=False)
    assert cosines.min() ** 2 > 0.99


@pytest.mark.slow
def test_frequencies_converge_at_second_order(plant, grid, reference):
    coarse = np.sqrt(np.mean(errors(plant, reference) ** 2))
    finer = build_grillage(grid, options=GrillageOptions(elements_per_span=4), damped=False)
    fine = np.sqrt(np.mean(errors(finer, reference) ** 2))
    assert np.log2(coarse / fine) > 1.5
    assert fine < 1e-3


@pytest.mark.parametrize("change", ["torsion", "pitch", "drop", "masses"])
def test_other_grids_match_as_well(grid, change):
    # the one chosen number, SHEAR_FACTOR, belongs to no grid in particular
    bar = grid.section["bar"]
    other = dataclasses.replace(
        grid,
        **{
            "torsion": {
                "section": grid.section
                | {"bar": dataclasses.replace(bar, torsion_stiffness=1.5 * bar.torsion_stiffness)}
            },
            "pitch": {"point": tuple(dataclasses.replace(p, x=0.8 * p.x) for p in grid.point)},
            "drop": {"point": tuple(dataclasses.replace(p, z=1.3 * p.z) for p in grid.point)},
            "masses": {"mass": tuple(dataclasses.replace(m, mass=3 * m.mass) for m in grid.mass)},
        }[change],
    )
    assert np.abs(errors(build_grillage(other, damped=False), build_fe_model(other, "physical"))).max() < WITHIN


def test_gravity_is_native_and_matters(plant, grid, reference):
    # bars alone get lighter: the plates keep their weight moment
    lighter = dataclasses.replace(
        grid,
        gravity=0.5 * grid.gravity,
        plate=tuple(dataclasses.replace(p, weight_moment=0.5 * p.weight_moment) for p in grid.plate),
    )
    expected = build_fe_model(lighter, "physical").linear.freq[0] / reference.linear.freq[0]
    found = build_grillage(lighter, damped=False).linearise().freq[0] / plant.linearise().freq[0]
    assert found == pytest.approx(expected, rel=2e-3)
    assert found < 0.8


def test_rigid_rotation_about_the_beam_returns_the_pendulum(plant, grid):
    # all turn by rx: the work is the weight moment of everything about the axis, whatever carries it inside
    model, linear = plant.model, plant.linearise()
    turn = np.zeros(model.nv)
    for i, joint in enumerate(linear.coordinates):
        point, motion = joint.rsplit(":", 1)
        if motion == "y":
            turn[i] = -model.body(point).pos[2]
        turn[i] += motion == "rx"
    data = plant.new_data()
    moment = -grid.gravity * sum(model.body_mass * data.xipos[:, 2])
    assert turn @ linear.K @ turn == pytest.approx(moment, rel=1e-5)  # differences of stiff struts


def test_a_large_rigid_rotation_strains_nothing(plant):
    # 30 degrees about the top beam: no strut lengthens, no spring turns
    model, data, angle = plant.model, plant.new_data(), np.pi / 6
    strained = [i for i in range(model.ntendon) if not model.tendon(i).name.startswith("at:")]  # those only read
    before = data.ten_length[strained]
    for i in range(model.njnt):
        point, motion = model.joint(i).name.rsplit(":", 1)
        z = 0.0 if point.endswith(":pin") else model.body(point).pos[2]
        data.qpos[i] = {"y": -z * np.sin(angle), "z": z * (np.cos(angle) - 1), "rx": angle}.get(motion, 0.0)
    mujoco.mj_forward(model, data)
    assert data.ten_length[strained] == pytest.approx(before, abs=1e-12)


def test_the_plane_of_the_drawing_is_a_plane_of_symmetry(plant):
    inside = np.array([name.rsplit(":", 1)[1] in ("x", "z", "ry") for name in plant.linearise().coordinates])
    K = linearise(plant.model).K
    assert np.abs(K[np.ix_(inside, ~inside)]).max() < 1e-9 * np.abs(K).max()


# -- running ---------------------------------------------------------------------------------------------------------


def test_noise_stays_noise(plant):
    model, data = plant.model, plant.new_data()
    data.qvel[:] = 1e-7 * np.random.default_rng(0).standard_normal(model.nv)
    mujoco.mj_step(model, data, nstep=10000)
    check_run(model, data, 5.0)
    assert np.abs(data.qvel).max() < 1e-5
    limit = 2 / plant.linearise().eigen[0][-1]
    assert plant.timestep == 5e-4 < 0.8 * limit


def test_integration_damps_no_mode(plant):
    linear = plant.linearise()
    assert abs(numerical_damping(plant, linear, 0, seconds=4.0)) < 1e-5


def test_modal_damping_is_prescribed(damped, grid, reference):
    check = check_plant(damped, reference, MODES[:5], seconds=2.0)  # the free run is not looked at
    assert check.zeta == pytest.approx(grid.damping.ratios[:5], rel=1e-6)


def test_native_damping_tendons_equal_the_applied_dissipation(damped):
    start = damped.linearise().eigen[1][:, [0, 3, 8]] @ [1e-4, 1e-4, 1e-4]
    ends = []
    for model, dissipation in ((damped.spec.compile(), None), (damped.model, damped.dissipation)):
        data = mujoco.MjData(model)
        data.qpos[:] = start
        for _ in range(200):
            if dissipation is not None:
                data.qfrc_applied[:] = -dissipation @ data.qvel
            mujoco.mj_step(model, data)
        ends.append(data.qpos.copy())
    assert ends[1] == pytest.approx(ends[0], rel=0, abs=1e-8 * np.abs(start).max())


def test_written_model_runs_by_itself(plant, tmp_path):
    path = tmp_path / "grid.xml"
    path.write_text(plant.spec.to_xml())
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    sag = np.linalg.solve(plant.linearise().K, data.qfrc_smooth)
    assert np.abs(sag).max() < 1e-3  # six digits of the positions written
    assert model.body_mass == pytest.approx(plant.model.body_mass, rel=1e-5)
    assert model.body_inertia == pytest.approx(plant.model.body_inertia, rel=1e-3, abs=1e-9)


def test_forces_and_sensors_act_along_y_at_the_joints(plant, grid):
    model, data = plant.model, plant.new_data()
    names = [p.name for p in grid.point]
    assert list(plant.ports)[: len(names)] == names  # and then the elastic elements
    assert plant.deflections(data) == pytest.approx(0.0, abs=0)
    for i, tap in enumerate(plant.actuators):
        data.ctrl[:] = plant.control_matrix @ np.eye(len(plant.actuators))[i]
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator == pytest.approx(plant.port_rows([tap.at])[0], abs=1e-15)
    data.qvel[:] = np.random.default_rng(1).standard_normal(model.nv)
    data.qpos[:] = 1e-3 * np.random.default_rng(2).standard_normal(model.nv)
    mujoco.mj_forward(model, data)
    at = [s.at for s in grid.sensor]
    read = plant.read(data)
    assert read[: len(at)] == pytest.approx(plant.port_rows(at) @ data.qvel)
    for value, plate in zip(read[len(at) :], grid.plate, strict=True):  # a probe below a plate sees its swing
        joint = model.joint(f"{plate.at}:rx")
        swing = (
            data.qpos[joint.qposadr[0]] - plant.timestep / 2 * data.qvel[joint.dofadr[0]]
        )  # positions are half a step on
        assert value == pytest.approx(plate.offset * swing)
    assert data.sensordata[plant.travel] == pytest.approx([plant.port(name).position(data) for name in at])
    assert [plant.port("point13").position(data), plant.port("point22").position(data)] == [0.0, 0.0]


def test_stiff_option_has_the_real_plane_and_the_same_modes(grid, reference):
    stiff = build_grillage(grid, options=GrillageOptions.stiff(), damped=False)
    assert stiff.substeps(2000.0) == 9
    assert stiff.timestep < 0.81 * 2 / stiff.linearise().eigen[0][-1]
    assert np.abs(errors(stiff, reference)).max() < WITHIN


# -- refusals --------------------------------------------------------------------------------------------------------


def test_structures_of_another_kind_are_refused(grid, beam):
    with pytest.raises(BadStructure, match="one level bar that carries"):
        build_grillage(beam)
    heavy = tuple(dataclasses.replace(p, inertia_about_beam=0.5) for p in grid.plate)
    with pytest.raises(BadStructure, match="plate13"):
        build_grillage(dataclasses.replace(grid, plate=heavy))
    with pytest.raises(BadStructure, match="sees no motion"):
        build_grillage(dataclasses.replace(grid, sensor=(dataclasses.replace(grid.sensor[0], at="point13"),)))
    with pytest.raises(BadStructure, match="unstable"):
        build_grillage(grid, options=GrillageOptions(timestep=1e-3))
    with pytest.raises(BadStructure, match="at least 2"):
        GrillageOptions(elements_per_span=1)


def test_a_calibrated_variant_is_named_as_left_out(grid, plant):
    assert not any("boundary" in words for words in plant.left_out)
    assert any("'published'" in words for words in build_grillage(grid, "published", damped=False).left_out)
