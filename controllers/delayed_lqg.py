"""LQG design on the sampled plant with hold and delay.

The published design neglects the delay of 1.35 samples (section 5.3). In this design the pending commands are exactly
known states of the model. Regulator and filter are those of the discrete plant.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from vlab.controllers.linear import LinearLaw
from vlab.controllers.sampling import sample_with_delay

from vlab.design.state_model import StateModel
from vlab.design.weights import Noise, Weights
from vlab.errors import BadDesign

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class DelayedLqgDesign:
    """Regulator and filter of the discrete plant.

    Parameters
    ----------
    A, B, C : array
        Discrete plant with states [x, u_(k-1), ...].
    F, L : array
        Gains of u = -F z, z+ = A z + B u + L (y - C z).
    controller : LinearLaw
        Law for the loop.
    """

    A: Array
    B: Array
    C: Array
    F: Array
    L: Array
    controller: LinearLaw

    @property
    def regulator_poles(self) -> Array:
        """Eigenvalues of A - B F in the z-plane.

        States of the delay alone have eigenvalue zero.
        """
        return np.asarray(np.linalg.eigvals(self.A - self.B @ self.F))

    @property
    def filter_poles(self) -> Array:
        """Eigenvalues of A - L C, all within exp(-alpha T)."""
        return np.asarray(np.linalg.eigvals(self.A - self.L @ self.C))


def design(model: StateModel, weights: Weights, noise: Noise, *, rate: float, delay_samples: float) -> DelayedLqgDesign:
    """Design an LQG law for the sampled plant with delay.

    The index is a sum over samples with weights Q T and R T; the noise has V1 T and V2 / T. Both tend to the continuous
    problem at fast sampling. The filter has the same prescribed margin alpha (4.9).

    Parameters
    ----------
    model : StateModel
        Model of the structure.
    weights, noise : Weights, Noise
        Weights and noise, see `vlab.design.weights`.
    rate : float
        Sample rate [Hz].
    delay_samples : float
        Delay from a sample to its output [samples]; the design adds the hold.

    Returns
    -------
    DelayedLqgDesign
        Gains and law.

    Raises
    ------
    BadDesign
        Weights or noise do not fit the model, or a Riccati equation has no stabilising solution.
    BadController
        The rate or delay is invalid.
    """
    if weights.Q.shape != model.A.shape or weights.R.shape[0] != model.B.shape[1]:
        raise BadDesign(
            f"Q {weights.Q.shape} and R {weights.R.shape} do not fit {2 * model.n} states and {model.B.shape[1]} coils"
        )
    if noise.V1.shape != model.A.shape or len(noise.V2) != len(model.C):
        raise BadDesign(
            f"V1 {noise.V1.shape} and V2 {noise.V2.shape} do not fit {2 * model.n} states and {len(model.C)} sensors"
        )
    A, B, C = sample_with_delay(model.A, model.B, model.C, rate=rate, delay_samples=delay_samples)
    n, T = len(model.A), 1.0 / rate
    Q, V1 = np.zeros_like(A), np.zeros_like(A)
    Q[:n, :n], V1[:n, :n] = weights.Q * T, noise.V1 * T
    shift = np.exp(noise.alpha * T)
    F = _gain(A, B, Q, weights.R * T, "regulator")
    L = _gain((shift * A).T, (shift * C).T, V1, noise.V2 / T, "filter").T
    zero = np.zeros((B.shape[1], len(C)))
    channels = model.channels
    law = LinearLaw(A - B @ F - L @ C, L, -F, zero, sensors=channels, actuators=channels, rate=rate)
    return DelayedLqgDesign(A=A, B=B, C=C, F=F, L=L, controller=law)


def _gain(A: Array, B: Array, Q: Array, R: Array, what: str) -> Any:
    """Return the gain of the discrete Riccati equation."""
    try:
        S = linalg.solve_discrete_are(A, B, Q, R)
    except (linalg.LinAlgError, ValueError) as error:
        raise BadDesign(f"the discrete Riccati equation of the {what} has no stabilising solution: {error}") from error
    F = linalg.solve(R + B.T @ S @ B, B.T @ S @ A, assume_a="pos")
    radius = np.abs(np.linalg.eigvals(A - B @ F)).max()
    if not radius < 1:
        raise BadDesign(
            f"the discrete Riccati equation of the {what} gave an unstable loop (|z| = {radius:.6g}); sample faster"
        )
    return F
