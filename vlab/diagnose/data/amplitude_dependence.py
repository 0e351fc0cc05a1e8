"""Amplitude dependence of frequency responses at several excitation levels.

Poles fitted per level give the trend of every natural frequency and damping ratio.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlab.diagnose.data.responses import Measured, Response
from vlab.diagnose.settings import AMPLITUDE_DEPENDENCE
from vlab.errors import VlabError
from vlab.modal.poles import estimate_poles
from vlab.signals import Array, FrequencyResponse

ONE_LEVEL = (
    "responses at one level cannot tell nonlinear effects from linear ones: there dry friction and drag look like damping, "
    "hardening and micro-slip like stiffness"
)
"""Note on responses at a single level."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trend:
    """Natural frequency and damping of one mode over the levels.

    Parameters
    ----------
    levels, freq, zeta : (n,) array
        Levels in ascending order, frequencies [Hz] and damping ratios [1].
    """

    levels: Array
    freq: Array
    zeta: Array

    def words(self) -> str:
        """Describe the change with the level, and the physics with that signature."""
        shift = float(np.log(self.freq[-1] / self.freq[0]))
        growth = float(np.log(self.zeta[-1] / self.zeta[0]))
        said = []
        if abs(shift) > AMPLITUDE_DEPENDENCE.least_shift:
            said.append(f"its frequency {'rises' if shift > 0 else 'falls'} by {100 * abs(shift):.2g} %")
        if abs(growth) > AMPLITUDE_DEPENDENCE.least_damping:
            said.append(f"its damping ratio goes from {100 * self.zeta[0]:.3g} to {100 * self.zeta[-1]:.3g} %")
        if not said:
            return ""
        return f"mode at {self.freq[0]:.4g} Hz: {' and '.join(said)} with the level, as by {_cause(shift, growth)}"


def _cause(shift: float, growth: float) -> str:
    hardens, softens = shift > AMPLITUDE_DEPENDENCE.least_shift, shift < -AMPLITUDE_DEPENDENCE.least_shift
    damps, frees = growth > AMPLITUDE_DEPENDENCE.least_damping, growth < -AMPLITUDE_DEPENDENCE.least_damping
    if softens and damps:
        return "micro-slip in joints or hysteresis"
    if frees:
        return "dry friction" + (" that also holds the structure at small amplitudes" if softens else "")
    if damps and not hardens:
        return "drag that grows with the speed"
    if hardens:
        return "a hardening stiffness, or a clearance that closes"
    return "a softening stiffness, or a clearance"


def level_notes(measured: Sequence[Measured]) -> list[str]:
    """Return notes on the amplitude dependence of responses.

    Parameters
    ----------
    measured : sequence of Response or Modes
        Measured data; responses of one input and output set form a group.

    Returns
    -------
    list of str
        Notes for the report.
    """
    responses = [d for d in measured if isinstance(d, Response)]
    groups: dict[tuple[str, tuple[str, ...], int], list[Response]] = {}
    for data in responses:
        groups.setdefault((data.input, data.outputs, data.order), []).append(data)
    several = [group for group in groups.values() if len(group) > 1]
    if not responses:
        return ["a table of modes is of one level: nonlinear effects cannot be told from linear ones by it"]
    if not several:
        return [ONE_LEVEL]
    out = []
    for group in several:
        out += _compared(group)
    return out


def _compared(group: list[Response]) -> list[str]:
    known = all(d.level is not None for d in group)
    group = sorted(group, key=lambda d: d.level or 0.0)
    first, last = group[0], group[-1]
    apart = _apart(first, last)
    pair = f"{', '.join(first.outputs)} from {first.input}"
    if apart <= AMPLITUDE_DEPENDENCE.differ:
        if not known:
            return [f"the responses {pair} were measured {len(group)} times and agree; their levels are not stated"]
        return [
            f"the responses {pair} at {len(group)} levels agree within their noise: nothing depends on the amplitude"
        ]
    if not known:
        return [
            f"the responses {pair} were measured {len(group)} times and differ by {apart:.2g} times their noise: "
            "something depends on the level or on time; state level in each [[frf]]"
        ]
    trends = [words for trend in trends_of(group) if (words := trend.words())]
    start = f"the responses {pair} differ over their {len(group)} levels by {apart:.2g} times their noise: no linear model explains all"
    return [start, *trends]


def _apart(a: Response, b: Response) -> float:
    """Return the rms difference of two responses over their noise."""
    low, high = max(a.freq[0], b.freq[0]), min(a.freq[-1], b.freq[-1])
    keep = (a.freq >= low) & (a.freq <= high)
    if keep.sum() < 2:
        return 0.0
    line = a.freq[keep]

    def at(values: Array) -> Array:
        return np.column_stack([np.interp(line, b.freq, column) for column in values.T])

    other = np.abs(at(b.H)) if a.is_magnitude or b.is_magnitude else at(b.H.real) + 1j * at(b.H.imag)
    own = np.abs(a.H[keep]) if a.is_magnitude or b.is_magnitude else a.H[keep]
    return float(np.sqrt(np.mean(np.abs(own - other) ** 2 / (a.spread[keep] ** 2 + at(b.spread) ** 2))))


def trends_of(group: Sequence[Response]) -> list[Trend]:
    """Return the modes of responses at several levels, paired by frequency.

    Parameters
    ----------
    group : sequence of Response
        Responses in ascending level.

    Returns
    -------
    list of Trend
        Modes found at all levels; empty without phases, levels or poles.
    """
    found = []
    for data in group:
        if data.is_magnitude or data.level is None:
            return []
        whole = FrequencyResponse(freq=data.freq, H=data.H[:, :, None], outputs=data.outputs, inputs=(data.input,))
        try:
            poles = estimate_poles(whole)
        except VlabError:  # too few lines, or no identifiable mode
            return []
        found.append((float(data.level), poles.freq, poles.zeta))
    out = []
    for k, freq in enumerate(found[0][1]):
        rows = [(found[0][0], freq, found[0][2][k])]
        for level, others, ratios in found[1:]:
            near = int(np.argmin(np.abs(np.log(others / rows[-1][1])))) if len(others) else -1
            if near < 0 or abs(np.log(others[near] / rows[-1][1])) > AMPLITUDE_DEPENDENCE.same_mode:
                break
            rows.append((level, others[near], ratios[near]))
        if len(rows) == len(found):
            table = np.array(rows, dtype=float)
            out.append(Trend(levels=table[:, 0], freq=table[:, 1], zeta=np.maximum(table[:, 2], 1e-6)))
    return out
