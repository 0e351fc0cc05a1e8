"""Control laws by name for a structure's coils."""

from collections.abc import Collection

from vlab.controllers import Controller, DirectRateFeedback
from vlab.controllers.catalogue import LAWS, laws_in_a_loop, published_controller
from vlab.controllers.law_file import is_law_file, load_law
from vlab.controllers.lqg import RATE
from vlab.controllers.user_law import check_code, is_user_law, load_user_law
from vlab.design.published_tables import published_table, published_tables
from vlab.errors import BadController, unknown_name
from vlab.lab.given_law import refuse_record
from vlab.structure.model import Structure

GAIN_TABLES = {"beam": "7", "grid": "11"}
"""Number of the table with each structure's published gains."""


def law_names(structure: Structure) -> list[str]:
    """Return the names of a structure's published laws."""
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
    """Return a law by name.

    The name is a user's file or entry point, a law file of `vlab design` (``controller.toml``), a published law, or a
    design method. Published gains apply unless `model` is given. A design method uses the published weights.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    name : str
        Name or path.
    rate : float
        Sample rate of the loop [Hz], for laws with states.
    variant : str
        Variant of the structure's model for a design.
    model : str
        Design model (`vlab.fe.reduced.MODELS`); the published design's by default.
    code : collection of str, optional
        Python files and entry points that the user named, if `name` comes from a data file; `name` may then refer to
        one of the listed only. None if the user gave `name`.

    Returns
    -------
    Controller
        Law.

    Raises
    ------
    UnknownName
        No such law.
    BadController
        The law cannot run in a loop, the code or law file is refused, or a model is given for a law without design.
    """
    refuse_record(name)
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
    if name not in LAWS:
        known = dict.fromkeys([*printed, *laws_in_a_loop()])
        raise unknown_name("law", name, known, where=f"structure {structure.name!r}")
    return published_controller(structure, name, rate=rate, variant=variant, model=model)


def published_law(structure: Structure, name: str) -> Controller:
    """Return a published direct rate feedback law.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    name : str
        Name of the gain table's part.

    Returns
    -------
    Controller
        Law with the published gains [N s/m].

    Raises
    ------
    UnknownName
        No published gains of that name.
    """
    names = law_names(structure)
    if name not in names:
        raise unknown_name("law", name, names, where=f"structure {structure.name!r}")
    table = published_table(structure.name, GAIN_TABLES[structure.name], name)
    return DirectRateFeedback(table.si("N s/m"), sensors=table.columns, actuators=table.rows)
