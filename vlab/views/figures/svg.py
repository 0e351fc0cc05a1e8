"""Export of figures: SVG for HTML, PNG for the Rerun viewer."""

import hashlib
import io
import re

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from vlab.views.figures.style import STYLE

SVG_SALT = "vlab"


def to_svg(figure: Figure) -> str:
    """Return a figure as an ``<svg>`` element for HTML.

    Equal figures give equal text, without dates. Text stays text. Identifiers derive from the content, so figures in
    one page do not clash.

    Parameters
    ----------
    figure : Figure
        Figure.

    Returns
    -------
    str
        SVG element.
    """
    buffer = io.StringIO()
    with mpl.rc_context({**STYLE, "svg.fonttype": "none", "svg.hashsalt": SVG_SALT, "path.simplify": True}):
        # the canvas draws once; `savefig` draws twice
        no_metadata = {"Date": None, "Creator": None, "Format": None, "Type": None}
        FigureCanvasSVG(figure).print_svg(buffer, metadata=no_metadata)
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*|<!--.*?-->\s*", "", svg, flags=re.S)
    svg = re.sub(r'(?<= d=")[^"]*', _shortened, svg)
    used = set(re.findall(r'(?:url\(|href=")#([^")]+)', svg))
    mark = "f" + hashlib.sha256(svg.encode()).hexdigest()[:8]
    svg = re.sub(r'(?<=<)([A-Za-z]+)((?: [^<>]*?)?) id="([^"]*)"', lambda m: _identified(m, used, mark), svg)
    return re.sub(r'(url\(|href=")#', rf"\g<1>#{mark}-", svg)


def _shortened(path: re.Match[str]) -> str:
    """Round the coordinates of a path."""
    digits = 1 if len(path[0]) > 2000 else 2
    return re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.{digits}f}", path[0])


def _identified(tag: re.Match[str], used: set[str], mark: str) -> str:
    return f'{tag[1]}{tag[2]} id="{mark}-{tag[3]}"' if tag[3] in used else f"{tag[1]}{tag[2]}"


def to_png(figure: Figure, *, dpi: int = 130) -> bytes:
    """Return a figure as a PNG image."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()
