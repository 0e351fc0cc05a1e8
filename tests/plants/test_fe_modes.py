"""A plant's first modes as the FE model has them: in steps, at every place, at coils and sensors, and beside these."""

import dataclasses
from itertools import pairwise, zip_longest

import mujoco
import numpy as np
import pytest

from vlab.errors import BadStructure, UnknownName
from vlab.fe import build_fe_model
from vlab.fe.damping import driven_modes
from vlab.plants import build_plant
from vlab.plants.tendon_points import fe_element_ports
from vlab.structure import load_structure
from vlab.structure.discretisation import Tuning
from vlab.structure.model import Damping, Span

COUNT = 7
SHIFT = (2e-3, 0.0, -1e-3)
COIL_SHIFT = (0.0, 1.5e-3)


@pytest.fixture(scope="module")
def fe(beam):
    return build_fe_model(beam, "physical")


@pytest.fixture(scope="module")
def like(beam):
    """The beam's links with the FE model's modes in steps of half a millisecond; two sensors and a coil beside their points."""
    tuning = Tuning(of_fe=COUNT, at_step=5e-4, beside=SHIFT, coils_beside=COIL_SHIFT)
    return build_plant(dataclasses.replace(beam, tuning=tuning), "composite", "physical")


def modes(fe, plant):
    """Return frequencies and shapes of the modes that the coils drive, of the FE model and of a plant, alike in sign."""
    linear, at_coils = plant.linearise(), plant.port_rows(fe.structure.coil_places)
    out = []
    for model, rows in ((fe.linear, fe.coils.T), (linear, at_coils)):
        omega, shapes = model.eigen
        driven = driven_modes(rows @ shapes)[:COUNT]
        out.append((omega[driven], shapes[:, driven], rows @ shapes[:, driven]))
    (w, x, at), (w1, x1, at1) = out
    return w, x, w1, x1 * np.sign(np.sum(at * at1, axis=0))


def test_steps_of_that_length_show_the_frequencies(fe, like):
    w, _, w1, _ = modes(fe, like)
    h = 5e-4
    assert np.all(w1 < w)
    assert w1 == pytest.approx(w * (1 - (w * h) ** 2 / 24), rel=1e-5)
    # the eigenvalues of velocity and displacement under v += -h w1^2 x, x += h v
    steps = np.array([[[1.0, -h * a**2], [h, 1.0 - (h * a) ** 2]] for a in w1])
    shown = np.abs(np.log(np.linalg.eigvals(steps).astype(complex))).max(axis=1) / h
    assert shown == pytest.approx(w, rel=1e-6)  # to what the driven modes' damping changes of the shapes


def test_every_port_sees_them_as_the_fe_model_does(fe, like):
    _, x, _, x1 = modes(fe, like)
    points = {p.name: fe.deflection(p.name) for p in fe.structure.point if p.name in like.ports}
    wanted = {name: [row] for name, row in points.items()}
    wanted |= {
        name: [port.row(None), *(more.row(None) for more in port.more)]
        for name, port in fe_element_ports(fe, points, lambda row: row).items()
    }
    data = like.new_data()
    both = like.ports.keys() & wanted.keys()
    assert {"beam:30in-40in", "cable-upper", "crosspiece-left", "tension"} <= both
    for name in both:
        ours = [like.ports[name], *like.ports[name].more]
        for port, row in zip(ours, wanted[name], strict=True):
            np.testing.assert_allclose(port.row(data) @ x1, row @ x, atol=1e-6 * np.abs(row @ x).max())
            # and its position is the integral of its row
            data.qpos[:] += 1e-6 * x1[:, 1]
            mujoco.mj_kinematics(like.model, data)
            moved = port.position(data)
            data.qpos[:] -= 1e-6 * x1[:, 1]
            mujoco.mj_kinematics(like.model, data)
            assert (moved - port.position(data)) / 1e-6 == pytest.approx((row @ x)[1], abs=1e-4 * np.abs(row @ x).max())


def test_coils_push_and_sensors_read_them_both_beside_their_points(fe, like):
    _, x, _, x1 = modes(fe, like)
    data = like.new_data()
    for j, (coil, beside) in enumerate(zip_longest(fe.structure.coil, COIL_SHIFT, fillvalue=0.0)):
        command = np.zeros(len(like.actuators))
        command[j] = 1.0
        data.ctrl[:] = like.control_matrix @ command
        mujoco.mj_forward(like.model, data)
        pushed = fe.deflection(coil.at) + beside * fe.slope(coil.at)
        np.testing.assert_allclose(x1.T @ data.qfrc_actuator, pushed @ x, atol=1e-8)
    data.ctrl[:] = 0.0
    data.qvel[:] = x1[:, 2]
    mujoco.mj_forward(like.model, data)
    read = like.read(data)
    for i, (sensor, beside) in enumerate(zip(fe.structure.sensor, SHIFT, strict=False)):
        there = fe.deflection(sensor.at) + beside * fe.slope(sensor.at)
        assert read[i] == pytest.approx(there @ x[:, 2], rel=1e-6)


def test_the_slope_is_that_of_the_deflection(fe):
    low, at, high = (fe.deflection(place) for place in ("19.99in", "20in", "20.01in"))
    slope = fe.slope("20in")
    towards = np.sign(fe.structure.position("30in")[1] - fe.structure.position("20in")[1])
    first = next(bar for bar in fe.structure.bar if "20in" in bar.points)
    along = towards * np.sign(np.subtract(*[fe.structure.position(first.points[i])[1] for i in (-1, 0)]))
    shapes = fe.linear.eigen[1][:, :COUNT]
    np.testing.assert_allclose(
        along * slope @ shapes, (high - low) @ shapes / (0.02 * 0.0254), atol=1e-5 * np.abs(slope @ shapes).max()
    )
    assert not np.allclose(at, high)
    assert fe.slope("nowhere") is None


@pytest.mark.parametrize(
    ("tuning", "message"),
    [
        ({"of_fe": COUNT, "at_step": 0.02}, "cannot be seen in such steps"),
        ({"of_fe": COUNT, "beside": (0.0,) * 9}, "beside has 9 entries; there are"),
        ({"beside": (1e-3,)}, "say with of_fe"),
    ],
)
def test_what_makes_no_sense_is_refused(beam, tuning, message):
    with pytest.raises(BadStructure, match=message):
        build_plant(dataclasses.replace(beam, tuning=Tuning(**tuning)), "composite", "physical")


@pytest.mark.parametrize("name", ["beam", "crosspiece"])
def test_a_bar_with_the_same_deviation_in_every_span_is_a_bar_of_another_section(beam, name):
    bar = next(bar for bar in beam.bar if bar.name == name)
    spans = tuple(
        Span(name=f"{a}-{b}", bar=bar.name, between=(b, a), stiffness=1.1, mass=0.95) for a, b in pairwise(bar.points)
    )
    section = {**beam.section, bar.section: beam.section[bar.section].scaled(stiffness=1.1, mass=0.95)}
    there, here = (
        build_fe_model(dataclasses.replace(beam, **what), "physical").linear
        for what in ({"span": spans}, {"section": section})
    )
    np.testing.assert_allclose(there.M, here.M, rtol=0, atol=1e-12 * np.abs(here.M).max())
    np.testing.assert_allclose(there.K, here.K, rtol=0, atol=1e-12 * np.abs(here.K).max())


def test_every_plant_has_the_deviations_of_its_spans(beam):
    grid = load_structure("grid")
    top = next(bar for bar in grid.bar if bar.carries)
    grid_span = next(bar for bar in grid.bar if bar.name == "diagonal-1").points[:2]
    for structure, bar, between, variant, modes, share in (
        (beam, "beam", ("30in", "40in"), "physical", 8, 0.1),
        (grid, top.name, top.points[3:5], "published", 4, 0.35),
        (grid, "diagonal-1", grid_span, "published", 4, 0.35),  # two links per hanging bar
    ):
        span = Span(name="soft", bar=bar, between=between, stiffness=0.8, mass=1.05)
        deviant = dataclasses.replace(structure, span=(span,))
        shifts = []
        for plant in ("composite", "fe"):
            w, w1 = (build_plant(s, plant, variant).linearise().eigen[0][:modes] for s in (structure, deviant))
            shifts.append(np.log(w1 / w))
        # links take the stiffness of a span at their hinges: a coarse copy of the FE model
        assert shifts[0] == pytest.approx(shifts[1], abs=share * np.abs(shifts[1]).max())
        assert np.abs(shifts[1]).max() > 1e-4


@pytest.mark.parametrize(
    ("bar", "between", "known"), [("beem", ("30in", "40in"), "crosspiece"), ("beam", ("30in", "50in"), "30in-40in")]
)
def test_a_span_names_a_bar_and_neighbouring_points(beam, bar, between, known):
    with pytest.raises(UnknownName, match=known):
        dataclasses.replace(beam, span=(Span(name="soft", bar=bar, between=between),))


def test_a_deviating_arm_leaves_every_measured_mode_its_ratio(beam):
    """Arms in opposition are silent on the even beam; they couple to two measured modes within a tenth of a hertz."""
    ratios = (0.001, 0.002, 0.003, 0.004, 0.005, 0.006)
    even = dataclasses.replace(beam, damping=Damping(ratios=ratios, higher=0.0005))
    span = Span(name="left", bar="crosspiece", between=("tip-left", "20in"), stiffness=0.99)
    deviant = dataclasses.replace(even, span=(span,))
    for structure, driven in ((even, 6), (deviant, 7)):
        fe = build_fe_model(structure, "physical")
        motion = np.abs(fe.coils.T @ fe.linear.eigen[1]).max(axis=0)
        assert np.sum(motion[:7] > 1e-3 * motion.max()) == driven
        assert fe.measured[:6].tolist() == [0, 1, 3, 4, 5, 6]
        assert fe.linear.zeta[fe.measured[:6]] == pytest.approx(ratios)
        assert fe.linear.zeta[2] == pytest.approx(0.0005)
        for tuning in (None, Tuning(of_fe=COUNT)):
            plant = build_plant(dataclasses.replace(structure, tuning=tuning), "composite", "physical")
            seen = np.abs(plant.port_rows(fe.points) @ plant.linearise().eigen[1]).max(axis=0) > 1e-3
            zeta = plant.linearise().zeta[seen][:7]
            assert zeta == pytest.approx([*ratios[:2], 0.0005, *ratios[2:]], rel=0.02)
