"""Formulas of the pages as MathML, made when the site is built: a page needs neither a script nor the network."""

import html
import re
from typing import Any

from latex2mathml.converter import convert

BLOCK = re.compile(r'<(?P<tag>span|div) class="arithmatex">(?P<tex>.*?)</(?P=tag)>', flags=re.DOTALL)
"""What the extension arithmatex leaves of a formula: LaTeX between the marks of an inline or a displayed formula."""
STYLED = re.compile(r'<mi mathvariant="(?P<style>[a-z-]+)">(?P<letter>[^<]+)</mi>')
LATIN = {
    "bold": (0x1D400, 0x1D41A),
    "bold-italic": (0x1D468, 0x1D482),
    "sans-serif": (0x1D5A0, 0x1D5BA),
    "script": (0x1D49C, 0x1D4B6),
}
GREEK = {"bold": (0x1D6A8, 0x1D6C2), "bold-italic": (0x1D71C, 0x1D736)}
"""Code points of the capital and the small first letter in every style; browsers know no other way to set a letter in one."""


def on_page_content(content: str, **_: Any) -> str:
    """Return a page with all its formulas as MathML."""
    return BLOCK.sub(_mathml, content)


def _mathml(match: re.Match[str]) -> str:
    tex = html.unescape(match["tex"]).strip()
    is_block = tex.startswith(r"\[")
    tex = re.sub(r"^\\[\[(]|\\[\])]$", "", tex).strip()
    formula = STYLED.sub(_letter, convert(tex, display="block" if is_block else "inline"))
    return f'<div class="equation">{formula}</div>' if is_block else formula


def _letter(match: re.Match[str]) -> str:
    """Return a letter in its style as the character of its own that Unicode has for it."""
    style, letter = match["style"], html.unescape(match["letter"])
    for first, table in (("Aa", LATIN), ("Αα", GREEK)):
        for start, code in zip(first, table.get(style, ()), strict=False):
            distance = ord(letter) - ord(start) if len(letter) == 1 else -1
            if 0 <= distance < 26:
                return f"<mi>{chr(code + distance)}</mi>"
    return match[0]
