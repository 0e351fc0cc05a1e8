"""Completion of commands, options and names in the shell, by argcomplete."""

import argparse
import contextlib
import os
import shlex
from collections.abc import Callable, Iterable, Mapping

from vlab.cli import VERBS, build_parser, parser_of


def _cases() -> Iterable[str]:
    from vlab.files.examples import PREFIX, examples

    return [PREFIX + example.name for example in examples() if example.is_case]


def _families() -> Iterable[str]:
    from vlab.cli.effects import families

    return families()


def _effects() -> Iterable[str]:
    from vlab.physics.catalogue import EFFECTS

    return EFFECTS


def _structures() -> Iterable[str]:
    from vlab.structure.reader import BUILT_IN

    return BUILT_IN


def _excitations() -> Iterable[str]:
    from vlab.lab.excitation import EXCITATIONS

    return EXCITATIONS


NAMES: Mapping[str, Callable[[], Iterable[str]]] = {
    "family": _families,
    "only": _effects,
    "names": lambda: [*_effects(), *_families()],
    "structure": _structures,
    "excite": _excitations,
    "case": _cases,
}
"""Names by argument, imported at their use."""
WITH_FILES = ("case", "structure")
"""Arguments that accept files, too."""


def complete(line: str) -> None:
    """Print the completions of a line and leave, as argcomplete does.

    Parameters
    ----------
    line : str
        Line of the shell up to the cursor.
    """
    import argcomplete
    from argcomplete.completers import FilesCompleter

    try:
        words = shlex.split(line)
    except ValueError:  # an open quote
        words = line.split()
    chosen = next((word for word in words[1:] if word in VERBS), None)
    parser = build_parser(chosen)
    if chosen is not None:
        for action in parser_of(parser, chosen)._actions:
            if action.dest in NAMES:
                action.completer = _completer(action, FilesCompleter())  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser, always_complete_options=False)


def _completer(action: argparse.Action, of_files: Callable[..., Iterable[str]]) -> Callable[..., list[str]]:
    """Return the completer of an argument."""

    def completer(prefix: str, **others: object) -> list[str]:
        names = [name for name in NAMES[action.dest]() if name.startswith(prefix)]
        return names + (list(of_files(prefix, **others)) if action.dest in WITH_FILES else [])

    return completer


def answer_shell() -> None:
    """Print the completions of the line in the environment; none without argcomplete."""
    with contextlib.suppress(ImportError):
        complete(os.environ.get("COMP_LINE", ""))
