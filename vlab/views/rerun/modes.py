"""Modal amplitudes of a run in a Rerun scene, as moving bars."""

from typing import Any

import mujoco
import numpy as np

from vlab.fe.damping import driven_modes
from vlab.lab.experiment import Result
from vlab.plants.base import Plant
from vlab.signals import Array
from vlab.structure.model import Structure
from vlab.views.rerun.bars import bar_view, log_bars
from vlab.views.rerun.frames import frame_steps
from vlab.views.rerun.rrd import BLUE, time_columns

WINDOW_S = 1.0
"""WINDOW_S [s]: window of an amplitude, at least two periods."""
EVERY = 6
"""EVERY [pictures]: pictures between two updates of the bars, ten a second."""
MILLI, LOWEST_HZ = 1e3, 0.1


class ModalScene:
    """Scaled modes of a plant about equilibrium.

    The scene shows as many modes as the structure has measured damping ratios. Modes without motion of the points are
    omitted.

    Parameters
    ----------
    structure : Structure
        Structure whose points set the scale.
    """

    def __init__(self, structure: Structure, plant: Plant) -> None:
        linear = plant.linearise()
        names = plant.points_of(structure)
        shapes = linear.eigen[1]
        at_points = plant.port_rows(names) @ shapes
        modes = driven_modes(at_points)[: len(structure.damping.ratios)]
        self.plant, self.freq = plant, linear.freq[modes]
        self._project = np.abs(at_points[:, modes]).max(axis=0)[:, None] * (shapes[:, modes].T @ linear.M)
        self._rest = plant.new_data().qpos.copy()

    def coordinates(self, frames: Array) -> Array:
        """Return the modal coordinates (n_frames, n_modes) [m] at stored configurations."""
        model, away = self.plant.model, np.zeros((len(frames), self.plant.model.nv))
        for row, configuration in zip(away, frames, strict=True):
            mujoco.mj_differentiatePos(model, row, 1.0, self._rest, configuration)
        return np.asarray(away @ self._project.T)

    def amplitudes(self, frames: Array, times: Array) -> Array:
        """Return modal amplitudes before each time.

        Parameters
        ----------
        frames : array
            Stored configurations.
        times : array
            Times [s].

        Returns
        -------
        array
            Amplitudes, (n_frames, n_modes) [m].
        """
        squares = np.vstack([np.zeros(len(self.freq)), np.cumsum(self.coordinates(frames) ** 2, axis=0)])
        end = np.arange(1, len(times) + 1)
        out = np.empty((len(times), len(self.freq)))
        for mode, hz in enumerate(self.freq):
            begin = np.searchsorted(times, times - max(WINDOW_S, 2 / max(hz, LOWEST_HZ)), side="right")
            out[:, mode] = (squares[end, mode] - squares[begin, mode]) / (end - begin)
        return np.sqrt(2 * np.maximum(out, 0.0))

    def log(self, stream: Any, result: Result, *, since: int = 0, until: int | None = None) -> None:
        """Log the bars [mm] of the pictures from `since` to before `until`."""
        until = len(result.frames) if until is None else until
        shown = np.arange(-(-since // EVERY) * EVERY, until, EVERY)
        longest = max(WINDOW_S, 2 / max(float(self.freq.min()), LOWEST_HZ))
        first = int(np.searchsorted(result.frame_times, result.frame_times[since] - longest)) if shown.size else since
        rows = self.amplitudes(result.frames[first:until], result.frame_times[first:until])[shown - first]
        indexes = time_columns(result.frame_times[shown], frame_steps(result)[shown])
        places = np.arange(1, len(self.freq) + 1)
        log_bars(stream, "modes", indexes, MILLI * rows, middles=places, width=0.7, colour=BLUE)

    def view(self) -> Any:
        """Return the view of the bars."""
        return bar_view(f"modes 1 to {len(self.freq)}: amplitude of the last second [mm]", "/modes")
