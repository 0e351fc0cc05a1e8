"""Channels that read forces of actuators, under commands and uncertain gains.

The channels of a search are without the nominal response to commands. Changed commands, changed gains and laws within a drive
change the reading itself, besides the motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlab.diagnose.settings import REDUCED_MODEL
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class EffortChange:
    """Change of the readings per unit of relative change of a parameter.

    Parameters
    ----------
    by : int
        Uncertain parameter.
    at_q, at_v : (n_channels, m) array
        Change per modal coordinate and velocity.
    per_command : (n_channels, n_actuators) array
        Change per unit command.
    """

    by: int
    at_q: Array
    at_v: Array
    per_command: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class EffortChannels:
    """Readings of actuators' forces.

    Parameters
    ----------
    per_command : (n_channels, n_actuators) array
        Nominal reading per unit command; zero for other channels.
    seen : (n_actuators,) array
        Share of the command of a sample's own interval in what its readings see: 0 where commands are held and change after
        the readings, 1 where they change before, 0.5 where they run straight.
    changes : tuple of EffortChange
        Changes by uncertain parameters.
    """

    per_command: Array
    seen: Array
    changes: tuple[EffortChange, ...] = ()

    def more_rows(self, theta: Array) -> Array:
        """Return the change of the rows (n_sets, n_channels, 2m) per [p, p'] at log factors."""
        parts = [np.hstack([change.at_q, change.at_v]) for change in self.changes]
        return self._scaled(theta, parts, (len(self.per_command), 0))

    def more_per_command(self, theta: Array) -> Array:
        """Return the change of the readings per command (n_sets, n_channels, n_actuators) at log factors."""
        return self._scaled(theta, [change.per_command for change in self.changes], self.per_command.shape)

    def _scaled(self, theta: Array, parts: Sequence[Array], empty: tuple[int, ...]) -> Array:
        factors = np.expm1(np.clip(theta, -REDUCED_MODEL.most, REDUCED_MODEL.most))
        out = np.zeros((len(theta), *(parts[0].shape if parts else empty)))
        for change, part in zip(self.changes, parts, strict=True):
            out += factors[:, change.by, None, None] * part
        return out

    def slopes(self, theta: Array, x: Array, seen: Array) -> Array:
        """Return the derivatives of the readings by the parameters.

        Parameters
        ----------
        theta : (n_changes,) array
            Log factors.
        x : (n, n_runs, 2m) array
            Modal states.
        seen : (n, n_runs, n_actuators) array
            Commands as the readings see them.

        Returns
        -------
        (n, n_runs, n_channels, n_changes) array
            Derivatives.
        """
        p, v = np.split(x, 2, axis=-1)
        out = np.zeros((*x.shape[:2], len(self.per_command), len(theta)))
        for change in self.changes:
            factor = np.exp(np.clip(theta[change.by], -REDUCED_MODEL.most, REDUCED_MODEL.most))
            out[..., change.by] = factor * (p @ change.at_q.T + v @ change.at_v.T + seen @ change.per_command.T)
        return out

    def added(self, theta: Array, recorded: Array, changed: Array) -> Array:
        """Return what readings gain over the nominal response to the recorded commands.

        Parameters
        ----------
        theta : (n_sets, n_changes) array
            Log factors.
        recorded : (n, n_runs, n_actuators) array
            Recorded commands as the readings see them.
        changed : (n, n_sets or 1, n_runs, n_actuators) array
            Changes of these commands by effects.

        Returns
        -------
        (n, n_sets, n_runs, n_channels) array
            Readings.
        """
        more = self.more_per_command(theta)
        out = np.einsum("nra,spa->nsrp", recorded, more)
        return out + np.einsum("nsra,spa->nsrp", np.broadcast_to(changed, (*out.shape[:3], more.shape[2])),
                               self.per_command + more)  # fmt: skip
