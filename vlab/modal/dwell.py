"""Evaluation of a dwell: shape, purity and decay of a mode."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from vlab.errors import BadRecording
from vlab.modal.channels import checked_data
from vlab.modal.steps import SETTLING, Step, sines
from vlab.signals import Array, ComplexArray, Recording

DECAY_TO = 0.05
"""DECAY_TO [1]: expected envelope at the end of the evaluated decay."""
MIN_CYCLES = 4
"""MIN_CYCLES [cycles]: shortest steady part and shortest decay."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DwellResult:
    """One mode from a multi-point dwell.

    Parameters
    ----------
    hz : float
        Frequency of the forces [Hz].
    motion : (n_outputs,) complex array
        Displacement amplitudes of the outputs, relative to the phase of the forces.
    forces : (n_inputs,) array
        Amplitudes of the forces, negative for opposition.
    indicator : float
        Share of the motion out of quadrature, sum(abs(Re) abs(u)) / sum(abs(u)^2): 0 for a pure mode at its natural
        frequency.
    decay_hz, decay_zeta : float or None
        Natural frequency [Hz] and damping ratio from the free decay; None without one.
    decay_residual : float or None
        Relative rms of the motion beside one mode's decay.
    outputs, inputs : tuple of str
        Channel names.
    """

    hz: float
    motion: ComplexArray
    forces: Array
    indicator: float
    decay_hz: float | None
    decay_zeta: float | None
    decay_residual: float | None
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]

    @property
    def shape(self) -> Array:
        """Quadrature part of the motion, largest component 1."""
        quadrature = self.motion.imag
        return np.asarray(quadrature / quadrature[np.argmax(np.abs(quadrature))])


def evaluate_dwell(
    recording: Recording,
    step: Step,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    derivatives: Array,
    drive_s: float | None = None,
) -> DwellResult:
    """Return shape, purity and damping of a dwell.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    step : Step
        Time with acting forces, and their frequency.
    inputs : sequence of str
        Names of the force channels.
    outputs : sequence of str
        Names of the sensor channels.
    derivatives : (n_outputs,) int array
        Order of each output's derivative of a displacement (1 for velocities).
    drive_s : float or None
        Stop time of the forces [s after the first sample].

    Returns
    -------
    DwellResult
        Shape, indicator and decay.

    Raises
    ------
    BadRecording
        Too few cycles of steady motion or of decay, or forces that are not in phase.
    """
    inputs, outputs = tuple(inputs), tuple(outputs)
    dt, x, y = checked_data(recording, inputs, outputs, 0.0)
    if step.hz is None or (step.stop - step.start) * dt * step.hz < 2 * MIN_CYCLES:
        raise BadRecording(
            f"a dwell of {(step.stop - step.start) * dt:g} s is too short; at least {2 * MIN_CYCLES} cycles"
        )
    begin = step.start + round(SETTLING * (step.stop - step.start))
    amplitude = sines(np.hstack([x, y])[begin : step.stop], begin * dt, dt, step.hz)
    force, motion = amplitude[: len(inputs)], amplitude[len(inputs) :]
    phase = 0.5 * np.angle(np.sum(force**2))
    force, motion = force * np.exp(-1j * phase), motion * np.exp(-1j * phase)
    if np.linalg.norm(force.imag) > 0.1 * np.linalg.norm(force.real):
        raise BadRecording("the forces are neither in phase nor in opposition; a dwell needs real forces")
    displacement = motion / (2j * np.pi * step.hz) ** derivatives
    power = np.sum(np.abs(displacement) ** 2)
    if power == 0:
        raise BadRecording("nothing moves in the dwell")
    decay: tuple[float, float, float] | None = None
    if drive_s is not None:
        decay = _decay(y[int(np.ceil(drive_s / dt)) + 1 :], dt, step.hz)
    return DwellResult(
        hz=step.hz,
        motion=displacement,
        forces=force.real,
        indicator=float(np.sum(np.abs(displacement.real) * np.abs(displacement)) / power),
        decay_hz=None if decay is None else decay[0],
        decay_zeta=None if decay is None else decay[1],
        decay_residual=None if decay is None else decay[2],
        outputs=outputs,
        inputs=inputs,
    )


def _decay(y: Array, dt: float, hz: float) -> tuple[float, float, float]:
    """Fit one decaying sine to all outputs.

    Amplitudes and offsets are eliminated in closed form.
    """
    if len(y) * dt * hz < MIN_CYCLES:
        raise BadRecording(f"{len(y) * dt:g} s of decay are fewer than {MIN_CYCLES} cycles of {hz:g} Hz; record longer")
    scale = np.sqrt(np.mean(y**2, axis=0)) + 1e-300
    zeta = 0.01
    theta = np.array([hz, zeta])
    for _ in range(3):  # repeated, because the damping limits the part above noise
        n = min(len(y), int(max(MIN_CYCLES / hz, -np.log(DECAY_TO) / (2 * np.pi * hz * theta[1])) / dt))
        t, data = dt * np.arange(n), y[:n] / scale
        fit = least_squares(lambda p, t=t, data=data: _left(p, t, data).ravel(), theta, bounds=([0.8 * hz, 1e-6], [1.25 * hz, 0.5]), x_scale=(hz, theta[1]))  # fmt: skip
        theta = fit.x
    left = np.sqrt(np.sum(fit.fun**2) / np.sum(data**2))
    return float(theta[0]), float(theta[1]), float(left)


def _left(parameters: Array, t: Array, data: Array) -> Array:
    omega, zeta = 2 * np.pi * parameters[0], parameters[1]
    fall, turn = np.exp(-zeta * omega * t), omega * np.sqrt(1 - zeta**2) * t
    basis = np.stack([fall * np.cos(turn), fall * np.sin(turn), np.ones(t.size)], axis=1)
    Q, _ = np.linalg.qr(basis)
    return np.asarray(data - Q @ (Q.T @ data))
