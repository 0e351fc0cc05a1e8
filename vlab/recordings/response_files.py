"""Frequency responses of a file with names, quantities and units."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab import units
from vlab.errors import BadUnit, unknown_name
from vlab.files.text import one_line
from vlab.modal.quantities import DRIVES, kind_of_unit, response_unit_of, split_unit
from vlab.recordings.files import refuse
from vlab.recordings.response_labels import ResponseLabel, frequency_column, labels_of_complex, labels_of_pairs
from vlab.recordings.responses import MeasuredResponse, read_lines, read_values
from vlab.recordings.table import Table
from vlab.signals import KIND_UNITS, ORDER, ComplexArray

_MOTIONS, _INPUTS = tuple(ORDER), (*DRIVES, *ORDER)


@dataclass(frozen=True)
class SideSpec:
    """Description of an output or input by a user.

    Parameters
    ----------
    name : str
        Name of the output or input, or column of an output.
    kind : str
        One of `vlab.signals.KIND_UNITS`; from the file if empty.
    unit : str
        Unit in the file; the file's or the SI unit if empty.
    """

    name: str
    kind: str = ""
    unit: str = ""


@dataclass(frozen=True)
class _Column:
    """A response in SI with its label."""

    label: ResponseLabel
    frequency: str
    unit: str
    H: ComplexArray


def response_labels(table: Table, *, frequency: str | None = None) -> tuple[ResponseLabel, ...]:
    """Return the frequency responses among the columns.

    A universal file states function types. In any other file, complex columns are responses. Without complex columns,
    pairs of real columns beside a column of frequencies are, see `vlab.recordings.response_labels.labels_of_pairs`.

    Parameters
    ----------
    table : Table
        Columns of a file.
    frequency : str, optional
        Column of the frequencies.

    Returns
    -------
    tuple of ResponseLabel
        Labels in file order; empty for a recording.
    """
    if table.channels is not None:
        return ()
    if table.responses is not None:
        return table.responses
    found = [name for name in table.names if np.iscomplexobj(table[name])]
    if found:
        return tuple(labels_of_complex(found, table.units, table.refused))
    axis = frequency or frequency_column(table.names, table.units)
    if not axis:
        return ()
    return tuple(labels_of_pairs([name for name in table.names if name != axis], table.units, table.refused))


def read_responses(
    table: Table,
    *,
    inputs: Sequence[SideSpec] = (),
    outputs: Sequence[SideSpec] = (),
    frequency: str | None = None,
    is_part: bool = False,
) -> tuple[MeasuredResponse, ...]:
    """Return the frequency responses of a file in SI.

    Parameters
    ----------
    table : Table
        Columns of the file.
    inputs, outputs : sequence of SideSpec
        Chosen inputs and outputs; all if empty. An input also names what the file leaves unnamed.
    frequency : str, optional
        Column of the frequencies; by default the column of that name.
    is_part : bool
        Whether other files may have the names, see `check_names`.

    Returns
    -------
    tuple of MeasuredResponse
        Responses, one for each input, unit and column of frequencies; empty if none is chosen.

    Raises
    ------
    BadRecording
        No responses, no column of frequencies, or a response without a unit. Or values that are no responses.
    BadUnit
        A unit is unknown, or contradicts the file.
    UnknownName
        The file has no such input, output or column.
    """
    labels = response_labels(table, frequency=frequency)
    if not labels:
        fix = "give complex columns, or pairs such as 'acc real' and 'acc imag', or 'acc magnitude' and 'acc phase'"
        raise refuse(table.path, "no frequency response with magnitude and phase among the columns", fix=fix)
    if not is_part:
        check_names(labels, inputs=inputs, outputs=outputs, where=one_line(table.path))
    columns, notes, unsure = [], [], []
    for label, output, given in _chosen(labels, inputs, outputs):
        column, said = _read(table, label, output, given, frequency)
        columns.append(column)
        notes += [note for note in said if note not in notes]
        unsure.append(bool(said))
    if len(columns) > 1 and any(unsure) and not all(unsure):
        one = columns[unsure.index(True)].label
        what = f"column {one.column!r} states no unit, and other responses do"
        raise refuse(table.path, what, fix=f"name it, such as --output {one.output}=acceleration,g")
    groups: dict[tuple[str, str, str], list[_Column]] = {}
    for column in columns:
        groups.setdefault((column.label.input, column.unit, column.frequency), []).append(column)
    return tuple(_together(table, group, notes if not i else []) for i, group in enumerate(groups.values()))


def check_names(
    labels: Sequence[ResponseLabel], *, inputs: Sequence[SideSpec], outputs: Sequence[SideSpec], where: str
) -> None:
    """Refuse names that no response has.

    Parameters
    ----------
    labels : sequence of ResponseLabel
        Responses of one or more files.
    inputs, outputs : sequence of SideSpec
        Chosen inputs and outputs.
    where : str
        Files, for the message.

    Raises
    ------
    UnknownName
        No response has an input, output or column of that name. One input may name what the files leave unnamed.
    """
    known = list(dict.fromkeys(label.output for label in labels))
    for spec in outputs:
        if spec.name not in known and all(spec.name != label.column for label in labels):
            raise unknown_name("output", spec.name, known, where=where)
    given = list(dict.fromkeys(label.input for label in labels if label.input))
    is_unnamed = any(not label.input for label in labels)
    for spec in inputs:
        if spec.name not in given and not (is_unnamed and len(inputs) == 1):
            raise unknown_name("input", spec.name, given, where=where)


def _chosen(
    labels: Sequence[ResponseLabel], inputs: Sequence[SideSpec], outputs: Sequence[SideSpec]
) -> list[tuple[ResponseLabel, SideSpec, SideSpec]]:
    """Return chosen labels with the user's descriptions."""
    chosen = []
    for label in labels:
        output = next((s for s in outputs if s.name in (label.output, label.column)), None)
        into = next((s for s in inputs if s.name == label.input or not label.input), None)
        if (outputs and output is None) or (inputs and into is None):
            continue
        own = replace(label, output=output.name if output else label.output, input=into.name if into else label.input)
        chosen.append((own, output or SideSpec(name=label.output), into or SideSpec(name=label.input)))
    return chosen


def _read(
    table: Table, label: ResponseLabel, output: SideSpec, given: SideSpec, frequency: str | None
) -> tuple[_Column, list[str]]:
    """Return a response in SI, and remarks."""
    axis = frequency or label.frequency or frequency_column(table.names, table.units)
    if not axis:
        fix = f"name it with --frequency (columns: {', '.join(table.names[:20])})"
        raise refuse(table.path, "no column is named f or frequency", fix=fix)
    freq = read_lines(table, axis, table.units.get(axis) or "Hz")
    is_db = bool(label.phase) and table.units.get(label.column, "").lower().startswith("db")
    values = read_values(
        table,
        freq,
        label.column,
        imaginary=label.imaginary,
        phase=label.phase,
        phase_unit=_phase_unit(table, label.phase),
        is_db=is_db,
    )
    stated = "" if is_db else table.units.get(label.column, "")
    above, below = split_unit(stated)
    motion, over, said = _side(table, label, output, label.motion, above, _MOTIONS)
    drive, under, also = _side(table, label, given, label.drive, below, _INPUTS, is_input=True)
    si = [KIND_UNITS[motion] or "", KIND_UNITS[drive] or ""]
    try:
        if kind_of_unit(above, _MOTIONS):
            pair = (f"({over})/({under})", response_unit_of(*si)) if below else (over, si[0])
            table.check_unit(label.column, *pair)
        factor = units.factor(over, si[0]) / units.factor(under, si[1])
    except BadUnit as error:
        raise BadUnit(f"{one_line(table.path)}: column {one_line(label.column)!r}: {error}") from error
    named = replace(label, input=label.input or drive)
    return _Column(named, axis, response_unit_of(*si), np.asarray(values * factor)), said + also


def _side(
    table: Table,
    label: ResponseLabel,
    spec: SideSpec,
    header: str,
    stated: str,
    accepted: tuple[str, ...],
    *,
    is_input: bool = False,
) -> tuple[str, str, list[str]]:
    """Return kind and unit of an output or input, and remarks.

    A user's description precedes the stated unit, and the unit precedes the header's data type.
    """
    name = (label.input if is_input else label.output) or "FORCE"
    option = f"--input {name}=force,N" if is_input else f"--output {name}=acceleration,g"
    side = "input" if is_input else "output"
    if spec.kind and spec.kind not in accepted:
        raise refuse(table.path, f"{side} {name!r} is of kind {spec.kind!r}", fix=f"accepted: {', '.join(accepted)}")
    by_unit = kind_of_unit(stated, accepted)
    if spec.kind:
        return spec.kind, spec.unit or (stated if by_unit == spec.kind else "") or KIND_UNITS[spec.kind] or "", []
    if by_unit and header and by_unit != header:
        what = f"column {label.column!r}: the header states {side} {header} and the unit {stated!r}, of {by_unit}"
        raise refuse(table.path, what, fix=f"say which with {option}")
    if by_unit:
        return by_unit, stated, []
    if header and not stated:
        return header, KIND_UNITS[header] or "", [_taken(table, header)]
    what = f"column {label.column!r} has the unit {stated!r}" if stated else f"column {label.column!r} has no unit"
    where = "of its input" if is_input else "of its output"
    raise refuse(table.path, f"{what}: the quantity {where} is not known", fix=f"name it, such as {option}")


def _taken(table: Table, kind: str) -> str:
    return (
        f"{one_line(table.path.name)} states {kind} without a unit: {KIND_UNITS[kind]} is taken; frequencies, damping ratios "
        "and shapes do not depend on that unit."
    )


def _phase_unit(table: Table, phase: str) -> str:
    """Return the stated unit of phases, or degrees if radians are excluded."""
    if not phase or table.units.get(phase):
        return table.units.get(phase, "") or "deg"
    if np.abs(table.real(phase)).max() <= 2 * np.pi:
        what = f"column {phase!r} reaches {np.abs(table.real(phase)).max():.3g} and states no unit"
        raise refuse(table.path, what, fix=f"name its unit in the file, such as '{phase} [rad]' or '{phase} [deg]'")
    return "deg"


def _together(table: Table, group: Sequence[_Column], notes: Sequence[str]) -> MeasuredResponse:
    """Return the responses to one input as one.

    Repeated responses of an output are averaged, with a remark.
    """
    by_output: dict[str, list[ComplexArray]] = {}
    for column in group:
        by_output.setdefault(column.label.output, []).append(column.H)
    first = group[0]
    repeated = [
        f"{one_line(table.path.name)}: {len(same)} responses of {output} to {first.label.input} are averaged."
        for output, same in by_output.items()
        if len(same) > 1
    ]
    return MeasuredResponse(
        freq=read_lines(table, first.frequency, table.units.get(first.frequency) or "Hz"),
        H=np.stack([np.mean(same, axis=0) for same in by_output.values()], axis=1)[:, :, None],
        outputs=tuple(by_output),
        inputs=(first.label.input,),
        unit=first.unit,
        notes=(*notes, *repeated),
    )
