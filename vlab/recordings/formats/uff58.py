"""Data set 58 or 58b of a universal file.

Data set 58 has records 1 to 12 in FORTRAN formats [1]_. Data set 58b has text records and binary samples. No count in a
header is trusted.

References
----------
.. [1] Structural Dynamics Research Laboratory, University of Cincinnati, Universal file formats.
"""

import re
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_DIRECTIONS = {1: "+X", 2: "+Y", 3: "+Z", 4: "+RX", 5: "+RY", 6: "+RZ"}
_DIRECTIONS |= {-code: "-" + text[1:] for code, text in _DIRECTIONS.items()}
_FIELDS_6 = (5, 10, 5, 10, 11, 10, 4, 11, 10, 4)
_FIELDS_7 = (10, 10, 10, 13, 13, 13)
_FIELDS_8 = (10, 5, 5, 5, 21, 21)
_FIELDS_58B = (7, 6, 6, 12, 12, 6, 6, 12, 12)
_SIGNS = b"0123456789+-.eEdD \r\n"
_EDGE = re.compile(rb"[\r\n]{0,2}    -1[ \r\n]|[\r\n]{0,2}    -1$")
CLOCK = "abscissa = "
"""Start of the fifth text line, which holds vlab's exact abscissae. The header rounds abscissae to 6 digits."""
_CLOCK = re.compile(CLOCK + r"(\S+) \+ k (/|\*) (\S+); crc32 ([0-9a-f]{8})")


class Lying(Exception):
    """A data set that contradicts its header."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Function:
    """A function of time, frequency or another abscissa.

    Parameters
    ----------
    ids : tuple of str
        Five lines of free text.
    kind : int
        Function type: 1 a time response, 4 a frequency response.
    response, reference : str
        Node and direction, such as ``"12+Z"``; the reference is empty or ``"0"`` for none.
    abscissa, values : (n,) arrays
        Abscissa as stored or as given by the header, and real or complex ordinates.
    abscissa_type, data_type, reference_type : int
        Specific data types of abscissa, numerator and denominator: 17 time, 18 frequency, 12 acceleration, 13 force.
    abscissa_unit, unit : str
        Unit labels of the file; for the ordinate "numerator/denominator".
    is_even : bool
        Whether the header gives first abscissa and step.
    """

    ids: tuple[str, ...]
    kind: int
    response: str
    reference: str = ""
    abscissa: NDArray[Any]
    values: NDArray[Any]
    abscissa_type: int
    abscissa_unit: str = ""
    unit: str = ""
    data_type: int = 0
    reference_type: int = 0
    is_even: bool

    @property
    def has_reference(self) -> bool:
        """Whether the function has a reference."""
        return self.reference not in ("", "0")


@dataclass(frozen=True)
class _Form:
    """Storage form of the samples, from record 7."""

    is_complex: bool
    is_double: bool
    is_even: bool
    count: int
    start: float
    step: float

    @property
    def per_point(self) -> int:
        return 1 + self.is_complex + (not self.is_even)


def _cut(line: bytes, widths: tuple[int, ...]) -> list[str]:
    text, out, at = line.decode("latin-1").rstrip("\r\n"), [], 0
    for width in widths:
        out.append(text[at : at + width].strip())
        at += width
    return out


def _integer(text: str, what: str) -> int:
    if not re.fullmatch(r"[+-]?\d{0,12}", text, re.ASCII):
        raise Lying(f"{what} is {text!r}, not an integer")
    return int(text or "0")


def _float(text: str, what: str) -> float:
    try:
        value = float(text.upper().replace("D", "E") or "0")
    except ValueError:
        value = float("nan")
    if not np.isfinite(value) or "_" in text:
        raise Lying(f"{what} is {text!r}, not a finite number")
    return value


def read_function(data: bytes, offset: int) -> tuple[Function, int]:
    """Read the data set at an offset.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    offset : int
        Offset of the line with the data set's number.

    Returns
    -------
    tuple of (Function, int)
        Function, and offset after its samples.

    Raises
    ------
    Lying
        A record is missing or damaged, or the number of samples contradicts the header.
    """
    where = f"data set 58 at byte {offset}"
    lines = []
    for _ in range(12):
        end = data.find(b"\n", offset) + 1
        if not end or end - offset > 200:
            raise Lying(f"{where}: its header is cut short or damaged")
        lines.append(data[offset:end])
        offset = end
    try:
        form = _form(lines[7])
        if form.count < 1 or form.count * form.per_point * 4 > len(data) - offset:
            raise Lying(f"it declares {form.count} samples in the {len(data) - offset} bytes that are left")
        is_binary = lines[0][6:7].lower() == b"b"
        values, offset = (_binary if is_binary else _text)(data, offset, form, lines[0])
        return _labelled(lines, form, values), offset
    except Lying as error:
        raise Lying(f"{where}: {error}") from error


def _form(line: bytes) -> _Form:
    kind, count, spacing, start, step, _ = _cut(line, _FIELDS_7)
    code = _integer(kind, "the ordinate data type")
    if code not in (2, 4, 5, 6):
        raise Lying(f"the ordinate data type is {code}; known are 2, 4, 5 and 6")
    even = _integer(spacing, "the abscissa spacing")
    if even not in (0, 1):
        raise Lying(f"the abscissa spacing is {even}; known are 0 and 1")
    form = _Form(
        code > 4,
        code in (4, 6),
        bool(even),
        _integer(count, "the number of samples"),
        _float(start, "the first abscissa"),
        _float(step, "the abscissa increment"),
    )
    if form.is_even and form.step <= 0 and form.count > 1:
        raise Lying(f"the abscissa increment is {form.step:g}; it must be positive")
    return form


def _text(data: bytes, offset: int, form: _Form, head: bytes) -> tuple[NDArray[Any], int]:
    """Read samples as text in fixed columns.

    Formats: 6E13.5, 4E20.12, 2(E13.5,E20.12) or E13.5,2E20.12.
    """
    widths: tuple[int, ...]
    if not form.is_double:
        widths = (13,) * 6
    elif form.is_even:
        widths = (20,) * 4
    else:
        widths = (13, 20) * 2 if form.per_point == 2 else (13, 20, 20)
    total = form.count * form.per_point
    n_lines = -(-total // len(widths))
    end = offset
    for _ in range(n_lines):
        end = data.find(b"\n", end) + 1
        if not end:
            raise Lying(f"it declares {form.count} samples and ends before: the file is truncated")
    block = data[offset:end]
    strange = block.translate(None, _SIGNS)
    if strange:
        is_gap = re.search(rb"(?i)nan|inf|\*\*\*", block) is not None
        what = "NaN, infinite or overflown samples" if is_gap else f"the signs {strange[:20]!r}"
        raise Lying(f"{what} where only numbers may stand")
    lines = block.translate(bytes.maketrans(b"Dd", b"ee")).splitlines()
    if len(lines) != n_lines:
        raise Lying("a carriage return in the middle of a line of samples")
    values = _numbers(lines, widths, total)
    return values.reshape(form.count, form.per_point), end


def _numbers(lines: list[bytes], widths: tuple[int, ...], total: int) -> NDArray[Any]:
    """Return the numbers of fixed-column lines.

    A line of another length is refused.
    """
    edges = [0, *np.cumsum(widths).tolist()]
    full = edges[-1]
    rest = total - (len(lines) - 1) * len(widths)
    for i, line in enumerate(lines):
        length = full if i < len(lines) - 1 else edges[rest]
        if len(line) != length and len(line.rstrip()) != length:
            raise Lying(f"line {i + 1} of the samples is {len(line.rstrip())} signs long, not {length}")
    try:
        table = np.frombuffer(b"".join(line[:full].ljust(full) for line in lines), dtype=np.dtype("S1"))
        cells = table.reshape(len(lines), full)
        columns = [
            np.ascontiguousarray(cells[: len(lines) - (k >= rest), edges[k] : edges[k + 1]]).view(f"S{width}").ravel()
            for k, width in enumerate(widths)
        ]
        values = np.empty((len(lines), len(widths)))
        for k, column in enumerate(columns):
            values[: column.size, k] = column.astype(float)
    except ValueError as error:
        raise Lying(f"the samples are not numbers in columns of {widths}: {error}") from error
    return values.reshape(-1)[:total]


def _binary(data: bytes, offset: int, form: _Form, head: bytes) -> tuple[NDArray[Any], int]:
    """Read binary samples.

    The abscissa of doubles is single precision by the format, or double as written by pyuff.
    """
    order, floats, lines, n_bytes = (_integer(text, "the binary header") for text in _cut(head, _FIELDS_58B)[1:5])
    if order not in (1, 2) or floats != 2 or lines != 11:
        raise Lying(f"its binary form is {order}, {floats}, {lines}; read are IEEE floats (2) after 11 lines")
    real = np.dtype(("<" if order == 1 else ">") + ("f8" if form.is_double else "f4"))
    first = {real} if form.is_even else {real, np.dtype(real.str.replace("8", "4"))}
    forms = [np.dtype([("v0", kind), *((f"v{i}", real) for i in range(1, form.per_point))]) for kind in first]
    for dtype in forms:
        size = form.count * dtype.itemsize
        # pyuff always declares the bytes of the real parts only
        if n_bytes not in (size, form.count * real.itemsize) or not _EDGE.match(data, offset + size):
            continue
        records = np.frombuffer(data, dtype=dtype, count=form.count, offset=offset)
        values = np.column_stack([records[name].astype(float) for name in dtype.names or ()])
        after = offset + size
        while data[after : after + 1] in (b"\r", b"\n"):
            after += 1
        return values, after
    raise Lying(f"it declares {form.count} samples in {n_bytes} bytes, and no end of a data set follows them")


def _labelled(lines: list[bytes], form: _Form, values: NDArray[Any]) -> Function:
    record = _cut(lines[6], _FIELDS_6)
    nodes = [_integer(record[i], "a node or a direction of record 6") for i in (5, 6, 8, 9)]
    axis, above, below = (_cut(line, _FIELDS_8) for line in lines[8:11])
    numerator, denominator = (_no_none(part[5]) for part in (above, below))
    unit = f"({numerator})/({denominator})" if numerator and denominator else numerator
    ids = tuple(line[:80].decode("latin-1").strip() for line in lines[1:6])
    abscissa = form.start + np.arange(form.count) * form.step if form.is_even else values[:, 0]
    if ids[4].startswith(CLOCK) and form.is_even:
        abscissa = _read_clock(ids[4], abscissa)
    ordinate = values if form.is_even else values[:, 1:]
    return Function(
        ids=ids,
        kind=_integer(record[0], "the function type"),
        response=f"{nodes[0]}{_DIRECTIONS.get(nodes[1], '')}",
        reference=f"{nodes[2]}{_DIRECTIONS.get(nodes[3], '')}",
        abscissa=abscissa,
        values=ordinate[:, 0] + 1j * ordinate[:, 1] if form.is_complex else ordinate[:, 0].copy(),
        abscissa_type=_integer(axis[0], "the abscissa's data type"),
        abscissa_unit=_no_none(axis[5]),
        unit=unit,
        data_type=_integer(above[0], "the ordinate's data type"),
        reference_type=_integer(below[0], "the denominator's data type"),
        is_even=form.is_even,
    )


def _no_none(text: str) -> str:
    return "" if text.upper() == "NONE" else text


# ----------------------------------------------------------------------------------------------------------- writing

Clock = tuple[float, str, float]
"""Even abscissae: start, "/" or "*", and rate or step, for start + k / rate or start + k * step."""


def ticks(clock: Clock, count: int) -> NDArray[Any]:
    """Return the abscissae of a clock."""
    start, sign, number = clock
    steps = np.arange(count) / number if sign == "/" else np.arange(count) * number
    return start + steps if start else steps


def clock_of(abscissa: NDArray[Any]) -> tuple[Clock, float]:
    """Return the clock of even abscissae, and its largest error.

    The clock reproduces the abscissae exactly if possible.

    Parameters
    ----------
    abscissa : array
        Even abscissae, (n,).

    Returns
    -------
    tuple of (Clock, float)
        Clock, and largest change [abscissa's unit].
    """
    count, start = abscissa.size, float(abscissa[0])
    if count < 2:
        return (start, "*", 1.0), 0.0
    step = float(abscissa[-1] - abscissa[0]) / (count - 1)
    rates = [round(1 / step, digits) for digits in (0, 3, 6)] + [1 / step]
    steps = [round(step, digits) for digits in (6, 9, 12)] + [float(abscissa[1] - abscissa[0]), step]
    clocks: list[Clock] = [(start, "/", rate) for rate in rates if rate > 0] + [(start, "*", s) for s in steps if s > 0]
    lost = [float(np.abs(ticks(clock, count) - abscissa).max()) for clock in clocks]
    best = int(np.argmin(lost))
    return clocks[best], lost[best]


def clock_text(clock: Clock) -> str:
    """Return a clock as text for `read_function`."""
    text = f"{CLOCK}{clock[0]!r} + k {clock[1]} {clock[2]!r}"
    return f"{text}; crc32 {zlib.crc32(text.encode()):08x}"


def _read_clock(text: str, abscissa: NDArray[Any]) -> NDArray[Any]:
    """Return the abscissae of a clock's text.

    The header's abscissae must agree.
    """
    match = _CLOCK.fullmatch(text)
    if match is None or match[4] != f"{zlib.crc32(text.partition(';')[0].encode()):08x}":
        raise Lying(f"the clock {text!r} is damaged")
    try:
        exact = ticks((float(match[1]), match[2], float(match[3])), abscissa.size)
    except ValueError as error:
        raise Lying(f"the clock {text!r} is damaged") from error
    span = max(abs(exact[0]), abs(exact[-1]))
    if not np.isfinite(exact).all() or np.abs(exact - abscissa).max() > 2e-5 * span:  # the header has 6 digits
        raise Lying(f"the clock {text!r} is not that of the header")
    return exact


def function_text(function: Function, clock: Clock) -> bytes:
    """Return a data set 58b with even abscissae.

    Text records precede little-endian doubles.

    Parameters
    ----------
    function : Function
        Function with even abscissae.
    clock : Clock
        Clock of the abscissae.

    Returns
    -------
    bytes
        Bytes of the data set.
    """
    values = function.values
    is_complex, count = np.iscomplexobj(values), values.size
    step = 1 / clock[2] if clock[1] == "/" else clock[2]
    samples = np.ascontiguousarray(values, dtype="<c16" if is_complex else "<f8").tobytes()
    lines = [
        f"{-1:6d}",
        f"{58:6d}b{1:6d}{2:6d}{11:12d}{len(samples):12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        *(f"{text:<80}" for text in function.ids),
        f"{function.kind:5d}{0:10d}{0:5d}{0:10d} {'NONE':<10}{int(function.response):10d}{0:4d}"
        f" {'NONE':<10}{int(function.reference or 0):10d}{0:4d}",
        f"{6 if is_complex else 4:10d}{count:10d}{1:10d}{clock[0]:13.5e}{step:13.5e}{0.0:13.5e}",
        _axis(function.abscissa_type, function.abscissa_unit),
        _axis(function.data_type, function.unit),
        _axis(0, ""),
        _axis(0, ""),
    ]
    return "\n".join(lines).encode("ascii") + b"\n" + samples + f"\n{-1:6d}\n".encode()


def _axis(data_type: int, unit: str) -> str:
    return f"{data_type:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20} {unit or 'NONE':<20}"
