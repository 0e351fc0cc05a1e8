"""Compiled replay of a recording without a law in the loop.

Inputs of all steps are known before the run. Steps, port forces and readings follow in compiled code, see
`vlab.cases.replay` for the order of a step.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from vlab.cases.channel_map import Run
from vlab.cases.constant_sensors import ConstantSensors
from vlab.cases.open_loop import CHECK_EVERY
from vlab.cases.replay_bench import Bench, NotSafe, State
from vlab.compilation import compiled
from vlab.lab.callback import refuse_foreign_callback
from vlab.lab.compiled_loop import own_array
from vlab.physics.compiled_ports import (
    CompiledPorts,
    Views,
    add_effort_readings,
    add_port_forces,
    compile_ports,
    no_ports,
)
from vlab.physics.running import Running
from vlab.plants.base import Plant, Port, check_run
from vlab.plants.compiled_steps import IS_AVAILABLE, c_function, first_half, second_half
from vlab.plants.contacts import first_contacts_fit
from vlab.signals import Array

LEAST_MEMORY = 2**20
"""LEAST_MEMORY [bytes]: least memory of a model for runs in compiled code. MuJoCo ends the process where memory runs out
in compiled code."""
INTEGRATION = int(mujoco.mjtState.mjSTATE_INTEGRATION)
VELOCITY, NO_STAGE = int(mujoco.mjtStage.mjSTAGE_VEL), int(mujoco.mjtStage.mjSTAGE_NONE)
RUNGE_KUTTA = int(mujoco.mjtIntegrator.mjINT_RK4)

_forward, _forward_skip = c_function("mj_forward"), c_function("mj_forwardSkip")
_fwd_position, _fwd_velocity = c_function("mj_fwdPosition"), c_function("mj_fwdVelocity")
_sensor_position, _sensor_velocity = c_function("mj_sensorPos"), c_function("mj_sensorVel")
_copy_state, _integrate_position = c_function("mj_copyState"), c_function("mj_integratePos")
_fwd_actuation, _fwd_acceleration = c_function("mj_fwdActuation"), c_function("mj_fwdAcceleration")
_fwd_constraint = c_function("mj_fwdConstraint")


class Inputs(NamedTuple):
    """Known inputs of a run.

    Parameters
    ----------
    forces : (n_steps, n_actuators) array
        Forces of the actuators [SI].
    seen : (n_readings, n_actuators) array
        Forces of the actuators as sensors see them.
    loads, seen_loads : (n_steps, n_loads) and (n_readings, n_loads) array
        Forces on ports.
    """

    forces: Array
    seen: Array
    loads: Array
    seen_loads: Array


class Matrices(NamedTuple):
    """Constant matrices of a plant.

    Parameters
    ----------
    controls : (nu, n_actuators) array
        Controls per force.
    load_rows : (n_loads, nv) array
        Jacobian rows of the loaded ports.
    dissipation, restoring : (nv, nv) array
        Transposes of the negative damping and stiffness matrix of the plant; empty for none.
    at_rest : (nq,) array
        Configuration without restoring force.
    """

    controls: Array
    load_rows: Array
    dissipation: Array
    restoring: Array
    at_rest: Array

    @classmethod
    def of(cls, plant: Plant, loaded: Sequence[Port]) -> "Matrices":
        """Return the matrices of a plant.

        Parameters
        ----------
        plant : Plant
            Plant.
        loaded : sequence of Port
            Ports with recorded forces.

        Returns
        -------
        Matrices
            Matrices.
        """
        data = plant.new_data()
        return cls(
            controls=np.ascontiguousarray(plant.control_matrix),
            load_rows=np.array([port.row(data) for port in loaded]).reshape(-1, plant.model.nv),
            dissipation=np.ascontiguousarray(-own_array(plant.dissipation).T),
            restoring=np.ascontiguousarray(-own_array(plant.restoring).T),
            at_rest=plant.model.qpos0.copy(),
        )


class Records(NamedTuple):
    """Readings of a run, without the half step of position.

    Parameters
    ----------
    raw : (n_readings, nsensordata) array
        Sensor values of MuJoCo.
    qpos, qvel, qacc : (n_readings, nq or nv) array
        Motion; no columns where no channel needs the motion.
    """

    raw: Array
    qpos: Array
    qvel: Array
    qacc: Array

    @classmethod
    def empty(cls, model: Any, n: int, *, moves: bool) -> "Records":
        """Return room for readings.

        Parameters
        ----------
        model : MjModel
            Compiled model.
        n : int
            Number of readings.
        moves : bool
            Whether a channel needs the motion.

        Returns
        -------
        Records
            Zeros.
        """
        sizes = (model.nsensordata, *(size * moves for size in (model.nq, model.nv, model.nv)))
        return cls(*(np.zeros((n, size)) for size in sizes))


def can_compile(plant: Plant, loaded: Sequence[Port]) -> bool:
    """Return whether compiled code can take the steps of a plant.

    Parameters
    ----------
    plant : Plant
        Plant.
    loaded : sequence of Port
        Ports with recorded forces.

    Returns
    -------
    bool
        Whether the steps need no Python.
    """
    model = plant.model
    is_stepped = model.opt.integrator != RUNGE_KUTTA or _has_only_smooth_forces(plant)
    has_rest = plant.restoring is None or model.nq == model.nv
    has_constant_loads = all(port.is_constant for port in loaded)
    return IS_AVAILABLE and is_stepped and has_rest and has_constant_loads and first_contacts_fit(model)


def _has_only_smooth_forces(plant: Plant) -> bool:
    """Return whether only smooth forces act, without states of their own.

    Actuators, delays and plugins have states, which MuJoCo advances in its own step only. Matrices of the plant stand beside
    MuJoCo.
    """
    model = plant.model
    is_rubbed = bool(np.any(model.dof_frictionloss) or np.any(model.tendon_frictionloss))
    is_limited = bool(np.any(model.jnt_limited) or np.any(model.tendon_limited))
    has_matrices = plant.dissipation is not None or plant.restoring is not None
    has_states = bool(model.na or model.nhistory or model.nplugin)
    return not (is_rubbed or is_limited or has_matrices or has_states or model.neq)


def replay_compiled(
    bench: Bench,
    run: Run,
    state: State,
    physics: Running | None,
    drives: tuple[Array, Array],
    loads: tuple[Sequence[Port], Array, Array],
    progress: Callable[[float], None],
) -> tuple[Array, Records] | None:
    """Simulate a run without a law in the loop.

    Parameters
    ----------
    bench : Bench
        Plant with its readings.
    run : Run
        Recording with mapped channels.
    state : State
        Initial state.
    physics : Running or None
        Attached physics; its actuator effects advance.
    drives : tuple of array
        Forces of the actuators over every step, and at the readings.
    loads : tuple
        Ports, their forces over every step, and at the readings.
    progress : callable
        Receives the completed share of the run.

    Returns
    -------
    tuple of (array, Records) or None
        Forces over every step under the actuator effects, and the readings. None if an effect cannot be compiled.

    Raises
    ------
    NotSafe
        The model has too little memory, or geoms touch: the memory of contacts has no bound that is known before the
        run.
    BadExperiment
        A foreign control callback is installed.
    Diverged
        The state left the finite range or MuJoCo reset the run.
    """
    refuse_foreign_callback()
    plant, model, ports = bench.plant, bench.model, no_ports(bench.model)
    if physics is not None and physics.ports is not None:
        compiled_ports = compile_ports(plant, physics.ports.lines)
        if compiled_ports is None:
            return None
        ports = compiled_ports
    forces, present = drives[0].copy(), drives[1].copy()
    steps = len(forces) // max(len(present) - 1, 1)
    if physics is not None and physics.has_actuators:
        is_first = np.zeros(len(plant.actuators), dtype=bool)
        is_first[[drive.actuator for drive in run.drives if drive.is_first and drive.actuator is not None]] = True
        for step, row in enumerate(forces):
            physics.actuate(row)
            if step % steps == 0:  # readings see the command of their own row
                present[step // steps] += np.where(is_first, physics.last_change, 0.0)
            if (step + 1) % steps == 0:
                present[(step + 1) // steps] += np.where(is_first, 0.0, physics.last_change)
        present[-1] += np.where(is_first, physics.last_change, 0.0)  # no step follows the last reading
    matrices, n = Matrices.of(plant, loads[0]), len(present)
    records = Records.empty(model, n, moves=any(c.sensor is None and c.port for c in run.compared))
    inputs = Inputs(forces, present, np.ascontiguousarray(loads[1]), np.ascontiguousarray(loads[2]))
    reads_forces = bench.reads_forces(run.compared)
    sums = ConstantSensors.of(model, set() if reads_forces else bench.addresses)
    bench.start(state)
    part = max(CHECK_EVERY // max(steps, 1), 1)
    for first in range(0, n, part):
        last = min(first + part, n)
        run_compiled(
            model,
            bench.pair,
            ports,
            inputs,
            matrices,
            records,
            sums,
            (first, last),
            ahead=bench.ahead,
            reads_forces=reads_forces,
        )
        check_run(model, bench.data, min(last, n - 1) * steps * model.opt.timestep)
        progress(last / n)
    return forces, records


def run_compiled(
    model: Any,
    pair: tuple[Any, Any],
    ports: CompiledPorts,
    inputs: Inputs,
    matrices: Matrices,
    records: Records,
    sums: ConstantSensors,
    span: tuple[int, int],
    *,
    ahead: float,
    reads_forces: bool,
) -> None:
    """Simulate the readings of a span, in place.

    Parameters
    ----------
    model : MjModel
        Compiled model.
    pair : tuple of MjData
        State of the run, and a copy for the readings.
    ports : CompiledPorts
        Port forces.
    inputs : Inputs
        Inputs of the whole run.
    matrices : Matrices
        Matrices of the plant.
    records : Records
        Readings of the whole run, overwritten in the span.
    sums : ConstantSensors
        Sensor values without kinematics; none where a reading needs kinematics.
    span : tuple of int
        First reading, and reading after the last one.
    ahead : float
        Time by which positions are ahead of velocities in the state [s].
    reads_forces : bool
        Whether readings depend on forces.

    Raises
    ------
    NotSafe
        Geoms touch, or more than half of the model's memory was used.
    """
    data, copy = pair
    if model.narena < LEAST_MEMORY or 2 * data.maxuse_arena > model.narena:
        raise NotSafe
    is_runge_kutta = bool(model.opt.integrator == RUNGE_KUTTA)
    has_touched = _run(
        (model._address, data._address, copy._address),
        (Views.of(data), Views.of(copy)),
        ports,
        inputs,
        matrices,
        records,
        sums,
        span,
        (float(data.time), float(model.opt.timestep), ahead),
        reads_forces,
        is_runge_kutta,
    )
    if is_runge_kutta:
        steps = len(inputs.forces) // max(len(records.raw) - 1, 1)
        data.time += (min(span[1], len(records.raw) - 1) - span[0]) * steps * model.opt.timestep
    if has_touched or 2 * data.maxuse_arena > model.narena:
        raise NotSafe


@compiled(error_model="numpy")
def _apply(view: Views, m: Matrices, force: Array, loads: Array, moved: Array) -> None:  # pragma: no cover - compiled
    """Set controls and applied forces of a state."""
    for i in range(view.ctrl.size):
        view.ctrl[i] = 0.0
        for j in range(force.size):
            view.ctrl[i] += m.controls[i, j] * force[j]
    for i in range(view.applied.size):
        view.applied[i] = 0.0
    for j in range(m.dissipation.shape[0]):  # the inner loops run over independent sums, which a processor vectorises
        speed = view.qvel[j]
        for i in range(view.applied.size):
            view.applied[i] += m.dissipation[j, i] * speed
    if m.restoring.shape[0] > 0:
        for i in range(moved.size):
            moved[i] = view.qpos[i] - m.at_rest[i]
        for j in range(moved.size):
            for i in range(view.applied.size):
                view.applied[i] += m.restoring[j, i] * moved[j]
    for load in range(loads.size):
        for i in range(view.applied.size):
            view.applied[i] += m.load_rows[load, i] * loads[load]


@compiled(error_model="numpy")
def _second_half_of_runge_kutta(model: int, data: int, view: Views, h: float) -> None:  # pragma: no cover - compiled
    """Finish a step of the classical Runge-Kutta method as MuJoCo does, without constraints.

    Controls and applied forces stand during the step.
    """
    _fwd_actuation(model, data)
    _fwd_acceleration(model, data)
    _fwd_constraint(model, data)
    position, speed = view.qpos.copy(), view.qvel.copy()
    rate, change = view.qvel / 6.0, view.qacc / 6.0
    for stage in range(1, 4):
        part, weight = (1.0, 1.0 / 6.0) if stage == 3 else (0.5, 1.0 / 3.0)
        last = part * view.qvel
        for i in range(speed.size):
            view.qvel[i] = speed[i] + h * (part * view.qacc[i])
        for i in range(position.size):
            view.qpos[i] = position[i]
        _integrate_position(model, view.qpos.ctypes.data, last.ctypes.data, h)
        _forward_skip(model, data, NO_STAGE, 1)
        for i in range(speed.size):
            rate[i] += weight * view.qvel[i]
            change[i] += weight * view.qacc[i]
    for i in range(speed.size):
        view.qvel[i] = speed[i] + h * change[i]
    for i in range(position.size):
        view.qpos[i] = position[i]
    _integrate_position(model, view.qpos.ctypes.data, rate.ctypes.data, h)


@compiled(error_model="numpy")
def _run(
    addresses: tuple[int, int, int],
    views: tuple[Views, Views],
    ports: CompiledPorts,
    inputs: Inputs,
    m: Matrices,
    records: Records,
    sums: ConstantSensors,
    span: tuple[int, int],
    times: tuple[float, float, float],
    reads_forces: bool,
    is_runge_kutta: bool,
) -> bool:  # pragma: no cover - compiled
    """Take the steps of a span; end and return true where geoms touch."""
    model, data, copy = addresses
    view, seen = views
    time, h, ahead = times
    n_readings, n_ports, moved = records.raw.shape[0], ports.rows.shape[0], np.empty(m.at_rest.size)
    steps = inputs.forces.shape[0] // max(n_readings - 1, 1)
    keep = n_readings > 0  # True and False themselves would compile the port forces twice
    for k in range(span[0], span[1]):
        _copy_state(model, data, copy, INTEGRATION)
        if ahead > 0.0:
            _integrate_position(model, seen.qpos.ctypes.data, seen.qvel.ctypes.data, -ahead)
        if reads_forces:
            _apply(seen, m, inputs.seen[k], inputs.seen_loads[k], moved)
            _forward(model, copy)
            if n_ports > 0:
                add_port_forces(model, copy, seen, ports, inputs.seen[k], time, not keep)
                _forward_skip(model, copy, VELOCITY, 0)
                add_effort_readings(seen, ports)
        elif sums.address.size == 0:
            _fwd_position(model, copy)
            _sensor_position(model, copy)
            _fwd_velocity(model, copy)
            _sensor_velocity(model, copy)
        if seen.contacts[0] > 0:
            return True
        if sums.address.size == 0:
            for i in range(records.raw.shape[1]):
                records.raw[k, i] = seen.sensordata[i]
        for i in range(sums.address.size):
            motion = seen.qpos if sums.order[i] == 0 else seen.qvel
            records.raw[k, sums.address[i]] += sums.share[i] * motion[sums.joint[i]]
        for i in range(records.qpos.shape[1]):
            records.qpos[k, i] = seen.qpos[i]
        for i in range(records.qvel.shape[1]):
            records.qvel[k, i] = seen.qvel[i]
            records.qacc[k, i] = seen.qacc[i]
        if k == n_readings - 1:
            break
        for step in range(k * steps, (k + 1) * steps):
            _apply(view, m, inputs.forces[step], inputs.loads[step], moved)
            first_half(model, data)
            if view.contacts[0] > 0:
                return True
            if n_ports > 0:
                add_port_forces(model, data, view, ports, inputs.forces[step], time, keep)
            if is_runge_kutta:
                _second_half_of_runge_kutta(model, data, view, h)
            else:
                second_half(model, data)
            time += h
    return False
