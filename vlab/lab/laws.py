"""Control laws by name, wired to a structure's coils."""

from controllers import Controller, DirectRateFeedback
from vlab.errors import unknown_name
from vlab.published import published_table, published_tables
from vlab.structure.model import Structure

GAIN_TABLES = {"beam": "7"}
"""The table that prints each structure's direct rate feedback gains."""


def law_names(structure: Structure) -> list[str]:
    """Return the names of the laws that can be put into the loop of a structure."""
    number = GAIN_TABLES.get(structure.name)
    return [table.part for table in published_tables(structure.name) if number is not None and table.number == number]


def published_law(structure: Structure, name: str) -> Controller:
    """Return a published direct rate feedback law with its printed gains.

    Raises
    ------
    UnknownName
        No gains of that name were published for the structure.
    """
    names = law_names(structure)
    if name not in names:
        raise unknown_name("law", name, names, where=f"structure {structure.name!r}")
    table = published_table(structure.name, GAIN_TABLES[structure.name], name)
    return DirectRateFeedback(table.si("N s/m"), sensors=table.columns, actuators=table.rows)
