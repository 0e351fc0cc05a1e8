"""Actuator effort of a run: commands, forces, saturation."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from vlab.plants.base import ActuatorTap
from vlab.signals import Array, rms


@dataclass(frozen=True, kw_only=True)
class ActuatorEffort:
    """Effort of one actuator over a run.

    All values are in the actuator's unit.

    Parameters
    ----------
    command_rms, command_peak : float
        Rms and peak of the law's commands at the samples.
    force_rms, force_peak : float
        Rms and peak of the amplifier's output, excitation included, averaged over each sample.
    saturated_share : float
        Share of time with command plus excitation beyond the amplifier's limit.
    """

    at: str
    unit: str
    command_rms: float
    command_peak: float
    force_rms: float
    force_peak: float
    saturated_share: float

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return asdict(self)


def actuator_efforts(
    taps: Sequence[ActuatorTap], commands: Array, applied: Array, saturated: Array
) -> tuple[ActuatorEffort, ...]:
    """Return the effort of every actuator.

    Parameters
    ----------
    taps : sequence of ActuatorTap
        Actuators in channel order.
    commands, applied : (n_samples, n_actuators) array
        Commands of the law, and forces averaged over each sample.
    saturated : (n_actuators,) array
        Share of time at the limit.

    Returns
    -------
    tuple of ActuatorEffort
        One entry an actuator.
    """

    return tuple(
        ActuatorEffort(
            at=tap.at,
            unit=tap.unit,
            command_rms=rms(commands[:, i]),
            command_peak=float(np.abs(commands[:, i]).max()),
            force_rms=rms(applied[:, i]),
            force_peak=float(np.abs(applied[:, i]).max()),
            saturated_share=float(saturated[i]),
        )
        for i, tap in enumerate(taps)
    )
