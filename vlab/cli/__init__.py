"""Command line: parse, call, print.

Exit status: 0 done, 1 a check failed, 2 bad input, 3 fault of vlab itself, 130 interrupted. Status 2 and 3 come with
one line on stderr. With ``--json`` one JSON document goes to stdout and nothing else. Progress goes to stderr.
"""

import argparse
import contextlib
import difflib
import errno
import gc
import importlib
import io
import json
import os
import shlex
import sys
import traceback
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NoReturn

from vlab import __version__
from vlab.cli import unforeseen
from vlab.cli.common import Outcome
from vlab.errors import Diverged, VlabError
from vlab.files.output_folder import finite
from vlab.files.text import in_line, one_line, printable
from vlab.interrupts import LEFT, LeavingAtOnce, Noted
from vlab.interrupts import STATUS as INTERRUPTED

VERBS = {
    "demo": "Run the whole story on the beam: cross-check, controlled experiment, diagnosis, real recording",
    "examples": "List the cases and recordings supplied with vlab, or copy them",
    "init": "Draft a case from a MuJoCo model and recordings",
    "check": "Check a case in seconds before a diagnosis: signs, units, delays, excitation, noise",
    "diagnose": "Find missing physics in a model from recordings",
    "compare": "Compare recordings of a case with the nominal model",
    "show": "Open a run in the Rerun viewer",
    "columns": "List the columns of a recording with their ranges and units",
    "effects": "List the catalogue of physics that a model can lack",
    "modes": "Compare the FE model, every plant and the published modes",
    "experiment": "Simulate an experiment and write a run folder",
    "modal-test": "Estimate frequency responses, poles and mode shapes from recordings",
    "design": "Design a control law on a model of a structure and judge it",
    "correct": "Correct a reduced model by a simulated modal test of a deviating structure",
    "reproduce": "Reproduce the tables of the dissertation",
    "conceal": "Generate cases with hidden physics and seal the truth",
    "prove": "Diagnose concealed cases, freeze the answers, open the truth and score",
    "bench": "Time vlab beside the usual alternatives",
}
"""VERBS: commands with their help, a diagnosis first; each has a module of its name."""
FIRST = "a model and logs of your own: vlab diagnose MODEL.xml LOG...   options of a command: vlab VERB --help"
"""FIRST: last line of the help."""


ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""ONE_THREAD: variables that limit linear algebra to one thread. Sums then have one order, so a seed gives the same bits
on any number of cores. The small matrices here are also faster on one thread."""
OF_SYSTEM = {errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EMFILE, errno.ENFILE}
OF_SYSTEM |= {errno.ENAMETOOLONG, errno.ELOOP}
"""OF_SYSTEM: errors of the system: missing rights, no space, too many open files, impossible names."""
MOST_SAID = 10_000
"""MOST_SAID [characters]: longest error line; a list of all accepted names is long."""
DEBUG = "--debug"
OF_ALL = (DEBUG, "--json")
"""OF_ALL: options of every command."""


OWN_CODE = {"PYTHONSAFEPATH": "1", "NUMBA_CACHE_DIR": "", "NUMBA_CACHE_LOCATOR_CLASSES": ""}
"""OWN_CODE: variables that keep code of the working folder from running, for the folder may hold foreign data. Started
processes import no modules from there. A ``.numba_config.yaml`` there names no cache of compiled code."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Print the error in one line and leave with status 2."""
        print(f"error: {self.prog}: {in_line(message)} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(2)


def build_parser(chosen: str | None = None) -> argparse.ArgumentParser:
    """Build the parser, with the arguments of the chosen command only.

    Parameters
    ----------
    chosen : str or None
        Command whose module is imported; none by default.

    Returns
    -------
    ArgumentParser
        Parser of all commands.
    """
    parser = _Parser(prog="vlab", allow_abbrev=False, epilog=FIRST)
    parser.description = "Simulate, control and diagnose flexible structures in a virtual laboratory on MuJoCo."
    parser.add_argument("--version", action="version", version=f"vlab {__version__}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=_Parser)
    for verb, summary in VERBS.items():
        sub = verbs.add_parser(verb, help=summary, description=summary, allow_abbrev=False)
        sub.add_argument(DEBUG, action="store_true", help="print the traceback of an error")
        sub.add_argument("--json", action="store_true", help="print one JSON document to stdout and nothing else")
        if verb == chosen:
            _module(verb).add_arguments(sub)
    return parser


def parser_of(parser: argparse.ArgumentParser, verb: str) -> argparse.ArgumentParser:
    """Return the parser of one command.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of all commands.
    verb : str
        Command.

    Returns
    -------
    ArgumentParser
        Parser of the command.
    """
    (verbs,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    found: argparse.ArgumentParser = verbs.choices[verb]
    return found


def _check_words(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Refuse an unknown command or option with the nearest known one.

    argparse would name a missing argument before an unknown option, and no near name.
    """
    first = next((word for word in words if not word.startswith("-")), None)
    if first is not None and first not in VERBS:
        parser.error(f"unknown command {first!r}{_nearest(first, VERBS)} (accepted: {', '.join(VERBS)})")
    own = parser if first is None else parser_of(parser, first)
    known = [*own._option_string_actions, *parser._option_string_actions, *OF_ALL]
    for word in words:
        option = word.partition("=")[0]
        if word == "--":
            return
        if option.startswith("--") and option not in known:
            own.error(f"unknown option {option!r}{_nearest(option, known)}")


def _nearest(given: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(given, list(known), n=1, cutoff=0.5)
    return f"; did you mean {near[0]!r}?" if near else ""


def _module(verb: str) -> Any:
    return importlib.import_module(f"vlab.cli.{verb.replace('-', '_')}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status.

    Parameters
    ----------
    argv : sequence of str or None
        Words of the command; those of the process by default.

    Returns
    -------
    int
        Exit status.
    """
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))  # before the verb's module loads numpy
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # file names and units outside the encoding of the terminal
            stream.reconfigure(errors="backslashreplace")
    for name, value in OWN_CODE.items():
        os.environ.setdefault(name, value)
    words = list(sys.argv[1:] if argv is None else argv)
    is_debug = DEBUG in words
    if not is_debug:  # warnings of numpy; values are checked at their use, and explicit filters of the user stay
        warnings.filterwarnings("ignore", category=RuntimeWarning, append=True)
    with Noted() as check_interrupts:  # a kill ends like Ctrl-C, without partial files
        try:
            return _run(words)
        except SystemExit:
            raise
        except BaseException as error:
            try:
                check_interrupts()
            except KeyboardInterrupt as stop:  # also if a library has converted the interrupt
                error = error if isinstance(error, KeyboardInterrupt) else stop
            return _said(error, is_debug=is_debug)


@contextlib.contextmanager
def _uncollected(verb: str | None) -> Iterator[None]:
    """Import the modules of a command without collections of garbage.

    Modules stay to the end, so their hundreds of thousands of objects are left out of later collections as well.
    """
    if verb is None or not gc.isenabled() or f"{__name__}.{verb.replace('-', '_')}" in sys.modules:
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.freeze()


def _draft_first(arguments: argparse.Namespace, unknown: Sequence[str]) -> str:
    """Return a hint for a model and logs in place of a case."""
    model = str(getattr(arguments, "case", ""))
    if not model.lower().endswith(".xml") or unknown[0].startswith("-"):
        return ""
    return f"; vlab {arguments.verb} takes one case: draft it with vlab init {shlex.join([model, *unknown])}"


def _run(words: Sequence[str]) -> int:
    """Run one command, print its outcome, and return its exit status."""
    chosen = next((word for word in words if word in VERBS), None)
    with LeavingAtOnce(), _uncollected(chosen):
        parser = build_parser(chosen)
        if not words or words[0] == "help":
            (parser if chosen is None else parser_of(parser, chosen)).print_help()
            return 0
        _check_words(parser, words)
        arguments, unknown = parser.parse_known_args(words)
        if unknown:
            where = "; write it after the command" if unknown[0] in OF_ALL else _draft_first(arguments, unknown)
            parser_of(parser, arguments.verb).error(f"unknown argument {unknown[0]!r}{where}")
        module = _module(arguments.verb)
    if "mujoco" in sys.modules:  # MuJoCo would log warnings to the working folder; `check_run` reports them
        sys.modules["mujoco"].set_mju_user_warning(lambda text: None)
    outcome: Outcome = module.run(arguments)
    try:
        text = json.dumps(finite(outcome.document), allow_nan=False) if arguments.json else printable(outcome.text)
        print(text)
        sys.stdout.flush()
    except OSError:
        with contextlib.suppress(OSError, ValueError):  # do not retry the output at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise
    return 0 if outcome.holds else 1


def _said(error: BaseException, *, is_debug: bool) -> int:
    """Print the reason of a failure, return the status."""
    if isinstance(error, BrokenPipeError):
        return 141
    if isinstance(error, KeyboardInterrupt):
        print(f"error: interrupted; {error if error.args else LEFT}", file=sys.stderr)
        return INTERRUPTED
    if is_debug:
        traceback.print_exception(error)
    if isinstance(error, VlabError):
        print(f"error: {one_line(error, longest=MOST_SAID)}", file=sys.stderr)
        return 1 if isinstance(error, Diverged) else 2
    if isinstance(error, OSError) and error.errno in OF_SYSTEM:
        where = one_line(error.filename or "the output")
        print(f"error: {where}: {error.strerror}; change its rights, make room, or name another path", file=sys.stderr)
        return 2
    print(f"error: unforeseen {unforeseen.line_of(error)}", file=sys.stderr)
    return unforeseen.STATUS
