"""Difference plots of mode shapes: one scale, no dependence on signs, units stated, hostile names stay text."""

import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from vlab.cli import main
from vlab.cli.modes import _moving
from vlab.errors import BadRecording
from vlab.fe import build_fe_model
from vlab.signals import ModalModel
from vlab.structure import load_structure
from vlab.views.figures import mode_difference_figure, to_svg

HOSTILE = '<script>alert("$x$")</script>'


def model(name, modes=5):
    structure = load_structure(name)
    points = [p.name for p in structure.point]
    fe = build_fe_model(structure)
    return structure, fe.linear.modal_model(fe.deflections(points), points, modes)


@pytest.fixture(scope="module", params=["beam", "grid"])
def drawn(request):
    return model(request.param)


def changed(modes, seed=0):
    """Modes a little different, in another order, of another size and other signs."""
    rng = np.random.default_rng(seed)
    order = np.arange(modes.freq.size)[::-1]
    largest = np.abs(modes.shapes).max(axis=0)
    shapes = modes.shapes + 0.05 * largest * rng.standard_normal(modes.shapes.shape)
    shapes = shapes[:, order] * (-3.0) ** np.arange(order.size)
    return ModalModel(freq=modes.freq[order] * 1.01, zeta=modes.zeta, shapes=shapes, coordinates=modes.coordinates)


def panels(figure):
    """Return left, right and difference: the first three axes, in this order."""
    return figure.axes[:3]


def points_of(axes):
    return next(line.get_xydata() for line in axes.lines if line.get_label() == "points")


def test_left_is_left_and_the_difference_is_on_top(drawn):
    structure, modes = drawn
    figure = mode_difference_figure(structure, changed(modes), modes, 2, labels=("seen", "made"))
    left, right, top = panels(figure)
    assert left.get_position().x1 <= right.get_position().x0
    assert top.get_position().y0 >= left.get_position().y1
    assert abs((top.get_position().x0 + top.get_position().x1) / 2 - 0.5) < 1e-6
    assert left.get_title().startswith("seen\nmode 4,")  # the order of the left model is turned round
    assert right.get_title().startswith("made\nmode 2,")
    assert "MAC 0.9" in top.get_title()


def test_all_panels_and_the_key_are_on_one_scale_that_is_stated(drawn):
    structure, modes = drawn
    figure = mode_difference_figure(structure, changed(modes), modes, 1)
    inch = figure.get_size_inches()
    scales = []
    for axes in figure.axes:
        place = axes.get_position()
        scales.append(place.width * inch[0] / np.ptp(axes.get_xlim()))
        scales.append(place.height * inch[1] / np.ptp(axes.get_ylim()))
    assert np.ptp(scales) < 1e-9 * scales[0]
    key = " ".join(text.get_text() for text in figure.axes[3].texts)
    assert re.search(r"x, \S+ m\b", key)
    assert re.search(r"z, \S+ m\b", key)
    assert "deflection y, 1 [-]" in key
    assert any("relative to the largest" in text.get_text() for text in figure.texts)


def test_nothing_is_drawn_outside_its_panel(drawn):
    structure, modes = drawn
    for mode in range(1, modes.freq.size + 1):
        for axes in panels(mode_difference_figure(structure, changed(modes), modes, mode)):
            xy = np.concatenate([line.get_xydata() for line in axes.lines])
            (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
            assert (xy > (x0, y0)).all()
            assert (xy < (x1, y1)).all()


def test_shapes_have_a_unit_maximum_and_the_difference_is_left_minus_right(drawn):
    structure, modes = drawn
    figure = mode_difference_figure(structure, changed(modes), modes, 3)
    zero = points_of(panels(mode_difference_figure(structure, modes, modes, 3))[2])
    left, right, top = (np.array(points_of(axes) - zero) for axes in panels(figure))
    unit = [np.hypot(*moved.T).max() for moved in (left, right)]
    assert unit[0] == pytest.approx(unit[1], rel=1e-9)
    np.testing.assert_allclose(top, left - right, atol=1e-9)


def test_a_model_does_not_differ_from_itself(drawn):
    structure, modes = drawn
    for mode in (1, modes.freq.size):
        top = panels(mode_difference_figure(structure, modes, modes, mode))[2]
        ties = [line.get_xydata() for line in top.lines if line.get_label() == "tie"]
        assert len(ties) == len(structure.point)
        assert max(np.abs(tie[1] - tie[0]).max() for tie in ties) == 0.0
        assert "largest 0.000, MAC 1.0000" in top.get_title()


@pytest.mark.slow
def test_signs_and_sizes_of_the_models_change_nothing(drawn):
    structure, modes = drawn
    left = changed(modes)
    once = to_svg(mode_difference_figure(structure, left, modes, 2))
    flipped, turned = replace(left, shapes=-left.shapes), replace(modes, shapes=-2 * modes.shapes)
    assert to_svg(mode_difference_figure(structure, flipped, modes, 2)) == once
    assert to_svg(mode_difference_figure(structure, left, turned, 2)) == once
    assert to_svg(mode_difference_figure(structure, left, modes, 2)) == once  # and again the same text


def test_complex_shapes_at_some_of_the_points_can_be_compared(drawn):
    structure, modes = drawn
    some = slice(0, len(modes.coordinates) - 2)
    left = ModalModel(
        freq=modes.freq,
        zeta=modes.zeta,
        shapes=modes.shapes[some] * np.exp(0.7j),
        coordinates=tuple(f"sensor:{name}" for name in modes.coordinates[some]),
    )
    top = panels(mode_difference_figure(structure, left, modes, 1))[2]
    assert len(points_of(top)) == len(left.coordinates)
    assert "largest 0.000" in top.get_title()


def test_hostile_names_stay_text(drawn):
    structure, modes = drawn
    named = replace(structure, title=HOSTILE)
    svg = to_svg(mode_difference_figure(named, modes, modes, 1, labels=(HOSTILE, HOSTILE)))
    assert "<script" not in svg
    assert svg.count("&lt;script&gt;") == 3
    ElementTree.fromstring(svg)


def test_a_mode_that_is_not_there_is_refused(drawn):
    structure, modes = drawn
    with pytest.raises(BadRecording, match="modes 1 to 5"):
        mode_difference_figure(structure, modes, modes, 0)
    few = ModalModel(
        freq=modes.freq[:1], zeta=modes.zeta[:1], shapes=modes.shapes[:, :1], coordinates=modes.coordinates
    )
    with pytest.raises(BadRecording, match="no partner"):
        mode_difference_figure(structure, few, modes, 2)


@pytest.mark.slow
def test_the_command_writes_differences_and_comac(tmp_path, capsys, quick_layout):
    folder = tmp_path / "out"
    assert main(["modes", "beam", "--modes", "2", "--out", str(folder), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    points = [p.name for p in load_structure("beam").point]
    for plant in document["plants"]:
        assert list(document["comac"][plant]) == points
        assert all(0 <= value <= 1 for value in document["comac"][plant].values())
        assert np.shape(document["cross_mac"][plant]) == (2, 2)
        assert np.diag(document["cross_mac"][plant]).min() > 0.99
        for mode in (1, 2):
            ElementTree.fromstring((folder / f"difference-{plant}-mode{mode:02d}.svg").read_text(encoding="utf-8"))


def test_rounding_at_held_points_is_no_motion():
    shapes = np.array([[1.0, -1.0], [3e-17, -2e-18], [0.5, 2e-3]])
    modes = ModalModel(freq=np.array([1.0, 2.0]), zeta=np.zeros(2), shapes=shapes, coordinates=("a", "held", "b"))
    np.testing.assert_array_equal(_moving(modes), [[1.0, -1.0], [0.0, 0.0], [0.5, 2e-3]])
