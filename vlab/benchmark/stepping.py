"""CPU times of experiments beside bare MuJoCo and python-control."""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco
import numpy as np

from vlab.cases.case import load_case
from vlab.cases.clock import plan_clock
from vlab.cases.initial_state import InitialState
from vlab.cases.simulate import simulate
from vlab.fe import build_fe_model
from vlab.files.assets import asset
from vlab.lab import Experiment, run_experiment
from vlab.lab.excitation import Multisine
from vlab.lab.laws import published_law
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import effect_named
from vlab.plants import Plant, build_plant
from vlab.structure import load_structure

SECONDS, RUNS = 10.0, 5
"""SECONDS, RUNS [s, 1]: simulated time of a run, and runs of which the median counts."""
SWING = 1e-3
"""SWING [m/s, rad/s]: initial velocity of every coordinate in bare steps."""
STRUCTURES, PLANTS = ("beam", "grid"), ("composite", "modal", "fe")
"""STRUCTURES, PLANTS [-]: timed structures and plants."""
REPLAYED = {"avc_cantilever/free_decay": "joint:hinge1", "emps/case": "joint:slide"}
"""REPLAYED [-]: replayed cases, with the joint of the added hysteresis."""
HYSTERESIS = {"force": 0.1, "yield": 0.01}
"""HYSTERESIS [SI]: parameters of the added law."""


@dataclass(frozen=True, kw_only=True)
class Stepping:
    """CPU times of an experiment and its peer, per simulated second.

    The ratio is peer over ours.
    """

    work: str
    ours_s: float
    peer: str
    peer_s: float
    ratio: float


def cpu_seconds() -> float:
    """Return the CPU time with that of ended children [s]."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def shortest(work: Callable[[], Any], times: int, clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the shortest of several timings.

    Parameters
    ----------
    work : callable
        Work.
    times : int
        Number of timings.
    clock : callable
        Clock [s]; elapsed time by default.

    Returns
    -------
    float
        Time [s].
    """
    taken = []
    for _ in range(times):
        begun = clock()
        work()
        taken.append(clock() - begun)
    return min(taken)


def cpu_times(
    ours: Callable[[], Any], peer: Callable[[], Any], runs: int, *, is_warm: bool = False
) -> tuple[float, float, float]:
    """Return the median CPU times of two works, and their ratio.

    The works take turns, so a slow phase of the machine meets both. Processes that they fork count.

    Parameters
    ----------
    ours, peer : callable
        Works.
    runs : int
        Number of turns.
    is_warm : bool
        Whether the first turn counts; otherwise each work runs once before its time is taken.

    Returns
    -------
    tuple of float
        Time of both works [s], and peer over ours of one turn.
    """
    taken = np.zeros((runs, 2))
    for turn in range(runs if is_warm else runs + 1):
        for column, work in enumerate((ours, peer)):
            begun = cpu_seconds()
            work()
            taken[turn % runs, column] = cpu_seconds() - begun
    ours_s, peer_s = np.median(taken, axis=0)
    return float(ours_s), float(peer_s), float(np.median(taken[:, 1] / taken[:, 0]))


def stepping_times(*, progress: Callable[[str], None] = lambda text: None) -> Iterator[Stepping]:
    """Time an experiment beside bare steps of its plant.

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
            ours_s, bare_s, ratio = cpu_times(partial(run_experiment, experiment), partial(_bare, plant, steps), RUNS)
            yield Stepping(
                work=f"{structure}, {name} plant, MFDRF at 2 kHz: an experiment, CPU seconds per simulated second",
                ours_s=ours_s / SECONDS,
                peer="bare mj_step(nstep) of the same plant, without law, converters and recording",
                peer_s=bare_s / SECONDS,
                ratio=ratio,
            )


def linear_times(*, progress: Callable[[str], None] = lambda text: None) -> Iterator[Stepping]:
    """Time an experiment on a linear plant beside python-control.

    Both simulate the response to one force without a law.

    Parameters
    ----------
    progress : callable
        Receives the present work.

    Yields
    ------
    Stepping
        Times of one structure.
    """
    import control

    for structure in STRUCTURES:
        progress(f"steps of the {structure}'s linear plant")
        built = load_structure(structure)
        plant, fe = build_plant(built, "linear"), build_fe_model(built)
        excitation = Multisine(level=0.2, period_s=SECONDS, seed=1)
        experiment = Experiment(plant=plant, seconds=SECONDS, excitation=excitation)
        model = control.StateSpace(*fe.linear.state_matrices(fe.coils[:, :1], fe.coils.T))
        times = np.arange(round(SECONDS / plant.timestep)) * plant.timestep
        theirs = partial(control.forced_response, model, times, excitation.sample(times))
        ours_s, peer_s, ratio = cpu_times(partial(run_experiment, experiment), theirs, RUNS)
        yield Stepping(
            work=f"{structure}, linear plant, no law: an experiment, CPU seconds per simulated second",
            ours_s=ours_s / SECONDS,
            peer=f"control.forced_response on the FE model of {len(model.A)} states",
            peer_s=peer_s / SECONDS,
            ratio=ratio,
        )


def replay_times(*, progress: Callable[[str], None] = lambda text: None) -> Iterator[Stepping]:
    """Time replays of real recordings beside bare steps of their plants.

    A replay includes inputs, readings and resampling, alone and with hysteresis at a joint.

    Parameters
    ----------
    progress : callable
        Receives the present work.

    Yields
    ------
    Stepping
        Times of one recording, with or without hysteresis.
    """
    for name, joint in REPLAYED.items():
        progress(f"replay of {name}")
        case = load_case(asset(f"cases/{name}.toml"))
        run, law = case.runs(("fit",))[0], Attached(effect_named("bouc-wen"), joint, HYSTERESIS)
        start = InitialState(qpos=case.plant.new_data().qpos.copy(), qvel=np.zeros(case.plant.model.nv), how="given")
        seconds = float(run.measured.time[-1] - run.measured.time[0])
        steps = round(seconds / plan_clock(case.plant.timestep, run).timestep)
        for what, plant in (("without a law", case.plant), ("with hysteresis at a joint", attach(case.plant, [law]))):
            ours = partial(simulate, plant, run, initial=start)
            ours_s, bare_s, ratio = cpu_times(ours, partial(_bare, case.plant, steps), RUNS)
            yield Stepping(
                work=f"{name}: a recording replayed {what}, CPU seconds per recorded second",
                ours_s=ours_s / seconds,
                peer="bare mj_step(nstep) of the same model, without law, inputs and readings",
                peer_s=bare_s / seconds,
                ratio=ratio,
            )


def _bare(plant: Plant, steps: int) -> None:
    """Step a swinging plant without input.

    At rest, sines and products of zero are cheaper.
    """
    data = plant.new_data()
    data.qvel[:] = SWING
    mujoco.mj_step(plant.model, data, nstep=steps)
