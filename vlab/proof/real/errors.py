"""Errors of a simulation on one recording, as `vlab diagnose` counts them.

The relative error of a channel is the rms error over the recording's rms about its mean. A recording counts by the rms over
its channels, and several recordings by the rms over recordings.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vlab.cases.channel_map import Run
from vlab.recordings.quality import held_samples
from vlab.signals import Recording, rms


@dataclass(frozen=True, kw_only=True)
class RecordingErrors:
    """Errors on one recording.

    Parameters
    ----------
    name : str
        Recording.
    channels : dict
        Relative error by channel; infinite after divergence.
    absolute : dict
        Rms error by channel [SI unit of the channel], without the first samples.
    size : dict
        Rms of the recorded channel, mean included, without the first samples [SI unit of the channel].
    """

    name: str
    channels: dict[str, float]
    absolute: dict[str, float]
    size: dict[str, float]

    @property
    def nrmse(self) -> float:
        """Relative error of the recording."""
        return rms(np.array(list(self.channels.values())))

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document."""
        return {
            "name": self.name,
            "nrmse": self.nrmse,
            "channels": self.channels,
            "absolute": self.absolute,
            "size": self.size,
        }


def errors_of(run: Run, simulated: Recording | None, skip: int = 0) -> RecordingErrors:
    """Return the errors of a simulation.

    Parameters
    ----------
    run : Run
        Recording.
    simulated : Recording or None
        Simulation at the same time stamps; None after divergence.
    skip : int
        First samples that the absolute errors leave out.

    Returns
    -------
    RecordingErrors
        Errors of every channel that moves.
    """
    kept = ~held_samples(run.measured)
    relative, absolute, size = {}, {}, {}
    for name in (c.channel for c in run.compared if np.ptp(run.measured[c.channel]) > 0):
        read = run.measured.is_read(name)
        late = kept & read & (np.arange(len(run.measured)) >= skip)
        size[name] = rms(run.measured[name][late])
        if simulated is None:
            relative[name] = absolute[name] = np.inf
            continue
        left = simulated[name] - run.measured[name]
        relative[name] = rms(left[kept & read]) / float(np.std(run.measured[name][read]))
        absolute[name] = rms(left[late])
    return RecordingErrors(name=run.name, channels=relative, absolute=absolute, size=size)


def rms_over_recordings(errors: Sequence[float]) -> float:
    """Return the error over several recordings; NaN without any."""
    return float(np.sqrt(np.mean(np.square(errors)))) if len(errors) else float("nan")
