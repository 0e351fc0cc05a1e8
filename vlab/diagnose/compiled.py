"""The loops over samples in which laws act, compiled: laws as tapes of operations, many parameter sets and recordings side by side."""

from collections.abc import Sequence
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

_COPY, _ADD, _SUBTRACT, _MULTIPLY = (CODE[f] for f in (np.positive, np.add, np.subtract, np.multiply))
_DIVIDE, _NEGATIVE, _ABSOLUTE = (CODE[f] for f in (np.divide, np.negative, np.absolute))
_MINIMUM, _MAXIMUM, _SIGN = (CODE[f] for f in (np.minimum, np.maximum, np.sign))
_EXP, _LOG, _SQRT, _SIN, _COS, _TANH = (CODE[f] for f in (np.exp, np.log, np.sqrt, np.sin, np.cos, np.tanh))
_ARCTAN, _POWER, _HYPOT, _FLOOR = (CODE[f] for f in (np.arctan, np.power, np.hypot, np.floor))
_LESS, _LESS_EQUAL, _GREATER, _GREATER_EQUAL = (
    CODE[f] for f in (np.less, np.less_equal, np.greater, np.greater_equal)
)
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


@njit(cache=True, error_model="numpy")
def _march(
    step_of: Array,
    seen_of: Array,
    drives: Array,
    part: Array,
    state: Array,
    last: Array,
    clock: tuple[int, int, float, Array],
    laws: tuple[Array, Array, Array, Array, Array],
    tapes: tuple[Array, Array, Array, Array, Array],
    registers: Array,
    states: Array,
    forces: Array,
) -> None:  # pragma: no cover - compiled
    """March the state through the samples of a chunk and fill in states and forces at the samples; see `Loop`."""
    first, substeps, h, late = clock
    ports, coils, push, felt, results = laws
    operations, bounds, firsts, remembers, recalled = tapes
    n, n_sets, n_runs, width = states.shape
    size, seen, n_laws = state.shape[2], seen_of.shape[1], len(ports)
    new, known = np.empty_like(state), np.empty((n_sets, n_runs, seen))
    for k in range(n):
        states[k] = state[:, :, :width]
        for sub in range(substeps):
            for s in range(n_sets):
                for r in range(n_runs):
                    new[s, r] = drives[sub % len(drives), k, s, r]
                    for i in range(width):
                        x = state[s, r, i]
                        for j in range(size):
                            new[s, r, j] += x * step_of[s, i, j]
            known[:] = 0.0
            for law in range(n_laws):  # forces change by little in a step: the last ones stand for those not known yet
                known += last[law]
            for law in range(n_laws):
                z, v, coil = ports[law], seen // 2 + ports[law], coils[law]
                own = registers[bounds[law, 0] : bounds[law + 1, 0]]
                for s in range(n_sets):
                    for r in range(n_runs):
                        e, at, after = s * n_runs + r, state[s, r, width:], new[s, r, width:]
                        own[_Z, e] = 0.5 * (at[z] + (after[z] + known[s, r, z]))
                        own[_V, e] = 0.5 * (at[v] + (after[v] + known[s, r, v]))
                        own[_T, e] = late[r] + ((first + k) * substeps + sub + 0.5) * h
                        own[_FREE, e], own[_FIRST, e] = after[v], at[v]
                        own[_COMMAND, e] = part[k, s % part.shape[1], r, coil] if coil >= 0 else 0.0
                _play(operations[bounds[law, 1] : bounds[law + 1, 1]], firsts[law], own)
                for m in range(bounds[law, 2], bounds[law + 1, 2]):
                    own[recalled[m]] = own[remembers[m]]
                for s in range(n_sets):
                    for r in range(n_runs):
                        force = own[results[law], s * n_runs + r]
                        if sub == 0:
                            forces[k, s, r, law] = force
                        for j in range(seen):
                            known[s, r, j] -= last[law, s, r, j]
                            last[law, s, r, j] = force * felt[law, s, j]
                            new[s, r, width + j] += last[law, s, r, j]
                        for j in range(width):
                            new[s, r, j] += force * push[law, s, j]
            state[:] = new
        if k % CHECKED == 0 and not np.abs(state[:, :, :width]).max() < RUNAWAY:
            _contain(state, seen_of)
            last[:] = 0.0


@njit(cache=True, error_model="numpy")
def _contain(state: Array, seen_of: Array) -> None:  # pragma: no cover - compiled
    """Bring states that ran away back to large numbers."""
    width, seen = seen_of.shape
    for s in range(state.shape[0]):
        for r in range(state.shape[1]):
            state[s, r, width:] = 0.0
            for i in range(width):
                x = state[s, r, i]
                x = MOST if np.isnan(x) else min(max(x, -MOST), MOST)
                state[s, r, i] = x
                for j in range(seen):
                    state[s, r, width + j] += x * seen_of[i, j]


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


class Loop:
    """Laws in the loop of a march, all of which can be played from tapes.

    Parameters
    ----------
    tapes : sequence of Tape
        One a law, for the length of a substep.
    values : sequence of sequences of (n_sets, 1) array
        Parameters of every law, in the order of its class.
    memories : sequence of sequences of array
        What every law remembers at first, each (n_sets, n_runs) or less.
    push, felt : (n_laws, n_sets, width) and (n_laws, n_sets, 2 n_ports) array
        What a unit force over a substep adds to the states, and to what the ports see: displacements, then velocities.
    ports, coils : sequence of int
        Which port of these each law acts at, and which of the known inputs is the command there, -1 for none.
    late : (n_runs,) array
        Times at which the runs begin [s].
    """

    def __init__(
        self,
        tapes: Sequence[Tape],
        values: Sequence[Sequence[Array]],
        memories: Sequence[Sequence[Any]],
        push: Array,
        felt: Array,
        ports: Sequence[int],
        coils: Sequence[int],
        late: Array,
    ) -> None:
        n_sets, n_runs, n_laws = push.shape[1], len(late), len(tapes)
        self.registers = np.zeros((sum(t.registers for t in tapes), n_sets * n_runs))
        bounds = np.zeros((n_laws + 1, 3), dtype=np.int64)
        for i, (tape, own, memory) in enumerate(zip(tapes, values, memories, strict=True)):
            base = bounds[i, 0]
            bounds[i + 1] = bounds[i] + (tape.registers, len(tape.operations), len(tape.memory))
            for at, value in (
                *tape.constants,
                *zip(tape.parameters, own, strict=True),
                *zip(tape.memory, memory, strict=True),
                (_MOBILITY, felt[i, :, felt.shape[2] // 2 + ports[i]][:, None]),
            ):
                self.registers[base + at] = np.broadcast_to(value, (n_sets, n_runs)).reshape(-1)
        self.tapes = (
            np.concatenate([t.operations for t in tapes]),
            bounds,
            np.array([t.first for t in tapes]),
            np.array([m for t in tapes for m in t.remembered], dtype=np.int64),
            np.array([m for t in tapes for m in t.memory], dtype=np.int64),
        )
        self.laws = (
            np.array(ports),
            np.array(coils),
            np.ascontiguousarray(push),
            np.ascontiguousarray(felt),
            np.array([t.force for t in tapes]),
        )
        self.late = late
        self.last = np.zeros((n_laws, n_sets, n_runs, felt.shape[2]))

    def through(
        self, step_of: Array, seen: Array, drives: Array, part: Array, x: Array, first: int, h: float, substeps: int
    ) -> tuple[Array, Array, Array]:
        """Return the states at the samples of a chunk, the forces of the laws there, and the states at its end.

        Parameters
        ----------
        step_of : (n_sets, width, width + seen) array
            What a substep makes of the states, and of what the ports see then.
        seen : (width, seen) array
            What the ports see of the states.
        drives : (1 or substeps, n, n_sets, n_runs, width + seen) array
            What is added in a substep.
        part : (n, n_sets or 1, n_runs, known) array
            Known inputs.
        x : (n_sets, n_runs, width) array
            States at the beginning.
        first : int
            The chunk's first sample.
        h : float
            Length of a substep [s].
        """
        states, forces = np.empty((len(part), *x.shape)), np.empty((len(part), *x.shape[:2], len(self.last)))
        state = np.concatenate([x, x @ seen], axis=-1)
        clock = (first, substeps, h, self.late)
        _march(
            np.ascontiguousarray(step_of), np.ascontiguousarray(seen), drives, np.ascontiguousarray(part), state, self.last,
            clock, self.laws, self.tapes, self.registers, states, forces,
        )  # fmt: skip
        return states, forces, state[..., : x.shape[-1]].copy()


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
