"""Linear plant: the modal plant in exact steps of its matrix exponential.

With the poles and complex modes of x' = A x + B w, x = [q', q], and a force w held over a step h,

    z+ = exp(s h) z + (exp(s h) - 1)/s W B w,    x = Re(V z).

A step has no error of integration, and its cost grows with the number of modes only. Designs and large numbers of draws use
the plant. Effects and nonlinear laws need one of the other plants.
"""

from dataclasses import dataclass, fields
from functools import cached_property

import mujoco
import numpy as np

from vlab.errors import BadStructure
from vlab.fe.model import FeModel
from vlab.plants.base import Plant
from vlab.plants.modal import build_modal
from vlab.signals import Array

LARGEST_ERROR = 1e-8
"""LARGEST_ERROR [1]: largest relative error of A from its poles and modes; above it two modes coincide."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExactMotion:
    """Steps of a linear plant in complex modes.

    Parameters
    ----------
    rotation : (m,) complex array
        exp(s h) of every pole with nonnegative imaginary part.
    drive : (m, n_actuators) complex array
        Change of z by a unit force in a step.
    readout : (n_sensordata, m) complex array
        ``sensordata`` of MuJoCo from z, real part. Positions are half a step ahead, as MuJoCo's.
    positions, velocities : (nv, m) complex array
        Configuration about equilibrium, half a step ahead, and velocity, from z; real part.
    inverse : (m, 2 nv) complex array
        z from [q', q] at the start of a step.
    """

    rotation: Array
    drive: Array
    readout: Array
    positions: Array
    velocities: Array
    inverse: Array

    def start(self, position: Array, velocity: Array) -> Array:
        """Return the modes of an initial state.

        Parameters
        ----------
        position, velocity : (nv,) array
            Configuration about equilibrium and velocity at the start.

        Returns
        -------
        (2 m,) array
            Real parts, then imaginary parts of z.
        """
        z = self.inverse @ np.concatenate([velocity, position])
        return np.concatenate([z.real, z.imag])


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearPlant(Plant):
    """A modal plant that experiments step exactly, see `vlab.lab.compiled_loop`.

    The MuJoCo model has the same modes. Views and diagnoses use the model.
    """

    @cached_property
    def motion(self) -> ExactMotion:
        """Steps in complex modes, with the plant's dissipation.

        Raises
        ------
        BadStructure
            Two modes coincide, so that A has too few eigenvectors.
        """
        linear, h = self.linearise(), self.timestep
        n, (position, velocity) = linear.n, self._responses()
        A, B, _, _ = linear.state_matrices(self.actuator_forces(), np.zeros((0, n)))
        poles, V = np.linalg.eig(A)
        W = np.linalg.inv(V)
        if np.abs((V * poles) @ W - A).max() > LARGEST_ERROR * np.abs(A).max():
            raise BadStructure("two modes of the linear plant coincide; use the plant 'modal'")
        kept = poles.imag >= 0
        poles, V, W = poles[kept], V[:, kept] * np.where(poles[kept].imag > 0, 2.0, 1.0), W[kept]
        ahead = V[n:] + h / 2 * V[:n]
        held = np.where(np.abs(poles) * h < 1e-12, h, np.expm1(poles * h) / np.where(poles == 0, 1.0, poles))
        return ExactMotion(
            rotation=np.exp(poles * h),
            drive=held[:, None] * (W @ B),
            readout=position @ ahead + velocity @ V[:n],
            positions=ahead,
            velocities=V[:n],
            inverse=W,
        )

    def _responses(self) -> tuple[Array, Array]:
        """Return ``sensordata`` per position and per velocity."""
        model, data = self.model, self.new_data()
        parts = []
        for values, rest in ((data.qpos, model.qpos0), (data.qvel, np.zeros(model.nv))):
            columns = []
            for j in range(model.nv):
                values[:] = rest
                values[j] += 1.0
                mujoco.mj_forward(model, data)
                columns.append(data.sensordata.copy())
            values[:] = rest
            parts.append(np.array(columns).T)
        return parts[0], parts[1]


def build_linear(fe: FeModel, *, timestep: float = 5e-4) -> LinearPlant:
    """Build the linear plant of an FE model.

    The plant has all modes that MuJoCo's own step can follow.

    Parameters
    ----------
    fe : FeModel
        FE model.
    timestep : float
        Integration step [s].

    Returns
    -------
    LinearPlant
        Plant at equilibrium.
    """
    modes = int(np.count_nonzero(fe.linear.eigen[0] * timestep < 2.0))
    built = build_modal(fe, modes=modes, timestep=timestep)
    values = {f.name: getattr(built, f.name) for f in fields(built)}
    return LinearPlant(**values | {"name": "linear"})
