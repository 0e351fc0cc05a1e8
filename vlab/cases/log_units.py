"""Units of the logs, in which tables read best."""

from vlab.cases.description import CaseTable
from vlab.units import from_si, same_dimension


def log_units(table: CaseTable) -> dict[str, str]:
    """Return the unit of each channel in its logs.

    Parameters
    ----------
    table : CaseTable
        Contents of the case file.

    Returns
    -------
    dict of str to str
        Unit by channel. A channel without a unit, or with two, is left out.
    """
    found: dict[str, set[str]] = {}
    for recording in table.recording:
        for channel, name in zip(recording.channel, recording.channel_names, strict=True):
            found.setdefault(name, set()).add(channel.unit)
    return {name: units.pop() for name, units in found.items() if len(units) == 1 and units != {""}}


def in_log_unit(values: tuple[float | None, ...], si: str, unit: str | None) -> tuple[list[float | None], str]:
    """Return values in the unit of the log.

    Parameters
    ----------
    values : tuple of float or None
        Values in SI.
    si : str
        Their SI unit.
    unit : str or None
        Unit of the log, if known.

    Returns
    -------
    tuple of (list, str)
        Values, and the unit they are in: SI where the log's unit measures something else.
    """
    if unit is None or unit == si or not same_dimension(unit, si):
        return list(values), si
    return [None if value is None else from_si(value, unit, si) for value in values], unit
