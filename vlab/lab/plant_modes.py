"""A plant's own modes at its sensors, and how well a modal test found them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from scipy import linalg

from vlab.errors import BadRecording
from vlab.modal.mac import match_modes
from vlab.plants.base import Plant
from vlab.signals import Array, ComplexArray, ModalModel

HZ_ERROR, ZETA_ERROR, LEAST_MAC = 1e-3, 0.05, 0.98
"""How near a modal test must come: relative errors of frequency and damping ratio, and the MAC of the shapes."""
UNSEEN = 1e-3
"""A mode whose largest motion at the sensors is less than this part of that of the others shows in no test."""
POSITION_STEP = 1e-6
"""Step of the central difference with which a displacement sensor is read [m or rad]: rounding 1e-10 of the shape."""


def plant_modes(plant: Plant, outputs: Sequence[str], *, low_hz: float, high_hz: float) -> ModalModel:
    """Return the damped modes of the linearised plant in a band, as its sensors see them.

    Parameters
    ----------
    outputs : sequence of str
        Channel names of sensors; velocities and displacements alike show the displacement.

    Returns
    -------
    ModalModel
        Complex shapes; modes that none of the sensors sees are left out.
    """
    linear = plant.linearise()
    n = linear.n
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(linear.M, np.hstack([linear.K, linear.C]))]])
    s, vectors = linalg.eig(A)
    hz = np.abs(s) / (2 * np.pi)
    keep = np.flatnonzero((s.imag > 0) & (hz >= low_hz) & (hz <= high_hz))
    keep = keep[np.argsort(hz[keep])]
    if keep.size == 0:
        raise BadRecording(f"the plant has no mode from {low_hz:g} to {high_hz:g} Hz; widen --band")
    raw = vectors[:n, keep]
    raw = raw / np.sqrt(np.einsum("ij,ik,kj->j", raw.conj(), linear.M, raw).real)  # unit modal mass: sizes compare
    shapes = _seen(plant, outputs, raw)
    size = np.abs(shapes).max(axis=0)
    seen = size > UNSEEN * size.max()
    at = keep[seen]
    return ModalModel(freq=hz[at], zeta=-s[at].real / np.abs(s[at]), shapes=shapes[:, seen], coordinates=tuple(outputs))


def _seen(plant: Plant, outputs: Sequence[str], modes: ComplexArray) -> ComplexArray:
    """Return what sensors see of motions in generalised coordinates, (n_outputs, n_modes)."""
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
    """A mode of the plant beside what a modal test found of it; NaN where it found nothing."""

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
        """Whether it was found as near as `HZ_ERROR`, `ZETA_ERROR` and `LEAST_MAC` ask for."""
        near = abs(self.hz_error) <= HZ_ERROR and abs(self.zeta_error) <= ZETA_ERROR
        return bool(near and self.mac >= LEAST_MAC)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        found = {"found_hz": self.found_hz, "found_zeta": self.found_zeta, "mac": self.mac}
        errors = {"hz_error": self.hz_error, "zeta_error": self.zeta_error, "ok": self.ok}
        return {"hz": self.hz, "zeta": self.zeta} | found | errors


def compare_with_plant(true: ModalModel, found: ModalModel) -> list[FoundMode]:
    """Return each mode of the plant with its partner in a modal test, paired by MAC."""
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
