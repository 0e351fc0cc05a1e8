"""The loops over samples in which laws act, compiled: laws as tapes of operations, many parameter sets and recordings side by side."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from vlab.physics.tape import CODE, SIGNALS, Tape
from vlab.signals import Array

RUNAWAY = 1e12
"""Forces and states beyond this have run away."""
CHECKED = 8
"""Every so many samples states are looked at whether they ran away."""
MOST = 1e9
"""What such states are brought back to."""
MOST_ALIKE = 1e8
"""Condition of a step's own directions up to which states are marched along them: half of all digits are left."""

_COPY, _ADD, _SUBTRACT, _MULTIPLY = (CODE[f] for f in (np.positive, np.add, np.subtract, np.multiply))
_DIVIDE, _NEGATIVE, _ABSOLUTE = (CODE[f] for f in (np.divide, np.negative, np.absolute))
_MINIMUM, _MAXIMUM, _SIGN = (CODE[f] for f in (np.minimum, np.maximum, np.sign))
_EXP, _LOG, _SQRT, _SIN, _COS, _TANH = (CODE[f] for f in (np.exp, np.log, np.sqrt, np.sin, np.cos, np.tanh))
_ARCTAN, _POWER, _HYPOT, _FLOOR = (CODE[f] for f in (np.arctan, np.power, np.hypot, np.floor))
_LESS, _LESS_EQUAL, _GREATER, _GREATER_EQUAL = (CODE[f] for f in (np.less, np.less_equal, np.greater, np.greater_equal))
_EQUAL, _NOT_EQUAL, _AND, _OR = (CODE[f] for f in (np.equal, np.not_equal, np.logical_and, np.logical_or))
_NOT, _WHERE = CODE[np.logical_not], CODE[np.where]
_Z, _V, _T, _FREE, _FIRST, _COMMAND, _MOBILITY = range(len(SIGNALS))


@njit(cache=True, error_model="numpy")
def _play(operations: Array, first: int, registers: Array) -> None:  # pragma: no cover - compiled
    """Do a tape's operations on registers (n_registers, n)."""
    n = registers.shape[1]
    for line in range(operations.shape[0]):
        code = operations[line, 0]
        a, b, c = registers[operations[line, 1]], registers[operations[line, 2]], registers[operations[line, 3]]
        out = registers[first + line]
        if code == _ADD:
            for e in range(n):
                out[e] = a[e] + b[e]
        elif code == _SUBTRACT:
            for e in range(n):
                out[e] = a[e] - b[e]
        elif code == _MULTIPLY:
            for e in range(n):
                out[e] = a[e] * b[e]
        elif code == _DIVIDE:
            for e in range(n):
                out[e] = a[e] / b[e]
        elif code == _NEGATIVE:
            for e in range(n):
                out[e] = -a[e]
        elif code == _COPY:
            for e in range(n):
                out[e] = a[e]
        elif code == _ABSOLUTE:
            for e in range(n):
                out[e] = abs(a[e])
        elif code == _MINIMUM:
            for e in range(n):
                out[e] = np.minimum(a[e], b[e])
        elif code == _MAXIMUM:
            for e in range(n):
                out[e] = np.maximum(a[e], b[e])
        elif code == _WHERE:
            for e in range(n):
                out[e] = b[e] if a[e] != 0.0 else c[e]
        elif code == _SIGN:
            for e in range(n):
                out[e] = np.sign(a[e])
        elif code == _LESS:
            for e in range(n):
                out[e] = 1.0 if a[e] < b[e] else 0.0
        elif code == _LESS_EQUAL:
            for e in range(n):
                out[e] = 1.0 if a[e] <= b[e] else 0.0
        elif code == _GREATER:
            for e in range(n):
                out[e] = 1.0 if a[e] > b[e] else 0.0
        elif code == _GREATER_EQUAL:
            for e in range(n):
                out[e] = 1.0 if a[e] >= b[e] else 0.0
        elif code == _EQUAL:
            for e in range(n):
                out[e] = 1.0 if a[e] == b[e] else 0.0
        elif code == _NOT_EQUAL:
            for e in range(n):
                out[e] = 1.0 if a[e] != b[e] else 0.0
        elif code == _AND:
            for e in range(n):
                out[e] = 1.0 if a[e] != 0.0 and b[e] != 0.0 else 0.0
        elif code == _OR:
            for e in range(n):
                out[e] = 1.0 if a[e] != 0.0 or b[e] != 0.0 else 0.0
        elif code == _NOT:
            for e in range(n):
                out[e] = 1.0 if a[e] == 0.0 else 0.0
        else:
            _play_slowly(code, a, b, out)


@njit(cache=True, error_model="numpy")
def _play_slowly(code: int, a: Array, b: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Do an operation that takes longer than it takes to choose it."""
    for e in range(out.size):
        x = a[e]
        if code == _EXP:
            y = np.exp(x)
        elif code == _TANH:
            y = np.tanh(x)
        elif code == _SIN:
            y = np.sin(x)
        elif code == _COS:
            y = np.cos(x)
        elif code == _LOG:
            y = np.log(x)
        elif code == _SQRT:
            y = np.sqrt(x)
        elif code == _ARCTAN:
            y = np.arctan(x)
        elif code == _FLOOR:
            y = np.floor(x)
        elif code == _POWER:
            y = x ** b[e]
        else:
            y = np.hypot(x, b[e])
        out[e] = y


_sums = njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
"""Compiles loops whose sums may be taken in any order, several terms at a time."""


@_sums
def _march_free(
    turn: Array,
    dense: Array,
    into: Array,
    rows: Array,
    direct: Array,
    inputs: Array,
    state: Array,
    substeps: int,
    y: Array,
) -> None:  # pragma: no cover - compiled
    """March states under inputs alone and fill in the channels y (n_sets, n_runs, n, p); see `march_modes`."""
    n_sets, n_runs, n, channels = y.shape
    n_inputs, size = inputs.shape[4], state.shape[2]
    m = size // 2
    held = np.empty(size)
    for s in range(n_sets):
        of = min(s, inputs.shape[2] - 1)
        for r in range(n_runs):
            x = state[s, r]
            for k in range(n):
                for c in range(channels):
                    total = 0.0
                    for j in range(size):
                        total += x[j] * rows[s, c, j]
                    for i in range(n_inputs):
                        total += inputs[k, 0, of, r, i] * direct[s, i, c]
                    y[s, r, k, c] = total
                for sub in range(substeps):
                    now = min(sub, inputs.shape[1] - 1)
                    if dense.shape[0] > 0:
                        held[:] = x
                        x[:] = 0.0
                        for i in range(m):
                            for j in range(m):
                                x[j] += held[i] * dense[s, i, j]
                    else:
                        for j in range(m):
                            held[j] = x[j] * turn[0, s, j] - x[m + j] * turn[1, s, j]
                            held[m + j] = x[j] * turn[1, s, j] + x[m + j] * turn[0, s, j]
                        x[:] = held
                    for i in range(n_inputs):
                        u = inputs[k, now, of, r, i]
                        if u != 0.0:
                            for j in range(size):
                                x[j] += u * into[s, i, j]


@_sums
def _march_looped(
    turn: Array,
    dense: Array,
    into: Array,
    rows: Array,
    direct: Array,
    inputs: Array,
    state: Array,
    substeps: int,
    seen_rows: Array,
    seen: Array,
    last: Array,
    clock: tuple[float, Array],
    laws: tuple[Array, Array, Array, Array, Array, Array],
    tapes: tuple[Array, Array, Array, Array, Array],
    registers: Array,
    y: Array,
) -> None:  # pragma: no cover - compiled
    """As `_march_free`, with laws in the loop of all sets and runs side by side."""
    h, late = clock
    ports, coils, push, felt, direct_law, results = laws
    operations, bounds, firsts, remembers, recalled = tapes
    n_sets, n_runs, n, channels = y.shape
    n_inputs, size = inputs.shape[4], state.shape[2]
    m, sees, n_laws = size // 2, seen.shape[2], len(ports)
    after, known, held = np.empty_like(seen), np.empty_like(seen), np.empty(size)
    for k in range(n):
        for s in range(n_sets):
            of = min(s, inputs.shape[2] - 1)
            for r in range(n_runs):
                for c in range(channels):
                    total = 0.0
                    for j in range(size):
                        total += state[s, r, j] * rows[s, c, j]
                    for i in range(n_inputs):
                        total += inputs[k, 0, of, r, i] * direct[s, i, c]
                    y[s, r, k, c] = total
        for sub in range(substeps):
            now = min(sub, inputs.shape[1] - 1)
            for s in range(n_sets):
                of = min(s, inputs.shape[2] - 1)
                for r in range(n_runs):
                    if dense.shape[0] > 0:
                        for j in range(m):
                            held[j] = state[s, r, j]
                            state[s, r, j] = 0.0
                        for i in range(m):
                            for j in range(m):
                                state[s, r, j] += held[i] * dense[s, i, j]
                    else:
                        for j in range(m):
                            x = state[s, r, j]
                            state[s, r, j] = x * turn[0, s, j] - state[s, r, m + j] * turn[1, s, j]
                            state[s, r, m + j] = x * turn[1, s, j] + state[s, r, m + j] * turn[0, s, j]
                    for i in range(n_inputs):
                        u = inputs[k, now, of, r, i]
                        if u != 0.0:
                            for j in range(size):
                                state[s, r, j] += u * into[s, i, j]
                    for i in range(sees):
                        total = 0.0
                        for j in range(size):
                            total += state[s, r, j] * seen_rows[s, i, j]
                        after[s, r, i] = total
                        known[s, r, i] = 0.0
                        for law in range(
                            n_laws
                        ):  # forces change by little in a step: the last ones stand for those to come
                            known[s, r, i] += last[law, s, r, i]
            for law in range(n_laws):
                z, v, coil = ports[law], sees // 2 + ports[law], coils[law]
                own = registers[bounds[law, 0] : bounds[law + 1, 0]]
                for s in range(n_sets):
                    of = min(s, inputs.shape[2] - 1)
                    for r in range(n_runs):
                        e = s * n_runs + r
                        own[_Z, e] = 0.5 * (seen[s, r, z] + (after[s, r, z] + known[s, r, z]))
                        own[_V, e] = 0.5 * (seen[s, r, v] + (after[s, r, v] + known[s, r, v]))
                        own[_T, e] = late[r] + (k * substeps + sub + 0.5) * h
                        own[_FREE, e], own[_FIRST, e] = after[s, r, v], seen[s, r, v]
                        own[_COMMAND, e] = inputs[k, 0, of, r, coil] if coil >= 0 else 0.0
                _play(operations[bounds[law, 1] : bounds[law + 1, 1]], firsts[law], own)
                for i in range(bounds[law, 2], bounds[law + 1, 2]):
                    own[recalled[i]] = own[remembers[i]]
                for s in range(n_sets):
                    for r in range(n_runs):
                        force = own[results[law], s * n_runs + r]
                        for j in range(size):
                            state[s, r, j] += force * push[s, law, j]
                        for i in range(sees):
                            known[s, r, i] -= last[law, s, r, i]
                            last[law, s, r, i] = force * felt[s, law, i]
                            after[s, r, i] += last[law, s, r, i]
                        if sub == 0:
                            for c in range(channels):
                                y[s, r, k, c] += force * direct_law[s, law, c]
            seen[:] = after
        if k % CHECKED == 0 and not np.abs(state).max() < RUNAWAY:
            for s in range(n_sets):
                for r in range(n_runs):
                    for j in range(size):
                        x = state[s, r, j]
                        state[s, r, j] = MOST if np.isnan(x) else min(max(x, -MOST), MOST)
            last[:] = 0.0


@njit(cache=True, error_model="numpy")
def _series(
    operations: Array, first: int, registers: Array, signals: Array, remembers: Array, recalled: Array, result: int
) -> Array:  # pragma: no cover - compiled
    """Return a law's force (n, m) along given signals (n, n_signals, m) for the registers from the first on."""
    n, count, m = signals.shape
    out = np.empty((n, m))
    for k in range(n):
        for i in range(count):
            registers[i] = signals[k, i]
        _play(operations, first, registers)
        for i in range(len(recalled)):
            registers[recalled[i]] = registers[remembers[i]]
        out[k] = registers[result]
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Modes:
    """A step's own directions, in which it turns and shrinks states: pairs of conjugate ones as one complex number.

    Parameters
    ----------
    turn : (2, n_sets, m) array
        Real and imaginary part of what a step multiplies each by.
    dense : (n_sets, m, m) array
        The step itself where its own directions are too nearly the same, as of a mass that nothing holds or brakes; else empty.
    into, back : (n_sets, width, m) and (n_sets, m, width) array of complex
        The directions' coordinates x @ into of states x, and states Re(z @ back) of coordinates.
    """

    turn: Array
    dense: Array
    into: Array
    back: Array


def modes_of(step: Array) -> Modes:
    """Return the own directions of steps (n_sets, width, width) that act on rows of states from the right."""
    n_sets, width, _ = step.shape
    values, vectors = np.linalg.eig(step)
    if not np.linalg.cond(vectors).max() < MOST_ALIKE:
        one = np.broadcast_to(np.eye(width, dtype=complex), step.shape)
        return Modes(turn=np.zeros((2, n_sets, width)), dense=np.ascontiguousarray(step), into=one, back=one)
    inverse = np.linalg.inv(vectors)
    weight = np.where(values.imag > 0, 2.0, np.where(values.imag < 0, 0.0, 1.0))  # one of a pair stands for both
    order = np.argsort(weight == 0, axis=1, kind="stable")[:, : int(np.count_nonzero(weight, axis=1).max())]
    values, weight = (np.take_along_axis(x, order, axis=1) for x in (values, weight))
    return Modes(
        turn=np.stack([values.real, values.imag]),
        dense=np.zeros((0, width, width)),
        into=np.take_along_axis(vectors, order[:, None, :], axis=2),
        back=np.take_along_axis(inverse, order[:, :, None], axis=1) * weight[:, :, None],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopLaw:
    """A law in the loop.

    Parameters
    ----------
    tape : Tape
        For the length of a substep.
    values : sequence of (n_sets, 1) array
        Its parameters, in the order of its class.
    memory : sequence of array
        What it remembers at first, each (n_sets, n_runs) or less.
    push : (n_sets, width) array
        What a unit force over a substep adds to the states.
    direct : (n_sets, p) array
        What it adds to the channels at once.
    port : int
        Where it acts.
    coil : int or None
        Which of the known inputs is the command there.
    """

    tape: Tape
    values: Sequence[Array]
    memory: Sequence[Any]
    push: Array
    direct: Array
    port: int
    coil: int | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Marched:
    """A linear system of states on rows, stepped by `step`.

    Parameters
    ----------
    step : (n_sets, width, width) array
        A substep.
    into : (n_sets, n_inputs, width) array
        What unit inputs add to the states in a substep.
    channels : (n_sets, width, p) array
    direct : (n_sets, n_inputs, p) array
        What inputs add to the channels at once.
    seen : (width, 2 n_ports) array
        Displacements, then velocities, of the ports.
    """

    step: Array
    into: Array
    channels: Array
    direct: Array
    seen: Array


def march_modes(
    system: Marched,
    laws: Sequence[LoopLaw],
    part: Array,
    given: Array,
    starts: Array,
    late: Array,
    h: float,
) -> Array:
    """March a linear system with laws in its loop.

    Parameters
    ----------
    part : (n, n_sets or 1, n_runs, known) array
        The first inputs, held over a sample.
    given : (n, substeps, n_sets, n_runs, n_inputs - known) array
        The other ones.
    starts : (n_sets, n_runs, width) array
    late : (n_runs,) array
        Times at which the runs begin [s].
    h : float
        Length of a substep [s].

    Returns
    -------
    (n, n_sets, n_runs, p) array
        Channels.
    """
    (n_sets, n_runs, _), n, p = starts.shape, len(part), system.channels.shape[2]
    modes = modes_of(system.step)

    def inward(rows: Array) -> Array:
        there = rows @ modes.into
        return np.ascontiguousarray(np.concatenate([there.real, there.imag], axis=-1))

    def outward(columns: Array) -> Array:
        there = np.swapaxes(modes.back @ columns, 1, 2)
        return np.ascontiguousarray(np.concatenate([there.real, -there.imag], axis=-1))

    inputs = part[:, None]
    if given.shape[-1]:
        inputs = np.concatenate([np.broadcast_to(inputs, (*given.shape[:-1], inputs.shape[-1])), given], axis=-1)
    y = np.empty((n_sets, n_runs, n, p))
    common = (
        np.ascontiguousarray(modes.turn),
        modes.dense,  # all in C's order: loops over rows of others take three times as long
        inward(system.into),
        outward(system.channels),
        np.ascontiguousarray(system.direct),
        np.ascontiguousarray(inputs),
        inward(starts),
        given.shape[1],
    )
    if not laws:
        _march_free(*common, y)
        return y.transpose(2, 0, 1, 3)
    seen_of, push = system.seen, np.stack([law.push for law in laws], axis=1)
    felt = push @ seen_of
    registers = np.zeros((sum(law.tape.registers for law in laws), n_sets * n_runs))
    bounds = np.zeros((len(laws) + 1, 3), dtype=np.int64)
    for i, law in enumerate(laws):
        tape = law.tape
        bounds[i + 1] = bounds[i] + (tape.registers, len(tape.operations), len(tape.memory))
        for at, value in (
            *tape.constants,
            *zip(tape.parameters, law.values, strict=True),
            *zip(tape.memory, law.memory, strict=True),
            (_MOBILITY, felt[:, i, seen_of.shape[1] // 2 + law.port, None]),
        ):
            registers[bounds[i, 0] + at] = np.broadcast_to(value, (n_sets, n_runs)).reshape(-1)
    tapes = (
        np.concatenate([law.tape.operations for law in laws]),
        bounds,
        np.array([law.tape.first for law in laws]),
        np.array([m for law in laws for m in law.tape.remembered], dtype=np.int64),
        np.array([m for law in laws for m in law.tape.memory], dtype=np.int64),
    )
    acting = (
        np.array([law.port for law in laws]),
        np.array([-1 if law.coil is None else law.coil for law in laws]),
        inward(push),
        np.ascontiguousarray(felt),
        np.stack([law.direct for law in laws], axis=1),
        np.array([law.tape.force for law in laws]),
    )
    seen = np.ascontiguousarray(starts @ seen_of)
    seen_rows = outward(np.broadcast_to(seen_of, (n_sets, *seen_of.shape)))
    last = np.zeros((len(laws), *seen.shape))
    clock = (h, np.ascontiguousarray(late, dtype=float))
    _march_looped(*common, seen_rows, seen, last, clock, acting, tapes, registers, y)
    return y.transpose(2, 0, 1, 3)


def series(tape: Tape, z: Array, v: Array, t: Array, values: Sequence[Any], memory: Sequence[Any]) -> Array:
    """Return a law's force along given motion, all (n, ...), from what it remembers at first."""
    shape = z.shape[1:]
    registers = np.zeros((tape.registers, int(np.prod(shape))))
    given = (*tape.constants, *zip(tape.parameters, values, strict=True), *zip(tape.memory, memory, strict=True))
    for at, value in given:
        registers[at] = np.broadcast_to(value, shape).reshape(-1)
    signals = np.stack([np.broadcast_to(x, z.shape).reshape(len(z), -1) for x in (z, v, t)], axis=1)
    remembers, recalled = (np.array(some, dtype=np.int64) for some in (tape.remembered, tape.memory))
    out = _series(tape.operations, tape.first, registers, signals, remembers, recalled, tape.force)
    return np.asarray(out.reshape(z.shape))
