"""Units: definitions, and refusals."""

import pytest

from vlab import units
from vlab.errors import BadUnit


@pytest.mark.parametrize(
    ("unit", "si", "expected"),
    [
        ("in", "m", 0.0254),  # exact by definition
        ("lb", "kg", 0.45359237),  # exact by definition
        ("lbf", "N", 0.45359237 * 9.80665),  # exact by definition
        ("lbf s/in", "N s/m", 0.45359237 * 9.80665 / 0.0254),
        ("lbf s^2/in", "kg", 0.45359237 * 9.80665 / 0.0254),
        ("g", "m/s^2", 9.80665),  # an acceleration
        ("g", "kg", 1e-3),  # a mass
        ("g/N", "(m/s^2)/N", 9.80665),  # standard gravity, CGPM 1901
        ("mV/g", "V/(m/s^2)", 1e-3 / 9.80665),
        ("g/N", "kg/N", 1e-3),
        ("V/degC", "V/K", 1.0),  # a difference of temperatures has no offset
        ("deg", "rad", 3.141592653589793 / 180),
        ("mm", "m", 1e-3),
        ("%", "1", 0.01),
        ("mg", "m/s^2", 9.80665e-3),  # an accelerometer's
        ("mg", "kg", 1e-6),
        ("Nm", "N m", 1.0),
        ("kNm", "N m", 1e3),
        ("Ncm", "N m", 0.01),
        ("in-lb", "N m", 0.45359237 * 9.80665 * 0.0254),
        ("ft-lb", "N m", 0.45359237 * 9.80665 * 0.3048),
        ("m/s2", "m/s^2", 1.0),
        ("mm/s²", "m/s^2", 1e-3),
        ("°/s", "rad/s", 3.141592653589793 / 180),
        ("dps", "rad/s", 3.141592653589793 / 180),
        ("ips", "m/s", 0.0254),
        ("mil", "m", 25.4e-6),
        ("kp", "N", 9.80665),
        ("Volt", "V", 1.0),
        *(
            (unit, "rad/s", 2 * 3.141592653589793 / 60)
            for unit in ("rpm", "RPM", "1/min", "min^-1", "U/min", "rev/min")
        ),
        *((unit, "rad/s", 2 * 3.141592653589793) for unit in ("Hz", "rev/s", "cps")),
        ("rev", "rad", 2 * 3.141592653589793),
        ("rad/s", "Hz", 0.5 / 3.141592653589793),
        ("rpm", "Hz", 1 / 60),
        ("kHz", "Hz", 1e3),
        ("s^-1", "Hz", 1.0),
    ],
)
def test_factors_are_those_of_the_definitions(unit, si, expected):
    assert units.factor(unit, si) == pytest.approx(expected, rel=1e-14)


def test_conversion_there_and_back_is_the_identity():
    assert units.from_si(units.to_si(3.7, "lbf s/in", "N s/m"), "lbf s/in", "N s/m") == pytest.approx(3.7, rel=1e-15)


@pytest.mark.parametrize(
    "unit",
    [
        "furlongs per fortnight",
        "m**",
        "__import__('os')",
        "in;rm",
        "x" * 100,
        "degC",
        "[length]",
        "9**9**9",
        "9^9^9^9",
        "m^(9^9^9)",
        "((((9)^99)^99)^99)^99",
        "s^99999999",
    ],
)
def test_what_is_no_unit_is_refused(unit):
    with pytest.raises(BadUnit):
        units.factor(unit, "m")


@pytest.mark.parametrize("unit", ["degC", "degF"])
def test_units_with_an_offset_have_no_factor(unit):
    with pytest.raises(BadUnit, match="has an offset"):
        units.factor(unit, "K")


@pytest.mark.parametrize(("unit", "si"), [("counts", "rad"), ("1/s", "rad/s"), ("counts/s", "rad/s")])
def test_an_angle_says_what_is_counted(unit, si):
    with pytest.raises(BadUnit, match="does not say what is counted"):
        units.factor(unit, si)


def test_wrong_dimension_names_both():
    with pytest.raises(BadUnit, match="'lbf' cannot be converted to 'm'"):
        units.factor("lbf", "m")


def test_powers_of_an_expression_are_units():
    assert units.factor("(mm/s^2)^2/Hz", "(m/s^2)^2/Hz") == pytest.approx(1e-6, rel=1e-14)
    assert units.factor("m/s^(1/2)", "m/s^0.5") == 1.0
    assert units.factor("mm^-1", "1/m") == pytest.approx(1e3, rel=1e-14)


@pytest.mark.parametrize("broken", ["UnitRegistry", "parse_units"])
def test_a_broken_library_is_not_called_a_wrong_unit(monkeypatch, broken):
    pint = pytest.importorskip("pint")

    def fail(*words: object) -> None:
        raise TypeError("cannot inherit frozen dataclass from a non-frozen one")

    monkeypatch.setattr(pint if broken == "UnitRegistry" else pint.UnitRegistry, broken, fail)
    for cached in (units._registry, units._parse):
        cached.cache_clear()
    with pytest.raises(ImportError, match=r"pint .* fails on this installation .TypeError: cannot inherit"):
        units.factor("mm", "m")
    monkeypatch.undo()
    assert units.factor("mm", "m") == 1e-3


@pytest.mark.parametrize(("unit", "hint"), [("degg", "did you mean 'deg'"), ("wombat", "'deg'"), ("N mmm", "'N mm'")])
def test_an_unknown_unit_has_a_hint(unit, hint):
    with pytest.raises(BadUnit, match=f"unknown unit .*{hint}"):
        units.factor(unit, "m")
