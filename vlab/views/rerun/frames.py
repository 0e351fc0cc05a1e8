"""Stored configurations of a run, with their samples."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from vlab.errors import BadRecording
from vlab.lab.experiment import Result
from vlab.plants.base import Plant
from vlab.signals import Array
from vlab.structure.model import Structure
from vlab.views.rerun.rrd import time_columns

MOTION = "motion"
"""MOTION: entity of the true deflections in a Rerun file, for views of several runs."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Motion of the points of a structure.

    Parameters
    ----------
    names : tuple of str
        Points.
    times : (n,) array
        Times of the pictures [s].
    steps : (n,) int array
        Sample of the recording of each picture.
    deflections : (n, n_points) array
        Deflections from equilibrium [m].
    """

    names: tuple[str, ...]
    times: Array
    steps: NDArray[np.int64]
    deflections: Array

    @classmethod
    def of(
        cls, structure: Structure, plant: Plant, result: Result, *, since: int = 0, until: int | None = None
    ) -> "Motion":
        """Return points' motion at configurations from `since` to `until`."""
        names, part = tuple(plant.points_of(structure)), slice(since, until)
        deflections = port_deflections(plant, result.frames[part], names)
        times, steps = result.frame_times[part], frame_steps(result)[part]
        return cls(names=names, times=times, steps=steps, deflections=deflections)

    @property
    def indexes(self) -> list[Any]:
        """The timelines of the pictures."""
        return time_columns(self.times, self.steps)

    @property
    def largest(self) -> float:
        """Largest deflection [m]."""
        return float(np.abs(self.deflections).max(initial=0.0))

    def log(self, stream: Any) -> None:
        """Log the true deflections for `read`."""
        n, count = self.deflections.shape
        stream.log(MOTION, rr.SeriesLines(names=[f"{name} [m]" for name in self.names]), static=True)
        columns = rr.Scalars.columns(scalars=self.deflections.ravel()).partition([count] * n)
        stream.send_columns(MOTION, self.indexes, columns)

    @classmethod
    def read(cls, path: Path) -> "Motion":
        """Read the motion from a Rerun file.

        Parameters
        ----------
        path : Path
            Rerun file of a run on a structure.

        Returns
        -------
        Motion
            Motion of the points.

        Raises
        ------
        BadRecording
            The file is damaged, or does not hold a run on a structure.
        """
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # Rerun only warns of a truncated file
                names, times, steps, deflections = _read_motion(path)
        except (RuntimeError, OSError, ValueError, KeyError, StopIteration, TypeError, Warning) as error:
            raise BadRecording(
                f"{path}: no motion of a structure can be read from it; run vlab experiment again to write it anew"
            ) from error
        if deflections.shape != (times.size, len(names)):
            raise BadRecording(f"{path}: the motion of {len(names)} points does not fit {deflections.shape}")
        order = np.argsort(times, kind="stable")
        return cls(names=tuple(names), times=times[order], steps=steps[order], deflections=deflections[order])


def _read_motion(path: Path) -> tuple[list[str], Array, NDArray[np.int64], Array]:
    names: list[str] = []
    parts = []
    for piece in RrdReader(path).stream().filter(content=f"/{MOTION}").to_chunks():
        table = piece.to_record_batch()
        columns = {name: table.column(i) for i, name in enumerate(table.schema.names)}
        if piece.is_static:
            labels = next(v for k, v in columns.items() if k.endswith("SeriesLines:names"))
            names = [label.removesuffix(" [m]") for label in labels.to_pylist()[0]]
        else:
            values = next(v for k, v in columns.items() if k.endswith("Scalars:scalars"))
            times = columns["sim_time"].cast("int64").to_numpy() * 1e-9
            parts.append((times, columns["step"].to_numpy(), np.array(values.to_pylist(), dtype=float)))
    times, steps, deflections = (np.concatenate(part) for part in zip(*parts, strict=True))
    return names, times, steps, deflections


def port_deflections(plant: Plant, frames: Array, names: Sequence[str]) -> Array:
    """Return deflections of ports from equilibrium at stored configurations.

    Parameters
    ----------
    plant : Plant
        Plant.
    frames : array
        Stored configurations.
    names : sequence of str
        Names of the ports.

    Returns
    -------
    array
        Deflections, (n_frames, n_names) [m].
    """
    ports = [plant.port(name) for name in names]
    data = plant.new_data()
    mujoco.mj_forward(plant.model, data)
    rest = np.array([port.position(data) for port in ports])
    out = np.empty((len(frames), len(ports)))
    for row, _ in zip(out, configurations(plant, data, frames), strict=True):
        row[:] = [port.position(data) for port in ports]
    return out - rest


def configurations(plant: Plant, data: Any, frames: Array) -> Iterator[Array]:
    """Set `data` to one stored configuration after the other.

    Parameters
    ----------
    plant : Plant
        Plant.
    data : object
        MuJoCo data, whose positions are set.
    frames : array
        Stored configurations.

    Yields
    ------
    array
        Stored configuration.
    """
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
    """Return the sample of each stored configuration."""
    steps = np.searchsorted(result.recording.time, result.frame_times - 1e-9)
    return np.asarray(np.clip(steps, 0, len(result.recording) - 1), dtype=np.int64)
