"""Linear second-order model M q'' + C q' + K q = U u.

The source may be an FE model, a reduction or a linearised plant.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy import linalg

from vlab.errors import BadStructure
from vlab.signals import Array, FrequencyResponse, ModalModel

Quantity = Literal["displacement", "velocity", "acceleration"]
_POWER = {"displacement": 0, "velocity": 1, "acceleration": 2}
_UNIT = {"displacement": "m/N", "velocity": "m/s/N", "acceleration": "m/s^2/N"}


@dataclass(frozen=True, kw_only=True, eq=False)
class SecondOrderModel:
    """Mass, damping and stiffness with labelled coordinates.

    Parameters
    ----------
    M, C, K : (n, n) array
        Symmetric matrices in SI; M is positive definite.
    coordinates : sequence of str
        Labels of the generalised coordinates, for example ``"v:base"``.

    Raises
    ------
    BadStructure
        The matrices do not fit together, are not symmetric or not finite, or M is not positive definite.
    """

    M: Array
    C: Array
    K: Array
    coordinates: tuple[str, ...]

    def __post_init__(self) -> None:
        n = len(self.coordinates)
        for name in ("M", "C", "K"):
            matrix = np.array(getattr(self, name), dtype=float)
            if matrix.shape != (n, n) or not np.all(np.isfinite(matrix)):
                raise BadStructure(f"{name} of shape {matrix.shape} is not a finite {n} x {n} matrix")
            if not np.allclose(matrix, matrix.T, rtol=0, atol=1e-6 * (np.abs(matrix).max() + 1e-300)):
                raise BadStructure(f"{name} is not symmetric; the model is not a passive structure")
            matrix = (matrix + matrix.T) / 2
            matrix.setflags(write=False)
            object.__setattr__(self, name, matrix)
        try:
            linalg.cholesky(self.M)
        except linalg.LinAlgError as error:
            raise BadStructure("the mass matrix is not positive definite: a coordinate carries no mass") from error

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    @cached_property
    def eigen(self) -> tuple[Array, Array]:
        """Circular frequencies omega [rad/s] and mass-normalised shapes Phi.

        Frequencies ascend, and Phi^T M Phi = I.
        """
        squared, shapes = linalg.eigh(self.K, self.M)
        shapes = shapes * np.where(shapes[np.abs(shapes).argmax(axis=0), np.arange(shapes.shape[1])] < 0, -1.0, 1.0)
        return np.sign(squared) * np.sqrt(np.abs(squared)), shapes

    @property
    def freq(self) -> Array:
        """Undamped natural frequencies [Hz], ascending.

        A negative value means negative stiffness (an unstable equilibrium).
        """
        return self.eigen[0] / (2 * np.pi)

    @cached_property
    def zeta(self) -> Array:
        """Damping ratios of the undamped modes.

        The ratios are the diagonal of Phi^T C Phi over 2 omega.
        """
        omega, shapes = self.eigen
        return np.einsum("ij,ik,kj->j", shapes, self.C, shapes) / (2 * np.maximum(np.abs(omega), 1e-12))

    def tuning_stiffness(self, factors: Array) -> Array:
        """Return the stiffness that tunes frequencies by factors, (n, n).

        The mode shapes stay.
        """
        omega, shapes = self.eigen
        changed = np.flatnonzero(np.asarray(factors) != 1.0)
        rows = (self.M @ shapes[:, changed]).T
        return np.asarray((rows.T * ((np.asarray(factors)[changed] ** 2 - 1.0) * omega[changed] ** 2)) @ rows)

    def with_modal_damping(self, zeta: Array) -> "SecondOrderModel":
        """Return the model with modal damping.

        C = M Phi diag(2 zeta omega) Phi^T M couples no modes.

        Parameters
        ----------
        zeta : array
            Damping ratio of each mode, (n,).

        Returns
        -------
        SecondOrderModel
            Model with new C.
        """
        omega, shapes = self.eigen
        MPhi = self.M @ shapes
        return SecondOrderModel(
            M=self.M, C=(MPhi * (2 * np.asarray(zeta) * np.abs(omega))) @ MPhi.T, K=self.K, coordinates=self.coordinates
        )

    def with_rate_feedback(self, inputs: Array, gains: Array) -> "SecondOrderModel":
        """Return the model under collocated rate feedback u = -D y.

        For a symmetric D the damping becomes C + B D B^T (4.30).
        """
        return SecondOrderModel(M=self.M, C=self.C + inputs @ gains @ inputs.T, K=self.K, coordinates=self.coordinates)

    def transformed(self, T: Array, coordinates: Sequence[str]) -> "SecondOrderModel":
        """Return the model in coordinates p with q = T p.

        A tall T gives a Ritz reduction.
        """
        return SecondOrderModel(
            M=T.T @ self.M @ T, C=T.T @ self.C @ T, K=T.T @ self.K @ T, coordinates=tuple(coordinates)
        )

    def state_matrices(
        self, inputs: Array, outputs: Array, quantity: Quantity = "velocity"
    ) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C, D of equation (3.2) for x = [q', q].

        Parameters
        ----------
        inputs : (n, n_inputs) array
            Load distribution of each input.
        outputs : (n_outputs, n) array
            Displacement at each output per coordinate.
        quantity : str
            Measured quantity of the outputs.

        Returns
        -------
        tuple of (array, array, array, array)
            State matrices.
        """
        n = self.n
        Minv = np.linalg.inv(self.M)
        A = np.block([[-Minv @ self.C, -Minv @ self.K], [np.eye(n), np.zeros((n, n))]])
        B = np.vstack([Minv @ inputs, np.zeros((n, inputs.shape[1]))])
        Z = np.zeros_like(outputs)
        if quantity == "velocity":
            C, D = np.hstack([outputs, Z]), np.zeros((len(outputs), inputs.shape[1]))
        elif quantity == "displacement":
            C, D = np.hstack([Z, outputs]), np.zeros((len(outputs), inputs.shape[1]))
        else:
            C, D = outputs @ A[:n], outputs @ Minv @ inputs
        return A, B, C, D

    def state_space(self, inputs: Array, outputs: Array, quantity: Quantity = "velocity") -> Any:
        """Return python-control's `StateSpace`, see `state_matrices`."""
        import control

        return control.StateSpace(*self.state_matrices(inputs, outputs, quantity))

    def frequency_response(
        self,
        freq: Array,
        inputs: Array,
        outputs: Array,
        *,
        quantity: Quantity = "velocity",
        input_names: Sequence[str] = (),
        output_names: Sequence[str] = (),
    ) -> FrequencyResponse:
        """Return the analytical frequency response from M, C and K.

        Parameters
        ----------
        freq : array
            Frequencies [Hz].
        inputs : array
            Load distribution of each input, (n, n_inputs).
        outputs : array
            Displacement rows of the outputs, (n_outputs, n).
        quantity : Quantity
            Measured quantity of the outputs.
        input_names : sequence of str
            Names of the inputs.
        output_names : sequence of str
            Names of the outputs.

        Returns
        -------
        FrequencyResponse
            Response (n_freq, n_outputs, n_inputs), in the quantity's unit per N.
        """
        omega = 2 * np.pi * np.asarray(freq, dtype=float)
        dynamic = self.K - np.einsum("f,ij->fij", omega**2, self.M) + 1j * np.einsum("f,ij->fij", omega, self.C)
        motion = np.linalg.solve(dynamic, np.broadcast_to(inputs.astype(complex), (omega.size, *inputs.shape)))
        H = outputs @ motion * ((1j * omega) ** _POWER[quantity])[:, None, None]
        return FrequencyResponse(
            freq=np.asarray(freq, dtype=float),
            H=H,
            outputs=tuple(output_names) or tuple(f"output{i}" for i in range(H.shape[1])),
            inputs=tuple(input_names) or tuple(f"input{i}" for i in range(H.shape[2])),
            unit=_UNIT[quantity],
        )

    def complex_modes(self) -> tuple[Array, Array]:
        """Return frequencies and damping ratios of all damped modes.

        The frequency is |s|/(2 pi) [Hz], the ratio -Re s/|s|, in ascending order. An overdamped pair counts as two
        modes with ratio one.
        """
        A = self.state_matrices(np.zeros((self.n, 1)), np.zeros((1, self.n)))[0]
        s = np.linalg.eigvals(A)
        s = s[s.imag >= 0]
        s = s[np.argsort(np.abs(s))]
        return np.abs(s) / (2 * np.pi), -s.real / np.abs(s)

    def modal_model(self, outputs: Array, names: Sequence[str], count: int) -> ModalModel:
        """Return the first undamped modes at the outputs.

        Each shape has unit maximum at the outputs.

        Parameters
        ----------
        outputs : array
            Displacement rows, (n_outputs, n).
        names : sequence of str
            Names of the outputs.
        count : int
            Number of modes.

        Returns
        -------
        ModalModel
            Modal model.
        """
        shapes = outputs @ self.eigen[1][:, :count]
        scale = shapes[np.abs(shapes).argmax(axis=0), np.arange(shapes.shape[1])]
        return ModalModel(
            freq=self.freq[:count],
            zeta=self.zeta[:count],
            shapes=shapes / np.where(scale == 0, 1, scale),
            coordinates=tuple(names),
        )
