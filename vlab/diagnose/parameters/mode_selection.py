"""Which modes of a model the search follows, and what MuJoCo's step makes of them."""

import warnings
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.linalg import logm

from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.parameters.reduced_model import observable
from vlab.diagnose.settings import LOCATIONS, MODE_SELECTION
from vlab.fe.second_order import SecondOrderModel
from vlab.physics.running import STAGGERED
from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class KeptModes:
    """A model near rest, and the modes of it that the search follows.

    Parameters
    ----------
    linear : SecondOrderModel
    rows : ChannelRows
        What channels read of its coordinates.
    omega, shapes : (nv,), (nv, nv) array
        All its modes: frequencies [rad/s], mass-normalised shapes.
    kept : (nv,) array of bool
        Those that are followed.
    band : float
        Modes beyond it follow statically [rad/s].
    """

    linear: SecondOrderModel
    rows: ChannelRows
    omega: Array
    shapes: Array
    kept: Array
    band: float

    @property
    def basis(self) -> Array:
        """Shapes of the modes that are followed, (nv, m)."""
        return np.asarray(self.shapes[:, self.kept])

    def compliance(self, pushes: Array) -> tuple[Array, Array]:
        """Return what channels read of the modes beyond the band, which follow forces (nv, n) statically: per force, and per its rate."""
        stiff = ~self.kept & (np.abs(self.omega) >= self.band)
        shapes = self.shapes[:, stiff]
        yields = shapes @ (shapes.T @ pushes / self.omega[stiff, None] ** 2)
        return np.asarray(self.rows.at_q @ yields), np.asarray(self.rows.at_v @ yields)


def kept_modes(linear: SecondOrderModel, rows: ChannelRows, highest_hz: float, rate_hz: float) -> KeptModes:
    """Choose the modes that the search follows.

    Parameters
    ----------
    highest_hz : float
        Frequency below which nearly all power of the recorded velocities lies.
    rate_hz : float
        Slowest sample rate of the recordings.
    """
    omega, shapes = linear.eigen
    kept = observable(rows.onto(np.eye(len(omega))), shapes, omega)
    widest = 2 * np.pi * MODE_SELECTION.seen * rate_hz
    band = min(2 * np.pi * max(MODE_SELECTION.band_margin * highest_hz, 1.5 * _lowest(omega, kept)), widest)
    if np.sum(kept & (np.abs(omega) < widest)) <= MODE_SELECTION.few:
        band = widest
    kept &= np.abs(omega) < band
    damping = np.einsum("ij,ik,kj->j", shapes, linear.C, shapes)
    kept |= lags(omega, damping, band)  # damping couples them to what is seen
    kept &= np.cumsum(kept) <= MODE_SELECTION.most_modes
    return KeptModes(linear=linear, rows=rows, omega=omega, shapes=shapes, kept=kept, band=float(band))


def lags(omega: Array, damping: Array, band: float) -> Array:
    """Return which modes are damped beyond their critical damping, as a servo's are, with a slow pole that a band feels [rad/s].

    Parameters
    ----------
    omega, damping : (n,) array
        Frequencies [rad/s] and modal damping [1/s], of unit modal mass.
    """
    half = 0.5 * damping
    slow = omega**2 / np.maximum(half + np.sqrt(np.maximum(half**2 - omega**2, 0.0)), 1e-300)
    return np.asarray(
        (half > np.abs(omega)) & (slow < MODE_SELECTION.lagging * band) & (np.abs(omega) > LOCATIONS.free)
    )


def _lowest(omega: Array, kept: Array) -> float:
    moving = np.abs(omega[kept])
    moving = moving[moving > 1e-3]
    return float(moving.min() / (2 * np.pi)) if moving.size else 0.0


def as_stepped(plant: Plant, linear: SecondOrderModel, basis: Array, h: float) -> tuple[Array, Array, Array]:
    """Return what MuJoCo's step adds to the modes' mass, damping and stiffness.

    A semi-implicit step of length h raises frequencies by (omega h)^2/24, and dampers of joints, which it takes at its
    end, act as masses, too. Over a long lightly damped record that is no small thing, and it is no missing physics, so
    the twin has it as well: the modes get the damping and stiffness of the logarithm of their step, together, for dampers couple
    them, and the mass with which forces that are held over steps move them as far: a servo goes where it is told to.

    Returns
    -------
    mass, damping, stiffness : (m, m) array
    """
    model = plant.model
    C, K = (basis.T @ part @ basis for part in (linear.C, linear.K))
    mass, damping, stiffness = (np.zeros_like(C) for _ in range(3))
    if model.opt.integrator not in STAGGERED:
        return mass, damping, stiffness
    at_end = np.zeros_like(linear.C)
    if not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP):
        at_end[np.diag_indices(model.nv)] = model.dof_damping
    if model.opt.integrator != mujoco.mjtIntegrator.mjINT_EULER:
        at_end = linear.C if plant.dissipation is None else linear.C - plant.dissipation
        is_same_tree = model.dof_treeid[:, None] == model.dof_treeid  # MuJoCo couples no other bodies there
        at_end = np.where(is_same_tree, at_end, 0.0)
    return tuple(
        there - here
        for there, here in zip(_of_step(C, K, basis.T @ at_end @ basis, h), (np.eye(len(C)), C, K), strict=True)
    )


def _of_step(C: Array, K: Array, at_end: Array, h: float) -> tuple[Array, Array, Array]:
    """Return the mass, the damping and the stiffness that a semi-implicit step of modes of unit mass shows under forces that are held
    over steps, (m, m) each.

    Parameters
    ----------
    at_end : (m, m) array
        Of the damping, what is taken at the end of a step.
    """
    m = len(C)
    yields = h * np.linalg.inv(np.eye(m) + h * at_end)
    step = np.eye(3 * m)  # of displacement, velocity, and the force
    step[m : 2 * m] += yields @ np.hstack([-K, -C, np.eye(m)])
    step[:m] += h * step[m : 2 * m]
    poles = np.linalg.eigvals(step)
    if np.any((poles.real <= 0.0) & (np.abs(poles.imag) < MODE_SELECTION.no_phase)):
        own = _one_by_one(np.diag(C), np.diag(K), np.diag(at_end), h)
        return own[0], own[1] + C - np.diag(np.diag(C)), own[2]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # it warns of errors of 1e-12
        rate = np.real(logm(step)) / h
    # velocities stand half a step behind: what counts is the rate of the displacements, not what the step calls velocity
    first, second = rate[:m], rate[:m] @ rate
    damping = -np.linalg.solve(first[:, m : 2 * m].T, second[:, m : 2 * m].T).T
    stiffness = -second[:, :m] - damping @ first[:, :m]
    mass = np.linalg.inv(second[:, 2 * m :] + damping @ first[:, 2 * m :])
    return mass, mass @ damping, mass @ stiffness


def _one_by_one(c: Array, k: Array, at_end: Array, h: float) -> tuple[Array, Array, Array]:
    """Return what `_of_step` does of modes whose damping (m,) does not couple them, where a step turns a servo's motion round: such a
    mode has its own stiffness, and a mass that goes with what its step shows."""
    grown = 1.0 + h * at_end
    step = np.zeros((len(c), 2, 2))  # of velocity and displacement
    step[:, 0, 0], step[:, 0, 1] = 1.0 - h * c / grown, -h * k / grown
    step[:, 1, 0], step[:, 1, 1] = h * step[:, 0, 0], 1.0 + h * step[:, 0, 1]
    s = np.log(np.linalg.eigvals(step).astype(complex)) / h
    damping, stiffness = -s.sum(axis=1).real, s.prod(axis=1).real
    mass = np.divide(k, stiffness, out=np.ones_like(k), where=(0.25 * c**2 > k) & (k > LOCATIONS.free**2))
    return np.diag(mass), np.diag(mass * damping), np.diag(mass * stiffness)
