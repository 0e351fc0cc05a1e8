"""Control loop with a linear law as one compiled function.

Law and output chain are one discrete linear system. From its state z and the samples y follow the commands u of the
sample and the mean forces f of the sample's steps,

    [u, f, z+] = F [z, y].

Between the two halves of a MuJoCo step the function samples the sensors, evaluates F, limits and brakes the forces, writes
the controls and records. A linear plant takes exact steps in place of MuJoCo's. Sums have another order than numpy's, so
results agree with those of the loop in Python to rounding.
"""

from typing import Any, NamedTuple

import numpy as np

from vlab.compilation import compiled
from vlab.controllers.linear import Matrices
from vlab.hardware.output_chain import OutputChain
from vlab.hardware.sensing import Sampling
from vlab.lab.callback import callback_kept
from vlab.plants.base import Plant
from vlab.plants.compiled_steps import first_half, second_half
from vlab.plants.linear import ExactMotion
from vlab.signals import Array

SUMS = {"contract", "reassoc"}
"""SUMS [-]: freedoms of the compiler in sums of products: order, and multiplication with addition in one rounding."""


class CompiledLoop(NamedTuple):
    """Arrays of one experiment, for the compiled function.

    Parameters
    ----------
    qpos, qvel, sensordata, ctrl, generalised : array
        Views of the arrays of `MjData`; the last is ``qfrc_applied``.
    sensing : (n_sensors, n_sensordata) array
        Matrix from ``sensordata`` to the sensors that the law reads; no rows without a law.
    travel : (n_sensors,) array of int
        Index in ``sensordata`` of each coil's travel; -1 for a probe or an unknown travel.
    share, steps : (n_sensors,) array
        Share of each signal at the converter [1], and quantisation step; 0 for none.
    half : float
        Half of the coils' linear travel [m].
    noise : (n_samples, n_sensors) array
        Noise, pick-up and drift; no rows without them.
    system : array
        Matrix F of law and output chain, see `system_of`; empty without a law.
    given, result : array
        Vectors [z, y] and [u, f, z+].
    added : (n_steps, n_actuators) array
        Force added behind the filter [N].
    limit : float
        Limit of the amplifiers [N]; infinite for none.
    brakes : (n_actuators, n_sensordata) array
        Matrix from ``sensordata`` to the forces by which the coils brake themselves; empty for none.
    controls : (nu, n_actuators) array
        Matrix from forces to controls.
    dissipation, restoring : (nv, nv) array
        Matrices of the plant; empty for none.
    rest : (nq,) array
        Configuration without restoring force.
    modes, spin, drive, readout, positions, velocities : array
        State and matrices of a linear plant, see `exact_of`; empty for a plant in MuJoCo's steps.
    raw, frames, commands, forces, over : array
        Records of `vlab.lab.loop.ControlLoop`: ``sensordata`` and commands a sample, configurations, forces a step, and
        steps beyond the limit.
    """

    qpos: Array
    qvel: Array
    sensordata: Array
    ctrl: Array
    generalised: Array
    sensing: Array
    travel: Array
    share: Array
    steps: Array
    half: float
    noise: Array
    system: Array
    given: Array
    result: Array
    added: Array
    limit: float
    brakes: Array
    controls: Array
    dissipation: Array
    restoring: Array
    rest: Array
    modes: Array
    spin: Array
    drive: Array
    readout: Array
    positions: Array
    velocities: Array
    raw: Array
    frames: Array
    commands: Array
    forces: Array
    over: Array
    force: Array
    braking: Array
    moved: Array
    restored: Array

    def advance(self, addresses: tuple[int, int], first: int, count: int, every: tuple[int, int]) -> None:
        """Run steps.

        Parameters
        ----------
        addresses : tuple of int
            Addresses of MuJoCo's model and data.
        first, count : int
            Index of the first step, and number of steps.
        every : tuple of int
            Steps per sample, and samples per stored configuration.
        """
        with callback_kept():
            _advance(*addresses, first, count, *every, self)


def system_of(matrices: Matrices, to: Array, chain: OutputChain, n_actuators: int) -> Array:
    """Return the matrix F of a law and its output chain.

    Parameters
    ----------
    matrices : tuple of array
        A, B, C, D of the law.
    to : (n_outputs,) array of int
        Actuators of the law's commands.
    chain : OutputChain
        Output chain of one channel.
    n_actuators : int
        Number of actuators; the others have no command.

    Returns
    -------
    array
        F. Rows: commands, (n_actuators,); forces, (substeps, n_actuators); next state. Columns: state and samples. The
        state holds the law's, then each actuator's filter and past commands.
    """
    A, B, C, D = matrices
    n, n_sensors, n_memory = len(A), B.shape[1], chain.matrix.shape[1] - 1
    memory = np.arange(n, n + n_actuators * n_memory).reshape(n_actuators, n_memory)
    size = n + memory.size
    commands = np.zeros((n_actuators, size + n_sensors))
    commands[to, :n], commands[to, size:] = C, D
    forces, following = np.zeros((chain.substeps, *commands.shape)), np.zeros((size, size + n_sensors))
    following[:n, :n], following[:n, size:] = A, B
    for a in range(n_actuators):
        own = chain.matrix[:, -1:] * commands[a]
        own[:, memory[a]] += chain.matrix[:, :-1]
        forces[:, a], following[memory[a]] = own[: chain.substeps], own[chain.substeps :]
    return np.vstack([commands, forces.reshape(-1, size + n_sensors), following])


def sensing_of(plant: Plant, sampling: Sampling, wired: Array) -> dict[str, Any]:
    """Return the entries of `CompiledLoop` for the wired sensors.

    Parameters
    ----------
    plant : Plant
        Plant with its sensors.
    sampling : Sampling
        Sampling of all sensors.
    wired : (n_sensors,) array of int
        Sensors that the law reads.

    Returns
    -------
    dict of str to object
        Entries by name.
    """
    coil, own = sampling.hardware.velocity_sensor, sampling.only(wired)
    travel = np.full(len(plant.sensors), -1)
    addresses = np.arange(plant.model.nsensordata)[plant.travel]
    if addresses.size:
        travel[sampling.is_velocity] = addresses
    return {
        "sensing": plant.sensor_matrix[wired],
        "travel": travel[wired],
        "share": np.where(own.is_velocity, coil.signal_share, 1.0),
        "steps": np.zeros(len(wired)) if own.steps is None else own.steps,
        "half": coil.linear_range / 2,
        "noise": np.zeros((0, len(wired))) if own.added is None else own.added,
    }


def exact_of(motion: ExactMotion | None) -> dict[str, Any]:
    """Return the entries of `CompiledLoop` for the steps of a linear plant.

    Parameters
    ----------
    motion : ExactMotion or None
        Steps in complex modes; None for a plant in MuJoCo's steps.

    Returns
    -------
    dict of str to array
        Entries by name. `modes` holds real and imaginary parts of z, one after the other.
    """
    if motion is None:
        empty = {name: np.zeros((0, 0)) for name in ("spin", "drive", "readout", "positions", "velocities")}
        return {"modes": np.zeros(0), **empty}
    return {
        "modes": np.zeros(2 * motion.rotation.size),
        "spin": np.array([motion.rotation.real, motion.rotation.imag]),
        "drive": np.ascontiguousarray(np.vstack([motion.drive.real, motion.drive.imag]).T),
        **{
            name: np.ascontiguousarray(np.hstack([matrix.real, -matrix.imag]))
            for name in ("readout", "positions", "velocities")
            for matrix in (getattr(motion, name),)
        },
    }


def own_array(matrix: Array | None) -> Array:
    """Return a writable copy in C order; an empty matrix for None."""
    return np.zeros((0, 0)) if matrix is None else np.array(matrix, dtype=float, order="C")


@compiled(error_model="numpy", fastmath=SUMS)
def _product(matrix: Array, vector: Array, out: Array) -> None:  # pragma: no cover - compiled
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        out[i] = total


@compiled(error_model="numpy")
def _place(positions: Array, modes: Array, rest: Array, qpos: Array) -> None:  # pragma: no cover - compiled
    _product(positions, modes, qpos)
    for i in range(rest.size):
        qpos[i] += rest[i]


@compiled(error_model="numpy", fastmath=SUMS)
def _step(spin: Array, drive: Array, force: Array, modes: Array) -> None:  # pragma: no cover - compiled
    m = spin.shape[1]
    for k in range(m):
        real, imaginary = modes[k], modes[m + k]
        modes[k] = spin[0, k] * real - spin[1, k] * imaginary
        modes[m + k] = spin[1, k] * real + spin[0, k] * imaginary
    for i in range(force.size):
        for k in range(2 * m):
            modes[k] += drive[i, k] * force[i]


@compiled(error_model="numpy", nogil=True)
def _advance(
    model: int, data: int, first: int, count: int, substeps: int, frame_every: int, c: CompiledLoop
) -> None:  # pragma: no cover - compiled
    n_actuators, n_sensors = c.forces.shape[1], c.travel.size
    size = c.given.size - n_sensors
    states, m, has_law = c.result.size - size, c.spin.shape[1], c.system.shape[0] > 0
    force, braking, moved, restored = c.force, c.braking, c.moved, c.restored
    for step in range(first, first + count):
        sample = step // substeps
        part = step - sample * substeps
        if m == 0:
            first_half(model, data)
        elif part == 0 or c.brakes.shape[0] > 0:
            _product(c.readout, c.modes, c.sensordata)
        if part == 0:
            for i in range(c.sensordata.size):
                c.raw[sample, i] = c.sensordata[i]
            if sample % frame_every == 0:
                if m > 0:
                    _place(c.positions, c.modes, c.rest, c.qpos)
                for i in range(c.qpos.size):
                    c.frames[sample // frame_every, i] = c.qpos[i]
        if part == 0 and has_law:
            _product(c.sensing, c.sensordata, c.given[size:])
            for i in range(n_sensors):
                value, gain = c.given[size + i], c.share[i]
                if c.travel[i] >= 0:
                    excess = abs(c.sensordata[c.travel[i]]) - c.half
                    if not excess <= 0.0:  # a travel that is no number spoils the sample
                        beyond = excess / c.half
                        gain /= 1.0 + beyond * beyond
                value *= gain
                if c.noise.shape[0] > 0:
                    value += c.noise[sample, i]
                if c.steps[i] > 0.0:
                    value = c.steps[i] * np.rint(value / c.steps[i])
                c.given[size + i] = value
            _product(c.system, c.given, c.result)
            for i in range(size):
                c.given[i] = c.result[states + i]
            for i in range(n_actuators):
                c.commands[sample, i] = c.result[i]
        if c.brakes.shape[0] > 0:
            _product(c.brakes, c.sensordata, braking)
        for i in range(n_actuators):
            value = c.added[step, i]
            if has_law:
                value += c.result[(1 + part) * n_actuators + i]
            if abs(value) > c.limit:
                c.over[i] += 1.0
                value = c.limit if value > 0.0 else -c.limit
            force[i] = value - braking[i]
            c.forces[step, i] = force[i]
        if m > 0:
            _step(c.spin, c.drive, force, c.modes)
            continue
        _product(c.controls, force, c.ctrl)
        if c.dissipation.shape[0] > 0:
            _product(c.dissipation, c.qvel, c.generalised)
        if c.restoring.shape[0] > 0:
            for i in range(c.rest.size):
                moved[i] = c.qpos[i] - c.rest[i]
            _product(c.restoring, moved, restored)
            for i in range(restored.size):
                c.generalised[i] = restored[i] + (c.generalised[i] if c.dissipation.shape[0] > 0 else 0.0)
        second_half(model, data)
    if m > 0:
        _place(c.positions, c.modes, c.rest, c.qpos)
        _product(c.velocities, c.modes, c.qvel)
