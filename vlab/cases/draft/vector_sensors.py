"""Columns named after a sensor of three values, without its axis."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from vlab.cases.places import is_in_name
from vlab.plants.base import Plant

AXES = ("x", "y", "z")
"""AXES: ends of the names of a vector sensor's values."""
STATES = 8
"""STATES [1]: random states of the model at which a sensor is read."""


@dataclass(frozen=True, kw_only=True)
class VectorSensor:
    """Sensor of three values that a column is named after.

    Parameters
    ----------
    name, kind : str
        Name of the sensor, and kind of its values.
    moving : tuple of str
        Names of the values that the motion of the model changes.
    """

    name: str
    kind: str
    moving: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the three values."""
        return tuple(f"{self.name}.{axis}" for axis in AXES)


def vector_sensor(plant: Plant, columns: Sequence[str], kind: str) -> VectorSensor | None:
    """Return the only vector sensor whose name stands in a column's names.

    Parameters
    ----------
    plant : Plant
        Model.
    columns : sequence of str
        Names of one column.
    kind : str
        Quantity of the column; empty if unknown.

    Returns
    -------
    VectorSensor or None
        None for no such sensor, several, or one of another quantity.
    """
    kinds = {tap.name: tap.kind for tap in plant.sensors}
    bases = [name.removesuffix(".x") for name in kinds if name.endswith(".x")]
    whole = [base for base in bases if all(f"{base}.{axis}" in kinds for axis in AXES)]
    found = [base for base in whole if any(is_in_name(column, [base]) for column in columns)]
    if len(found) != 1:
        return None
    own = kinds[f"{found[0]}.x"]
    if kind and kind not in (own, own.removeprefix("angular-")):
        return None
    return VectorSensor(name=found[0], kind=own, moving=_moving(plant, found[0]))


def only_vector_sensor(plant: Plant) -> VectorSensor | None:
    """Return the sensor of three values that is the only sensor of a model.

    Parameters
    ----------
    plant : Plant
        Model.

    Returns
    -------
    VectorSensor or None
        None for other sensors.
    """
    bases = {tap.name.rpartition(".")[0] for tap in plant.sensors}
    return vector_sensor(plant, [bases.pop()], "") if len(bases) == 1 and "" not in bases else None


def is_accelerometer(plant: Plant, name: str) -> bool:
    """Return whether a sensor of three values feels gravity.

    Parameters
    ----------
    plant : Plant
        Model.
    name : str
        Name of the sensor in the MJCF model.

    Returns
    -------
    bool
        False for other sensors, and for places that are no sensor of the MJCF model.
    """
    number = mujoco.mj_name2id(plant.model, mujoco.mjtObj.mjOBJ_SENSOR, name)
    return number >= 0 and int(plant.model.sensor_type[number]) == int(mujoco.mjtSensor.mjSENS_ACCELEROMETER)


def _moving(plant: Plant, name: str) -> tuple[str, ...]:
    """Return the values of a sensor that differ between states of the model."""
    model, rng = plant.model, np.random.default_rng(0)
    data, rows = mujoco.MjData(model), []
    first = int(model.sensor(name).adr[0])
    for _ in range(STATES):
        mujoco.mj_resetData(model, data)
        mujoco.mj_integratePos(model, data.qpos, 0.1 * rng.standard_normal(model.nv), 1.0)
        data.qvel[:] = rng.standard_normal(model.nv)
        mujoco.mj_forward(model, data)
        rows.append(data.sensordata[first : first + len(AXES)].copy())
    spread = np.ptp(rows, axis=0)
    still = np.sqrt(np.finfo(float).eps) * spread.max()
    return tuple(f"{name}.{axis}" for axis, own in zip(AXES, spread, strict=True) if own > still)
