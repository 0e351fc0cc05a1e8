"""Dynamic modes, and modal matrices of MuJoCo's discrete step.

Modes above the band respond quasi-statically by their compliance. The logarithm of the semi-implicit step gives the
modes' apparent mass, damping and stiffness.
"""

import warnings
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.linalg import logm

from vlab.diagnose.parameters.observation import ChannelRows
from vlab.diagnose.parameters.reduced_model import observable
from vlab.diagnose.settings import LOCATIONS, MODE_SELECTION
from vlab.fe.second_order import SecondOrderModel
from vlab.physics.port_lines import STAGGERED
from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class KeptModes:
    """Linear model near rest with its selected modes.

    Parameters
    ----------
    linear : SecondOrderModel
        Linear model.
    rows : ChannelRows
        Channels per generalised coordinate.
    omega, shapes : (nv,), (nv, nv) array
        Natural frequencies [rad/s] and mass-normalised shapes of all modes.
    kept : (nv,) array of bool
        Mask of the dynamic modes.
    band : float
        Frequency above which modes are quasi-static [rad/s].
    """

    linear: SecondOrderModel
    rows: ChannelRows
    omega: Array
    shapes: Array
    kept: Array
    band: float

    @property
    def basis(self) -> Array:
        """Shapes (nv, m) of the dynamic modes."""
        return np.asarray(self.shapes[:, self.kept])

    def compliance(self, pushes: Array) -> tuple[Array, Array]:
        """Return quasi-static channels under forces (nv, n) and their rates."""
        stiff = ~self.kept & (np.abs(self.omega) >= self.band)
        shapes = self.shapes[:, stiff]
        yields = shapes @ (shapes.T @ pushes / self.omega[stiff, None] ** 2)
        return np.asarray(self.rows.at_q @ yields), np.asarray(self.rows.at_v @ yields)


def kept_modes(linear: SecondOrderModel, rows: ChannelRows, highest_hz: float, rate_hz: float) -> KeptModes:
    """Select the dynamic modes of the search.

    Parameters
    ----------
    linear : SecondOrderModel
        Linear model.
    rows : ChannelRows
        Channels per generalised coordinate.
    highest_hz : float
        Frequency below which nearly all recorded velocity power lies [Hz].
    rate_hz : float
        Lowest sample rate of the recordings [Hz].

    Returns
    -------
    KeptModes
        Observable modes in the band, and overdamped modes with a slow pole.
    """
    omega, shapes = linear.eigen
    kept = observable(rows.onto(np.eye(len(omega))), shapes, omega)
    widest = 2 * np.pi * MODE_SELECTION.seen * rate_hz
    band = min(
        2 * np.pi * max(MODE_SELECTION.band_margin * highest_hz, MODE_SELECTION.above_lowest * _lowest(omega, kept)),
        widest,
    )
    if np.sum(kept & (np.abs(omega) < widest)) <= MODE_SELECTION.few:
        band = widest
    kept &= np.abs(omega) < band
    damping = np.einsum("ij,ik,kj->j", shapes, linear.C, shapes)
    kept |= lags(omega, damping, band)  # damping couples overdamped modes to observable ones
    kept &= np.cumsum(kept) <= MODE_SELECTION.most_modes
    return KeptModes(linear=linear, rows=rows, omega=omega, shapes=shapes, kept=kept, band=float(band))


def lags(omega: Array, damping: Array, band: float) -> Array:
    """Return the mask of overdamped modes with a slow pole.

    Parameters
    ----------
    omega, damping : (n,) array
        Natural frequencies [rad/s] and modal damping [1/s] at unit modal mass.
    band : float
        Upper frequency of the band [rad/s].

    Returns
    -------
    (n,) array of bool
        True for overdamped modes whose slow pole acts in the band.
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
    """Return the modal matrices that MuJoCo's step adds.

    A semi-implicit step of length h raises frequencies by (omega h)^2/24, and implicit joint dampers add apparent mass.
    Both matter over long lightly damped records and are no missing physics. Damping and stiffness follow from the
    logarithm of the step, coupled by the dampers. The mass gives held forces their displacement, as a servo requires.

    Parameters
    ----------
    plant : Plant
        Plant with the integrator.
    linear : SecondOrderModel
        Linear model.
    basis : (nv, m) array
        Mode shapes.
    h : float
        Time step [s].

    Returns
    -------
    mass, damping, stiffness : (m, m) array
        Additional modal matrices.
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
        is_same_tree = model.dof_treeid[:, None] == model.dof_treeid  # implicit damping is per tree
        at_end = np.where(is_same_tree, at_end, 0.0)
    return tuple(
        there - here
        for there, here in zip(_of_step(C, K, basis.T @ at_end @ basis, h), (np.eye(len(C)), C, K), strict=True)
    )


def _of_step(C: Array, K: Array, at_end: Array, h: float) -> tuple[Array, Array, Array]:
    """Return M, C and K (m, m) of a semi-implicit step.

    Parameters
    ----------
    C, K : (m, m) array
        Damping and stiffness at unit modal mass.
    at_end : (m, m) array
        Implicit part of the damping.
    h : float
        Time step [s].
    """
    m = len(C)
    yields = h * np.linalg.inv(np.eye(m) + h * at_end)
    step = np.eye(3 * m)  # displacement, velocity, force
    step[m : 2 * m] += yields @ np.hstack([-K, -C, np.eye(m)])
    step[:m] += h * step[m : 2 * m]
    poles = np.linalg.eigvals(step)
    if np.any((poles.real <= 0.0) & (np.abs(poles.imag) < MODE_SELECTION.no_phase)):
        own = _one_by_one(np.diag(C), np.diag(K), np.diag(at_end), h)
        return own[0], own[1] + C - np.diag(np.diag(C)), own[2]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # scipy warns of errors of 1e-12
        rate = np.real(logm(step)) / h
    # velocities lag half a step, so the rate of the displacements replaces the step's velocity
    first, second = rate[:m], rate[:m] @ rate
    damping = -np.linalg.solve(first[:, m : 2 * m].T, second[:, m : 2 * m].T).T
    stiffness = -second[:, :m] - damping @ first[:, :m]
    mass = np.linalg.inv(second[:, 2 * m :] + damping @ first[:, 2 * m :])
    return mass, mass @ damping, mass @ stiffness


def _one_by_one(c: Array, k: Array, at_end: Array, h: float) -> tuple[Array, Array, Array]:
    """Return the result of `_of_step` for modes with uncoupled damping (m,).

    The case is a step that reverses a servo's motion. Such a mode keeps its stiffness, with a mass that matches the
    step.
    """
    grown = 1.0 + h * at_end
    step = np.zeros((len(c), 2, 2))  # velocity, displacement
    step[:, 0, 0], step[:, 0, 1] = 1.0 - h * c / grown, -h * k / grown
    step[:, 1, 0], step[:, 1, 1] = h * step[:, 0, 0], 1.0 + h * step[:, 0, 1]
    s = np.log(np.linalg.eigvals(step).astype(complex)) / h
    damping, stiffness = -s.sum(axis=1).real, s.prod(axis=1).real
    mass = np.divide(k, stiffness, out=np.ones_like(k), where=(0.25 * c**2 > k) & (k > LOCATIONS.free**2))
    return np.diag(mass), np.diag(mass * damping), np.diag(mass * stiffness)
