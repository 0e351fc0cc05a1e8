"""Time limit of a search."""

import time
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Deadline:
    """End of the time that a search may add effects.

    Parameters
    ----------
    at : float
        Time of `time.monotonic` [s]; infinite without a limit.
    """

    at: float = float("inf")

    @classmethod
    def after(cls, seconds: float | None) -> "Deadline":
        """Return the deadline some seconds from now.

        Parameters
        ----------
        seconds : float or None
            Duration [s]; None for no limit.

        Returns
        -------
        Deadline
            Deadline.
        """
        return cls() if seconds is None else cls(at=time.monotonic() + seconds)

    @property
    def is_past(self) -> bool:
        """Whether the time is spent."""
        return time.monotonic() >= self.at

    @property
    def notes(self) -> tuple[str, ...]:
        """One note after the deadline, otherwise none."""
        return ("the time limit ended the search; the best hypothesis so far stands",) if self.is_past else ()


NO_DEADLINE = Deadline()
"""Deadline of an unlimited search."""
