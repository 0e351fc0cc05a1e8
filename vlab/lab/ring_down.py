"""Damping of a free vibration after release, compared with the loop's poles."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from vlab.controllers.linear import LinearController
from vlab.fe.model import FeModel
from vlab.hardware.back_emf import brake_model
from vlab.hardware.laboratory import Hardware
from vlab.lab.excitation import Release
from vlab.lab.free_decay import SETTLING, envelope_decay, fit_poles, sensor_channels
from vlab.lab.prediction import loop_on
from vlab.lab.run_folder import PreparedRun
from vlab.signals import Array, ComplexArray, Recording

TOLD = 0.05
"""TOLD [1]: largest relative standard deviation of a damping ratio that counts as identified."""
NEAR = 0.3
"""NEAR [1]: largest relative distance of a fitted pole from its prediction; a farther pole is another mode."""
REACH = 0.5
"""REACH [1]: corner of an envelope's low-pass relative to the distance to the nearest mode, where the gain is 1/256."""
WIDEST = 0.5
"""WIDEST [1]: largest corner relative to the mode's frequency. At twice that frequency, the mirror image, the gain is
4^-8."""
GONE = 1.2
"""GONE [powers of e]: largest decay of a mode before its envelope is used."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopPoles:
    """Predicted poles of a loop.

    Parameters
    ----------
    s : (n,) complex array
        Poles of the coil-driven modes with measured damping ratios, in order of their open-loop frequency [rad/s].
    others : (m,) complex array
        All further oscillatory poles, and carriers picked up by unshielded leads [rad/s].
    """

    s: ComplexArray
    others: ComplexArray

    @property
    def hz(self) -> Array:
        """Frequencies |s|/(2 pi) [Hz]."""
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
        Number of the mode, from 1, among coil-driven modes.
    predicted_hz, predicted_zeta : float
        Frequency [Hz] and damping ratio of the loop's pole.
    hz, zeta, zeta_sd : float or None
        Fit of a common decaying exponential to all sensors; None if unidentified.
    zeta_envelope : float or None
        Damping ratio from the envelope of the sensor with the largest share; None if unidentified or not isolated.
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
    """Return the predicted poles of a loop.

    Parameters
    ----------
    fe : FeModel
        FE model.
    law : object
        Law, or None for the structure alone.
    hardware : Hardware
        Hardware between law and structure.

    Returns
    -------
    LoopPoles or None
        None for a nonlinear law.
    """
    fe = brake_model(fe, hardware)
    modes = np.asarray(fe.measured[: len(fe.structure.damping.ratios)])
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
    """Return carriers of unshielded leads as undamped poles.

    Frequencies are aliased to below half the sample rate [rad/s].
    """
    rate = hardware.converter.rate
    hz = np.array([hz for _, hz in hardware.leads.carriers]) if hardware.leads is not None else np.zeros(0)
    return np.asarray(2j * np.pi * np.abs(hz - rate * np.round(hz / rate)))


def _pole(hz: Sequence[float] | Array, zeta: Sequence[float] | Array) -> ComplexArray:
    ratio = np.clip(np.asarray(zeta, dtype=float), -1.0, 1.0)
    return np.asarray(2 * np.pi * np.asarray(hz) * (-ratio + 1j * np.sqrt(1 - ratio**2)))


def ring_down(prepared: PreparedRun, recording: Recording) -> tuple[Decay, ...]:
    """Return every mode's decay after a release.

    Any other excitation and a user's model give an empty result.
    """
    if not isinstance(prepared.experiment.excitation, Release) or prepared.structure is None:
        return ()
    poles = loop_poles(prepared.fe_model(), prepared.law, prepared.hardware)
    return () if poles is None else decays(recording, poles)


def decays(recording: Recording, poles: LoopPoles) -> tuple[Decay, ...]:
    """Return every mode's decay in a free vibration.

    `fit_poles` states the errors.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    poles : LoopPoles
        Predicted poles.

    Returns
    -------
    tuple of Decay
        One entry a mode.
    """
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
    """Return the damping ratio from an envelope.

    The sensor with the largest share of the mode's band is used.
    """
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
