"""Braking of coils without current control by their back-EMF.

A coil of constant Bl with velocity v has the voltage Bl v. Through a resistance R the voltage drives a current with the
force Bl^2/R v against the motion. For sensor coils the braking is a damper at each coil, in the matrices of a plant or
model. A mode of mass-normalised shape phi gains the modal damping sum(phi_i^2) Bl^2/R.
"""

from dataclasses import replace

import mujoco
import numpy as np

from vlab.fe.model import FeModel
from vlab.hardware.laboratory import Hardware
from vlab.plants.base import Plant
from vlab.signals import Array


def brake_plant(plant: Plant, hardware: Hardware) -> Plant:
    """Return a plant with the braking of its velocity sensors.

    Buffered sensors leave the plant unchanged.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.
    hardware : Hardware
        Hardware between law and structure.

    Returns
    -------
    Plant
        Plant.
    """
    damping = hardware.velocity_sensor.back_emf_damping
    if damping == 0.0:
        return plant
    rows = _velocity_rows(plant)
    own = np.zeros((plant.model.nv,) * 2) if plant.dissipation is None else plant.dissipation
    return replace(plant, dissipation=own + damping * rows.T @ rows)


def brake_model(fe: FeModel, hardware: Hardware) -> FeModel:
    """Return an FE model with the braking of its coils.

    Sensors without a buffer and force coils without current control brake.

    Parameters
    ----------
    fe : FeModel
        FE model.
    hardware : Hardware
        Hardware between law and structure.

    Returns
    -------
    FeModel
        FE model.
    """
    structure, linear = fe.structure, fe.linear
    for damping, places in (
        (hardware.velocity_sensor.back_emf_damping, [sensor.at for sensor in structure.sensor]),
        (hardware.coil.back_emf_damping, structure.coil_places),
    ):
        if damping > 0:
            linear = linear.with_rate_feedback(fe.deflections(places).T, damping * np.eye(len(places)))
    return fe if linear is fe.linear else replace(fe, linear=linear)


def _velocity_rows(plant: Plant) -> Array:
    """Return the coil sensors' velocity rows, (n_coils, nv).

    The rows are per generalised velocity at equilibrium.
    """
    data, coils = plant.new_data(), [i for i, tap in enumerate(plant.sensors) if tap.kind == "velocity"]
    rows = np.zeros((len(coils), plant.model.nv))
    for j in range(plant.model.nv):
        data.qvel[:] = 0.0
        data.qvel[j] = 1.0
        mujoco.mj_forward(plant.model, data)
        rows[:, j] = plant.read(data)[coils]
    return rows
