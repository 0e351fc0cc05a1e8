"""Statement of a case, and deviations of the bench as built.

An engineer states round standard deviations by kind. In some cases parts of the bench are about twice as far off.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from vlab.proof.generator.bench import Benign

WRONG, WRONG_PARTS, TWICE = 0.25, 1 / 3, (1.5, 2.5)
"""WRONG, WRONG_PARTS, TWICE [-]: share of the cases with parameters about twice as far off as stated, and share of such
parameters there. The last is the range of their deviation over the statement."""
COLOURED, OVER_WHITE, TIME_CONSTANT = 0.3, (0.5, 1.5), (0.005, 0.05)
"""COLOURED, OVER_WHITE [-], TIME_CONSTANT [s]: share of the cases with coloured noise, range of the coloured part
over the white one, and range of its time constant."""
STRAY, OF_COMMAND = 0.15, (0.005, 0.03)
"""STRAY, OF_COMMAND [-]: share of the cases with forces that are not recorded, and range of their rms over that of the
recorded ones."""
MOST = 2.5
"""MOST [-]: largest deviation of a statement that is right, in standard deviations."""


def deviations(benign: Sequence[Benign], rng: np.random.Generator, *, is_wrong: bool) -> dict[str, float]:
    """Draw the log-factors of a bench as built.

    Parameters
    ----------
    benign : sequence of Benign
        Parameters that vary without missing physics.
    rng : Generator
        Random numbers.
    is_wrong : bool
        Whether some parameters are about twice as far off as the case states.

    Returns
    -------
    dict
        Log-factor by the name of the parameter.
    """
    out = {}
    for b in benign:
        if not b.sd:
            continue
        out[b.name] = b.sd * float(np.clip(rng.standard_normal(), -MOST, MOST))
        if is_wrong and b.prior and rng.random() < WRONG_PARTS:
            out[b.name] = b.prior * float(rng.choice([-1.0, 1.0]) * rng.uniform(*TWICE))
    return out


def coloured_part(rng: np.random.Generator, share: float) -> tuple[float, float]:
    """Draw the coloured part of the noise of a case.

    Parameters
    ----------
    rng : Generator
        Random numbers.
    share : float
        Share of the cases with coloured noise.

    Returns
    -------
    (float, float)
        Its standard deviation over that of the white part, 0 for none, and its time constant [s].
    """
    over_white = float(rng.uniform(*OVER_WHITE)) if rng.random() < share else 0.0
    return over_white, float(np.exp(rng.uniform(*np.log(TIME_CONSTANT))))


def stated(options: Mapping[str, Sequence[float]], rng: np.random.Generator) -> dict[str, float]:
    """Draw a round standard deviation of every kind of parameter."""
    return {kind: float(rng.choice(values)) for kind, values in options.items()}
