"""Structure files: every number has unit and origin, and nothing wrong passes."""

import re

import pytest

from vlab.errors import BadStructure, UnknownName, VlabError
from vlab.files.assets import asset
from vlab.structure import load_structure, locate

TEXT = asset("beam.toml").read_text(encoding="utf-8")


def altered(tmp_path, pattern: str, replacement: str):
    text, count = re.subn(pattern, replacement, TEXT, count=1)
    assert count == 1, "the test does not alter what it means to"
    path = tmp_path / "altered.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_number_states_unit_origin_and_source(beam):
    assert len(beam.provenance) > 50
    for path, where in beam.provenance.items():
        assert where.origin in ("published", "identified", "assumed"), path
        assert where.source, path
        assert where.unit, path


def test_published_values_are_those_of_the_dissertation(beam):
    # section 2.1, in the units of the text
    inch, lbf = 0.0254, 4.4482216152605
    assert beam.section["steel"].bending_stiffness == pytest.approx(
        9060 * lbf * inch**2, rel=1e-12
    )  # definitions of units: rounding only
    assert beam.section["aluminium"].bending_stiffness == pytest.approx(2680 * lbf * inch**2, rel=1e-12)
    assert beam.position("top")[1] - beam.position("base")[1] == pytest.approx(80 * inch, rel=1e-12)


@pytest.mark.parametrize(
    ("pattern", "replacement", "message"),
    [
        (r"thickness = \{", "thicknes = {", "unknown key 'thicknes'; did you mean 'thickness'"),
        (r'value = 0.125, unit = "in"', 'value = nan, unit = "in"', "must be finite"),
        (r'value = 0.125, unit = "in"', 'value = inf, unit = "in"', "must be finite"),
        (r'value = 0.125, unit = "in"', 'value = -0.125, unit = "in"', "must be positive"),
        (r'value = 0.125, unit = "in"', 'value = "thin", unit = "in"', "a number was expected"),
        (r'value = 0.125, unit = "in"', 'value = 0.125, unit = "lb"', "cannot be converted to 'm'"),
        (r'value = 0.125, unit = "in"', 'value = 0.125, unit = "cubit"', "unknown unit 'cubit'"),
        (
            r'value = 0.125, unit = "in", origin = "published"',
            'value = 0.125, unit = "in", origin = "guessed"',
            "unknown origin 'guessed'",
        ),
        (r'value = 0.125, unit = "in", origin = "published", ', 'value = 0.125, unit = "in", ', "no 'origin'"),
        (r"thickness = \{[^}]*\}", "thickness = 0.125", "has no unit and origin"),
        (r"thickness = \{[^}]*\}\n", "", "the key 'thickness' is missing"),
        (r'at = "40in"', 'at = "41in"', "unknown point '41in'"),
        (r'section = "steel"', 'section = "stel"', "unknown section 'stel'; did you mean 'steel'"),
        (r'kind = "velocity"', 'kind = "speed"', "unknown value 'speed'"),
        (r"\[damping\]", "[damping", "malformed TOML"),
        (r"tension = \{[^}]*\}\n", "", "states no tension"),
        (r'name = "10in"', 'name = "20in"', "stands 2 times"),
        (r'format = "vlab-structure-1"', 'format = "vlab-structure-9"', "unknown value 'vlab-structure-9'"),
    ],
)
def test_a_wrong_structure_file_is_refused_in_one_line(tmp_path, pattern, replacement, message):
    from vlab.fe import build_fe_model

    path = altered(tmp_path, pattern, replacement)
    with pytest.raises(VlabError) as caught:
        build_fe_model(load_structure(path))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_bent_bar_is_refused(tmp_path):
    path = altered(tmp_path, r'(name = "30in"\nlabel = "grid point 6"\nx = \{ value = )0.0', r"\g<1>1.0")
    with pytest.raises(BadStructure, match="not straight"):
        load_structure(path)


SPAN = """
[[span]]
name = "{name}"
bar = "beam"
between = {between}
stiffness = {{ value = {factor}, unit = "1", origin = "assumed", source = "test" }}
"""


@pytest.mark.parametrize("between", ['["30in", "40in"]', '["40in", "30in"]'])
def test_two_spans_at_one_place_are_refused(tmp_path, between):
    # the first used to count and the second to be lost without a word
    path = tmp_path / "spans.toml"
    first = SPAN.format(name="thin", between='["30in", "40in"]', factor=0.98)
    path.write_text(TEXT + first, encoding="utf-8")
    assert load_structure(path).deviation("beam", "30in", "40in").stiffness == 0.98
    path.write_text(TEXT + first + SPAN.format(name="thick", between=between, factor=1.02), encoding="utf-8")
    with pytest.raises(
        BadStructure, match=r"spans 'thin' and 'thick' are both between.*'beam'.*at most one \[\[span\]\]"
    ):
        load_structure(path)


def test_unknown_structures_list_the_known():
    with pytest.raises(UnknownName, match="did you mean 'beam'"):
        load_structure("baem")


@pytest.mark.parametrize(
    ("place", "height_in"),
    [("base", 0), ("0in", 0), ("20in", 20), ("clamp", 20), ("37in", 37), ("508mm", 20), ("top", 80), ("80in", 80)],
)
def test_places_are_points_or_heights(beam, place, height_in):
    assert locate(beam, place).z == pytest.approx(height_in * 0.0254, abs=1e-12)  # rounding of the unit only


@pytest.mark.parametrize("place", ["81in", "midle", "", "20", "-3in", "tip"])
def test_places_that_are_not_on_the_structure_are_refused(beam, place):
    with pytest.raises(UnknownName):
        locate(beam, place)
