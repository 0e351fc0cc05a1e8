"""Reports: one file, nothing from outside, everything escaped, whole or not at all."""

import base64
import hashlib
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from vlab.errors import OutputRefused
from vlab.signals import Channel, Recording
from vlab.views.figures import to_svg, traces_figure
from vlab.views.reports.page import BadFigure, Section, write_report

HOSTILE = "<script>alert(1)</script>"


class Tags(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))


def hostile_figure() -> str:
    time = np.arange(100) / 100
    channel = Channel(name=HOSTILE, kind="other", unit="V")
    return to_svg(traces_figure([(HOSTILE, Recording(time=time, data=time[:, None], channels=(channel,)))]))


def hostile_report(path):
    cells = (["mode", HOSTILE], [[1, HOSTILE], [2.5, None]])
    section = Section(title=HOSTILE, text=[HOSTILE], tables=[cells], figures=[(hostile_figure(), HOSTILE)])
    return write_report(path, title=HOSTILE, sections=[section] * 3, summary=[HOSTILE])


def test_hostile_names_are_escaped_everywhere(tmp_path):
    html = hostile_report(tmp_path / "report.html").read_text(encoding="utf-8")
    tags = Tags()
    tags.feed(html)
    assert [tag for tag, _ in tags.found].count("script") == 1  # the page's own, the only one that its policy allows
    (script,) = re.findall(r"<script>(.*?)</script>", html, flags=re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in html
    assert "alert" not in script
    assert html.count("&lt;script&gt;") > 10


def test_report_needs_nothing_from_outside(tmp_path):
    html = hostile_report(tmp_path / "report.html").read_text(encoding="utf-8")
    tags = Tags()
    tags.feed(html)
    for tag, attributes in tags.found:
        assert tag not in ("link", "iframe", "object", "embed", "base", "img"), tag
        for name in ("src", "href", "xlink:href"):
            assert (attributes.get(name) or "#").startswith("#"), (tag, attributes)
    assert not re.search(r"@import|@font-face", html)
    assert "default-src 'none'" in html


def test_equal_reports_are_equal_bytes(tmp_path):
    one, two = hostile_report(tmp_path / "a.html"), hostile_report(tmp_path / "b.html")
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize(
    ("svg", "match"),
    [
        ("<p>no</p>", "not an <svg>"),
        ("<svg><g></svg>", "not well-formed"),
        ("<svg><script>alert(1)</script></svg>", "script"),
        ('<svg><g onload="alert(1)"/></svg>', "onload"),
        ('<svg xmlns:x="http://www.w3.org/1999/xlink"><use x:href="http://example.org/a#b"/></svg>', "href"),
        ('<svg><rect style="fill: url(http://example.org/a)"/></svg>', "style"),
        ('<svg><style>@import "http://example.org/a.css";</style></svg>', "style"),
        ("<svg><foreignObject/></svg>", "foreignObject"),
        ('<!DOCTYPE svg [<!ENTITY a "b">]><svg>&a;</svg>', "not an <svg>"),
    ],
)
def test_a_figure_that_is_more_than_a_drawing_is_refused(svg, match):
    with pytest.raises(BadFigure, match=match):
        Section(title="s", figures=[(svg, "figure")])


def test_rows_must_fit_their_headers():
    with pytest.raises(ValueError, match="3 cells under 2 headers"):
        Section(title="s", tables=[(["a", "b"], [[1, 2, 3]])])


def test_a_report_that_cannot_be_written_leaves_nothing(tmp_path):
    with pytest.raises(OutputRefused):
        write_report(tmp_path / "missing" / "report.html", title="t", sections=[])
    assert list(tmp_path.iterdir()) == []


def test_a_column_of_names_stands_left_even_where_one_looks_like_a_length(tmp_path):
    tables = [(["actuator", "rms"], [["40in", 0.02], ["base", 0.03]])]
    page = write_report(tmp_path / "r.html", title="t", sections=[Section(title="s", tables=tables)]).read_text()
    assert "<td>40in</td>" in page
    assert '<td class="number">0.02</td>' in page
    assert '<th scope="col">actuator</th>' in page
