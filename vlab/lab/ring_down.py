"""Release and decay: the damping that a free vibration shows, beside the poles that theory predicts of the loop."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from vlab.controllers.linear import LinearController
from vlab.fe.damping import driven_modes
from vlab.fe.model import FeModel
from vlab.hardware.back_emf import brake_model
from vlab.hardware.laboratory import Hardware
from vlab.lab.excitation import Release
from vlab.lab.free_decay import SETTLING, envelope_decay, fit_poles, sensor_channels
from vlab.lab.prediction import loop_on
from vlab.lab.run_folder import PreparedRun
from vlab.signals import Array, ComplexArray, Recording

TOLD = 0.05
"""A mode is told where the standard deviation of its damping ratio is below this share of it."""
NEAR = 0.3
"""A fitted pole farther than this from the predicted one, relative to its size, is another one."""
REACH = 0.5
"""Corner of an envelope's low-pass relative to the distance to the nearest mode, at which it leaves 1/256."""
WIDEST = 0.5
"""The same relative to the mode's own frequency: of the mirror image at twice that it leaves 4^-8."""
GONE = 1.2
"""Decay, in powers of e, by which a mode may have fallen before its envelope is used."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopPoles:
    """The poles of a loop as theory has them.

    Parameters
    ----------
    s : (n,) complex array
        Of the modes that have measured ratios and that the coils can drive, in order of their frequency without control
        [rad/s].
    others : (m,) complex array
        All other oscillatory poles, and what unshielded leads pick up.
    """

    s: ComplexArray
    others: ComplexArray

    @property
    def hz(self) -> Array:
        """Frequencies |s|/2 pi [Hz]."""
        return np.asarray(np.abs(self.s) / (2 * np.pi))

    @property
    def zeta(self) -> Array:
        """Damping ratios."""
        return np.asarray(-self.s.real / np.abs(self.s))


@dataclass(frozen=True, kw_only=True)
class Decay:
    """One mode of a free vibration.

    Parameters
    ----------
    mode : int
        From 1, of those that the coils can drive.
    predicted_hz, predicted_zeta : float
        Of the loop's pole.
    hz, zeta, zeta_sd : float or None
        Of the decaying exponential that all sensors show together; None where they do not tell.
    zeta_envelope : float or None
        From the envelope of the sensor that shows the mode best; None where the mode is not told or does not stand alone.
    """

    mode: int
    predicted_hz: float
    predicted_zeta: float
    hz: float | None
    zeta: float | None
    zeta_sd: float | None
    zeta_envelope: float | None

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return asdict(self)


def loop_poles(fe: FeModel, law: object, hardware: Hardware) -> LoopPoles | None:
    """Return the poles of a loop, or of the structure alone without a law; None for a law that is not linear."""
    fe = brake_model(fe, hardware)
    modes = np.asarray(driven_modes(fe.coils.T @ fe.linear.eigen[1])[: len(fe.structure.damping.ratios)])
    hum = _picked_up(hardware)
    if law is None:
        every = _pole(fe.linear.freq, fe.linear.zeta)
        return LoopPoles(s=every[modes], others=np.concatenate([np.delete(every, modes), hum]))
    if not isinstance(law, LinearController):
        return None
    loop = loop_on(fe, law, hardware.converter)
    own, all_poles = loop.mode_poles(modes.tolist()), loop.poles()
    s, every = (_pole([p.hz for p in poles], [p.zeta for p in poles]) for poles in (own, all_poles))
    others = every[(every.imag > 0) & (np.abs(every[:, None] - s).min(axis=1) > 1e-9 * np.abs(every))]
    return LoopPoles(s=s, others=np.concatenate([others, hum]))


def _picked_up(hardware: Hardware) -> ComplexArray:
    """Return what unshielded leads pick up as poles without damping, folded to below half the sample rate [rad/s]."""
    rate = hardware.converter.rate
    hz = np.array([hz for _, hz in hardware.leads.carriers]) if hardware.leads is not None else np.zeros(0)
    return np.asarray(2j * np.pi * np.abs(hz - rate * np.round(hz / rate)))


def _pole(hz: Sequence[float] | Array, zeta: Sequence[float] | Array) -> ComplexArray:
    ratio = np.clip(np.asarray(zeta, dtype=float), -1.0, 1.0)
    return np.asarray(2 * np.pi * np.asarray(hz) * (-ratio + 1j * np.sqrt(1 - ratio**2)))


def ring_down(prepared: PreparedRun, recording: Recording) -> tuple[Decay, ...]:
    """Return the decay of every mode after a release, open or closed loop; nothing after any other excitation."""
    if not isinstance(prepared.experiment.excitation, Release):
        return ()
    poles = loop_poles(prepared.fe_model(), prepared.law, prepared.hardware)
    return () if poles is None else decays(recording, poles)


def decays(recording: Recording, poles: LoopPoles) -> tuple[Decay, ...]:
    """Return what a free vibration says of every mode; raises as `fit_poles` does."""
    fitted = fit_poles(recording, poles.s, poles.others)
    out = []
    for k in range(len(poles.s)):
        s, size = fitted.s[k], abs(poles.s[k])
        zeta, sd = float(-s.real / abs(s)), float(fitted.sd[k] / abs(s))
        is_told = abs(s - poles.s[k]) < NEAR * size and sd < TOLD * abs(zeta)
        out.append(
            Decay(
                mode=k + 1,
                predicted_hz=float(poles.hz[k]),
                predicted_zeta=float(poles.zeta[k]),
                hz=float(abs(s) / (2 * np.pi)) if is_told else None,
                zeta=zeta if is_told else None,
                zeta_sd=sd if is_told else None,
                zeta_envelope=_from_envelope(recording, poles, k) if is_told else None,
            )
        )
    return tuple(out)


def _from_envelope(recording: Recording, poles: LoopPoles, k: int) -> float | None:
    """Return the damping ratio from the envelope at the sensor that has the largest share of the mode's band."""
    hz = float(poles.hz[k])
    near = np.abs(np.delete(np.concatenate([poles.hz, np.abs(poles.others) / (2 * np.pi)]), k) - hz)
    corner = float(min(WIDEST * hz, REACH * near.min(initial=np.inf)))
    if corner <= 0 or -poles.s[k].real * SETTLING / corner > GONE:
        return None
    freq = np.fft.rfftfreq(len(recording), 1 / recording.rate)
    band = np.abs(freq - hz) < corner

    def share(name: str) -> float:
        power = np.abs(np.fft.rfft(recording[name])) ** 2
        return float(power[band].sum() / max(power.sum(), 1e-300))

    rate = envelope_decay(recording, max(sensor_channels(recording), key=share), hz, corner)
    return None if rate is None else float(rate / np.hypot(rate, poles.s[k].imag))
