"""Amplitude dependence of frequency responses at several excitation levels.

Poles fitted per level give the trend of every natural frequency and damping ratio.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlab.diagnose.data.responses import Measured, Modes, Response
from vlab.diagnose.settings import AMPLITUDE_DEPENDENCE
from vlab.errors import VlabError
from vlab.modal.poles import PoleEstimate, estimate_poles
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
        least = AMPLITUDE_DEPENDENCE.least_shift * float(self.zeta.min())
        said = []
        if abs(shift) > least:
            said.append(f"its frequency {'rises' if shift > 0 else 'falls'} by {100 * abs(shift):.2g} %")
        if abs(growth) > AMPLITUDE_DEPENDENCE.least_damping:
            said.append(f"its damping ratio goes from {100 * self.zeta[0]:.3g} to {100 * self.zeta[-1]:.3g} %")
        if not said:
            return ""
        return (
            f"mode at {self.freq[0]:.4g} Hz: {' and '.join(said)} with the level, as by {_cause(shift / least, growth)}"
        )


def _cause(shift: float, growth: float) -> str:
    """Return the physics behind a growth of damping and a shift.

    The shift is in units of the least one.
    """
    hardens, softens = shift > 1.0, shift < -1.0
    damps, frees = growth > AMPLITUDE_DEPENDENCE.least_damping, growth < -AMPLITUDE_DEPENDENCE.least_damping
    if softens and damps:
        return "micro-slip in joints, hysteresis, or a softening stiffness that bends the peak"
    if frees:
        return "dry friction" + (" that also holds the structure at small amplitudes" if softens else "")
    if damps and not hardens:
        return "drag that grows with the speed"
    if hardens:
        return "a hardening stiffness, or a clearance that closes"
    return "a softening stiffness, or a clearance"


def level_notes(measured: Sequence[Measured], trends: Sequence[Trend] = ()) -> list[str]:
    """Return notes on the amplitude dependence of responses.

    Parameters
    ----------
    measured : sequence of Response or Modes
        Measured data; responses of one input and output set form a group.
    trends : sequence of Trend
        Modes over the levels from a model; poles fitted to the responses by default.

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
    tables = sorted(
        (d for d in measured if isinstance(d, Modes) and d.amplitude is not None),
        key=lambda d: 0.0 if d.amplitude is None else float(d.amplitude.max()),
    )
    if not responses and len(tables) > 1:
        return [words for trend in trends_of_tables(tables) if (words := trend.words())]
    if not responses:
        return ["a table of modes is of one level: nonlinear effects cannot be told from linear ones by it"]
    if not several:
        return [ONE_LEVEL]
    out = []
    for group in several:
        out += _compared(group, own=not trends)
    return out + [words for trend in trends if (words := trend.words()) and out]


def level_scale_notes(measured: Sequence[Measured]) -> list[str]:
    """Return notes on the meaning of the stated levels.

    Parameters
    ----------
    measured : sequence of Response or Modes
        Data of known level.

    Returns
    -------
    list of str
        Notes for the report.
    """
    out = []
    if any(isinstance(d, Response) for d in measured):
        kinds = {"noise" if d.is_random else "a stepped sine" for d in measured if isinstance(d, Response)}
        out.append(
            f"levels are taken as the rms of {' and of '.join(sorted(kinds))} in the unit of the input; if that unit is a "
            "relative one, amplitudes and parameters of nonlinear effects have its scale"
        )
    if any(isinstance(d, Modes) for d in measured):
        out.append(
            "amplitudes of modal tables are taken in m or rad; on another scale, nonlinear effects have that scale"
        )
    return out


def _compared(group: list[Response], *, own: bool) -> list[str]:
    """Return notes on one group, with its poles' trends if asked."""
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
    trends = [words for trend in trends_of(group) if (words := trend.words())] if own else []
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
    is_same = np.array_equal(a.freq, b.freq)  # without interpolation, the noise is the whole error
    size = a.noise[keep] ** 2 + b.noise[keep] ** 2 if is_same else a.spread[keep] ** 2 + at(b.spread) ** 2
    return float(np.sqrt(np.mean(np.abs(own - other) ** 2 / size)))


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
        clear = _clear(poles)
        found.append((float(data.level), poles.freq[clear], poles.zeta[clear]))
    taken: list[set[int]] = [set() for _ in found]
    out = []
    for k, freq in enumerate(found[0][1]):
        rows = [(found[0][0], freq, found[0][2][k])]
        for used, (level, others, ratios) in zip(taken[1:], found[1:], strict=True):
            far = np.abs(np.log(others / rows[-1][1]))
            far[list(used)] = np.inf
            near = int(np.argmin(far)) if len(far) else -1
            if near < 0 or far[near] > AMPLITUDE_DEPENDENCE.same_mode:
                break
            used.add(near)
            rows.append((level, others[near], ratios[near]))
        if len(rows) == len(found):
            table = np.array(rows, dtype=float)
            out.append(Trend(levels=table[:, 0], freq=table[:, 1], zeta=np.maximum(table[:, 2], 1e-6)))
    return sorted(out, key=lambda trend: float(trend.freq[0]))


def _clear(poles: PoleEstimate) -> Array:
    """Return the indices of clear modes, highest peak first.

    Modes in the half-power band of a higher one are left out. A resonance that bends with the amplitude is fitted by
    two poles, of which the weaker is no mode.
    """
    height = np.abs(poles.participation).max(axis=0) / np.maximum(poles.zeta * poles.freq, 1e-300)
    kept: list[int] = []
    for k in np.argsort(-height):
        width = poles.zeta * poles.freq
        if all(abs(poles.freq[k] - poles.freq[i]) > width[k] + width[i] for i in kept):
            kept.append(int(k))
    return np.array(kept, dtype=int)


def trends_of_tables(tables: Sequence[Modes]) -> list[Trend]:
    """Return the trend of every mode over modal tables with amplitudes.

    Parameters
    ----------
    tables : sequence of Modes
        Tables with amplitudes, in ascending order; tables of another number of modes than the first are left out.

    Returns
    -------
    list of Trend
        Trends of modes with known damping at all amplitudes.
    """
    same = [d for d in tables if d.n == tables[0].n]
    out = []
    for k in range(tables[0].n if len(same) > 1 else 0):
        zeta = np.array([d.zeta[k] for d in same])
        if np.isfinite(zeta).all():
            levels = np.array([d.amplitude[k] for d in same if d.amplitude is not None])
            out.append(Trend(levels=levels, freq=np.array([d.freq[k] for d in same]), zeta=np.maximum(zeta, 1e-6)))
    return out
