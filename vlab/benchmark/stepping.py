"""CPU times of whole experiments beside bare steps of MuJoCo."""

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco

from vlab.lab import Experiment, run_experiment
from vlab.lab.excitation import Multisine
from vlab.lab.laws import published_law
from vlab.plants import Plant, build_plant
from vlab.structure import load_structure

SECONDS, RUNS = 10.0, 5
"""SECONDS, RUNS [s, 1]: simulated time of a run, and runs of which the median counts."""
SWING = 1e-3
"""SWING [m/s, rad/s]: initial velocity of every coordinate in bare steps."""
STRUCTURES, PLANTS = ("beam", "grid"), ("composite", "modal", "fe")
"""STRUCTURES, PLANTS [-]: timed structures and plants."""


@dataclass(frozen=True, kw_only=True)
class Stepping:
    """CPU times of an experiment and of bare steps [s per simulated second]."""

    work: str
    ours_s: float
    bare_s: float


def cpu_medians(works: Sequence[Callable[[], Any]], runs: int) -> list[float]:
    """Return the median CPU time of several works [s].

    The works take turns, so a slow phase of the machine meets all of them.

    Parameters
    ----------
    works : sequence of callable
        Works; each runs once before its time is taken.
    runs : int
        Number of turns.

    Returns
    -------
    list of float
        One median a work.
    """
    taken: list[list[float]] = [[] for _ in works]
    for work in works:
        work()
    for _ in range(runs):
        for work, times in zip(works, taken, strict=True):
            begun = time.process_time()
            work()
            times.append(time.process_time() - begun)
    return [statistics.median(times) for times in taken]


def stepping_times(*, progress: Callable[[str], None] = lambda text: None) -> Iterator[Stepping]:
    """Time an experiment with a linear law beside bare steps of the same plant.

    The experiment includes excitation, sensors, law, delay, filter and recording.

    Parameters
    ----------
    progress : callable
        Receives the present work.

    Yields
    ------
    Stepping
        Times of one plant.
    """
    for structure in STRUCTURES:
        built = load_structure(structure)
        law = published_law(built, "mfdrf")
        for name in PLANTS:
            progress(f"steps of the {structure}'s {name} plant")
            plant = build_plant(built, name)
            excitation = Multisine(level=0.2, period_s=SECONDS, seed=1)
            experiment = Experiment(plant=plant, seconds=SECONDS, excitation=excitation, controller=law)
            steps = round(SECONDS / plant.timestep)
            ours_s, bare_s = cpu_medians([partial(run_experiment, experiment), partial(_bare, plant, steps)], RUNS)
            yield Stepping(
                work=f"{structure}, {name} plant, MFDRF at 2 kHz: an experiment, CPU seconds per simulated second",
                ours_s=ours_s / SECONDS,
                bare_s=bare_s / SECONDS,
            )


def _bare(plant: Plant, steps: int) -> None:
    """Step a swinging plant without input; at rest, sines and products of zero are cheaper."""
    data = plant.new_data()
    data.qvel[:] = SWING
    mujoco.mj_step(plant.model, data, nstep=steps)
