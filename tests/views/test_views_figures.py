"""Figures: units on every axis, no lost peak, equal data give equal SVG, hostile names stay text."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from vlab.errors import BadRecording, UnknownName
from vlab.modal.mac import mac
from vlab.signals import Channel, FrequencyResponse, ModalModel, Recording
from vlab.views import figures
from vlab.views.figures import bar_curve, decimate, frf_figure, to_svg
from vlab.views.figures.style import ROLES

HOSTILE = '<script>alert("$x$")</script>'
UNIT = re.compile(r"\[[^\]]+\]")


def recording(names=("sensor:base", "probe:30in"), *, n=4000, rate=2000.0, gain=1.0):
    time = np.arange(n) / rate
    data = gain * np.column_stack([np.sin(2 * np.pi * (5 + 3 * k) * time) for k in range(len(names))])
    kinds = [("velocity", "m/s"), ("displacement", "m")]
    channels = [
        Channel(name=name, kind=kinds[k % 2][0], unit=kinds[k % 2][1], at=name.rpartition(":")[2])
        for k, name in enumerate(names)
    ]
    return Recording(time=time, data=data, channels=tuple(channels))


def response(outputs=("sensor:base",), *, unit="m/s/N", coherence=True, n=500):
    freq = np.linspace(0.5, 30, n)
    one = 1j * freq / (25 - freq**2 + 0.1j * freq)
    H = np.repeat(one[:, None, None], len(outputs), axis=1)
    seen = np.full((n, len(outputs)), 0.9) if coherence else None
    return FrequencyResponse(freq=freq, H=H, outputs=outputs, inputs=("force:base",), unit=unit, coherence=seen)


def every_figure(beam, fe):
    points = [p.name for p in beam.point]
    modes = fe.linear.modal_model(fe.deflections(points), points, 2)
    poles = 2j * np.pi * modes.freq - 0.1
    return {
        "frf": frf_figure(response(), response(coherence=False), "base", "base"),
        "modes": figures.mode_shapes_figure(beam, modes, modes),
        "mac": figures.mac_figure(mac(modes.shapes, modes.shapes), row_freq=modes.freq),
        "traces": figures.traces_figure([("a", recording())]),
        "spectrum": figures.spectrum_figure([("a", recording())]),
        "comparison": figures.comparison_figure(recording(), recording(gain=0.9), "sensor:base"),
        "frequencies": figures.frequencies_figure({"published": modes.freq, "FE": modes.freq * 1.01}),
        "poles": figures.pole_figure([("open", poles), ("closed", poles - 1)], damping=(0.01,)),
    }


@pytest.fixture(scope="module")
def drawn(beam, fe):
    return every_figure(beam, fe)


@pytest.fixture(scope="module")
def svgs(drawn):
    return {name: to_svg(figure) for name, figure in drawn.items()}


def test_every_axis_states_its_unit(drawn):
    for name, figure in drawn.items():
        across = [axes.get_xlabel() for axes in figure.axes] + [figure.get_supxlabel()]
        up = [axes.get_ylabel() for axes in figure.axes]
        for labels in (across, up):
            stated = [label for label in labels if label]
            assert stated, name
            assert all(UNIT.search(label) for label in stated), (name, stated)


def test_svg_is_the_same_for_the_same_data(beam, fe, svgs):
    again = every_figure(beam, fe)
    for name in ("frf", "mac"):
        assert to_svg(again[name]) == svgs[name], name
    for name, svg in svgs.items():
        assert svg.startswith("<svg"), name
        assert not re.search(r"<!|\d{4}-\d\d-\d\dT|dc:date", svg), name


def test_svg_identifiers_of_two_figures_do_not_meet(svgs):
    found = [identifier for svg in svgs.values() for identifier in re.findall(r' id="([^"]*)"', svg)]
    assert len(found) > 10
    assert len(found) == len(set(found))


def test_svg_refers_only_to_what_it_holds(svgs):
    for name, svg in svgs.items():
        assert set(re.findall(r'(?:url\(|href=")#([^")]+)', svg)) <= set(re.findall(r' id="([^"]*)"', svg)), name


def test_decimation_keeps_the_extremes():
    rng = np.random.default_rng(0)
    time, values = np.arange(120_000) / 2000, rng.normal(size=120_000)
    values[77_777], values[3] = 40.0, -50.0
    x, y = decimate(time, values, limit=2000)
    assert len(x) <= 2000
    assert np.all(np.diff(x) > 0)
    assert (y.max(), y.min()) == (40.0, -50.0)
    assert (x[0], x[-1]) == (time[0], time[-1])
    assert np.isin(y, values).all()


def test_a_minute_at_2_khz_makes_a_small_svg():
    svg = to_svg(figures.traces_figure([("run", recording(n=120_000))]))
    assert len(svg) < 150_000


def test_uneven_stamps_have_a_spectrum_too():
    """A sine of 10 Hz at 1 m on stamps that jitter by a fifth of their step: the peak is where it was."""
    time = np.arange(4000) / 400 + 5e-4 * np.random.default_rng(1).uniform(-1, 1, 4000)
    wave = Recording(
        time=time,
        data=np.sin(2 * np.pi * 10 * time)[:, None],
        channels=(Channel(name="a", kind="displacement", unit="m"),),
    )
    line = figures.spectrum_figure([("a", wave)]).axes[0].lines[0]
    freq, density = (np.asarray(x, dtype=float) for x in line.get_data())
    assert freq[np.argmax(density)] == pytest.approx(10.0, abs=0.5)


def test_a_hostile_channel_name_stays_text():
    figure = figures.traces_figure([(HOSTILE, recording((HOSTILE, "_hidden"))), ("b", recording((HOSTILE,)))])
    svg = to_svg(figure)
    assert "<script" not in svg
    words = "".join(ElementTree.fromstring(svg).itertext())
    assert 'alert("$x$")' in words


def test_an_overlay_in_another_unit_is_refused():
    with pytest.raises(BadRecording, match="do not share an axis"):
        frf_figure(response(), response(unit="m/N"))
    frf_figure(response(unit="(m/s)/N"), response(unit="m/s/N"))  # two ways to write one unit


def test_an_unknown_output_names_the_ones_there_are():
    with pytest.raises(UnknownName, match="sensor:base"):
        frf_figure(response(), output="sensor:20in")


def test_phase_is_cut_where_the_curves_jump_least():
    freq = np.linspace(1, 10, 200)
    noisy = np.exp(1j * np.radians(180 + 20 * np.sin(40 * freq)))  # about +-180 degrees: the usual cut would tear it
    frf = FrequencyResponse(freq=freq, H=noisy[:, None, None], outputs=("y",), inputs=("u",), unit="m/N")
    line = frf_figure(frf).axes[1].lines[0]
    assert not np.isnan(line.get_ydata()).any()
    assert np.ptp(line.get_ydata()) < 50


def test_bar_curve_passes_through_its_points(beam):
    bar = beam.bar[0]
    rng = np.random.default_rng(1)
    deflections = rng.normal(size=len(bar.points))
    xz, matrix = bar_curve(beam, bar, bar.points)
    for point, value in zip(bar.points, deflections, strict=True):
        here = np.argmin(np.hypot(*(xz - beam.position(point)).T))
        assert (matrix @ deflections)[here] == pytest.approx(value, abs=1e-12)


def test_bar_curve_is_the_cubic_of_a_cantilever_arm(beam):
    # An arm of the crosspiece under a tip force: v = (3 s^2 - s^3) / 2 with s from the clamp to the tip.
    bar = next(b for b in beam.bar if b.name == "crosspiece")
    xz, matrix = bar_curve(beam, bar, bar.points)
    s = np.abs(xz[:, 0]) / xz[-1, 0]
    assert matrix @ [1.0, 0.0, 1.0] == pytest.approx((3 * s**2 - s**3) / 2, abs=1e-12)
    assert matrix @ [-1.0, 0.0, 1.0] == pytest.approx(np.sign(xz[:, 0]) * (3 * s**2 - s**3) / 2, abs=1e-12)


def test_mode_shapes_pair_by_likeness_not_by_order(beam, fe):
    points = [p.name for p in beam.point]
    modes = fe.linear.modal_model(fe.deflections(points), points, 3)
    turned = np.array([2, 0, 1])
    other = ModalModel(
        freq=modes.freq[turned],
        zeta=modes.zeta[turned],
        shapes=-3.0 * modes.shapes[:, turned],
        coordinates=tuple(points),
    )
    figure = figures.mode_shapes_figure(beam, modes, other)
    for axes, freq in zip(figure.axes, modes.freq, strict=True):
        assert axes.get_title().count(f"{freq:.3f}") == 2


def test_comparison_refuses_recordings_apart_in_time():
    late = recording()
    late = Recording(time=late.time + 100, data=late.data, channels=late.channels)
    with pytest.raises(BadRecording, match="do not overlap"):
        figures.comparison_figure(recording(), late, "sensor:base")


def test_curves_with_a_role_have_its_colour():
    pair = [("recorded", recording()), ("simulated", recording())]
    axes = figures.traces_figure(pair, roles=("measured", "nominal")).axes[0]
    assert [line.get_color() for line in axes.lines] == [ROLES[role]["color"] for role in ("measured", "nominal")]


def test_short_lengths_are_drawn_in_millimetres():
    """An axis of metres has an offset that no reader sees."""
    time = np.arange(200) / 100.0
    channel = Channel(name="probe", kind="displacement", unit="m", at="30in")
    short = Recording(time=time, data=1e-4 * np.sin(9.0 * time)[:, None], channels=(channel,))
    (axes,) = figures.traces_figure([("run", short)]).axes
    assert "[mm]" in axes.get_ylabel()
    assert np.abs(axes.lines[0].get_ydata()).max() == pytest.approx(0.1, rel=0.01)
