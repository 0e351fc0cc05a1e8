"""vlab: a virtual laboratory for flexible structures under active vibration control, on MuJoCo.

From arrays to an answer::

    import vlab

    case = vlab.Case.from_arrays("arm.xml", t, {"motor": torque}, {"encoder": angle})
    result = vlab.diagnose(case)
    print(result)
    result.report("report.html")

`Case` holds a model and recordings. `diagnose` finds physics that the model lacks. `experiment` simulates an experiment
on a structure, `modal_test` estimates its modes, and `design` designs a control law. Every name is imported at first
use.
"""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vlab.api.design import DesignedLaw, design
    from vlab.api.diagnosis import Diagnosis, diagnose
    from vlab.api.experiment import experiment
    from vlab.api.modal_test import modal_test
    from vlab.api.schema import diagnosis_schema
    from vlab.cases.case import Case, load_case
    from vlab.errors import VlabError
    from vlab.physics.catalogue import effects
    from vlab.signals import Recording

__version__ = "0.1.0"

__all__ = [
    "Case",
    "DesignedLaw",
    "Diagnosis",
    "Recording",
    "VlabError",
    "__version__",
    "design",
    "diagnose",
    "diagnosis_schema",
    "effects",
    "experiment",
    "load_case",
    "modal_test",
]

_HOMES = {
    "Case": "vlab.cases.case",
    "DesignedLaw": "vlab.api.design",
    "Diagnosis": "vlab.api.diagnosis",
    "Recording": "vlab.signals",
    "VlabError": "vlab.errors",
    "diagnosis_schema": "vlab.api.schema",
    "effects": "vlab.physics.catalogue",
    "experiment": "vlab.api.experiment",
    "load_case": "vlab.cases.case",
    "modal_test": "vlab.api.modal_test",
}
_VERBS = {"vlab.design": "vlab.api.design", "vlab.diagnose": "vlab.api.diagnosis"}
"""Packages that are functions, too, with the module of the function of the same name."""


class CallablePackage(ModuleType):
    """Package that is also the function of its name."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Call the function of the package's name."""
        function = getattr(import_module(_VERBS[self.__name__]), self.__name__.rpartition(".")[2])
        return function(*arguments, **options)


def __getattr__(name: str) -> Any:
    """Import a public name at first use."""
    if f"vlab.{name}" in _VERBS:
        return import_module(f"vlab.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'vlab' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    modules = {name for name, value in globals().items() if isinstance(value, ModuleType)}
    special = {name for name in globals() if name.startswith("__")}
    return sorted({*modules, *special, *__all__})
