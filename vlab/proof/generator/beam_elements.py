"""Hierarchic Timoshenko beam elements in bending, tension and torsion, integrated by Gauss quadrature.

Deflection w, section rotation psi and twist phi are independent fields with shape functions of degree `DEGREE`,
`DEGREE` - 1 and `TWIST_DEGREE`. The first two functions of a field are linear and belong to the ends. All others are
integrated Legendre polynomials, zero at both ends [1]_ (section 8.2). Because w' has the degree of psi, thin elements
do not lock in shear. The strain energy and the kinetic energy are

    U = 1/2 integral of (EI psi'^2 + GA (w' - psi)^2 + T w'^2 + GJ phi'^2) ds
    E = 1/2 integral of (mu w_t^2 + r psi_t^2 + j phi_t^2) ds

Stiffness, mass and tension may vary within an element.

References
----------
.. [1] B. Szabo, I. Babuska, *Finite Element Analysis*, Wiley, 1991.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from vlab.signals import Array

DEGREE, TWIST_DEGREE = 7, 3
"""DEGREE, TWIST_DEGREE [-]: degrees of deflection and twist; one element a span is exact to 1e-6 below 60 Hz."""
POINTS = 14
"""POINTS [-]: Gauss points of an element; exact for polynomials of degree 27."""


@dataclass(frozen=True, eq=False)
class Fields:
    """Values of all shape functions at stations of an element.

    The first six columns are (w, psi, phi) at both ends. The inner functions of w, of psi and of phi follow.

    Parameters
    ----------
    s, weight : (n,) array
        Stations from the first end, and weights of the quadrature [m].
    w, dw : (n, m) array
        Deflection and its derivative by s.
    psi, dpsi : (n, m) array
        Section rotation and its derivative.
    phi, dphi : (n, m) array
        Twist and its derivative.
    """

    s: Array
    weight: Array
    w: Array
    dw: Array
    psi: Array
    dpsi: Array
    phi: Array
    dphi: Array

    def form(self, left: Array, right: Array, density: Array | float = 1.0) -> Array:
        """Return the matrix of the integral of density times left times right.

        Parameters
        ----------
        left, right : (n, m) array
            Two of the fields.
        density : (n,) array or float
            Density at the stations.

        Returns
        -------
        (m, m) array
            Matrix of the bilinear form.
        """
        return np.asarray(left.T @ (right * (self.weight * density)[:, None]))


def inner_count() -> tuple[int, int, int]:
    """Return the numbers of inner functions of w, psi and phi."""
    return DEGREE - 1, DEGREE - 2, TWIST_DEGREE - 1


def shape_fields(length: float) -> Fields:
    """Return the shape functions at the Gauss points of an element.

    Parameters
    ----------
    length : float
        Length of the element [m].

    Returns
    -------
    Fields
        Values at `POINTS` stations.
    """
    xi, weight = legendre.leggauss(POINTS)
    inner_w, inner_psi, inner_phi = inner_count()
    total = 6 + inner_w + inner_psi + inner_phi
    starts = (6, 6 + inner_w, 6 + inner_w + inner_psi)
    values = []
    for field, (start, degree) in enumerate(zip(starts, (DEGREE, DEGREE - 1, TWIST_DEGREE), strict=True)):
        value, slope = np.zeros((POINTS, total)), np.zeros((POINTS, total))
        columns = [field, 3 + field, *range(start, start + degree - 1)]
        value[:, columns], slope[:, columns] = _hierarchic(xi, degree)
        values += [value, slope * 2.0 / length]
    return Fields((xi + 1.0) * length / 2.0, weight * length / 2.0, *values)


def _hierarchic(xi: Array, degree: int) -> tuple[Array, Array]:
    """Return hierarchic functions on [-1, 1] and their derivatives, (n, degree + 1) each."""
    polynomials = legendre.legvander(xi, degree)
    value = np.column_stack([(1 - xi) / 2, (1 + xi) / 2])
    slope = np.column_stack([np.full_like(xi, -0.5), np.full_like(xi, 0.5)])
    for k in range(2, degree + 1):
        size = np.sqrt(2.0 * (2 * k - 1))
        value = np.column_stack([value, (polynomials[:, k] - polynomials[:, k - 2]) / size])
        slope = np.column_stack([slope, polynomials[:, k - 1] * (2 * k - 1) / size])
    return value, slope


@dataclass(frozen=True, kw_only=True)
class Along:
    """Properties of a bar at stations of one element.

    Parameters
    ----------
    EI, GA, GJ : (n,) array
        Bending stiffness [N m^2], shear stiffness [N], torsion stiffness [N m^2].
    mu, rotary, polar : (n,) array
        Mass [kg/m], rotary inertia of bending and polar inertia [kg m].
    tension, moment : (n,) array
        Axial force [N], and in-plane bending moment [N m]. A positive moment pulls the fibres lifted by a positive
        twist.
    """

    EI: Array
    GA: Array
    GJ: Array
    mu: Array
    rotary: Array
    polar: Array
    tension: Array
    moment: Array


def element_matrices(
    fields: Fields, along: Along, end_moments: tuple[float, float] = (0.0, 0.0)
) -> tuple[Array, Array, Array]:
    """Return mass, stiffness and bending stiffness of an element.

    The in-plane moment works on twist times curvature. Half of its boundary term [M phi psi] is added, which makes the
    energy invariant to rigid rotations.

    Parameters
    ----------
    fields : Fields
        Shape functions at the stations.
    along : Along
        Properties at the stations.
    end_moments : (float, float)
        In-plane moments at both ends [N m].

    Returns
    -------
    tuple of ((m, m) array, (m, m) array, (m, m) array)
        Mass, stiffness, and the part of the stiffness from EI.
    """
    f = fields
    mass = f.form(f.w, f.w, along.mu) + f.form(f.psi, f.psi, along.rotary) + f.form(f.phi, f.phi, along.polar)
    bending = f.form(f.dpsi, f.dpsi, along.EI)
    shear = f.dw - f.psi
    stiffness = bending + f.form(shear, shear, along.GA) + f.form(f.dw, f.dw, along.tension)
    stiffness = stiffness + f.form(f.dphi, f.dphi, along.GJ)
    work = -f.form(f.phi, f.dpsi, along.moment)
    for end, sign in ((0, -1.0), (1, 1.0)):
        work[3 * end + 2, 3 * end + 1] += 0.5 * sign * end_moments[end]
    return mass, stiffness + work + work.T, bending


def hanging_string(tension: Callable[[Array], Array], length: float, mass_per_length: float) -> tuple[float, float]:
    """Return stiffness and mass of a string at its moving end.

    The string is condensed statically. Its shape n follows from (T n')' = 0 between the held end and the moving end.

    Parameters
    ----------
    tension : callable
        Distance from the moving end [m] to tension [N], for arrays.
    length : float
        Length of the string [m].
    mass_per_length : float
        Mass per length [kg/m].

    Returns
    -------
    (float, float)
        Lateral stiffness [N/m] and mass [kg].
    """
    xi, weight = legendre.leggauss(POINTS)
    s, weight = (xi + 1.0) * length / 2.0, weight * length / 2.0
    stiffness = 1.0 / float(weight @ (1.0 / tension(s)))
    shape = np.empty_like(s)
    for i, at in enumerate(s):  # 1 - (flexibility up to the station) / (flexibility of the string)
        inner = (xi + 1.0) * at / 2.0
        shape[i] = 1.0 - stiffness * float((weight / length * at) @ (1.0 / tension(inner)))
    return stiffness, float(mass_per_length * weight @ shape**2)
