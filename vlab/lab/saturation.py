"""Limit cycle of an unstable loop with saturating amplifiers, by harmonic balance.

A sine of amplitude A through a limit L keeps its frequency and the share N(A/L) of its fundamental. N is the describing
function of saturation [1]_. The loop oscillates steadily where N makes the loop marginally stable. Higher harmonics and
noise are neglected.

References
----------
.. [1] A. Gelb and W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, McGraw-Hill,
       1968, app. B.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.optimize import bisect

from vlab.errors import BadController
from vlab.lab.prediction import SampledLoop
from vlab.signals import Array

PASSES = 30
"""PASSES [1]: largest number of fixed-point iterations for coupled amplifiers."""
SMALLEST, LARGEST = 1e-3, 1e4
"""SMALLEST,
LARGEST [limits]: range of the largest command's amplitude in the search for a limit cycle."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LimitCycle:
    """Steady oscillation of a loop with limited amplifiers.

    Parameters
    ----------
    hz : float
        Frequency [Hz].
    commands, forces : (n_coils,) array
        Amplitudes of the commands, and of the forces' fundamental [N].
    samples : (n_sensors,) array
        Amplitudes at the sensors [m/s].
    """

    hz: float
    commands: Array
    forces: Array
    samples: Array


def saturation_share(amplitude: Array, limit: float) -> Array:
    """Return the describing function N of saturation.

    N = 2/pi (arcsin(r) + r sqrt(1 - r^2)) with r = limit/amplitude, and N = 1 below the limit.
    """
    ratio = limit / np.maximum(np.asarray(amplitude, dtype=float), limit)
    return np.asarray(2 / np.pi * (np.arcsin(ratio) + ratio * np.sqrt(1 - ratio**2)))


def harmonic_balance(loop: SampledLoop, limit: float) -> LimitCycle | None:
    """Return the limit cycle of an unstable loop.

    The least stable pole is followed along decreasing shares of the amplifiers.

    Parameters
    ----------
    loop : SampledLoop
        Sampled loop.
    limit : float
        Largest force of every amplifier [N].

    Returns
    -------
    LimitCycle or None
        None for a stable loop.

    Raises
    ------
    BadController
        The limit is not positive, or no amplitude gives marginal stability (the structure is unstable without control).
    """
    if not limit > 0:
        raise BadController(f"a limit of {limit} N is no limit; harmonic balance needs a positive one")
    if loop.radius < 1:
        return None
    sizes = np.geomspace(SMALLEST, LARGEST, 60) * limit
    growths = [_steady_shares(loop, size, limit)[1] for size in sizes]
    ends = [i for i in range(len(sizes) - 1) if growths[i] > 0 >= growths[i + 1]]
    if not ends:
        raise BadController("no amplitude of the commands makes the loop steady: the structure grows without control")
    low, high = np.log(sizes[ends[0]]), np.log(sizes[ends[0] + 1])
    size = float(np.exp(bisect(lambda v: _steady_shares(loop, float(np.exp(v)), limit)[1], low, high, xtol=1e-6)))
    shares, _ = _steady_shares(loop, size, limit)
    z, commands, samples = _swing(loop.with_gain(shares))
    scale = size / np.abs(commands).max()
    amplitudes = np.abs(commands) * scale
    return LimitCycle(
        hz=float(abs(np.angle(z)) * loop.rate / (2 * np.pi)),
        commands=amplitudes,
        forces=saturation_share(amplitudes, limit) * amplitudes,
        samples=np.abs(samples) * scale,
    )


def _steady_shares(loop: SampledLoop, size: float, limit: float) -> tuple[Array, float]:
    """Return the amplifiers' shares and the growth ln|z|.

    `size` is the amplitude of the largest command.
    """
    shares = np.ones(len(loop.at_coils))
    for _ in range(PASSES):
        _, commands, _ = _swing(loop.with_gain(shares))
        new = saturation_share(size * np.abs(commands) / np.abs(commands).max(), limit)
        settled = np.abs(new - shares).max() < 1e-9
        shares = new
        if settled:
            break
    return shares, float(np.log(abs(_swing(loop.with_gain(shares))[0])))


def _swing(loop: SampledLoop) -> tuple[complex, Array, Array]:
    """Return the least stable eigenvalue with its commands and samples."""
    z, vectors = linalg.eig(loop.matrix)
    worst = int(np.abs(z).argmax())
    n = len(loop.plant[0])
    samples = loop.plant[2] @ vectors[:n, worst]
    _, _, c, d = loop.law
    return complex(z[worst]), c @ vectors[n:, worst] + d @ samples, samples
