"""Control loop of an experiment, between the halves of MuJoCo's steps.

A linear law without attached effects runs in one compiled function, `vlab.lab.compiled_loop`. Any other loop runs in
MuJoCo's control callback, in Python.
"""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from vlab.controllers import Controller, DirectRateFeedback, LinearLaw, ObserverFeedback
from vlab.controllers.linear import Matrices
from vlab.errors import BadController, BadExperiment
from vlab.hardware.laboratory import Hardware
from vlab.hardware.output_chain import OutputChain
from vlab.hardware.sensing import Sampling
from vlab.lab.callback import control_callback, refuse_foreign_callback
from vlab.physics.port_lines import STAGGERED
from vlab.physics.running import Running
from vlab.plants.base import Plant
from vlab.plants.linear import LinearPlant
from vlab.signals import Array

if TYPE_CHECKING:
    from vlab.lab.compiled_loop import CompiledLoop

PLAIN_LAWS = (LinearLaw, DirectRateFeedback, ObserverFeedback)
"""PLAIN_LAWS [-]: classes of laws that are nothing but their matrices, an observer without a limit."""


def plain_matrices(law: Controller) -> Matrices | None:
    """Return A, B, C, D of a law that is nothing but these matrices.

    Parameters
    ----------
    law : Controller
        Control law.

    Returns
    -------
    tuple of array or None
        Matrices; None for another class, a subclass with methods of its own, and a limited observer.
    """
    own = ("step", "reset", "matrices")
    if set(own) & set(getattr(law, "__dict__", ())) or getattr(law, "limit", None) is not None:
        return None
    for known in PLAIN_LAWS:
        if all(getattr(type(law), name, None) is getattr(known, name) for name in own):
            matrices: Matrices = getattr(law, "matrices")  # noqa: B009 - no member of every law
            return matrices
    return None


def can_compile(plant: Plant, controller: Controller | None) -> bool:
    """Return whether the compiled loop covers a plant and a law.

    The law is linear or absent, and no effect is attached. MuJoCo's step has two halves, which Runge-Kutta has not. No
    sensor reads an acceleration. Compiled code finds MuJoCo's library. A linear plant runs in this loop only.

    Parameters
    ----------
    plant : Plant
        Plant with its effects.
    controller : Controller or None
        Control law; None for no feedback.

    Returns
    -------
    bool
        True for the compiled loop, False for the loop in Python.
    """
    model = plant.model
    if plant.physics or (controller is not None and plain_matrices(controller) is None):
        return False
    if model.opt.integrator not in STAGGERED or model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION:
        return False
    if np.any(model.sensor_needstage == mujoco.mjtStage.mjSTAGE_ACC):
        return False
    from vlab.plants.compiled_steps import IS_AVAILABLE

    return IS_AVAILABLE


class ControlLoop:
    """Wiring and memory of one experiment.

    `advance` runs integration steps, on the path that `is_compiled` names. Between two samples the loop applies stored
    mean forces only. In Python, a repeated step (`mj_forward`, stages of a Runge-Kutta step) changes nothing. The
    compiled loop has a memory of its own and leaves the law at rest.

    Parameters
    ----------
    plant, hardware, controller : Plant, Hardware, Controller or None
        Parts of the loop; None as controller means no feedback.
    added : (n_steps, n_actuators) array
        Force added behind the filter in every integration step [N].
    sampling : Sampling
        Roll-off, noise and quantisation of the sensors.
    samples, substeps : int
        Number of samples, and integration steps per sample.
    frame_every : int
        Samples between stored configurations, for views.

    Raises
    ------
    BadExperiment
        Forces or noise have another length, or a linear plant has effects or a law in Python.
    BadController
        The law does not fit the plant or the rate.
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
        if len(added) != samples * substeps or (sampling.added is not None and len(sampling.added) < samples):
            raise BadExperiment(f"forces and noise do not fit {samples} samples of {substeps} steps; draw them anew")
        self.plant, self.hardware, self.controller, self.sampling = plant, hardware, controller, sampling
        self.added, self.substeps, self.frame_every = added, substeps, frame_every
        self.data = plant.new_data()
        n_actuators = len(plant.actuators)
        self._raw = np.zeros((samples, plant.model.nsensordata))
        self._late = _late_addresses(plant.model)
        self.commands = np.zeros((samples, n_actuators))
        self.forces, self._over, self._done = np.zeros_like(self.added), np.zeros(n_actuators), 0
        self.frames = np.zeros((-(-samples // frame_every), plant.model.nq))
        self._physics = Running(plant, sample=substeps * plant.timestep) if plant.physics else None
        changed = self._physics is not None and self._physics.has_sensors
        self._sensed = np.zeros((samples, len(plant.sensors))) if changed else None
        self._chain = OutputChain(hardware.converter, channels=n_actuators, substeps=substeps)
        if controller is not None:
            self._check_law(controller)
        self._motion = plant.motion if isinstance(plant, LinearPlant) else None
        self._compiled = self._compile() if can_compile(plant, controller) else None
        if self._motion is not None and self._compiled is None:
            raise BadExperiment(
                "the plant 'linear' runs in the compiled loop only: with a linear law or none, and without effects; use the plant 'modal'"
            )
        self._callback = None if self.is_compiled else self._in_python()

    @property
    def is_compiled(self) -> bool:
        """Whether the steps run in compiled code, see `can_compile`."""
        return self._compiled is not None

    def advance(self, steps: int) -> None:
        """Run integration steps.

        Parameters
        ----------
        steps : int
            Number of steps.

        Raises
        ------
        BadExperiment
            The run has fewer steps left, or a foreign control callback is installed.
        """
        left = len(self.added) - self._done
        if steps > left:
            raise BadExperiment(f"{steps} steps were asked of a run with {left} steps left; make the run longer")
        if self._compiled is not None:
            refuse_foreign_callback()
            if self._motion is not None and self._done == 0:
                self._compiled.modes[:] = self._motion.start(self.data.qpos - self.plant.model.qpos0, self.data.qvel)
            addresses = self.plant.model._address, self.data._address
            self._compiled.advance(addresses, self._done, steps, (self.substeps, self.frame_every))
            if self._motion is not None:
                self.data.time = (self._done + steps) * self.plant.timestep
                mujoco.mj_checkPos(self.plant.model, self.data)  # MuJoCo's own steps look for divergence, too
        else:
            assert self._callback is not None
            with control_callback(self.data, self._callback):
                mujoco.mj_step(self.plant.model, self.data, nstep=steps)
        self._done += steps
        if self._late.size and self._done == len(self.added) and self.substeps == 1:
            self._raw[-1, self._late] = self.data.sensordata[self._late]

    @property
    def sampled(self) -> Array:
        """Sensor samples, (n_samples, n_sensors)."""
        if self._sensed is not None:
            return self.sampling.converted(self._sensed, slice(None))
        travel = self._raw[:, self.plant.travel]
        return self.sampling.samples(
            self._raw @ self.plant.sensor_matrix.T, travel if travel.size else None, slice(None)
        )

    @property
    def applied(self) -> Array:
        """Mean actuator force over each sample, (n_samples, n_actuators).

        Effects attached to the actuators act behind the recorded force.
        """
        return self.forces.reshape(-1, self.substeps, self.forces.shape[1]).mean(axis=1)

    @property
    def saturated(self) -> Array:
        """Share of steps at each amplifier's limit, (n_actuators,)."""
        return self._over / len(self.forces)

    def _check_law(self, controller: Controller) -> None:
        self._from = np.array([self.plant.sensor_index(name) for name in controller.sensors], dtype=int)
        self._to = np.array([self.plant.actuator_index(name) for name in controller.actuators], dtype=int)
        rate, made_for = self.hardware.converter.rate, getattr(controller, "rate", None)
        if made_for is not None and abs(made_for / rate - 1) > 1e-9:
            raise BadController(
                f"the law was made for {made_for:g} Hz; the loop samples at {rate:g} Hz: run at --rate {made_for:g}, or design it for this rate"
            )
        controller.reset()
        try:
            out = np.asarray(controller.step(np.zeros(len(self._from))), dtype=float)
        except BadController:
            raise
        except (ValueError, TypeError, IndexError) as error:
            raise BadController(
                f"the law fails on {len(self._from)} samples ({', '.join(controller.sensors)}): {error}"
            ) from error
        if out.shape != (len(self._to),):
            raise BadController(
                f"the law gives {out.shape} commands; {len(self._to)} are wired to ({', '.join(controller.actuators)})"
            )
        controller.reset()

    def _feedback(self) -> Callable[[int], Array] | None:
        """Return the function from sensor data to mean forces.

        The function samples, runs the law and gives the forces of the coming steps.
        """
        controller = self.controller
        if controller is None:
            return None
        law, push, commands, sampling = controller.step, self._chain.push, self.commands, self.sampling
        sensordata, every, wired, to = self.data.sensordata, self.plant.sensor_matrix, self._from, self._to
        direct, plain, own = every[wired].dot, sampling.is_ideal, sampling.only(wired)
        loaded = self.hardware.velocity_sensor.signal_share < 1.0  # the travel of the coils reduces their signal
        travel, half_travel = sensordata[self.plant.travel], self.hardware.velocity_sensor.linear_range / 2
        known_travel = travel if travel.size else None
        sensed = self._sensed
        scattered = list(to) != list(range(commands.shape[1]))
        wide = np.zeros(commands.shape[1])

        def tick(sample: int) -> Array:
            if sensed is not None:
                return answer(sampling.converted(sensed[sample], sample)[wired], sample)
            in_range = not loaded
            for x in travel.tolist():  # plain floats compare faster than an array of a few values
                if not -half_travel <= x <= half_travel:
                    in_range = False
            if not in_range:
                return answer(sampling.samples(every @ sensordata, known_travel, sample)[wired], sample)
            return answer(direct(sensordata) if plain else own.converted(direct(sensordata), sample), sample)

        def answer(y: Array, sample: int) -> Array:
            command = law(y)
            if scattered:
                wide[to] = command
                command = wide
            commands[sample] = command
            return push(command)

        return tick

    def _compile(self) -> "CompiledLoop":
        """Return the compiled loop, at rest."""
        from vlab.lab.compiled_loop import CompiledLoop, exact_of, own_array, sensing_of, system_of

        motion = self._motion
        plant, data, n_actuators = self.plant, self.data, len(self.plant.actuators)
        wired, system = np.zeros(0, dtype=int), np.zeros((0, 0))
        if self.controller is not None:
            matrices = plain_matrices(self.controller)
            assert matrices is not None  # see `can_compile`
            wired, system = self._from, system_of(matrices, self._to, self._chain, n_actuators)
        braked, rows = self._braked()
        brakes = np.zeros((n_actuators if braked else 0, plant.model.nsensordata))
        brakes[braked] = rows
        return CompiledLoop(
            qpos=data.qpos,
            qvel=data.qvel,
            sensordata=data.sensordata,
            ctrl=data.ctrl,
            generalised=data.qfrc_applied,
            **sensing_of(plant, self.sampling, wired),
            system=system,
            given=np.zeros(system.shape[1]),
            result=np.zeros(system.shape[0]),
            added=np.ascontiguousarray(self.added),
            limit=self.hardware.coil.limit or np.inf,
            brakes=brakes,
            controls=own_array(plant.control_matrix),
            dissipation=-own_array(None if motion else plant.dissipation),
            restoring=-own_array(None if motion else plant.restoring),
            rest=plant.model.qpos0.copy(),
            **exact_of(motion),
            raw=self._raw,
            frames=self.frames,
            commands=self.commands,
            forces=self.forces,
            over=self._over,
            force=np.zeros(n_actuators),
            braking=np.zeros(n_actuators),
            moved=np.zeros(plant.model.nq),
            restored=np.zeros(plant.model.nv),
        )

    def _in_python(self) -> Callable[[Any, Any], None]:
        """Return the callback with local names only.

        The callback runs two thousand times a simulated second.
        """
        plant, data, substeps = self.plant, self.data, self.substeps
        qvel, qpos, sensordata, generalised = data.qvel, data.qpos, data.sensordata, data.qfrc_applied
        raw, frames, frame_every, applied = self._raw, self.frames, self.frame_every, self.forces
        added = [(i, self.added[:, i].tolist()) for i in range(self.added.shape[1]) if np.any(self.added[:, i])]
        limit_forces, give = self._amplifier(), self._outlet()
        prescribed = plant.prescribed
        actuate, sense, push = self._attached()
        tick, per_step, n_steps = self._feedback(), 1.0 / plant.timestep, len(self.added)
        forces = np.zeros((substeps, len(plant.actuators)))  # one row a step, used once
        last, late = -1, self._late

        def callback(model: Any, data: Any) -> None:
            nonlocal last, forces
            step = int(data.time * per_step + 0.5)
            if step == last or step >= n_steps:
                return
            last = step
            sample, part = divmod(step, substeps)
            if late.size and step and (step - 1) % substeps == 0:
                raw[(step - 1) // substeps, late] = sensordata[late]
            if part == 0:
                raw[sample] = sensordata
                if sense is not None:
                    sense(sample)
                if sample % frame_every == 0:
                    frames[sample // frame_every] = qpos
                if tick is not None:
                    forces = tick(sample)
                else:
                    forces[:] = 0.0
            force = forces[part]
            for actuator, signal in added:
                force[actuator] += signal[step]
            if limit_forces is not None:
                limit_forces(force)
            applied[step] = force
            if actuate is not None:
                actuate(force)
            give(force)
            if prescribed is not None:
                prescribed(qpos, qvel, generalised)
            if push is not None:
                push(data)

        return callback

    def _attached(
        self,
    ) -> tuple[Callable[[Array], None] | None, Callable[[int], None] | None, Callable[[Any], None] | None]:
        """Return the attached effects on forces, samples and structure.

        Each is None without an effect.
        """
        physics, sensed, sampling, plant = self._physics, self._sensed, self.sampling, self.plant
        if physics is None:
            return None, None, None
        present, ports, period = physics.force, physics.ports, self.substeps * plant.timestep
        sensordata, generalised, stays = self.data.sensordata, self.data.qfrc_applied, plant.prescribed is not None
        travel, every = sensordata[plant.travel], plant.sensor_matrix

        def actuate(force: Array) -> None:
            physics.actuate(force)
            present[:] = force

        def sense(sample: int) -> None:
            values = sampling.rolled_off(every @ sensordata, travel if travel.size else None)
            physics.sense(values, sample * period)
            if sensed is not None:
                sensed[sample] = values

        def push(data: Any) -> None:
            if not stays:
                generalised[:] = 0.0
            if ports is not None:
                ports.push(data, present)

        return actuate, None if sensed is None else sense, None if ports is None else push

    def _outlet(self) -> Callable[[Array], None]:
        """Return the function from actuator forces to MuJoCo's controls.

        Several controls may have the same force.
        """
        ctrl, controls = self.data.ctrl, self.plant.control_matrix
        n = controls.shape[1]
        if n and len(controls) % n == 0 and np.array_equal(controls, np.tile(np.eye(n), (len(controls) // n, 1))):
            return functools.partial(ctrl.reshape(-1, n).__setitem__, slice(None))
        spread = controls.dot
        return lambda force: spread(force, ctrl)

    def _braked(self) -> tuple[list[int], Array]:
        """Return the coils that brake themselves, and their forces per ``sensordata``.

        The rows have the shape (n_braked, n_sensordata).
        """
        coil, plant = self.hardware.coil, self.plant
        places = {tap.at: i for i, tap in enumerate(plant.sensors) if tap.kind == "velocity"}
        braked = [i for i, a in enumerate(plant.actuators) if a.at in places] if coil.back_emf_damping else []
        return braked, coil.back_emf_damping * plant.sensor_matrix[[places[plant.actuators[i].at] for i in braked]]

    def _amplifier(self) -> Callable[[Array], None] | None:
        """Return the in-place amplifier model of the forces.

        The model covers the limit, and braking without current control.
        """
        limit, sensordata, over, (braked, rows) = (
            self.hardware.coil.limit,
            self.data.sensordata,
            self._over,
            self._braked(),
        )
        if not limit and not braked:
            return None

        def limit_forces(force: Array) -> None:
            if limit:
                np.add(over, np.abs(force) > limit, over)
                np.clip(force, -limit, limit, out=force)
            if braked:
                force[braked] -= rows @ sensordata

        return limit_forces


def _late_addresses(model: Any) -> Array:
    """Return the indices in ``sensordata`` of accelerations and forces.

    MuJoCo computes them at the end of a step, from state and forces at its start. A law sees them one step late. The
    recording has them at their own time.
    """
    late = np.flatnonzero(model.sensor_needstage == mujoco.mjtStage.mjSTAGE_ACC)
    parts = [np.arange(model.sensor_adr[i], model.sensor_adr[i] + model.sensor_dim[i]) for i in late]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=int)
