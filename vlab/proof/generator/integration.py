"""Integration by exact poles, with implicit midpoints for forces at places.

The motion is split by superposition. The response of the linear structure to commands is a sum over its complex
poles, each an exact first-order recursion (scipy's `lfilter`). The response to hidden forces is integrated step by
step. With constant forces over a step, the transition is a matrix exponential. The laws depend on the midpoint of the
step, found by fixed-point iteration.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy import linalg, signal

from vlab.errors import Diverged
from vlab.proof.generator.bench import Bench
from vlab.proof.generator.hardware import Output
from vlab.proof.generator.law import Law, Static
from vlab.signals import Array


@dataclass(frozen=True, eq=False)
class Poles:
    """Complex modes of a bench: poles, load participation, shapes.

    Parameters
    ----------
    poles : (m,) complex array
        Poles p_r: one of each conjugate pair, and real ones.
    enter : (m, 2n) complex array
        Rows of the inverse mode matrix, doubled for pairs.
    shapes : (2n, m) complex array
        Mode shapes of the state [q, q'].
    inverse : (n, n) array
        Inverse of M.
    """

    poles: Array
    enter: Array
    shapes: Array
    inverse: Array

    @classmethod
    def of(cls, bench: Bench) -> "Poles":
        """Solve the eigenproblem of a bench.

        Parameters
        ----------
        bench : Bench
            Bench.

        Returns
        -------
        Poles
            Complex modes.
        """
        A, inverse = bench.first_order()
        poles, shapes = linalg.eig(A)
        enter = np.linalg.inv(shapes)
        keep = poles.imag >= 0
        weight = np.where(poles[keep].imag > 0, 2.0, 1.0)
        return cls(poles[keep], enter[keep] * weight[:, None], shapes[:, keep], inverse)

    def response(self, loads: Array, forces: Array, rows: Array, step: float, skip: int = 1) -> Array:
        """Return the response of state rows to held forces, from rest.

        Parameters
        ----------
        loads : (n, k) array
            Loads per unit force.
        forces : (n_steps, k, runs) array
            Forces, constant over each step.
        rows : (m, 2n) array
            Rows of the state [q, q'].
        step : float
            Integration step [s].
        skip : int
            Steps between two returned values.

        Returns
        -------
        (n_steps // skip, m, runs) array
            Values at the beginning of the steps.
        """
        n = len(self.inverse)
        into = self.enter[:, n:] @ (self.inverse @ loads)
        out = rows @ self.shapes
        result = np.zeros((-(-len(forces) // skip), len(rows), forces.shape[2]))
        for r, pole in enumerate(self.poles):
            if not np.any(np.abs(out[:, r])):
                continue
            decay = np.exp(pole * step)
            gain = np.expm1(pole * step) / pole if pole != 0 else step
            drive = np.einsum("k,tkr->tr", into[r] * gain, forces)
            state = signal.lfilter([0.0, 1.0], [1.0, -decay], drive, axis=0)[::skip]
            result += np.real(out[:, r][None, :, None] * state[:, None, :])
        return result


def port_rows(row: Array, order: int) -> Array:
    """Return the state row of a displacement or velocity."""
    zero = np.zeros_like(row)
    return np.concatenate([row, zero] if order == 0 else [zero, row])


@dataclass(frozen=True, kw_only=True, eq=False)
class Feedback:
    """Sampled static rate feedback, updated at every `every`-th step.

    Parameters
    ----------
    actuators, sensors : tuple of int
        Actuators and sensors of the bench, in the order of the gains.
    gains : (n_actuators, n_sensors) array
        Force u = -gains y.
    noise : (n_samples, n_sensors, runs) array
        Sensor noise, visible to the law.
    output : Output
        Converter, delay and filter of the commands.
    """

    actuators: tuple[int, ...]
    sensors: tuple[int, ...]
    gains: Array
    noise: Array
    output: Output = field(default_factory=Output)


class _Way:
    """Path of sampled commands to step forces: delay, then filter.

    One step at a time, with the result of `Output.forces`.
    """

    def __init__(self, output: Output, step: float, substeps: int, shape: tuple[int, ...]) -> None:
        self._late, self._sub = output.delay_s / step, substeps
        omega = 2 * np.pi * output.corner_hz * step
        self._kept = float(np.exp(-omega)) if omega else 0.0
        self._share = float((1.0 - self._kept) / omega) if omega else 0.0
        self._past: list[Array] = []
        self._none = self._state = np.zeros(shape)

    def say(self, command: Array) -> None:
        """Take the command of the next sample."""
        self._past.append(command)

    def force(self, k: int) -> Array:
        """Return the mean force over a step.

        Parameters
        ----------
        k : int
            Number of the step.

        Returns
        -------
        array
            Force of each actuator, (n_actuators, runs).
        """
        at = k - self._late
        first, last = int(np.floor(at / self._sub)), int(np.floor((at + 1) / self._sub))
        share = last * self._sub - at if last > first else 1.0  # share of the step before the next sample
        u = share * self._sample(first) + (1.0 - share) * (self._sample(last) if share < 1.0 else 0.0)
        out = u + (self._state - u) * self._share
        self._state = u + (self._state - u) * self._kept
        return np.asarray(out)

    def _sample(self, index: int) -> Array:
        return self._past[index] if index >= 0 else self._none


def integrate(
    bench: Bench,
    commands: Array,
    laws: Sequence[tuple[str, Law]],
    *,
    step: float,
    substeps: int,
    feedback: Feedback | None = None,
) -> Array:
    """Integrate a bench under actuator forces and hidden laws, from rest.

    Parameters
    ----------
    bench : Bench
        Bench.
    commands : (n_steps, n_actuators, runs) array
        Actuator forces, constant over each step.
    laws : sequence of (place, law)
        Forces along places.
    step : float
        Integration step [s].
    substeps : int
        Steps per returned sample.
    feedback : Feedback or None
        Law in the loop.

    Returns
    -------
    (n_samples, n_sensors, runs) array
        True sensor values at the beginning of each sample.
    """
    poles = Poles.of(bench)
    sensors = np.array([port_rows(s.row, s.order) for s in bench.sensors.values()])
    linear = poles.response(bench.loads, commands, sensors, step, substeps)
    if not laws and feedback is None:
        return linear
    rows = [bench.places[place].row for place, _ in laws]
    at = np.array([port_rows(row, order) for order in (0, 1) for row in rows]).reshape(-1, 2 * bench.n)
    loads = np.column_stack([*rows, *([] if feedback is None else [bench.loads[:, list(feedback.actuators)]])])
    move, drive = _transition(bench, loads, step)
    free = poles.response(bench.loads, commands, at, step) if laws else np.zeros((len(commands), 0, linear.shape[2]))
    problem = _Problem(
        move=move,
        drive=drive,
        at=at,
        sensors=sensors,
        free=np.concatenate([free, free[-1:]]),
        linear=linear,
        laws=tuple(law for _, law in laws),
        coils=tuple(_coil(bench, place, commands) for place, _ in laws),
        fed_back=tuple(_fed_back(bench, place, feedback) for place, _ in laws),
        step=step,
        substeps=substeps,
    )
    if feedback is None and laws and all(isinstance(law, Static) for _, law in laws):
        try:
            return linear + in_windows(problem)
        except Diverged:  # steep law: use single steps
            return linear + step_by_step(problem, feedback)
    return linear + step_by_step(problem, feedback)


def _coil(bench: Bench, place: str, commands: Array) -> Array | None:
    """Return the commanded force of the actuator along a place."""
    name = bench.places[place].actuator
    return commands[:, list(bench.actuators).index(name)] if name else None


def _fed_back(bench: Bench, place: str, feedback: Feedback | None) -> int | None:
    """Return the fed-back actuator along a place."""
    names, name = list(bench.actuators), bench.places[place].actuator
    if feedback is None or not name or names.index(name) not in feedback.actuators:
        return None
    return feedback.actuators.index(names.index(name))


def _transition(bench: Bench, loads: Array, step: float) -> tuple[Array, Array]:
    """Return the exact transition over a step, and that of constant forces."""
    A, inverse = bench.first_order()
    n, k = bench.n, loads.shape[1]
    wide = np.zeros((2 * n + k,) * 2)
    wide[: 2 * n, : 2 * n] = A
    wide[n : 2 * n, 2 * n :] = inverse @ loads
    moved = linalg.expm(wide * step)
    return moved[: 2 * n, : 2 * n], moved[: 2 * n, 2 * n :]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Problem:
    """Motion added by hidden forces and feedback.

    Parameters
    ----------
    move : (m, m) array
        Transition of the state over a step.
    drive : (m, p + k) array
        Effect of unit forces over a step: p laws, then k fed-back actuators.
    at : (2p, m) array
        Displacements of the places, then their velocities.
    free : (n_steps + 1, 2p, runs) array
        Response of the places to commands alone.
    linear : (n_samples, n_sensors, runs) array
        Response of the sensors to commands alone.
    coils : tuple of (n_steps, runs) array or None
        Commanded actuator force along the place of each law.
    fed_back : tuple of int or None
        Fed-back actuator along the place of each law.
    """

    move: Array
    drive: Array
    at: Array
    sensors: Array
    free: Array
    linear: Array
    laws: tuple[Law, ...]
    coils: tuple[Array | None, ...]
    fed_back: tuple[int | None, ...]
    step: float
    substeps: int


WINDOW, WINDOW_S = 20, 0.004
"""WINDOW [steps], WINDOW_S [s]: steps solved together, and their longest duration; the iteration contracts with its
square."""
TOLERANCE, MOST_SWEEPS = 1e-9, 60
"""TOLERANCE, MOST_SWEEPS [-]: relative change of the forces at convergence, and most iterations."""


def in_windows(problem: _Problem) -> Array:
    """Integrate laws without memory, one window of steps at a time.

    Fixed-point iteration solves for all forces of a window.

    Parameters
    ----------
    problem : _Problem
        Motion to integrate.

    Returns
    -------
    array
        Added motion at the sensors, (n_samples, n_sensors, runs).

    Raises
    ------
    Diverged
        A window does not converge: the law is too steep for the step.
    """
    m, p, runs = len(problem.move), len(problem.laws), problem.free.shape[2]
    sub, steps = problem.substeps, len(problem.free) - 1
    width = sub * max(1, min(WINDOW, round(WINDOW_S / problem.step)) // sub)
    powers = [np.eye(m)]
    for _ in range(width):
        powers.append(problem.move @ powers[-1])
    pulses = [power @ problem.drive for power in powers[:-1]]  # (m, p): i steps after a step of unit forces
    middle = 0.5 * np.array([problem.at @ (a + b) for a, b in pairwise(powers)])
    answer = np.zeros((width, 2 * p, width, p))
    final = np.zeros((m, width, p))
    heard = np.zeros((width // sub, len(problem.sensors), width, p))
    for i in range(width):
        final[:, i] = pulses[width - 1 - i]
        for j in range(i + 1):
            after = pulses[i - j]
            before = pulses[i - j - 1] if j < i else np.zeros_like(after)
            answer[i, :, j] = 0.5 * problem.at @ (after + before)
        if i % sub == 0:
            for j in range(i):
                heard[i // sub, :, j] = problem.sensors @ pulses[i - 1 - j]
    to_middle, by_force = middle.reshape(-1, m), answer.reshape(width * 2 * p, width * p)
    to_end, to_sensors = final.reshape(m, -1), heard.reshape(-1, width * p)
    listen = np.concatenate([problem.sensors @ powers[i] for i in range(0, width, sub)])
    out = np.zeros((-(-steps // width) * (width // sub), len(problem.sensors), runs))
    state, forces, largest = np.zeros((m, runs)), np.zeros((width, p, runs)), 1e-300
    at_middle = 0.5 * (problem.free[:-1] + problem.free[1:])
    count = width // sub
    for w, first in enumerate(range(0, steps, width)):
        size = min(width, steps - first)
        base = (to_middle @ state).reshape(width, 2 * p, runs)
        base[:size] += at_middle[first : first + size]
        time = ((first + np.arange(width)) * problem.step + 0.5 * problem.step)[:, None]
        coils = [0.0 if c is None else _padded(c[first : first + size], width) for c in problem.coils]
        for _ in range(MOST_SWEEPS):
            seen = base + (by_force @ forces.reshape(width * p, runs)).reshape(width, 2 * p, runs)
            new = np.empty_like(forces)
            for j, law in enumerate(problem.laws):
                new[:, j] = law.force(seen[:, j], seen[:, p + j], time, problem.step, coils[j], {})
            largest = max(largest, float(np.abs(new).max()))
            change = float(np.abs(new - forces).max())
            forces = new
            if not change > TOLERANCE * largest:
                break
        else:
            raise Diverged(f"a hidden force does not converge at a step of {problem.step:g} s")
        flat = forces.reshape(width * p, runs)
        out[w * count : (w + 1) * count] = (listen @ state + to_sensors @ flat).reshape(count, -1, runs)
        state = powers[width] @ state + to_end @ flat
    return out[: len(problem.linear)]


def _padded(values: Array, count: int) -> Array:
    return (
        values if len(values) == count else np.concatenate([values, np.zeros((count - len(values), *values.shape[1:]))])
    )


def step_by_step(problem: _Problem, feedback: Feedback | None) -> Array:
    """Integrate laws with memory, friction or feedback, step by step.

    Parameters
    ----------
    problem : _Problem
        Motion to integrate.
    feedback : Feedback or None
        Law in the loop.

    Returns
    -------
    array
        Added motion at the sensors, (n_samples, n_sensors, runs).
    """
    p, runs, m = len(problem.laws), problem.free.shape[2], len(problem.move)
    steps, sub, h = len(problem.free) - 1, problem.substeps, problem.step
    mobility = problem.at @ problem.drive  # of the places, after a step of unit forces
    full = np.vstack([problem.move, problem.at @ problem.move])
    state, work = np.zeros((m, runs)), np.zeros((m + 2 * p, runs))
    drive, free, linear = problem.drive, problem.free, problem.linear
    forces, ports = np.zeros((drive.shape[1], runs)), np.zeros((2 * p, runs))
    states = np.zeros((len(linear), m, runs))
    memories = [law.start(runs) for law in problem.laws]
    listens = [] if feedback is None else list(feedback.sensors)
    heard, ends, moved = problem.sensors[listens], work[m:], work[:m]
    way = None if feedback is None else _Way(feedback.output, h, sub, (len(feedback.actuators), runs))
    single = p == 1 and feedback is None
    if single:
        solve, memory, a, b = problem.laws[0].solve, memories[0], float(mobility[0, 0]), float(mobility[1, 0])
        coil, to_state, to_ports = problem.coils[0], drive[:, :1], mobility[:, :1]
    for k in range(steps):
        if k % sub == 0:
            states[k // sub] = state
            if feedback is not None and way is not None:
                seen = heard @ state + linear[k // sub, listens] + feedback.noise[k // sub]
                way.say(-feedback.gains @ seen)
        if way is not None:
            forces[p:] = way.force(k)
        full.dot(state, out=work)
        ends += free[k + 1]
        if single:
            u = 0.0 if coil is None else coil[k]
            force = solve(ports[0], ports[1], ends[0], ends[1], a, b, k * h, h, u, memory)
            state, ports = moved + to_state * force, ends + to_ports * force
            continue
        for j in range(p):
            others = [i for i in range(len(forces)) if i != j]
            z1 = ends[j] + mobility[j, others] @ forces[others]
            v1 = ends[p + j] + mobility[p + j, others] @ forces[others]
            coil_j = problem.coils[j]
            u = 0.0 if coil_j is None else coil_j[k]
            fed = problem.fed_back[j]
            u = u if fed is None else u + forces[p + fed]
            forces[j] = problem.laws[j].solve(
                ports[j], ports[p + j], z1, v1, mobility[j, j], mobility[p + j, j], k * h, h, u, memories[j]
            )
        state, ports = moved + drive @ forces, ends + mobility @ forces
    return np.einsum("ms,tsr->tmr", problem.sensors, states)


def semi_implicit(bench: Bench, commands: Array, period: float, step: float) -> Array:
    """Return the samples of a simulator with a coarse step.

    The rates at the end of a step move the coordinates [1]_. Dampers are implicit in the rate of their own coordinate, as
    between bodies of different kinematic trees.

    Parameters
    ----------
    bench : Bench
        Bench.
    commands : (n_samples, n_actuators, runs) array
        Forces, held over a sample.
    period : float
        Sample period [s]; whole steps fit into it.
    step : float
        Step [s].

    Returns
    -------
    (n_samples, n_sensors, runs) array
        Samples.

    References
    ----------
    .. [1] E. Hairer, C. Lubich and G. Wanner, *Geometric Numerical Integration*, Springer, 2nd ed., 2006, I.1.2.
    """
    q, v = np.zeros((bench.n, commands.shape[2])), np.zeros((bench.n, commands.shape[2]))
    gain = step * np.linalg.inv(bench.M + step * np.diag(np.diag(bench.C)))
    rows = [(s.row, s.order) for s in bench.sensors.values()]
    out = np.zeros((len(commands), len(rows), commands.shape[2]))
    for k, command in enumerate(commands):
        for j, (row, order) in enumerate(rows):
            out[k, j] = row @ (v if order else q)
        force = bench.loads @ command
        for _ in range(round(period / step)):
            v = v + gain @ (force - bench.K @ q - bench.C @ v)
            q = q + step * v
    return out
