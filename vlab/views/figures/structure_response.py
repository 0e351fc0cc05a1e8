"""Figures of analytical frequency responses of a structure."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from vlab.errors import unknown_name
from vlab.fe.model import FeModel
from vlab.fe.second_order import Quantity
from vlab.signals import Array
from vlab.views.figures import frf_figure

QUANTITIES: tuple[Quantity, ...] = ("velocity", "displacement")


def response_figures(fe: FeModel, force: str, places: Sequence[str] = ()) -> dict[str, Figure]:
    """Return velocity and displacement responses to a force.

    Parameters
    ----------
    fe : FeModel
        FE model.
    force : str
        Point of the structure, or place of a coil.
    places : sequence of str
        Places of the response; the coils by default.

    Returns
    -------
    dict
        Figures by file name.

    Raises
    ------
    UnknownName
        There is no such place.
    """
    known = list(dict.fromkeys([*(p.name for p in fe.structure.point), *fe.structure.coil_places]))
    places = list(places) or fe.structure.coil_places
    for place in (force, *places):
        if place not in known:
            raise unknown_name("place", place, known, where=f"structure {fe.structure.name!r}")
    freq, load, rows = _lines(fe), fe.deflections([force]).T, fe.deflections(places)
    figures = {}
    for quantity in QUANTITIES:
        names = [f"{quantity}:{place}" for place in places]
        response = fe.linear.frequency_response(
            freq, load, rows, quantity=quantity, input_names=[f"force:{force}"], output_names=names
        )
        for place in places:
            title = f"{quantity} of {place} per force at {force}, open loop"
            figures[f"frf-{quantity}-{place}"] = frf_figure(None, response, place, force, title=title)
    return figures


def _lines(fe: FeModel) -> Array:
    """Return frequencies, dense around each resonance [Hz]."""
    modes = fe.linear.freq[: len(fe.structure.damping.ratios)]
    top = 1.1 * modes[-1]
    around = np.sinh(np.linspace(-5, 5, 61))
    near = [hz * (1 + zeta * around) for hz, zeta in zip(fe.linear.freq, fe.linear.zeta, strict=True)]
    freq = np.unique(np.concatenate([np.linspace(0.02 * top, top, 600), *near]))
    return freq[(freq >= 0.02 * top) & (freq <= top)]
