"""Tabulated force against its nodes, and against laws that it can represent."""

import numpy as np
import pytest

from vlab.physics.catalogue import CANDIDATES, EFFECTS, LAST_RESORT
from vlab.physics.effect import Step
from vlab.physics.tabulated import NODES, TabulatedForce

LAW = TabulatedForce()
STEP = Step(h=1e-3)


def values(**some: float) -> dict[str, float]:
    return {"reach": 0.02, "speed": 0.5, **{p.name: 0.0 for p in LAW.amplitudes}, **some}


def table_of(signal: str, force, reach: float) -> dict[str, float]:
    """Return the increments that interpolate an opposing force between the nodes."""
    steps = np.diff([[force(side * reach * node) for node in NODES] for side in (1.0, -1.0)], axis=1)
    return {
        f"{signal}_{side}_{k}": sign * step
        for (side, sign), row in zip((("positive", 1.0), ("negative", -1.0)), steps, strict=True)
        for k, step in enumerate(row, start=1)
    }


@pytest.mark.parametrize("signal", ["displacement", "velocity"])
def test_the_force_passes_through_its_nodes_and_is_linear_between(signal):
    def hardening(x):
        return 3.0 * x + 2.0 * x**2 + 40.0 * x**3

    reach = {"displacement": 0.02, "velocity": 0.5}[signal]
    p = values(**table_of(signal, hardening, reach))
    at = reach * np.array([*[-n for n in NODES[::-1]], *NODES[1:]])
    x = np.linspace(-2.0 * reach, 2.0 * reach, 401)
    z, v = (x, 0.0 * x) if signal == "displacement" else (0.0 * x, x)
    force, memory = LAW.force(z, v, p, STEP, None)
    np.testing.assert_allclose(-force, np.interp(x, at, hardening(at)), rtol=0, atol=1e-12)  # constant beyond the ends
    assert memory is None


def test_no_increments_no_force():
    force, _ = LAW.force(np.linspace(-1, 1, 9), np.linspace(1, -1, 9), values(), STEP, None)
    assert not force.any()


def test_a_damping_table_only_dissipates():
    """Increments of one sign oppose the velocity, so the power is never positive."""
    p = values(**table_of("velocity", lambda v: 0.3 * np.sign(v) * min(abs(v) / 0.05, 1.0), 0.5))
    t = np.linspace(0.0, 20.0, 20_001)
    v = 0.4 * np.sin(3.0 * t)
    force, _ = LAW.force(0.0 * v, v, p, STEP, None)
    assert (force * v <= 1e-15).all()
    assert np.mean(force * v) == pytest.approx(-0.3 * 0.4 * 2 / np.pi, rel=0.02)  # of Coulomb friction


def test_the_law_is_tried_last():
    assert (EFFECTS["unknown-law"],) == LAST_RESORT
    assert EFFECTS["unknown-law"] not in CANDIDATES
    asked = [name for name, effect in EFFECTS.items() if effect.is_on_request]
    assert asked == ["cogging"]
    assert len(CANDIDATES) == len(EFFECTS) - 1 - len(asked)
