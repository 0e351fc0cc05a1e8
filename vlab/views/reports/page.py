"""HTML reports in one file, readable offline, with all content escaped."""

import base64
import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from vlab.errors import VlabError
from vlab.files.text import printable
from vlab.recordings.files import written_whole

TEMPLATES = Path(__file__).parent / "templates"
_SVG_TAGS = {
    *("svg", "g", "defs", "style", "path", "use", "text", "tspan", "title", "desc", "clipPath", "rect", "circle"),
    *("ellipse", "line", "polyline", "polygon", "image", "linearGradient", "radialGradient", "stop", "pattern"),
}


class BadFigure(VlabError, ValueError):
    """Figure that is not a plain SVG drawing."""


@dataclass(frozen=True, kw_only=True)
class Section:
    """Part of a report.

    Parameters
    ----------
    title : str
        Heading.
    text : sequence of str
        Paragraphs.
    tables : sequence of (headers, rows)
        Text or numbers; floats have four digits, None and NaN a dash.
    figures : sequence of (svg, caption)
        Drawings of `vlab.views.figures.to_svg`.

    Raises
    ------
    BadFigure
        A drawing is not SVG, or holds scripts or external references.
    """

    title: str
    text: Sequence[str] = ()
    tables: Sequence[tuple[Sequence[str], Sequence[Sequence[Any]]]] = ()
    figures: Sequence[tuple[str, str]] = ()

    def __post_init__(self) -> None:
        if isinstance(self.text, str):
            object.__setattr__(self, "text", (self.text,))
        for headers, rows in self.tables:
            for row in rows:
                if len(row) != len(headers):
                    raise ValueError(f"section {self.title!r}: a row of {len(row)} cells under {len(headers)} headers")
        for svg, caption in self.figures:
            _check_svg(svg, caption)


@dataclass(frozen=True, kw_only=True)
class Headline:
    """Answer of a page in one glance.

    Parameters
    ----------
    badge : str
        Verdict in two or three words.
    tone : str
        ``"found"``, ``"fine"``, ``"open"`` or ``"stopped"``: colour of the badge.
    sentence : str
        Verdict in one sentence.
    pair : sequence of (label, value)
        The numbers before and after.
    command : str
        Next command, run from the folder of the page; empty for none.
    """

    badge: str
    tone: str
    sentence: str
    pair: Sequence[tuple[str, str]] = ()
    command: str = ""


def write_report(
    path: Path | str,
    *,
    title: str,
    sections: Sequence[Section],
    summary: Sequence[str] = (),
    headline: Headline | None = None,
) -> Path:
    """Write a report as one self-contained HTML file.

    Parameters
    ----------
    path : path
        Output file, which appears whole or not at all.
    title : str
        Title of the page.
    sections : sequence of Section
        Sections in reading order.
    summary : sequence of str
        Paragraphs under the title.
    headline : Headline or None
        Answer above the summary.

    Returns
    -------
    Path
        Written file.

    Raises
    ------
    OutputRefused
        The file cannot be written.
    """
    path = Path(path)
    page = _environment().get_template("report.html")
    script = (TEMPLATES / "zoom.js").read_text(encoding="utf-8")
    allowed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    html = page.render(
        title=title,
        sections=sections,
        summary=summary,
        headline=headline,
        script=Markup(script),
        allowed=Markup(allowed),
    )
    with written_whole(path) as stream:
        stream.write(html.encode("utf-8", errors="replace"))
    return path


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        finalize=_plain,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(cell=_cell, number_columns=_number_columns, svg=Markup)
    return environment


def _plain(value: object) -> object:
    """Return a text without control characters.

    A number stays on the line of its per cent sign.
    """
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    return re.sub(r"(?<=\d) %", "\N{NO-BREAK SPACE}%", printable(value))


def _number_columns(rows: Sequence[Sequence[object]]) -> list[bool]:
    """Return the flush-right columns: those with nothing but numbers.

    A column of places such as 40in is text.
    """
    return [all(_is_number(value) for value in column) for column in zip(*rows, strict=True)]


def _is_number(value: object) -> bool:
    """Return whether a cell reads like a number."""
    if isinstance(value, str):
        return re.fullmatch(r"\s*[-–]?\s*|\s*[-+±]?\d[\d.,]*(e[-+]?\d+)?\s*(%|[A-Za-z/²]{1,4})?\s*", value) is not None
    return value is None or isinstance(value, (int, float)) or hasattr(value, "dtype")


def _cell(value: object) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _check_svg(svg: str, caption: str) -> None:
    """Refuse an SVG with more than a drawing.

    Raises
    ------
    BadFigure
        The text is not well-formed, or has a document type or an element or reference foreign to drawings.
    """
    if not svg.lstrip().startswith("<svg") or "<!" in svg:
        raise BadFigure(f"figure {caption!r} is not an <svg> element; make it with vlab.views.figures.to_svg")
    try:
        root = ElementTree.fromstring(svg)
    except ElementTree.ParseError as error:
        raise BadFigure(f"figure {caption!r} is not well-formed SVG: {error}") from error
    for element in root.iter():
        tag = str(element.tag).rpartition("}")[2]
        if tag not in _SVG_TAGS:
            raise BadFigure(f"figure {caption!r} holds a <{tag}> element; a drawing has none")
        for name, value in element.attrib.items():
            bare = name.rpartition("}")[2].lower()
            is_outside = bare == "href" and not value.startswith(("#", "data:image/png"))
            if bare.startswith("on") or is_outside or re.search(r"url\(\s*['\"]?[^#'\"\s]", value):
                raise BadFigure(
                    f"figure {caption!r}: <{tag}> has {bare}={value[:40]!r}; a drawing refers to itself only"
                )
        if tag == "style" and re.search(r"@import|url\(", element.text or ""):
            raise BadFigure(f"figure {caption!r}: its style refers to elsewhere; a drawing refers to itself only")
