"""Formulas of the pages as MathML, made when the site is built: a page needs neither a script nor the network."""

import html
import re
from typing import Any

from latex2mathml.converter import convert

BLOCK = re.compile(r'<(?P<tag>span|div) class="arithmatex">(?P<tex>.*?)</(?P=tag)>', flags=re.DOTALL)
"""What the extension arithmatex leaves of a formula: LaTeX between the marks of an inline or a displayed formula."""


def on_page_content(content: str, **_: Any) -> str:
    """Return a page with all its formulas as MathML."""
    return BLOCK.sub(_mathml, content)


def _mathml(match: re.Match[str]) -> str:
    tex = html.unescape(match["tex"]).strip()
    is_block = tex.startswith(r"\[")
    tex = re.sub(r"^\\[\[(]|\\[\])]$", "", tex).strip()
    formula = convert(tex, display="block" if is_block else "inline")
    return f'<div class="equation">{formula}</div>' if is_block else formula
