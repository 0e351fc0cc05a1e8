"""Tapes of laws: what is played from them is what the laws say, and laws that no tape can hold are known."""

import math
from typing import Any, ClassVar

import numpy as np
import pytest

from vlab.diagnose.kernels.expression_graph import series
from vlab.physics.catalogue import EFFECTS
from vlab.physics.compiled_expression import evaluate
from vlab.physics.effect import Parameter, PortEffect, Step
from vlab.physics.expression import CODE, OPERATIONS, trace_expression
from vlab.physics.servo import Servo, ServoEffect, at_servo

SERVO = Servo(gain=2.0, damping=0.3, inertia=0.1, drag=0.2)
_PORTS = [e for e in EFFECTS.values() if isinstance(e, PortEffect)]
PORTS = [at_servo(e, SERVO) if isinstance(e, ServoEffect) else e for e in _PORTS]
ALONG_MOTION = [e for e in PORTS if "coil" not in e.needs and (e.family != "friction" or e.memory(()))]
"""The others need to know more of a step."""
H, N, WIDTH = 0.003, 200, 5
OF_THE_LIBRARY = {np.exp, np.log, np.sin, np.cos, np.tanh, np.arctan, np.power, np.hypot}
"""numpy and compiled code take these functions from different libraries, whose last bits differ."""


class Law(PortEffect):
    name = "own"
    family = "own"
    law = ""
    words = ""
    parameters: ClassVar = (Parameter(name="force", unit="N", low=1e-6, high=1e4),)


class Branching(Law):
    def force(self, z, v, p, step, memory):
        return (p["force"] if v > 0 else -p["force"]), memory


class OfMath(Law):
    def force(self, z, v, p, step, memory):
        return p["force"] * math.sin(z), memory


class Forgetful(Law):
    """Returns one state more than it has."""

    def memory(self, shape):
        return [np.zeros(shape)]

    def force(self, z, v, p, step, memory):
        return p["force"] * z, [z, v]


class Functions(Law):
    """Every operation that a tape may hold."""

    def force(self, z, v, p, step, memory):
        flags = ((z < v) | (z >= 2 * v)) & ~((z <= 0.1) & (v > 0.1)) | (z == v) & (z != v)
        size = np.sqrt(abs(z)) + np.log(1.0 + v**2) + np.hypot(z, v) + np.abs(v) ** 1.5 + np.square(z)
        turn = np.sin(z) - np.cos(v) + np.tanh(z * v) + np.arctan(z) + np.exp(-abs(v)) - np.floor(3 * z)
        return np.where(flags, np.minimum(size, turn), np.maximum(-size, +turn) / (1 + z * z)) * np.sign(
            v
        ) - 2.0, memory


def both(effect: PortEffect) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    z, v = rng.standard_normal((2, N, WIDTH))
    t = np.arange(N)[:, None] * H + np.arange(WIDTH)
    values: dict[str, Any] = {
        p.name: float(np.sqrt(p.low * p.high)) if not p.signed else -0.3 for p in effect.parameters
    }
    graph = trace_expression(effect, H, ("z", "v", "t"))
    assert graph is not None
    memory = effect.memory((WIDTH,))
    evaluated = series(graph, z, v, t, [values[p.name] for p in effect.parameters], memory or ())
    written = np.empty_like(z)
    for k in range(N):
        written[k], memory = effect.force(z[k], v[k], values, Step(h=H, t=t[k]), memory)
    return evaluated, written


@pytest.mark.slow
@pytest.mark.parametrize("effect", ALONG_MOTION, ids=lambda e: e.name)
def test_a_tape_plays_what_the_law_says(effect):
    """To rounding: compiled functions and numpy's differ in the last bit."""
    evaluated, written = both(effect)
    assert np.abs(written).max() > 0
    np.testing.assert_allclose(evaluated, written, rtol=1e-9, atol=1e-12 * np.abs(written).max())


def test_every_operation_plays_as_numpy_has_it():
    evaluated, written = both(Functions())
    np.testing.assert_allclose(evaluated, written, rtol=1e-12)


@pytest.mark.parametrize("width", [1, 2, 7, 64])
@pytest.mark.parametrize("operation", OPERATIONS, ids=lambda f: f.__name__)
def test_an_operation_on_registers_is_that_of_numpy_to_the_last_bit(operation, width):
    """On every pair of ordinary and extreme numbers; functions of the mathematical library to rounding."""
    extreme = [0.0, -0.0, 1.0, -1.0, 2.5, -2.5, 1e-310, 1e200, -1e200, np.inf, -np.inf, np.nan]
    rng = np.random.default_rng(3)
    numbers = np.array([*extreme, *rng.standard_normal(-len(extreme) % width or width)])
    numbers = np.resize(numbers, -(-len(numbers) // width) * width).reshape(-1, width)
    rest = rng.permuted(numbers, axis=0)
    count = operation.nin if isinstance(operation, np.ufunc) else 3
    line = np.array([[CODE[operation], 0, 1, 2]])
    for a, b, c in zip(numbers, rest, rest[::-1], strict=True):
        registers = np.array([a, b, c, np.full(width, 7.0), np.full(width, 8.0)])
        evaluate(line, 3, registers)
        with np.errstate(all="ignore"):
            wanted = np.asarray(operation(*(a, b, c)[:count]) if operation is not np.where else np.where(a != 0, b, c))
        if operation in OF_THE_LIBRARY:
            np.testing.assert_allclose(registers[3], wanted, rtol=1e-15)
        else:
            np.testing.assert_array_equal(_bits(registers[3]), _bits(wanted.astype(float)))
        np.testing.assert_array_equal(_bits(registers[[0, 1, 2, 4]]), _bits(np.array([a, b, c, np.full(width, 8.0)])))


@pytest.mark.parametrize("effect", ALONG_MOTION, ids=lambda e: e.name)
def test_a_graph_on_registers_is_the_plain_evaluation_to_the_last_bit(effect):
    """The plain evaluation takes one operation after another with numpy; the last bit holds without library functions."""
    graph = trace_expression(effect, H, ("z", "v", "t"))
    assert graph is not None
    registers = np.random.default_rng(4).standard_normal((graph.registers, 12))
    for at, value in graph.constants:
        registers[at] = value
    for at in (*graph.parameters, *graph.memory):
        registers[at] = np.abs(registers[at])
    plain = registers.copy()
    with np.errstate(all="ignore"):
        for at, (code, a, b, c) in enumerate(graph.operations):
            operation = OPERATIONS[code]
            operands = (plain[a], plain[b], plain[c])[: 3 if operation is np.where else operation.nin]
            plain[graph.first + at] = (
                operation(*operands) if operation is not np.where else np.where(operands[0] != 0, *operands[1:])
            )
    evaluate(graph.operations, graph.first, registers)
    used = {OPERATIONS[code] for code in graph.operations[:, 0]}
    if used & OF_THE_LIBRARY:
        np.testing.assert_allclose(registers, plain, rtol=1e-12)
    else:
        np.testing.assert_array_equal(_bits(registers), _bits(plain))


def _bits(x: np.ndarray) -> np.ndarray:
    """Return the bits of numbers, with one form of zero (signs of zero differ by library) and of what is no number."""
    return np.where(np.isnan(x), np.nan, x + 0.0).view(np.int64)


@pytest.mark.parametrize("effect", PORTS, ids=lambda e: e.name)
def test_every_law_of_the_catalogue_is_played(effect):
    assert trace_expression(effect, H) is not None


@pytest.mark.parametrize("effect", [Branching(), OfMath(), Forgetful()], ids=lambda e: type(e).__name__)
def test_a_law_that_no_tape_can_hold_is_known(effect):
    assert trace_expression(effect, H) is None
