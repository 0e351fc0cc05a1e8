"""The command line: parse, call, print.

Exit status 0: done. 1: a check did not hold. 2: bad input, with one line on stderr. With ``--json`` one JSON document
goes to stdout and nothing else; progress goes to stderr.
"""

import argparse
import importlib
import json
import os
import signal
import sys
import threading
from collections.abc import Sequence
from typing import Any, NoReturn

from vlab import __version__
from vlab.cli.common import Outcome
from vlab.errors import Diverged, VlabError
from vlab.outputs import finite
from vlab.text import in_line, printable

VERBS = {
    "demo": "the whole story on the beam: cross-check, controlled experiment, something concealed and found, a real recording",
    "modes": "FE model, every plant and the published values side by side",
    "design": "a control law designed on a model of a structure, and what it achieves",
    "experiment": "a simulated experiment, written as a run folder",
    "effects": "the catalogue of physics that a model can have left out",
    "modal-test": "frequency responses, poles and mode shapes from recordings",
    "reproduce": "the dissertation's tables beside ours",
    "correct": "a reduced model corrected by a simulated modal test of a structure that differs from it",
    "compare": "a case: recordings beside their model, and by how much they differ",
    "diagnose": "what physics the model of a case lacks, where, and how much better it fits with it",
    "conceal": "cases with something hidden in them by an independent generator, and their sealed truth",
    "prove": "concealed cases diagnosed, the answers frozen, then the truth opened and scored",
    "show": "open a run in the Rerun viewer",
    "bench": "speed side by side with what a user would use instead",
}
"""What `vlab` can do; each verb has a module of its name beside this one."""


ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Linear algebra on one thread: sums then have one order, so the same seed gives the same bits on any number of cores, and
the small matrices here are faster that way."""


OWN_CODE = {"PYTHONSAFEPATH": "1", "NUMBA_CACHE_DIR": "", "NUMBA_CACHE_LOCATOR_CLASSES": ""}
"""Nothing of the folder that vlab is called in is run, for it may be one of data: no modules in it by the processes that are started,
and no cache of compiled code that a ``.numba_config.yaml`` there names."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Say in one line what is wrong and leave with status 2."""
        print(f"error: {self.prog}: {in_line(message)} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(2)


def build_parser(chosen: str | None = None) -> argparse.ArgumentParser:
    """Build the parser; only the chosen verb's module is imported and asked for its arguments."""
    parser = _Parser(prog="vlab", allow_abbrev=False)
    parser.description = "A virtual laboratory for flexible structures under active vibration control, on MuJoCo."
    parser.add_argument("--version", action="version", version=f"vlab {__version__}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=_Parser)
    for verb, summary in VERBS.items():
        sub = verbs.add_parser(verb, help=summary, description=summary, allow_abbrev=False)
        sub.add_argument("--json", action="store_true", help="print one JSON document to stdout and nothing else")
        if verb == chosen:
            _module(verb).add_arguments(sub)
    return parser


def _module(verb: str) -> Any:
    return importlib.import_module(f"vlab.cli.{verb.replace('-', '_')}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return its exit status."""
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))  # before the verb's module loads numpy
    for name, value in OWN_CODE.items():
        os.environ.setdefault(name, value)
    words = list(sys.argv[1:] if argv is None else argv)
    chosen = next((word for word in words if word in VERBS), None)
    arguments = build_parser(chosen).parse_args(words)
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # a kill ends as Ctrl-C does: nothing half-written
    try:
        module = _module(arguments.verb)
        if (
            "mujoco" in sys.modules
        ):  # its warnings would go to a log file in the user's folder; `check_run` reports them
            sys.modules["mujoco"].set_mju_user_warning(lambda text: None)
        outcome: Outcome = module.run(arguments)
    except VlabError as error:
        print("error: " + in_line(" ".join(str(error).split())), file=sys.stderr)
        return 1 if isinstance(error, Diverged) else 2
    except PermissionError as error:
        print(
            f"error: {error.filename}: not permitted ({error.strerror}); change its rights or the path", file=sys.stderr
        )
        return 2
    except KeyboardInterrupt as stop:
        print(f"error: interrupted; {stop if stop.args else 'nothing half-written was left'}", file=sys.stderr)
        return 130
    except BrokenPipeError:
        return 141
    try:
        text = json.dumps(finite(outcome.document), allow_nan=False) if arguments.json else printable(outcome.text)
        print(text)
        sys.stdout.flush()
    except BrokenPipeError:
        sys.stderr.close()
        return 141
    return 0 if outcome.holds else 1
