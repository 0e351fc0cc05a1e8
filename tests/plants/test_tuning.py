"""Frequencies that a structure is tuned to: the same in the FE model and in every plant, shapes and ratios as they were."""

import dataclasses

import mujoco
import numpy as np
import pytest

from vlab.diagnose.model_kinds.structure_file import structure_toml
from vlab.errors import BadStructure
from vlab.fe import build_fe_model
from vlab.fe.damping import driven_modes
from vlab.modal.mac import mac
from vlab.plants import build_plant
from vlab.structure import load_structure
from vlab.structure.discretisation import Tuning

FACTORS = (1.01, 0.99, 1.003, 1.0, 1.02)


@pytest.fixture(scope="module")
def tuned(beam):
    return dataclasses.replace(beam, tuning=Tuning(frequencies=FACTORS, of_fe=7))


def heard(linear, rows):
    """Return the modes of a model that move at some rows: frequency, damping ratio, shape there.

    The arms' swing against each other is moved a little (3e-4) where MuJoCo slows the fastest modes of the FE plant.
    """
    omega, shapes = linear.eigen
    at = rows @ shapes
    which = np.flatnonzero(np.abs(at).max(axis=0) > 1e-3 * np.abs(at).max())[:6]
    return omega[which], linear.zeta[which], at[:, which]


def test_frequencies_of_the_fe_model_are_multiplied(beam, tuned):
    before, after = (build_fe_model(s, "physical") for s in (beam, tuned))
    (w0, z0, x0), (w1, z1, x1) = (heard(m.linear, m.coils.T) for m in (before, after))
    assert w1 / w0 == pytest.approx((*FACTORS, 1.0), rel=1e-9)
    assert z1 == pytest.approx(z0, rel=1e-9)  # the ratios are prescribed, so the dampers follow
    assert np.diag(mac(x0, x1)) == pytest.approx(1.0, abs=1e-9)
    total = np.zeros_like(after.linear.K)
    for piece in after.pieces:
        total[np.ix_(piece.columns, piece.columns)] += piece.K
    assert np.abs(total - after.linear.K).max() < 1e-12 * np.abs(total).max()


@pytest.mark.parametrize("plant", ["composite", "fe", "modal"])
def test_every_plant_has_them(beam, tuned, plant):
    own = dataclasses.replace(beam, tuning=Tuning(of_fe=7))
    before, after = (build_plant(s, plant, "physical") for s in (own, tuned))
    rows = before.port_rows(beam.coil_places)
    (w0, z0, _), (w1, z1, _) = (heard(p.linearise(), rows) for p in (before, after))
    assert w1 / w0 == pytest.approx((*FACTORS, 1.0), rel=1e-6)
    assert z1 == pytest.approx(z0, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count", "off"), [("beam", 7, 0.006), ("grid", 15, 0.016)])
def test_a_coarse_mesh_has_the_modes_of_the_fe_model(name, count, off):
    structure = load_structure(name)
    like = dataclasses.replace(structure, tuning=Tuning(of_fe=count))
    fe, before, after = (
        build_fe_model(structure, "physical"),
        *(build_plant(s, "composite", "physical") for s in (structure, like)),
    )
    points = [p.name for p in structure.point if p.name in after.ports]
    at_coils = after.port_rows(structure.coil_places)
    shapes = []
    for linear, coils, rows in (
        (fe.linear, fe.coils.T, fe.deflections(points)),
        *((p.linearise(), at_coils, p.port_rows(points)) for p in (before, after)),
    ):
        omega, phi = linear.eigen
        first = driven_modes(coils @ phi)[:count]
        shapes.append((omega[first], rows @ phi[:, first], linear.zeta[first]))
    (w, x, z), (_, coarse, _), (w1, x1, z1) = shapes
    assert w1 == pytest.approx(w, rel=1e-6)
    assert z1 == pytest.approx(z, rel=1e-6)
    # mass-normalised shapes at all points, which rotation among close modes of the plant's own leaves this much off
    sign = np.sign(np.sum(x * x1, axis=0))
    assert np.linalg.norm(x1 * sign - x) < off * np.linalg.norm(x)
    assert np.linalg.norm(np.abs(coarse) - np.abs(x)) > (0.1 if name == "grid" else 0.0) * np.linalg.norm(x)


@pytest.mark.slow
def test_the_grid_answers_as_the_fe_model_does():
    grid = load_structure("grid")
    fe = build_fe_model(grid, "physical")
    bare, like = (
        build_plant(dataclasses.replace(grid, tuning=t), "composite", "physical") for t in (None, Tuning(of_fe=15))
    )
    sensors, coils = [sensor.at for sensor in grid.sensor], grid.coil_places

    def mobility(linear, forces, rows):
        omega, phi = (part[..., :60] for part in linear.eigen)  # up to 60 Hz and more
        damping = phi.T @ linear.C @ phi
        s = 2j * np.pi * np.linspace(0.3, 15.0, 600)
        whole = [np.diag(omega**2 + x**2) + x * damping for x in s]
        return np.array([x * (rows @ phi) @ np.linalg.solve(a, phi.T @ forces) for x, a in zip(s, whole, strict=True)])

    wanted = mobility(fe.linear, fe.coils, fe.deflections(sensors))
    off = [
        np.linalg.norm(mobility(p.linearise(), p.port_rows(coils).T, p.port_rows(sensors)) - wanted)
        / np.linalg.norm(wanted)
        for p in (bare, like)
    ]
    assert off[0] > 0.2
    assert off[1] < 0.025  # modal masses of two links a bar stay up to 2.5 % off


def test_more_modes_of_the_fe_model_than_there_are_are_refused(beam):
    with pytest.raises(BadStructure, match="modes that the coils drive"):
        build_plant(dataclasses.replace(beam, tuning=Tuning(of_fe=400)), "composite", "physical")


@pytest.mark.parametrize("plant", ["composite", "fe"])
def test_native_tendons_equal_the_applied_forces(tuned, plant):
    """The written-out model carries springs and dampers as tendons; while running they act as matrices: the same motion."""
    own = build_plant(tuned, plant, "physical")
    start = own.linearise().eigen[1][:, [0, 2, 5]] @ [1e-4, 1e-4, 1e-4]
    ends = []
    for model, prescribed in ((own.spec.compile(), None), (own.model, own.prescribed)):
        data = mujoco.MjData(model)
        data.qpos[:] = model.qpos0 + start
        for _ in range(500):
            if prescribed is not None:
                prescribed(data.qpos, data.qvel, data.qfrc_applied)
            mujoco.mj_step(model, data)
        ends.append(data.qpos - model.qpos0)
    assert ends[1] == pytest.approx(ends[0], rel=0, abs=1e-8 * np.abs(start).max())  # summed in another order


def test_a_written_structure_keeps_its_tuning(tuned, tmp_path):
    path = tmp_path / "tuned.toml"
    path.write_text(structure_toml(tuned))
    assert load_structure(path).tuning == tuned.tuning
