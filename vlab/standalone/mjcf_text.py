"""Edits of a model's XML text that keep every other character.

The parser gives each element's place in the bytes of its file. Included files count as part of the including element,
as in MuJoCo. Edits change attributes, rename elements or add children. Comments, order, line ends and spelling stay.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

ATTRIBUTE = re.compile(rb"\s+([^\s=/>]+)\s*=\s*(\"[^\"]*\"|'[^']*')")
"""ATTRIBUTE: one attribute of a start tag, with the space before it."""
START = re.compile(rb"<([^\s/>]+)((?:\s+[^\s=/>]+\s*=\s*(?:\"[^\"]*\"|'[^']*'))*)\s*(/?)>")
"""START: a whole start tag, with its name, its attributes and the slash of an empty element."""


@dataclass(eq=False)
class Element:
    """An element of a model's text.

    Parameters
    ----------
    tag : str
        Name of the element.
    attributes : dict of str to str
        Attributes as written.
    file : Path
        File that holds the element.
    start, close : int
        Bytes at which the start tag and the end tag begin; both the same for an empty element.
    parent : Element or None
        Enclosing element; for the children of an included file the one that includes the file.
    children : list of Element
        Direct children, without ``include`` elements.
    """

    tag: str
    attributes: dict[str, str]
    file: Path
    start: int
    close: int
    parent: "Element | None" = None
    children: list["Element"] = field(default_factory=list)

    def iterate(self) -> Iterator["Element"]:
        """Yield the element and all below, in the order of the text."""
        yield self
        for child in self.children:
            yield from child.iterate()


@dataclass(eq=False)
class _Change:
    """Wanted change of one element."""

    tag: str
    attributes: dict[str, str | None] = field(default_factory=dict)
    first: list[str] = field(default_factory=list)
    last: list[str] = field(default_factory=list)


class ModelText:
    """Text of a model with its included files.

    Parameters
    ----------
    path : Path
        Main file.

    Raises
    ------
    ValueError
        The XML is malformed, or a file cannot be found.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.texts: dict[Path, bytes] = {}
        self._changes: dict[Element, _Change] = {}
        self.root = self._read(path, ())

    def _read(self, path: Path, chain: tuple[Path, ...]) -> Element:
        if path in chain:
            raise ValueError(f"{path.name} includes itself")
        text = self.texts[path] = path.read_bytes()
        parser = expat.ParserCreate()
        stack: list[Element] = []
        roots: list[Element] = []

        def begin(tag: str, attributes: dict[str, str]) -> None:
            at = parser.CurrentByteIndex
            parent = stack[-1] if stack else None
            element = Element(tag, attributes, path, at, at, parent)
            stack.append(element)
            if parent is None:
                roots.append(element)
            elif tag == "include":
                for child in self._read(self._found(path, attributes.get("file", "")), (*chain, path)).children:
                    child.parent = parent
                    parent.children.append(child)
            else:
                parent.children.append(element)

        def end(tag: str) -> None:
            stack.pop().close = parser.CurrentByteIndex

        parser.StartElementHandler, parser.EndElementHandler = begin, end
        try:
            parser.Parse(text, True)
        except expat.ExpatError as error:
            raise ValueError(f"{path.name}: malformed XML: {error}") from error
        return roots[0]

    def _found(self, path: Path, name: str) -> Path:
        for folder in (self.path.parent, path.parent):
            if (folder / name).is_file():
                return (folder / name).resolve()
        raise ValueError(f"{path.name}: the included file {name!r} is not there")

    # ---- edits ------------------------------------------------------------------------------------------------------

    def set(self, element: Element, attributes: Mapping[str, str | None], *, tag: str = "") -> None:
        """Set attributes of an element, and its name.

        Parameters
        ----------
        element : Element
            Element of this text.
        attributes : mapping of str to str or None
            New values; None takes the attribute away.
        tag : str
            New name of the element; "" keeps the present one.
        """
        change = self._changes.setdefault(element, _Change(element.tag))
        change.attributes |= attributes
        change.tag = tag or change.tag

    def add(self, parent: Element, text: str, *, is_first: bool = False) -> None:
        """Add a child to an element.

        Parameters
        ----------
        parent : Element
            Element of this text.
        text : str
            XML of the child; lines after the first are indented further.
        is_first : bool
            Whether the child comes before all others instead of after.
        """
        change = self._changes.setdefault(parent, _Change(parent.tag))
        (change.first if is_first else change.last).append(text)

    @property
    def changed(self) -> list[Path]:
        """Files with changes, in order of reading."""
        touched = {element.file for element in self._changes}
        return [path for path in self.texts if path in touched]

    def written(self, path: Path) -> bytes:
        """Return the text of a file with its changes.

        Parameters
        ----------
        path : Path
            File of the model.

        Returns
        -------
        bytes
            New text; the old one if nothing in the file changes.
        """
        text = self.texts[path]
        pieces: list[tuple[int, int, bytes]] = []
        for element, change in self._changes.items():
            if element.file == path:
                pieces += _pieces(text, element, change)
        for start, end, new in sorted(pieces, key=lambda piece: piece[:2], reverse=True):
            text = text[:start] + new + text[end:]
        return text


def escaped(value: str) -> str:
    """Return a text as the value of an attribute in double quotes."""
    return value.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def _pieces(text: bytes, element: Element, change: _Change) -> list[tuple[int, int, bytes]]:
    """Return replaced ranges of a file's bytes."""
    match = START.match(text, element.start)
    if match is None:
        raise ValueError(f"{element.file.name}: the start tag of <{element.tag}> at byte {element.start} is unclear")
    line_end = b"\r\n" if b"\r\n" in text else b"\n"
    space = _indent(text, element.start)
    deeper = _indent(text, element.children[0].start) if _has_own_line(text, element) else space + b"  "
    attributes = _attributes(match[2], change.attributes)
    is_empty, has_children = bool(match[3]), bool(change.first or change.last)
    tag = change.tag.encode()
    end = b"/>" if is_empty and not has_children else b">"
    tail = text[match.end(2) : match.end() - len(match[3]) - 1]  # a space before the bracket stays
    out = [(element.start, match.end(), b"<" + tag + attributes + tail + end)]
    first = b"".join(line_end + _indented(child, deeper, line_end) for child in change.first)
    last = b"".join(_indented(child, deeper, line_end) + line_end for child in change.last)
    if is_empty:
        if has_children:
            lines = first + (line_end + last if last else line_end)
            out = [(element.start, match.end(), out[0][2] + lines + space + b"</" + tag + b">")]
        return out
    if change.tag != element.tag:
        out.append((element.close + 2, element.close + 2 + len(element.tag.encode()), tag))
    if first:
        out[0] = (*out[0][:2], out[0][2] + first)
    if last:
        begin = text.rfind(b"\n", 0, element.close) + 1
        if text[begin : element.close].strip():  # the end tag follows something on its line
            out.append((element.close, element.close, line_end + last + space))
        else:
            out.append((begin, begin, last))
    return out


def _attributes(text: bytes, wanted: Mapping[str, str | None]) -> bytes:
    """Return attributes with changes, the kept ones as written."""
    left, out = dict(wanted), b""
    for match in ATTRIBUTE.finditer(text):
        name = match[1].decode()
        if name not in left:
            out += match[0]
        elif (value := left.pop(name)) is not None:
            head = text[match.start() : match.start(2)]
            out += head + f'"{escaped(value)}"'.encode()
    return out + b"".join(f' {k}="{escaped(v)}"'.encode() for k, v in left.items() if v is not None)


def _indent(text: bytes, at: int) -> bytes:
    begin = text.rfind(b"\n", 0, at) + 1
    return text[begin:at] if not text[begin:at].strip() else b""


def _has_own_line(text: bytes, element: Element) -> bool:
    if not element.children or element.children[0].file != element.file:
        return False
    begin = text.rfind(b"\n", 0, element.children[0].start) + 1
    return not text[begin : element.children[0].start].strip()


def _indented(child: str, space: bytes, line_end: bytes) -> bytes:
    return line_end.join(space + line.encode() for line in child.splitlines())
