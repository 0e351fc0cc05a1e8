"""Expression graphs of laws, evaluated in compiled code."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from vlab.compilation import compiled
from vlab.physics.expression import CODE, SIGNALS, ExpressionGraph
from vlab.signals import Array

_COPY, _ADD, _SUBTRACT, _MULTIPLY = (CODE[f] for f in (np.positive, np.add, np.subtract, np.multiply))
_DIVIDE, _NEGATIVE, _ABSOLUTE = (CODE[f] for f in (np.divide, np.negative, np.absolute))
_MINIMUM, _MAXIMUM, _SIGN = (CODE[f] for f in (np.minimum, np.maximum, np.sign))
_EXP, _LOG, _SQRT, _SIN, _COS, _TANH = (CODE[f] for f in (np.exp, np.log, np.sqrt, np.sin, np.cos, np.tanh))
_ARCTAN, _POWER, _HYPOT, _FLOOR = (CODE[f] for f in (np.arctan, np.power, np.hypot, np.floor))
_LESS, _LESS_EQUAL, _GREATER, _GREATER_EQUAL = (CODE[f] for f in (np.less, np.less_equal, np.greater, np.greater_equal))
_EQUAL, _NOT_EQUAL, _AND, _OR = (CODE[f] for f in (np.equal, np.not_equal, np.logical_and, np.logical_or))
_NOT, _WHERE = CODE[np.logical_not], CODE[np.where]
AT_Z, AT_V, AT_T, AT_FREE, AT_FIRST, AT_COMMAND, AT_MOBILITY, AT_H = range(len(SIGNALS))
"""Registers of a law's signals: displacement, velocity, time, free and first velocity, command, mobility, length
of the step."""


@compiled(error_model="numpy")
def evaluate(operations: Array, first: int, registers: Array) -> None:  # pragma: no cover - compiled
    """Evaluate an expression graph on registers, in place.

    Parameters
    ----------
    operations : (n_operations, 4) array of int
        Code and three operand registers of every operation.
    first : int
        Register of the first result.
    registers : (n_registers, n) array
        Values of n parallel evaluations.
    """
    n = registers.shape[1]
    for line in range(operations.shape[0]):
        code = operations[line, 0]
        a, b, c, out = operations[line, 1], operations[line, 2], operations[line, 3], first + line
        if code == _ADD:
            for e in range(n):
                registers[out, e] = registers[a, e] + registers[b, e]
        elif code == _SUBTRACT:
            for e in range(n):
                registers[out, e] = registers[a, e] - registers[b, e]
        elif code == _MULTIPLY:
            for e in range(n):
                registers[out, e] = registers[a, e] * registers[b, e]
        elif code == _DIVIDE:
            for e in range(n):
                registers[out, e] = registers[a, e] / registers[b, e]
        elif code == _NEGATIVE:
            for e in range(n):
                registers[out, e] = -registers[a, e]
        elif code == _COPY:
            for e in range(n):
                registers[out, e] = registers[a, e]
        elif code == _ABSOLUTE:
            for e in range(n):
                registers[out, e] = abs(registers[a, e])
        elif code == _MINIMUM:
            for e in range(n):
                registers[out, e] = np.minimum(registers[a, e], registers[b, e])
        elif code == _MAXIMUM:
            for e in range(n):
                registers[out, e] = np.maximum(registers[a, e], registers[b, e])
        elif code == _WHERE:
            for e in range(n):
                registers[out, e] = registers[b, e] if registers[a, e] != 0.0 else registers[c, e]
        elif code == _SIGN:
            for e in range(n):
                registers[out, e] = np.sign(registers[a, e])
        elif code == _LESS:
            for e in range(n):
                registers[out, e] = 1.0 if registers[a, e] < registers[b, e] else 0.0
        elif code == _LESS_EQUAL:
            for e in range(n):
                registers[out, e] = 1.0 if registers[a, e] <= registers[b, e] else 0.0
        elif code == _GREATER:
            for e in range(n):
                registers[out, e] = 1.0 if registers[a, e] > registers[b, e] else 0.0
        elif code == _GREATER_EQUAL:
            for e in range(n):
                registers[out, e] = 1.0 if registers[a, e] >= registers[b, e] else 0.0
        elif code == _EQUAL:
            for e in range(n):
                registers[out, e] = 1.0 if registers[a, e] == registers[b, e] else 0.0
        elif code == _NOT_EQUAL:
            for e in range(n):
                registers[out, e] = 1.0 if registers[a, e] != registers[b, e] else 0.0
        elif code == _AND:
            for e in range(n):
                registers[out, e] = 1.0 if registers[a, e] != 0.0 and registers[b, e] != 0.0 else 0.0
        elif code == _OR:
            for e in range(n):
                registers[out, e] = 1.0 if registers[a, e] != 0.0 or registers[b, e] != 0.0 else 0.0
        elif code == _NOT:
            for e in range(n):
                registers[out, e] = 1.0 if registers[a, e] == 0.0 else 0.0
        else:
            _evaluate_slowly(code, a, b, out, registers)


@compiled(error_model="numpy")
def _evaluate_slowly(code: int, a: int, b: int, out: int, registers: Array) -> None:  # pragma: no cover - compiled
    """Evaluate a transcendental operation, element by element."""
    for e in range(registers.shape[1]):
        x = registers[a, e]
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
            y = x ** registers[b, e]
        else:
            y = np.hypot(x, registers[b, e])
        registers[out, e] = y


ExpressionGraphs = tuple[Array, Array, Array, Array, Array]
"""Operations of all laws; bounds (n + 1, 3) of each law's registers, operations and memory; first result registers;
registers of the memory after a step; registers of the memory before a step."""


def loaded(
    graphs: Sequence[ExpressionGraph],
    values: Sequence[Sequence[Any]],
    memories: Sequence[Sequence[Any]],
    shape: tuple[int, ...],
) -> tuple[ExpressionGraphs, Array]:
    """Concatenate expression graphs and fill their constant registers.

    Parameters
    ----------
    graphs : sequence of ExpressionGraph
        Graph of every law.
    values : sequence of sequence of array
        Parameters of every law in the order of its class, broadcastable to `shape`.
    memories : sequence of sequence of array
        Initial memory of every law.
    shape : tuple of int
        Batch of parameter sets and runs.

    Returns
    -------
    graphs : ExpressionGraphs
        Concatenated graphs.
    registers : (n_registers, prod(shape)) array
        Registers with constants, parameters and initial memory.
    """
    registers = np.zeros((sum(graph.registers for graph in graphs), int(np.prod(shape))))
    bounds = np.zeros((len(graphs) + 1, 3), dtype=np.int64)
    for i, (graph, own, memory) in enumerate(zip(graphs, values, memories, strict=True)):
        bounds[i + 1] = bounds[i] + (graph.registers, len(graph.operations), len(graph.memory))
        given = (*graph.constants, *zip(graph.parameters, own, strict=True), *zip(graph.memory, memory, strict=True))
        for at, value in given:
            registers[bounds[i, 0] + at] = np.broadcast_to(value, shape).reshape(-1)
    found = (
        np.concatenate([np.zeros((0, 4), dtype=np.int64), *(graph.operations for graph in graphs)]),
        bounds,
        np.array([graph.first for graph in graphs], dtype=np.int64),
        np.array([m for graph in graphs for m in graph.remembered], dtype=np.int64),
        np.array([m for graph in graphs for m in graph.memory], dtype=np.int64),
    )
    return found, registers
