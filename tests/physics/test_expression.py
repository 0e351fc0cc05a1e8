"""Tapes of laws: what is played from them is what the laws say, and laws that no tape can hold are known."""

import math
from typing import Any, ClassVar

import numpy as np
import pytest

from vlab.diagnose.kernels.expression_graph import series
from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import Parameter, PortEffect, Step
from vlab.physics.expression import trace_expression
from vlab.physics.servo import Servo, ServoEffect, at_servo

SERVO = Servo(gain=2.0, damping=0.3)
_PORTS = [e for e in EFFECTS.values() if isinstance(e, PortEffect)]
PORTS = [at_servo(e, SERVO) if isinstance(e, ServoEffect) else e for e in _PORTS]
ALONG_MOTION = [e for e in PORTS if "coil" not in e.needs and (e.family != "friction" or e.memory(()))]
"""The others need to know more of a step."""
H, N, WIDTH = 0.003, 200, 5


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


@pytest.mark.parametrize("effect", ALONG_MOTION, ids=lambda e: e.name)
def test_a_tape_plays_what_the_law_says(effect):
    """To rounding: compiled functions and numpy's differ in the last bit."""
    evaluated, written = both(effect)
    assert np.abs(written).max() > 0
    np.testing.assert_allclose(evaluated, written, rtol=1e-9, atol=1e-12 * np.abs(written).max())


def test_every_operation_plays_as_numpy_has_it():
    evaluated, written = both(Functions())
    np.testing.assert_allclose(evaluated, written, rtol=1e-12)


@pytest.mark.parametrize("effect", PORTS, ids=lambda e: e.name)
def test_every_law_of_the_catalogue_is_played(effect):
    assert trace_expression(effect, H) is not None


@pytest.mark.parametrize("effect", [Branching(), OfMath(), Forgetful()], ids=lambda e: type(e).__name__)
def test_a_law_that_no_tape_can_hold_is_known(effect):
    assert trace_expression(effect, H) is None
