"""Durations of an experiment from the slowest mode.

A mode of damping ratio zeta and angular frequency omega decays as exp(-t/tau), tau = 1/(zeta omega). A record must outlast
the transient of the slowest mode, and a period, block or interval must hold the decay of that mode.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from vlab.errors import BadRecording, BadStructure
from vlab.hardware import load_hardware
from vlab.lab.excitation import build_excitation
from vlab.lab.model_bench import BenchExcitation
from vlab.lab.plant_modes import UNSEEN, plant_modes
from vlab.lab.run_folder import RunSettings
from vlab.physics.attach import attach
from vlab.physics.spec import parse_effect
from vlab.plants import build_plant
from vlab.plants.base import Plant
from vlab.signals import Array, ModalModel
from vlab.structure import load_structure

SETTLED = 0.02
"""SETTLED [1]: share of the transient that is left when averaging begins. 0.02 biases a damping ratio by 5 % at most on the
beam (multisine, 4 periods). Raising the value shortens a record."""
DECAYED = 0.05
"""DECAYED [1]: share of a free decay that is left at the end of its block, as under the window of a hammer test."""
PERIODS = 4
"""PERIODS [1]: number of periods, blocks or blows. The modal test averages the second half of the periods; the estimate of
coherence needs four blocks."""
LINES = 20
"""LINES [1]: fewest lines of a periodic signal in the band of a user's model. Fewer lines make a signal that repeats itself
within its period."""
LOW_HZ, HIGH_HZ = 0.5, 60.0
"""LOW_HZ, HIGH_HZ [Hz]: band in which the slowest mode of a release is looked for, as the band of other excitations."""
BANDWIDTHS = 1.5
"""BANDWIDTHS [1]: half-power bandwidths to each side of a mode within which a stepped sine has fine steps."""
SHARE = 0.05
"""SHARE [1]: largest travel at a coil relative to the linear range of a velocity sensor. At 0.05 the release of the beam
biases damping ratios by less than 0.1 %. Raising the value excites the nonlinear stretch of cables."""
CREST = 3.0
"""CREST [1]: peak of a random signal in standard deviations."""
SEEN = 0.25
"""SEEN [1]: smallest participation of a mode at some exciting coil, relative to the coil at which it is largest. Raising the
value excites more coils, which takes longer."""
FREE = 1e-9
"""FREE [1]: largest eigenvalue of a free motion relative to the largest."""


@dataclass(frozen=True, kw_only=True)
class Suited:
    """Settings that follow from the plant.

    Parameters
    ----------
    settings : RunSettings
        Complete settings.
    hz : float
        Frequency of the slowest mode [Hz]; NaN if nothing follows from the plant.
    tau_s : float
        Time constant of that mode [s]; NaN if nothing follows from the plant.
    """

    settings: RunSettings
    hz: float = float("nan")
    tau_s: float = float("nan")

    @property
    def in_turn(self) -> bool:
        """Whether coils of a structure act one after another."""
        return "," in self.settings.at and not self.settings.is_own_model

    @property
    def words(self) -> str:
        """Reason of the duration; empty if nothing follows from the plant."""
        if not np.isfinite(self.tau_s):
            return ""
        turns = f"; in turn at {self.settings.at}, for modes with a node at one coil" if self.in_turn else ""
        return (
            f"{self.settings.seconds:g} s follow from the slowest mode of the plant: {self.hz:.4g} Hz, time constant "
            f"{self.tau_s:.3g} s{turns} (--seconds sets another duration)"
        )


def suited(settings: RunSettings) -> Suited:
    """Return settings with duration and period that suit the plant.

    A law in the loop and a dwell keep the default duration. Where the exciter of a structure is at a node of some mode,
    several coils act in turn. A stepped sine without stated steps gets fine steps about every mode.

    Parameters
    ----------
    settings : RunSettings
        Settings whose duration is the default. A stated period, block or interval stays.

    Returns
    -------
    Suited
        Settings with the reason.
    """
    name, _, written = settings.excite.partition(":")
    if settings.law or name not in RULES:
        return Suited(settings=settings)
    plant, low, high = _bench(settings, name)
    outputs = [tap.name for tap in plant.sensors]
    try:
        modes = plant_modes(plant, outputs, low_hz=low, high_hz=high)
    except (BadRecording, BadStructure):  # no mode in the band, or no linearisation
        return Suited(settings=settings)
    tau = 1 / (2 * np.pi * modes.freq * modes.zeta)
    slowest = int(np.argmax(tau))
    stated = {key.strip() for key, _, _ in (part.partition("=") for part in written.split(","))} - {""}
    if not settings.is_own_model and not settings.at and name != "release":
        settings = replace(settings, at=_coils(plant, load_structure(settings.structure).exciter, low, high))
    if settings.is_own_model and not 0 < tau.min() <= tau.max() < settings.seconds:
        return Suited(settings=settings)  # unstable, or without damping
    if name == "stepped-sine" and not {key for key in stated if key.startswith(("zoom", "steps"))}:
        settings = _zoomed(settings, modes, low, high)
    found = RULES[name](settings, float(tau[slowest]), stated)
    if settings.is_own_model:  # the levels follow from the model, see `vlab.lab.model_bench`
        least = float(np.ceil(LINES / (high - low)))
        if found.period_s is not None and settings.period_s is None and found.period_s < least:
            found = replace(found, period_s=least, seconds=PERIODS * least)
        return Suited(settings=found, hz=float(modes.freq[slowest]), tau_s=float(tau[slowest]))
    if settings.level is None and "level" not in stated and name in TRAVELS:
        hardware = load_hardware(settings.hardware or None, settings.hardware_values)
        travel = max(TRAVELS[name](_receptance(plant, at), found) for at in _places(settings))
        found = replace(found, level=float(f"{SHARE * hardware.velocity_sensor.linear_range / travel:.2g}"))
    found = replace(found, seconds=found.seconds * len(_places(settings)))
    return Suited(settings=found, hz=float(modes.freq[slowest]), tau_s=float(tau[slowest]))


def _bench(settings: RunSettings, name: str) -> tuple[Plant, float, float]:
    """Return the plant of a run and the excited band [Hz]."""
    if settings.is_own_model:
        prepared = settings.prepare()
        signal = prepared.experiment.excitation
        excitation: Any = signal.parts[0] if isinstance(signal, BenchExcitation) else signal
        plant = prepared.plant
    else:
        band = {"low_hz": settings.low_hz, "high_hz": settings.high_hz}
        excitation = build_excitation(settings.excite, **({} if name == "release" else band))
        plant = build_plant(load_structure(settings.structure), settings.plant, settings.variant)
        code = settings.named_code
        plant = attach(plant, [parse_effect(text, code=code) for text in settings.effect])
    return plant, getattr(excitation, "low_hz", LOW_HZ), getattr(excitation, "high_hz", HIGH_HZ)


def _periodic(settings: RunSettings, tau: float, stated: set[str]) -> RunSettings:
    """Return four periods, the first two of which outlast the transient."""
    settle = tau * np.log(1 / SETTLED)
    period = settings.period_s
    if period is None and "period_s" in stated:
        period = float(build_excitation(settings.excite).period_s)
    if period is None:
        period = float(np.ceil(2 * settle / PERIODS))
        return replace(settings, period_s=period, seconds=PERIODS * period)
    return replace(settings, seconds=max(PERIODS, 2 * int(np.ceil(settle / period))) * period)


def _blocks(settings: RunSettings, tau: float, stated: set[str]) -> RunSettings:
    """Return four blocks of bursts with decay."""
    excitation: Any = build_excitation(settings.excite)
    block = float(np.ceil(tau * np.log(1 / DECAYED) / (1 - min(excitation.share, 0.9))))
    if "block_s" in stated:
        return replace(settings, seconds=PERIODS * excitation.block_s)
    return replace(settings, excite=_with(settings.excite, block_s=block), seconds=PERIODS * block)


def _blows(settings: RunSettings, tau: float, stated: set[str]) -> RunSettings:
    """Return four blows, after each of which the response decays."""
    if "interval_s" in stated:
        excitation: Any = build_excitation(settings.excite)
        return replace(settings, seconds=PERIODS * excitation.interval_s)
    interval = float(np.ceil(tau * np.log(1 / DECAYED)))
    return replace(settings, excite=_with(settings.excite, interval_s=interval), seconds=PERIODS * interval)


def _release(settings: RunSettings, tau: float, stated: set[str]) -> RunSettings:
    """Return one decay."""
    return replace(settings, seconds=float(np.ceil(tau * np.log(1 / DECAYED))))


def _steps(settings: RunSettings, tau: float, stated: set[str]) -> RunSettings:
    """Return the whole sweep of a stepped sine."""
    excitation: Any = build_excitation(settings.excite, low_hz=settings.low_hz, high_hz=settings.high_hz)
    return replace(settings, seconds=float(np.ceil(excitation.seconds)))


def _zoomed(settings: RunSettings, modes: ModalModel, low: float, high: float) -> RunSettings:
    """Return a stepped sine with fine steps about every mode.

    The steps are half the half-power bandwidth 2 zeta f apart and reach `BANDWIDTHS` of it to each side. After the half of
    a step that the analysis drops, `DECAYED` of the transient is left. As many steps lie evenly in the band: with few lines
    between the modes, higher model orders are not unique.
    """
    tau = 1 / (2 * np.pi * modes.freq * modes.zeta)
    width = np.minimum(2 * BANDWIDTHS * modes.zeta, 0.49)
    inside = (modes.freq > low) & (modes.freq < high)
    dwell = 2 * tau * np.log(1 / DECAYED)

    def joined(values: Array) -> str:
        return "/".join(f"{value:.6g}" for value in values[inside])

    per_mode = int(4 * BANDWIDTHS) + 1
    zoom = {
        "steps": str(per_mode * int(inside.sum())),
        "zoom_hz": joined(modes.freq),
        "zoom_widths": joined(width),
        "zoom_dwells_s": joined(dwell),
        "zoom_steps": str(per_mode),
    }
    joint = "," if ":" in settings.excite else ":"
    excite = settings.excite + joint + ",".join(f"{key}={value}" for key, value in zoom.items())
    return replace(settings, excite=excite)


@dataclass(frozen=True, kw_only=True)
class _Receptance:
    """Modes of a plant between the exciting coil and all coils.

    Parameters
    ----------
    omega, zeta : (n,) array
        Angular frequencies [rad/s] and damping ratios.
    gain : (n_coils, n) array
        Product of the mass-normalised shapes at a coil and at the exciter [1/kg].
    """

    omega: Array
    zeta: Array
    gain: Array


def _places(settings: RunSettings) -> list[str]:
    return (settings.at or load_structure(settings.structure).exciter).split(",")


def _coils(plant: Plant, exciter: str, low: float, high: float) -> str:
    """Return coils that together excite all modes, with commas between.

    A mode with a node at one coil needs another. The exciter of the structure comes first. Each further coil is the one
    with the most modes that none before excites. A coil excites a mode with `SEEN` of the participation of the best coil.
    """
    linear = plant.linearise()
    square, shapes = linalg.eigh(linear.K, linear.M)
    hz = np.sqrt(np.maximum(square, 0.0)) / (2 * np.pi)
    rows = np.abs(plant.actuator_forces().T @ shapes[:, (hz >= low) & (hz <= high)])
    largest = rows.max(axis=0)
    is_seen = (rows >= SEEN * largest)[:, largest > UNSEEN * largest.max(initial=0.0)]
    chosen = [plant.actuator_index(exciter)]
    left = ~is_seen[chosen[0]]
    while left.any():
        chosen.append(int(np.argmax(is_seen[:, left].sum(axis=1))))
        left &= ~is_seen[chosen[-1]]
    return ",".join(plant.actuators[i].at for i in chosen) if len(chosen) > 1 else ""


def _receptance(plant: Plant, place: str) -> _Receptance:
    at = plant.actuator_index(place)
    linear = plant.linearise()
    square, shapes = linalg.eigh(linear.K, linear.M)
    held = square > FREE * square.max()
    shapes, omega = shapes[:, held], np.sqrt(square[held])
    rows = plant.port_rows([tap.at for tap in plant.actuators]) @ shapes
    zeta = np.einsum("ij,ik,kj->j", shapes, linear.C, shapes) / (2 * omega)
    return _Receptance(omega=omega, zeta=zeta, gain=rows * (shapes.T @ plant.actuator_forces()[:, at]))


def _static_travel(modes: _Receptance, settings: RunSettings) -> float:
    """Return the largest travel under a static unit force [m/N]."""
    return float(np.abs((modes.gain / modes.omega**2).sum(axis=1)).max())


def _random_travel(modes: _Receptance, settings: RunSettings) -> float:
    """Return the largest travel under unit rms force [m/N].

    A mode of unit mass under an even one-sided density G [N^2/Hz] has the variance G/(8 zeta omega^3).
    """
    excitation: Any = build_excitation(settings.excite, low_hz=settings.low_hz, high_hz=settings.high_hz)
    density = 1 / (excitation.high_hz - excitation.low_hz)
    inside = (modes.omega >= 2 * np.pi * excitation.low_hz) & (modes.omega <= 2 * np.pi * excitation.high_hz)
    variance = modes.gain**2 * (inside * density / (8 * modes.zeta * modes.omega**3))
    return float(CREST * np.sqrt(variance.sum(axis=1).max()))


def _sine_travel(modes: _Receptance, settings: RunSettings) -> float:
    """Return the largest travel under a unit resonant sine [m/N]."""
    return float(np.abs(modes.gain / (2 * modes.zeta * modes.omega**2)).max())


def _blow_travel(modes: _Receptance, settings: RunSettings) -> float:
    """Return the largest travel after a half-sine blow of unit peak [m/N]."""
    excitation: Any = build_excitation(settings.excite, low_hz=settings.low_hz, high_hz=settings.high_hz)
    impulse = 2 / np.pi * 1.5 / excitation.high_hz
    inside = modes.omega <= 2 * np.pi * excitation.high_hz
    return float(np.abs(modes.gain * inside / modes.omega).sum(axis=1).max() * impulse)


TRAVELS: Mapping[str, Any] = {
    "multisine": _random_travel,
    "pseudo-random": _random_travel,
    "burst-random": _random_travel,
    "sweep": _sine_travel,
    "stepped-sine": _sine_travel,
    "hammer": _blow_travel,
    "release": _static_travel,
}
"""TRAVELS: largest travel at a coil per unit level [m/N], by excitation."""


RULES: Mapping[str, Any] = {
    "multisine": _periodic,
    "pseudo-random": _periodic,
    "sweep": _periodic,
    "burst-random": _blocks,
    "hammer": _blows,
    "release": _release,
    "stepped-sine": _steps,
}
"""RULES: function of settings, time constant [s] and stated settings, by excitation."""


def _with(excite: str, **settings: float) -> str:
    """Return the text of an excitation with further settings."""
    joint = "," if ":" in excite else ":"
    return excite + joint + ",".join(f"{key}={value!r}" for key, value in settings.items())
