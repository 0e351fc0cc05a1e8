"""A structure on the bench as an environment of Gymnasium.

The agent reads velocity sensors and commands force coils through the laboratory's converters, amplifiers and coils. An
episode starts from a static deflection by random forces at the coils, and the task is to take the energy out.
"""

from collections.abc import Sequence
from typing import Any, ClassVar

import mujoco
import numpy as np

from vlab.controllers import Controller
from vlab.controllers.user_law import code_of
from vlab.errors import BadExperiment
from vlab.hardware import load_hardware
from vlab.hardware.back_emf import brake_plant
from vlab.hardware.sensing import Sampling
from vlab.lab.loop import ControlLoop
from vlab.physics.attach import attach
from vlab.physics.spec import parse_effect
from vlab.plants import build_plant
from vlab.plants.base import check_run
from vlab.signals import Array
from vlab.structure import load_structure

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as error:
    raise ImportError("vlab.environments needs gymnasium; pip install 'vlab-vibration[gym]'") from error

IDS = {"vlab/Beam-v0": "beam", "vlab/Grid-v0": "grid"}
"""Registered names of the environments with their structures."""


class _Held:
    """A law that holds the commands of the agent."""

    def __init__(self, sensors: tuple[str, ...], actuators: tuple[str, ...]) -> None:
        self.sensors, self.actuators = sensors, actuators
        self.forces = np.zeros(len(actuators))

    def reset(self) -> None:
        """Command no force."""
        self.forces = np.zeros(len(self.actuators))

    def step(self, y: Array) -> Array:
        """Return the held forces [N], (n_actuators,)."""
        return self.forces


class StructureEnv(gymnasium.Env):
    """Active vibration control of a structure.

    An observation holds the velocities at the sensors [m/s], (n_sensors,). An action holds one force for each coil,
    (n_coils,), from -1 to 1 in units of `limit`. The reward of a step is -(E/E0 + w mean(a^2)) h: mechanical energy E,
    its start E0, weight w = `effort`, action a, duration h of the step [s].

    Parameters
    ----------
    structure : str
        ``"beam"``, ``"grid"``, or a structure file.
    plant, variant : str
        MuJoCo model and variant of the structure.
    decisions_hz : float
        Rate of actions [Hz]; the rate of the converter is a multiple of this rate.
    seconds : float
        Duration of an episode [s].
    limit : float
        Largest force of a coil [N].
    level : float
        Largest static force at a coil before the start [N].
    effort : float
        Weight of the action in the reward.
    noise : float
        Rms noise of the velocity sensors [m/s].
    effects : sequence of str
        Effects of the catalogue in the plant, as ``"NAME@PLACE:parameter=value"``.

    Raises
    ------
    BadExperiment
        A setting is impossible.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(
        self,
        structure: str = "beam",
        *,
        plant: str = "composite",
        variant: str = "published",
        decisions_hz: float = 200.0,
        seconds: float = 10.0,
        limit: float = 0.5,
        level: float = 0.5,
        effort: float = 0.01,
        noise: float = 0.0,
        effects: Sequence[str] = (),
        render_mode: None = None,
    ) -> None:
        named = {"decisions_hz": decisions_hz, "seconds": seconds, "limit": limit, "level": level}
        for name, value in named.items():
            if not (np.isfinite(value) and value > 0):
                raise BadExperiment(f"{name} is {value:g}; give a positive number")
        settings = (f"velocity_sensor.noise={noise!r}m/s",) if noise else ()
        self._hardware = load_hardware(None, settings)
        code = tuple(filter(None, (code_of(text.partition("@")[0].strip()) for text in effects)))
        built = build_plant(load_structure(structure), plant, variant)
        self._plant = brake_plant(attach(built, [parse_effect(text, code=code) for text in effects]), self._hardware)
        rate = self._hardware.converter.rate
        self._per_decision = round(rate / decisions_hz)
        if self._per_decision < 1 or abs(self._per_decision * decisions_hz / rate - 1) > 1e-9:
            raise BadExperiment(f"decisions at {decisions_hz:g} Hz are no whole part of the converter's {rate:g} Hz")
        self._decisions = round(seconds * decisions_hz)
        self._substeps = self._plant.substeps(rate)
        self._period = self._per_decision / rate
        self._limit, self._level, self._effort = limit, level, effort
        taps = enumerate(self._plant.sensors)
        self._seen = np.array([i for i, tap in taps if tap.name.startswith("sensor:") and tap.kind == "velocity"])
        self.sensors = tuple(self._plant.sensors[i].name for i in self._seen)
        self.actuators = tuple(tap.name for tap in self._plant.actuators)
        linear = self._plant.linearise()
        self._mass, self._stiffness = linear.M, linear.K
        self._rest = self._plant.new_data().qpos.copy()
        self._static = self._static_shapes()
        self.observation_space = spaces.Box(-np.inf, np.inf, (len(self.sensors),), np.float64)
        self.action_space = spaces.Box(-1.0, 1.0, (len(self.actuators),), np.float64)
        self.render_mode = render_mode
        self._loop: ControlLoop | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode from a static deflection.

        Parameters
        ----------
        seed : int, optional
            Seed of deflection and noise.
        options : dict, optional
            ``{"forces": (n_coils,) array}`` sets the static forces [N] in place of random ones.

        Returns
        -------
        observation : (n_sensors,) array
            Velocities [m/s].
        info : dict
            ``time`` [s], ``energy`` [J] and the static ``forces`` [N].
        """
        super().reset(seed=seed)
        model, samples = self._plant.model, self._decisions * self._per_decision
        is_velocity = np.array([tap.kind == "velocity" for tap in self._plant.sensors])
        self._held = _Held(tuple(n.removeprefix("sensor:") for n in self.sensors), self.actuators)
        law: Controller = self._held
        self._loop = ControlLoop(
            self._plant,
            self._hardware,
            law,
            added=np.zeros((samples * self._substeps, len(self.actuators))),
            sampling=Sampling.draw(self._hardware, is_velocity, samples + 1, self.np_random),
            samples=samples,
            substeps=self._substeps,
            frame_every=samples,
        )
        forces = self.np_random.uniform(-self._level, self._level, len(self.actuators))
        if options is not None and "forces" in options:
            forces = np.asarray(options["forces"], dtype=float)
            if forces.shape != (len(self.actuators),) or not np.isfinite(forces).all():
                raise BadExperiment(f"forces are of shape {forces.shape}; give {len(self.actuators)} finite numbers")
        mujoco.mj_integratePos(model, self._loop.data.qpos, self._static @ forces, 1.0)
        self._done = 0
        mujoco.mj_forward(model, self._loop.data)
        self._first = max(self.energy, np.finfo(float).tiny)
        return self._observation(), {**self._info(), "forces": forces}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Hold an action for one decision.

        Parameters
        ----------
        action : (n_coils,) array
            Forces in units of the limit; values outside -1 to 1 are clipped.

        Returns
        -------
        observation : (n_sensors,) array
            Velocities [m/s].
        reward : float
            Minus relative energy and effort over the step.
        terminated, truncated : bool
            False; whether the episode is over.
        info : dict
            ``time`` [s] and ``energy`` [J].

        Raises
        ------
        BadExperiment
            The episode has not started or is over.
        """
        if self._loop is None or self._done >= self._decisions:
            raise BadExperiment("the episode has not started or is over; call reset()")
        data, model = self._loop.data, self._plant.model
        given = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        self._held.forces = self._limit * given
        self._loop.advance(self._per_decision * self._substeps)
        self._done += 1
        check_run(model, data, self._done * self._period)
        mujoco.mj_forward(model, data)  # sensors at the end of the step, without the callback
        cost = self.energy / self._first + self._effort * float(np.mean(given**2))
        truncated = self._done >= self._decisions
        return self._observation(), -cost * self._period, False, truncated, self._info()

    @property
    def energy(self) -> float:
        """Mechanical energy of the linearised structure [J]."""
        assert self._loop is not None
        data, model = self._loop.data, self._plant.model
        away = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, away, 1.0, self._rest, data.qpos)
        return float(away @ self._stiffness @ away + data.qvel @ self._mass @ data.qvel) / 2

    def _static_shapes(self) -> Array:
        """Return static deflections (n_dofs, n_coils) under unit forces of the coils."""
        return np.asarray(np.linalg.lstsq(self._stiffness, self._plant.actuator_forces(), rcond=1e-12)[0])

    def _observation(self) -> Array:
        assert self._loop is not None
        raw = self._loop.data.sensordata
        travel = raw[self._plant.travel]
        sample = self._done * self._per_decision
        values = self._loop.sampling.samples(self._plant.sensor_matrix @ raw, travel if travel.size else None, sample)
        return np.asarray(values[self._seen], dtype=np.float64)

    def _info(self) -> dict[str, Any]:
        return {"time": self._done * self._period, "energy": self.energy}


def register() -> None:
    """Register `IDS` for ``gymnasium.make``; the entry point of vlab calls this function."""
    for name, structure in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(id=name, entry_point="vlab.environments:StructureEnv", kwargs={"structure": structure})
