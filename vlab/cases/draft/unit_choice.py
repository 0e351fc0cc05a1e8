"""Units of matched columns.

A column without a stated unit has the unit in which all columns of its group stay inside the ranges of the model. If
several units remain, the first seconds are simulated in each. If the simulation tells nothing, the size decides.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product
from typing import Any

import numpy as np

from vlab import units
from vlab.cases.case import read_run
from vlab.cases.channel_map import Run
from vlab.cases.checks.beside import UNEXPLAINED, first_seconds
from vlab.cases.checks.ranges import MARGIN, is_inside, limits_of
from vlab.cases.description import ChannelTable, RecordingTable
from vlab.cases.draft.logs import Log, LogClock
from vlab.cases.draft.matching import Match, unit_of
from vlab.cases.draft.vector_sensors import AXES, is_accelerometer
from vlab.cases.simulate import simulate
from vlab.errors import VlabError
from vlab.plants.base import Plant
from vlab.recordings.overview import TURN
from vlab.signals import Array, Recording

CANDIDATES = {
    "rad": ("rad", "deg"),
    "rad/s": ("rad/s", "deg/s", "rpm"),
    "rad/s^2": ("rad/s^2", "deg/s^2"),
    "m": ("m", "mm"),
    "m/s": ("m/s", "mm/s"),
    "m/s^2": ("m/s^2", "g"),
}
"""CANDIDATES: units of a log by SI unit, the usual one first."""
STEPS_TRIED = 4000
"""STEPS_TRIED [1]: integration steps of each trial."""
MOST_TRIED = 12
"""MOST_TRIED [1]: largest number of trials, each another choice of units."""
CONFIRMED = 0.1
"""CONFIRMED [1]: largest residual share with which the simulation confirms the clock; no other clock leaves so little."""
CLEARLY = 0.5
"""CLEARLY [1]: largest residual share of a choice over that of every other choice. A unit mistake changes a share by
far more; a tie of linear models stays near 1."""

HALFWAY = 30.0
"""HALFWAY [1]: motion of a log in metres over that of the model, or over its size, halfway from metres to millimetres."""


@dataclass(frozen=True, kw_only=True)
class Group:
    """Columns of a log that share a unit.

    Parameters
    ----------
    si : str
        SI unit.
    is_input : bool
        Whether the columns drive the model.
    """

    si: str
    is_input: bool


def choose_units(log: Log, clock: LogClock, plant: Plant, used: Sequence[Match]) -> tuple[Match, ...]:
    """Choose the unit of every matched column.

    Parameters
    ----------
    log : Log
        First log.
    clock : LogClock
        Clock of the log.
    plant : Plant
        Model.
    used : sequence of Match
        Matched columns.

    Returns
    -------
    tuple of Match
        Columns with unit and reason.
    """
    out, groups = [], dict[Group, list[int]]()
    for i, match in enumerate(used):
        si = unit_of(plant, match)
        if match.stated and (not si or units.same_dimension(match.stated, si)):
            out.append(replace(match, unit=match.stated, why_unit="stated by file or name"))
        elif si in CANDIDATES:
            out.append(match)
            groups.setdefault(Group(si=si, is_input=match.is_input), []).append(i)
        else:
            unit = {"voltage": "V", "current": "A"}.get(match.kind, si)
            out.append(replace(match, unit=unit, why_unit="the unit of the model" if unit else ""))
    left = {group: _inside(log, plant, [out[i] for i in members]) for group, members in groups.items()}
    said = {group: (units_left[0], why) for group, (units_left, why) in left.items() if len(units_left) == 1}
    said |= _by_turn(out, groups)
    several = {g: units_left for g, (units_left, _) in left.items() if len(units_left) > 1 and g not in said}
    tried = _simulated(log, clock, plant, out, groups, said, several) if several else {}
    for group, members in groups.items():
        sure = group in said or group in tried
        alike = [
            g for g in groups if g.si == group.si and g not in said and g not in tried
        ]  # their sizes belong together
        all_alike = [out[i] for g in alike for i in groups[g]]
        unit, why = said.get(group) or tried.get(group) or _by_size(log, clock, plant, group.si, out, all_alike, said)
        counts = next((w for i in members if (w := _counts(log, out[i], unit))), "")
        for i in members:
            out[i] = replace(out[i], unit=unit, why_unit=counts or why, is_unit_sure=sure and not counts)
    return tuple(out)


def _counts(log: Log, match: Match, unit: str) -> str:
    """Return a doubt on an angle that looks like counts of an encoder.

    Whole numbers within one turn, and more than one turn off zero, are no angle in degrees.
    """
    if unit != "deg" and unit != "rad":
        return ""
    values = _values(log, match)
    turn = TURN / units.factor(unit, "rad")
    if not values.size or not np.all(values == np.rint(values)):
        return ""
    middle = float(np.median(values))
    if abs(middle) < turn or np.ptp(values) >= abs(middle):
        return ""
    return (
        f"whole numbers about {middle:g}, as counts of an encoder: state scale, the rad a count, in place of unit, and "
        "offset, the count at zero"
    )


def _by_turn(matches: Sequence[Match], groups: Mapping[Group, Sequence[int]]) -> dict[Group, tuple[str, str]]:
    """Return the units in which the jumps of wrapped angles are full turns."""
    out = {}
    for group, members in groups.items():
        wrapped = next((matches[i] for i in members if matches[i].turn), None)
        if wrapped is not None:
            out[group] = (wrapped.turn, f"{wrapped.label!r} jumps by a full turn in {wrapped.turn}")
    return out


# ---- ranges of the model -----------------------------------------------------------------------------------------


def _inside(log: Log, plant: Plant, members: Sequence[Match]) -> tuple[tuple[str, ...], str]:
    """Return units that keep all columns inside ranges, with reason."""
    si = unit_of(plant, members[0])
    candidates = CANDIDATES[si]
    limits = [(m, limits_of(plant, m.at, m.kind, is_input=m.is_input)) for m in members]
    known = [(m, found) for m, found in limits if found is not None]
    kept = tuple(
        unit
        for unit in candidates
        if all(is_inside(_values(log, m) * units.factor(unit, si), found) for m, found in known)
    )
    if not known or not kept or len(kept) == len(candidates):
        return candidates, ""
    other = next(unit for unit in candidates if unit not in kept)
    out = next(m for m, found in known if not is_inside(_values(log, m) * units.factor(other, si), found))
    return kept, f"in {other} {out.label!r} would leave the range of the model"


def _values(log: Log, match: Match) -> Array:
    values = log.table.real(match.column)
    return np.asarray(values[np.isfinite(values)])


# ---- simulation --------------------------------------------------------------------------------------------------


def _simulated(
    log: Log,
    clock: LogClock,
    plant: Plant,
    matches: Sequence[Match],
    groups: Mapping[Group, Sequence[int]],
    said: Mapping[Group, tuple[str, str]],
    several: Mapping[Group, tuple[str, ...]],
) -> dict[Group, tuple[str, str]]:
    """Return the units of groups that the simulation tells clearly."""
    open_groups = list(several)
    shares: dict[tuple[str, ...], float] = {}
    for choice in islice(product(*several.values()), MOST_TRIED):
        chosen = {group: unit for group, (unit, _) in said.items()} | dict(zip(open_groups, choice, strict=True))
        tried = list(matches)
        for group, members in groups.items():
            for i in members:
                tried[i] = replace(tried[i], unit=chosen[group])
        shares[choice] = residual_share(log, clock, plant, tried)
    best = min(shares, key=lambda choice: shares[choice])
    out = {}
    for k, group in enumerate(open_groups):
        others = [share for choice, share in shares.items() if choice[k] != best[k]]
        if others and shares[best] < UNEXPLAINED and shares[best] <= CLEARLY * min(others):
            why = (
                f"simulated so, {percent(shares[best])} of the readings is left over, otherwise {percent(min(others))}"
            )
            out[group] = (best[k], why)
    return out


def residual_share(log: Log, clock: LogClock, plant: Plant, matches: Sequence[Match]) -> float:
    """Return the share of the readings that the simulation leaves over.

    Parameters
    ----------
    log : Log
        Log.
    clock : LogClock
        Clock of the log.
    plant : Plant
        Model.
    matches : sequence of Match
        Columns with their units.

    Returns
    -------
    float
        Mean over the channels, at most 1; 1 where the model cannot follow.
    """
    both = _beside(log, clock, plant, matches)
    if both is None:
        return 1.0
    run, own = both
    shares = []
    for name in (c.channel for c in run.compared):
        read = run.measured.is_read(name)
        y, error = run.measured[name][read], (own[name] - run.measured[name])[read]
        if y.size and np.ptp(y) > 0.0:
            shares.append(min(1.0, float(np.mean(error**2) / np.var(y))))
    return float(np.mean(shares)) if shares else 1.0


def _beside(log: Log, clock: LogClock, plant: Plant, matches: Sequence[Match]) -> tuple[Run, Recording] | None:
    """Return the first seconds of a log and of the model, if simulated."""
    table = RecordingTable(
        file=log.path.name,
        role="fit",
        time=clock.time,
        time_unit=clock.unit,
        rate_hz=clock.rate_hz,
        channel=tuple(ChannelTable(**channel_keys(match) | {"column": match.column}) for match in matches),
    )
    try:
        run = first_seconds(plant, read_run(plant, "draft", table, log.table), STEPS_TRIED)
        with np.errstate(all="ignore"):
            return run, simulate(plant, run).recording
    except VlabError:
        return None


def percent(share: float) -> str:
    """Return a share in words, such as ``"0.11 %"``."""
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


def channel_keys(match: Match) -> dict[str, Any]:
    """Return the keys of a column's table in the case.

    Parameters
    ----------
    match : Match
        Column with its place and unit.

    Returns
    -------
    dict of str to object
        Values by key of ``[[channel]]``.
    """
    keys: dict[str, Any] = {"column": match.label, "at": match.at, "kind": match.kind}
    keys |= {"unit": match.unit} if match.unit else {}
    keys |= {} if match.scale is None else {"scale": match.scale}
    keys |= {"unwrap": True} if match.wraps else {}
    return keys | ({"input": True} if match.is_input else {})


# ---- size --------------------------------------------------------------------------------------------------------


def _by_size(
    log: Log,
    clock: LogClock,
    plant: Plant,
    si: str,
    matches: Sequence[Match],
    members: Sequence[Match],
    said: Mapping[Group, tuple[str, str]],
) -> tuple[str, str]:
    """Return the unit that the size of the values suggests."""
    largest = max(float(np.abs(_values(log, m)).max(initial=0.0)) for m in members)
    if si == "rad":
        if largest > TURN:
            return _radians(log, clock, plant, matches, members, largest)
        return "rad", f"values up to {largest:.4g} are less than a turn in rad"
    if si == "m":
        return _metres(log, clock, plant, matches, members, largest)
    if si == "m/s^2":
        return _accelerations(log, plant, members)
    is_in_degrees = any(unit == "deg" for unit, _ in said.values()) or any(m.stated == "deg" for m in matches)
    if si.startswith("rad/") and is_in_degrees:
        return si.replace("rad", "deg"), "the angles of the log are in degrees"
    return si, "the SI unit"


def _radians(
    log: Log, clock: LogClock, plant: Plant, matches: Sequence[Match], members: Sequence[Match], largest: float
) -> tuple[str, str]:
    """Return radians or degrees by the motion of the model, with reason.

    An unlimited hinge may turn several times. Radians stay where both units fit, or none.
    """
    beyond = f"values up to {largest:.4g} are more than a turn in rad"
    limits = [limits_of(plant, m.at, m.kind, is_input=m.is_input) for m in members]
    if any(found is not None for found in limits):
        return "deg", beyond
    halfway = np.sqrt(units.factor("rad", "deg"))
    sizes = {unit: _size_beside_model(log, clock, plant, matches, members, unit) for unit in CANDIDATES["rad"]}
    fitting = [unit for unit, size in sizes.items() if size is not None and 1.0 / halfway < size < halfway]
    if len(fitting) == 1:
        return fitting[
            0
        ], f"{beyond}, and the motion in {fitting[0]} is {sizes[fitting[0]]:.2g} times that of the model"
    both = "rad and deg both fit" if fitting else "the model moves as far neither in rad nor in deg"
    return "rad", f"{beyond}, which the hinge may make; {both}, so state the unit"


def _accelerations(log: Log, plant: Plant, members: Sequence[Match]) -> tuple[str, str]:
    """Return m/s^2 or g by an accelerometer of three axes, which feels gravity."""
    gravity = float(np.linalg.norm(plant.model.opt.gravity))
    axes = {m.at: m for m in members}
    for base in [at.removesuffix(".x") for at in axes if at.endswith(".x")]:
        own = [axes.get(f"{base}.{axis}") for axis in AXES]
        if gravity == 0.0 or None in own or not is_accelerometer(plant, base):
            continue
        readings = np.stack([log.table.real(m.column) for m in own if m is not None])
        size = float(np.nanmedian(np.linalg.norm(readings, axis=0))) if np.isfinite(readings).all(axis=0).any() else 0.0
        if not size > 0.0:
            continue
        sizes = {unit: size * units.factor(unit, "m/s^2") / gravity for unit in CANDIDATES["m/s^2"]}
        unit = min(sizes, key=lambda u: abs(np.log(sizes[u])))
        return unit, f"in {unit}, the size of the three axes of {base!r} is {sizes[unit]:.2g} times gravity"
    return "m/s^2", "the SI unit"


def _metres(
    log: Log, clock: LogClock, plant: Plant, matches: Sequence[Match], members: Sequence[Match], largest: float
) -> tuple[str, str]:
    """Return metres or millimetres, with the reason."""
    limits = [(m, limits_of(plant, m.at, m.kind, is_input=m.is_input)) for m in members]
    known = [(m, found) for m, found in limits if found is not None]
    if known:
        shares = [float(np.ptp(_values(log, m))) / (found[1] - found[0]) for m, found in known]
        if max(shares) <= 1.0 + MARGIN:
            return "m", f"the values take {percent(max(shares))} of the joint's range in m; in mm they fit, too"
        return "mm", f"the values take {percent(1e-3 * max(shares))} of the joint's range in mm, and more than all in m"
    extent = float(plant.model.stat.extent)
    if largest <= extent:
        return "m", f"values up to {largest:.4g} are less than the model's size of {extent:.3g} m"
    beyond = f"values up to {largest:.4g} are more than the model's size of {extent:.3g} m"
    if any(m.is_input for m in members):  # the motion of the model grows with the unit of its command
        return "mm" if largest > HALFWAY * extent else "m", f"{beyond}; the model follows the command in m and in mm"
    size = _size_beside_model(log, clock, plant, matches, members, "m")
    if size is None or size > HALFWAY:
        return "mm", beyond
    return "m", f"{beyond}, and the motion in m is {size:.2g} times that of the model; in mm they fit, too"


def _size_beside_model(
    log: Log, clock: LogClock, plant: Plant, matches: Sequence[Match], members: Sequence[Match], unit: str
) -> float | None:
    """Return the largest motion in a unit over that of the model."""
    tried = [
        replace(m, unit=unit) if m in members else m if m.unit else replace(m, unit=unit_of(plant, m)) for m in matches
    ]
    both = _beside(log, clock, plant, tried)
    if both is None:
        return None
    run, own = both
    names = {m.at for m in members if not m.is_input} & {c.channel for c in run.compared}
    sizes = {name: float(np.std(own[name])) for name in names}
    return max(
        (float(np.std(run.measured[name])) / size for name, size in sizes.items() if 0.0 < size < np.inf), default=None
    )
