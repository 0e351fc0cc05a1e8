"""Control laws by name, wired to a structure's coils."""

from collections.abc import Collection

from vlab.controllers import Controller, DirectRateFeedback
from vlab.controllers.catalogue import LAWS, published_way
from vlab.controllers.law_file import is_law_file, load_law
from vlab.controllers.lqg import RATE
from vlab.controllers.user_law import check_code, is_user_law, load_user_law
from vlab.design.published_tables import published_table, published_tables
from vlab.errors import BadController, unknown_name
from vlab.structure.model import Structure

GAIN_TABLES = {"beam": "7", "grid": "11"}
"""The table that prints each structure's direct rate feedback gains."""


def law_names(structure: Structure) -> list[str]:
    """Return the names of the laws whose gains were printed for a structure."""
    number = GAIN_TABLES.get(structure.name)
    return [table.part for table in published_tables(structure.name) if number is not None and table.number == number]


def named_law(
    structure: Structure,
    name: str,
    *,
    rate: float = RATE,
    variant: str = "published",
    model: str = "",
    code: Collection[str] | None = None,
) -> Controller:
    """Return a law by its name.

    A user's own from the file or entry point that the name says; one that `vlab design` wrote (``controller.toml``); one
    with printed gains, unless a model is named; or one that is designed here and now with the published weights.

    Parameters
    ----------
    rate : float
        Samples per second of the loop, for laws with states [Hz].
    variant : str
        Of the structure's model that a law is designed on.
    model : str
        To design the law on (`vlab.fe.reduced.MODELS`); that of the published design by default.
    code : collection of str, optional
        Where the name comes from a file of data: the Python files and entry points that the user named, of which it may name one.
        None: the user gives the name.

    Raises
    ------
    UnknownName
        No law of that name.
    BadController
        A law that cannot run in a loop, code that the user did not name, or a bad law file, or a model for a law that is not designed here.
    """
    if model and (is_user_law(name) or is_law_file(name)):
        raise BadController(f"the law {name} is made already: the model {model!r} is for laws that are designed here")
    if is_user_law(name):
        check_code(name, code)
        return load_user_law(name)
    if is_law_file(name):
        return load_law(name)
    printed = law_names(structure)
    if name in printed and not model:
        return published_law(structure, name)
    if name == "lqr":
        raise BadController(
            "the law lqr feeds every state back, which no sensors measure; take lqg, which estimates them"
        )
    if name not in LAWS:
        known = [*printed, *(law for law in LAWS if law not in printed and law != "lqr")]
        raise unknown_name("law", name, known, where=f"structure {structure.name!r}")
    return published_way(structure, name, rate=rate, variant=variant, model=model).controller


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
