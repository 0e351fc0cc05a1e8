"""Recordings of several inputs in turn, cut into one recording an input."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vlab.signals import Recording


def in_turns(recordings: Sequence[Recording]) -> list[Recording]:
    """Return one recording a turn.

    The note ``turn_s`` of a recording states that its inputs act one after another, for so long each. The end of one
    turn rings into the next: a periodic signal drops the beginning of each turn, and other signals come to rest.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings.

    Returns
    -------
    list of Recording
        Recordings of one input each where turns are noted; all others unchanged.
    """
    return [part for recording in recordings for part in _turns(recording)]


def _turns(recording: Recording) -> list[Recording]:
    turn_s = recording.meta.get("turn_s")
    inputs = recording.inputs
    if turn_s is None or len(inputs) < 2:
        return [recording]
    per_turn = round(float(turn_s) * recording.rate)
    meta = {key: value for key, value in recording.meta.items() if key != "turn_s"}
    parts = []
    for i, name in enumerate(inputs):
        rows = slice(i * per_turn, (i + 1) * per_turn)
        if not np.any(recording[name][rows]):  # the record ends before this turn
            continue
        kept = recording.select([n for n in recording.names if n == name or n not in inputs])
        time = kept.time[rows] - kept.time[rows][0]
        parts.append(replace(kept, time=time, data=kept.data[rows], meta=meta))
    return parts
