"""Command limit of a closed loop, identified from recorded commands.

The control law is known, so replay on the recorded samples needs no structural model. A limit is accepted where the
limited replay reproduces the recorded commands. Both variants are tried: a law with an observer of the limited command,
and a law unaware of the limit.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlab.cases.channel_map import Law, Run
from vlab.cases.initial_state import replayed_commands
from vlab.cases.replay_bench import bench_for
from vlab.cases.simulate import warmed_up
from vlab.controllers import Controller
from vlab.diagnose.settings import COMMAND_LIMIT
from vlab.plants.base import Plant
from vlab.signals import Array


class Limited:
    """Control law with a limit behind the law.

    Parameters
    ----------
    law : Controller
        Law without knowledge of the limit.
    limit : float
        Largest command [unit of the law].
    """

    def __init__(self, law: Controller, limit: float) -> None:
        self.law, self.limit = law, limit
        self.sensors, self.actuators = law.sensors, law.actuators

    def reset(self) -> None:
        """Reset the law's state."""
        self.law.reset()

    def step(self, y: Array) -> Array:
        """Return the law's commands, clipped at the limit."""
        return np.clip(self.law.step(y), -self.limit, self.limit)


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandLimit:
    """Limit identified from the recorded commands.

    Parameters
    ----------
    actuator : str
        Actuator with most samples at the limit.
    limit : float
        Largest command [unit of the law].
    sd : float
        Half the spacing of the trial limits [unit of the law].
    is_known : bool
        Whether the law's observer uses the limited command.
    before, after : float
        Replay error over the rms of the recorded commands, without and with the limit.
    """

    actuator: str
    limit: float
    sd: float
    is_known: bool
    before: float
    after: float

    def on(self, run: Run) -> Run:
        """Return a run whose law has the limit."""
        if run.law is None:
            return run
        return replace(run, law=replace(run.law, controller=limited(run.law.controller, self.limit, self.is_known)))


def limited(controller: Any, limit: float, is_known: bool) -> Any:
    """Return a copy of a law with a limit.

    Parameters
    ----------
    controller : Any
        Law.
    limit : float
        Largest command [unit of the law].
    is_known : bool
        Whether the law's observer uses the limited command.

    Returns
    -------
    Any
        Law with the limit.
    """
    out = copy.deepcopy(controller)
    if is_known and hasattr(out, "limit"):
        out.limit = limit
        return out
    return Limited(out, limit)


def find_limit(plant: Plant, runs: Sequence[Run]) -> CommandLimit | None:
    """Identify a command limit missing from the law.

    Parameters
    ----------
    plant : Plant
        Plant with the actuators.
    runs : sequence of Run
        Recordings; closed loops with recorded commands are used.

    Returns
    -------
    CommandLimit or None
        Limit, or None where no limit explains the recorded commands.
    """
    loops = [run for run in runs if run.law is not None and any(c.actuator is not None for c in run.compared)]
    if not loops:
        return None
    law = loops[0].law
    assert law is not None
    if getattr(law.controller, "limit", None) is not None:
        return None
    recorded = [_recorded(run) for run in loops]
    size = float(np.sqrt(np.mean(np.concatenate([r.ravel() for r in recorded]) ** 2)))
    own = [np.abs(r / law.per_actuator[_columns(run)]) for run, r in zip(loops, recorded, strict=True)]  # its unit
    largest = max(float(r.max()) for r in own)

    def error(limit: float | None, is_known: bool) -> float:
        parts = [_replay(plant, run, limit, is_known) - r for run, r in zip(loops, recorded, strict=True)]
        return float(np.sqrt(np.mean(np.concatenate([p.ravel() for p in parts]) ** 2))) / size

    before = error(None, False)
    options = np.geomspace(*COMMAND_LIMIT.span, COMMAND_LIMIT.grid) * largest
    tried = [(error(float(x), known), float(x), known) for known in (True, False) for x in options]
    after, limit, known = min(tried, key=lambda t: t[0])
    if not after**2 <= (1 - COMMAND_LIMIT.explained) * before**2 or limit > COMMAND_LIMIT.most * largest:
        return None
    fine = limit * np.linspace(1.0 - COMMAND_LIMIT.near, 1.0 + COMMAND_LIMIT.near, COMMAND_LIMIT.fine)
    after, limit = min((error(float(x), known), float(x)) for x in fine)
    there = np.zeros(len(law.actuators))
    for run, r in zip(loops, own, strict=True):
        there[_columns(run)] += np.sum(r >= COMMAND_LIMIT.at_limit * limit, axis=0)
    actuator = plant.actuators[law.actuators[int(np.argmax(there))]].name
    return CommandLimit(
        actuator=actuator, limit=limit, sd=COMMAND_LIMIT.sd * limit, is_known=known, before=before, after=after
    )


def _columns(run: Run) -> list[int]:
    """Return the indices of the law's commands that were recorded."""
    assert run.law is not None
    recorded = {c.actuator for c in run.compared if c.actuator is not None}
    return [i for i, a in enumerate(run.law.actuators) if a in recorded]


def _recorded(run: Run) -> Array:
    assert run.law is not None
    by_actuator = {c.actuator: c.channel for c in run.compared if c.actuator is not None}
    return np.column_stack([run.measured[by_actuator[run.law.actuators[i]]] for i in _columns(run)])


def _replay(plant: Plant, run: Run, limit: float | None, is_known: bool) -> Array:
    law: Law = run.law  # type: ignore[assignment]
    if limit is not None:
        law = replace(law, controller=limited(law.controller, limit, is_known))
    bench = bench_for(plant, run)
    law, _ = warmed_up(law, run, bench)
    out = replayed_commands(run, law, run.measured, bench)
    return out[:, _columns(run)]
