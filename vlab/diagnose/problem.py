"""Inverse problem of the search in time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import Compared, Run
from vlab.diagnose.data.mains_interference import MainsInterference
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.model_kinds.meshed_structure import MeshedStructure
from vlab.diagnose.model_kinds.mjcf_model import MjcfModel
from vlab.diagnose.model_kinds.model_kind import ModelKind
from vlab.diagnose.parameters.known_effects import known_terms, unsearched
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.mjcf import Uncertain, redundant
from vlab.diagnose.parameters.recorded_runs import short_notes
from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.parameters.unused_entries import unused
from vlab.diagnose.settings import PROBLEM
from vlab.plants.base import Plant
from vlab.signals import Array


def model_kind_of(case: Case) -> ModelKind:
    """Return the kind of a case's nominal model."""
    if case.structure is None:
        return MjcfModel()
    return MeshedStructure(structure=case.structure, variant=case.table.model.variant)


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """Inverse problem of a case.

    Parameters
    ----------
    case : Case
        Case.
    plant : Plant
        Nominal plant.
    reduced_model : ReducedModel
        Reduced modal model of the plant.
    parameters : tuple of Uncertain
        Uncertain parameters.
    channels : tuple of Compared
        All compared channels, without commands.
    names : tuple of str
        Names of the channels.
    runs : tuple of Run
        Recordings with mapped channels.
    orders : tuple of int
        Time derivatives of position in every channel: 0, 1 or 2.
    about : (n_channels,) array
        Values about which sensor gains act [SI]: those at rest, whose share of offset is unknown.
    signals : tuple of Signals
        The runs on the clock of the search, in the same order, without mains interference.
    places : tuple of Place
        Locations.
    interferences : tuple of MainsInterference
        Mains interference of the channels.
    highest_hz : float
        Frequency below which nearly all recorded velocity power lies [Hz].
    intensity : mapping of float to float
        Unknown-force intensity by sample period [s], from an earlier tuning.
    bare : Problem or None
        Problem without forces of the model's own nonlinearity.
    timing : str
        Note on an estimated sampling convention.
    horizon_s : float
        Length of the parts in which unstable motion is predicted [s]; infinite for stable motion.
    port_laws : tuple of Term
        Effects at ports of the case's own model, along a motion.
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
    horizon_s: float = np.inf
    port_laws: tuple[Term, ...] = ()

    @property
    def model_error(self) -> float:
        """Simulation error in the weights over a channel's rms."""
        return PROBLEM.model_error

    @cached_property
    def model_kind(self) -> ModelKind:
        """Kind of the nominal model."""
        return model_kind_of(self.case)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on unsearched parts of recordings and unused statements."""
        out = [self.timing] if self.timing else []
        for run, part in zip(self.runs, self.signals, strict=True):
            whole = float(run.measured.time[-1] - run.measured.time[0])
            if part.last_s - part.t0 < PROBLEM.long * whole:
                out.append(
                    f"{run.name}: searched from {part.t0:.4g} to {part.last_s:.4g} s of {whole:.4g} s; the verdict is on all of it"
                )
        if np.isfinite(self.horizon_s):
            out.append(
                "small errors grow exponentially along the motion (unstable or chaotic), so every recording is predicted in "
                f"parts of about {self.horizon_s:.2g} s, each from a state of its own"
            )
        out += short_notes(self.case, self.runs)
        out += unused(self.case.table.model.uncertain, self.parameters)
        if not self.port_laws and (beside := unsearched(self.plant)):
            out.append(
                f"[[model.effect]] {', '.join(beside)}: nonlinear and no element of MuJoCo's; the search has the tangent at rest "
                "alone, the verdict is on the whole law"
            )
        return (*out, *getattr(self.plant, "notes", ()))

    @cached_property
    def known(self) -> tuple[Term, ...]:
        """Effects of the case's model that are present in every hypothesis."""
        return (*known_terms(self.plant, self.channels), *self.port_laws)

    def beside_known(
        self, terms: Sequence[Term], values: Sequence[Mapping[str, Array]], n_sets: int
    ) -> tuple[list[Term], list[Mapping[str, Array]]]:
        """Return a hypothesis with the known effects before its own.

        Parameters
        ----------
        terms : sequence of Term
            Effects.
        values : sequence of mapping
            Parameter values (n_sets,) of every term.
        n_sets : int
            Number of parameter sets.

        Returns
        -------
        terms : list of Term
            Known effects, then the others.
        values : list of mapping
            Their parameter values (n_sets,).
        """
        stated = [{name: np.full(n_sets, value) for name, value in term.values.items()} for term in self.known]
        return [*self.known, *terms], [*stated, *values]

    @property
    def excited(self) -> tuple[int | None, ...]:
        """Actuators with recorded inputs; None for a force at a port."""
        return tuple(dict.fromkeys(drive.actuator for run in self.runs for drive in run.drives))

    @cached_property
    def may_vanish(self) -> Array:
        """Parameters (n_parameters,) whose value may be zero."""
        return np.array([p.may_vanish for p in self.parameters], dtype=bool)

    @cached_property
    def common_scale(self) -> Array | None:
        """Log factors that scale all impedances and gains, or None."""
        loaded = any(drive.port for run in self.runs for drive in run.drives)
        return self.model_kind.common_scale(self.plant, self.parameters, loaded=loaded)

    @cached_property
    def redundant(self) -> Array:
        """Parameter directions without effect on the model."""
        return redundant(self.parameters)

    def adjusted(self, theta: Array) -> Plant:
        """Return the plant at given log factors."""
        return self.model_kind.adjusted(self.plant, self.parameters, self.for_plant(theta))

    def for_plant(self, theta: Array) -> Array:
        """Return log factors that reproduce the reduced model's frequencies.

        The reduced model keeps nominal modal coordinates, but the modes of a rebuilt plant change. The difference is
        some 1e-5 of a frequency, and a per cent of a lightly damped response.

        Parameters
        ----------
        theta : (n_parameters,) array
            Log factors of the reduced model.

        Returns
        -------
        (n_parameters,) array
            Log factors for a rebuilt plant.
        """
        return self.model_kind.for_plant(self.reduced_model, self.plant, self.parameters, theta)

    def in_role(self, role: str) -> list[Signals]:
        """Return the runs of one role."""
        return [s for s in self.signals if s.role == role]
