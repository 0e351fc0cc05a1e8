"""The loop that MuJoCo calls: gated on the sample clock, it samples, runs the law, and turns commands into forces."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from controllers import Controller
from vlab.errors import BadController
from vlab.hardware.laboratory import Hardware
from vlab.hardware.output_chain import OutputChain
from vlab.hardware.sensing import Sampling
from vlab.plants.base import Plant
from vlab.signals import Array


class ControlLoop:
    """Wiring and memory of one experiment; `callback` is what MuJoCo calls once an integration step.

    Between two samples nothing but the stored mean forces is applied. A call that repeats a step (`mj_forward`, stages
    of a Runge-Kutta step) changes nothing.

    Parameters
    ----------
    plant, hardware, controller
        The parts; no controller means no feedback.
    added : (n_steps, n_actuators) array
        Force added behind the filter in every integration step.
    sampling : Sampling
        Roll-off, noise and quantisation of the sensors.
    samples, substeps : int
        How many samples to run, and integration steps per sample.
    frame_every : int
        Samples between stored configurations, for views.
    """

    def __init__(
        self,
        plant: Plant,
        hardware: Hardware,
        controller: Controller | None,
        *,
        added: Array,
        sampling: Sampling,
        samples: int,
        substeps: int,
        frame_every: int,
    ) -> None:
        self.plant, self.hardware, self.controller, self.sampling = plant, hardware, controller, sampling
        self.added, self.substeps, self.frame_every = added, substeps, frame_every
        self.data = mujoco.MjData(plant.model)
        n_actuators = len(plant.actuators)
        self._addresses = np.array([tap.address for tap in plant.sensors], dtype=int)
        self._rates = np.array([tap.address if tap.rate_address is None else tap.rate_address for tap in plant.sensors], dtype=int)
        self._stagger = np.array([0.0 if tap.rate_address is None else plant.timestep / 2 for tap in plant.sensors])
        self._raw = np.zeros((samples, plant.model.nsensordata))
        self._travels = np.zeros((samples, int(sampling.is_velocity.sum())))
        self.commands = np.zeros((samples, n_actuators))
        self._applied = np.zeros((len(added), n_actuators))
        self.frames = np.zeros((-(-samples // frame_every), plant.model.nq))
        if controller is not None:
            self._check_law(controller)
        self.callback = self._compile()

    @property
    def sampled(self) -> Array:
        """What the sensors gave at every sample, (n_samples, n_sensors)."""
        values = self._raw[:, self._addresses] - self._stagger * self._raw[:, self._rates]
        travels = self._travels if self.plant.travel is not None else None
        return self.sampling.samples(values, travels, slice(None))

    @property
    def applied(self) -> Array:
        """Mean force at every actuator over every sample, (n_samples, n_actuators)."""
        return self._applied.reshape(-1, self.substeps, self._applied.shape[1]).mean(axis=1)

    def _check_law(self, controller: Controller) -> None:
        self._from = np.array([self.plant.sensor_index(name) for name in controller.sensors], dtype=int)
        self._to = np.array([self.plant.actuator_index(name) for name in controller.actuators], dtype=int)
        controller.reset()
        try:
            out = np.asarray(controller.step(np.zeros(len(self._from))), dtype=float)
        except (ValueError, TypeError, IndexError) as error:
            raise BadController(f"the law fails on {len(self._from)} samples ({', '.join(controller.sensors)}): {error}") from error
        if out.shape != (len(self._to),):
            raise BadController(f"the law gives {out.shape} commands; {len(self._to)} are wired to ({', '.join(controller.actuators)})")
        controller.reset()

    def _feedback(self) -> Callable[[int], Array] | None:
        """Return the function that samples, runs the law and gives the mean forces of the coming steps."""
        controller = self.controller
        if controller is None:
            return None
        chain = OutputChain(self.hardware.converter, channels=len(self._to), substeps=self.substeps)
        law, push, commands = controller.step, chain.push, self.commands
        sensordata, travels, sampling = self.data.sensordata, self._travels, self.sampling
        wired, addresses, rates, stagger = self._from, self._addresses, self._rates, self._stagger
        direct = addresses[wired]
        plain = sampling.is_ideal and not np.any(stagger[wired])
        half_travel = self.hardware.velocity_sensor.linear_range / 2
        everywhere = list(self._to) == list(range(commands.shape[1]))
        forces, to = np.zeros((self.substeps, commands.shape[1])), self._to

        def tick(sample: int) -> Array:
            in_travel = True
            for x in travels[sample].tolist():  # a few plain floats compare faster than an array
                in_travel = in_travel and -half_travel <= x <= half_travel
            if plain and in_travel:
                y = sensordata[direct]
            else:
                values = sensordata[addresses] - stagger * sensordata[rates]
                y = sampling.samples(values, travels[sample], sample)[wired]
            command = law(y)
            if everywhere:
                commands[sample] = command
                return push(command)
            commands[sample, to] = command
            forces[:, to] = push(command)
            return forces

        return tick

    def _compile(self) -> Callable[[Any, Any], None]:
        """Bind everything the callback needs to local names: it runs two thousand times a simulated second."""
        plant, data, substeps = self.plant, self.data, self.substeps
        added, applied, raw, travels, frames = self.added, self._applied, self._raw, self._travels, self.frames
        ctrl, qvel, qpos, sensordata, generalised = data.ctrl, data.qvel, data.qpos, data.sensordata, data.qfrc_applied
        travel = None if plant.travel is None else plant.travel(data)
        dissipate = None if plant.dissipation is None else (-plant.dissipation).dot  # the method is twice as fast as np.dot
        limit_forces = self._amplifier()
        tick, frame_every = self._feedback(), self.frame_every
        per_step, n_steps, add = 1.0 / plant.timestep, len(added), np.add
        forces = np.zeros((substeps, ctrl.size))
        last = -1

        def callback(model: Any, data: Any) -> None:
            nonlocal last, forces
            step = int(data.time * per_step + 0.5)
            if step == last or step >= n_steps:
                return
            last = step
            if substeps == 1:
                sample, part = step, 0
            else:
                sample, part = divmod(step, substeps)
            if part == 0:
                raw[sample] = sensordata
                if travel is not None:
                    travels[sample] = travel()
                if sample % frame_every == 0:
                    frames[sample // frame_every] = qpos
                if tick is not None:
                    forces = tick(sample)
            add(forces[part], added[step], ctrl)
            if limit_forces is not None:
                limit_forces()
            applied[step] = ctrl
            if dissipate is not None:
                dissipate(qvel, generalised)

        return callback

    def _amplifier(self) -> Callable[[], None] | None:
        """Return what the amplifiers do to the forces in place: their limit, and braking without current control."""
        coil = self.hardware.coil
        places = {tap.at: tap.address for tap in self.plant.sensors if tap.kind == "velocity"}
        braked = [i for i, a in enumerate(self.plant.actuators) if a.at in places] if coil.back_emf_damping else []
        if not coil.limit and not braked:
            return None
        ctrl, sensordata = self.data.ctrl, self.data.sensordata
        velocities = [places[self.plant.actuators[i].at] for i in braked]

        def limit_forces() -> None:
            if coil.limit:
                np.clip(ctrl, -coil.limit, coil.limit, out=ctrl)
            if braked:
                ctrl[braked] -= coil.back_emf_damping * sensordata[velocities]

        return limit_forces
