"""Interrupts and termination signals, ended with one line.

A command imports the module first, and the module imports little: until its import ends, an interrupt gives a
traceback.
"""

import os
import signal
from collections.abc import Callable

STATUS = 130
"""STATUS [1]: exit status of an interrupted command, as in shells."""
LEFT = "nothing half-written was left"
"""Message after an interrupt."""


class _Handling:
    """Interrupt handler of a block.

    A thread cannot install handlers. A background job of a shell has no Ctrl-C. In both cases the handlers stay.
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
        except ValueError:  # not in the main thread
            assert not self._before
        return self._check

    def __exit__(self, *exception: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)  # type: ignore[arg-type]

    def _check(self) -> None:
        pass


class Noted(_Handling):
    """Handler that raises KeyboardInterrupt, with a check.

    Python drops an exception of a callback, and libraries replace it by their own. The check raises the interrupt
    again.
    """

    def __init__(self) -> None:
        super().__init__()
        self._pressed = False

    def _handle(self, number: int, frame: object) -> None:
        self._pressed = True
        before = self._before.get(number)
        if callable(before):  # passes the interrupt to the earlier handler
            before(number, frame)
        raise KeyboardInterrupt

    def _check(self) -> None:
        if self._pressed:
            raise KeyboardInterrupt


class LeavingAtOnce(_Handling):
    """Handler that ends the process at once during imports.

    No file is being written then. Python would print an exception of an import callback and continue.
    """

    def _handle(self, number: int, frame: object) -> None:
        os.write(2, f"error: interrupted; {LEFT}\n".encode())
        os._exit(STATUS)
