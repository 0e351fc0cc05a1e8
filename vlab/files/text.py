"""Text from files as it may be shown: nothing in it drives a terminal or forges a line."""


def printable(text: object, *, keep: str = "\n\t") -> str:
    r"""Return text with every character that is not printable written as its escape, such as ``\x1b``.

    These are control characters, marks that turn the direction of writing, characters without width and halves of pairs.

    Parameters
    ----------
    text : object
        Its `str` is taken.
    keep : str
        Characters that stay although they are not printable; ``""`` for text that must stay on its line.

    Returns
    -------
    str
    """
    return "".join(c if c.isprintable() or c in keep else " " if _is_blank(c) else _escape(c) for c in str(text))


def in_line(text: object) -> str:
    """Return text that stays on its line: what ends one is written as an escape, too; see `printable`."""
    return printable(text, keep="")


def one_line(text: object, *, longest: int = 400) -> str:
    """Return text as one printable line, cut to a length, so that it cannot forge or break a message.

    Parameters
    ----------
    text : object
        Its `str` is taken.
    longest : int
        Characters that stay; what was cut is said by three dots.

    Returns
    -------
    str
    """
    spaced = "".join(" " if c.isspace() else c for c in str(text)[: 2 * longest])
    line = " ".join(printable(spaced).split())
    return line if len(line) <= longest else line[:longest] + "..."


def _is_blank(c: str) -> bool:
    """Whether a character is one of the blanks of typesetting; those that end a line are none."""
    return c.isspace() and not c.isascii() and c not in "\x85\u2028\u2029"


def _escape(c: str) -> str:
    code = ord(c)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
