"""Modal matrix parts of an MJCF model under its uncertain parameters."""

from collections.abc import Callable, Sequence

import numpy as np

from vlab.diagnose.parameters.mjcf import Number, Uncertain, adjusted
from vlab.diagnose.parameters.reduced_model import Part
from vlab.plants.base import Plant
from vlab.signals import Array


def parts_of(plant: Plant, parameters: Sequence[Uncertain], basis: Array) -> tuple[Part, ...]:
    """Return the modal matrix parts under uncertain parameters.

    A spring is one part under two factors: the common one and its own. A sum of both derivatives at factors of 7 %
    would shift a lightly damped frequency by a tenth of its bandwidth.

    Parameters
    ----------
    plant : Plant
        Nominal plant.
    parameters : sequence of Uncertain
        Uncertain parameters.
    basis : (nv, m) array
        Mode shapes.

    Returns
    -------
    tuple of Part
        Parts of M, C and K.
    """
    by: dict[Number, tuple[int, ...]] = {}
    for i, parameter in enumerate(parameters):
        for number in parameter.fields:
            by[number] = (*by.get(number, ()), i)
    together: dict[tuple[int, ...], list[Number]] = {}
    for number, multiplied in by.items():
        together.setdefault(multiplied, []).append(number)
    return tuple(_part(plant, tuple(fields), multiplied, basis) for multiplied, fields in together.items())


def _part(plant: Plant, fields: tuple[Number, ...], by: tuple[int, ...], basis: Array) -> Part:
    one = Uncertain(name="", kind="", sd=1.0, fields=fields)

    def matrices(theta: float) -> tuple[Array, Array, Array]:
        linear = adjusted(plant, [one], np.array([theta])).linearise()
        return linear.M, linear.C, linear.K

    M, C, K = (basis.T @ part @ basis for part in _derivative(matrices))
    return Part(
        by=by,
        M=M if np.abs(M).max() > 1e-9 else None,  # unit modal mass
        C=C if np.any(C) else None,
        K=K if np.any(K) else None,
    )


def _derivative(make: Callable[[float], tuple[Array, Array, Array]], step: float = 1e-3) -> tuple[Array, Array, Array]:
    """Return central differences of M, C and K by a log factor."""
    high, low = make(step), make(-step)
    return tuple((a - b) / (2 * step) for a, b in zip(high, low, strict=True))  # type: ignore[return-value]
