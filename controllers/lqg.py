"""LQG: regulator on Kalman-filter estimates (4.8-4.29), discretised by (5.2)-(5.5)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from vlab.controllers.designed_law import largest_index
from vlab.controllers.linear import LinearLaw
from vlab.controllers.lqr import LqrDesign
from vlab.controllers.lqr import design as design_lqr
from vlab.controllers.sampling import hold

from vlab.design import performance
from vlab.design.riccati import kalman_filter
from vlab.design.state_model import StateModel
from vlab.design.weights import Noise, Weights
from vlab.errors import BadDesign
from vlab.fe.model import FeModel
from vlab.signals import Array

RATE = 1000.0
"""RATE [Hz]: sample rate of the published LQG controllers (section 5.3)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LqgDesign:
    """Regulator, filter and the resulting discrete law.

    Parameters
    ----------
    regulator : LqrDesign
        Gain F with the design model.
    noise : Noise
        V_1, V_2 and alpha.
    K : (2n, n_s) array
        Filter gain in SI.
    controller : LinearLaw
        x_est+ = F22 x_est + F21 y, u = F12 x_est at `controller.rate`.
    """

    law: str = field(default="lqg", init=False)
    regulator: LqrDesign
    noise: Noise
    K: Array
    controller: LinearLaw

    @property
    def model(self) -> StateModel:
        """Design model of the law."""
        return self.regulator.model

    @property
    def weights(self) -> Weights:
        """Q and R of the regulator."""
        return self.regulator.weights

    @property
    def F(self) -> Array:
        """Gain of the regulator, (n_c, 2n)."""
        return self.regulator.F

    @property
    def A_estimator(self) -> Array:
        """Matrix A - B F - K C of the continuous law (5.5)."""
        return estimator(self.model, self.F, self.K)

    @property
    def A_closed(self) -> Array:
        """Closed loop on the design model for [x, e] (4.16)."""
        return performance.lqg_loop(self.model, self.F, self.K)

    @property
    def poles(self) -> performance.Poles:
        """Poles of the regulator.

        On the design model the loop has only regulator and filter poles.
        """
        return self.regulator.poles

    @property
    def filter_poles(self) -> performance.Poles:
        """Poles of the filter, A - K C."""
        return performance.poles(self.model.A - self.K @ self.model.C)

    @property
    def in_loop(self) -> LinearLaw:
        """See `Design`."""
        return self.controller

    @property
    def state_gain(self) -> Array:
        """See `Design`."""
        return self.F

    @property
    def filter_gain(self) -> Array:
        """See `Design`."""
        return self.K

    @property
    def search(self) -> None:
        """See `Design`."""
        return

    def gains(self) -> dict[str, Any]:
        """See `Design`."""
        return {**self.regulator.gains(), "sensors": list(self.model.channels), "K": self.K}

    def closed_modes(self, modes: Sequence[int]) -> tuple[Array, Array]:
        """See `Design`: the modes of the regulator."""
        return self.regulator.closed_modes(modes)

    def shape_indices(self, modes: Sequence[int], weights: Weights) -> Array:
        """See `Design`: the design's own weights apply."""
        return self.indices(modes)

    def goal(self, bounded: Array) -> dict[str, Any]:
        """See `Design`."""
        return largest_index(bounded)

    def indices(self, modes: int | Sequence[int] | Array) -> Array:
        """Return J of initial shapes of the design model: (4.20).

        `modes` is the number of first modes, or their numbers from 0.
        """
        x0 = performance.initial_states(self.model, modes)
        return performance.lqg_index(self.model, self.F, self.K, self.weights, x0)

    def A_on(self, full: StateModel) -> Array:
        """Return the closed loop with another model, A_E of (4.24).

        The state is [x, x_est].
        """
        return performance.reduced_controller_loop(full, self.model, self.F, self.K)

    def poles_on(self, full: StateModel) -> tuple[performance.Poles, performance.Spillover]:
        """Return the regulator's poles on a larger model, and spillover.

        The poles are in the order of `poles`.
        """
        return performance.reduced_controller_poles(full, self.model, self.F, self.K)

    def indices_on(self, full: StateModel, weights: Weights, count: int) -> Array:
        """Return J of initial shapes of another model: (4.26).

        `weights` belong to the other model's states. The shapes are those of the modes that correspond to the design
        model's first.
        """
        x0 = performance.initial_states(full, performance.shared_modes(full, self.model)[:count])
        return performance.reduced_controller_index(full, self.model, self.F, self.K, weights, x0)

    def to_control(self) -> Any:
        """Return the continuous law in python-control's form.

        Inputs are velocities, outputs forces.
        """
        import control

        zero = np.zeros((self.model.B.shape[1], len(self.model.C)))
        names = self.model.channels
        return control.StateSpace(
            self.A_estimator,
            self.K,
            -self.F,
            zero,
            inputs=[f"velocity {name}" for name in names],
            outputs=[f"force {name}" for name in names],
        )


def design(fe: FeModel | StateModel, weights: Weights, noise: Noise, *, rate: float = RATE) -> LqgDesign:
    """Design an LQG law on a full or reduced model.

    Parameters
    ----------
    fe : FeModel or StateModel
        Model for the design.
    weights, noise : Weights and Noise
        Weights and noise, see `vlab.design.weights`.
    rate : float
        Sample rate of the discrete law [Hz].

    Returns
    -------
    LqgDesign
        Gains and law.

    Raises
    ------
    BadDesign
        Weights or noise do not fit the model, or a Riccati equation has no stabilising solution; the message has the
        reason.
    BadController
        The rate is not positive.
    """
    regulator = design_lqr(fe, weights)
    model = regulator.model
    if noise.V1.shape != model.A.shape or len(noise.V2) != len(model.C):
        raise BadDesign(
            f"noise V1 {noise.V1.shape} and V2 {noise.V2.shape} does not fit the model's {2 * model.n} states and "
            f"{len(model.C)} sensors; make it from the same model"
        )
    K = kalman_filter(model.A, model.C, noise.V1, noise.V2, noise.alpha).K
    return LqgDesign(regulator=regulator, noise=noise, K=K, controller=discrete_law(model, regulator.F, K, rate=rate))


def estimator(model: StateModel, F: Array, K: Array) -> Array:
    """Return A - B F - K C (5.5)."""
    return model.A - model.B @ F - K @ model.C


def discrete_law(model: StateModel, F: Array, K: Array, *, rate: float = RATE) -> LinearLaw:
    """Return the law of (5.2)-(5.5), with samples held over a period.

    F12 = -F, F22 = exp(A~ dt), F21 = (F22 - I) A~^-1 K, the integral of exp(A~ t) K. The design has no delay.

    Parameters
    ----------
    model : StateModel
        Design model.
    F, K : array
        Regulator and filter gain.
    rate : float
        Sample rate [Hz].

    Returns
    -------
    LinearLaw
        Discrete law.
    """
    if not (np.isfinite(rate) and rate > 0):
        raise BadDesign(f"the rate {rate} Hz is not a positive number")
    F22, F21 = hold(estimator(model, F, K), K, 1 / rate)
    feedthrough = np.zeros((len(F), len(model.C)))
    return LinearLaw(F22, F21, -F, feedthrough, sensors=model.channels, actuators=model.channels, rate=rate)
