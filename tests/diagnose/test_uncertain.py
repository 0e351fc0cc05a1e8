"""What is uncertain: the scale that no motion shows, servos' gains, and how strongly modes must be seen."""

from dataclasses import replace

import numpy as np
import pytest

from vlab.diagnose.parameters.mjcf import adjusted, common_scale, redundant, stiffness_of, uncertain_parameters
from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.parameters.reduced_model import observable
from vlab.diagnose.parameters.structure import edited, structure_parameters
from vlab.diagnose.parameters.structure_sensitivity import common_scale_of_structure, damping_of_structure
from vlab.fe import build_fe_model
from vlab.fe.damping import driven_modes
from vlab.plants.mjcf import build_mjcf
from vlab.structure import load_structure

RIG = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
<body name="a"><joint name="a" type="slide" axis="1 0 0" stiffness="900" damping="3" {more}/><geom size="0.1" mass="1"/></body>
<body name="b" pos="1 0 0"><joint name="b" type="slide" axis="1 0 0" stiffness="400" damping="2"/><geom size="0.1" mass="0.5"/></body>
</worldbody>
<tendon><fixed name="spring" stiffness="300" damping="0.2"><joint joint="a" coef="-1"/><joint joint="b" coef="1"/></fixed></tendon>
<actuator>{actuator}</actuator><sensor><jointpos name="x" joint="b"/></sensor></mujoco>"""
MOTOR, SERVO = '<motor name="drive" joint="a"/>', '<position name="drive" joint="a" kp="50"/>'


def rig(folder, actuator=MOTOR, more=""):
    (folder / "rig.xml").write_text(RIG.format(actuator=actuator, more=more))
    plant = build_mjcf("rig.xml", folder=folder)
    return plant, uncertain_parameters(plant, {"gain": 0.05, "stiffness": 0.04}, ["x"], [0])


@pytest.mark.parametrize(
    ("actuator", "more"), [(MOTOR, ""), (SERVO, ""), (MOTOR, 'armature="0.1"')], ids=["motor", "servo", "rotor"]
)
def test_a_common_scale_of_gains_and_impedances_leaves_every_motion(tmp_path, actuator, more):
    plant, parameters = rig(tmp_path, actuator, more)
    scale = common_scale(plant, parameters, loaded=False)
    assert scale is not None
    other = adjusted(plant, parameters, 0.1 * scale)
    factor = np.exp(0.1)
    for now, then in zip(
        (other.linearise().M, other.linearise().C, other.linearise().K),
        (plant.linearise().M, plant.linearise().C, plant.linearise().K),
        strict=True,
    ):
        np.testing.assert_allclose(now, factor * then, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(other.model.actuator_gainprm[0, 0], factor * plant.model.actuator_gainprm[0, 0])
    # the likeliest of all that do so: what two parameters share falls to each by its variance
    by = {p.name: (p.sd, value) for p, value in zip(parameters, scale, strict=True)}
    (sd, common), (own_sd, own) = by["stiffness"], by["joint:a:stiffness"]
    assert common / own > sd**2 / own_sd**2  # the common one serves three springs
    assert by["sensor:x"][1] == pytest.approx(0.0, abs=1e-12)


def test_a_measured_load_or_a_known_mass_shows_the_scale(tmp_path):
    plant, parameters = rig(tmp_path)
    assert common_scale(plant, parameters, loaded=True) is None
    assert common_scale(*rig(tmp_path, '<position name="drive" joint="a" kp="50" kv="2"/>'), loaded=False) is None


def test_dry_friction_goes_with_the_scale(tmp_path):
    plant, parameters = rig(tmp_path, more='frictionloss="0.1"')
    other = adjusted(plant, parameters, 0.1 * common_scale(plant, parameters, loaded=False))
    assert other.model.dof_frictionloss.max() == pytest.approx(0.1 * np.exp(0.1))
    (friction,) = (p for p in parameters if p.kind == "friction")
    assert friction.sd == pytest.approx(0.3)  # as its default says, for one joint has it


def test_what_all_have_in_common_against_what_each_has_is_no_direction_of_the_recordings(tmp_path):
    plant, parameters = rig(tmp_path)
    directions = redundant(parameters)
    assert len(directions) == 3  # of stiffness, damping and mass one each
    sd = np.array([p.sd for p in parameters])
    for direction in directions:
        other = adjusted(plant, parameters, 0.7 * sd * direction)
        for array in (
            "jnt_stiffness",
            "tendon_stiffness",
            "dof_damping",
            "tendon_damping",
            "body_mass",
            "body_inertia",
        ):
            np.testing.assert_allclose(getattr(other.model, array), getattr(plant.model, array), rtol=1e-9)
        np.testing.assert_allclose(other.model.actuator_gainprm, plant.model.actuator_gainprm, rtol=1e-9)
    assert redundant(structure_parameters(load_structure("beam"), {}, ["sensor:a"], [0])).size == 0


@pytest.mark.parametrize("name", ["beam", "grid"])
def test_structures_have_a_common_scale_too(name):
    structure = load_structure(name)
    parameters = structure_parameters(structure, {}, ["sensor:a"], [0])
    scale = common_scale_of_structure(structure, "published", parameters, loaded=False)
    assert scale is not None
    scaled = edited(structure, parameters, np.log(2.0) * scale)
    now, then = build_fe_model(scaled).linear, build_fe_model(structure).linear
    np.testing.assert_allclose(now.M, 2.0 * then.M, rtol=0, atol=1e-9 * np.abs(then.M).max())
    np.testing.assert_allclose(now.eigen[0], then.eigen[0], rtol=1e-6)
    np.testing.assert_allclose(np.abs(now.eigen[1][:, 0]), np.abs(then.eigen[1][:, 0]) / np.sqrt(2.0), atol=1e-6)
    assert {p.kind: value for p, value in zip(parameters, scale, strict=True)}["gain"] == 1.0
    assert common_scale_of_structure(structure, "published", parameters, loaded=True) is None
    certain = [replace(p, sd=0.0) if p.name == "fittings:mass" else p for p in parameters]
    assert common_scale_of_structure(structure, "published", certain, loaded=False) is None
    assert (
        common_scale_of_structure(structure, "published", [p for p in parameters if p.kind != "tension"], loaded=False)
        is None
    )


def test_a_servos_gain_multiplies_what_it_makes_of_the_motion(tmp_path):
    plant, parameters = rig(tmp_path, SERVO)
    theta = np.array([0.1 if p.name == "gain:drive" else 0.0 for p in parameters])
    softer = adjusted(plant, parameters, theta).linearise().K - plant.linearise().K
    np.testing.assert_allclose(softer, [[50.0 * (np.exp(0.1) - 1.0), 0.0], [0.0, 0.0]], atol=1e-9)


def test_the_stiffness_of_an_element_is_found_by_any_of_its_names(tmp_path):
    plant, _ = rig(tmp_path)
    assert stiffness_of(plant.model, ("site:none", "tendon:spring"))[0] == ("tendon_stiffness", 0)
    assert stiffness_of(plant.model, ("body:a",)) == []


def test_a_mode_is_seen_however_far_a_free_one_goes():
    """A shaft that turns freely beside a mode of 19 Hz: per unit of force it goes ten thousand times as far."""
    omega, shapes = np.array([0.0, 38.0, 121.0]), np.array([[0.5, 0.5, 0.3], [0.5, -0.5, 1e-9]])
    rows = ChannelRows(at_q=np.eye(2)[:1], at_v=np.zeros((1, 2)), at_a=np.zeros((1, 2)), rest=np.zeros(1))
    assert observable(rows, shapes, omega).all()
    blind = ChannelRows(at_q=np.eye(2)[1:], at_v=np.zeros((1, 2)), at_a=np.zeros((1, 2)), rest=np.zeros(1))
    assert observable(blind, shapes, omega).tolist() == [True, True, False]


def test_close_modes_of_the_twin_take_the_damping_of_their_place_in_the_order():
    """The grid's modes at 9.739 and 9.743 Hz, with ratios of .0100 and .0039, change places where bars weigh more."""
    structure = load_structure("grid")
    parameters = structure_parameters(structure, {"stiffness": 0.03, "damping": 0.15}, ["sensor:a"], [0], tuned=6)
    by_name = {p.name: i for i, p in enumerate(parameters)}
    theta = np.zeros(len(parameters))
    theta[[by_name["section:bar:mass"], by_name["damping:mode2"], by_name["damping"]]] = 0.03, 0.2, -0.1
    now = build_fe_model(structure).linear
    shapes = now.eigen[1]
    shapes = shapes[:, :60]
    M, C, K = (shapes.T @ a @ shapes for a in (now.M, now.C, now.K))
    at_coils = build_fe_model(structure).coils.T @ shapes
    damping = damping_of_structure(structure, parameters, M, K, at_coils, range(len(driven_modes(at_coils))))
    other = build_fe_model(edited(structure, parameters, theta)).linear
    changed = [shapes.T @ (a - b) @ shapes for a, b in ((other.M, now.M), (other.K, now.K))]
    C = C + damping.change(changed[0][None], changed[1][None], theta[None])[0]
    np.testing.assert_allclose(damping.change(0 * M[None], 0 * K[None], 0 * theta[None])[0], 0.0, atol=1e-12)
    inverse = np.linalg.inv(M + changed[0])
    matrix = np.block([[np.zeros_like(M), np.eye(len(M))], [-inverse @ (K + changed[1]), -inverse @ C]])
    roots = np.linalg.eigvals(matrix)
    roots = roots[roots.imag > 0][np.argsort(np.abs(roots[roots.imag > 0]))][:13]
    their = other.eigen[1][:, :13]
    expected = np.einsum("ij,ik,kj->j", their, other.C, their) / (2.0 * other.eigen[0][:13])
    # the modes left out are far above: what they would add is some 1e-4
    np.testing.assert_allclose(-roots.real / np.abs(roots), expected, rtol=2e-3)
    turned = np.abs(np.einsum("ij,ik,kj->j", their, now.M, shapes[:, :13]))
    assert turned.min() < 0.8  # modes have turned, and each has the ratio of its place
    # what a table of measured modes is fitted with: each keeps the ratio of its own shape
    by_shape = replace(damping, follows_shapes=True)
    places = slice(11, 13)  # the two
    theta[:] = 0.0
    theta[by_name["section:bar:mass"]] = 0.06
    other = build_fe_model(edited(structure, parameters, theta)).linear
    changed = [shapes.T @ (a - b) @ shapes for a, b in ((other.M, now.M), (other.K, now.K))]
    C = shapes.T @ now.C @ shapes + by_shape.change(changed[0][None], changed[1][None], theta[None])[0]
    modes = shapes.T @ now.M @ other.eigen[1][:, places]
    found = np.einsum("ij,ik,kj->j", modes, C, modes) / (2.0 * other.eigen[0][places])
    nominal = np.array(structure.damping.ratios)[[places.start + 1, places.start]]  # they have changed places
    np.testing.assert_allclose(found, nominal, rtol=0.03)
