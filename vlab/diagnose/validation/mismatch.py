"""Mismatch of the hold-out recordings by frequency band, channel and time."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from vlab.cases.misfit import misfit
from vlab.diagnose.validation.checked import Checked


def locate_mismatch(checked: Sequence[Checked]) -> dict[str, Any]:
    """Return the largest residuals by band, channel and time.

    Parameters
    ----------
    checked : sequence of Checked
        Recordings with their simulations.

    Returns
    -------
    dict
        Bands [Hz] and times [s] of the largest residuals, and the channels in order, with errors over the rms.
    """
    bands: list[dict[str, float]] = []
    channels: dict[str, float] = {}
    times: list[dict[str, Any]] = []
    for run in checked:
        simulated = run.standing
        if simulated is None:
            continue
        for name, errors in run.channels.items():
            channels[name] = max(channels.get(name, 0.0), errors[1])
            found = misfit(run.measured, simulated, name)
            for low, high, share in zip(
                found.band_edges_hz[:-1], found.band_edges_hz[1:], found.band_share, strict=True
            ):
                bands.append({"low_hz": float(low), "high_hz": float(high), "share": float(share), "nrmse": errors[1]})
            k = int(np.argmax(found.window_nrmse))
            times.append(
                {
                    "recording": run.name,
                    "channel": name,
                    "time_s": float(found.window_time_s[k]),
                    "nrmse": float(found.window_nrmse[k]),
                }
            )
    bands.sort(key=lambda b: -b["share"] * b["nrmse"] ** 2)
    times.sort(key=lambda t: -t["nrmse"])
    order = sorted(channels, key=lambda c: -channels[c])
    return {
        "where_frequency_hz": bands[:4],
        "where_channel": [{"channel": c, "nrmse": channels[c]} for c in order],
        "where_time_s": times[:4],
    }
