"""Result of a peer on a case, and what all peers share."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.plants.mjcf import MjcfPlant
from vlab.signals import Array, rms

MOST_ERROR = 1e3
"""MOST_ERROR [-]: held-out error of a model that diverges, and upper limit of any."""


class NotUsable(Exception):
    """A case that a peer cannot treat; the text is the reason."""


@dataclass(frozen=True, kw_only=True)
class Named:
    """Effect that a peer names.

    Parameters
    ----------
    effect, place : str
        Names as in the findings of a diagnosis.
    share : float
        Size or significance by which the peer chose, in its own unit.
    """

    effect: str
    place: str
    share: float


@dataclass(frozen=True, kw_only=True)
class PeerResult:
    """Result of a peer on a case.

    Parameters
    ----------
    named : Named or None
        First answer, as the first finding of a diagnosis; None where the peer adds nothing.
    names : tuple of str
        Effects that the peer can name.
    nrmse : float
        Held-out error over the channels' rms [-]; NaN without a free run.
    remark : str
        Caps that were met, and numbers of the fit.
    """

    named: Named | None
    names: tuple[str, ...]
    nrmse: float = float("nan")
    remark: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the result in the shape that the score reads."""
        found = [] if self.named is None else [vars(self.named)]
        return {"named": found, "names": list(self.names), "nrmse": self.nrmse, "note": "", "remark": self.remark}


@dataclass(frozen=True, kw_only=True)
class Deadline:
    """End of the CPU time of a peer on one case.

    Parameters
    ----------
    end_s : float
        CPU time of this process at the end [s].
    """

    end_s: float

    @classmethod
    def after(cls, seconds: float) -> "Deadline":
        """Return the deadline after some CPU time [s] from now."""
        return cls(end_s=time.process_time() + seconds)

    @property
    def is_past(self) -> bool:
        """Whether the time is up."""
        return time.process_time() >= self.end_s


def mjcf_runs(case: Case) -> tuple[MjcfPlant, list[Run], list[Run]]:
    """Return plant, fit recordings and hold-out recordings of a case.

    Parameters
    ----------
    case : Case
        Case.

    Returns
    -------
    tuple
        Plant, fit recordings, hold-out recordings.

    Raises
    ------
    NotUsable
        The model is no MJCF, a law is in the loop, or there is nothing to fit.
    """
    fit, holdout = case.runs(("fit",)), case.runs(("holdout",))
    if not isinstance(case.plant, MjcfPlant) or any(run.law is not None for run in [*fit, *holdout]):
        raise NotUsable("for MJCF models without a law in the loop")
    if not fit or not holdout:
        raise NotUsable("for cases with recordings to fit and to hold out")
    return case.plant, fit, holdout


def compared_names(run: Run) -> list[str]:
    """Return the moving compared channels of a run, without commands."""
    return [c.channel for c in run.compared if c.actuator is None and np.ptp(run.measured[c.channel]) > 0]


def error_of(run: Run, simulated: Array) -> float:
    """Return the error of simulated channels over the channels' rms.

    Parameters
    ----------
    run : Run
        Recording.
    simulated : (n, n_channels) array
        Channels of `compared_names` [SI].

    Returns
    -------
    float
        Rms over the channels, at most `MOST_ERROR`; the definition of the held-out error of a diagnosis.
    """
    errors = []
    for column, name in zip(simulated.T, compared_names(run), strict=True):
        read = run.measured.is_read(name)
        with np.errstate(over="ignore", invalid="ignore"):
            errors.append(rms((column - run.measured[name])[read]) / float(np.std(run.measured[name][read])))
    found = float(np.sqrt(np.mean(np.square(np.minimum(errors, MOST_ERROR)))))
    return found if np.isfinite(found) else MOST_ERROR


def mean_error(errors: Sequence[float]) -> float:
    """Return the rms of the errors of several recordings."""
    return float(np.sqrt(np.mean(np.square(errors))))
