"""Port forces in compiled code, step by step with MuJoCo.

The arithmetic is that of `vlab.physics.running.PortForces`; a test compares both. The compiled form takes laws with an
expression graph, at ports with a constant Jacobian row.
"""

from typing import Any, NamedTuple

import mujoco
import numpy as np

from vlab.compilation import compiled
from vlab.physics.compiled_expression import (
    AT_COMMAND,
    AT_FIRST,
    AT_FREE,
    AT_MOBILITY,
    AT_T,
    AT_V,
    AT_Z,
    evaluate,
    loaded,
)
from vlab.physics.expression import trace_expression
from vlab.physics.port_lines import PortLines, command_of
from vlab.plants.base import ONE_WAY, Plant
from vlab.plants.compiled_steps import c_function
from vlab.plants.contacts import contact_count
from vlab.signals import Array

PROBE = 0.01
"""PROBE [m or rad]: displacement of all joints by which constant Jacobian rows are checked."""

_fwd_actuation, _fwd_acceleration = c_function("mj_fwdActuation"), c_function("mj_fwdAcceleration")
_solve_mass = c_function("mj_solveM")


class Views(NamedTuple):
    """Arrays of an `MjData`."""

    qpos: Array
    qvel: Array
    qacc: Array
    act: Array
    ctrl: Array
    applied: Array
    smooth: Array
    sensordata: Array
    contacts: Array

    @classmethod
    def of(cls, data: Any) -> "Views":
        """Return the views of an `MjData`.

        Parameters
        ----------
        data : MjData
            State.

        Returns
        -------
        Views
            Arrays that share the memory of `data`.
        """
        return cls(
            data.qpos,
            data.qvel,
            data.qacc,
            data.act,
            data.ctrl,
            data.qfrc_applied,
            data.qfrc_smooth,
            data.sensordata,
            contact_count(data),
        )


class CompiledPorts(NamedTuple):
    """Arrays of port forces for compiled code.

    Parameters
    ----------
    rows, solved, corrected : (n, nv) array
        Jacobian rows, motion per force, and a work array.
    at_rest : (nq,) array
        Configuration at rest.
    damping : (nv,) array
        See `PortLines`; empty for none.
    linear : (3, n) array
        Added mass, damping and stiffness.
    is_fixed, is_staggered : bool
        See `PortLines`.
    h : float
        Integration step [s].
    laws : (n_laws, 4) array of int
        Line, actuator, filter state and register of the force of every law; -1 for none.
    graphs : tuple of array
        See `vlab.physics.compiled_expression.loaded`.
    registers : (n_registers, 1) array
        Registers of all laws, with their memory.
    last : (n,) array
        Forces of the laws in the last step.
    efforts : (nsensordata, nv) array
        Readings per generalised force of the drives.
    in_drive : (n,) array
        1 for a line that sensors of actuator forces read, 0 otherwise.
    line : (6, n) array
        Work arrays: velocity, acceleration, displacement, force, expected force, force of the laws.
    compliance, working : (n, n) array
        Compliance of the lines, and a work array with the one under added mass.
    """

    rows: Array
    solved: Array
    corrected: Array
    at_rest: Array
    damping: Array
    linear: Array
    is_fixed: bool
    is_staggered: bool
    h: float
    laws: Array
    graphs: tuple[Array, Array, Array, Array, Array]
    registers: Array
    last: Array
    efforts: Array
    in_drive: Array
    line: Array
    compliance: Array
    working: Array


def compile_ports(plant: Plant, lines: PortLines) -> CompiledPorts | None:
    """Return port forces for compiled code.

    Parameters
    ----------
    plant : Plant
        Plant of the run.
    lines : PortLines
        Lines of its effects.

    Returns
    -------
    CompiledPorts or None
        None if a law has no expression graph, or a row depends on the configuration.
    """
    if not np.all(np.isin(plant.model.jnt_type, ONE_WAY)) or not all(port.is_constant for port in lines.ports):
        return None
    data = plant.new_data()
    found = []
    for i, a in lines.laws:
        effect: Any = a.effect
        graph = trace_expression(effect, plant.timestep, damped=lines.damped)
        if graph is None:
            return None
        values, memory = [float(a.values[p.name]) for p in effect.parameters], effect.memory(()) or []
        found.append((graph, values, memory, (i, *command_of(plant, a), graph.force)))
    graphs, registers = loaded([f[0] for f in found], [f[1] for f in found], [f[2] for f in found], (1,))
    n, nv = lines.rows.shape
    ports = CompiledPorts(
        rows=lines.rows.copy(),
        solved=np.zeros((n, nv)),
        corrected=np.zeros((n, nv)),
        at_rest=data.qpos.copy(),
        damping=np.zeros(0) if lines.damping is None else np.asarray(lines.damping, dtype=float),
        linear=np.array([lines.added, lines.viscous, lines.spring]),
        is_fixed=lines.is_fixed,
        is_staggered=lines.is_staggered,
        h=plant.timestep,
        laws=np.array([f[3] for f in found], dtype=np.int64).reshape(-1, 4),
        graphs=graphs,
        registers=registers,
        last=np.zeros(n),
        efforts=np.ascontiguousarray(lines.efforts),
        in_drive=lines.in_drive.astype(float),
        line=np.zeros((6, n)),
        compliance=np.zeros((n, n)),
        working=np.zeros((n, n)),
    )
    solve_compliance(plant.model._address, data._address, ports)
    return ports if _are_affine(plant, lines, data) else None


def no_ports(model: Any) -> CompiledPorts:
    """Return port forces without a line.

    Parameters
    ----------
    model : MjModel
        Compiled model.

    Returns
    -------
    CompiledPorts
        Arrays of no line.
    """
    empty, none = np.zeros((0, int(model.nv))), np.zeros(0, dtype=np.int64)
    graphs = (np.zeros((0, 4), dtype=np.int64), np.zeros((1, 3), dtype=np.int64), none, none, none)
    return CompiledPorts(
        rows=empty,
        solved=empty.copy(),
        corrected=empty.copy(),
        at_rest=np.zeros(int(model.nq)),
        damping=np.zeros(0),
        linear=np.zeros((3, 0)),
        is_fixed=True,
        is_staggered=True,
        h=float(model.opt.timestep),
        laws=np.zeros((0, 4), dtype=np.int64),
        graphs=graphs,
        registers=np.zeros((0, 1)),
        last=np.zeros(0),
        efforts=np.zeros((int(model.nsensordata), int(model.nv))),
        in_drive=np.zeros(0),
        line=np.zeros((6, 0)),
        compliance=np.zeros((0, 0)),
        working=np.zeros((0, 0)),
    )


def _are_affine(plant: Plant, lines: PortLines, data: Any) -> bool:
    """Return whether all positions are linear in the coordinates."""
    moved = PROBE * np.cos(np.arange(plant.model.nq))
    data.qpos[:] += moved
    mujoco.mj_fwdPosition(plant.model, data)
    found = np.array([port.position(data) for port in lines.ports]) - lines.rest
    return bool(np.allclose(found, lines.rows @ moved, rtol=1e-9, atol=1e-12))


@compiled(error_model="numpy")
def solve_compliance(model: int, data: int, c: CompiledPorts) -> None:  # pragma: no cover - compiled
    """Solve for the motion per force of every row, in place.

    Parameters
    ----------
    model, data : int
        Addresses of MuJoCo's model and data.
    c : CompiledPorts
        Port forces; `solved` and `compliance` are overwritten.
    """
    n, nv = c.rows.shape
    _solve_mass(model, data, c.solved.ctypes.data, c.rows.ctypes.data, n)
    if c.damping.size > 0:
        damped = np.empty((n, nv))
        for i in range(n):
            for j in range(nv):
                damped[i, j] = c.solved[i, j] * c.damping[j]
        _solve_mass(model, data, c.corrected.ctypes.data, damped.ctypes.data, n)
        for i in range(n):
            for j in range(nv):
                c.solved[i, j] -= c.corrected[i, j]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(nv):
                total += c.rows[i, k] * c.solved[j, k]
            c.compliance[i, j] = total


@compiled(error_model="numpy")
def add_port_forces(
    model: int, data: int, view: Views, c: CompiledPorts, commands: Array, time: float, keep: bool
) -> None:  # pragma: no cover - compiled
    """Add the port forces of a step to the applied forces.

    Parameters
    ----------
    model, data : int
        Addresses of MuJoCo's model and data, with kinematics and controls up to date.
    view : Views
        Arrays of the data.
    c : CompiledPorts
        Port forces.
    commands : (n_actuators,) array
        Forces of the actuators.
    time : float
        Time at the beginning of the step [s].
    keep : bool
        Whether the laws' memory goes on.
    """
    _fwd_actuation(model, data)
    _fwd_acceleration(model, data)
    if not c.is_fixed:
        solve_compliance(model, data, c)
    n, nv = c.rows.shape
    h, G = c.h, c.working
    v, a, z, push, expected, of_laws = c.line[0], c.line[1], c.line[2], c.line[3], c.line[4], c.line[5]
    for i in range(n):
        v[i] = a[i] = z[i] = of_laws[i] = 0.0
        expected[i] = c.last[i]
        for j in range(n):
            G[i, j] = c.compliance[i, j]
        for j in range(nv):
            v[i] += c.rows[i, j] * view.qvel[j]
            a[i] += c.solved[i, j] * view.smooth[j]
            z[i] += c.rows[i, j] * (view.qpos[j] - c.at_rest[j])
    if not c.is_staggered:
        for i in range(n):
            own = 0.0
            for j in range(n):
                own += G[i, j] * expected[j]
            z[i] += h / 2 * (v[i] + h / 4 * (a[i] + own))
    _add_linear(c, v, a, z, push)
    operations, bounds, firsts, stored, recalled = c.graphs
    for law in range(c.laws.shape[0]):
        i, coil, state, result = c.laws[law]
        own = 0.0
        for j in range(n):
            own += G[i, j] * expected[j]
        after = v[i] + h * a[i]
        at = c.registers[bounds[law, 0] : bounds[law + 1, 0]]
        at[AT_Z, 0], at[AT_V, 0], at[AT_T, 0] = z[i], 0.5 * (v[i] + after + h * own), time + h / 2
        at[AT_FREE, 0], at[AT_FIRST, 0], at[AT_MOBILITY, 0] = after, v[i], h * G[i, i]
        at[AT_COMMAND, 0] = view.act[state] if state >= 0 else commands[coil] if coil >= 0 else 0.0
        evaluate(operations[bounds[law, 1] : bounds[law + 1, 1]], firsts[law], at)
        if keep:
            for k in range(bounds[law, 2], bounds[law + 1, 2]):
                at[recalled[k], 0] = at[stored[k], 0]
        force = at[result, 0]
        push[i] = of_laws[i] = force
        expected[i] = 0.0
        for j in range(n):
            a[j] += G[j, i] * force
    for i in range(n):
        push[i] -= c.linear[0, i] * a[i]
        if keep:
            c.last[i] = of_laws[i]
        for j in range(nv):
            view.applied[j] += push[i] * c.rows[i, j]


@compiled(error_model="numpy")
def _add_linear(c: CompiledPorts, v: Array, a: Array, z: Array, push: Array) -> None:  # pragma: no cover - compiled
    """Add the forces of the linear effects, and solve for their inertia."""
    n, has_inertia = v.size, False
    for i in range(n):
        push[i] = -c.linear[1, i] * v[i] - c.linear[2, i] * z[i]
        has_inertia |= c.linear[0, i] != 0.0
    if c.laws.shape[0] == n:
        return
    moved = np.empty(n)
    for i in range(n):
        moved[i] = a[i]
        for j in range(n):
            moved[i] += c.working[i, j] * push[j]
    if has_inertia:
        shared = np.eye(n)
        for i in range(n):
            for j in range(n):
                shared[i, j] += c.working[i, j] * c.linear[0, j]
        if np.all(np.isfinite(shared)):
            inverse = np.linalg.inv(shared)
            moved = inverse @ moved
            working = inverse @ c.working
            for i in range(n):
                for j in range(n):
                    c.working[i, j] = working[i, j]
        else:  # MuJoCo reports the diverged state
            for i in range(n):
                moved[i] = np.nan
    for i in range(n):
        a[i] = moved[i]


@compiled(error_model="numpy")
def add_effort_readings(view: Views, c: CompiledPorts) -> None:  # pragma: no cover - compiled
    """Add what sensors of actuator forces read of laws within a drive.

    Parameters
    ----------
    view : Views
        Arrays of the data after `add_port_forces`.
    c : CompiledPorts
        Port forces.
    """
    n, nv = c.rows.shape
    for i in range(n):
        force = c.line[5, i] * c.in_drive[i]
        if force != 0.0:
            for s in range(c.efforts.shape[0]):
                for j in range(nv):
                    view.sensordata[s] += c.efforts[s, j] * force * c.rows[i, j]
