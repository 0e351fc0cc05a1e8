"""Expression graph of a port law, recorded by symbolic evaluation.

A law is written once, with numpy, for arrays of any shape. In a loop over samples numpy's call overhead exceeds the
arithmetic. Searches and simulations therefore evaluate the recorded operations in compiled code, see
`vlab.physics.compiled_expression`. A law that branches on values, or calls a function outside `OPERATIONS`, is evaluated as written.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from vlab.physics.effect import PortEffect, Step
from vlab.signals import Array

OPERATIONS: tuple[Any, ...] = (
    np.positive, np.add, np.subtract, np.multiply, np.divide, np.negative, np.absolute, np.minimum, np.maximum, np.sign,
    np.exp, np.log, np.sqrt, np.sin, np.cos, np.tanh, np.arctan, np.power, np.hypot, np.floor,
    np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal, np.logical_and, np.logical_or, np.logical_not,
    np.where,
)  # fmt: skip
"""Permitted operations; the index is the operation's code."""
CODE: dict[Any, int] = {operation: code for code, operation in enumerate(OPERATIONS)} | {
    np.bitwise_and: OPERATIONS.index(np.logical_and),
    np.bitwise_or: OPERATIONS.index(np.logical_or),
    np.invert: OPERATIONS.index(np.logical_not),
}
"""Code of every permitted numpy function; squares become products."""
SIGNALS = ("z", "v", "t", "free_velocity", "first_velocity", "command", "mobility", "h")
"""Signals of a step in the first registers; parameters and memory follow."""


class Untraceable(TypeError):
    """A law that cannot be recorded."""


@dataclass(frozen=True, eq=False)
class ExpressionGraph:
    """Operations of a law in order of evaluation.

    Each operation reads at most three registers and writes the next free one.

    Parameters
    ----------
    operations : (n, 4) array of int
        Code and operand registers of each operation; operation k writes register `first` + k.
    constants : tuple of (int, float)
        Registers of constants, with their values.
    parameters, memory : tuple of int
        Registers of the law's parameters in class order, and registers of the memory.
    force, remembered : int, tuple of int
        Registers of the force and of the new memory.
    first : int
        Register of the first operation's result.
    """

    operations: Array
    constants: tuple[tuple[int, float], ...]
    parameters: tuple[int, ...]
    memory: tuple[int, ...]
    force: int
    remembered: tuple[int, ...]
    first: int

    @property
    def registers(self) -> int:
        """Number of registers."""
        return self.first + len(self.operations)


class _Writer:
    """Recorder of operations.

    Constants have negative registers until their count is known.
    """

    def __init__(self, inputs: int) -> None:
        self.inputs = inputs
        self.numbers: dict[float, int] = {}
        self.lines: list[tuple[int, int, int, int]] = []

    def register(self, operand: Any) -> int:
        """Return the register of a symbol or number."""
        if isinstance(operand, _Symbol):
            return operand.at
        if not np.isscalar(operand) and np.ndim(operand) != 0:
            raise Untraceable("an array stands in the law")
        return self.numbers.setdefault(float(operand), -1 - len(self.numbers))

    def take(self, code: int, operands: Sequence[Any]) -> "_Symbol":
        """Record an operation and return its symbol."""
        at = [self.register(x) for x in operands]
        self.lines.append((code, *at, *([at[0]] * (3 - len(at)))))  # type: ignore[arg-type]
        return _Symbol(self, self.inputs + len(self.lines) - 1)

    def graph(
        self, parameters: Sequence["_Symbol"], memory: Sequence["_Symbol"], force: Any, remembered: Any
    ) -> ExpressionGraph:
        """Return the expression graph.

        Results have registers of their own, so that new memory overwrites no register still in use.
        """
        results = [self.take(CODE[np.positive], (x,)).at for x in (force, *remembered)]
        count = len(self.numbers)

        def moved(at: int) -> int:  # order of registers: inputs, numbers, results of operations
            return self.inputs - 1 - at if at < 0 else at if at < self.inputs else at + count

        lines = [(code, *(moved(x) for x in at)) for code, *at in self.lines]
        return ExpressionGraph(
            operations=np.array(lines, dtype=np.int64),
            constants=tuple((moved(at), number) for number, at in self.numbers.items()),
            parameters=tuple(s.at for s in parameters),
            memory=tuple(s.at for s in memory),
            force=moved(results[0]),
            remembered=tuple(moved(at) for at in results[1:]),
            first=self.inputs + count,
        )


class _Symbol(NDArrayOperatorsMixin):
    """A symbolic number that records operators and numpy functions."""

    def __init__(self, writer: _Writer, at: int) -> None:
        self.writer, self.at = writer, at

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """Record a numpy function."""
        is_square = ufunc is np.square or (
            ufunc is np.power and not isinstance(inputs[1], _Symbol) and inputs[1] == 2  # numpy squares likewise
        )
        if is_square:
            ufunc, inputs = np.multiply, (inputs[0], inputs[0])
        if method != "__call__" or options or ufunc not in CODE:
            raise Untraceable(f"{ufunc.__name__} is in no expression graph")
        return self.writer.take(CODE[ufunc], inputs)

    def __array_function__(self, function: Any, types: Any, args: Any, options: Any) -> Any:
        """Record a choice."""
        if function is not np.where or len(args) != 3 or options:
            raise Untraceable(f"{function.__name__} is in no expression graph")
        return self.writer.take(CODE[np.where], args)

    def __bool__(self) -> bool:
        raise Untraceable("the law branches on a value; numpy.where does not")


@lru_cache(maxsize=512)
def trace_expression(
    effect: PortEffect,
    h: float | None,
    seen: tuple[str, ...] = SIGNALS,
    numbers: tuple[str, ...] = (),
    damped: float | None = None,
) -> ExpressionGraph | None:
    """Return a law's expression graph.

    Parameters
    ----------
    effect : PortEffect
        Port law.
    h : float or None
        Common length of all steps [s]; None for the length of each step as a signal.
    seen : tuple of str
        Known signals of a step, of `SIGNALS`; every other signal has the default of `Step`.
    numbers : tuple of str
        Values that the law takes beside its parameters; their registers follow those of the parameters.
    damped : float or None
        See `vlab.physics.effect.Step`.

    Returns
    -------
    ExpressionGraph or None
        None if the law cannot be recorded.
    """
    names = [*(p.name for p in effect.parameters), *numbers]
    count = len(effect.memory(()) or ())
    writer = _Writer(len(SIGNALS) + len(names) + count)
    symbols = [_Symbol(writer, at) for at in range(writer.inputs)]
    signals = dict(zip(SIGNALS, symbols, strict=False))
    own = symbols[len(SIGNALS) : len(SIGNALS) + len(names)]
    memory = symbols[len(SIGNALS) + len(names) :]
    known: dict[str, Any] = {name: signals[name] for name in seen if name not in ("z", "v", "h")}
    step = Step(h=signals["h"] if h is None else h, damped=damped, **known)
    force: Callable[..., tuple[Any, Any]] = effect.force
    try:
        result, after = force(
            signals["z"], signals["v"], dict(zip(names, own, strict=True)), step, list(memory) if count else None
        )
        after = list(after) if count else []
        return writer.graph(own, memory, result, after) if len(after) == count else None
    except (TypeError, AttributeError):  # errors of Python and numpy for a symbol in place of a number
        return None
