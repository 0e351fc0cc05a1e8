"""Hysteresis between command and force: piezo stacks, shape memory, magnets."""

from typing import Any, ClassVar

import numpy as np

from vlab.physics.compiled_commands import play_outputs
from vlab.physics.effect import ActuatorEffect, ActuatorStep, Parameter, Values
from vlab.signals import Array

PLAYS = 10
"""PLAYS [1]: play operators of `InputHysteresis`, at least 2. Raising the number resolves finer levels: 10 operators
resolve levels from 1/50 of the largest threshold."""
_ENDS = (np.arange(PLAYS + 1) / PLAYS) ** 2
THRESHOLDS = tuple((0.5 * (_ENDS[1:] + _ENDS[:-1])).tolist())
"""THRESHOLDS [1]: thresholds of the play operators over the largest one. Each is the middle of a range of thresholds;
the ranges are finer at low levels."""
WEIGHTS = tuple(np.diff(_ENDS).tolist())
"""WEIGHTS [1]: shares of the play operators, the widths of their ranges."""


def play(u: Array, threshold: Array) -> Array:
    """Return the outputs of play operators from rest.

    A play operator keeps its output while the input moves within the threshold, and follows beyond: y(k) = min(max(y(k -
    1), u(k) - r), u(k) + r) [1]_.

    Parameters
    ----------
    u : (n, ...) array
        Input signals, time along the first axis.
    threshold : (k,) array
        Thresholds r, in the unit of `u`.

    Returns
    -------
    (n, ..., k) array
        Outputs.

    References
    ----------
    .. [1] M. Brokate and J. Sprekels, Hysteresis and Phase Transitions, Springer, 1996, section 2.3.
    """
    columns = np.ascontiguousarray(np.reshape(np.asarray(u, dtype=float), (len(u), -1)))
    return np.asarray(play_outputs(columns, threshold).reshape(*np.shape(u), len(threshold)))


class InputHysteresis(ActuatorEffect):
    """Prandtl-Ishlinskii hysteresis of a drive.

    Play operators P_r with thresholds r up to L act beside the command [1]_, [2]_: force = u + 2 g int_0^L P_r[u] dr.
    Small commands see the model's gain. For commands of amplitude A <= L the law is Rayleigh's law of piezo ceramics
    and magnets: the gain is 1 + g A, and a loop has the area 4/3 g A^3. Beyond L the gain tends to 1 + 2 g L. The law is
    rate-independent, so the lag is the same at all frequencies.

    References
    ----------
    .. [1] K. Kuhnen, Modeling, identification and compensation of complex hysteretic nonlinearities: a modified
           Prandtl-Ishlinskii approach, European Journal of Control 9 (2003) 407-418.
    .. [2] M. Brokate and J. Sprekels, Hysteresis and Phase Transitions, Springer, 1996, section 2.4.
    """

    name = "actuator-hysteresis"
    family = "input-hysteresis"
    keeps_extremes = True
    law = "force = u + 2 g int_0^L P_r[u] dr, P_r: play of threshold r; gain 1 + g A at amplitudes A up to L"
    words = (
        "the force of a drive depends on its past commands, not on their speed: the gain grows with the level, and the "
        "lag is the same at all frequencies, as of piezo stacks, shape memory and magnets"
    )
    parameters: ClassVar = (
        Parameter(name="growth", unit="1/N", low=1e-9, high=1e9, words="of the gain, per unit of the command's amplitude"),
        Parameter(
            name="limit", unit="N", low=0.05, high=4.0, role="shape", reference="input", grid=(0.2, 0.5, 1.0),
            words="amplitude up to which the gain grows",
        ),
    )  # fmt: skip

    def actuate(self, u: Array, p: Values, h: float) -> Array:
        """See `ActuatorEffect`."""
        u = np.asarray(u, dtype=float)
        scale = float(p["limit"])
        return np.asarray(u + 2.0 * p["growth"] * scale * (play(u, scale * np.array(THRESHOLDS)) @ np.array(WEIGHTS)))

    def stepper(self, p: Values, h: float) -> ActuatorStep:
        """See `ActuatorEffect`."""
        scale, factor = float(p["limit"]), 2.0 * float(p["growth"]) * float(p["limit"])
        thresholds, past = [scale * r for r in THRESHOLDS], [0.0] * PLAYS

        def step(u: Any) -> float:
            total = 0.0
            for i, r in enumerate(thresholds):
                past[i] = min(max(past[i], u - r), u + r)
                total += WEIGHTS[i] * past[i]
            return float(u + factor * total)

        return step
