"""Guarded loading of a user's own control law.

The law is a class without required arguments with the interface of `vlab.controllers.base.Controller`. Its members are
the attributes `sensors` and `actuators` and the methods `reset()` and `step(y) -> u`. Loading a law runs the code of
its file, so only a named file is loaded: ``path/to/law.py:ClassName``. ``entry:NAME`` means the entry point NAME of the
group ``vlab.laws`` of an installed package.
"""

import hashlib
import importlib.metadata
import importlib.util
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vlab.controllers.base import Controller
from vlab.controllers.direct_rate_feedback import DirectRateFeedback
from vlab.controllers.linear import LinearLaw

from vlab.errors import BadController, VlabError, unknown_name

GROUP = "vlab.laws"
"""Entry point group of packages with control laws."""
ENTRY = "entry:"
"""Prefix of an entry point's name."""
FORM = "path/to/law.py:ClassName or entry:NAME"
"""Form of a user's law, for messages."""
MOST_CHANNELS = 1000
"""MOST_CHANNELS [1]: largest number of sensors or actuators of a law."""
FAILURES = (Exception, SystemExit)
"""Exceptions of a user's code that become one line. A keyboard interrupt does not."""


def is_user_law(text: str) -> bool:
    """Return whether a name means a user's own law.

    Such a name contains a Python file or an entry point.
    """
    return text.startswith(ENTRY) or text.endswith(".py") or ".py:" in text


def code_of(name: str) -> str:
    """Return the code that a name would run.

    The result is ``mine.py`` for ``mine.py:Class``, ``entry:NAME`` itself, and ``""`` for a name without code.
    """
    if not is_user_law(name):
        return ""
    file, colon, _ = name.rpartition(":")
    return file if colon and file.endswith(".py") else name


def check_code(
    name: str, code: Collection[str] | None, *, kind: str = "law", error: type[VlabError] = BadController
) -> None:
    """Refuse a name with code that the user did not name.

    A name may come from a data folder.

    Parameters
    ----------
    name : str
        Name of a law or an effect.
    code : collection of str or None
        Python files and entry points that the user named, as returned by `code_of`. None if the user gave `name` in
        Python or on the command line.
    kind, error : str, type
        Kind of object in the message, and type of the exception.

    Raises
    ------
    BadController
        The code is not listed; `error` replaces the type.
    """
    wanted = code_of(name)
    if code is None or not wanted or wanted in code:
        return
    if Path(wanted).resolve() in {Path(c).resolve() for c in code if c.endswith(".py")}:
        return
    raise error(
        f"unknown {kind} {name!r}: it is code that a file of data names, and data run nobody's code; accepted: {kind}s of vlab's "
        "own catalogue, or code that you name yourself on the command line"
    )


def load_user_law(text: str) -> Controller:
    """Load a user's own law with a guard.

    Parameters
    ----------
    text : str
        ``path/to/law.py:ClassName`` or ``entry:NAME``.

    Returns
    -------
    Controller
        Guarded law.

    Raises
    ------
    BadController
        The file is missing, its code fails, or the object lacks the interface of a `Controller`.
    UnknownName
        No such class in the file, or no such entry point.
    """
    if text.startswith(ENTRY):
        made_by = from_entry_point(text.removeprefix(ENTRY))
    else:
        path, colon, name = text.rpartition(":")
        if not colon or not path.endswith(".py") or not name.isidentifier():
            raise BadController(f"the law {text!r} names no class of a file; write {FORM}")
        made_by = class_from_file(Path(path), name)
    law = instance(made_by, text)
    return law if type(law) in (DirectRateFeedback, LinearLaw) else GuardedLaw(law, text)  # check themselves


class GuardedLaw:
    """A user's law with checked results.

    An error becomes one line with the law's name and the sample.

    Parameters
    ----------
    law : Controller
        Object of the user.
    name : str
        Name given by the user.

    Raises
    ------
    BadController
        The object lacks the interface of a `Controller`.
    """

    def __init__(self, law: Any, name: str) -> None:
        self.name, self._law = name, law
        for needed in ("reset", "step"):
            if not callable(getattr(law, needed, None)):
                raise BadController(f"the law {name} has no method {needed}(); a law has reset() and step(y) -> u")
        self.sensors, self.actuators = self._places("sensors"), self._places("actuators")
        rate = getattr(law, "rate", None)
        if rate is not None and not (isinstance(rate, (int, float)) and np.isfinite(rate) and rate > 0):
            raise BadController(f"the law {name}: rate = {rate!r} is not a positive number of Hz; leave it out for any")
        self.rate: float | None = rate
        self._samples = 0

    def reset(self) -> None:
        """Clear the memory of the law.

        Raises
        ------
        BadController
            The law's own code failed.
        """
        self._samples = 0
        try:
            self._law.reset()
        except FAILURES as error:
            raise BadController(f"the law {self.name} fails in reset(): {_said(error)}") from error

    def step(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the law's commands, (n_actuators,).

        Parameters
        ----------
        y : array
            Samples, (n_sensors,).

        Returns
        -------
        array
            Finite commands.

        Raises
        ------
        BadController
            The law's code failed, or its result is not one finite number an actuator.
        """
        self._samples += 1
        try:
            given = self._law.step(np.array(y))
            u = np.asarray(given, dtype=float)
        except FAILURES as error:
            raise BadController(
                f"the law {self.name} fails in step() at sample {self._samples}: {_said(error)}"
            ) from error
        if given is None:
            raise BadController(
                f"the law {self.name} gave nothing at sample {self._samples}; does step() lack its return?"
            )
        if u.shape != (len(self.actuators),):
            raise BadController(
                f"the law {self.name} gave {_size(u)} at sample {self._samples}; {len(self.actuators)} are needed, one for each of ({', '.join(self.actuators)})"
            )
        if not np.isfinite(u).all():
            bad = self.actuators[int(np.flatnonzero(~np.isfinite(u))[0])]
            raise BadController(f"the law {self.name} gave {u[~np.isfinite(u)][0]} for {bad} at sample {self._samples}")
        return u

    def _places(self, what: str) -> tuple[str, ...]:
        places = getattr(self._law, what, None)
        if (
            isinstance(places, str)
            or not isinstance(places, Sequence)
            or not 1 <= len(places) <= MOST_CHANNELS
            or not all(isinstance(place, str) for place in places)
        ):
            raise BadController(
                f'the law {self.name} must say its {what} as places, for example {what} = ["base"]; it has {places!r}'
            )
        return tuple(places)


def class_from_file(
    path: Path, name: str, *, kind: str = "law", form: str = FORM, error: type[VlabError] = BadController
) -> Any:
    """Run a user's Python file and return an object by name.

    Parameters
    ----------
    path : Path
        Python file.
    name : str
        Name in the file.
    kind, form : str
        Kind of object and required form, for messages.
    error : type
        Type of the exception.

    Returns
    -------
    object
        The object.
    """
    if not path.is_file():
        raise error(f"there is no {kind} file {str(path)!r}; write {form}")
    label = f"vlab_user_{kind}_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(label, path)
    if spec is None or spec.loader is None:
        raise error(f"{path} cannot be read as Python")
    module = importlib.util.module_from_spec(spec)
    sys.modules[label] = module  # dataclasses look up their module
    try:
        spec.loader.exec_module(module)
    except FAILURES as failure:
        del sys.modules[label]
        raise error(f"the {kind} file {path} fails when it is loaded: {_said(failure)}") from failure
    if not hasattr(module, name):
        here = [key for key, value in vars(module).items() if isinstance(value, type) and value.__module__ == label]
        raise unknown_name("class", name, here, where=str(path))
    return getattr(module, name)


def from_entry_point(
    name: str, *, group: str = GROUP, kind: str = "law", error: type[VlabError] = BadController
) -> Any:
    """Load an object of an installed package.

    Parameters
    ----------
    name : str
        Name of the entry point.
    group : str
        Group of entry points.
    kind : str
        Kind of object, for messages.
    error : type
        Type of the exception.

    Returns
    -------
    object
        The object.

    Raises
    ------
    UnknownName
        No such entry point.
    BadController
        Several packages offer the name, or loading fails; `error` replaces the type.
    """
    points = importlib.metadata.entry_points(group=group)
    chosen = [point for point in points if point.name == name]
    if not chosen:
        raise unknown_name("entry point", name, [point.name for point in points], where=f"group {group!r}")
    if len(chosen) > 1:
        raise error(
            f"{len(chosen)} installed packages offer a {kind} {name!r} ({', '.join(p.value for p in chosen)}); keep one"
        )
    try:
        return chosen[0].load()
    except FAILURES as failure:
        raise error(
            f"the entry point {name!r} ({chosen[0].value}) fails when it is loaded: {_said(failure)}"
        ) from failure


def instance(made_by: Any, text: str) -> Any:
    """Return an object from a class, function or object.

    A class or function is called without arguments.

    Parameters
    ----------
    made_by : object
        Class, function, or the law itself.
    text : str
        Name of the law, for messages.

    Returns
    -------
    object
        Law, not yet checked.

    Raises
    ------
    BadController
        The class or function fails without arguments.
    """
    if not callable(made_by) or (callable(getattr(made_by, "step", None)) and not isinstance(made_by, type)):
        return made_by
    try:
        return made_by()
    except FAILURES as error:
        raise BadController(
            f"the law {text} cannot be made without arguments: {_said(error)}; give every argument a default, or make the "
            "law in Python: vlab.experiment(..., law=...)"
        ) from error


def _size(u: NDArray[np.float64]) -> str:
    if u.ndim == 0:
        return "a single number"
    return f"{len(u)} commands" if u.ndim == 1 else f"an array of shape {u.shape}"


def _said(error: BaseException) -> str:
    """Return an exception as one line, with the line of the user's file."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:300] + _line_of(error)


def _line_of(error: BaseException) -> str:
    """Return the last line of the user's file, or an empty text."""
    file, line, step = "", 0, error.__traceback__
    while step is not None:
        of = step.tb_frame
        is_own = str(of.f_globals.get("__name__", "")).startswith(("vlab.", "importlib"))
        file = file or ("" if is_own else of.f_code.co_filename)
        if file and of.f_code.co_filename == file:  # deeper frames are of packages that the file calls
            line = step.tb_lineno
        step = step.tb_next
    return f" ({Path(file).name}:{line})" if file else ""
