"""The stored configurations of a run: a plant put into one after the other, and the samples they belong to."""

from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from vlab.errors import BadRecording
from vlab.lab.experiment import Result
from vlab.plants.base import Plant
from vlab.signals import Array
from vlab.views.rrd import time_columns


def port_deflections(plant: Plant, frames: Array, names: Sequence[str]) -> Array:
    """Return the deflections (n_frames, n_names) [m] of ports from their equilibrium at stored configurations."""
    ports = [plant.port(name) for name in names]
    data = plant.new_data()
    mujoco.mj_forward(plant.model, data)
    rest = np.array([port.position(data) for port in ports])
    out = np.empty((len(frames), len(ports)))
    for row, _ in zip(out, configurations(plant, data, frames), strict=True):
        row[:] = [port.position(data) for port in ports]
    return out - rest


def configurations(plant: Plant, data: Any, frames: Array) -> Iterator[Array]:
    """Put `data` into one stored configuration after the other, as far as positions go."""
    model = plant.model
    if frames.ndim != 2 or frames.shape[1] != model.nq:
        raise BadRecording(
            f"stored configurations of shape {frames.shape} are not those of a plant with {model.nq} coordinates"
        )
    for configuration in frames:
        data.qpos[:] = configuration
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        yield configuration


def frame_columns(result: Result) -> list[Any]:
    """Return the timelines of the stored configurations."""
    return time_columns(result.frame_times, frame_steps(result))


def frame_steps(result: Result) -> NDArray[np.int64]:
    """Return the sample that each stored configuration belongs to."""
    steps = np.searchsorted(result.recording.time, result.frame_times - 1e-9)
    return np.asarray(np.clip(steps, 0, len(result.recording) - 1), dtype=np.int64)
