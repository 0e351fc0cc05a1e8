"""Runs without a plant, for what looks at recordings alone."""

import numpy as np

from vlab.cases.channel_map import Compared, Drive, Run
from vlab.signals import KIND_UNITS, Channel, Recording


def run_of(time, sensors, inputs=None, name="run", kind="displacement"):
    """Return a run of named sensor signals [SI] and inputs [N] on some time stamps."""
    inputs = inputs or {}
    channels = [Channel(name=n, kind=kind, unit=KIND_UNITS[kind]) for n in sensors]
    channels += [Channel(name=n, kind="force", unit="N", is_input=True) for n in inputs]
    recording = Recording(
        time=time, data=np.column_stack([*sensors.values(), *inputs.values()]), channels=tuple(channels)
    )
    return Run(
        name=name,
        role="fit",
        measured=recording,
        before=None,
        drives=tuple(Drive(channel=n, port="somewhere") for n in inputs),
        compared=tuple(Compared(channel=n, sensor=i) for i, n in enumerate(sensors)),
        law=None,
        hardware=None,
        initial="auto",
    )
