"""Progress of long work: a bar on the terminal, or a function of the caller."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = bool | Callable[[float, str], None] | None
"""True: a bar on stderr if stderr is a terminal. A function receives the completed share and the present step."""


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

    with tqdm(total=100, desc=label, leave=False, bar_format="{desc}: {bar} {percentage:.0f} %  {postfix}") as bar:

        def report(share: float, what: str) -> None:
            bar.set_postfix_str(what, refresh=False)
            bar.update(100 * share - bar.n)

        yield report
