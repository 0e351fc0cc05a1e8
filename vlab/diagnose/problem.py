"""What the search works on: the twin, the runs on one clock, what is uncertain, the places."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import Compared, Run
from vlab.diagnose.data.mains_interference import MainsInterference
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.mjcf import Uncertain, adjusted, common_scale, redundant, unused
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.parameters.structure import (
    adjusted_structure,
    common_scale_of_structure,
    frequencies_of_reduced_model,
)
from vlab.diagnose.settings import PROBLEM
from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """A case as the search sees it.

    Parameters
    ----------
    channels : tuple of Compared
        All channels that are compared in some run, commands aside.
    names : tuple of str
        Their names.
    runs : tuple of Run
        As wired.
    signals : tuple of Signals
        The same runs on the search's clock, in the same order, hum taken off.
    orders : tuple of int
        How often every channel is the derivative of a position.
    about : (n_channels,) array
        Readings from which sensors' gains count: those at rest, of which nobody knows how much is the zero.
    hums : tuple of Hum
        The hum that was found on their channels.
    highest_hz : float
        Frequency below which nearly all power of the recorded velocities lies.
    intensity : mapping of float to float
        Of the forces that the twin lacks, by sample period [s], where a filter was tuned before; see `observer.tune`.
    bare : Problem or None
        The same without the loads of the model's own nonlinearity, where there are any.
    timing : str
        When the inputs act, where the recordings had to tell; see `timing.score_by_timing`.
    """

    case: Case
    plant: Plant
    reduced_model: ReducedModel
    parameters: tuple[Uncertain, ...]
    channels: tuple[Compared, ...]
    names: tuple[str, ...]
    runs: tuple[Run, ...]
    orders: tuple[int, ...]
    about: Array
    signals: tuple[Signals, ...]
    places: tuple[Place, ...]
    interferences: tuple[MainsInterference, ...] = ()
    highest_hz: float = np.inf
    intensity: Mapping[float, float] = field(default_factory=dict)
    bare: "Problem | None" = None
    timing: str = ""

    @property
    def model_error(self) -> float:
        """Error of the simulation itself that is allowed for in the weights, as a share of a channel's rms."""
        return PROBLEM.model_error

    @property
    def own_error(self) -> float:
        """Error that the model itself leaves where nothing is missing, as a share of a channel's rms, at least."""
        return PROBLEM.integration_error if self.case.structure is None else PROBLEM.model_error

    @property
    def notes(self) -> tuple[str, ...]:
        """What must be said of the search: parts of recordings that it did not look at, what was stated and not used."""
        out = [self.timing] if self.timing else []
        for run, part in zip(self.runs, self.signals, strict=True):
            whole = float(run.measured.time[-1] - run.measured.time[0])
            if part.last_s - part.t0 < PROBLEM.long * whole:
                out.append(
                    f"{run.name}: searched from {part.t0:.4g} to {part.last_s:.4g} s of {whole:.4g} s; the verdict is on all of it"
                )
        out += unused(self.case.table.model.uncertain, self.parameters)
        return (*out, *getattr(self.plant, "notes", ()))

    @cached_property
    def common_scale(self) -> Array | None:
        """See `vlab.diagnose.parameters.mjcf.common_scale`."""
        loaded = any(drive.port for run in self.runs for drive in run.drives)
        if self.case.structure is None:
            return common_scale(self.plant, self.parameters, loaded=loaded)
        return common_scale_of_structure(
            self.case.structure, self.case.table.model.variant, self.parameters, loaded=loaded
        )

    @cached_property
    def redundant(self) -> Array:
        """See `vlab.diagnose.parameters.mjcf.redundant`."""
        return redundant(self.parameters)

    def adjusted(self, theta: Array) -> Plant:
        """Return the plant with its uncertain parameters at given log-factors."""
        if self.case.structure is None:
            return adjusted(self.plant, self.parameters, theta)
        return self._rebuilt(self.for_plant(theta))

    def for_plant(self, theta: Array) -> Array:
        """Return log-factors with which a rebuilt plant has the twin's frequencies at given ones.

        The twin keeps the modes' coordinates as they are at nominal values, and a rebuilt plant bends into others: some
        hundred-thousandths of a frequency, which light damping makes a per cent of a response.
        """
        if self.case.structure is None or not any(p.kind == "frequency" for p in self.parameters):
            return theta
        return frequencies_of_reduced_model(
            self.reduced_model, self._rebuilt(theta), self.case.structure, self.parameters, theta
        )

    def _rebuilt(self, theta: Array) -> Plant:
        assert self.case.structure is not None
        return adjusted_structure(
            self.case.structure, self.plant, self.case.table.model.variant, self.parameters, theta
        )

    def in_role(self, role: str) -> list[Signals]:
        """Return the runs of one role."""
        return [s for s in self.signals if s.role == role]
