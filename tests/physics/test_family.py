"""Families of effects: one home of what laws of a kind have in common, open to a user's own."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from vlab.cli import main
from vlab.diagnose.parameters.locations import admissible
from vlab.physics.catalogue import EFFECTS, effect_named
from vlab.physics.effect import ActuatorEffect, LinearPortEffect, PickUp, PortEffect, SensorEffect
from vlab.physics.family import FAMILIES, Family, register_family, separating_measurement
from vlab.physics.servo import ServoEffect

EXAMPLES = Path(__file__).parents[2] / "assets" / "examples"

TOY = """
from typing import ClassVar
from vlab.physics.effect import ActuatorEffect, Parameter
from vlab.physics.family import Family

class Toy(ActuatorEffect):
    name = "toy-loss"
    family = Family(
        name="toy", is_shared=True, hardware="coil", accompanied_by="viscous-damping", related=frozenset({"gain"}),
        tested_by="a toy measurement", separated_by={"gain": "a measurement between"},
    )
    law = "F = u (1 - g)"
    words = "a toy"
    parameters: ClassVar = (Parameter(name="g", unit="1", low=0.01, high=0.9),)

    def actuate(self, u, p, h):
        return u * (1.0 - p["g"])
"""


@pytest.fixture
def toy(tmp_path):
    path = tmp_path / "toy.py"
    path.write_text(TOY)
    yield f"{path}:Toy"
    FAMILIES.pop("toy", None)


def test_every_effect_of_the_catalogue_has_a_listed_family():
    assert {e.family for e in EFFECTS.values()} == set(FAMILIES)


def test_families_refer_to_families_and_effects_that_exist():
    for family in FAMILIES.values():
        assert {*family.related, *family.separated_by} <= set(FAMILIES)
        assert not family.accompanied_by or family.accompanied_by in EFFECTS
        assert family.tested_by


def test_dry_friction_is_nonsmooth_slip():
    for family in FAMILIES.values():
        assert not family.is_dry_friction or (family.is_nonsmooth and family.is_slip)


def test_a_measurement_separates_families_in_any_order():
    for one, other in combinations(FAMILIES, 2):
        assert separating_measurement([one, other]) == separating_measurement([other, one])
    assert "quasi-static sweep" in separating_measurement(["hysteresis", "friction"])
    assert "known mass moved" in separating_measurement(["mass"])
    assert not separating_measurement(["friction"])


def test_a_users_family_is_one_file(toy, capsys):
    effect = effect_named(toy)
    assert effect.family == "toy"
    assert FAMILIES["toy"] is effect.traits
    assert separating_measurement(["gain", "toy"]) == "a measurement between"
    assert main(["effects", toy]) == 0
    assert "toy-loss  [toy]" in capsys.readouterr().out
    assert effect_named(toy).traits == effect.traits  # the file may be read again


def test_a_family_of_a_known_name_must_have_its_traits():
    with pytest.raises(ValueError, match="has other traits already"):
        register_family(Family(name="friction"))
    register_family(FAMILIES["friction"])


def test_traits_of_an_unlisted_family_are_the_plain_ones():
    brake = effect_named(f"{EXAMPLES}/magnetic_brake.py:MagneticBrake")
    assert brake.traits == Family(name="eddy-currents")


def test_needs_of_a_place_follow_the_family(toy):
    from types import SimpleNamespace

    shared = SimpleNamespace(kind="actuator", also=(1,), index=0)
    assert admissible(effect_named(toy), shared)
    assert not admissible(EFFECTS["actuator-offset"], shared)


KINDS = {"port": (PortEffect, LinearPortEffect), "actuator": ActuatorEffect, "sensor": SensorEffect}


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_traits_agree_with_the_class_of_an_effect(effect):
    assert isinstance(effect, KINDS[effect.kind])
    assert effect.is_linear == isinstance(effect, LinearPortEffect)
    assert effect.is_force == isinstance(effect, PortEffect)
    assert effect.picks_up == isinstance(effect, PickUp)
    assert effect.is_in_servo == isinstance(effect, ServoEffect)
    assert effect.is_linear or all(hasattr(effect, name) for name in effect.simulated_by)
    assert effect.is_in_servo or not effect.numbers


def test_a_channel_effect_transfers_a_signal_as_its_law_does():
    t = 0.01 * np.arange(50)
    u = np.sin(7.0 * t)
    clipping, drift = EFFECTS["actuator-clipping"], EFFECTS["sensor-drift"]
    assert np.array_equal(clipping.transfer(u, {"limit": 0.3}, 0.01, t), clipping.actuate(u, {"limit": 0.3}, 0.01))
    p = {q.name: 0.2 for q in drift.parameters}
    assert np.array_equal(drift.transfer(u, p, 0.01, t), drift.sense(u, p, 0.01, t))


def test_a_delay_of_sensor_or_actuator_is_told_by_a_second_sensor():
    assert "second sensor" in separating_measurement({"timing"}, is_of_both_ends=True)
    assert "first-order lag" in separating_measurement({"timing"})
