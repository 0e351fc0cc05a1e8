"""The runs of a case wired to its model: they compare the same channels, and it is known what drives them."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import ORDER, Compared, Law, Run
from vlab.cases.initial_state import replayed_commands
from vlab.cases.replay import bench_for, plan_clock
from vlab.diagnose.data.runs import fastest, uniform
from vlab.diagnose.parameters.observation import within_limits
from vlab.diagnose.settings import RECORDED_RUNS
from vlab.errors import BadCase
from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedRuns:
    """The runs of a case that compare the same channels, and what drives them.

    Parameters
    ----------
    channels : tuple of Compared
        Commands aside.
    load_ports : tuple of str
        Ports that recordings drive directly.
    driven : tuple of int
        Actuators that recordings or laws drive.
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
        """How often every channel is the derivative of a position."""
        measured = self.runs[0].measured
        return tuple(ORDER.get(measured.channels[measured.index(name)].kind, 0) for name in self.names)

    @property
    def highest_hz(self) -> float:
        """The frequency below which nearly all power of the recorded velocities lies."""
        data = [(np.column_stack([run.measured[name] for name in self.names]), run.measured.time) for run in self.runs]
        return max(fastest(y, uniform(time), self.orders) for y, time in data)

    def step(self, plant: Plant) -> float:
        """Return the shortest integration step that a plant takes along them [s]."""
        return min(plan_clock(plant.timestep, run).timestep for run in self.runs)


def read_runs(case: Case, roles: Sequence[str]) -> RecordedRuns:
    """Return a case's runs in some roles.

    Raises
    ------
    BadCase
        No recording, one that is too short, or runs that compare different channels.
    """
    runs = tuple(case.runs(roles))
    if not runs:
        only = ", or one of the [[frf]] and [[modal]] as fit" if case.table.frf or case.table.modal else ""
        raise BadCase(f"{case.path}: no [[recording]] has the role {' or '.join(roles)}; mark at least one{only}")
    short = next((run for run in runs if len(run.measured) < RECORDED_RUNS.least_samples), None)
    if short is not None:
        raise BadCase(
            f"{case.path}: {short.name} has {len(short.measured)} samples; at least {RECORDED_RUNS.least_samples} tell motion from noise"
        )
    channels = tuple(c for c in runs[0].compared if c.actuator is None)
    for run in runs[1:]:
        if tuple(c for c in run.compared if c.actuator is None) != channels:
            raise BadCase(
                f"{case.path}: {run.name} compares other channels than {runs[0].name}; give them the same ones"
            )
    by_law = {i for run in runs if run.law is not None for i in run.law.actuators}
    return RecordedRuns(
        runs=runs,
        channels=channels,
        load_ports=tuple(dict.fromkeys(d.port for run in runs for d in run.drives if d.port)),
        driven=tuple(sorted({d.actuator for run in runs for d in run.drives if d.actuator is not None} | by_law)),
    )


def recorded_commands(plant: Plant, run: Run) -> Array | None:
    """Return what the law in the loop commanded, (n_samples, n_actuators): recorded, or replayed on the recorded sensors."""
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
    """Return a run whose driving channels are what the plant's own limits let through: the search is linear in them."""
    measured = run.measured
    data = measured.data.copy()
    for drive in run.drives:
        if drive.actuator is not None:
            i = measured.index(drive.channel)
            data[:, i] = within_limits(plant, drive.actuator, data[:, i])
    return run if np.array_equal(data, measured.data) else replace(run, measured=replace(measured, data=data))
