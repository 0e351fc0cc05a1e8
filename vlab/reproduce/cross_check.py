"""Cross-check of FE model, plants and published values of a structure."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import linear_sum_assignment

from vlab.design.published_tables import published_tables
from vlab.fe.model import FeModel
from vlab.fe.reduced import build_reduced_model
from vlab.fe.second_order import SecondOrderModel
from vlab.modal.mac import mac
from vlab.plants import Plant, build_plant
from vlab.plants.base import check_run
from vlab.plants.build import STEPPED
from vlab.signals import Array, ModalModel
from vlab.structure.model import Structure

CLOSE = 0.006
"""CLOSE [-]: relative distance of modes compared as a group; models that agree within 0.6 % cannot distinguish them."""
NEAR = 1.5
"""NEAR [-]: largest frequency ratio of paired modes, for few points make shapes look alike. A Guyan reduction raises the
grid's highest retained modes up to 1.4 times."""
SILENT = 1e-6
"""SILENT [-]: relative motion at the points of the drawing below which a mode is not compared (bounce on cables)."""
PUBLISHED = {
    "full": ("analytical",),
    "exact": ("full model and exact reduction", "analytical"),
    "guyan": ("guyan reduction", "analytical"),
    "corrected-guyan": ("analytical",),
}
"""PUBLISHED: table columns of a model's frequencies; those of the full model if it has none."""
FREE_RUN_S = 10.0
"""FREE_RUN_S [s]: duration of a free run for the numerical damping; longer runs resolve less damping."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlantCheck:
    """Comparison of a plant with the FE model.

    Parameters
    ----------
    freq, mac : (n_modes,) array
        Frequency [Hz] and MAC of the plant's mode for each FE mode; within a close group the MAC with its subspace.
    shapes : (n_points, n_modes) array
        Shapes at the points of the drawing, unit maximum.
    numerical_damping : float
        Damping ratio of the highest compared mode by integration alone [-].
    real_time_factor : float
        Simulated over elapsed time of the bare plant on this machine.
    """

    plant: Plant
    freq: Array
    mac: Array
    shapes: Array
    zeta: Array
    numerical_damping: float
    real_time_factor: float


@dataclass(frozen=True, kw_only=True, eq=False)
class CrossCheck:
    """All results of `vlab modes`."""

    structure: Structure
    fe: FeModel
    model: str
    modes: Array
    published: Array | None
    measured: Array | None
    plants: dict[str, PlantCheck]

    @property
    def points(self) -> list[str]:
        """Points of the compared shapes."""
        return [p.name for p in self.structure.point]

    def fe_modes(self) -> ModalModel:
        """Return the FE modes at the points of the drawing."""
        shapes = self.fe.deflections(self.points) @ self.fe.linear.eigen[1][:, self.modes]
        return ModalModel(
            freq=self.fe.linear.freq[self.modes],
            zeta=self.fe.linear.zeta[self.modes],
            shapes=shapes / shapes[np.abs(shapes).argmax(axis=0), np.arange(shapes.shape[1])],
            coordinates=tuple(self.points),
        )

    def plant_modes(self, name: str) -> ModalModel:
        """Return the paired modes of a plant at the points."""
        check = self.plants[name]
        return ModalModel(freq=check.freq, zeta=check.zeta, shapes=check.shapes, coordinates=tuple(self.points))

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        rows = []
        for i, j in enumerate(self.modes):
            rows.append(
                {
                    "mode": i + 1,
                    "published_hz": _cell(self.published, i),
                    "measured_hz": _cell(self.measured, i),
                    "fe_hz": float(self.fe.linear.freq[j]),
                    "plant_hz": {"composite": None, "fe": None, "modal": None}
                    | {name: float(check.freq[i]) for name, check in self.plants.items()},
                    "mac": {name: float(check.mac[i]) for name, check in self.plants.items()},
                    "zeta": float(self.fe.linear.zeta[j]),
                    "plant_zeta": {name: float(check.zeta[i]) for name, check in self.plants.items()},
                }
            )
        return {
            "structure": self.structure.name,
            "variant": self.fe.variant,
            "model": self.model,
            "modes": rows,
            "plants": {
                name: {
                    "dof": int(check.plant.model.nv),
                    "timestep_s": check.plant.timestep,
                    "numerical_damping_ratio": check.numerical_damping,
                    "real_time_factor": check.real_time_factor,
                    "left_out": list(check.plant.left_out),
                }
                for name, check in self.plants.items()
            },
        }


def _cell(values: Array | None, i: int) -> float | None:
    return float(values[i]) if values is not None and i < len(values) else None


def cross_check(
    structure: Structure,
    variant: str = "published",
    *,
    model: str = "full",
    modes: int | None = None,
    plants: Sequence[str] = (),
    seconds: float = FREE_RUN_S,
) -> CrossCheck:
    """Compare frequencies and shapes of FE model, plants and publication.

    Modes that no coil can drive (opposed arms) are omitted, for no experiment measured them.

    Parameters
    ----------
    structure : Structure
        Structure.
    variant : str
        Variant of the model.
    model : str
        Reduction of the FE model (see `vlab.fe.reduced`); the plants stay complete.
    modes : int or None
        Number of modes; all published ones by default.
    plants : sequence of str
        Names of the plants; all that MuJoCo steps by default.
    seconds : float
        Duration of a free run [s].

    Returns
    -------
    CrossCheck
        Comparison.
    """
    fe = build_reduced_model(structure, model, variant)
    tables = published_tables(structure.name)
    table = next((t for t in tables if "analytical" in t.columns), None)
    column = next(((t, name) for name in PUBLISHED[model] for t in tables if name in t.columns), None)
    count = modes if modes is not None else len(table.rows) if table is not None else 6
    driven = fe.measured[:count]
    return CrossCheck(
        structure=structure,
        fe=fe,
        model=model,
        modes=driven,
        published=None if column is None else column[0].column(column[1]),
        measured=None if table is None else table.column("experimental"),
        plants={
            name: check_plant(build_plant(structure, name, variant), fe, driven, seconds=seconds)
            for name in (plants or STEPPED)
        },
    )


def check_plant(plant: Plant, fe: FeModel, modes: Array, *, seconds: float = FREE_RUN_S) -> PlantCheck:
    """Pair a plant's modes with the FE model's by MAC.

    Parameters
    ----------
    plant : Plant
        Plant.
    fe : FeModel
        FE model.
    modes : array
        Compared modes of the FE model.
    seconds : float
        Duration of the free run [s], see `numerical_damping`.

    Returns
    -------
    PlantCheck
        Comparison of the plant.
    """
    names = [p.name for p in fe.structure.point]
    linear = plant.linearise()
    shapes = plant.port_rows(names) @ linear.eigen[1]
    seen = np.flatnonzero(np.abs(shapes).max(axis=0) > SILENT * np.abs(shapes).max())
    target = fe.deflections(names) @ fe.linear.eigen[1][:, modes]
    apart = np.abs(np.log(linear.freq[seen][None, :] / fe.linear.freq[modes][:, None]))
    likeness = mac(target, shapes[:, seen]) - (apart > np.log(NEAR))  # a MAC is at most 1, so near modes come first
    rows, columns = linear_sum_assignment(-likeness)
    chosen = seen[columns[np.argsort(rows)]]
    matched = shapes[:, chosen]
    scale = matched[np.abs(matched).argmax(axis=0), np.arange(matched.shape[1])]
    return PlantCheck(
        plant=plant,
        freq=linear.freq[chosen],
        mac=np.array(
            [_subspace_mac(t, shapes[:, _close(linear.freq, k, seen)]) for t, k in zip(target.T, chosen, strict=True)]
        ),
        shapes=matched / scale,
        zeta=linear.zeta[chosen],
        numerical_damping=numerical_damping(plant, linear, int(chosen[-1]), seconds=seconds),
        real_time_factor=real_time_factor(plant),
    )


def _close(freq: Array, mode: int, among: Array) -> Array:
    """Return the modes within `CLOSE` of one, itself included."""
    return among[np.abs(freq[among] / freq[mode] - 1) < CLOSE]


def _subspace_mac(target: Array, shapes: Array) -> float:
    """Return the MAC of a shape with the subspace of a group.

    Closer modes than the agreement of the models mix arbitrarily, but their subspace is well defined.
    """
    basis = np.linalg.qr(shapes)[0]
    return float(np.sum((basis.T @ target) ** 2) / np.sum(target**2))


def numerical_damping(plant: Plant, linear: SecondOrderModel, mode: int, *, seconds: float = FREE_RUN_S) -> float:
    """Return the damping ratio of a mode by integration alone.

    The plant without dampers runs free from the mode shape. A sinusoid is fitted to the modal amplitude over one
    second at the start and at the end.

    Parameters
    ----------
    plant : Plant
        Plant.
    linear : SecondOrderModel
        Linearised plant.
    mode : int
        Number of the mode, from 0.
    seconds : float
        Duration of the free run [s].

    Returns
    -------
    float
        Damping ratio [-].
    """
    model = plant.spec.compile() if plant.dissipation is None else plant.model
    model = mujoco.MjModel.__copy__(model)
    model.dof_damping[:] = 0.0
    omega, shapes = linear.eigen
    data = mujoco.MjData(model)
    points = [name for name, port in plant.ports.items() if port.unit == "m" and not port.tag]
    largest = np.abs(plant.port_rows(points) @ shapes[:, mode]).max()
    size = 1e-4 / largest  # largest motion 0.1 mm: small motion
    start = size * shapes[:, mode]
    mujoco.mj_integratePos(model, data.qpos, start, 1.0)
    momentum = linear.M @ shapes[:, mode]
    steps = round(seconds / plant.timestep)
    second = round(1.0 / plant.timestep)
    amplitudes = np.zeros(steps)
    offset = np.zeros(model.nv)
    for i in range(steps):
        mujoco.mj_step(model, data)
        if i < second or i >= steps - second:
            mujoco.mj_differentiatePos(model, offset, 1.0, model.qpos0, data.qpos)
            amplitudes[i] = momentum @ offset
    check_run(model, data, steps * plant.timestep)
    discrete = (
        2 / plant.timestep * np.arcsin(omega[mode] * plant.timestep / 2)
    )  # frequency of the semi-implicit Euler step
    sizes = []
    for window in (slice(0, second), slice(steps - second, steps)):
        t = np.arange(steps)[window] * plant.timestep
        basis = np.column_stack([np.cos(discrete * t), np.sin(discrete * t)])
        sizes.append(float(np.hypot(*np.linalg.lstsq(basis, amplitudes[window], rcond=None)[0])))
    return float(np.log(sizes[0] / sizes[1]) / (omega[mode] * (seconds - 1.0)))


def real_time_factor(plant: Plant, *, seconds: float = 1.0) -> float:
    """Return simulated over elapsed time, best of three short runs.

    Parameters
    ----------
    plant : Plant
        Plant.
    seconds : float
        Simulated duration [s].

    Returns
    -------
    float
        Factor [-].
    """
    data = plant.new_data()
    steps = round(seconds / plant.timestep)
    best = np.inf
    for _ in range(3):
        begun = time.perf_counter()
        mujoco.mj_step(plant.model, data, nstep=steps)
        best = min(best, time.perf_counter() - begun)
    return float(seconds / best)
