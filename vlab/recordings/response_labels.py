"""Labels of frequency responses, from headers or column names."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

_FREQUENCY = re.compile(r"(.*\.)?(f|(?i:freq|freqs|frequency|frequencies|hz))([ _]*\(?[Hh]z\)?)?")  # F is a force
_PARTS = {
    **dict.fromkeys(("real", "re"), "real"),
    **dict.fromkeys(("imaginary", "imag", "im"), "imaginary"),
    **dict.fromkeys(("magnitude", "mag", "amplitude", "ampl", "amp", "abs"), "magnitude"),
    **dict.fromkeys(("phase", "angle", "arg"), "phase"),
}
_PART = re.compile(rf"(?<![a-z])({'|'.join(sorted(_PARTS, key=len, reverse=True))})(?![a-z])")
_UNIT = re.compile(r"\s*\[[^\[\]]*\]\s*$")
_ROUND_UNIT = re.compile(r"\s*\(([^()]*)\)\s*$")
_MATRIX = re.compile(r"(.*)_(\d+)_(\d+)")


@dataclass(frozen=True, kw_only=True)
class ResponseLabel:
    """Label of a frequency response.

    Parameters
    ----------
    output, input : str
        Names; the input is empty if the file names none.
    motion, drive : str
        Kinds of output and input that the header states, see `vlab.signals.KIND_UNITS`; empty if the header states none.
    column : str
        Column of complex values, real parts or magnitudes.
    imaginary, phase : str
        Columns of imaginary part or phase, or empty.
    frequency : str
        Column of the frequencies; empty if the file has one for all.
    """

    output: str
    input: str = ""
    motion: str = ""
    drive: str = ""
    column: str
    imaginary: str = ""
    phase: str = ""
    frequency: str = ""


def frequency_column(names: Iterable[str], stated: Mapping[str, str]) -> str:
    """Return the column of the frequencies, or an empty text.

    Parameters
    ----------
    names : iterable of str
        Real columns.
    stated : mapping of str to str
        Units that the file states.
    """
    return next((name for name in names if _FREQUENCY.fullmatch(_without_unit(name, stated))), "")


def labels_of_complex(names: Iterable[str], stated: Mapping[str, str], split: Iterable[str]) -> list[ResponseLabel]:
    """Return labels of complex columns from their names.

    ``acc/hammer`` is the output ``acc`` from the input ``hammer``. ``H_2_1`` is output 2 and input 1 of the array ``H``.

    Parameters
    ----------
    names : iterable of str
        Complex columns.
    stated : mapping of str to str
        Units that the file states.
    split : iterable of str
        Names of arrays that were split into columns.

    Returns
    -------
    list of ResponseLabel
        One label a column.
    """
    arrays = set(split)
    return [_label(name, _without_unit(name, stated), arrays, column=name) for name in names]


def labels_of_pairs(names: Iterable[str], stated: Mapping[str, str], split: Iterable[str]) -> list[ResponseLabel]:
    """Return labels of pairs of real columns.

    A pair has one name but for the words real and imaginary, or magnitude and phase.

    Parameters
    ----------
    names : iterable of str
        Real columns.
    stated : mapping of str to str
        Units that the file states.
    split : iterable of str
        Names of arrays that were split into columns.

    Returns
    -------
    list of ResponseLabel
        One label a pair.
    """
    groups: dict[str, dict[str, str]] = {}
    for name in names:
        text = _without_unit(name, stated)
        found = list(_PART.finditer(text.lower()))
        if found:
            base = _joined(text[: found[-1].start()], text[found[-1].end() :])
            groups.setdefault(base, {})[_PARTS[found[-1][1]]] = name
    out, arrays = [], set(split)
    for base, parts in groups.items():
        for first, other, called in (("real", "imaginary", "imaginary"), ("magnitude", "phase", "phase")):
            if first in parts and other in parts:
                out.append(_label(parts[first], base, arrays, column=parts[first], **{called: parts[other]}))
                break
    return out


def _label(name: str, text: str, arrays: set[str], **columns: str) -> ResponseLabel:
    match = _MATRIX.fullmatch(name)
    output, given = (match[2], match[3]) if match and match[1] in arrays else _sides(text)
    return ResponseLabel(output=output or "response", input=given, **columns)


def _joined(before: str, after: str) -> str:
    """Return the parts around a word as one name.

    Signs beside the word are left out.
    """
    before, after = before.rstrip(" _.-:,;(|"), after.strip(" _.-:,;|")
    if after.startswith("(") and after.endswith(")"):
        after = after[1:-1]
    elif after.endswith(")") and "(" not in after:
        after = after[:-1]
    return f"{before} {after}".strip()


def _without_unit(name: str, stated: Mapping[str, str]) -> str:
    """Return a name without a unit in brackets at its end."""
    text = _UNIT.sub("", name)
    match = _ROUND_UNIT.search(text)
    if match and match[1].strip() == stated.get(name):
        around = (text[: match.start()].strip().lower(), match[1].strip().lower())
        if not any(word in _PARTS for word in around):  # H (real), Re(H)
            text = text[: match.start()]
    return text.strip() or name


def _sides(name: str) -> tuple[str, str]:
    """Return output and input of a name such as ``acc/hammer``."""
    output, slash, given = name.partition("/")
    if not slash or "/" in given or not output.strip() or not given.strip() or "(" in name:
        return name, ""
    return output.strip(), given.strip()
