"""Experiment: wiring, duration and seed in, recording out."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from vlab.controllers import Controller
from vlab.errors import BadExperiment
from vlab.hardware.back_emf import brake_plant
from vlab.hardware.laboratory import Hardware, load_hardware
from vlab.hardware.sensing import Sampling
from vlab.lab.effort import ActuatorEffort, actuator_efforts
from vlab.lab.excitation import Excitation, Release, forces_at
from vlab.lab.loop import ControlLoop
from vlab.plants.base import Plant, check_run
from vlab.signals import Array, Channel, Recording

FRAMES_HZ = 60.0
"""FRAMES_HZ [Hz]: rate of the configurations kept for views."""
CHUNK_STEPS = 2000
"""CHUNK_STEPS [1]: integration steps between checks for divergence."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Description of an experiment.

    Parameters
    ----------
    plant : Plant
        Plant on the bench.
    seconds : float
        Duration [s].
    excitation : Excitation or None
        Signal added to the command of `excite`.
    excite : str
        Exciting actuator, or several with commas between; the first actuator by default.
    controller : Controller or None
        Law in the loop.
    hardware : Hardware
        Hardware; the laboratory's by default.
    seed : int
        Seed of the sensor noise.
    """

    plant: Plant
    seconds: float
    excitation: Excitation | None = None
    excite: str = ""
    controller: Controller | None = None
    hardware: Hardware = field(default_factory=load_hardware)
    seed: int = 0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.seconds) and 0 < self.seconds <= 86400):
            raise BadExperiment(f"a duration of {self.seconds} s cannot be run; accepted: above 0 up to a day")
        if self.seconds * self.hardware.converter.rate < 2:
            raise BadExperiment(f"{self.seconds} s at {self.hardware.converter.rate:g} Hz are fewer than 2 samples")
        places = self.excite.split(",")
        if len(set(places)) < len(places):
            raise BadExperiment(f"the excitation acts twice at one place ({self.excite}); name every actuator once")


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """Result of an experiment.

    Parameters
    ----------
    recording : Recording
        All channels at the sample rate.
    frame_times : (n_frames,) array
        Times of the stored configurations [s].
    frames : (n_frames, nq) array
        Configurations for views.
    effort : tuple of ActuatorEffort
        Effort of every actuator.
    is_compiled : bool
        Whether the loop ran in compiled code, see `vlab.lab.loop.can_compile`.
    """

    recording: Recording
    frame_times: Array
    frames: Array
    effort: tuple[ActuatorEffort, ...] = ()
    is_compiled: bool = False


def run_experiment(
    experiment: Experiment,
    *,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[float, Callable[[], Result]], None] | None = None,
) -> Result:
    """Run an experiment.

    Parameters
    ----------
    experiment : Experiment
        Description of the experiment.
    progress : callable or None
        Called with the simulated seconds done.
    watch : callable or None
        Called with the simulated seconds done and a function that returns the result so far.

    Returns
    -------
    Result
        Recording, frames and effort.

    Raises
    ------
    BadExperiment
        A rate that does not fit the step, or an actuator that does not exist.
    Diverged
        The run became nonfinite or MuJoCo reset the state.
    """
    plant = brake_plant(experiment.plant, experiment.hardware)
    rate = experiment.hardware.converter.rate
    substeps = plant.substeps(rate)
    samples = round(experiment.seconds * rate)
    steps = samples * substeps
    targets = [plant.actuator_index(at) for at in experiment.excite.split(",")] if experiment.excite else [0]
    middles = (np.arange(steps) + 0.5) * plant.timestep
    added = np.zeros((steps, len(plant.actuators)))
    if experiment.excitation is not None:
        added[:, targets] = forces_at(experiment.excitation, middles, len(targets))
    is_velocity = np.array([tap.kind == "velocity" for tap in plant.sensors])
    sampling = Sampling.draw(experiment.hardware, is_velocity, samples, np.random.default_rng(experiment.seed))
    loop = ControlLoop(
        plant,
        experiment.hardware,
        experiment.controller,
        added=added,
        sampling=sampling,
        samples=samples,
        substeps=substeps,
        frame_every=max(1, round(rate / FRAMES_HZ)),
    )
    if isinstance(experiment.excitation, Release):
        _pull(plant, loop.data, targets[0], experiment.excitation.level)
    times = np.arange(samples) / rate

    def so_far() -> Result:
        applied = loop.applied
        return Result(
            recording=_record(experiment, loop, times, targets, applied),
            frame_times=times[:: loop.frame_every],
            frames=loop.frames,
            effort=actuator_efforts(plant.actuators, loop.commands, applied, loop.saturated),
            is_compiled=loop.is_compiled,
        )

    def after(done_s: float) -> None:
        if progress is not None:
            progress(done_s)
        if watch is not None:
            watch(done_s, so_far)

    done = 0
    while done < steps:
        chunk = min(CHUNK_STEPS, steps - done)
        loop.advance(chunk)
        done += chunk
        check_run(plant.model, loop.data, done * plant.timestep)
        after(done * plant.timestep)
    return so_far()


def _pull(plant: Plant, data: Any, actuator: int, force: float) -> None:
    """Set the static deflection under an actuator force.

    The linearised stiffness gives the deflection.
    """
    load = plant.actuator_forces()[:, actuator] * force
    shape = np.linalg.lstsq(plant.linearise().K, load, rcond=1e-12)[0]
    mujoco.mj_integratePos(plant.model, data.qpos, shape, 1.0)
    mujoco.mj_forward(plant.model, data)


def _record(experiment: Experiment, loop: ControlLoop, times: Array, targets: list[int], applied: Array) -> Recording:
    plant = experiment.plant
    excited = experiment.excitation is not None and not isinstance(experiment.excitation, Release)
    sampled = loop.sampled
    channels: list[Channel] = []
    columns: list[Array] = []
    if excited and experiment.excitation is not None:
        for target, signal in zip(targets, forces_at(experiment.excitation, times, len(targets)).T, strict=True):
            tap = plant.actuators[target]
            channels.append(
                Channel(name=f"excitation:{tap.at}", kind="excitation", unit=tap.unit, at=tap.at, is_input=True)
            )
            columns.append(signal)
    for i, tap in enumerate(plant.actuators):
        if experiment.controller is not None:
            channels.append(Channel(name=f"command:{tap.at}", kind="command", unit=tap.unit, at=tap.at))
            columns.append(loop.commands[:, i])
        channels.append(Channel(name=f"{tap.kind}:{tap.at}", kind=tap.kind, unit=tap.unit, at=tap.at))
        columns.append(applied[:, i])
    for i, sensor in enumerate(plant.sensors):
        channels.append(Channel(name=sensor.name, kind=sensor.kind, unit=sensor.unit, at=sensor.at))
        columns.append(sampled[:, i])
    meta: dict[str, Any] = {"plant": plant.name, "seed": experiment.seed, "rate_hz": experiment.hardware.converter.rate}
    if excited and experiment.excitation is not None:
        meta |= experiment.excitation.facts
    data = np.column_stack(columns)
    data.setflags(write=False)  # the recording takes the array as its own
    return Recording(time=times, data=data, channels=tuple(channels), meta=meta)
