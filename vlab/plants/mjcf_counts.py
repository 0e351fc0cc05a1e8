"""Size of an MJCF model from its counts, computed before compilation.

The counts concern copies of copies, points of grids, fields and samples. The limit is memory. Elements made by a count
are charged as a dense matrix, which the laboratory forms; MuJoCo's own time for copies grows likewise. Reserved memory
(the arena of ``size``) is left to MuJoCo, which reports a shortage.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from vlab.errors import BadStructure
from vlab.files.text import one_line

MOST_NUMBERS = 10_000**2
"""MOST_NUMBERS [1]: largest total of 8-byte numbers from a model's counts, 800 MB. The limit allows 10 000 copied
elements."""

Parts = Callable[[Any], Iterable[Any]]
"""Element to the root elements of the files that it includes or attaches."""

_MOST = math.isqrt(MOST_NUMBERS)
_SECTIONS = ("tendon", "equality", "actuator", "sensor", "contact", "deformable")
"""Sections with children that are copied together with their referents."""
_POINT = 4  # elements per point of a flexcomp: a body with three joints
_KEY = 4  # largest count of numbers per element in a keyframe
_FIELDS = {"nsample": 10, "actdim": 1, "dim": 1, "num": 17}
"""Numbers per counted item of an actuator or sensor: past samples, states, values, contacts."""
_RAY = 8  # numbers per pixel of a rangefinder
_PIXEL = 3  # numbers per pixel of a texture's side: up to six sides of four bytes
_VERTEX = 1000  # numbers per vertex of a generated mesh: faces, normals, hull
_HUGE = 10**18


def check_counts(root: Any, label: str, parts: Parts = lambda element: ()) -> None:
    """Refuse a model with counts beyond memory.

    Parameters
    ----------
    root : Element
        Root element of the main file.
    label : str
        Name of the file in messages.
    parts : callable
        See `Parts`.

    Raises
    ------
    BadStructure
        The total is too large; the message names the largest contribution.
    """
    names: dict[str, int] = {}
    known = None
    while known != names:  # a copy includes its referents, and their referents
        known = dict(names)
        elements = list(_made(root, label, parts, names))
        for element, times in elements:
            name = element.get("name")
            if times > 1 and name:
                names[name] = max(times, names.get(name, 1))
    defaults = _defaults(elements)
    everything = sum(times * (1 + _own(element)) for element, times in elements)
    fields = _user_fields(elements) + _KEY * _largest(elements, "size", "nkey")
    asked = [(times * _numbers(element, defaults), element) for element, times in elements]
    total = everything * fields + sum(numbers for numbers, _ in asked)
    if total > MOST_NUMBERS:
        most = max(asked, key=lambda pair: pair[0])
        what = "fields of every element (nuser, user, nkey)" if everything * fields > most[0] else _spelled(most[1])
        raise BadStructure(
            f"{label}: the counts in the model ask for {_said(total)} numbers, most of them for {what}; accepted: up to "
            f"{MOST_NUMBERS} (800 MB); make the counts smaller"
        )


def _made(root: Any, label: str, parts: Parts, names: Mapping[str, int]) -> Iterator[tuple[Any, int]]:
    """Yield every element with its number of copies.

    Included or attached files take the place of their element.

    Raises
    ------
    BadStructure
        There are more copies than rows of the largest dense matrix.
    """
    copies, largest, what = 0, 0, ""
    included: set[int] = set()
    stack: list[tuple[Any, int, bool]] = [(root, 1, False)]
    while stack:
        element, times, is_copy = stack.pop()
        inside = times * (_product(element.get("count")) if element.tag == "replicate" else 1)
        copies += times * _own(element) + (times if is_copy or times > 1 else 0)
        asked = inside if element.tag == "replicate" else times if element.tag == "attach" else times * _own(element)
        if asked > largest:
            largest, what = asked, _spelled(element)
        if copies > _MOST:
            raise BadStructure(
                f"{label}: the counts in the model make more than {_MOST} elements, most of them in {what}; accepted: up to "
                f"{_MOST} copies in all, nested counts multiplied; make the counts smaller"
            )
        yield element, times
        for child in element:
            stack.append((child, inside * _with_what_it_names(element, child, names), is_copy))
        for part in parts(element):
            if element.tag == "include":
                if id(part) in included:  # MuJoCo refuses a repeated inclusion
                    continue
                included.add(id(part))
            stack += [(child, inside, is_copy or element.tag != "include") for child in part]


def _with_what_it_names(section: Any, child: Any, names: Mapping[str, int]) -> int:
    if section.tag not in _SECTIONS or not names:
        return 1
    return max(names.get(value, 1) for part in child.iter() for value in ("", *part.attrib.values()))


def _own(element: Any) -> int:
    """Return the number of elements that one element makes.

    Examples: points of a grid, cells of its interpolation.
    """
    if element.tag not in ("flexcomp", "composite"):
        return 0
    points = _POINT * _product(element.get("count")) if element.get("count") else 0
    nodes = 2 if element.get("dof", "").startswith("quad") else 1  # of a cell, per side
    cells = math.prod(nodes * n + 1 for n in _whole(element.get("cellcount"))) if element.get("cellcount") else 0
    return points + _POINT * cells


def _numbers(element: Any, defaults: Mapping[str, int]) -> int:
    """Return the total of one element's counts."""

    def of(key: str) -> int:
        return _product(element.get(key)) if element.get(key) else defaults.get(key, 0)

    out = sum(weight * of(key) for key, weight in _FIELDS.items() if element.get(key) or key in defaults)
    match element.tag:
        case "size":
            out += of("nuserdata")
        case "hfield":
            out += of("nrow") * of("ncol")
        case "texture":
            out += _PIXEL * of("width") * max(of("width"), of("height"))
        case "mesh" if element.get("builtin"):
            sides = _whole(element.get("params"))[:2]
            out += _VERTEX * (sides[0] * max(sides) if sides else 0)
        case "rangefinder" if element.get("camera"):
            out += _RAY * defaults.get("resolution", 0)
        case "config":
            out += _product(element.get("value")) if len(_whole(element.get("value"))) > 1 else 0
    return out


def _defaults(elements: Iterable[tuple[Any, int]]) -> dict[str, int]:
    """Return the largest implicit counts.

    Sources: default classes, and the cameras of rangefinders.
    """
    out: dict[str, int] = {}
    for element, _ in elements:
        if element.tag == "default":
            for child in element:
                for key in ("width", "height", "nsample", "actdim"):
                    if child.tag != "default" and child.get(key):
                        out[key] = max(out.get(key, 0), _product(child.get(key)))
        if element.tag == "camera" and element.get("resolution"):
            out["resolution"] = max(out.get("resolution", 0), _product(element.get("resolution")))
    return out


def _user_fields(elements: Iterable[tuple[Any, int]]) -> int:
    """Return the largest number of user fields per element.

    Every element of a kind has as many as the largest.
    """
    stated = [
        _product(v) for e, _ in elements if e.tag == "size" for k, v in e.attrib.items() if k.startswith("nuser_")
    ]
    return max([*stated, *(len(e.get("user").split()) for e, _ in elements if e.get("user"))], default=0)


def _largest(elements: Iterable[tuple[Any, int]], tag: str, key: str) -> int:
    return max((_product(e.get(key)) for e, _ in elements if e.tag == tag and e.get(key)), default=0)


def _whole(text: str | None) -> list[int]:
    """Return the numbers of at least 1 in a text, rounded down."""
    numbers = [_number(token) for token in (text or "").split()]
    return [int(min(number, _HUGE)) for number in numbers if number >= 1]


def _number(token: str) -> float:
    for read in (float, float.fromhex):  # MuJoCo accepts exponents and base 16
        try:
            return read(token)
        except (ValueError, OverflowError):
            continue
    return 0.0


def _product(text: str | None) -> int:
    return math.prod(_whole(text))


def _spelled(element: Any) -> str:
    said = " ".join(f"{key}={value!r}" for key, value in element.attrib.items())
    return one_line(f"<{element.tag} {said}".strip() + ">", longest=120)


def _said(count: int) -> str:
    return str(count) if count < _HUGE else "1e18 or more"
