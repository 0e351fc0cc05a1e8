"""From the columns of a file to a frequency response: forms and units known, frequencies checked, nothing repaired."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vlab import units
from vlab.errors import BadRecording, BadUnit
from vlab.files.text import one_line
from vlab.recordings.files import refuse
from vlab.recordings.table import Table
from vlab.signals import FrequencyResponse

FORM_UNITS = {"receptance": "m/N", "mobility": "m/s/N", "accelerance": "m/s^2/N"}
"""The forms of a frequency response and the SI unit of each."""


class ResponseColumn(Protocol):
    """Which column holds the response at a place; see `vlab.cases.description.FrfChannelTable`."""

    @property
    def column(self) -> str:
        """The column, of complex numbers or of the real part."""

    @property
    def at(self) -> str:
        """The output."""

    @property
    def imaginary(self) -> str:
        """The column of the imaginary part, or empty."""

    @property
    def phase(self) -> str:
        """The column of the phase, or empty."""

    @property
    def phase_unit(self) -> str:
        """Its unit."""


class ResponseSpec(Protocol):
    """What the columns of a file are; see `vlab.cases.description.FrfTable`."""

    @property
    def form(self) -> str:
        """One of `FORM_UNITS`."""

    @property
    def form_db(self) -> bool:
        """Whether the columns hold 20 log10 of the magnitude."""

    @property
    def input(self) -> str:
        """The input."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """The outputs."""

    @property
    def frequency(self) -> str:
        """The column of the frequencies."""

    @property
    def frequency_unit(self) -> str:
        """Its unit."""

    @property
    def unit(self) -> str:
        """Unit of the response; the SI unit of the form where it is empty."""

    @property
    def channel(self) -> Sequence[ResponseColumn]:
        """The columns by output; empty where the columns after the frequency are the outputs in their order."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredResponse(FrequencyResponse):
    """A frequency response as measured.

    Parameters
    ----------
    is_magnitude : bool
        The file holds magnitudes only: H is real and its phase is not known.
    notes : tuple of str
        What a user of the response should know.
    """

    is_magnitude: bool = False
    notes: tuple[str, ...] = ()

    def to_frd(self) -> Any:
        """Return python-control's `FRD`; a response without phase has none.

        Raises
        ------
        BadRecording
            The response is magnitudes only.
        """
        if self.is_magnitude:
            raise BadRecording("the response is magnitudes only, its phase is not known; compare magnitudes")
        return super().to_frd()


def to_frequency_response(table: Table, spec: ResponseSpec) -> MeasuredResponse:
    """Label the columns of a table as frequency responses to one input and convert them to SI.

    Parameters
    ----------
    table : Table
        The file.
    spec : FrfTable or alike
        What its columns are.

    Returns
    -------
    MeasuredResponse
        (n, n_outputs, 1) in the SI unit of the form; of dB the magnitude, marked so.

    Raises
    ------
    BadRecording
        Columns of unequal length, frequencies that are negative or do not increase, a complex magnitude, a real column
        without its imaginary part, or fewer columns than outputs.
    BadUnit
        A unit that is unknown, of another dimension than the form, or not that which the file states.
    UnknownName
        A column that is not in the file.
    """
    si = FORM_UNITS.get(spec.form)
    if si is None:
        raise refuse(table.path, f"the form is {spec.form!r}", fix=f"accepted: {', '.join(FORM_UNITS)}")
    freq = table.real(spec.frequency) * _factor(table, spec.frequency, spec.frequency_unit, "Hz")
    if freq.size < 2 or freq[0] < 0 or not np.all(np.diff(freq) > 0):
        k = int(np.argmin(np.diff(freq))) + 1 if freq.size > 1 else 0
        what = f"the frequencies in {spec.frequency!r} do not increase from 0 on (line {k} is {freq[k]:g} Hz)"
        raise refuse(table.path, what, fix="name the column of the frequencies")
    columns, notes, has_phase = [], [], []
    for output, (column, imaginary, phase, phase_unit) in zip(spec.outputs, _columns(table, spec), strict=True):
        values = _values(table, column, imaginary, is_db=spec.form_db)
        if phase:
            values = _turned(table, column, values, phase, phase_unit)
        has_phase.append(bool(phase) or not spec.form_db)
        if values.size != freq.size:
            what = f"column {column!r} has {values.size} lines, the frequencies {freq.size}"
            raise refuse(table.path, what, fix="they do not belong together")
        if not spec.form_db and not imaginary and not phase and not np.iscomplexobj(table[column]):
            raise refuse(
                table.path,
                f"column {column!r} (output {output!r}) is real, a response has a phase",
                fix="name the column of its imaginary part or of its phase, or set form_db where it is a magnitude in dB",
            )
        columns.append(values * _factor(table, column, spec.unit or si, si))
    if freq[0] == 0.0:
        notes.append("the line at 0 Hz is kept; accelerometers and coils measure nothing there")
    if any(has_phase) and not all(has_phase):
        raise refuse(table.path, "some outputs have a phase and others none", fix="name a phase for each, or for none")
    if not all(has_phase):
        notes.append("magnitudes only: 20 log10 of the magnitude in the unit of the response, no phase")
    try:
        return MeasuredResponse(
            freq=freq,
            H=np.column_stack(columns)[:, :, None],
            outputs=tuple(spec.outputs),
            inputs=(spec.input,),
            unit=si,
            is_magnitude=not all(has_phase),
            notes=tuple(notes),
        )
    except BadRecording as error:
        raise refuse(table.path, str(error)) from error


def _columns(table: Table, spec: ResponseSpec) -> list[tuple[str, str, str, str]]:
    """Return the columns of real (or complex) and imaginary part of each output, and of its phase with its unit."""
    if spec.channel:
        given = {c.at: (c.column, c.imaginary, c.phase, c.phase_unit) for c in spec.channel}
        missing = [output for output in spec.outputs if output not in given]
        if missing:
            raise refuse(table.path, f"output {missing[0]!r} has no channel", fix="give each output one channel")
        return [given[output] for output in spec.outputs]
    others = [name for name in table.names if name != spec.frequency]
    if len(others) != len(spec.outputs):
        what = f"{len(others)} columns beside {spec.frequency!r} for {len(spec.outputs)} outputs"
        raise refuse(table.path, what, fix="say with channel which column belongs to which output")
    return [(name, "", "", "deg") for name in others]


def _turned(table: Table, column: str, size: NDArray[Any], phase: str, unit: str) -> NDArray[Any]:
    """Return a magnitude turned by its phase."""
    angle = table.real(phase) * _factor(table, phase, unit, "rad")
    if np.iscomplexobj(size) or np.any(size < 0):
        raise refuse(table.path, f"column {column!r} is no magnitude", fix=f"leave out the phase {phase!r}")
    if angle.size != size.size:
        what = f"{column!r} has {size.size} lines, its phase {phase!r} {angle.size}"
        raise refuse(table.path, what, fix="they do not belong together")
    return np.asarray(size * np.exp(1j * angle))


def _values(table: Table, column: str, imaginary: str, *, is_db: bool) -> NDArray[Any]:
    if is_db:
        levels = table.real(column)
        if np.abs(levels).max() > 400:
            what = f"column {column!r} reaches {np.abs(levels).max():g} dB, a ratio of more than 1e20"
            raise refuse(table.path, what, fix="leave out form_db where the columns are no decibels")
        return np.asarray(10.0 ** (levels / 20.0))
    if not imaginary:
        return table[column]
    real, second = table.real(column), table.real(imaginary)
    if real.size != second.size:
        what = f"{column!r} has {real.size} lines, its imaginary part {imaginary!r} {second.size}"
        raise refuse(table.path, what, fix="they do not belong together")
    return real + 1j * second


def _factor(table: Table, column: str, unit: str, si: str) -> float:
    try:
        table.check_unit(column, unit, si)
        return units.factor(unit, si)
    except BadUnit as error:
        raise BadUnit(f"{one_line(table.path)}: column {one_line(column)!r}: {error}") from error
