"""Vectors in a Parquet column: one column for each element.

Robot data sets keep the joints of a sample in one list: ``action`` holds ``action[0]``, ``action[1]`` and so on. A struct
``imu`` holds ``imu.x``. All lists of a column have one length.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from vlab.recordings.formats.parquet_times import is_time
from vlab.recordings.table import MAX_COLUMNS


def is_numeric(kind: Any) -> bool:
    """Return whether values of an Arrow type are numbers."""
    return pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)


def is_vector(kind: Any) -> bool:
    """Return whether an Arrow type holds lists or structs."""
    if pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        return is_numeric(kind.value_type)
    return pa.types.is_struct(kind) and any(is_numeric(field.type) for field in kind)


def field_of(name: str, fields: Sequence[str]) -> str:
    """Return the field of a file that holds an element.

    Parameters
    ----------
    name : str
        Name of an element, such as ``observation.state[2]``.
    fields : sequence of str
        Fields of the file.

    Returns
    -------
    str
        Field, or the name itself.
    """
    if name in fields:
        return name
    candidates = [f for f in fields if name.startswith((f"{f}[", f"{f}."))]
    return max(candidates, key=len, default=name)


def elements(name: str, column: Any, refused: dict[str, str]) -> Iterator[tuple[str, Any]]:
    """Yield name and Arrow column of each element.

    Parameters
    ----------
    name : str
        Name of the field.
    column : ChunkedArray
        Samples of the field.
    refused : dict of str to str
        Receives the reason of a refusal.

    Yields
    ------
    tuple of (str, ChunkedArray)
        Element and its samples.
    """
    if not is_vector(column.type):
        yield name, column
        return
    whole = column.combine_chunks()
    whole = pa.concat_arrays(whole.chunks) if isinstance(whole, pa.ChunkedArray) else whole
    if pa.types.is_struct(column.type):
        refused[name] = f"it holds {column.type}; name a part, such as {name}.{column.type.field(0).name}"
        for i, field in enumerate(column.type):
            if is_numeric(field.type):
                yield f"{name}.{field.name}", pa.chunked_array([whole.flatten()[i]])
        return
    if whole.null_count:
        first = int(np.argmax(whole.is_null().to_numpy(zero_copy_only=False)))
        refused[name] = f"empty at sample {first} ({whole.null_count} of {len(whole)} lists are empty)"
        return
    lengths = np.unique(whole.value_lengths().to_numpy(zero_copy_only=False))
    if len(lengths) != 1 or not 0 < lengths[0] <= MAX_COLUMNS:
        refused[name] = f"it holds lists of {lengths.min()} to {lengths.max()} numbers; all must be of one length"
        return
    count, values = int(lengths[0]), whole.flatten()
    refused[name] = f"it holds lists of {count} numbers; name an element, such as {name}[0]"
    for i in range(count):
        yield f"{name}[{i}]", pa.chunked_array([values.take(pa.array(np.arange(i, len(values), count)))])


def all_names(file: Any) -> list[str]:
    """Return a Parquet file's columns with its vectors' elements.

    Parameters
    ----------
    file : ParquetFile
        File; the first row gives the length of its lists.

    Returns
    -------
    list of str
        Names in file order.
    """
    vectors = [field.name for field in file.schema_arrow if is_vector(field.type)]
    row = next(file.iter_batches(batch_size=1, columns=vectors), None) if vectors else None
    out: list[str] = []
    for field in file.schema_arrow:
        if is_numeric(field.type) or is_time(field.type):
            out.append(field.name)
        elif row is not None and field.name in vectors:
            out += [name for name, _ in elements(field.name, pa.chunked_array([row.column(field.name)]), {})]
    return out
