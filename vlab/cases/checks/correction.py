"""A slip in what a case says of its columns: what the recordings are without it, and the lines of the case that mend it."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from vlab import units
from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.cases.checks.slips import REACH
from vlab.cases.description import ChannelTable

Severity = Literal["fatal", "warning", "note"]


@dataclass(frozen=True, kw_only=True)
class Taken:
    """What a channel should be taken from.

    Parameters
    ----------
    channel, source : str
        The channel, and the one whose numbers are its own.
    factor : float
        By which the numbers, as the case has them read, are too large.
    unit : str
        In which they are, where that is why.
    """

    channel: str
    source: str
    factor: float = 1.0
    unit: str = ""


@dataclass(frozen=True, kw_only=True)
class Correction:
    """Some channels of all recordings read otherwise."""

    taken: tuple[Taken, ...]

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that change."""
        return tuple(taken.channel for taken in self.taken)

    @property
    def is_swap(self) -> bool:
        """Whether channels exchange their numbers."""
        return any(taken.source != taken.channel for taken in self.taken)

    @property
    def is_turned(self) -> bool:
        """Whether it turns signs and does nothing else."""
        return all(taken.factor == -1.0 for taken in self.taken)

    @property
    def is_beyond_physics(self) -> bool:
        """Whether a factor is larger than any effect of the catalogue makes it."""
        return any(abs(np.log(abs(taken.factor))) > np.log(REACH) for taken in self.taken)

    def on(self, run: Run) -> Run:
        """Return a run as it is without the slip."""
        out = {}
        for name in ("measured", "before"):
            recording = getattr(run, name)
            if recording is None:
                continue
            data = recording.data.copy()
            for taken in self.taken:
                if {taken.channel, taken.source} <= set(recording.names):
                    data[:, recording.index(taken.channel)] = recording[taken.source] / taken.factor
            out[name] = replace(recording, data=data)
        return replace(run, **out)

    def edits(self, case: Case) -> str:
        """Return the lines of the case that mend it."""
        tables = columns_of(case)
        parts = [_edit(case, taken, tables) for taken in self.taken]
        return "; ".join(dict.fromkeys(part for part in parts if part))


@dataclass(frozen=True, kw_only=True)
class Found:
    """What is wrong with what a case says of its recordings.

    Parameters
    ----------
    severity : str
        ``"fatal"``: nothing can be said of the model before it is mended. ``"warning"``: it may be physics as well, but where nothing
        else explains the recordings, it does. ``"note"``: worth a look.
    text : str
        What was seen, and the edit of the case that mends it.
    channels : tuple of str
        The channels that it is said of.
    """

    severity: Severity
    text: str
    channels: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class FileCheck:
    """What the checks of a case's files found, the worst first."""

    found: tuple[Found, ...] = ()

    def of(self, severity: Severity) -> tuple[str, ...]:
        """Return the texts of one severity."""
        return tuple(f.text for f in self.found if f.severity == severity)

    @property
    def lines(self) -> tuple[str, ...]:
        """All texts."""
        return tuple(text for severity in ("fatal", "warning", "note") for text in self.of(severity))


@dataclass(frozen=True, kw_only=True)
class Column:
    """What the recordings of a case say of a channel.

    Parameters
    ----------
    table : ChannelTable
        In the first recording that has it.
    columns : tuple of str
        Its columns in all of them.
    """

    table: ChannelTable
    columns: tuple[str, ...] = field(default=())

    @property
    def si(self) -> str:
        """SI unit of its numbers inside vlab; empty where a scale leads to the model's own."""
        return self.table.spec().channel_and_factor()[0].unit

    @property
    def factor(self) -> float:
        """By what a number of the file is multiplied."""
        return self.table.spec().channel_and_factor()[1]

    @property
    def unit(self) -> str:
        """Unit that the numbers are said to be in."""
        return self.si if self.table.scale is not None else self.table.unit

    @property
    def where(self) -> str:
        """The lines of the case that describe it, in words."""
        names = " and ".join(f'"{name}"' for name in self.columns)
        return f"[[recording.channel]] with column = {names}"


def columns_of(case: Case) -> dict[str, Column]:
    """Return what a case says of its channels, by name."""
    out: dict[str, Column] = {}
    for table in case.table.recording:
        for name, channel in zip(table.channel_names, table.channel, strict=True):
            known = out.get(name, Column(table=channel))
            out[name] = replace(known, columns=tuple(dict.fromkeys([*known.columns, channel.column])))
    return out


def slips_of(column: Column) -> dict[str, float]:
    """Return by unit how much too large the numbers of a channel are where they are in that unit and not in the one that is said."""
    if not column.si:
        return {}
    return {unit: 1.0 / ratio for unit, ratio in units.mistaken(column.unit, column.si).items()}


def _edit(case: Case, taken: Taken, tables: dict[str, Column]) -> str:
    column = tables[taken.channel]
    if taken.source != taken.channel:
        other = tables[taken.source]
        return f'at = "{column.table.at}" in {other.where}'
    if taken.unit and taken.factor > 0.0 and column.table.scale is None:
        return f'unit = "{taken.unit}" in every {column.where}'
    return f"scale = {column.factor / taken.factor:.12g} in every {column.where}"
