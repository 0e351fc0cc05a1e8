"""Comparison of a case's model with its recordings."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from vlab.cases.case import Case, load_case
from vlab.cases.channel_map import Run
from vlab.cases.checks import FileCheck, check_clock, check_recordings
from vlab.cases.misfit import Misfit, misfit
from vlab.cases.simulate import Simulation, simulate
from vlab.errors import BadCase
from vlab.plants.base import Plant
from vlab.signals import Recording

OVERLAY_POINTS = 2000
"""OVERLAY_POINTS [samples]: length of an overlay in a JSON document; a longer recording is decimated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RunComparison:
    """One recording beside its simulation.

    Parameters
    ----------
    run : Run
        Recording with mapped channels.
    simulation : Simulation
        Response of the model.
    misfits : tuple of Misfit
        Residual of each compared channel that moves.
    constant : tuple of str
        Compared channels without motion in the recording; a relative residual is undefined.
    """

    run: Run
    simulation: Simulation
    misfits: tuple[Misfit, ...]
    constant: tuple[str, ...] = ()

    @property
    def measured(self) -> Recording:
        """Compared part of the recording, all channels."""
        return self.run.measured

    @property
    def simulated(self) -> Recording:
        """Simulated channels at the same times, inputs as recorded."""
        return self.simulation.recording

    def overlay(self, points: int = OVERLAY_POINTS) -> list[dict[str, Any]]:
        """Return measured and simulated samples for a plot.

        Parameters
        ----------
        points : int
            Largest number of samples.

        Returns
        -------
        list of dict of str to object
            One dictionary a compared channel.
        """
        every = max(1, -(-len(self.measured) // points))
        return [
            {
                "channel": m.channel,
                "unit": m.unit,
                "time_s": self.measured.time[::every].tolist(),
                "measured": self.measured[m.channel][::every].tolist(),
                "simulated": self.simulated[m.channel][::every].tolist(),
            }
            for m in self.misfits
        ]

    def to_json(self, *, overlay: bool = False) -> dict[str, Any]:
        """Return plain values for a JSON document.

        Parameters
        ----------
        overlay : bool
            Whether to include samples.

        Returns
        -------
        dict of str to object
            Residuals and settings by name.
        """
        out: dict[str, Any] = {
            "name": self.run.name,
            "role": self.run.role,
            "samples": len(self.measured),
            "start_s": float(self.measured.time[0]),
            "stop_s": float(self.measured.time[-1]),
            "timestep_s": self.simulation.timestep_s,
            "initial": self.simulation.initial.to_json(),
            "notes": list(self.simulation.notes),
            "misfits": [m.to_json() for m in self.misfits],
            "constant": list(self.constant),
        }
        if overlay:
            out["overlay"] = self.overlay()
        return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """A case's model compared with its recordings.

    Parameters
    ----------
    check : FileCheck
        Findings of the file checks.
    """

    case: Case
    runs: tuple[RunComparison, ...]
    check: FileCheck = field(default_factory=FileCheck)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks beside the residuals, such as constant channels and blank cells."""
        still = [
            f"{run.run.name}: {name} is {run.measured[name][0]:g} {run.measured.channels[run.measured.index(name)].unit} throughout: "
            "nothing can be measured against it"
            for run in self.runs
            for name in run.constant
        ]
        read = [f"{r.run.name}: {text}" for r in self.runs for text in r.measured.meta.get("reading", ())]
        return (*self.case.notes, *still, *read, *self.check.lines)

    @property
    def nrmse(self) -> dict[str, float]:
        """Rms of the channels' NRMSE, by recording with motion."""
        return {r.run.name: float(np.sqrt(np.mean([m.nrmse**2 for m in r.misfits]))) for r in self.runs if r.misfits}

    def to_json(self, *, overlay: bool = False) -> dict[str, Any]:
        """Return plain values for a JSON document.

        Parameters
        ----------
        overlay : bool
            Whether to include samples.

        Returns
        -------
        dict of str to object
            Residuals and settings by name.
        """
        return {
            "title": self.case.table.title,
            "model": self.case.table.model.mjcf or self.case.table.model.structure,
            "model_notes": [*getattr(self.case.plant, "notes", ()), *self.case.plant.left_out],
            "runs": [r.to_json(overlay=overlay) for r in self.runs],
            "remarks": list(self.remarks),
        }


def compare_run(plant: Plant, run: Run, *, progress: Callable[[float], None] = lambda share: None) -> RunComparison:
    """Simulate one recording and measure every channel's residual.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.
    run : Run
        Recording with mapped channels.
    progress : callable
        Called with the share of the run done.

    Returns
    -------
    RunComparison
        Simulation and residuals.
    """
    simulation = simulate(plant, run, progress=progress)
    channels = [c.channel for c in run.compared]
    constant = tuple(name for name in channels if np.ptp(run.measured[name]) == 0.0)
    return RunComparison(
        run=run,
        simulation=simulation,
        misfits=tuple(misfit(run.measured, simulation.recording, name) for name in channels if name not in constant),
        constant=constant,
    )


def compare_case(
    path: Path | str | Case,
    *,
    roles: Sequence[str] = ("fit", "holdout"),
    allow_outside: bool = False,
    progress: Callable[[float, str], None] = lambda share, what: None,
) -> Comparison:
    """Simulate a case's recordings and measure the residuals.

    Parameters
    ----------
    path : path or Case
        Folder or file of the case, or the case.
    roles : sequence of str
        Roles of the recordings to use; recordings of any other role stay closed.
    allow_outside : bool
        Whether the case may name files outside its folder.
    progress : callable
        Called with the share done and the present activity.

    Returns
    -------
    Comparison
        Case, comparisons and file findings.

    Raises
    ------
    BadCase
        The case does not fit its model, has no recording in `roles`, or has a wrong time unit.
    """
    case = path if isinstance(path, Case) else load_case(path, allow_outside=allow_outside)
    runs = case.runs(roles)
    if not runs:
        if case.table.frf or case.table.modal:
            raise BadCase(
                f"{case.path}: only recordings over time are compared here; vlab check and vlab diagnose put [[frf]] and [[modal]] beside the model"
            )
        raise BadCase(f"{case.path}: no [[recording]] has the role {' or '.join(roles)}")
    check_clock(case, runs)
    compared, of = [], len(runs) + 1
    for i, run in enumerate(runs):
        share = partial(_share, progress, f"simulating {run.name}", i, of)
        compared.append(compare_run(case.plant, run, progress=share))
    progress(len(runs) / of, "checking signs and units")
    check = check_recordings(case, runs, [c.simulated for c in compared])
    progress(1.0, "done")
    return Comparison(case=case, runs=tuple(compared), check=check)


def _share(progress: Callable[[float, str], None], what: str, done: int, of: int, share: float) -> None:
    progress((done + share) / of, what)
