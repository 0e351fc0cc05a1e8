"""PC-1000 array controller: one constant matrix a sample (equation 5.1).

The matrix multiplies [inputs; states].
"""

from typing import Any, NoReturn

import numpy as np

from vlab.controllers.block_diagonal import block_diagonal
from vlab.controllers.linear import LinearController, LinearLaw
from vlab.errors import BadController
from vlab.hardware.laboratory import Hardware
from vlab.signals import Array


class ArrayController(LinearLaw):
    """A law as downloaded to the array controller.

    Direct feedback fills F11 alone; an observer fills F12, F21 and F22 (section 5.3). The zero parts are not
    multiplied.

    Parameters
    ----------
    law : LinearController
        Linear law: direct rate feedback, a sampled observer or any other.
    hardware : Hardware
        Hardware with the array's sizes and the converter's rate.

    Raises
    ------
    BadController
        There are too many sensors, actuators or states, the law is nonlinear or has another rate, or the hardware has
        no array.
    """

    def __init__(self, law: LinearController, hardware: Hardware) -> None:
        if not isinstance(law, LinearController):
            _refuse(f"{type(law).__name__} has no `matrices`: the array multiplies by one constant matrix")
        if hardware.array is None:
            _refuse("this hardware has no array; add a table [array] with inputs, outputs and states to its file")
        size, rate = hardware.array, hardware.converter.rate
        made_for = getattr(law, "rate", None)
        if made_for is not None and abs(made_for / rate - 1) > 1e-9:
            low, high = hardware.converter.lowest_rate, hardware.converter.highest_rate
            _refuse(
                f"the law was made for {made_for:g} Hz and the array samples at {rate:g} Hz; sample the law at the rate of the array, {low:g} to {high:g} Hz"
            )
        A, B, C, D = law.matrices
        for what, given, most, fix in (
            ("sensors", len(law.sensors), size.inputs, "wire fewer"),
            ("actuators", len(law.actuators), size.outputs, "wire fewer"),
            ("states", len(A), size.states, f"reduce the model to {size.states // 2} modes or fewer"),
        ):
            if given > most:
                _refuse(f"the law has {given} {what}; the array takes {most}: {fix}")
        self.array = size
        super().__init__(A, B, C, D, sensors=law.sensors, actuators=law.actuators, rate=rate)

    @property
    def coefficients(self) -> Array:
        """Complete matrix [[F11, F12], [F21, F22]].

        The shape is (outputs + states, inputs + states).
        """
        size = self.array
        F = np.zeros((size.outputs + size.states, size.inputs + size.states))
        n, n_sensors, n_actuators = len(self.A), len(self.sensors), len(self.actuators)
        F[:n_actuators, :n_sensors] = self.D
        F[:n_actuators, size.inputs : size.inputs + n] = self.C
        F[size.outputs : size.outputs + n, :n_sensors] = self.B
        F[size.outputs : size.outputs + n, size.inputs : size.inputs + n] = self.A
        return F

    @property
    def non_zeros(self) -> int:
        """Number of nonzero coefficients.

        An observer of 12 modes and 5 pairs has 816, in block-diagonal form 288.
        """
        return int(np.count_nonzero(self.coefficients))

    def s_plane(self) -> Array:
        """Return the roots of the internal states in the s-plane [rad/s].

        The map is z = exp(s T). Below half the sample rate the roots are the continuous observer's, which is the check
        of section 5.3. `vlab.lab.prediction` gives the roots of the whole loop.
        """
        rate = self.rate or 1.0
        s = np.log(np.linalg.eigvals(self.A).astype(complex)) * rate
        return np.asarray(s[np.argsort(np.abs(s), kind="stable")])


def array_report(law: LinearController, hardware: Hardware, *, continuous: Array | None = None) -> dict[str, Any]:
    """Return a law's demands on the array as plain data.

    The data are sizes, nonzero coefficients in both forms, and roots of the states.

    Parameters
    ----------
    law : LinearController
        Linear law.
    hardware : Hardware
        Hardware with the array's sizes.
    continuous : (n_states,) complex array or None
        Roots of the law before sampling [rad/s], for the z- to s-plane check.

    Returns
    -------
    dict of str to object
        Plain values by name.

    Raises
    ------
    BadController
        The law does not fit, see `ArrayController`.
    """
    array, size = ArrayController(law, hardware), hardware.array
    assert size is not None  # guaranteed by the checks of the array
    roots = array.s_plane()
    parts = {"inputs": len(law.sensors), "outputs": len(law.actuators), "states": len(roots)}
    return {
        "rate_hz": array.rate,
        **parts,
        "room": {name: getattr(size, name) for name in parts},
        "non_zeros": array.non_zeros,
        "non_zeros_block_diagonal": ArrayController(block_diagonal(law), hardware).non_zeros,
        "roots_hz": np.abs(roots) / (2 * np.pi),
        "s_plane_error": None if continuous is None else _farthest(roots, continuous),
    }


def array_text(report: dict[str, Any]) -> str:
    """Return the report of `array_report` as text.

    Parameters
    ----------
    report : dict of str to object
        Result of `array_report`.

    Returns
    -------
    str
        One line an entry.
    """
    room = report["room"]
    used = ", ".join(f"{report[name]} of {room[name]} {name}" for name in room)
    text = f"array controller at {report['rate_hz']:g} Hz: fits with {used}; {report['non_zeros']} non-zeros"
    if report["states"]:
        text += f", {report['non_zeros_block_diagonal']} in block-diagonal form"
    if report["s_plane_error"] is not None:
        text += (
            f"; its roots, carried back to the s-plane, are the continuous law's within {report['s_plane_error']:.1g}"
        )
    return text


def _farthest(roots: Array, continuous: Array) -> float:
    """Return the largest relative distance to the nearest root."""
    apart = np.abs(roots[:, None] - continuous[None, :]) / np.abs(continuous)[None, :]
    return float(apart.min(axis=0).max(initial=0.0))


def _refuse(message: str) -> NoReturn:
    raise BadController(f"array controller: {message}")
