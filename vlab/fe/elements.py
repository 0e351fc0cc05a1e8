"""Element matrices: Hermite beam in bending with tension, linear bar in torsion.

The bending coordinates of an element are (v1, s1, v2, s2): deflection and slope at its two ends. Bending has cubic
shape functions and consistent mass [1]_ (sections 11.2-11.3). Tension has a consistent geometric stiffness, here for a
tension that varies linearly along the element [1]_ (section 11.3), [2]_.

References
----------
.. [1] R. D. Cook, D. S. Malkus, M. E. Plesha, *Concepts and Applications of Finite Element Analysis*, 3rd ed., 1989.
.. [2] J. S. Przemieniecki, *Theory of Matrix Structural Analysis*, 1968, chapter 15.
"""

from collections.abc import Callable

import numpy as np

from vlab.signals import Array


def hermite(xi: float, length: float) -> Array:
    """Return the four cubic shape functions.

    Parameters
    ----------
    xi : float
        s/length in [0, 1].
    length : float
        Length of the element [m].

    Returns
    -------
    array
        Values [1, m, 1, m].
    """
    return np.array(
        [
            1 - 3 * xi**2 + 2 * xi**3,
            length * (xi - 2 * xi**2 + xi**3),
            3 * xi**2 - 2 * xi**3,
            length * (xi**3 - xi**2),
        ]
    )


def hermite_slope(xi: float, length: float) -> Array:
    """Return the derivatives of the shape functions by s.

    Parameters
    ----------
    xi : float
        s/length in [0, 1].
    length : float
        Length of the element [m].

    Returns
    -------
    array
        Values [1/m, 1, 1/m, 1].
    """
    return np.array(
        [
            (-6 * xi + 6 * xi**2) / length,
            1 - 4 * xi + 3 * xi**2,
            (6 * xi - 6 * xi**2) / length,
            3 * xi**2 - 2 * xi,
        ]
    )


def hermite_curvature(xi: float, length: float) -> Array:
    """Return the second derivatives of the shape functions by s.

    Parameters
    ----------
    xi : float
        s/length in [0, 1].
    length : float
        Length of the element [m].

    Returns
    -------
    array
        Values [1/m^2, 1/m, 1/m^2, 1/m].
    """
    return np.array(
        [
            (-6 + 12 * xi) / length**2,
            (-4 + 6 * xi) / length,
            (6 - 12 * xi) / length**2,
            (-2 + 6 * xi) / length,
        ]
    )


def bending_stiffness(EI: float, length: float, GA: float = 0.0) -> Array:
    """Return the 4 x 4 bending stiffness.

    With shear flexibility the result is the exact stiffness of a Timoshenko beam, Phi = 12 EI/(GA L^2) (Przemieniecki,
    section 5.6). Translational terms are divided by 1 + Phi, and rotational terms become 4 + Phi and 2 - Phi.

    Parameters
    ----------
    EI : float
        Bending stiffness [N m^2].
    length : float
        Length of the element [m].
    GA : float
        Shear stiffness [N]; zero for rigid in shear.

    Returns
    -------
    array
        Stiffness in (v1, s1, v2, s2).
    """
    L = length
    Phi = 12 * EI / (GA * L**2) if GA > 0 else 0.0
    return (EI / (L**3 * (1 + Phi))) * np.array(
        [
            [12, 6 * L, -12, 6 * L],
            [6 * L, (4 + Phi) * L**2, -6 * L, (2 - Phi) * L**2],
            [-12, -6 * L, 12, -6 * L],
            [6 * L, (2 - Phi) * L**2, -6 * L, (4 + Phi) * L**2],
        ]
    )


def consistent_mass(mass_per_length: float, length: float) -> Array:
    """Return the 4 x 4 consistent mass.

    Parameters
    ----------
    mass_per_length : float
        Mass per length [kg/m].
    length : float
        Length of the element [m].

    Returns
    -------
    array
        Mass in (v1, s1, v2, s2).
    """
    L = length
    return (mass_per_length * L / 420) * np.array(
        [
            [156, 22 * L, 54, -13 * L],
            [22 * L, 4 * L**2, 13 * L, -3 * L**2],
            [54, 13 * L, 156, -22 * L],
            [-13 * L, -3 * L**2, -22 * L, 4 * L**2],
        ]
    )


def geometric_stiffness(tension_start: float, tension_end: float, length: float) -> Array:
    """Return the 4 x 4 geometric stiffness of a linear tension.

    Parameters
    ----------
    tension_start, tension_end : float
        Tension at the first and last node [N].
    length : float
        Length of the element [m].

    Returns
    -------
    array
        Stiffness in (v1, s1, v2, s2).
    """
    points, weights = np.polynomial.legendre.leggauss(3)  # exact to degree 5: slope^2 is quartic, tension linear
    K = np.zeros((4, 4))
    for point, weight in zip((points + 1) / 2, weights * length / 2, strict=True):
        slope = hermite_slope(point, length)
        tension = tension_start + (tension_end - tension_start) * point
        K += weight * tension * np.outer(slope, slope)
    return K


def moment_stiffness(moment: Callable[[float], float], length: float, boundary_factor: float) -> Array:
    """Return the 6 x 6 geometric stiffness of an in-plane moment.

    The coordinates are (v1, s1, v2, s2, twist 1, twist 2). The moment M(s) does work on the product of twist phi and
    curvature, U = -(integral of M phi w'' - b [M phi w']). The boundary factor b is 1 for a plate strip, with in-plane
    shear on w' phi. The factor is 0.5 for semitangential end moments, which turn half with each of the two rotations.

    Parameters
    ----------
    moment : callable
        s [m] to M [N m], positive if it pulls the fibres lifted by a positive twist.
    length : float
        Length of the element [m].
    boundary_factor : float
        b.

    Returns
    -------
    array
        Symmetric stiffness.
    """
    points, weights = np.polynomial.legendre.leggauss(
        4
    )  # exact to degree 7: quadratic moment, linear twist and curvature
    U = np.zeros((6, 6))
    for xi, weight in zip((points + 1) / 2, weights * length / 2, strict=True):
        twist = np.concatenate([np.zeros(4), [1 - xi, xi]])
        curvature = np.concatenate([hermite_curvature(xi, length), [0.0, 0.0]])
        U -= weight * moment(xi * length) * np.outer(twist, curvature)
    for end, sign in ((0, -1.0), (1, 1.0)):
        row = np.zeros((6, 6))
        row[4 + end, 1 + 2 * end] = 1.0
        U += boundary_factor * sign * moment(end * length) * row
    return U + U.T


def torsion_stiffness(GJ: float, length: float) -> Array:
    """Return the 2 x 2 St-Venant torsion stiffness.

    Parameters
    ----------
    GJ : float
        Torsion stiffness [N m^2].
    length : float
        Length of the element [m].
    """
    return GJ / length * np.array([[1.0, -1.0], [-1.0, 1.0]])


def torsion_mass(polar_inertia_per_length: float, length: float) -> Array:
    """Return the 2 x 2 consistent polar inertia.

    Parameters
    ----------
    polar_inertia_per_length : float
        Polar inertia per length [kg m].
    length : float
        Length of the element [m].
    """
    return polar_inertia_per_length * length / 6 * np.array([[2.0, 1.0], [1.0, 2.0]])


def rigid_end(offset_start: float, offset_end: float) -> Array:
    """Return the 4 x 4 map from nodes to flexible ends.

    The flexible part starts `offset_start` after the first node and ends `offset_end` before the second [m].
    """
    T = np.eye(4)
    T[0, 1] = offset_start
    T[2, 3] = -offset_end
    return T


def rigid_segment(mass_per_length: float, tension: float, length: float) -> tuple[Array, Array]:
    """Return mass and geometric stiffness of a rigid piece.

    The coordinates are (v, s) of the node that carries the piece.

    Parameters
    ----------
    mass_per_length : float
        Mass per length [kg/m].
    tension : float
        Tension [N].
    length : float
        Signed length [m]; positive for a piece ahead of its node along the bar.
    """
    a = length
    M = mass_per_length * abs(a) * np.array([[1.0, a / 2], [a / 2, a**2 / 3]])
    K = tension * abs(a) * np.array([[0.0, 0.0], [0.0, 1.0]])
    return M, K
