"""Running part of a law module: port forces, commands and readings in plain MuJoCo.

The text below the marker goes into every ``law.py``. It needs mujoco and numpy, and nothing of vlab. The march is that
of `vlab.physics.running`. All port forces of a step come from one solution. Mass and damping at ports are implicit, and
every law uses the port motion under them.
"""

# ---- head of a law module: filled in when the module is written ----
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import mujoco
import numpy as np

REST: list[float] = []
SAMPLE = 0.001
NUMBERS: list[tuple[str, tuple[int, ...], float]] = []
LINES: list[dict[str, Any]] = []
COMMANDS: list[dict[str, Any]] = []
READINGS: list[dict[str, Any]] = []
# ---- running ----

STAGGERED = (
    mujoco.mjtIntegrator.mjINT_EULER,
    mujoco.mjtIntegrator.mjINT_IMPLICIT,
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
)
"""Integrators with the position half a step ahead of the velocity."""
DAMPED = {mujoco.mjtIntegrator.mjINT_EULER: 0.0, mujoco.mjtIntegrator.mjINT_RK4: 0.5}
"""Share of a step's change of velocity on which the damping of actuators acts, by integrator; 1 for all others."""


class Step(NamedTuple):
    """Data of one integration step.

    Length and middle time [s], mobility [m/s/N], command, velocities at the end and the beginning [m/s]. The last number
    is the share of the change of velocity on which the damping of actuators acts.
    """

    h: Any
    t: Any = 0.0
    mobility: Any = 0.0
    free_velocity: Any = None
    command: Any = 0.0
    first_velocity: Any = None
    damped: Any = None


class Coordinate:
    """A scalar coordinate of the model.

    Kinds: a joint, a tendon, a body's centre or a site along an axis, and the floor.
    """

    def __init__(self, model: Any, line: dict[str, Any]) -> None:
        self.kind, self.axis, self.gear = line["kind"], line.get("axis", 0), line.get("gear", 1.0)
        self.index = -1 if self.kind == "floor" else int(getattr(model, self.kind)(line["name"]).id)
        self.fixed = np.array(line["row"]) if self.kind == "floor" else np.zeros(model.nv)
        if self.kind == "joint":
            self.fixed[model.jnt_dofadr[self.index]] = self.gear

    def row(self, model: Any, data: Any) -> Any:
        """Return the Jacobian row of the coordinate.

        Parameters
        ----------
        model, data : mujoco.MjModel, mujoco.MjData
            Running model.

        Returns
        -------
        (nv,) array
            Row at the present configuration.
        """
        if self.kind in ("joint", "floor"):
            return self.fixed
        if self.kind == "tendon":
            out, first = np.zeros(model.nv), int(model.ten_J_rowadr[self.index])
            count = int(model.ten_J_rownnz[self.index])
            out[model.ten_J_colind[first : first + count]] = self.gear * data.ten_J[first : first + count]
            return out
        jacobian = np.zeros((3, model.nv))
        find = mujoco.mj_jacBodyCom if self.kind == "body" else mujoco.mj_jacSite
        find(model, data, jacobian, None, self.index)
        return jacobian[self.axis]

    def position(self, model: Any, data: Any) -> float:
        """Return the value of the coordinate.

        Parameters
        ----------
        model, data : mujoco.MjModel, mujoco.MjData
            Running model.

        Returns
        -------
        float
            Value [m or rad].
        """
        if self.kind == "floor":
            return 0.0
        if self.kind == "joint":
            return self.gear * float(data.qpos[model.jnt_qposadr[self.index]])
        if self.kind == "tendon":
            return self.gear * float(data.ten_length[self.index])
        return float((data.xipos if self.kind == "body" else data.site_xpos)[self.index, self.axis])


class Run:
    """Memory of one `MjData`: law states, command filters and reading filters."""

    def __init__(self, model: Any, sample: float) -> None:
        self.h, self.sample = float(model.opt.timestep), sample
        rest = mujoco.MjData(model)
        if len(REST) == model.nq:
            rest.qpos[:] = REST
        mujoco.mj_fwdPosition(model, rest)
        self.places = [Coordinate(model, a) for a in LINES]
        self.rest = [place.position(model, rest) for place in self.places]
        impedance = np.array([a.get("impedance", (0.0, 0.0, 0.0)) for a in LINES]).reshape(-1, 3)
        self.viscous, self.spring = impedance[:, 1], impedance[:, 2]
        self.added = impedance[:, 0] + self.viscous * self.h / 2
        is_explicit = model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER and (
            model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP
        )
        damps = model.opt.integrator in STAGGERED and not is_explicit
        self.damping = self.h * model.dof_damping if damps and np.any(model.dof_damping) else None
        self.reset()

    def reset(self) -> None:
        """Return to the memory at rest."""
        self.time, self.middle, self.is_over = -np.inf, 0, False
        self.memory = [None if a.get("law") is None else a["law"].memory(()) for a in LINES]
        self.last = np.zeros(len(LINES))
        self.next: tuple[Any, Any] = (self.memory, self.last)
        self.force: Any = 0.0
        self.command_time, self.commanded = -np.inf, np.zeros(0)
        self.reading_time, self.readings = -np.inf, dict[str, float]()
        self.command_steps = [_held(a, self.h, self.sample) for a in COMMANDS]
        self.reading_steps = [a["law"].stepper(a["values"], self.sample) for a in READINGS]

    def begins(self, model: Any, time: float) -> bool:
        """Return whether a call belongs to the beginning of a step.

        Parameters
        ----------
        model : mujoco.MjModel
            Running model.
        time : float
            Time of the call [s].

        Returns
        -------
        bool
            False for the later stages of a Runge-Kutta step.
        """
        h = self.h
        if time < self.time - 1e-6 * h:
            self.reset()
        if abs(time - self.time) <= 1e-6 * h:
            return True
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 and self.time > -np.inf:
            if time < self.time + 0.75 * h:
                self.middle += 1
                return False
            if self.middle == 2 and not self.is_over and time < self.time + 1.25 * h:
                self.is_over = True
                return False
        self.memory, self.last = self.next
        self.time, self.middle, self.is_over = time, 0, False
        return True


def _held(line: dict[str, Any], h: float, sample: float) -> Any:
    """Return a command filter per integration step.

    A clocked filter changes its output once a sample only.
    """
    if not line.get("is_clocked"):
        return line["law"].stepper(line["values"], h)
    once, every = line["law"].stepper(line["values"], sample), max(1, round(sample / h))
    count, held = 0, 0.0

    def step(u: float) -> float:
        nonlocal count, held
        if count % every == 0:
            held = once(u)
        count += 1
        return held

    return step


_runs: "WeakKeyDictionary[Any, Run]" = WeakKeyDictionary()
_sample = [SAMPLE]


def _run(model: Any, data: Any) -> Run:
    run = _runs.get(data)
    if run is None or run.h != float(model.opt.timestep):
        run = _runs[data] = Run(model, _sample[0])
    return run


def install(model: Any, *, sample: float = SAMPLE) -> None:
    """Set the model's remaining numbers and install `passive` as MuJoCo's passive force callback.

    Parameters
    ----------
    model : mujoco.MjModel
        Compiled ``model.xml``.
    sample : float
        Time between two readings, and between two samples of a clocked command [s].
    """
    _sample[0] = sample
    _runs.clear()
    for field, index, value in NUMBERS:
        getattr(model, field)[index] = value
    if NUMBERS:
        mujoco.mj_setConst(model, mujoco.MjData(model))
    off = mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER
    if LINES and int(model.opt.disableflags) & int(off) == int(off):
        raise ValueError("the model disables springs and dampers, so MuJoCo calls no passive force; enable one of them")
    if LINES:
        mujoco.set_mjcb_passive(passive)


def uninstall() -> None:
    """Take the callback away and forget all states."""
    mujoco.set_mjcb_passive(None)
    _runs.clear()


def passive(model: Any, data: Any) -> None:
    """Add the port forces of a step to ``data.qfrc_passive``.

    The force of a step is held over the stages of a Runge-Kutta step. A call at the same time repeats the same step, so
    `mj_forward` between two steps changes nothing. A time that goes back starts from rest.
    """
    if not LINES:
        return
    run = _run(model, data)
    if run.begins(model, float(data.time)):
        run.next, run.force = _forces(model, data, run)
    data.qfrc_passive += run.force


def _forces(model: Any, data: Any, run: Run) -> tuple[tuple[Any, Any], Any]:
    """Return memory and forces after the step, and the generalised force."""
    h, n = run.h, len(LINES)
    rows = np.array([place.row(model, data) for place in run.places])
    mujoco.mj_rne(model, data, 0, data.qfrc_bias)
    mujoco.mj_fwdActuation(model, data)
    mujoco.mj_fwdAcceleration(model, data)  # without port forces and constraint forces
    solved = np.zeros_like(rows)
    mujoco.mj_solveM(model, data, solved, rows)
    if run.damping is not None:  # implicit joint dampers, to first order
        correction = np.zeros_like(solved)
        mujoco.mj_solveM(model, data, correction, solved * run.damping)
        solved -= correction
    v, a, G = rows @ data.qvel, solved @ data.qfrc_smooth, rows @ solved.T
    z = np.array([place.position(model, data) - rest for place, rest in zip(run.places, run.rest, strict=True)])
    if model.opt.integrator not in STAGGERED:
        z += h / 2 * (v + h / 4 * (a + G @ run.last))
    push = -run.viscous * v - run.spring * z
    a = a + G @ push
    if np.any(run.added):
        shared = np.linalg.inv(np.eye(n) + G * run.added)
        a, G = shared @ a, shared @ G
    memory, expected, of_laws = list(run.memory), run.last.copy(), np.zeros(n)
    for i, line in enumerate(LINES):
        if line.get("law") is None:
            continue
        before = float(v[i])
        after = before + h * float(a[i])
        command = float(data.ctrl[line["control"]]) if "control" in line else 0.0
        command = float(data.act[line["state"]]) if "state" in line else command  # a servo's filtered command
        damped = DAMPED.get(model.opt.integrator, 1.0)
        step = Step(h, data.time + h / 2, h * float(G[i, i]), after, command, before, damped)
        own = h * float(G[i] @ expected)
        force, memory[i] = line["law"].force(
            float(z[i]), 0.5 * (before + after + own), line["values"], step, run.memory[i]
        )
        push[i], expected[i], of_laws[i] = force, 0.0, force
        a = a + G[:, i] * force
    return (memory, of_laws), (push - run.added * a) @ rows


def command(model: Any, data: Any, u: Any) -> Any:
    """Return controls for commands, with all effects between command and actuator.

    Call once before every integration step: ``data.ctrl[:] = law.command(model, data, u)``. A second call at the same
    time returns the first result.

    Parameters
    ----------
    model, data : mujoco.MjModel, mujoco.MjData
        Running model.
    u : (nu,) array
        Commands.

    Returns
    -------
    (nu,) array
        Controls.
    """
    run = _run(model, data)
    if data.time < run.command_time - 1e-6 * run.h:
        run.reset()
    if data.time > run.command_time + 1e-6 * run.h:
        out = np.array(u, dtype=float)
        for line, step in zip(COMMANDS, run.command_steps, strict=True):
            out[line["control"]] = step(float(out[line["control"]]))
        run.command_time, run.commanded = float(data.time), out
    return run.commanded.copy()


def read(model: Any, data: Any, values: dict[str, float] | None = None) -> dict[str, float]:
    """Return readings of the sensors, with all effects between motion and reading.

    Call once a sample, `install` gives the sample period. A second call at the same time returns the first result.

    Parameters
    ----------
    model, data : mujoco.MjModel, mujoco.MjData
        Running model with up-to-date sensors.
    values : dict of str to float, optional
        True values by name; by default those of the model's sensors.

    Returns
    -------
    dict of str to float
        Readings by sensor name; a sensor of three values has the names ``NAME.x``, ``NAME.y`` and ``NAME.z``.
    """
    run = _run(model, data)
    if data.time < run.reading_time - 1e-6 * run.h:
        run.reset()
    if data.time > run.reading_time + 1e-6 * run.h:
        out = _sensor_values(model, data) if values is None else dict(values)
        for line, step in zip(READINGS, run.reading_steps, strict=True):
            if line["name"] in out:
                other = float(data.ctrl[line["control"]]) if "control" in line else 0.0
                other = out[line["sensor"]] if "sensor" in line else other
                out[line["name"]] = float(step(float(out[line["name"]]), float(data.time), other))
        run.reading_time, run.readings = float(data.time), out
    return dict(run.readings)


def _sensor_values(model: Any, data: Any) -> dict[str, float]:
    out = {}
    for i in range(model.nsensor):
        name, size, first = model.sensor(i).name, int(model.sensor_dim[i]), int(model.sensor_adr[i])
        if name and size == 1:
            out[name] = float(data.sensordata[first])
        elif name and size == 3:
            out |= {f"{name}.{axis}": float(data.sensordata[first + k]) for k, axis in enumerate("xyz")}
    return out
