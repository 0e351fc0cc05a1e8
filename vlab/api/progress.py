"""Progress of long work, for a terminal or a caller."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from vlab.files.text import in_line

Progress = bool | Callable[[float, str], None] | None
"""True: a bar on stderr if stderr is a terminal. A function receives the completed share and the present step."""

SHARE_FORMAT = "{desc}: {bar} {percentage:.0f} %  {elapsed}, {remaining} left{postfix}"
"""Form of a bar that shows the completed share and the present step."""


@contextmanager
def reported(progress: Progress, label: str) -> Iterator[Callable[[float, str], None] | None]:
    """Yield the function that receives the progress.

    Parameters
    ----------
    progress : bool, callable or None
        Wish of the caller.
    label : str
        Label of the bar.

    Yields
    ------
    callable or None
        Function of the completed share and the present step.
    """
    if callable(progress) or not progress or not sys.stderr.isatty():
        yield progress if callable(progress) else None
        return
    from tqdm import tqdm

    with tqdm(total=100, desc=label, leave=False, smoothing=0, bar_format=SHARE_FORMAT) as bar:
        yield share_of(bar)


def share_of(bar: Any) -> Callable[[float, str], None]:
    """Return the function that moves a bar of 100 parts in `SHARE_FORMAT`.

    Parameters
    ----------
    bar : tqdm
        Bar.

    Returns
    -------
    callable
        Function of the completed share and the present step.
    """

    def report(share: float, what: str) -> None:
        bar.set_postfix_str(in_line(what), refresh=False)
        bar.update(100 * share - bar.n)

    return report
