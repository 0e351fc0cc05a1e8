"""Excitation signals. Each is a function of time alone, drawn once from its seed.

The signal is added to the command of an actuator behind the converter's filter, where the laboratory added it
(Figure 21), so one coil both controls and excites. Written out they read ``NAME`` or ``NAME:setting=value,...``; several
numbers of one setting are separated by a slash: ``dwell:hz=3.31,forces=1/-0.4``.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Protocol, get_type_hints

import numpy as np

from vlab.errors import BadExperiment, unknown_name
from vlab.lab.broadband import Banded, BurstRandom, Multisine, PseudoRandom, Sweep
from vlab.lab.dwell import Dwell, SteppedSine
from vlab.signals import Array

__all__ = [
    "EXCITATIONS",
    "BurstRandom",
    "Dwell",
    "Excitation",
    "Hammer",
    "Multisine",
    "PseudoRandom",
    "Release",
    "SteppedSine",
    "Sweep",
    "build_excitation",
    "forces_at",
]


class Excitation(Protocol):
    """A signal over time.

    Parameters
    ----------
    level : float
        Its size in the actuator's unit; rms for multisines and noise (of a burst while it is on), peak for sines and
        blows, the static force for a release.
    """

    @property
    def level(self) -> float:
        """Size of the signal."""

    @property
    def period_s(self) -> float | None:
        """Period of a periodic signal [s], else None."""

    @property
    def facts(self) -> dict[str, Any]:
        """What a recording notes of the signal, for those who read it."""

    def sample(self, time: Array) -> Array:
        """Return the signal at times [s], (n_times,), or (n_times, n_actuators) where it drives several."""


def forces_at(excitation: Excitation, time: Array, actuators: int) -> Array:
    """Return the signal of each of the actuators that excite, (n_times, n_actuators).

    Raises
    ------
    BadExperiment
        The signal is not made for so many actuators.
    """
    signal = excitation.sample(time)
    columns = signal[:, None] if signal.ndim == 1 else signal
    if columns.shape[1] != actuators:
        raise BadExperiment(
            f"an excitation of {columns.shape[1]} force{'s' * (columns.shape[1] > 1)} cannot drive {actuators} actuators; "
            "a dwell needs as many forces as places, anything else drives one place a run"
        )
    return columns


@dataclass(frozen=True, kw_only=True)
class Hammer(Banded):
    """Half-sine pulses of slightly varying size and interval [peak level]; the width follows from the band.

    Parameters
    ----------
    interval_s : float
        Mean time between blows.
    """

    interval_s: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.interval_s > 3 / self.high_hz:
            raise BadExperiment(
                f"an interval of {self.interval_s} s is too short for blows of {1.5 / self.high_hz:g} s"
            )

    @property
    def period_s(self) -> None:
        """Blows do not repeat exactly."""

    @property
    def facts(self) -> dict[str, Any]:
        """What a recording notes of the signal."""
        return {"signal": "impact"}

    def sample(self, time: Array) -> Array:
        """Return the signal at times [s]."""
        t = np.asarray(time, dtype=float)
        rng = np.random.default_rng(self.seed)
        width = 1.5 / self.high_hz  # a half sine of width w has its first spectral zero at 1.5/w
        out = np.zeros_like(t)
        blow = 0.2
        while blow < t.max(initial=0.0) + width:
            inside = (t >= blow) & (t < blow + width)
            out[inside] += self.level * rng.uniform(0.8, 1.2) * np.sin(np.pi * (t[inside] - blow) / width)
            blow += self.interval_s * rng.uniform(0.9, 1.1)
        return out


@dataclass(frozen=True, kw_only=True)
class Release:
    """No signal: the structure is pulled by a static force at the actuator and let go at the start."""

    level: float = 1.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.level):
            raise BadExperiment(f"the static force {self.level} is not finite")

    @property
    def period_s(self) -> None:
        """A release happens once."""

    @property
    def facts(self) -> dict[str, Any]:
        """What a recording notes of the signal."""
        return {"signal": "release"}

    def sample(self, time: Array) -> Array:
        """Return zeros: the force is gone from the start."""
        return np.zeros_like(np.asarray(time, dtype=float))


EXCITATIONS: Mapping[str, Callable[..., Any]] = {
    "multisine": Multisine,
    "pseudo-random": PseudoRandom,
    "burst-random": BurstRandom,
    "sweep": Sweep,
    "stepped-sine": SteppedSine,
    "dwell": Dwell,
    "hammer": Hammer,
    "release": Release,
}
"""The excitations by name."""


def build_excitation(name: str, **settings: Any) -> Any:
    """Build an excitation from ``NAME`` or ``NAME:setting=value,...``, and further settings.

    Settings that are None do not count. A seed is left aside where nothing is drawn at random.

    Raises
    ------
    UnknownName
        No excitation of that name.
    BadExperiment
        A setting that this excitation does not have or that is given twice, or a value it refuses.
    """
    kind_name, colon, written = name.partition(":")
    if kind_name not in EXCITATIONS:
        raise unknown_name("excitation", kind_name, EXCITATIONS)
    kind: Any = EXCITATIONS[kind_name]
    accepted = [f.name for f in fields(kind) if f.init]
    given = {key: value for key, value in settings.items() if value is not None}
    if "seed" not in accepted:
        given.pop("seed", None)
    for key, text in _settings(name, written) if colon else ():
        if key in given and key != "seed":
            raise BadExperiment(f"the excitation {name!r}: {key} is given twice, here and as an option of its own")
        given[key] = _value(name, key, text, get_type_hints(kind).get(key)) if key in accepted else text
    for key in given:
        if key not in accepted:
            raise BadExperiment(
                f"the excitation {kind_name!r} has no setting {key!r} (accepted: {', '.join(accepted)})"
            )
    return kind(**given)


def _settings(name: str, written: str) -> list[tuple[str, str]]:
    parts = [part.partition("=") for part in written.split(",")]
    pairs = [(key.strip(), value.strip()) for key, _, value in parts]
    if not all(key and value for key, value in pairs) or len(dict(pairs)) < len(pairs):
        raise BadExperiment(
            f"the excitation {name!r} has not the form NAME:setting=value,setting=value, each setting once"
        )
    return pairs


def _value(name: str, key: str, text: str, kind: Any) -> Any:
    """Return a written value as its setting wants it."""
    try:
        if kind is bool:
            return {"yes": True, "true": True, "no": False, "false": False}[text.lower()]
        if kind in (int, float):
            return kind(text)
        return tuple(float(part) for part in text.split("/"))
    except (ValueError, KeyError):
        form = {bool: "yes or no", int: "a whole number", float: "a number"}.get(
            kind, "numbers with slashes between them"
        )
        raise BadExperiment(f"the excitation {name!r}: {key}={text} is not {form}") from None
