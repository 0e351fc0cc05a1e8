"""Static offsets of sensors, such as distance or gravity.

Offsets of many times the motion are subtracted first, since filters and windows would start far off. Smaller offsets
are parameters of every fit (`vlab.diagnose.inference.sensor_offset`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.cases.description import ChannelTable, RecordingTable
from vlab.cases.linear_start import input_matrices
from vlab.diagnose.parameters.observation import ChannelRows, channel_rows
from vlab.diagnose.parameters.recorded_runs import read_runs
from vlab.diagnose.settings import LOCATIONS, STATIC_OFFSET
from vlab.errors import BadStructure
from vlab.fe.second_order import SecondOrderModel
from vlab.plants.base import Plant
from vlab.signals import Array

ANGLES = ("angle",)
"""Kinds without correction: a pendulum may be inverted."""


@dataclass(frozen=True, kw_only=True)
class StaticOffset:
    """Static offset of a channel from the model at rest.

    Parameters
    ----------
    channel : str
        Channel.
    value : float
        Offset [SI].
    unit : str
        SI unit of the channel.
    """

    channel: str
    value: float
    unit: str

    @property
    def line(self) -> str:
        """Note for the report."""
        return f"{self.channel}: reads {self.value:.4g} {self.unit} more at rest than the model, in all recordings; taken off"


def remove_static_offsets(case: Case) -> tuple[Case, tuple[StaticOffset, ...]]:
    """Subtract the static offsets of a case's channels.

    Parameters
    ----------
    case : Case
        Case.

    Returns
    -------
    case : Case
        Case with corrected channel offsets.
    offsets : tuple of StaticOffset
        Subtracted offsets.

    Raises
    ------
    BadCase, BadRecording
        A recording contradicts the model or cannot be read.
    """
    if not case.recordings(("fit",)):
        return case, ()
    recorded = read_runs(case, ("fit",))
    try:
        linear = case.plant.linearise()
    except BadStructure:
        return case, ()  # without equilibrium there is no offset
    rows = channel_rows(case.plant, recorded.channels)
    omega, shapes = linear.eigen
    moves_freely = np.any(np.abs(rows.at_q @ shapes[:, np.abs(omega) < LOCATIONS.free]) > 0, axis=1)
    measured = recorded.runs[0].measured
    forced = [_static_response(case.plant, run, linear, rows) for run in recorded.runs]
    found = []
    for i, compared in enumerate(recorded.channels):
        channel = measured.channels[measured.index(compared.channel)]
        if channel.kind in ANGLES or moves_freely[i]:
            continue
        rest = 0.0 if compared.from_rest else rows.rest[i]
        columns = [run.measured[compared.channel] - rest for run in recorded.runs]
        value = _static_offset(columns, np.array([shifts[i] for shifts in forced]))
        if value != 0.0:
            found.append(StaticOffset(channel=compared.channel, value=value, unit=channel.unit))
    return (_corrected(case, found), tuple(found)) if found else (case, ())


def _static_response(plant: Plant, run: Run, linear: SecondOrderModel, rows: ChannelRows) -> Array:
    """Return the channels' static response to the mean inputs (n_channels,)."""
    forces, direct = input_matrices(plant, run)
    means = np.array([run.measured[drive.channel].mean() for drive in run.drives])
    return np.asarray(rows.at_q @ np.linalg.lstsq(linear.K, forces @ means)[0] + direct @ means)


def _static_offset(columns: list[Array], forced: Array) -> float:
    """Return the offset of a channel, 0 where motion or inputs may explain its mean.

    The static response to the inputs is that of the linear model. Its size counts as its uncertainty, since large inputs
    hold the model far from rest, where gravity loads the joints otherwise.
    """
    means, spread = np.array([c.mean() for c in columns]) - forced, max(float(c.std()) for c in columns)
    uncertain = np.hypot(spread, np.abs(forced))
    stands = (
        spread > 0
        and np.all(np.abs(means) > STATIC_OFFSET.stands_off * uncertain)
        and np.ptp(means) < STATIC_OFFSET.alike * spread
    )
    return float(np.mean(means)) if stands else 0.0


def _corrected(case: Case, found: list[StaticOffset]) -> Case:
    """Return a case with offsets in its channel tables."""
    by_name = {s.channel: s.value for s in found}

    def corrected(table: RecordingTable) -> Iterator[ChannelTable]:
        for channel, name in zip(table.channel, table.channel_names, strict=True):
            value = by_name.get(name, 0.0)
            factor = channel.spec().channel_and_factor()[1]
            yield replace(channel, offset=channel.offset + value / factor) if value else channel

    return case.with_channels(corrected)
