"""Ctrl-C and polite kills: heard wherever they come, and ended with one line.

This is the first module that a command imports, so it imports next to nothing itself: until its import has ended, an interrupt ends
in a traceback.
"""

import os
import signal
from collections.abc import Callable

STATUS = 130
"""Exit status of an interrupted command, as shells have it."""
LEFT = "nothing half-written was left"


class _Handling:
    """Handles interrupts while its block runs.

    A thread may not handle them, and a job that a shell started in the background has no Ctrl-C: these stay as they are.
    """

    def __init__(self) -> None:
        self._before: dict[int, object] = {}

    def _handle(self, number: int, frame: object) -> None:
        raise NotImplementedError

    def __enter__(self) -> Callable[[], None]:
        try:
            for number in (signal.SIGINT, signal.SIGTERM):
                before = signal.getsignal(number)
                if before is not signal.SIG_IGN:
                    signal.signal(number, self._handle)
                    self._before[number] = signal.SIG_DFL if before is None else before
        except ValueError:  # not the main thread
            assert not self._before
        return self._check

    def __exit__(self, *exception: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)  # type: ignore[arg-type]

    def _check(self) -> None:
        pass


class Noted(_Handling):
    """Raises KeyboardInterrupt on an interrupt; its block gets a check that raises it again after one.

    Python drops an exception that comes up in a callback, and libraries turn it into errors of their own.
    """

    def __init__(self) -> None:
        super().__init__()
        self._pressed = False

    def _handle(self, number: int, frame: object) -> None:
        self._pressed = True
        before = self._before.get(number)
        if callable(before):  # whoever noted interrupts before hears of this one, too
            before(number, frame)
        raise KeyboardInterrupt

    def _check(self) -> None:
        if self._pressed:
            raise KeyboardInterrupt


class LeavingAtOnce(_Handling):
    """Ends the process at once on an interrupt, for the time in which modules are imported: nothing is being written then.

    An exception would not do: Python prints it and goes on where it comes up in a callback of the import system.
    """

    def _handle(self, number: int, frame: object) -> None:
        os.write(2, f"error: interrupted; {LEFT}\n".encode())
        os._exit(STATUS)
