"""Control law as an object or function of Python.

The object is a linear law, has a method step(y), or is a function u = f(y). The command line names a law in a file. In
Python a law may exist as an object alone. The run folder then holds the law itself: a linear law as ``controller.toml``,
which runs again, and any other law as ``law.txt``, which is a record.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vlab.controllers import Controller, DirectRateFeedback, LinearLaw, ObserverFeedback
from vlab.controllers.law_file import write_law
from vlab.controllers.user_law import GuardedLaw, instance
from vlab.errors import BadController
from vlab.files.text import one_line, printable, with_article
from vlab.plants.base import Plant
from vlab.signals import Array

PREFIX = "python:"
"""Prefix of the name of a law that existed in Python alone."""
LAW_FILE, RECORD = "controller.toml", "law.txt"
"""File in the run folder of a linear law, and of any other law."""
FORM = "a name, a law of vlab.design, an object with sensors, actuators, reset() and step(y), or a function u = f(y)"
"""Accepted laws, for messages."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GivenLaw:
    """A law that the user gave as an object.

    Parameters
    ----------
    law : object
        Law with the interface of `Controller`, or a function from samples to commands.
    name : str
        Name in the settings of the run: ``controller.toml`` of a linear law, else ``python:NAME``.
    """

    law: Any
    name: str

    @property
    def is_linear(self) -> bool:
        """Whether the law is written as a file that runs again."""
        return self.name == LAW_FILE

    def for_plant(self, plant: Plant) -> Controller:
        """Return the law with its channels.

        A function reads the velocity sensors beside the actuators, in the order of the actuators. Without such a pair
        for every actuator the function reads all sensors, in the order of the plant.

        Parameters
        ----------
        plant : Plant
            Plant of the run.

        Returns
        -------
        Controller
            Law; `GuardedLaw` unless the law is linear.

        Raises
        ------
        BadController
            The object lacks the interface of a `Controller`.
        """
        if self.is_linear:
            law: Controller = self.law
            return law
        name = self.name.removeprefix(PREFIX)
        return GuardedLaw(self.law if hasattr(self.law, "step") else _Function(self.law, plant), name)

    def write(self, folder: Path, law: Controller) -> None:
        """Write the law into a run folder.

        Parameters
        ----------
        folder : Path
            Run folder.
        law : Controller
            Law of the run, see `for_plant`.
        """
        if isinstance(law, DirectRateFeedback | LinearLaw):
            write_law(law, folder / LAW_FILE)
            return
        lines = [
            f"Law {self.name.removeprefix(PREFIX)}, an object of Python: a record, which vlab does not run.",
            f"sensors [SI]: {', '.join(law.sensors)}",
            f"actuators [SI]: {', '.join(law.actuators)}",
            f"object: {one_line(repr(self.law))}",
        ]
        source = _source_of(self.law)
        lines += ["source:", "", source] if source else ["source: not known to Python"]
        (folder / RECORD).write_text(printable("\n".join(lines)) + "\n", encoding="utf-8")


class _Function:
    """Law from a function u = f(y)."""

    def __init__(self, function: Callable[[Array], Any], plant: Plant) -> None:
        self._function = function
        self.actuators = tuple(tap.name for tap in plant.actuators if tap.name)
        beside = {tap.at: tap.name for tap in plant.sensors if tap.kind == "velocity"}
        paired = [beside.get(tap.at, "") for tap in plant.actuators if tap.name]
        self.sensors = tuple(paired if all(paired) else (tap.name for tap in plant.sensors if tap.name))

    def reset(self) -> None:
        """Do nothing; a function has no memory of its own."""

    def step(self, y: Array) -> Any:
        """Return the commands."""
        u = self._function(y)
        return np.ravel(u) if len(self.actuators) == 1 and u is not None else u  # one command may be a bare number


def given_law(given: Any) -> GivenLaw:
    """Return a law that was given as an object.

    Parameters
    ----------
    given : object
        Linear law, object or class with the interface of `Controller`, or function u = f(y).

    Returns
    -------
    GivenLaw
        Law with its name in the settings.

    Raises
    ------
    BadController
        The object is no law, or its class needs arguments.
    """
    law = instance(given, _name_of(given)) if isinstance(given, type) else given
    if isinstance(law, ObserverFeedback) and law.limit is None:  # the file keeps matrices, so the matrices run
        law = LinearLaw(*law.matrices, sensors=law.sensors, actuators=law.actuators)
    if type(law) in (DirectRateFeedback, LinearLaw):
        return GivenLaw(law=law, name=LAW_FILE)
    if not callable(law) and not hasattr(law, "step"):
        raise BadController(f"the law is {with_article(type(law).__name__)}; accepted: {FORM}")
    return GivenLaw(law=law, name=f"{PREFIX}{_name_of(given)}")


def refuse_record(name: str) -> None:
    """Refuse the name of a law that existed in Python alone.

    Parameters
    ----------
    name : str
        Name of a law.

    Raises
    ------
    BadController
        The name has the prefix `PREFIX`.
    """
    if name.startswith(PREFIX):
        raise BadController(
            f"the law {name.removeprefix(PREFIX)!r} was an object of Python, and {RECORD} is only its record; run it again with "
            "vlab.experiment(..., law=OBJECT), or write it in a file path/to/law.py:ClassName"
        )


def _name_of(law: Any) -> str:
    named = law if hasattr(law, "__qualname__") else type(law)
    return one_line(f"{named.__module__}.{named.__qualname__}", longest=120)


def _source_of(law: Any) -> str:
    """Return the source of a function or of an object's class."""
    try:
        return inspect.getsource(law if inspect.isroutine(law) else type(law))
    except (OSError, TypeError):  # built in, or typed at a prompt
        return ""
