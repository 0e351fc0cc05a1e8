"""Linear least squares estimate of an initial modal state."""

from dataclasses import dataclass, field

import mujoco
import numpy as np

from vlab.cases.channel_map import Compared, Run
from vlab.cases.clock import Clock
from vlab.cases.replay_bench import Bench, Loads, State, bench_for
from vlab.cases.replay_inputs import before
from vlab.errors import BadCase
from vlab.fe.second_order import SecondOrderModel
from vlab.plants.base import Plant, without_limits
from vlab.signals import Array

MOST_MODES = 8
"""MOST_MODES [1]: largest number of estimated modes."""


_STEP = 1e-6
"""_STEP [largest joint motion, m or rad]: step of the central differences of the sensors."""


@dataclass(eq=False)
class StartProblem:
    """Least-squares problem of one run's window."""

    bench: Bench
    clock: Clock
    run: Run  # window without a law
    measured: Array  # (samples, channels), relative to the model's rest
    weight: Array  # (channels,)
    shapes: Array = field(default_factory=lambda: np.zeros((0, 0)))
    scale: Array = field(default_factory=lambda: np.zeros(0))
    origin: State | None = None  # origin of the coordinates; rest if None
    held: float = 0.0  # weight of the coordinates relative to the samples
    servoed: dict[int, tuple[str, float]] = field(default_factory=dict)

    def state(self, x: Array) -> State:
        """Return the state of scaled modal coordinates.

        Parameters
        ----------
        x : (2 m,) array
            Modal displacements, then modal velocities, in multiples of `scale`.

        Returns
        -------
        State
            Joint positions and velocities of the model.
        """
        m = self.shapes.shape[1]
        origin = self.bench.rest if self.origin is None else self.origin
        qpos = origin.qpos.copy()
        mujoco.mj_integratePos(self.bench.model, qpos, self.shapes @ (x[:m] * self.scale[:m]), 1.0)
        return State(qpos, origin.qvel + self.shapes @ (x[m:] * self.scale[m:]))


def estimate_linear_start(problem: StartProblem, linear: SecondOrderModel) -> tuple[Array, Array, float]:
    """Return scaled modal coordinates, mode indices and sum of squares.

    The information criterion chooses the number of modes.

    Parameters
    ----------
    problem : StartProblem
        Model and window of the recording; `shapes` and `scale` are set to those of the chosen modes.
    linear : SecondOrderModel
        Model about rest.

    Returns
    -------
    tuple of ((2 m,) array, (m,) array, float)
        Coordinates as `StartProblem.state` takes them, indices of the modes, and the weighted sum of squares.

    Raises
    ------
    BadCase
        No mode lies below the band of the recording, or the first one grows out of all numbers.
    """
    omega, all_shapes = linear.eigen
    time = problem.run.measured.time
    nyquist = 0.45 * (len(time) - 1) / (time[-1] - time[0])
    usable = np.flatnonzero(np.abs(omega) < 2 * np.pi * nyquist)[:MOST_MODES]
    usable = usable[: max(1, problem.measured.size // 4)]
    if not usable.size:
        raise BadCase(
            f'{problem.run.name}: no mode lies below {nyquist:.3g} Hz; the initial state cannot be estimated, say initial = "rest"'
        )
    best: tuple[float, Array, int, float] | None = None
    for m in range(1, usable.size + 1):
        chosen = usable[:m]
        slowest = 2 * np.pi / (time[-1] - time[0])
        problem.shapes = all_shapes[:, chosen]
        problem.scale = np.concatenate([np.ones(m), np.maximum(np.abs(omega[chosen]), slowest)])
        with np.errstate(over="ignore", invalid="ignore"):  # growth out of all numbers ends the search below
            matrix, forced = _responses(problem, omega[chosen], linear)
        target = ((problem.measured - forced) * problem.weight).ravel()
        matrix *= np.tile(problem.weight, len(time))[:, None]
        if not (np.isfinite(matrix).all() and np.isfinite(target).all()):
            break  # the mode grows out of all numbers within the window
        x = np.linalg.lstsq(matrix, target, rcond=1e-9)[0]
        left = target - matrix @ x
        floor = 1e-20 * float(target @ target) + 1e-300  # rounding level: a better fit has no meaning
        score = target.size * np.log(float(left @ left) + floor) + 2 * m * np.log(target.size)
        if best is None or score < best[0]:
            best = (float(score), x, m, float(left @ left))
    if best is None:
        raise BadCase(
            f"{problem.run.name}: the model about rest is unstable and grows out of all numbers within "
            f'{time[-1] - time[0]:.3g} s; check the signs of damping and stiffness, or say initial = "rest"'
        )
    _, x, m, expected = best
    chosen = usable[:m]
    problem.shapes = all_shapes[:, chosen]
    problem.scale = np.concatenate([np.ones(m), np.maximum(np.abs(omega[chosen]), 2 * np.pi / (time[-1] - time[0]))])
    return x, chosen, expected


def _responses(problem: StartProblem, omega: Array, linear: SecondOrderModel) -> tuple[Array, Array]:
    """Return channel responses to modal coordinates and inputs.

    The first has shape (samples * channels, 2 m).
    """
    shapes, scale, m, window = problem.shapes, problem.scale, len(omega), problem.run
    damping = shapes.T @ linear.C @ shapes
    A = np.block([[np.zeros((m, m)), np.eye(m)], [-np.diag(np.sign(omega) * omega**2), -damping]])
    forces, direct = input_matrices(problem.bench.plant, window)
    B = np.vstack([np.zeros((m, forces.shape[1])), shapes.T @ forces])
    C = _output_matrix(problem)
    time, names = window.measured.time, [d.channel for d in window.drives]
    inputs = window.measured.select(names).data if names else np.zeros((len(time), 0))
    held = np.array([d.is_held for d in window.drives], dtype=bool)
    present = np.where(held, before(inputs, stood=True), inputs)
    steps = np.diff(time)[: 1 if window.measured.is_uniform else None]
    n, p = 2 * m, B.shape[1]
    blocks = np.zeros((steps.size, n + p, n + p))
    blocks[:, :n, :n], blocks[:, :n, n:] = A, B
    moves = exponentials(blocks * steps[:, None, None])
    free, forced = np.diag(scale), np.zeros(n)
    matrix, drive = np.zeros((len(time), C.shape[0], n)), np.zeros((len(time), C.shape[0]))
    for k in range(len(time)):
        matrix[k], drive[k] = C @ free, C @ forced + direct @ present[k]
        if k + 1 < len(time):
            move = moves[min(k, len(moves) - 1)]
            free, forced = move[:n, :n] @ free, move[:n, :n] @ forced + move[:n, n:] @ inputs[k]
    return matrix.reshape(-1, n), drive


def exponentials(matrices: Array) -> Array:
    """Return the exponentials of many small matrices.

    Scaling and squaring with a Taylor series [1]_. With a norm of 1/4 the first omitted term is 1/4^13/13! = 2e-18,
    below rounding. scipy takes 7 ms a small matrix here.

    Parameters
    ----------
    matrices : array
        Square matrices, (k, n, n).

    Returns
    -------
    array
        exp of each, (k, n, n).

    References
    ----------
    .. [1] C. Moler and C. Van Loan, Nineteen dubious ways to compute the exponential of a matrix, twenty-five years
           later, SIAM Review 45 (2003) 3-49, method 3.
    """
    norm = float(np.abs(matrices).sum(axis=-1).max(initial=0.0))
    squarings = max(0, int(np.ceil(np.log2(max(norm, 1e-300) / 0.25))))
    scaled = matrices / 2.0**squarings
    term = np.broadcast_to(np.eye(matrices.shape[-1]), matrices.shape)
    total = term.copy()
    for k in range(1, 13):
        term = term @ scaled / k
        total += term
    for _ in range(squarings):
        total = total @ total
    return total


def _output_matrix(problem: StartProblem) -> Array:
    """Return the channels per modal displacement and velocity.

    Central differences of the sensors give the derivatives.
    """
    bench, m = problem.bench, problem.shapes.shape[1]
    columns = []
    for i in range(2 * m):
        shape = problem.shapes[:, i % m]
        step = _STEP / np.abs(shape).max()
        sides = []
        for sign in (step, -step):
            qpos, qvel = bench.rest.qpos.copy(), np.zeros(bench.model.nv)
            if i < m:
                mujoco.mj_integratePos(bench.model, qpos, shape, sign)
            else:
                qvel = shape * sign
            sides.append(_values(bench, problem.run.compared, State(qpos, qvel), np.zeros(bench.model.nu)))
        columns.append((sides[0] - sides[1]) / (2 * step))
    return np.array(columns).T


def _values(
    bench: Bench, compared: tuple[Compared, ...], state: State, ctrl: Array, loads: Loads | None = None
) -> Array:
    bench.start(state)
    bench.look(ctrl, loads=loads)
    return bench.values(compared, bench.sensors())


def input_matrices(plant: Plant, run: Run) -> tuple[Array, Array]:
    """Return the drives' generalised forces and direct feedthrough.

    Parameters
    ----------
    plant : Plant
        Plant.
    run : Run
        Recording with drives and compared channels.

    Returns
    -------
    forces : (nv, n_drives) array
        Generalised forces per unit input about rest.
    direct : (n_channels, n_drives) array
        Channels per unit input, without motion [SI].
    """
    plant = without_limits(plant)  # a unit command may exceed the limits
    bench = bench_for(plant, run)
    data, of_commands = plant.new_data(), plant.actuator_forces()
    rest = bench.rest_values(run.compared)
    forces = np.zeros((bench.model.nv, len(run.drives)))
    direct = np.zeros((rest.size, len(run.drives)))
    still = np.zeros(bench.model.nu)
    for i, drive in enumerate(run.drives):
        if drive.port:
            port = plant.port(drive.port)
            forces[:, i] = port.row(data)
            pair = [_values(bench, run.compared, bench.rest, still, [(port, load)]) for load in (1.0, 0.0)]
            direct[:, i] = pair[0] - pair[1]
        elif drive.actuator is not None:
            forces[:, i] = of_commands[:, drive.actuator]
            ctrl = plant.control_matrix[:, drive.actuator]
            direct[:, i] = _values(bench, run.compared, bench.rest, ctrl) - rest
    return forces, direct
