"""Sampled loop as one discrete system: structure, delay, hold, filter, law.

The zero-order hold with delay follows from the matrix exponential, see Franklin, Powell and Workman [1]_.

References
----------
.. [1] G. F. Franklin, J. D. Powell and M. L. Workman, Digital Control of Dynamic Systems, 3rd ed., Addison-Wesley,
       1998.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg
from scipy.optimize import linear_sum_assignment

from vlab.controllers import DirectRateFeedback
from vlab.controllers.linear import LinearController, Matrices
from vlab.controllers.sampling import sample_with_delay
from vlab.errors import BadController
from vlab.fe.model import FeModel
from vlab.fe.second_order import Quantity, SecondOrderModel
from vlab.hardware.laboratory import Converter
from vlab.hardware.output_chain import theoretical_response
from vlab.signals import Array

SAME_MODE = 0.2
"""SAME_MODE [1]: largest distance in log frequency at which a pole belongs to a mode."""


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Eigenvalues of the sampled loop.

    Parameters
    ----------
    z : (n,) complex array
        Eigenvalues in the z-plane.
    s : (n,) complex array
        Eigenvalues ln(z)/T [rad/s].
    """

    z: Array
    s: Array

    @property
    def is_stable(self) -> bool:
        """Whether every eigenvalue lies inside the unit circle."""
        return bool(np.all(np.abs(self.z) < 1))

    def modes(self, near_hz: Sequence[float] | Array) -> tuple[Array, Array]:
        """Return frequency and damping of each mode's continuation.

        The assignment of oscillatory eigenvalues minimises the sum of distances to the open-loop frequencies, in log
        frequency. A heavily damped mode then keeps its place. A law with states has eigenvalues near the structure's;
        `SampledLoop.mode_poles` separates them.

        Parameters
        ----------
        near_hz : sequence of float or array
            Open-loop frequencies [Hz].

        Returns
        -------
        tuple of (array, array)
            Frequencies |s|/(2 pi) [Hz] and damping ratios.
        """
        upper = self.s[self.s.imag > 1e-9]
        freq = np.abs(upper) / (2 * np.pi)
        rows, columns = linear_sum_assignment(np.abs(np.log(freq[None, :] / np.asarray(near_hz)[:, None])))
        chosen = upper[columns[np.argsort(rows)]]
        return np.abs(chosen) / (2 * np.pi), -chosen.real / np.abs(chosen)


@dataclass(frozen=True, kw_only=True)
class LoopPole:
    """One eigenvalue of the loop with its main mode.

    Parameters
    ----------
    hz, zeta : float
        Frequency |s|/(2 pi) [Hz] and damping ratio; a negative ratio means growth.
    growth : float
        Real part of s [1/s].
    mode : int
        Mode of the structure, from 1, with most of the motion's energy.
    share : float
        Share of that mode in the energy of all modes.
    mode_hz : float
        Frequency of that mode alone [Hz].
    """

    hz: float
    zeta: float
    growth: float
    mode: int
    share: float
    mode_hz: float

    @property
    def is_mode(self) -> bool:
        """Whether the pole is a slightly moved structural mode.

        Any other pole belongs as much to law, delay and filter.
        """
        return bool(abs(np.log(max(self.hz, 1e-12) / self.mode_hz)) < SAME_MODE)


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledLoop:
    """A structure under a sampled linear law, with hold, delay and filter.

    Parameters
    ----------
    omega : (m,) array
        Circular frequencies of the retained modes [rad/s].
    damping : (m, m) array
        Phi^T C Phi with mass-normalised shapes.
    at_coils : (n_coils, m) array
        Deflection of each mode at the law's coils.
    at_sensors : (n_sensors, m) array
        Sensor velocity per modal velocity.
    law : tuple of array
        A, B, C, D of x+ = A x + B y, u = C x + D y.
    converter : Converter
        Rate, delay and filter.
    gain : float or (n_coils,) array
        Factor on the commands; 1 for the law as given.
    """

    omega: Array
    damping: Array
    at_coils: Array
    at_sensors: Array
    law: Matrices
    converter: Converter
    gain: float | Array = 1.0

    def __post_init__(self) -> None:
        shapes = (len(self.at_coils), len(self.at_sensors))
        if self.law[3].shape != shapes:
            raise BadController(
                f"the law takes {self.law[3].shape[1]} samples to {self.law[3].shape[0]} commands; {shapes[1]} sensors and {shapes[0]} coils are given"
            )

    @property
    def rate(self) -> float:
        """Samples per second [Hz]."""
        return self.converter.rate

    def with_gain(self, gain: float | Array) -> "SampledLoop":
        """Return the loop with another gain on all commands."""
        other = replace(self, gain=gain)
        other.__dict__["plant"] = self.plant  # sampling the same plant again would take most of the time
        return other

    def with_delay(self, delay_samples: float) -> "SampledLoop":
        """Return the loop with another delay [samples]."""
        return replace(self, converter=replace(self.converter, delay_samples=delay_samples))

    def with_filter(self, corner_hz: float) -> "SampledLoop":
        """Return the loop with another filter corner [Hz].

        0 means no filter.
        """
        return replace(self, converter=replace(self.converter, filter_corner=corner_hz))

    @cached_property
    def continuous(self) -> tuple[Array, Array, Array]:
        """A, B, C from filter inputs to velocities.

        The states are modal velocities, displacements and filter outputs.
        """
        n, n_coils, corner = len(self.omega), len(self.at_coils), 2 * np.pi * self.converter.filter_corner
        size = 2 * n + (n_coils if corner > 0 else 0)
        A, B, C = np.zeros((size, size)), np.zeros((size, n_coils)), np.zeros((len(self.at_sensors), size))
        A[:n, :n], A[:n, n : 2 * n], A[n : 2 * n, :n] = -self.damping, -np.diag(self.omega**2), np.eye(n)
        C[:, :n] = self.at_sensors
        if corner > 0:
            A[:n, 2 * n :], A[2 * n :, 2 * n :] = self.at_coils.T, -corner * np.eye(n_coils)
            B[2 * n :] = corner * np.eye(n_coils)
        else:
            B[:n] = self.at_coils.T
        return A, B, C

    @cached_property
    def plant(self) -> tuple[Array, Array, Array]:
        """A, B, C of the discrete system from commands to samples."""
        return sample_with_delay(*self.continuous, rate=self.converter.rate, delay_samples=self.converter.delay_samples)

    @cached_property
    def matrix(self) -> Array:
        """Transition matrix of the closed loop.

        The plant's states precede the law's.
        """
        A, B, C = self.plant
        a, b, c, d = self.law
        B = B * self.gain
        return np.block([[A + B @ d @ C, B @ c], [b @ C, a]])

    def closed(self) -> ClosedLoop:
        """Return the eigenvalues of the closed loop."""
        z = np.linalg.eigvals(self.matrix)
        z = z[np.abs(z) > 1e-12]
        return ClosedLoop(z, np.log(z.astype(complex)) * self.converter.rate)

    @cached_property
    def radius(self) -> float:
        """Spectral radius of the closed loop; stable below one."""
        return float(np.abs(np.linalg.eigvals(self.matrix)).max())

    def poles(self) -> list[LoopPole]:
        """Return one pole a pair by frequency, with its main mode."""
        return sorted((pole for pole, _ in self._poles_and_energies()), key=lambda pole: pole.hz)

    def mode_poles(self, modes: Sequence[int]) -> list[LoopPole]:
        """Return the poles that continue given modes.

        Each mode gets a pole of its own. A pole is chosen by log frequency and by the mode's share of its energy. A law
        with states puts well-damped poles among the structure's, so light damping counts as well.

        Parameters
        ----------
        modes : sequence of int
            Modes, from 0.

        Returns
        -------
        list of LoopPole
            One pole a mode.
        """
        found = self._poles_and_energies()
        energies = np.array([energy[list(modes)] for _, energy in found]).T
        zeta = np.array([pole.zeta for pole, _ in found])
        apart = np.log([max(pole.hz, 1e-12) for pole, _ in found]) - np.log(self.omega[list(modes), None] / (2 * np.pi))
        rows, columns = linear_sum_assignment(np.abs(apart) + 1 - energies + zeta)
        return [found[column][0] for column in columns[np.argsort(rows)]]

    def _poles_and_energies(self) -> list[tuple[LoopPole, Array]]:
        """Return one pole a pair with its modal energy shares, (m,)."""
        z, vectors = linalg.eig(self.matrix)
        upper = np.flatnonzero((z.imag >= 0) & (np.abs(z) > 1e-12))
        n = len(self.omega)
        s = np.log(z[upper].astype(complex)) * self.converter.rate
        moving = vectors[:, upper]
        energy = np.abs(moving[:n]) ** 2 + (self.omega[:, None] * np.abs(moving[n : 2 * n])) ** 2
        energy = energy / np.maximum(energy.sum(axis=0), 1e-300)
        return [
            (
                LoopPole(
                    hz=float(abs(root)) / (2 * np.pi),
                    zeta=float(-root.real / abs(root)),
                    growth=float(root.real),
                    mode=int(share.argmax()) + 1,
                    share=float(share.max()),
                    mode_hz=float(self.omega[share.argmax()] / (2 * np.pi)),
                ),
                share,
            )
            for root, share in zip(s, energy.T, strict=True)
        ]

    def critical(self) -> LoopPole:
        """Return the least stable pole."""
        return max(self.poles(), key=lambda pole: pole.growth)

    def opened(self, freq: Array) -> Array:
        """Return the loop gain L = -K P at the commands.

        The sensitivity is (I + L)^-1. P is exact from sample to sample, with the images of the hold.

        Parameters
        ----------
        freq : array
            Frequencies [Hz].

        Returns
        -------
        array
            L, (n_freq, n_coils, n_coils).
        """
        A, B, C = self.plant
        n, n_coils = len(self.continuous[0]), B.shape[1]
        z = np.exp(2j * np.pi * np.asarray(freq, dtype=float) / self.converter.rate)[:, None, None]
        # past commands are powers of 1/z; without them the eigenvectors are well conditioned
        lags = range((len(A) - n) // n_coils)
        columns = [B[:n], *(A[:n, n + lag * n_coils : n + (lag + 1) * n_coils] for lag in lags)]
        each = C[:, :n] @ _resolvent(A[:n, :n], np.hstack(columns), z[:, 0, 0])
        P = sum(each[:, :, k * n_coils : (k + 1) * n_coils] * z**-k for k in range(len(columns)))
        return np.asarray(-law_response(self.law, freq, self.converter.rate) @ (P * self.gain))


def _resolvent(A: Array, B: Array, z: Array) -> Array:
    """Return (z I - A)^-1 B for every z.

    Well-conditioned eigenvectors of A shorten the computation.
    """
    values, vectors = np.linalg.eig(A)
    if np.linalg.cond(vectors) < 1e8:
        return np.asarray(vectors @ (np.linalg.solve(vectors, B.astype(complex)) / (z[:, None] - values)[:, :, None]))
    return np.linalg.solve(
        z[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (len(z), *B.shape)).astype(complex)
    )


def sampled_loop(
    linear: SecondOrderModel,
    inputs: Array,
    law: LinearController,
    converter: Converter,
    *,
    outputs: Array | None = None,
    modes: int | None = None,
) -> SampledLoop:
    """Return the exactly sampled loop of a structure and a law.

    The loop has hold, delay and filter.

    Parameters
    ----------
    linear : SecondOrderModel
        Structure.
    inputs : (n, n_coils) array
        Load distribution of the law's coils.
    law : LinearController
        Linear law.
    converter : Converter
        Rate, delay and filter.
    outputs : (n_sensors, n) array or None
        Deflection rows of the law's velocity sensors; collocated with the coils by default.
    modes : int or None
        Number of retained modes; all by default.

    Returns
    -------
    SampledLoop
        Loop.

    Raises
    ------
    BadController
        The law is nonlinear, has another rate, or does not fit coils and sensors.
    """
    if not isinstance(law, LinearController):
        raise BadController(
            f"{type(law).__name__} has no `matrices`: theory predicts linear laws only; run an experiment instead"
        )
    made_for = getattr(law, "rate", None)
    if made_for is not None and abs(made_for / converter.rate - 1) > 1e-9:
        raise BadController(f"the law was made for {made_for:g} Hz; the loop samples at {converter.rate:g} Hz")
    omega, shapes = linear.eigen
    shapes = shapes[:, :modes]
    rows = inputs.T if outputs is None else outputs
    return SampledLoop(
        omega=omega[:modes],
        damping=shapes.T @ linear.C @ shapes,
        at_coils=inputs.T @ shapes,
        at_sensors=rows @ shapes,
        law=law.matrices,
        converter=converter,
    )


def loop_on(fe: FeModel, law: LinearController, converter: Converter, *, modes: int | None = None) -> SampledLoop:
    """Return the loop of an FE model and a law.

    The law's design model may be another one.
    """
    coils, sensors = fe.deflections(law.actuators).T, fe.deflections(law.sensors)
    return sampled_loop(fe.linear, coils, law, converter, outputs=sensors, modes=modes)


def predict_rate_feedback(
    linear: SecondOrderModel, inputs: Array, gains: Array, converter: Converter, *, modes: int | None = None
) -> ClosedLoop:
    """Return the eigenvalues of the loop u_k = -D y_k.

    Coils and sensors are collocated, see `sampled_loop`.

    Parameters
    ----------
    linear : SecondOrderModel
        Linear model.
    inputs : array
        Load distribution of the coils, (n, n_coils).
    gains : (n_coils, n_coils) array
        D [N s/m].
    converter : Converter
        Rate, delay and filter.
    modes : int or None
        Number of retained modes; all by default.
    """
    places = [f"coil{i + 1}" for i in range(inputs.shape[1])]
    law = DirectRateFeedback(gains, sensors=places, actuators=places)
    return sampled_loop(linear, inputs, law, converter, modes=modes).closed()


def closed_loop_response(
    linear: SecondOrderModel,
    coils: Array,
    law: LinearController,
    converter: Converter,
    freq: Array,
    *,
    sensors: Array,
    excited: Array,
    outputs: Array,
    quantity: Quantity,
) -> Array:
    """Return the analytical closed-loop response to an added force.

    The force acts behind the filter. The loop is opened at the forces: u = c(f) K(f) (velocities), with the law's
    response K and the response c of hold, delay and filter. With L = -c K G the coils' forces are -(I + L)^-1
    L_excited. Images of the hold above half the sample rate are left out.

    Parameters
    ----------
    linear : SecondOrderModel
        Linear model.
    coils : (n, n_coils) array
        Load distribution of the law's coils.
    law : LinearController
        Linear law.
    converter : Converter
        Rate, delay and filter.
    freq : array
        Frequencies [Hz].
    sensors : (n_sensors, n) array
        Deflection rows of the law's velocity sensors.
    excited : (n, n_excited) array
        Load distribution of the added force.
    outputs : (n_outputs, n) array
        Deflection rows of the observed points.
    quantity : Quantity
        Observed quantity.

    Returns
    -------
    array
        Response, (n_freq, n_outputs, n_excited).
    """
    both = np.hstack([coils, excited])
    n_coils = coils.shape[1]
    seen = linear.frequency_response(freq, both, sensors, quantity="velocity").H
    out = linear.frequency_response(freq, both, outputs, quantity=quantity).H
    through = law_response(law.matrices, freq, converter.rate) * theoretical_response(converter, freq)[:, None, None]
    loop = -through @ seen
    forces = -np.linalg.solve(np.eye(n_coils) + loop[:, :, :n_coils], loop[:, :, n_coils:])
    return np.asarray(out[:, :, n_coils:] + out[:, :, :n_coils] @ forces)


def law_response(law: Matrices, freq: Array, rate: float) -> Array:
    """Return C (z I - A)^-1 B + D of a discrete law.

    The shape is (n_freq, n_actuators, n_sensors).

    Parameters
    ----------
    law : Matrices
        A, B, C, D of the law.
    freq : array
        Frequencies [Hz].
    rate : float
        Sample rate [Hz].
    """
    a, b, c, d = law
    z = np.exp(2j * np.pi * np.asarray(freq, dtype=float) / rate)
    return np.asarray(c @ _resolvent(a, b, z) + d if len(a) else np.broadcast_to(d + 0j, (len(z), *d.shape)))
