"""Resolution of time stamps: decimals, and ticks of a coarse clock.

A logger with a clock of ticks r writes an even time t as a multiple of r, rounded or cut. All stamps then lie within r of
an even grid.
"""

from dataclasses import dataclass

import numpy as np

from vlab.signals import Array

FINEST_DIGIT = 9
"""FINEST_DIGIT [1]: last decimal of time stamps, of nanoseconds; finer stamps count as exact."""


@dataclass(frozen=True, kw_only=True)
class CoarseClock:
    """Even samples whose stamps lie on ticks.

    Parameters
    ----------
    tick_s : float
        Tick of the clock [s].
    rate_hz : float
        Rate of the even samples [Hz].
    """

    tick_s: float
    rate_hz: float

    @property
    def advice(self) -> str:
        """Observation and remedy."""
        rate = f"{self.rate_hz:.6g}"
        return (
            f"the time stamps lie on ticks of {1e3 * self.tick_s:g} ms, and even samples at {rate} Hz fit them; where the rate "
            f"is even, say rate_hz = {rate} in place of time"
        )


def even_in_ticks(time: Array) -> CoarseClock | None:
    """Return the clock of even samples whose stamps lie on ticks.

    Decimal ticks are rounded numbers, which need no remark.

    Parameters
    ----------
    time : (n,) array
        Time stamps [s].

    Returns
    -------
    CoarseClock or None
        None for even stamps, decimal ticks, and stamps farther than a tick from every even grid.
    """
    resolution, steps = resolution_of(time), np.diff(time)
    if not resolution or np.ptp(steps) <= 1.001 * resolution:
        return None
    counts = np.rint(steps / resolution).astype(np.int64)
    tick = resolution * float(np.gcd.reduce(counts))
    index = np.arange(len(time), dtype=float)
    step, _ = np.polyfit(index, time, 1)
    # Rounding moves the line of least squares by about a tick over sqrt(n) at the ends.
    reach = tick * (1.0 + 1.0 / np.sqrt(len(time)))
    if tick <= resolution or tick >= 2.0 * step or np.ptp(time - step * index) > reach:
        return None
    return CoarseClock(tick_s=tick, rate_hz=float(f"{1.0 / step:.{_digits(len(time))}g}"))


def _digits(samples: int) -> int:
    """Return the digits of a rate that so many samples determine."""
    return max(1, int(np.log10(samples)))


def resolution_of(time: Array) -> float:
    """Return the resolution of decimal time stamps.

    Even times that are rounded to a resolution r have steps that differ by r at most.

    Parameters
    ----------
    time : (n,) array
        Time stamps [s].

    Returns
    -------
    float
        Largest power of ten of which all steps are multiples [s]; 0.0 for none beyond the rounding of the numbers.
    """
    steps = np.diff(time)
    rounding = 4 * float(np.spacing(np.abs(time).max()))
    for digits in range(FINEST_DIGIT + 1):
        step = 10.0**-digits
        if rounding > 0.01 * step:
            return 0.0
        if np.abs(steps - step * np.rint(steps / step)).max() <= rounding:
            return step
    return 0.0
