"""JSON lines: one object a line, nested values as columns."""

import io
import json
from collections.abc import Collection, Sequence
from pathlib import Path

from vlab.recordings import files
from vlab.recordings.files import refuse
from vlab.recordings.formats.json_document import table_of_runs
from vlab.recordings.formats.json_runs import Run, is_run
from vlab.recordings.formats.records import table_of
from vlab.recordings.table import Table
from vlab.recordings.workers.rows import Rows

LONGEST_LINE = 2**22
"""LONGEST_LINE [bytes]: longest accepted line."""


def read(
    data: bytes,
    path: Path,
    *,
    names: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    blanks: Collection[str] = frozenset(),
) -> Table:
    """Read a file of JSON lines, see `vlab.recordings.open_table`.

    ``{"joint": {"position": [0.1, 0.2]}}`` gives ``joint.position[0]`` and ``joint.position[1]``. ``null`` is a blank
    cell. Where each line holds lists of samples over a list of times, each line is a run.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    path : Path
        Path of the file, for messages.
    names : sequence of str or None
        Must be None, because the file has its own names.
    columns : sequence of str or None
        Columns to read; all by default.
    blanks : collection of str
        Columns that may have blank cells or NaN.

    Returns
    -------
    Table
        Columns and refusals.

    Raises
    ------
    BadRecording
        A line is no JSON object, or the columns are too large.
    """
    if names is not None:
        raise refuse(path, "JSON lines name their own values", fix="leave out names")
    limit = files.unpacked_limit(len(data))
    rows, runs, stream, number = Rows(limit), list[Run](), io.BytesIO(data), 0
    while line := stream.readline(LONGEST_LINE + 1):
        number += 1
        if len(line) > LONGEST_LINE:
            raise refuse(path, f"line {number} has more than {LONGEST_LINE} bytes", fix="write one object a line")
        if not line.strip():
            continue
        try:
            record = json.loads(line.decode("utf-8-sig" if number == 1 else "utf-8"))
        except (ValueError, RecursionError) as error:
            is_cut = stream.tell() == len(data) and not line.endswith(b"\n")
            fix = "the file is cut short; copy or export it again" if is_cut else "write one JSON object a line"
            raise refuse(path, f"line {number} is not JSON: {error}", fix=fix) from error
        if not isinstance(record, dict):
            raise refuse(
                path, f"line {number} is {type(record).__name__}, not an object", fix='write {"name": value, ...}'
            )
        if runs or (not rows.count and is_run(record)):
            runs.append(Run(str(len(runs)), record))
            continue
        try:
            rows.add(record)
        except (ValueError, OverflowError) as error:
            raise refuse(path, f"line {number}: {error}", fix="cut the recording into parts") from error
    return table_of_runs(runs, path, columns, blanks, limit) if runs else table_of(rows, path, columns, blanks)
