"""Lateral modes of the cables, added to an FE model.

The FE model has cables as springs and end masses only. A cable of length l and mass m moves as v_end x/l + sum of s_j
sin(j pi x/l), after Craig and Bampton [1]_. The coordinate x starts at the cable's fixing. The first term is already in
the model: stiffness T/l and mass m/3 at the point. Each s_j adds the modal mass m/2, its natural frequency with both
ends held, and the coupling -(-1)^j m/(j pi) to the point's acceleration. The stiffness is uncoupled.

References
----------
.. [1] R. R. Craig and M. C. C. Bampton, Coupling of substructures for dynamic analyses, AIAA Journal 6 (1968)
       1313-1319.
"""

from dataclasses import replace

import numpy as np

from vlab.errors import BadStructure, unknown_name
from vlab.fe.model import FeModel
from vlab.fe.second_order import SecondOrderModel
from vlab.fe.statics import cable_tensions
from vlab.signals import Array
from vlab.structure.model import Cable, Structure


def string_frequency(structure: Structure, cable: str, mode: int = 1) -> float:
    """Return a cable's natural frequency with held ends [Hz].

    The frequency is j/(2 l) sqrt(T/mu) for mode j.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    cable : str
        Name of the cable.
    mode : int
        Number of half waves j.

    Raises
    ------
    UnknownName
        No such cable.
    """
    part = _cable(structure, cable)
    tension = cable_tensions(structure)[cable] * part.length / (part.count * abs(part.height))  # of one cable
    return float(mode / (2 * part.length) * np.sqrt(tension / (part.density * part.area)))


def with_cable_mass(structure: Structure, cable: str, factor: float) -> Structure:
    """Return the structure with another cable mass per length.

    The tension stays. Wire rope is metal over about 0.6 of its cross-section; a sheath or fittings add mass.

    Parameters
    ----------
    structure : Structure
        Structure with its points, bars and transducers.
    cable : str
        Name of the cable.
    factor : float
        Factor on the mass per length.

    Returns
    -------
    Structure
        Changed structure.

    Raises
    ------
    UnknownName
        No such cable.
    BadStructure
        The factor is not positive.
    """
    if not (np.isfinite(factor) and factor > 0):
        raise BadStructure(f"a cable of {factor} times its mass makes no sense; accepted: above 0")
    part = _cable(structure, cable)
    other = replace(part, density=part.density * factor)
    return replace(structure, cable=tuple(other if c.name == cable else c for c in structure.cable))


def add_string_modes(fe: FeModel, modes: int = 1, *, zeta: float | None = None) -> FeModel:
    """Return the FE model with the first modes of every cable.

    The additional coordinates are ``s1:cable-lower`` and so on. All cables of a set move alike. The structure keeps its
    own damping.

    Parameters
    ----------
    fe : FeModel
        FE model with cables as springs.
    modes : int
        Number of modes of each cable.
    zeta : float or None
        Damping ratio of each string with held ends; the structure's ratio of higher modes by default.

    Returns
    -------
    FeModel
        Extended model.

    Raises
    ------
    BadStructure
        Fewer than one mode, or a negative ratio.
    """
    structure, linear = fe.structure, fe.linear
    ratio = structure.damping.higher if zeta is None else zeta
    if modes < 1 or not ratio >= 0:
        raise BadStructure(
            f"{modes} string modes of damping ratio {ratio} make no sense; accepted: from 1 mode, from 0"
        )
    parts = [(cable, j) for cable in structure.cable for j in range(1, modes + 1)]
    n, total = linear.n, linear.n + len(parts)
    M, C, K = (np.zeros((total, total)) for _ in range(3))
    M[:n, :n], C[:n, :n], K[:n, :n] = linear.M, linear.C, linear.K
    for i, (cable, j) in enumerate(parts, start=n):
        mass, omega = 3 * cable.end_mass, 2 * np.pi * string_frequency(structure, cable.name, j)
        M[i, i], C[i, i], K[i, i] = mass / 2, mass * ratio * omega, mass / 2 * omega**2
        M[i, :n] = M[:n, i] = -((-1) ** j) * mass / (j * np.pi) * fe.deflection(cable.at)
    labels = (*linear.coordinates, *(f"s{j}:{cable.name}" for cable, j in parts))
    return replace(
        fe,
        linear=SecondOrderModel(M=M, C=C, K=K, coordinates=labels),
        expand=np.hstack([fe.expand, np.zeros((len(fe.expand), len(parts)))]),
        pieces=(),
    )


def string_shares(fe: FeModel) -> Array:
    """Return the cables' share of each mode's kinetic energy, (n_modes,)."""
    shapes = fe.linear.eigen[1]
    cables = {cable.name for cable in fe.structure.cable}
    own = np.array([label.partition(":")[2] in cables for label in fe.linear.coordinates])
    return np.asarray(np.einsum("ij,ij->j", shapes[own], (fe.linear.M @ shapes)[own]))


def _cable(structure: Structure, name: str) -> Cable:
    for cable in structure.cable:
        if cable.name == name:
            return cable
    raise unknown_name("cable", name, [c.name for c in structure.cable], where=f"structure {structure.name!r}")
