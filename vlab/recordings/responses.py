"""Assembly of frequency responses from columns: forms, units, checks."""

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
from vlab.signals import Array, FrequencyResponse

FORM_UNITS = {"receptance": "m/N", "mobility": "m/s/N", "accelerance": "m/s^2/N"}
"""SI unit of each form of a frequency response."""


class ResponseColumn(Protocol):
    """Column of one response, see `vlab.cases.description.FrfChannelTable`."""

    @property
    def column(self) -> str:
        """Column of complex values, or of the real part."""

    @property
    def at(self) -> str:
        """Output of the response."""

    @property
    def imaginary(self) -> str:
        """Column of the imaginary part, or ""."""

    @property
    def phase(self) -> str:
        """Column of the phase, or ""."""

    @property
    def phase_unit(self) -> str:
        """Unit of the phase."""


class ResponseSpec(Protocol):
    """Description of a file's columns, see `vlab.cases.description.FrfTable`."""

    @property
    def form(self) -> str:
        """One of `FORM_UNITS`."""

    @property
    def form_db(self) -> bool:
        """Whether the columns hold 20 log10 of the magnitude."""

    @property
    def input(self) -> str:
        """Input of the responses."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Outputs of the responses."""

    @property
    def frequency(self) -> str:
        """Column of the frequencies."""

    @property
    def frequency_unit(self) -> str:
        """Unit of the frequencies."""

    @property
    def unit(self) -> str:
        """Unit of the response; the SI unit of the form if empty."""

    @property
    def channel(self) -> Sequence[ResponseColumn]:
        """Columns by output.

        If empty, the columns after the frequency are the outputs in order.
        """


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredResponse(FrequencyResponse):
    """A measured frequency response.

    Parameters
    ----------
    is_magnitude : bool
        Whether the file holds magnitudes only. H is then real with unknown phase.
    notes : tuple of str
        Remarks for a user of the response.
    """

    is_magnitude: bool = False
    notes: tuple[str, ...] = ()

    def to_frd(self) -> Any:
        """Return the response as python-control's `FRD`.

        Raises
        ------
        BadRecording
            The response has magnitudes only.
        """
        if self.is_magnitude:
            raise BadRecording("the response is magnitudes only, its phase is not known; compare magnitudes")
        return super().to_frd()


def to_frequency_response(table: Table, spec: ResponseSpec) -> MeasuredResponse:
    """Label columns as frequency responses and convert to SI.

    Parameters
    ----------
    table : Table
        Columns of the file.
    spec : FrfTable or alike
        Description of the columns.

    Returns
    -------
    MeasuredResponse
        Responses to one input, (n, n_outputs, 1), in the SI unit of the form. A response in dB gives magnitudes, marked
        as such.

    Raises
    ------
    BadRecording
        The columns have unequal length, or fewer columns than outputs exist. Frequencies are negative or do not
        increase. A magnitude is complex, or a real column lacks its imaginary part.
    BadUnit
        A unit is unknown, of another dimension than the form, or contradicts the file.
    UnknownName
        A column is not in the file.
    """
    si = FORM_UNITS.get(spec.form)
    if si is None:
        raise refuse(table.path, f"the form is {spec.form!r}", fix=f"accepted: {', '.join(FORM_UNITS)}")
    freq = read_lines(table, spec.frequency, spec.frequency_unit)
    columns, notes, has_phase = [], [], []
    for output, (column, imaginary, phase, phase_unit) in zip(spec.outputs, _columns(table, spec), strict=True):
        values = read_values(
            table, freq, column, imaginary=imaginary, phase=phase, phase_unit=phase_unit, is_db=spec.form_db
        )
        has_phase.append(bool(phase) or not spec.form_db)
        if not spec.form_db and not np.iscomplexobj(values):
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


def read_lines(table: Table, frequency: str, unit: str) -> Array:
    """Return the frequencies of a file [Hz].

    Parameters
    ----------
    table : Table
        Columns of the file.
    frequency : str
        Column of the frequencies.
    unit : str
        Unit of that column.

    Returns
    -------
    (n,) array
        Increasing frequencies from 0 on, at least two.

    Raises
    ------
    BadRecording
        One line only, or frequencies that are negative, repeated or decreasing.
    BadUnit
        The unit is unknown, of another dimension, or contradicts the file.
    """
    freq = table.real(frequency) * _factor(table, frequency, unit, "Hz")
    if freq.size < 2:
        what = f"{frequency!r} has one line, at {freq[0]:g} Hz"
        raise refuse(table.path, what, fix="a response has at least 2 lines; name the column of the frequencies")
    if freq[0] < 0 or not np.all(np.diff(freq) > 0):
        k = int(np.argmin(np.diff(freq))) + 1 if freq[0] >= 0 else 0
        if k and freq[k] == freq[k - 1]:
            what = f"the frequencies in {frequency!r} do not increase: lines {k - 1} and {k} both are at {freq[k]:g} Hz"
            raise refuse(table.path, what, fix="keep one of the lines")
        what = f"the frequencies in {frequency!r} do not increase from 0 on (line {k} is {freq[k]:g} Hz)"
        raise refuse(table.path, what, fix="name the column of the frequencies")
    return np.asarray(freq, dtype=float)


def read_values(
    table: Table, freq: Array, column: str, *, imaginary: str = "", phase: str = "", phase_unit: str = "", is_db: bool
) -> NDArray[Any]:
    """Return one response in the unit of the file.

    Parameters
    ----------
    table : Table
        Columns of the file.
    freq : (n,) array
        Frequencies.
    column : str
        Column of complex values, real parts or magnitudes.
    imaginary, phase : str
        Column of the imaginary parts or of the phases, or empty.
    phase_unit : str
        Unit of the phases.
    is_db : bool
        Whether the column holds 20 log10 of the magnitude.

    Returns
    -------
    (n,) array
        Complex response, or real values of a column without imaginary part and phase.

    Raises
    ------
    BadRecording
        Unequal lengths, a complex part, or a magnitude below 0 or beyond 400 dB.
    UnknownName
        A column is not in the file.
    """
    values = _values(table, column, imaginary, is_db=is_db)
    if phase:
        values = _turned(table, column, values, phase, phase_unit)
    if values.size != freq.size:
        what = f"column {column!r} has {values.size} lines, the frequencies {freq.size}"
        raise refuse(table.path, what, fix="they do not belong together")
    return values


def _columns(table: Table, spec: ResponseSpec) -> list[tuple[str, str, str, str]]:
    """Return the columns of each output.

    The columns are real (or complex) part, imaginary part and phase, with the phase's unit.
    """
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
    """Return a magnitude with its phase."""
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
