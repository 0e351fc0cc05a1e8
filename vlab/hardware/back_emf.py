"""The braking of coils whose current is not controlled: what their own voltage drives through what they are connected to.

A coil of Bl that moves with v gives Bl v; through a resistance R that is a current, and the force Bl^2/R v against the
motion. For the coils of sensors it is a damper at every one of them, so it stands in the matrices of a plant or a model; a
mode of mass-normalised shape phi gains the modal damping sum(phi_i^2) Bl^2/R.
"""

from dataclasses import replace

import mujoco
import numpy as np

from vlab.fe.model import FeModel
from vlab.hardware.laboratory import Hardware
from vlab.plants.base import Plant
from vlab.signals import Array


def brake_plant(plant: Plant, hardware: Hardware) -> Plant:
    """Return a plant with the braking of its velocity sensors; the same plant where they are buffered."""
    damping = hardware.velocity_sensor.back_emf_damping
    if damping == 0.0:
        return plant
    rows = _velocity_rows(plant)
    own = np.zeros((plant.model.nv,) * 2) if plant.dissipation is None else plant.dissipation
    return replace(plant, dissipation=own + damping * rows.T @ rows)


def brake_model(fe: FeModel, hardware: Hardware) -> FeModel:
    """Return an FE model with the braking of sensors without a buffer and of force coils without current control."""
    structure, linear = fe.structure, fe.linear
    for damping, places in (
        (hardware.velocity_sensor.back_emf_damping, [sensor.at for sensor in structure.sensor]),
        (hardware.coil.back_emf_damping, structure.coil_places),
    ):
        if damping > 0:
            linear = linear.with_rate_feedback(fe.deflections(places).T, damping * np.eye(len(places)))
    return fe if linear is fe.linear else replace(fe, linear=linear)


def _velocity_rows(plant: Plant) -> Array:
    """Return the velocity of every coil sensor per generalised velocity at equilibrium, (n_coils, nv)."""
    data, coils = plant.new_data(), [i for i, tap in enumerate(plant.sensors) if tap.kind == "velocity"]
    rows = np.zeros((len(coils), plant.model.nv))
    for j in range(plant.model.nv):
        data.qvel[:] = 0.0
        data.qvel[j] = 1.0
        mujoco.mj_forward(plant.model, data)
        rows[:, j] = plant.read(data)[coils]
    return rows
