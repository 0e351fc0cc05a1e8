"""What theory says of the sampled loop: structure, delay, hold, filter and law as one discrete system."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.optimize import linear_sum_assignment

from vlab.fe.second_order import Quantity, SecondOrderModel
from vlab.hardware.laboratory import Converter
from vlab.hardware.output_chain import delay_split, theoretical_response
from vlab.signals import Array


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Eigenvalues of the sampled loop.

    Parameters
    ----------
    z : (n,) complex array
        In the z-plane.
    s : (n,) complex array
        ln(z)/T [rad/s].
    """

    z: Array
    s: Array

    @property
    def is_stable(self) -> bool:
        """Whether every eigenvalue lies inside the unit circle."""
        return bool(np.all(np.abs(self.z) < 1))

    def modes(self, near_hz: Sequence[float] | Array) -> tuple[Array, Array]:
        """Return frequency |s|/2pi [Hz] and damping ratio of the oscillatory eigenvalue that continues each open-loop mode.

        Eigenvalues are assigned so that the sum of their distances to the open-loop frequencies, in log frequency, is
        least; a heavily damped mode keeps its place that way.
        """
        upper = self.s[self.s.imag > 1e-9]
        freq = np.abs(upper) / (2 * np.pi)
        rows, columns = linear_sum_assignment(np.abs(np.log(freq[None, :] / np.asarray(near_hz)[:, None])))
        chosen = upper[columns[np.argsort(rows)]]
        return np.abs(chosen) / (2 * np.pi), -chosen.real / np.abs(chosen)


def predict_rate_feedback(
    linear: SecondOrderModel, inputs: Array, gains: Array, converter: Converter, *, modes: int | None = None
) -> ClosedLoop:
    """Return the loop u_k = -D y_k with hold, delay and filter, sampled exactly.

    Parameters
    ----------
    linear : SecondOrderModel
        The structure.
    inputs : (n, n_coils) array
        Load distribution of the coils; the velocities are collocated.
    gains : (n_coils, n_coils) array
        D [N s/m].
    modes : int or None
        Keep the first modes only; all by default.
    """
    omega, shapes = linear.eigen
    keep = slice(0, modes)
    omega, at_coils = omega[keep], inputs.T @ shapes[:, keep]
    damping = shapes[:, keep].T @ linear.C @ shapes[:, keep]
    n, n_coils = len(omega), inputs.shape[1]
    T, corner = 1.0 / converter.rate, converter.filter_corner
    whole, late = delay_split(converter.delay_samples)
    A = np.zeros((2 * n + n_coils, 2 * n + n_coils))  # states: modal velocities, modal displacements, filter outputs
    A[:n, :n], A[:n, n : 2 * n] = -damping, -np.diag(omega**2)
    A[n : 2 * n, :n] = np.eye(n)
    B = np.zeros((2 * n + n_coils, n_coils))
    if corner > 0:
        A[:n, 2 * n :] = at_coils.T
        A[2 * n :, 2 * n :] = -2 * np.pi * corner * np.eye(n_coils)
        B[2 * n :] = 2 * np.pi * corner * np.eye(n_coils)
    else:
        B[:n] = at_coils.T
        A, B = A[: 2 * n, : 2 * n], B[: 2 * n]
    whole_step, late_step = _held(A, B, T), _held(A, B, (1 - late) * T)
    transition, newer = whole_step[0], late_step[1]
    older = whole_step[1] - newer
    C = np.zeros((n_coils, len(A)))
    C[:, :n] = at_coils
    # x+ = transition x + older u_(k-whole-1) + newer u_(k-whole), u_k = -D C x
    m = whole + 1
    big = np.zeros((len(A) + m * n_coils,) * 2)
    big[: len(A), : len(A)] = transition
    feedback = -gains @ C

    def column(lag: int) -> slice:
        return slice(len(A) + (lag - 1) * n_coils, len(A) + lag * n_coils)

    big[: len(A), column(whole + 1)] += older
    if whole == 0:
        big[: len(A), : len(A)] += newer @ feedback
    else:
        big[: len(A), column(whole)] += newer
    big[column(1), : len(A)] = feedback
    for lag in range(2, m + 1):
        big[column(lag), column(lag - 1)] = np.eye(n_coils)
    z = np.linalg.eigvals(big)
    z = z[np.abs(z) > 1e-12]
    return ClosedLoop(z, np.log(z) * converter.rate)


def _held(A: Array, B: Array, duration: float) -> tuple[Array, Array]:
    block = np.zeros((len(A) + B.shape[1],) * 2)
    block[: len(A), : len(A)], block[: len(A), len(A) :] = A, B
    out = linalg.expm(block * duration)
    return out[: len(A), : len(A)], out[: len(A), len(A) :]


def rate_feedback_response(
    linear: SecondOrderModel,
    coils: Array,
    gains: Array,
    converter: Converter,
    freq: Array,
    *,
    excited: Array,
    outputs: Array,
    quantity: Quantity,
) -> Array:
    """Return the analytical closed-loop response to a force added behind the filter, (n_freq, n_outputs, n_excited).

    The loop is opened at the forces: u = -D c(f) (velocities), c the response of hold, delay and filter, so the motion
    per added force is G (I + D c G_coils)^-1.

    Parameters
    ----------
    coils : (n, n_coils) array
        Load distribution of the law's coils, in the order of D; velocities are collocated.
    excited : (n, n_excited) array
        Load distribution of the added force.
    outputs : (n_outputs, n) array
        Deflection rows of what is observed.
    """
    both = np.hstack([coils, excited])
    n_coils = coils.shape[1]
    at_coils = linear.frequency_response(freq, both, coils.T, quantity="velocity").H
    out = linear.frequency_response(freq, both, outputs, quantity=quantity).H
    loop = gains[None] * theoretical_response(converter, freq)[:, None, None]
    forces = -np.linalg.solve(np.eye(n_coils) + loop @ at_coils[:, :, :n_coils], loop @ at_coils[:, :, n_coils:])
    return np.asarray(out[:, :, n_coils:] + out[:, :, :n_coils] @ forces)
