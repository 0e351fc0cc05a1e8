"""Shared parts of the commands: outcome, arguments, progress bars."""

import argparse
import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from vlab.api.progress import SHARE_FORMAT, share_of
from vlab.interrupts import Noted

if TYPE_CHECKING:
    from tqdm import tqdm

LOG_S = 30.0
"""LOG_S [s]: time between two lines of progress in a log."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of a command: document, text, checks."""

    document: Any
    text: str
    holds: bool = True


def seed_number(text: str) -> int:
    """Return the seed of random numbers that a word states.

    Parameters
    ----------
    text : str
        Word of the command line.

    Returns
    -------
    int
        Seed.

    Raises
    ------
    argparse.ArgumentTypeError
        The word is no whole number from 0.
    """
    return _whole_number(text, 0, "is no seed; accepted: whole numbers from 0")


def process_number(text: str) -> int:
    """Return the number of processes of a command-line word.

    Parameters
    ----------
    text : str
        Word.

    Returns
    -------
    int
        Number, at least 1.

    Raises
    ------
    argparse.ArgumentTypeError
        The word is no whole number from 1.
    """
    why = "is no number of processes; accepted: whole numbers from 1; leave the option out for one a core"
    return _whole_number(text, 1, why)


def _whole_number(text: str, least: int, why: str) -> int:
    """Return a whole number of at least some size."""
    try:
        number = int(text)
    except ValueError:
        number = least - 1
    if number < least:
        raise argparse.ArgumentTypeError(f"{text!r} {why}")
    return number


def add_seed(parser: argparse.ArgumentParser, words: str, *, default: int | None = None) -> None:
    """Add the argument ``--seed``.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of the command.
    words : str
        Help: what is drawn, and the default.
    default : int or None
        Seed without the argument; None lets the command decide.
    """
    parser.add_argument("--seed", type=seed_number, default=default, help=words)


class _Lines:
    """Stderr outside a terminal: progress as lines of a log."""

    def write(self, text: str) -> None:
        for line in text.replace("\r", "\n").splitlines():
            if line.strip():
                print(" ".join(line.split()).replace(" ,", ","), file=sys.stderr)

    def flush(self) -> None:
        sys.stderr.flush()


def _bar(**settings: Any) -> "tqdm":
    """Return a progress bar on stderr."""
    from tqdm import tqdm

    if sys.stderr.isatty():
        return tqdm(file=sys.stderr, leave=False, **settings)
    return tqdm(
        file=_Lines(),
        leave=False,
        ascii=True,
        ncols=79,
        delay=LOG_S,
        mininterval=LOG_S,
        miniters=0,
        maxinterval=0,
        **settings,
    )


@contextlib.contextmanager
def progress_bar(label: str, total_s: float) -> Iterator[Callable[[float], None]]:
    """Show the progress through simulated time on stderr.

    Parameters
    ----------
    label : str
        Label of the bar.
    total_s : float
        Simulated time of the whole work [s].

    Yields
    ------
    callable
        Function that takes the completed simulated time [s].
    """
    with Noted() as check, _bar(
        total=round(total_s, 3), desc=label, unit="s", smoothing=0,
        bar_format="{desc}: {bar} {n:.1f}/{total:.1f} simulated s, {remaining} left",
    ) as bar:  # fmt: skip

        def report(done_s: float) -> None:
            check()
            if bar.n == 0.0 and done_s > 0.0:
                _leave_out_the_start(bar, done_s)
            bar.update(done_s - bar.n)

        yield report


def _leave_out_the_start(bar: "tqdm", done: float) -> None:
    """Measure the pace from the first report on.

    A compilation before it says nothing of the rest.
    """
    now = bar._time()
    bar.delay = max(bar.delay - (now - bar.start_t), 0.0)
    bar.initial, bar.start_t = done, now


@contextlib.contextmanager
def share_bar(label: str) -> Iterator[Callable[[float, str], None]]:
    """Show the completed share of a long work.

    Parameters
    ----------
    label : str
        Label of the bar.

    Yields
    ------
    callable
        Function that takes the completed share and the present step.
    """
    with Noted() as check, _bar(total=100, desc=label, smoothing=0, bar_format=SHARE_FORMAT) as bar:
        shown = share_of(bar)

        def report(share: float, what: str) -> None:
            check()
            shown(share, what)

        yield report


@contextlib.contextmanager
def count_bar(label: str, total: int) -> Iterator[Callable[[int, int], None]]:
    """Show the number of completed cases.

    Parameters
    ----------
    label : str
        Label of the bar.
    total : int
        Number of all cases.

    Yields
    ------
    callable
        Function that takes the numbers of completed and of all cases.
    """
    with Noted() as check, _bar(total=total, desc=label, unit="case") as bar:

        def report(done: int, of: int) -> None:
            check()
            bar.total = of
            bar.update(done - bar.n)

        yield report
