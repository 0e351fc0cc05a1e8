"""Safe text from files: no terminal control, no forged lines."""

import re

VOWELS, SPELT = "aeio", ("ndarray", "MjModel", "MjSpec", "MjData")
"""VOWELS: first letters of words with the article an. SPELT: names that begin with the sound of a letter's name."""
MOST_PLAIN = 1e6
"""MOST_PLAIN [1]: size of a number from which a sentence takes an exponent."""
IDENTIFIER = re.compile(r"\S*(?:[_@/\\\d]|[:.]\w)")
"""IDENTIFIER: start of a text whose first word is a name of a place, an effect or a file."""


def printable(text: object, *, keep: str = "\n\t") -> str:
    r"""Return text with nonprintable characters as escapes, such as ``\x1b``.

    Nonprintable are control characters, marks of writing direction, characters without width and halves of surrogate
    pairs.

    Parameters
    ----------
    text : object
        Object, converted by `str`.
    keep : str
        Nonprintable characters to keep; ``""`` for text on a single line.

    Returns
    -------
    str
        Printable text.
    """
    return "".join(c if c.isprintable() or c in keep else " " if _is_blank(c) else _escape(c) for c in str(text))


def in_line(text: object) -> str:
    """Return text on one line, with line ends as escapes.

    See `printable`.
    """
    return printable(text, keep="")


def one_line(text: object, *, longest: int = 400) -> str:
    """Return text as one printable line of limited length.

    The result cannot forge or break a message.

    Parameters
    ----------
    text : object
        Object, converted by `str`.
    longest : int
        Largest number of characters; three dots mark a cut.

    Returns
    -------
    str
        One line.
    """
    spaced = "".join(" " if c.isspace() else c for c in str(text)[: 2 * longest])
    line = " ".join(printable(spaced).split())
    return line if len(line) <= longest else line[:longest] + "..."


def in_digits(value: float, digits: int = 3) -> str:
    """Return a number without an exponent, for a sentence.

    Parameters
    ----------
    value : float
        Number.
    digits : int
        Significant digits.

    Returns
    -------
    str
        ``"7940"`` and not ``"7.94e+03"``.
    """
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < MOST_PLAIN else text


def _is_blank(c: str) -> bool:
    """Return whether a character is a typographic blank.

    Characters that end a line do not count.
    """
    return c.isspace() and not c.isascii() and c not in "\x85\u2028\u2029"


def _escape(c: str) -> str:
    code = ord(c)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def with_article(word: str) -> str:
    """Return a word with its indefinite article.

    Parameters
    ----------
    word : str
        Noun, such as the name of a type; ``"NoneType"`` becomes ``"None"``.

    Returns
    -------
    str
        Such as ``"an int"`` or ``"a str"``.
    """
    if word == "NoneType":
        return "None"
    return f"{'an' if word[:1].lower() in VOWELS or word in SPELT else 'a'} {word}"


def as_sentence(text: str) -> str:
    """Return a text with a capital letter and one full stop.

    A name at the start, such as ``gain:elbow`` or ``case.toml``, keeps its letters.

    Parameters
    ----------
    text : str
        Sentence that begins in lower case.

    Returns
    -------
    str
        Sentence.
    """
    first = text[:1] if IDENTIFIER.match(text) else text[:1].upper()
    return f"{first}{text[1:].rstrip('.')}."
