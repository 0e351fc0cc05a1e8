"""The Nyquist plot draws what it says and refuses what it cannot."""

import numpy as np
import pytest

from vlab.errors import BadRecording
from vlab.views.figures import nyquist_figure, to_svg
from vlab.views.figures.design import _lines

FREQ = np.geomspace(0.1, 10.0, 200)


def test_a_single_loop_is_drawn_as_it_is():
    loop = 2.0 / (1 + 1j * FREQ)
    whole, close = nyquist_figure(FREQ, loop).axes
    line = whole.lines[0]
    np.testing.assert_allclose(line.get_xdata() + 1j * line.get_ydata(), loop, atol=1e-12)
    assert "Re L" in whole.get_xlabel()
    assert close.get_xlim()[0] < -1 < close.get_xlim()[1]


def test_several_loops_are_drawn_by_their_determinant():
    parts = np.array([2.0 / (1 + 1j * FREQ), 0.5 / (1 + 2j * FREQ)])
    loop = np.zeros((FREQ.size, 2, 2), dtype=complex)
    loop[:, [0, 1], [0, 1]] = parts.T
    line = nyquist_figure(FREQ, loop, title="a <b> $c$").axes[0].lines[0]
    expected = (1 + parts[0]) * (1 + parts[1]) - 1
    np.testing.assert_allclose(line.get_xdata() + 1j * line.get_ydata(), expected, atol=1e-12)


def test_equal_figures_give_equal_text():
    loop = 2.0 / (1 + 1j * FREQ)
    assert to_svg(nyquist_figure(FREQ, loop)) == to_svg(nyquist_figure(FREQ, loop))


@pytest.mark.parametrize("loop", [np.ones(3), np.full(200, np.nan), np.ones((200, 2, 3))])
def test_what_cannot_be_drawn_is_refused(loop):
    with pytest.raises(BadRecording):
        nyquist_figure(FREQ, loop)


def test_a_resonance_is_drawn_as_a_circle():
    pole = 2 * np.pi * 1.85 * np.array([-0.01 + 1j, -0.01 - 1j])
    freq = _lines(0.5, 10.0, [pole])
    loop = 1.0 / (2j * np.pi * freq - pole[0])
    turns = np.abs(np.diff(np.unwrap(np.angle(loop - 0.5 / -pole[0].real))))
    assert np.degrees(turns.max()) < 2.1
