"""Control law in a Rerun scene: commands, amplifier forces, states."""

from typing import Any

import numpy as np

from vlab.controllers import Controller, LinearController
from vlab.hardware.laboratory import Hardware
from vlab.hardware.output_chain import OutputChain
from vlab.plants.base import ActuatorTap, Plant
from vlab.signals import Array, Recording
from vlab.views.figures import pretty_unit
from vlab.views.rerun.rrd import BLUE, GREEN, GREY, ORANGE, rgb
from vlab.views.rerun.traces import log_many, plot_view

COILS = 5
"""COILS [-]: most actuators with a plot of their own, those with the largest forces."""
SAME = 1e-9
"""SAME [-]: relative rounding difference of two evaluations of one command."""


class LawStates:
    """States of a linear law along a recording.

        x+ = A x + B y,  u = C x + D y

    Parameters
    ----------
    law : LinearController
        Law of the run; only its matrices are used.
    """

    def __init__(self, law: LinearController, plant: Plant) -> None:
        self.A, self.B, self.C, self.D = law.matrices
        self.size = len(self.A)
        self._sensors = [plant.sensors[plant.sensor_index(name)].name for name in law.sensors]
        self._commands = [f"command:{plant.actuators[plant.actuator_index(name)].at}" for name in law.actuators]
        self._x = np.zeros(self.size)

    def follow(self, recording: Recording, since: int, until: int) -> Array:
        """Return the states of a range of samples.

        Parameters
        ----------
        recording : Recording
            Recording of the run.
        since : int
            First sample.
        until : int
            Sample after the last.

        Returns
        -------
        array
            States, (n, n_states).
        """
        states = np.empty((until - since, self.size))
        columns = [recording.index(name) for name in self._sensors]
        for row, y in zip(states, recording.data[since:until, columns], strict=True):
            row[:] = self._x
            self._x = self.A @ self._x + self.B @ y
        return states

    def explain(self, recording: Recording, states: Array, since: int = 0) -> bool:
        """Return whether the states reproduce the recorded commands.

        Nonlinear action of the law breaks the agreement.

        Parameters
        ----------
        recording : Recording
            Recording of the run.
        states : array
            States, (n, n_states).
        since : int
            First sample.

        Returns
        -------
        bool
            Whether commands agree within rounding.
        """
        part = slice(since, since + len(states))
        given = np.column_stack([recording[name][part] for name in self._commands])
        samples = np.column_stack([recording[name][part] for name in self._sensors])
        off = np.abs(states @ self.C.T + samples @ self.D.T - given).max()
        return bool(off <= SAME * np.abs(given).max())


def asked_forces(plant: Plant, recording: Recording, hardware: Hardware) -> dict[str, Array]:
    """Return the forces of all actuators before the amplifier limit, by place.

    The values are means over the samples.

    Parameters
    ----------
    plant : Plant
        Plant.
    recording : Recording
        Recording of the run.
    hardware : Hardware
        Hardware of the laboratory.

    Returns
    -------
    dict
        Force of each actuator, (n_samples,) [N].
    """
    chain = OutputChain(hardware.converter, channels=1, substeps=(substeps := plant.substeps(recording.rate)))
    out = {}
    for tap in plant.actuators:
        asked = np.zeros(len(recording))
        if f"command:{tap.at}" in recording.names:
            steps = chain.response(recording[f"command:{tap.at}"][:, None])
            asked = steps.reshape(-1, substeps).mean(axis=1)
        if f"excitation:{tap.at}" in recording.names:
            signal = recording[f"excitation:{tap.at}"]
            asked = asked + (signal + np.append(signal[1:], signal[-1])) / 2  # mean until the next sample
        out[tap.at] = asked
    return out


class LawScene:
    """Scene of commands, actuator forces and states.

    Parameters
    ----------
    recording : Recording
        Recording of the run, or of its first part.
    """

    def __init__(self, plant: Plant, recording: Recording, hardware: Hardware | None, law: Controller | None) -> None:
        self.plant, self.hardware = plant, hardware
        self.limit = hardware.coil.limit if hardware is not None else 0.0
        shown = [t for t in plant.actuators if f"force:{t.at}" in recording.names] if law or self.limit else []
        size = {t.at: float(np.abs(recording[f"force:{t.at}"]).max()) for t in shown}
        self.taps = sorted(shown, key=lambda t: -size[t.at])[:COILS]
        self.states = LawStates(law, plant) if isinstance(law, LinearController) and len(law.matrices[0]) else None
        self._asked: tuple[Recording | None, dict[str, Array]] = (None, {})

    def log(self, stream: Any, recording: Recording, *, since: int = 0, until: int | None = None) -> None:
        """Log all samples from `since` to before `until`."""
        part = slice(since, len(recording) if until is None else until)
        time = recording.time[part]
        for k, tap in enumerate(self.taps):
            curves = self._curves(tap, recording)
            labels = [f"{label} [{pretty_unit(tap.unit)}]" for label, _, _ in curves]
            values = np.column_stack([values[part] for _, values, _ in curves])
            log_many(stream, f"law/{k}", time, values, labels, [c for _, _, c in curves], first=since)
        if self.states is not None:
            states = self.states.follow(recording, since, part.stop)
            if not self.states.explain(recording, states, since):
                self.states = None  # the law reached an internal limit; linear states end here
                return
            labels = [f"state {i + 1}" for i in range(self.states.size)]
            colours = [rgb(i) for i in range(self.states.size)]
            log_many(stream, "law/states", time, states, labels, colours, first=since)

    def _curves(self, tap: ActuatorTap, recording: Recording) -> list[tuple[str, Array, Any]]:
        curves = [("force with excitation", recording[f"force:{tap.at}"], ORANGE)]
        if self.limit and self.hardware is not None:
            if self._asked[0] is not recording:
                self._asked = recording, asked_forces(self.plant, recording, self.hardware)
            ends = np.full(len(recording), self.limit)
            curves = [("asked of the amplifier", self._asked[1][tap.at], GREEN), *curves]
            curves += [("limit", ends, GREY), ("-limit", -ends, GREY)]
        if f"command:{tap.at}" in recording.names:
            curves.append(("command of the law", recording[f"command:{tap.at}"], BLUE))
        return curves

    def views(self) -> list[Any]:
        """Return one plot per actuator, and the states."""
        views = [plot_view(f"{tap.at} [{pretty_unit(tap.unit)}]", f"/law/{k}") for k, tap in enumerate(self.taps)]
        if self.states is not None:
            views.append(plot_view(f"states of the law ({self.states.size})", "/law/states"))
        return views
