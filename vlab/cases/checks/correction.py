"""Corrections of a case's column descriptions, with the edits of the file."""

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
    """Corrected source of a channel.

    Parameters
    ----------
    channel, source : str
        The channel, and the channel with the right numbers.
    factor : float
        Ratio of the numbers as read to the true numbers.
    unit : str
        True unit of the numbers, if the unit is wrong.
    """

    channel: str
    source: str
    factor: float = 1.0
    unit: str = ""


@dataclass(frozen=True, kw_only=True)
class Correction:
    """Corrected reading of channels in all recordings."""

    taken: tuple[Taken, ...]

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that change."""
        return tuple(taken.channel for taken in self.taken)

    @property
    def is_swap(self) -> bool:
        """Whether channels exchange their numbers."""
        return any(taken.source != taken.channel for taken in self.taken)

    @property
    def is_turned(self) -> bool:
        """Whether the correction only reverses signs."""
        return all(taken.factor == -1.0 for taken in self.taken)

    @property
    def is_beyond_physics(self) -> bool:
        """Whether a factor exceeds every effect of the catalogue."""
        return any(abs(np.log(abs(taken.factor))) > np.log(REACH) for taken in self.taken)

    def on(self, run: Run) -> Run:
        """Return a run with the correction.

        Parameters
        ----------
        run : Run
            Run as read.

        Returns
        -------
        Run
            Corrected copy.
        """
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
        """Return edits of a case file, or arguments in memory.

        Parameters
        ----------
        case : Case
            Case with the channels.

        Returns
        -------
        str
            Edits, such as ``unit = "mm" in every [[recording.channel]] with column = "x"``.
        """
        tables = columns_of(case)
        if case.in_memory:
            return f"channels={{{', '.join(_edit_of_arrays(taken, tables) for taken in self.taken)}}}"
        parts = [_edit(taken, tables) for taken in self.taken]
        return "; ".join(dict.fromkeys(part for part in parts if part))


MEND = "; to mend it, say in "
"""MEND: words between an observation and the place of its edit."""


def mend_in(case: Case) -> str:
    """Return the words between an observation and its edit.

    Parameters
    ----------
    case : Case
        Case with a file, or with arrays in memory.

    Returns
    -------
    str
        Words with the name of the case file, or of the function that takes arrays.
    """
    return f"{MEND}{'vlab.Case.from_arrays' if case.in_memory else case.path.name}: "


@dataclass(frozen=True, kw_only=True)
class Found:
    """A finding of the file checks.

    Parameters
    ----------
    severity : str
        ``"fatal"``: the model cannot be assessed before an edit. ``"warning"``: a missing effect could cause the same;
        an edit is needed unless an effect explains the recordings. ``"note"``: minor.
    text : str
        Observation and edit of the case.
    channels : tuple of str
        Affected channels.
    mend : str
        Edit of the case alone, which `text` holds too; empty if no edit mends the finding.
    """

    severity: Severity
    text: str
    channels: tuple[str, ...] = ()
    mend: str = ""

    @property
    def what(self) -> str:
        """Observation without the edit."""
        return self.text.partition(MEND)[0] if self.mend else self.text


@dataclass(frozen=True, kw_only=True)
class FileCheck:
    """Findings of the file checks, worst first."""

    found: tuple[Found, ...] = ()

    def of(self, severity: Severity) -> tuple[str, ...]:
        """Return the messages of one severity."""
        return tuple(f.text for f in self.found if f.severity == severity)

    @property
    def lines(self) -> tuple[str, ...]:
        """All messages."""
        return tuple(text for severity in ("fatal", "warning", "note") for text in self.of(severity))


@dataclass(frozen=True, kw_only=True)
class Column:
    """Description of a channel in a case's recordings.

    Parameters
    ----------
    table : ChannelTable
        Table of the first recording with the channel.
    columns : tuple of str
        Columns of the channel in all recordings.
    is_shared : bool
        Whether the channel is shared by all recordings.
    """

    table: ChannelTable
    columns: tuple[str, ...] = field(default=())
    is_shared: bool = False

    @property
    def si(self) -> str:
        """SI unit of the channel inside vlab.

        The unit is empty if a scale converts to the model's own unit.
        """
        return self.table.spec().channel_and_factor()[0].unit

    @property
    def factor(self) -> float:
        """Factor from file number to SI."""
        return self.table.spec().channel_and_factor()[1]

    @property
    def unit(self) -> str:
        """Stated unit of the numbers."""
        return self.si if self.table.scale is not None else self.table.unit

    @property
    def where(self) -> str:
        """Location of the channel in the case, for messages."""
        names = " and ".join(f'"{name}"' for name in self.columns)
        return f"[[{'channel' if self.is_shared else 'recording.channel'}]] with column = {names}"


def columns_of(case: Case) -> dict[str, Column]:
    """Return the column descriptions of a case by channel.

    Parameters
    ----------
    case : Case
        Case with its model.

    Returns
    -------
    dict of str to Column
        Description by channel name.
    """
    out: dict[str, Column] = {}
    for table in case.table.recording:
        for name, channel in zip(table.channel_names, table.channel, strict=True):
            known = out.get(name, Column(table=channel, is_shared=channel.column in case.shared))
            out[name] = replace(known, columns=tuple(dict.fromkeys([*known.columns, channel.column])))
    return out


def slips_of(column: Column) -> dict[str, float]:
    """Return the factor of each possible unit mistake.

    Parameters
    ----------
    column : Column
        Description of the channel.

    Returns
    -------
    dict of str to float
        Ratio of numbers as read to true numbers, by true unit.
    """
    if not column.si:
        return {}
    return {unit: 1.0 / ratio for unit, ratio in units.mistaken(column.unit, column.si).items()}


def _edit(taken: Taken, tables: dict[str, Column]) -> str:
    column = tables[taken.channel]
    if taken.source != taken.channel:
        other = tables[taken.source]
        return f'at = "{column.table.at}" in {other.where}'
    if taken.unit and taken.factor > 0.0 and column.table.scale is None:
        return f'unit = "{taken.unit}" in every {column.where}'
    return f"scale = {column.factor / taken.factor:.12g} in every {column.where}"


def _edit_of_arrays(taken: Taken, tables: dict[str, Column]) -> str:
    """Return the entries of the argument `channels` that replace a channel."""
    column = tables[taken.channel]
    if taken.source != taken.channel:
        columns, key = tables[taken.source].columns, f'"at": "{column.table.at}"'
    elif taken.unit and taken.factor > 0.0 and column.table.scale is None:
        columns, key = column.columns, f'"unit": "{taken.unit}"'
    else:
        columns, key = column.columns, f'"scale": {column.factor / taken.factor:.12g}'
    return ", ".join(f'"{name}": {{{key}}}' for name in columns)
