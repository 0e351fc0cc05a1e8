"""Part of a run with a state of its own."""

from dataclasses import dataclass

import numpy as np

from vlab.signals import Array


@dataclass(frozen=True)
class Part:
    """Samples of a run in a window.

    Parameters
    ----------
    run : int
        Index of the run.
    first, end : int
        First sample, and end of the window.
    """

    run: int
    first: int
    end: int

    def of(self, series: Array) -> Array:
        """Return the window of a series (n, n_runs, ...)."""
        return np.asarray(series[self.first : self.end, self.run])
