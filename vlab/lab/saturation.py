"""The limit cycle of an unstable loop whose amplifiers have a limit: harmonic balance.

A sine of amplitude A through a limit L keeps its frequency and, of its fundamental, the share N(A/L), the describing
function of saturation [1]_. The loop swings where N makes it just stable. Higher harmonics and noise are left out.

References
----------
.. [1] Gelb and Vander Velde, *Multiple-Input Describing Functions and Nonlinear System Design*, McGraw-Hill, 1968, app. B.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.optimize import bisect

from vlab.errors import BadController
from vlab.lab.prediction import SampledLoop
from vlab.signals import Array

PASSES = 30
"""Most passes of the shares of several amplifiers, which depend on each other."""
SMALLEST, LARGEST = 1e-3, 1e4
"""Amplitudes of the largest command, in limits, between which a limit cycle is looked for."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LimitCycle:
    """A steady vibration of a loop with limited amplifiers.

    Parameters
    ----------
    hz : float
        Frequency [Hz].
    commands, forces : (n_coils,) array
        Amplitudes of the commands, and of the fundamental of the forces, [N].
    samples : (n_sensors,) array
        Amplitudes at the sensors [m/s].
    """

    hz: float
    commands: Array
    forces: Array
    samples: Array


def saturation_share(amplitude: Array, limit: float) -> Array:
    """Return N: the share of a sine's fundamental that a limit lets through, one below it."""
    ratio = limit / np.maximum(np.asarray(amplitude, dtype=float), limit)
    return np.asarray(2 / np.pi * (np.arcsin(ratio) + ratio * np.sqrt(1 - ratio**2)))


def harmonic_balance(loop: SampledLoop, limit: float) -> LimitCycle | None:
    """Return the limit cycle that an unstable loop settles at, or None for a stable loop.

    The least stable pole is followed down the shares of the amplifiers; a loop that no amplitude steadies (its
    structure is unstable without control) is refused.

    Parameters
    ----------
    limit : float
        Largest force of every amplifier [N].

    Raises
    ------
    BadController
        A limit that is not positive, or no amplitude at which the loop is steady.
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
    """Return the shares of the amplifiers when the largest command has this amplitude, and the growth ln|z| then."""
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
    """Return the least stable eigenvalue, and what its motion asks of the commands and shows at the sensors."""
    z, vectors = linalg.eig(loop.matrix)
    worst = int(np.abs(z).argmax())
    n = len(loop.plant[0])
    samples = loop.plant[2] @ vectors[:n, worst]
    _, _, c, d = loop.law
    return complex(z[worst]), c @ vectors[n:, worst] + d @ samples, samples
