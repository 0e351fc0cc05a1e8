"""Excitation signals as functions of time.

A signal is drawn once from its seed. The signal adds to an actuator's command behind the converter's filter, as in the
laboratory (Figure 21). One coil can therefore both control and excite. The text form is ``NAME`` or
``NAME:setting=value,...``. A slash separates several numbers of one setting: ``dwell:hz=3.31,forces=1/-0.4``.
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
    "InTurn",
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
        Amplitude in the actuator's unit: rms for multisines and noise (within a burst), peak for sines and blows,
        static force for a release.
    """

    @property
    def level(self) -> float:
        """Amplitude of the signal."""

    @property
    def period_s(self) -> float | None:
        """Period of a periodic signal [s], else None."""

    @property
    def facts(self) -> dict[str, Any]:
        """Signal description for the recording."""

    def sample(self, time: Array) -> Array:
        """Return the signal at times [s].

        The shape is (n_times,), or (n_times, n_actuators) for several actuators.
        """


def forces_at(excitation: Excitation, time: Array, actuators: int) -> Array:
    """Return the signal of each exciting actuator.

    Parameters
    ----------
    excitation : Excitation
        Signal.
    time : array
        Times [s].
    actuators : int
        Number of exciting actuators.

    Returns
    -------
    array
        Signal in the actuators' unit, (n_times, n_actuators).

    Raises
    ------
    BadExperiment
        The signal is for another number of actuators.
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
class InTurn:
    """One signal at several actuators, one after another.

    Parameters
    ----------
    signal : Excitation
        Signal of one actuator.
    actuators : int
        Number of actuators.
    turn_s : float
        Duration of each turn [s].
    """

    signal: Excitation
    actuators: int
    turn_s: float

    @property
    def level(self) -> float:
        """Amplitude of the signal."""
        return self.signal.level

    @property
    def period_s(self) -> float | None:
        """Period of the signal in a turn [s], or None."""
        return self.signal.period_s

    @property
    def facts(self) -> dict[str, Any]:
        """Signal description for the recording, with the duration of a turn."""
        return {**self.signal.facts, "turn_s": self.turn_s}

    def sample(self, time: Array) -> Array:
        """Return the signals.

        Parameters
        ----------
        time : array
            Times [s].

        Returns
        -------
        array
            Signals in the actuators' unit, (n_times, n_actuators).
        """
        t = np.asarray(time, dtype=float)
        turn = np.floor(t / self.turn_s + 1e-9).astype(int)
        out = np.zeros((t.size, self.actuators))
        for i in range(self.actuators):
            here = turn == i
            if here.any():
                out[here, i] = self.signal.sample(t[here] - i * self.turn_s)
        return out


@dataclass(frozen=True, kw_only=True)
class Hammer(Banded):
    """Half-sine pulses of varying size and interval [peak level].

    The band determines the width of a pulse.

    Parameters
    ----------
    interval_s : float
        Mean interval between blows [s].
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
        """None: blows do not repeat exactly."""

    @property
    def facts(self) -> dict[str, Any]:
        """Signal description for the recording."""
        return {"signal": "impact"}

    def sample(self, time: Array) -> Array:
        """Return the signal.

        Parameters
        ----------
        time : array
            Times [s].

        Returns
        -------
        array
            Signal in the actuator's unit, (n_times,).
        """
        t = np.asarray(time, dtype=float)
        rng = np.random.default_rng(self.seed)
        width = 1.5 / self.high_hz  # the spectrum of a half sine of width w has its first zero at 1.5/w
        out = np.zeros_like(t)
        blow = 0.2
        while blow < t.max(initial=0.0) + width:
            inside = (t >= blow) & (t < blow + width)
            out[inside] += self.level * rng.uniform(0.8, 1.2) * np.sin(np.pi * (t[inside] - blow) / width)
            blow += self.interval_s * rng.uniform(0.9, 1.1)
        return out


@dataclass(frozen=True, kw_only=True)
class Release:
    """Release from a static force at the actuator, without signal."""

    level: float = 1.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.level):
            raise BadExperiment(f"the static force {self.level} is not finite")

    @property
    def period_s(self) -> None:
        """None: a release happens once."""

    @property
    def facts(self) -> dict[str, Any]:
        """Signal description for the recording."""
        return {"signal": "release"}

    def sample(self, time: Array) -> Array:
        """Return zeros, because the force ends at the start."""
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
"""Excitations by name."""


def build_excitation(name: str, **settings: Any) -> Any:
    """Build an excitation from its text and further settings.

    The form is ``NAME`` or ``NAME:setting=value,...``. A setting of None is ignored. A seed is ignored by a signal
    without random draws.

    Parameters
    ----------
    name : str
        Text.

    Returns
    -------
    object
        Excitation.

    Raises
    ------
    UnknownName
        No such excitation.
    BadExperiment
        A setting is unknown, given twice, or out of range.
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
    """Return a written value as its setting's type."""
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
