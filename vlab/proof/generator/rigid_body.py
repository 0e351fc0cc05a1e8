"""Equations of motion of a serial chain of hinge joints.

Methods: recursive Newton-Euler and composite rigid bodies.

    M(q) q'' + b(q, q') = tau

All vectors are in the axes of the base. The bias b is the recursion of Newton and Euler without joint accelerations [1]_
(Table 5.1 in link axes). Column j of M is the momentum of the composite body beyond joint j under a unit rate of that joint
[2]_.

References
----------
.. [1] R. Featherstone, *Rigid Body Dynamics Algorithms*, Springer, 2008, chapters 5 and 6.
.. [2] M. W. Walker and D. E. Orin, Efficient dynamic computer simulation of robotic mechanisms, J. Dyn. Syst. Meas.
       Control 104 (1982) 205-211, method 3.
"""

from dataclasses import dataclass

import numpy as np

from vlab.proof.generator.compilation import compiled
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Bodies in a row, each on a turning joint of the one before.

    Parameters
    ----------
    offset : (n, 3) array
        Origin of a body in the axes of the body before [m]; the joint passes through it.
    turn : (n, 3, 3) array
        Axes of a body in those of the body before, at a joint angle of zero.
    axis : (n, 3) array
        Unit axis of the joint in the axes of its body.
    mass : (n,) array
        Masses [kg].
    centre : (n, 3) array
        Centres of mass in the axes of the body [m].
    inertia : (n, 3, 3) array
        Moments of inertia about the centre, in the axes of the body [kg m^2].
    gravity : (3,) array
        Acceleration of free fall [m/s^2].
    """

    offset: Array
    turn: Array
    axis: Array
    mass: Array
    centre: Array
    inertia: Array
    gravity: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.mass)

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Array, Array, Array]:
        """All arrays in the order of the compiled functions."""
        return self.offset, self.turn, self.axis, self.mass, self.centre, self.inertia, self.gravity

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix.

        Parameters
        ----------
        q : (n,) array
            Angles [rad].

        Returns
        -------
        (n, n) array
            Matrix [kg m^2].
        """
        return self._equations(q, np.zeros(self.n))[0]

    def bias(self, q: Array, v: Array) -> Array:
        """Return gravity and velocity moments.

        Parameters
        ----------
        q, v : (n,) array
            Angles [rad] and rates [rad/s].

        Returns
        -------
        (n,) array
            Moments [N m].
        """
        return self._equations(q, v)[1]

    def energy(self, q: Array, v: Array) -> float:
        """Return kinetic and potential energy.

        Parameters
        ----------
        q, v : (n,) array
            Angles [rad] and rates [rad/s].

        Returns
        -------
        float
            Energy [J].
        """
        work = _Work(self.n)
        place(np.asarray(q, float), *self.arrays, *work.places)
        height = -float(self.mass @ (work.centre @ self.gravity))
        return 0.5 * float(v @ self.mass_matrix(q) @ v) + height

    def _equations(self, q: Array, v: Array) -> tuple[Array, Array]:
        work = _Work(self.n)
        place(np.asarray(q, float), *self.arrays, *work.places)
        M, b = np.zeros((self.n, self.n)), np.zeros(self.n)
        masses(self.mass, *work.places, M)
        moments(np.asarray(v, float), self.mass, self.gravity, *work.places, b)
        return M, b


class _Work:
    """Room for origins, axes, centres and moments of inertia in base axes."""

    def __init__(self, n: int) -> None:
        self.origin, self.axis, self.centre = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
        self.inertia = np.zeros((n, 3, 3))

    @property
    def places(self) -> tuple[Array, Array, Array, Array]:
        """All of them."""
        return self.origin, self.axis, self.centre, self.inertia


@compiled
def rotation(axis: Array, angle: float, out: Array) -> None:
    """Write the rotation about a unit axis: Rodrigues' formula."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    k = 1.0 - c
    out[0, 0], out[0, 1], out[0, 2] = c + k * x * x, k * x * y - s * z, k * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = k * x * y + s * z, c + k * y * y, k * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = k * x * z - s * y, k * y * z + s * x, c + k * z * z


@compiled
def _product(A: Array, B: Array, out: Array) -> None:
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@compiled
def place(
    q: Array,
    offset: Array,
    turn: Array,
    axis: Array,
    mass: Array,
    centre: Array,
    inertia: Array,
    gravity: Array,
    origins: Array,
    axes: Array,
    centres: Array,
    inertias: Array,
) -> None:
    """Write origins, joint axes, centres and moments of inertia in base axes."""
    R, S, T = np.eye(3), np.zeros((3, 3)), np.zeros((3, 3))
    x, y, z = 0.0, 0.0, 0.0
    for i in range(len(q)):
        o = offset[i]
        x += R[0, 0] * o[0] + R[0, 1] * o[1] + R[0, 2] * o[2]
        y += R[1, 0] * o[0] + R[1, 1] * o[1] + R[1, 2] * o[2]
        z += R[2, 0] * o[0] + R[2, 1] * o[1] + R[2, 2] * o[2]
        _product(R, turn[i], S)
        rotation(axis[i], q[i], T)
        _product(S, T, R)
        origins[i, 0], origins[i, 1], origins[i, 2] = x, y, z
        for k in range(3):
            axes[i, k] = R[k, 0] * axis[i, 0] + R[k, 1] * axis[i, 1] + R[k, 2] * axis[i, 2]
            away = R[k, 0] * centre[i, 0] + R[k, 1] * centre[i, 1] + R[k, 2] * centre[i, 2]
            centres[i, k] = origins[i, k] + away
        _product(R, inertia[i], S)
        for k in range(3):
            for j in range(3):
                inertias[i, k, j] = S[k, 0] * R[j, 0] + S[k, 1] * R[j, 1] + S[k, 2] * R[j, 2]


@compiled
def _add_cross(a: Array, b: Array, by: float, out: Array) -> None:
    out[0] += by * (a[1] * b[2] - a[2] * b[1])
    out[1] += by * (a[2] * b[0] - a[0] * b[2])
    out[2] += by * (a[0] * b[1] - a[1] * b[0])


@compiled
def _times(A: Array, b: Array, out: Array) -> None:
    for k in range(3):
        out[k] = A[k, 0] * b[0] + A[k, 1] * b[1] + A[k, 2] * b[2]


@compiled
def masses(mass: Array, origins: Array, axes: Array, centres: Array, inertias: Array, M: Array) -> None:
    """Write the mass matrix by composite rigid bodies."""
    n = len(mass)
    whole, middle, I = 0.0, np.zeros(3), np.zeros((3, 3))
    arm, p, turn = np.zeros(3), np.zeros(3), np.zeros(3)
    for j in range(n - 1, -1, -1):
        both = whole + mass[j]
        for k in range(3):
            arm[k] = centres[j, k] - middle[k]
        share = whole * mass[j] / both
        square = arm[0] * arm[0] + arm[1] * arm[1] + arm[2] * arm[2]
        for k in range(3):
            for i in range(3):
                I[k, i] += inertias[j, k, i] - share * arm[k] * arm[i]
            I[k, k] += share * square
        for k in range(3):
            middle[k] += mass[j] / both * arm[k]
        whole = both
        for k in range(3):
            arm[k], p[k] = middle[k] - origins[j, k], 0.0
        _add_cross(axes[j], arm, whole, p)  # momentum under a unit rate
        for i in range(j + 1):
            _times(I, axes[j], turn)
            for k in range(3):
                arm[k] = middle[k] - origins[i, k]
            _add_cross(arm, p, 1.0, turn)
            M[i, j] = axes[i, 0] * turn[0] + axes[i, 1] * turn[1] + axes[i, 2] * turn[2]
            M[j, i] = M[i, j]


@compiled
def moments(
    v: Array, mass: Array, gravity: Array, origins: Array, axes: Array, centres: Array, inertias: Array, out: Array
) -> None:
    """Write the moments of gravity and rates by Newton and Euler's recursion."""
    n = len(v)
    rate, gain, lift = np.zeros(3), np.zeros(3), -gravity
    force, moment = np.zeros((n, 3)), np.zeros((n, 3))
    arm, cross, spin, before = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for i in range(n):
        for k in range(3):  # acceleration of the joint, a point of the body before
            arm[k] = origins[i, k] - before[k]
            cross[k] = 0.0
        _add_cross(rate, arm, 1.0, cross)
        _add_cross(gain, arm, 1.0, lift)
        _add_cross(rate, cross, 1.0, lift)
        _add_cross(rate, axes[i], v[i], gain)
        for k in range(3):
            rate[k] += v[i] * axes[i, k]
            before[k] = origins[i, k]
            arm[k] = centres[i, k] - origins[i, k]
            cross[k] = 0.0
        _add_cross(rate, arm, 1.0, cross)
        for k in range(3):
            force[i, k] = mass[i] * lift[k]
        _add_cross(gain, arm, mass[i], force[i])
        _add_cross(rate, cross, mass[i], force[i])
        _times(inertias[i], gain, moment[i])
        _times(inertias[i], rate, spin)
        _add_cross(rate, spin, 1.0, moment[i])
    total, push = np.zeros(3), np.zeros(3)  # about the joint, and force, of all bodies from the joint on
    for i in range(n - 1, -1, -1):
        if i < n - 1:
            for k in range(3):
                arm[k] = origins[i + 1, k] - origins[i, k]
            _add_cross(arm, push, 1.0, total)
        for k in range(3):
            arm[k] = centres[i, k] - origins[i, k]
            push[k] += force[i, k]
            total[k] += moment[i, k]
        _add_cross(arm, force[i], 1.0, total)
        out[i] = axes[i, 0] * total[0] + axes[i, 1] * total[1] + axes[i, 2] * total[2]
