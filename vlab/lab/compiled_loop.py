"""Control loop with a linear law as one compiled function.

Between the two halves of a MuJoCo step the function samples the sensors, runs the law x+ = A x + B y, u = C x + D y and
the output chain, limits and brakes the forces, writes the controls and records. `vlab.lab.loop` chooses the function where
the law, the hardware and the plant allow it. Sums have another order than numpy's, so results agree to rounding.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from vlab.compilation import compiled
from vlab.controllers.linear import Matrices
from vlab.hardware.sensing import Sampling
from vlab.plants.base import Plant
from vlab.plants.compiled_steps import first_half, second_half
from vlab.signals import Array

SUMS = {"contract", "reassoc"}
"""SUMS [-]: freedoms of the compiler in sums of products: order, and multiplication with addition in one rounding."""


class Rows(NamedTuple):
    """A sparse matrix by rows: row i has the entries from `starts[i]` to `starts[i + 1]`."""

    starts: Array
    columns: Array
    values: Array

    @classmethod
    def of(cls, matrix: Array) -> "Rows":
        """Return the nonzero entries of a matrix.

        Parameters
        ----------
        matrix : (n, m) array
            Dense matrix.

        Returns
        -------
        Rows
            Entries, row by row.
        """
        rows, columns = np.nonzero(matrix)
        starts = np.searchsorted(rows, np.arange(len(matrix) + 1))
        return cls(starts.astype(np.int64), columns.astype(np.int64), np.asarray(matrix[rows, columns], dtype=float))


class State(NamedTuple):
    """Views of the arrays of one `MjData`."""

    qpos: Array
    qvel: Array
    sensordata: Array
    ctrl: Array
    applied: Array


class Samples(NamedTuple):
    """Sampling of the sensors that the law reads, in the law's order.

    Parameters
    ----------
    rows : Rows
        From ``sensordata`` to sensor values.
    travel : (n_sensors,) array of int
        Index in ``sensordata`` of each coil's travel; -1 for a probe or an unknown travel.
    share : (n_sensors,) array
        Share of the signal at the converter [1].
    half : float
        Half of the coils' linear travel [m].
    added : (n_samples, n_sensors) array
        Noise, pick-up and drift; no rows without them.
    steps : (n_sensors,) array
        Quantisation steps; 0 for none.
    """

    rows: Rows
    travel: Array
    share: Array
    half: float
    added: Array
    steps: Array


class Law(NamedTuple):
    """A linear law with its memory.

    Parameters
    ----------
    matrix : (n_outputs + n_states, n_states + n_sensors) array
        [[C, D], [A, B]].
    given, result : array
        State and samples [x, y], and commands and next state [u, x+].
    to : (n_outputs,) array of int
        Actuators of the commands; empty without a law.
    """

    matrix: Array
    given: Array
    result: Array
    to: Array


class Output(NamedTuple):
    """The way from commands to MuJoCo's controls.

    Parameters
    ----------
    chain : array
        Matrix of `vlab.hardware.output_chain.OutputChain`.
    memory : (n_actuators, n_columns) array
        State of the filter, past commands and new command.
    means : (n_actuators, n_rows) array
        Result of the last sample: mean forces of its steps, and the next memory.
    added : (n_steps, n_actuators) array
        Force added behind the filter [N].
    limit : float
        Limit of the amplifiers [N]; 0 for none.
    brakes : Rows
        From ``sensordata`` to the force by which each coil brakes itself.
    controls : Rows
        From forces to controls.
    dissipation, restoring : array
        Matrices of the plant, (nv, nv); (0, 0) for none.
    rest : array
        Configuration at equilibrium.
    """

    chain: Array
    memory: Array
    means: Array
    added: Array
    limit: float
    brakes: Rows
    controls: Rows
    dissipation: Array
    restoring: Array
    rest: Array


class Records(NamedTuple):
    """Recorded arrays, see `vlab.lab.loop.ControlLoop`."""

    raw: Array
    frames: Array
    commands: Array
    forces: Array
    over: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class CompiledLoop:
    """Compiled steps of one experiment.

    Parameters
    ----------
    model, data : object
        MuJoCo's model and data.
    substeps, frame_every : int
        Steps per sample, and samples per stored configuration.
    samples, law, output, records : NamedTuple
        Parts of the loop.
    """

    model: Any
    data: Any
    substeps: int
    frame_every: int
    samples: Samples
    law: Law
    output: Output
    records: Records

    def advance(self, first: int, count: int) -> None:
        """Run steps.

        Parameters
        ----------
        first : int
            Index of the first step.
        count : int
            Number of steps.
        """
        data = self.data
        state = State(data.qpos, data.qvel, data.sensordata, data.ctrl, data.qfrc_applied)
        which = (first, count, self.substeps, self.frame_every)
        _advance(
            self.model._address, data._address, which, state, self.samples, self.law, self.output, self.records
        )


def samples_of(plant: Plant, sampling: Sampling, wired: Array) -> Samples:
    """Return the sampling of the wired sensors.

    Parameters
    ----------
    plant : Plant
        Plant with its sensors.
    sampling : Sampling
        Sampling of all sensors.
    wired : (n_wired,) array of int
        Sensors that the law reads.
    """
    coil, own = sampling.hardware.velocity_sensor, sampling.only(wired)
    travel = np.full(len(plant.sensors), -1)
    addresses = np.arange(plant.model.nsensordata)[plant.travel]
    if addresses.size:
        travel[sampling.is_velocity] = addresses
    return Samples(
        rows=Rows.of(plant.sensor_matrix[wired]),
        travel=travel[wired],
        share=np.where(own.is_velocity, coil.signal_share, 1.0),
        half=coil.linear_range / 2,
        added=np.zeros((0, len(wired))) if own.added is None else own.added,
        steps=np.zeros(len(wired)) if own.steps is None else own.steps,
    )


def law_of(matrices: Matrices, to: Array) -> Law:
    """Return a law at rest.

    Parameters
    ----------
    matrices : tuple of array
        A, B, C, D of the law.
    to : (n_outputs,) array of int
        Actuators of the commands.
    """
    A, B, C, D = matrices
    matrix = np.ascontiguousarray(np.block([[C, D], [A, B]]))
    return Law(matrix=matrix, given=np.zeros(matrix.shape[1]), result=np.zeros(matrix.shape[0]), to=to)


def output_of(plant: Plant, chain: Array, added: Array, *, limit: float, brakes: Array) -> Output:
    """Return the way from commands to controls, at rest.

    Parameters
    ----------
    plant : Plant
        Plant with its actuators and matrices.
    chain : array
        Matrix of the output chain.
    added : (n_steps, n_actuators) array
        Force added behind the filter [N].
    limit : float
        Limit of the amplifiers [N]; 0 for none.
    brakes : (n_actuators, n_sensordata) array
        Matrix from ``sensordata`` to the forces by which the coils brake themselves.
    """
    none, n = np.zeros((0, 0)), added.shape[1]
    return Output(
        chain=np.array(chain),
        memory=np.zeros((n, chain.shape[1])),
        means=np.zeros((n, chain.shape[0])),
        added=np.ascontiguousarray(added),
        limit=float(limit),
        brakes=Rows.of(brakes),
        controls=Rows.of(plant.control_matrix),
        dissipation=none if plant.dissipation is None else np.array(plant.dissipation, order="C"),
        restoring=none if plant.restoring is None else np.array(plant.restoring, order="C"),
        rest=plant.model.qpos0.copy(),
    )


@compiled(error_model="numpy", fastmath=SUMS)
def _product(matrix: Array, vector: Array, out: Array) -> None:  # pragma: no cover - compiled
    for i in range(out.size):
        total = 0.0
        for j in range(vector.size):
            total += matrix[i, j] * vector[j]
        out[i] = total


@compiled(error_model="numpy")
def _row(rows: Rows, i: int, vector: Array) -> float:  # pragma: no cover - compiled
    total = 0.0
    for k in range(rows.starts[i], rows.starts[i + 1]):
        total += rows.values[k] * vector[rows.columns[k]]
    return total


@compiled(error_model="numpy")
def _sample(s: Samples, sample: int, sensordata: Array, y: Array) -> None:  # pragma: no cover - compiled
    """Write the converter's samples, see `vlab.hardware.sensing`."""
    for i in range(s.travel.size):
        value = _row(s.rows, i, sensordata)
        gain = s.share[i]
        if s.travel[i] >= 0:
            excess = abs(sensordata[s.travel[i]]) - s.half
            if not excess <= 0.0:
                gain *= 1.0 / (1.0 + (excess / s.half) ** 2)
        value *= gain
        if s.added.shape[0] > 0:
            value += s.added[sample, i]
        if s.steps[i] > 0.0:
            value = s.steps[i] * np.rint(value / s.steps[i])
        y[i] = value


@compiled(error_model="numpy")
def _command(
    s: Samples, law: Law, out: Output, sample: int, sensordata: Array, commands: Array
) -> None:  # pragma: no cover - compiled
    """Sample, and run the law and the output chain."""
    outputs = law.to.size
    states = law.result.size - outputs
    _sample(s, sample, sensordata, law.given[states:])
    _product(law.matrix, law.given, law.result)
    for i in range(states):
        law.given[i] = law.result[outputs + i]
    for i in range(outputs):
        commands[sample, law.to[i]] = law.result[i]
    last = out.chain.shape[1] - 1
    steps = out.chain.shape[0] - last
    for a in range(commands.shape[1]):
        out.memory[a, last] = commands[sample, a]
        _product(out.chain, out.memory[a], out.means[a])
        for i in range(last):
            out.memory[a, i] = out.means[a, steps + i]


@compiled(error_model="numpy")
def _force(out: Output, step: int, part: int, state: State, records: Records) -> None:  # pragma: no cover - compiled
    """Write the controls and the prescribed forces of a step."""
    forces = records.forces[step]
    for a in range(forces.size):
        force = out.means[a, part] + out.added[step, a]
        if out.limit > 0.0:
            if abs(force) > out.limit:
                records.over[a] += 1.0
            force = min(max(force, -out.limit), out.limit)
        forces[a] = force - _row(out.brakes, a, state.sensordata)
    for i in range(state.ctrl.size):
        state.ctrl[i] = _row(out.controls, i, forces)
    if out.dissipation.size > 0:
        _product(out.dissipation, state.qvel, state.applied)
        for i in range(state.applied.size):
            state.applied[i] = -state.applied[i]
    elif out.restoring.size > 0:
        for i in range(state.applied.size):
            state.applied[i] = 0.0
    if out.restoring.size > 0:
        for i in range(state.applied.size):
            total = 0.0
            for j in range(state.qpos.size):
                total += out.restoring[i, j] * (state.qpos[j] - out.rest[j])
            state.applied[i] -= total


@compiled(error_model="numpy", nogil=True)
def _advance(
    model: int,
    data: int,
    which: tuple[int, int, int, int],
    state: State,
    samples: Samples,
    law: Law,
    out: Output,
    records: Records,
) -> None:  # pragma: no cover - compiled
    first, count, substeps, frame_every = which
    for step in range(first, first + count):
        first_half(model, data)
        sample = step // substeps
        part = step - sample * substeps
        if part == 0:
            for i in range(state.sensordata.size):
                records.raw[sample, i] = state.sensordata[i]
            if sample % frame_every == 0:
                for i in range(state.qpos.size):
                    records.frames[sample // frame_every, i] = state.qpos[i]
            if law.to.size > 0:
                _command(samples, law, out, sample, state.sensordata, records.commands)
        _force(out, step, part, state, records)
        second_half(model, data)
