"""What a diagnosis reports of a fitted hypothesis."""

from types import SimpleNamespace

import pytest

from vlab.diagnose.findings import unit_at
from vlab.physics.catalogue import EFFECTS
from vlab.signals import Channel


def problem(sensor="m/s", motor="N m", recorded="V"):
    """A problem with one sensor and two actuators: a motor whose force is known, and one that takes bare commands."""
    channels = [
        Channel(name="gyro", kind="velocity", unit=sensor),
        Channel(name="u", kind="command", unit=recorded, is_input=True),
    ]
    measured = SimpleNamespace(channels=channels, names=["gyro", "u"], index=lambda name: ["gyro", "u"].index(name))
    run = SimpleNamespace(
        measured=measured, drives=[SimpleNamespace(channel="u", actuator=1)], compared=[], channels=channels
    )
    taps = [SimpleNamespace(unit=motor), SimpleNamespace(unit="command")]
    return SimpleNamespace(runs=[run], names=("gyro",), plant=SimpleNamespace(actuators=taps))


@pytest.mark.parametrize(
    ("effect", "parameter", "actuator", "unit"),
    [
        ("sensor-quantisation", "step", 0, "m/s"),
        ("sensor-drift", "rate", 0, "m/s^2"),
        ("sensor-delay", "delay", 0, "s"),
        ("sensor-gain", "gain", 0, "1"),
        ("crosstalk", "share", 0, "(m/s)/(N m)"),
        ("crosstalk", "share", 1, "(m/s)/V"),
        ("actuator-offset", "offset", 0, "N m"),
        ("actuator-offset", "offset", 1, "V"),
        ("slew-limit", "slope", 1, "V/s"),
        ("actuator-gain", "gain", 1, "1"),
        ("actuator-hysteresis", "growth", 0, "1/(N m)"),
        ("actuator-hysteresis", "growth", 1, "1/V"),
        ("coulomb-friction", "force", 0, "N m"),
        ("rotary-inertia", "inertia", 0, "kg m^2"),
        ("quadratic-drag", "coefficient", 0, "N m s^2/rad^2"),
    ],
)
def test_a_parameter_has_the_unit_of_its_place(effect, parameter, actuator, unit):
    law = EFFECTS[effect]
    place = SimpleNamespace(index=0, other=actuator, indices=(actuator,), angular=True)
    term = SimpleNamespace(effect=law, place=place)
    assert unit_at(law.parameter(parameter).unit, term, problem()) == unit
