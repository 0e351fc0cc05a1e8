"""A port's law as a tape of operations on numbers, found by letting the law act on symbols.

A law is written once, with numpy, for arrays of any shape. In a loop over samples most of its time goes into calling numpy, not into
arithmetic, so the search plays the law's operations from a tape in compiled code instead; see `vlab.diagnose.kernels.expression_graph`. Laws that
cannot be taken down, for they branch on values or call what is not listed here, are evaluated as they are written.
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
"""What a tape may hold; an operation's code is its index."""
CODE: dict[Any, int] = {operation: code for code, operation in enumerate(OPERATIONS)} | {
    np.bitwise_and: OPERATIONS.index(np.logical_and),
    np.bitwise_or: OPERATIONS.index(np.logical_or),
    np.invert: OPERATIONS.index(np.logical_not),
}
"""Codes of all that a law may call, but for squares, which are products."""
SIGNALS = ("z", "v", "t", "free_velocity", "first_velocity", "command", "mobility")
"""What a law sees of its step, in the first registers; parameters and memory come next."""


class Untraceable(TypeError):
    """A law does what no tape can hold."""


@dataclass(frozen=True, eq=False)
class ExpressionGraph:
    """A law's operations in their order, each from at most three registers into the next free one.

    Parameters
    ----------
    operations : (n, 4) array of int
        Code and operands of each; its result goes to register `first` + its number.
    constants : tuple of (int, float)
        Registers that hold a number.
    parameters, memory : tuple of int
        Registers of the law's parameters in the order of its class, and of what it remembers.
    force, remembered : int, tuple of int
        Registers of the results.
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
        """How many registers it takes."""
        return self.first + len(self.operations)


class _Writer:
    """Takes operations down; numbers get registers below zero until their count is known."""

    def __init__(self, inputs: int) -> None:
        self.inputs = inputs
        self.numbers: dict[float, int] = {}
        self.lines: list[tuple[int, int, int, int]] = []

    def register(self, operand: Any) -> int:
        """Return the register of a symbol, or of a number."""
        if isinstance(operand, _Symbol):
            return operand.at
        if not np.isscalar(operand) and np.ndim(operand) != 0:
            raise Untraceable("an array stands in the law")
        return self.numbers.setdefault(float(operand), -1 - len(self.numbers))

    def take(self, code: int, operands: Sequence[Any]) -> "_Symbol":
        """Take an operation down and return the symbol of its result."""
        at = [self.register(x) for x in operands]
        self.lines.append((code, *at, *([at[0]] * (3 - len(at)))))  # type: ignore[arg-type]
        return _Symbol(self, self.inputs + len(self.lines) - 1)

    def graph(
        self, parameters: Sequence["_Symbol"], memory: Sequence["_Symbol"], force: Any, remembered: Any
    ) -> ExpressionGraph:
        """Return the tape; results stand in registers of their own, so that what is remembered overwrites nothing still read."""
        results = [self.take(CODE[np.positive], (x,)).at for x in (force, *remembered)]
        count = len(self.numbers)

        def moved(at: int) -> int:  # inputs, then numbers, then results of operations
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
    """A number that is not known yet: operators and numpy's functions on it are taken down."""

    def __init__(self, writer: _Writer, at: int) -> None:
        self.writer, self.at = writer, at

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """Take a function of numpy down."""
        is_square = ufunc is np.square or (
            ufunc is np.power and not isinstance(inputs[1], _Symbol) and inputs[1] == 2  # as numpy does
        )
        if is_square:
            ufunc, inputs = np.multiply, (inputs[0], inputs[0])
        if method != "__call__" or options or ufunc not in CODE:
            raise Untraceable(f"{ufunc.__name__} is on no tape")
        return self.writer.take(CODE[ufunc], inputs)

    def __array_function__(self, function: Any, types: Any, args: Any, options: Any) -> Any:
        """Take a choice down."""
        if function is not np.where or len(args) != 3 or options:
            raise Untraceable(f"{function.__name__} is on no tape")
        return self.writer.take(CODE[np.where], args)

    def __bool__(self) -> bool:
        raise Untraceable("the law branches on a value; numpy.where does not")


@lru_cache(maxsize=512)
def trace_expression(effect: PortEffect, h: float, seen: tuple[str, ...] = SIGNALS) -> ExpressionGraph | None:
    """Return a law's tape for steps of one length; None where it cannot be taken down.

    Parameters
    ----------
    seen : tuple of str
        What is known of a step, of `SIGNALS`; the rest is as `Step` has it by default.
    """
    names = [p.name for p in effect.parameters]
    count = len(effect.memory(()) or ())
    writer = _Writer(len(SIGNALS) + len(names) + count)
    symbols = [_Symbol(writer, at) for at in range(writer.inputs)]
    signals = dict(zip(SIGNALS, symbols, strict=False))
    own = symbols[len(SIGNALS) : len(SIGNALS) + len(names)]
    memory = symbols[len(SIGNALS) + len(names) :]
    step = Step(h=h, **{name: signals[name] for name in seen if name not in ("z", "v")})
    force: Callable[..., tuple[Any, Any]] = effect.force
    try:
        result, after = force(
            signals["z"], signals["v"], dict(zip(names, own, strict=True)), step, list(memory) if count else None
        )
        after = list(after) if count else []
        return writer.graph(own, memory, result, after) if len(after) == count else None
    except (TypeError, AttributeError):  # what python and numpy say of a symbol where they want a number
        return None
