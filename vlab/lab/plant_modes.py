"""Plant modes at its sensors, compared with a modal test.

A recording of a simulation holds the poles of the integrated plant. The one-step map z of the integrator gives
s = log(z) / dt. Relative to the continuous plant, a semi-implicit Euler step raises a frequency by (omega dt)^2 / 24.
Damping by the past velocity raises a frequency by zeta omega dt / 2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial
from typing import Any

import mujoco
import numpy as np
from scipy import linalg

from vlab.errors import BadRecording
from vlab.fe.second_order import SecondOrderModel
from vlab.modal.mac import match_modes
from vlab.plants.base import Plant
from vlab.plants.linear import LinearPlant
from vlab.plants.linearise import linearise
from vlab.signals import Array, ComplexArray, ModalModel

HZ_ERROR, ZETA_ERROR, LEAST_MAC = 1e-3, 0.05, 0.98
"""HZ_ERROR [1]: largest relative error of a frequency.
ZETA_ERROR [1]: largest relative error of a damping ratio.
LEAST_MAC [1]: smallest MAC of the shapes."""
UNSEEN = 1e-3
"""UNSEEN [1]: largest sensor motion, relative to the most visible mode, below which a mode is unobservable."""
POSITION_STEP = 1e-6
"""POSITION_STEP [m or rad]: step of the central difference of a displacement sensor; rounding is 1e-10 of the shape."""


def plant_modes(plant: Plant, outputs: Sequence[str], *, low_hz: float, high_hz: float) -> ModalModel:
    """Return the damped modes of the integrated plant in a band.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.
    outputs : sequence of str
        Channel names of sensors; velocities and displacements both give displacement shapes.
    low_hz, high_hz : float
        Band [Hz].

    Returns
    -------
    ModalModel
        Complex shapes; unobservable modes are left out.
    """
    linear = plant.linearise()
    n = linear.n
    s, vectors = _poles(plant, linear)
    hz = np.abs(s) / (2 * np.pi)
    keep = np.flatnonzero((s.imag > 0) & (hz >= low_hz) & (hz <= high_hz))
    keep = keep[np.argsort(hz[keep])]
    if keep.size == 0:
        raise BadRecording(f"the plant has no mode from {low_hz:g} to {high_hz:g} Hz; widen --band")
    raw = vectors[:n, keep]
    raw = raw / np.sqrt(np.einsum("ij,ik,kj->j", raw.conj(), linear.M, raw).real)  # unit modal mass
    shapes = _seen(plant, outputs, raw)
    size = np.abs(shapes).max(axis=0)
    seen = size > UNSEEN * size.max()
    at = keep[seen]
    return ModalModel(freq=hz[at], zeta=-s[at].real / np.abs(s[at]), shapes=shapes[:, seen], coordinates=tuple(outputs))


def _poles(plant: Plant, linear: SecondOrderModel) -> tuple[ComplexArray, ComplexArray]:
    """Return poles [rad/s] and eigenvectors of the integrated plant."""
    n, h = linear.n, plant.timestep
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(linear.M, np.hstack([linear.K, linear.C]))]])
    s, vectors = linalg.eig(A)
    if isinstance(plant, LinearPlant):  # its steps are exact
        return s, vectors
    if int(plant.model.opt.integrator) == int(mujoco.mjtIntegrator.mjINT_RK4):
        z = sum((h * s) ** k / factorial(k) for k in range(5))
        return np.log(z) / h, vectors
    applied = linear.C - linearise(plant.model).C  # forces of the past velocity; MuJoCo's own dampers are implicit
    rate = np.linalg.solve(linear.M + h * (linear.C - applied), np.hstack([-h * linear.K, linear.M - h * applied]))
    step = np.vstack([np.hstack([np.eye(n), np.zeros((n, n))]) + h * rate, rate])
    z, vectors = linalg.eig(step)
    with np.errstate(divide="ignore"):  # a state that is lost in one step has no motion
        return np.log(z.astype(complex)) / h, vectors


def _seen(plant: Plant, outputs: Sequence[str], modes: ComplexArray) -> ComplexArray:
    """Return mode shapes at sensors, (n_outputs, n_modes)."""
    rows = [plant.sensor_index(name) for name in outputs]
    is_rate = np.array([plant.sensors[i].kind == "velocity" for i in rows])

    def read(motion: Array) -> Array:
        data = plant.new_data()
        data.qvel[:] = motion
        mujoco.mj_forward(plant.model, data)
        speeds = plant.read(data)[rows]
        sides = []
        for sign in (1.0, -1.0):
            data = plant.new_data()
            mujoco.mj_integratePos(plant.model, data.qpos, motion, sign * POSITION_STEP)
            mujoco.mj_forward(plant.model, data)
            sides.append(plant.read(data)[rows])
        return np.where(is_rate, speeds, (sides[0] - sides[1]) / (2 * POSITION_STEP))

    return np.stack([read(mode.real) + 1j * read(mode.imag) for mode in modes.T], axis=1)


@dataclass(frozen=True, kw_only=True)
class FoundMode:
    """A plant mode with its estimate from a modal test.

    The estimate is NaN for a missed mode.
    """

    hz: float
    zeta: float
    found_hz: float
    found_zeta: float
    mac: float

    @property
    def hz_error(self) -> float:
        """Relative error of the frequency."""
        return self.found_hz / self.hz - 1

    @property
    def zeta_error(self) -> float:
        """Relative error of the damping ratio."""
        return self.found_zeta / self.zeta - 1

    @property
    def ok(self) -> bool:
        """Whether all errors are within their limits.

        The limits are `HZ_ERROR`, `ZETA_ERROR` and `LEAST_MAC`.
        """
        near = abs(self.hz_error) <= HZ_ERROR and abs(self.zeta_error) <= ZETA_ERROR
        return bool(near and self.mac >= LEAST_MAC)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        found = {"found_hz": self.found_hz, "found_zeta": self.found_zeta, "mac": self.mac}
        errors = {"hz_error": self.hz_error, "zeta_error": self.zeta_error, "ok": self.ok}
        return {"hz": self.hz, "zeta": self.zeta} | found | errors


def compare_with_plant(true: ModalModel, found: ModalModel) -> list[FoundMode]:
    """Pair each plant mode with a test mode by MAC.

    Parameters
    ----------
    true : ModalModel
        Modes of the plant.
    found : ModalModel
        Modes of the test.

    Returns
    -------
    list of FoundMode
        One entry a plant mode.
    """
    pairing = match_modes(true, found)
    partner = {int(a): (int(b), float(m)) for a, b, m in zip(pairing.a, pairing.b, pairing.mac, strict=True)}
    rows = []
    for j in range(true.freq.size):
        b, alike = partner.get(j, (-1, np.nan))
        rows.append(
            FoundMode(
                hz=float(true.freq[j]),
                zeta=float(true.zeta[j]),
                found_hz=float(found.freq[b]) if b >= 0 else np.nan,
                found_zeta=float(found.zeta[b]) if b >= 0 else np.nan,
                mac=alike,
            )
        )
    return rows
