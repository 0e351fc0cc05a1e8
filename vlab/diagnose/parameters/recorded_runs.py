"""Recorded runs of a case with common channels."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import Compared, Law, Run
from vlab.cases.clock import plan_clock
from vlab.cases.initial_state import replayed_commands
from vlab.cases.replay_bench import bench_for
from vlab.diagnose.data.band import fastest
from vlab.diagnose.data.noise import estimate_noise
from vlab.diagnose.data.repeats import with_repeats
from vlab.diagnose.data.settled import with_unsettled
from vlab.diagnose.parameters.observation import within_limits
from vlab.diagnose.settings import RECORDED_RUNS
from vlab.errors import BadCase
from vlab.plants.base import Plant
from vlab.signals import ORDER, Array, sample_period


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedRuns:
    """Runs of a case with common channels.

    Parameters
    ----------
    runs : tuple of Run
        Recordings.
    channels : tuple of Compared
        Compared channels, without commands.
    load_ports : tuple of str
        Directly driven ports.
    driven : tuple of int
        Actuators driven by recordings or laws.
    """

    runs: tuple[Run, ...]
    channels: tuple[Compared, ...]
    load_ports: tuple[str, ...]
    driven: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels."""
        return tuple(c.channel for c in self.channels)

    @property
    def orders(self) -> tuple[int, ...]:
        """Time derivatives of position in every channel: 0, 1 or 2."""
        measured = self.runs[0].measured
        return tuple(ORDER.get(measured.channels[measured.index(name)].kind, 0) for name in self.names)

    @property
    def highest_hz(self) -> float:
        """Frequency below which nearly all recorded velocity power lies [Hz]."""
        data = [(np.column_stack([run.measured[name] for name in self.names]), run.measured.time) for run in self.runs]
        return max(fastest(y, sample_period(time), self.orders) for y, time in data)

    def step(self, plant: Plant) -> float:
        """Return the shortest integration step over the runs [s]."""
        return min(plan_clock(plant.timestep, run).timestep for run in self.runs)


def read_runs(case: Case, roles: Sequence[str]) -> RecordedRuns:
    """Return the runs of a case in some roles.

    Parameters
    ----------
    case : Case
        Case.
    roles : sequence of str
        Roles to read.

    Returns
    -------
    RecordedRuns
        Runs with common channels.

    Raises
    ------
    BadCase
        No recording, too short recordings only, or different channels.
    """
    every = case.runs(roles)
    runs = with_repeats([run for run in every if len(run.measured) >= RECORDED_RUNS.fewest_samples])
    runs = with_unsettled(runs, case.plant)
    if not every:
        only = ", or one of the [[frf]] and [[modal]] as fit" if case.table.frf or case.table.modal else ""
        raise BadCase(f"{case.path}: no [[recording]] has the role {' or '.join(roles)}; mark at least one{only}")
    if not any(map(has_noise_floor, runs)):
        longest = max(every, key=lambda run: len(run.measured))
        raise BadCase(
            f"{case.path}: {longest.name} has {len(longest.measured)} samples; at least {RECORDED_RUNS.least_samples} tell motion "
            "from noise: give a longer recording, or the rest before the motion as well"
        )
    channels = tuple(c for c in runs[0].compared if c.actuator is None)
    for run in runs[1:]:
        if tuple(c for c in run.compared if c.actuator is None) != channels:
            raise BadCase(
                f"{case.path}: {run.name} compares other channels than {runs[0].name}; give them the same ones"
            )
    by_law = {i for run in runs if run.law is not None for i in run.law.actuators}
    return RecordedRuns(
        runs=with_noise_of(runs, runs),
        channels=channels,
        load_ports=tuple(dict.fromkeys(d.port for run in runs for d in run.drives if d.port)),
        driven=tuple(sorted({d.actuator for run in runs for d in run.drives if d.actuator is not None} | by_law)),
    )


def has_noise_floor(run: Run) -> bool:
    """Return whether a run has a noise floor of its own."""
    return len(run.measured) >= RECORDED_RUNS.least_samples


def with_noise_of(runs: Sequence[Run], others: Sequence[Run]) -> tuple[Run, ...]:
    """Return runs, the short ones with the noise of longer runs.

    Parameters
    ----------
    runs : sequence of Run
        Runs; stated noise and noise between repeats remain.
    others : sequence of Run
        Runs of the same sensors.

    Returns
    -------
    tuple of Run
        Runs. A short run states the median noise of the longer ones.
    """
    longer = [run for run in others if has_noise_floor(run)]

    def of_longer(c: Compared) -> Compared:
        found = [estimate_noise(run, c.channel).sigma for run in longer if c.channel in run.measured.names]
        return replace(c, noise=float(np.median(found))) if found and c.noise is None else c

    return tuple(
        run if has_noise_floor(run) or run.repeats else replace(run, compared=tuple(map(of_longer, run.compared)))
        for run in runs
    )


def short_notes(case: Case, runs: Sequence[Run]) -> list[str]:
    """Return notes on recordings that are too short for the fit.

    Parameters
    ----------
    case : Case
        Case.
    runs : sequence of Run
        Fitted recordings.

    Returns
    -------
    list of str
        Notes.
    """
    names = {run.name for run in runs}
    return [
        f"{run.name}: {len(run.measured)} samples do not tell motion from noise, so it is left out; at least {RECORDED_RUNS.fewest_samples} do"
        for run in case.runs(("fit",))
        if run.name not in names
    ]


def recorded_commands(plant: Plant, run: Run) -> Array | None:
    """Return the recorded or replayed commands of the law.

    Parameters
    ----------
    plant : Plant
        Plant.
    run : Run
        Recording.

    Returns
    -------
    (n_samples, n_actuators) array or None
        Commands within the plant's limits; None without a law.
    """
    if run.law is None:
        return None
    law: Law = replace(run.law, controller=copy.deepcopy(run.law.controller))
    out = np.zeros((len(run.measured), len(plant.actuators)))
    replayed = replayed_commands(run, law, run.measured, bench_for(plant, run))
    for column, actuator in enumerate(law.actuators):
        recorded = next((c for c in run.compared if c.actuator == actuator), None)
        commands = replayed[:, column] if recorded is None else run.measured[recorded.channel]
        out[:, actuator] = within_limits(plant, actuator, commands)
    return out


def limited(plant: Plant, run: Run) -> Run:
    """Return a run with drives within the plant's limits.

    The search is linear in the driving channels.

    Parameters
    ----------
    plant : Plant
        Plant.
    run : Run
        Recording.

    Returns
    -------
    Run
        Recording with clipped drives.
    """
    measured = run.measured
    data = measured.data.copy()
    for drive in run.drives:
        if drive.actuator is not None:
            i = measured.index(drive.channel)
            data[:, i] = within_limits(plant, drive.actuator, data[:, i])
    return run if np.array_equal(data, measured.data) else replace(run, measured=replace(measured, data=data))
