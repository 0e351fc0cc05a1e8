"""How far models are from data, what every finding does there, and the share of the gap that is closed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from vlab.diagnose.settings import MODEL_CHOICE
from vlab.signals import Array

D = TypeVar("D", bound="Distance")


@dataclass(frozen=True, kw_only=True)
class Part:
    """What one finding does in one set of data.

    Parameters
    ----------
    left : float
        Relative error of the amended model without it.
    told : float
        Log-likelihood by which the data are expected to tell the amended model from that one, were all that either leaves noise.
    """

    name: str
    left: float
    told: float

    @property
    def is_idle(self) -> bool:
        """Whether the finding does nothing there that could be told from nothing at all."""
        return self.told < MODEL_CHOICE.alike


@dataclass(frozen=True, kw_only=True, eq=False)
class Distance:
    """How far the models are from one set of data.

    Parameters
    ----------
    nominal, before, after, noise : float
        Relative errors of the model as given, of that or the refitted one, whichever is nearer, and of the amended one, and what
        noise leaves.
    channels : dict
        The same by channel: (nominal, before, after, noise), `before` of the same model in all of them.
    incoherent : float
        Relative rms of what `before` leaves that neither inputs nor motion explain, the noise at least; 0 where that is not known.
    refitted : float
        Relative error of the refitted model; not a number where nothing was compared with it.
    bare : float
        Relative error of the amended model without any finding: what its own refit does alone.
    parts : tuple of Part
        What every finding does there.
    """

    name: str
    role: str
    nominal: float
    before: float
    after: float
    noise: float
    channels: dict[str, tuple[float, float, float, float]]
    incoherent: float = 0.0
    calibrated: float = float("nan")
    bare: float = float("nan")
    parts: tuple[Part, ...] = ()

    @property
    def is_spoilt(self) -> bool:
        """Whether the refitted model is further off than the model as given, which then stands in its place."""
        return self.calibrated > self.nominal

    @property
    def stands(self) -> str:
        """Which model that is: ``"nominal"`` or ``"calibrated"``."""
        return "nominal" if self.is_spoilt else "calibrated"

    @property
    def start(self) -> float:
        """What the model leaves without the findings, as given, refitted, or refitted together with them: a gap that a refit closes
        is none that a finding closes."""
        return float(np.fmin(self.before, self.bare))

    @property
    def is_idle(self) -> bool:
        """Whether no finding does anything in a recording kept aside, which then can verify none."""
        return self.role == "holdout" and bool(self.parts) and all(part.is_idle for part in self.parts)

    @property
    def gap_closed(self) -> float | None:
        """(before - after)/(before - noise); None where before is within the noise, or where no finding does anything."""
        return None if self.is_idle else gap_closed(self.before, self.after, self.noise)


def gap_closed(before: float, after: float, noise: float) -> float | None:
    """Return the share of the distance to the noise that was closed; None where there is none."""
    if not np.isfinite(before):
        return 1.0 if np.isfinite(after) else 0.0
    if before <= 1.1 * noise:
        return None
    return float((before - after) / (before - noise)) if np.isfinite(after) else -np.inf


def part_of(name: str, left: float, moved: Array, noise: Array, samples: int) -> Part:
    """Return what a finding does, from what its removal changes.

    What it does is told from nothing by noise alone: where a model leaves more than noise, it still does something.

    Parameters
    ----------
    left : float
        Relative error of the amended model without it.
    moved, noise : (n_channels,) array
        By how much the two models are apart, and the noise, relative to the channels' rms; infinite where one of them cannot follow.
    samples : int
        Of a channel.
    """
    return Part(name=name, left=left, told=float(0.5 * samples * np.sum((moved / np.maximum(noise, 1e-300)) ** 2)))


def verifying(checked: Sequence[D]) -> list[D]:
    """Return the sets of data that can verify a finding; all of them where none can."""
    return [c for c in checked if not c.is_idle] or list(checked)


def whole_gap(checked: Sequence[Distance]) -> float | None:
    """Return the share of the gap that is closed on all data that can verify a finding; None where none can, or nothing is to be closed."""
    chosen = [c for c in checked if not c.is_idle]
    return gap_closed(*(total(chosen, key) for key in ("before", "after", "noise"))) if chosen else None


def total(checked: Sequence[Distance], which: str) -> float:
    """Return the root mean square over recordings of one of their errors."""
    values = np.array([getattr(c, which) for c in checked])
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
