"""Pendulums and carts, marched by the implicit midpoint rule.

The equations of motion are those of Lagrange in closed form. A hinge angle q counts from the hanging rest. With mass m,
centre c below the hinge, moment of inertia I about the centre, and length l:

- one rod: (I + m c^2) q'' + m g c sin q = f;
- two rods, with q_2 relative to the first [1]_: M_11 = J_1 + J_2 + 2 b cos q_2, M_12 = J_2 + b cos q_2, M_22 = J_2;
- a cart of mass m_0 at x with one rod: M_11 = m_0 + m, M_12 = m c cos q, M_22 = I + m c^2.

Here J_1 = I_1 + m_1 c_1^2 + m_2 l_1^2, J_2 = I_2 + m_2 c_2^2 and b = m_2 l_1 c_2.

The numbers of a joint are a table with one column a coordinate, see `NUMBERS`. Dry friction sticks exactly, by impulses as in
`vlab.proof.generator.servo_drive`.

References
----------
.. [1] H. Goldstein, C. Poole and J. Safko, *Classical Mechanics*, Addison-Wesley, 3rd ed., 2002, chapter 1.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from vlab.proof.generator.compilation import compiled
from vlab.proof.generator.impulses import inverse, rub, within
from vlab.signals import Array

NUMBERS = {
    "damping": 0.0,
    "inertia": 0.0,
    "push": 0.0,
    "spring": 0.0,
    "cubic": 0.0,
    "quintic": 0.0,
    "drift": 0.0,
    "drag": 0.0,
    "drag_power": 2.0,
    "dry": 0.0,
    "excess": 0.0,
    "speed": 1.0,
    "skew": 0.0,
    "loaded": 0.0,
    "smooth": 0.0,
    "smooth_speed": 1.0,
    "stop": 0.0,
    "gap": 0.0,
    "side": 0.0,
    "stop_power": 1.0,
    "sine": 0.0,
    "cosine": 0.0,
    "omega": 0.0,
    "fading": 0.0,
    "fading_time": 1.0,
    "cable": 0.0,
    "cable_yield": 1.0,
    "magnet": 0.0,
    "magnet_at": 0.0,
    "magnet_width": 1.0,
    "slope": 0.0,
    "slope_rate": 0.0,
    "slope_phase": 0.0,
}
"""NUMBERS: numbers of a joint with their values in an ideal one. Forces in N or N m, places in m or rad, times in s."""
_AT = {name: i for i, name in enumerate(NUMBERS)}
(_DAMP, _INERTIA, _PUSH, _SPRING, _CUBIC, _QUINTIC, _DRIFT, _DRAG, _POWER, _DRY, _EXCESS, _SPEED, _SKEW, _LOADED,
 _SMOOTH, _WIDTH, _STOP, _GAP, _SIDE, _HARD, _SINE, _COSINE, _OMEGA, _FADING, _FADED, _CABLE, _YIELD, _MAGNET, _MAGNET_AT,
 _MAGNET_WIDTH, _SLOPE, _SLOPING, _SLOPED) = range(len(NUMBERS))  # fmt: skip
_SINGLE, _DOUBLE, _ON_CART = range(3)
CODES = {"single": _SINGLE, "double": _DOUBLE, "cart": _ON_CART}
ROUNDS, CLOSED = 60, 1e-14
"""ROUNDS, CLOSED [-]: most fixed-point rounds of an implicit step, and relative change of the rates that ends them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Swinging:
    """Pendulum with its joints.

    Parameters
    ----------
    code : int
        Form of the equations, a value of `CODES`.
    bodies : (4, rods) array
        Mass [kg], centre [m], moment of inertia [kg m^2] and length [m] of each rod.
    rail : float
        Mass of the cart [kg]; zero without one.
    gravity : float
        Acceleration of gravity [m/s^2].
    gain : float
        Force of the motor over its command.
    joints : (numbers, n) array
        One row a number of `NUMBERS`, one column a coordinate.
    """

    code: int
    bodies: Array
    rail: float
    gravity: float
    gain: float
    joints: Array

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return int(self.joints.shape[1])

    def number(self, name: str) -> Array:
        """Return one number of all joints, (n,)."""
        return self.joints[_AT[name]]

    def with_numbers(self, coordinate: int, **numbers: float) -> "Swinging":
        """Return the pendulum with other numbers of one joint."""
        joints = self.joints.copy()
        for name, value in numbers.items():
            joints[_AT[name], coordinate] = value
        return replace(self, joints=joints)

    def with_payload(self, mass: float) -> "Swinging":
        """Return the pendulum with a point mass at its tip.

        Parameters
        ----------
        mass : float
            Mass [kg].

        Returns
        -------
        Swinging
            Pendulum with a heavier last rod.
        """
        own, centre, inertia, length = self.bodies[:, -1]
        whole = own + mass
        middle = (own * centre + mass * length) / whole
        about = inertia + own * (centre - middle) ** 2 + mass * (length - middle) ** 2
        bodies = self.bodies.copy()
        bodies[:, -1] = whole, middle, about, length
        return replace(self, bodies=bodies)

    def equations(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return mass matrix, bias forces and loads of the joints.

        Parameters
        ----------
        q, v : (n,) array
            Coordinates [m, rad] and rates.

        Returns
        -------
        ((n, n) array, (n,) array, (n,) array)
            Mass matrix, bias of gravity and inertia, and normal forces for friction that grows with load [N]. The loads
            leave out the acceleration of a hinge.
        """
        M, b, load = np.zeros((self.n, self.n)), np.zeros(self.n), np.zeros(self.n)
        _equations(self.code, self.bodies, self.rail, self.gravity, np.array(q, float), np.array(v, float), M, b, load)
        return M, b, load

    def energy(self, q: Array, v: Array) -> float:
        """Return kinetic and potential energy without springs of joints.

        Parameters
        ----------
        q, v : (n,) array
            Coordinates [m, rad] and rates.

        Returns
        -------
        float
            Energy [J].
        """
        m, c, _, length = self.bodies
        angles = np.cumsum(q[-len(m) :])
        hinges = np.concatenate([[0.0], -np.cumsum(length[:-1] * np.cos(angles[:-1]))])
        heights = hinges - c * np.cos(angles)
        return float(0.5 * v @ self.equations(q, v)[0] @ v + self.gravity * (m @ heights))

    def march(self, forces: Array, step: float, substeps: int, first: Array, begin: float = 0.0) -> Array:
        """Return the motion at the samples.

        Parameters
        ----------
        forces : (n_fine,) array
            Force of the motor before its gain, on the fine clock [N].
        step : float
            Fine step [s].
        substeps : int
            Fine steps per sample.
        first : (2, n) array
            Coordinates and rates at the beginning.
        begin : float
            Time of the beginning [s].

        Returns
        -------
        (n_samples, 2, n) array
            Coordinates and rates.
        """
        out = np.zeros((len(forces) // substeps, 2, self.n))
        given = np.ascontiguousarray(self.gain * forces)
        _march(self.code, self.bodies, self.rail, self.gravity, self.joints, first, given, step, substeps, begin, out)
        return out

    def march_coarsely(
        self, forces: Array, step: float, substeps: int, first: Array, *, is_fourth_order: bool
    ) -> Array:
        """Return the motion with ideal joints in the steps of a simulator.

        Steps are those of Runge and Kutta of fourth order, or of first order with implicit dampers [1]_.

        Parameters
        ----------
        forces : (n_steps,) array
            Force of the motor before its gain [N].
        step : float
            Step [s].
        substeps : int
            Steps per sample.
        first : (2, n) array
            Coordinates and rates at the beginning.
        is_fourth_order : bool
            Whether the steps are of fourth order.

        Returns
        -------
        (n_samples, 2, n) array
            Coordinates and rates.

        References
        ----------
        .. [1] E. Hairer, C. Lubich and G. Wanner, *Geometric Numerical Integration*, Springer, 2nd ed., 2006, I.1.2.
        """
        out = np.zeros((len(forces) // substeps, 2, self.n))
        given, damping = np.ascontiguousarray(self.gain * forces), self.number("damping").copy()
        march = _fourth if is_fourth_order else _first
        march(self.code, self.bodies, self.rail, self.gravity, damping, first, given, step, substeps, out)
        return out


def free(
    layout: Literal["single", "double", "cart"],
    *,
    bodies: Array,
    rail: float,
    gravity: float,
    gain: float,
    damping: Array,
) -> Swinging:
    """Return a pendulum with ideal joints.

    Parameters
    ----------
    layout : str
        Key of `CODES`.
    bodies : (4, rods) array
        See `Swinging`.
    rail, gravity, gain : float
        See `Swinging`.
    damping : (n,) array
        Damping of the joints [N s/m, N m s/rad].

    Returns
    -------
    Swinging
        Pendulum.
    """
    joints = np.repeat(np.array(list(NUMBERS.values()))[:, None], len(damping), axis=1)
    joints[_DAMP] = damping
    return Swinging(code=CODES[layout], bodies=bodies, rail=rail, gravity=gravity, gain=gain, joints=joints)


@compiled
def _equations(
    code: int, bodies: Array, rail: float, g: float, q: Array, v: Array, M: Array, b: Array, load: Array
) -> None:
    """Write mass matrix, bias forces and loads."""
    m, c, inertia = bodies[0, 0], bodies[1, 0], bodies[2, 0]
    if code == _SINGLE:
        M[0, 0] = inertia + m * c * c
        b[0] = m * g * c * np.sin(q[0])
        load[0] = abs(m * (g * np.cos(q[0]) + c * v[0] * v[0]))
    elif code == _DOUBLE:
        m2, c2, length = bodies[0, 1], bodies[1, 1], bodies[3, 0]
        outer, inner = inertia + m * c * c + m2 * length * length, bodies[2, 1] + m2 * c2 * c2
        beta, cos, sin, sum_rate = m2 * length * c2, np.cos(q[1]), np.sin(q[1]), v[0] + v[1]
        M[0, 0] = outer + inner + 2.0 * beta * cos
        M[0, 1] = M[1, 0] = inner + beta * cos
        M[1, 1] = inner
        lower = m2 * g * c2 * np.sin(q[0] + q[1])
        b[0] = -beta * sin * v[1] * (v[0] + sum_rate) + (m * c + m2 * length) * g * np.sin(q[0]) + lower
        b[1] = beta * sin * v[0] * v[0] + lower
        load[0] = abs((m + m2) * g * np.cos(q[0]) + (m * c + m2 * length) * v[0] * v[0])
        load[1] = abs(m2 * (g * np.cos(q[0] + q[1]) + c2 * sum_rate * sum_rate))
    else:
        cos, sin = np.cos(q[1]), np.sin(q[1])
        M[0, 0] = rail + m
        M[0, 1] = M[1, 0] = m * c * cos
        M[1, 1] = inertia + m * c * c
        b[0] = -m * c * sin * v[1] * v[1]
        b[1] = m * g * c * sin
        load[0] = abs((rail + m) * g + m * c * cos * v[1] * v[1])
        load[1] = abs(m * (g * cos + c * v[1] * v[1]))


@compiled
def _law(z: float, v: float, t: float, pull: float, d: Array) -> float:
    """Return the smooth force of a joint but for its damper.

    `pull` is the state of the cable.
    """
    f = d[_PUSH] - (d[_SPRING] + d[_DRIFT] * t) * z - (d[_CUBIC] + d[_QUINTIC] * z * z) * z * z * z
    if d[_DRAG] != 0.0 and v != 0.0:
        f -= d[_DRAG] * np.sign(v) * abs(v) ** d[_POWER]
    if d[_SMOOTH] != 0.0:
        f -= d[_SMOOTH] * np.tanh(v / d[_WIDTH])
    if d[_STOP] != 0.0:
        if d[_SIDE] != 0.0:
            f -= d[_SIDE] * d[_STOP] * max(d[_SIDE] * z - d[_GAP], 0.0) ** d[_HARD]
        else:
            f -= np.sign(z) * d[_STOP] * max(abs(z) - d[_GAP], 0.0) ** d[_HARD]
    if d[_OMEGA] != 0.0:
        f += d[_SINE] * np.sin(d[_OMEGA] * t) + d[_COSINE] * np.cos(d[_OMEGA] * t)
    if d[_CABLE] != 0.0:
        f -= d[_CABLE] * max(pull, 0.0)
    if d[_MAGNET] != 0.0:
        s = (z - d[_MAGNET_AT]) / d[_MAGNET_WIDTH]
        f -= d[_MAGNET] * s * np.exp(0.5 - 0.5 * s * s)
    if d[_SLOPE] != 0.0:
        f += d[_SLOPE] * np.sin(d[_SLOPING] * z + d[_SLOPED])
    return f


@compiled
def _level(v: float, t: float, load: float, d: Array) -> float:
    """Return the size of the dry friction of a joint."""
    level = d[_DRY] + d[_LOADED] * load
    if d[_EXCESS] > 0.0:
        level += d[_EXCESS] * np.exp(-((v / d[_SPEED]) ** 2))
    if d[_FADING] != 0.0:
        level *= max(1.0 + d[_FADING] * (np.exp(-max(t, 0.0) / d[_FADED]) - 1.0), 0.0)
    return level


@compiled
def _march(
    code: int,
    bodies: Array,
    rail: float,
    g: float,
    joints: Array,
    first: Array,
    forces: Array,
    h: float,
    substeps: int,
    begin: float,
    out: Array,
) -> None:
    """March in implicit midpoint steps."""
    n = joints.shape[1]
    x, v, end, middle, rate = first[0].copy(), first[1].copy(), np.zeros(n), np.zeros(n), np.zeros(n)
    M, W, b, load, r = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), np.zeros(n), np.zeros(n)
    most, less, impulse, old, change = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    pull, pulled = np.zeros(n), np.zeros(n)
    for step in range(len(forces)):
        if step % substeps == 0:
            out[step // substeps, 0], out[step // substeps, 1] = x, v
        t = begin + (step + 0.5) * h
        for i in range(n):
            end[i] = v[i] + change[i]
        for _ in range(ROUNDS):
            for i in range(n):
                old[i] = end[i]
                rate[i] = 0.5 * (v[i] + end[i])
                middle[i] = x[i] + 0.5 * h * rate[i]
            _equations(code, bodies, rail, g, middle, rate, M, b, load)
            for i in range(n):
                d = joints[:, i]
                if d[_CABLE] != 0.0:
                    way = h * rate[i] / d[_YIELD]
                    z = pull[i]
                    pulled[i] = z + way * (1.0 - (0.5 * np.sign(way * z) + 0.5) * z * z)
                force = _law(middle[i], rate[i], t, 0.5 * (pull[i] + pulled[i]), d)
                if i == 0 and code == _ON_CART:
                    force += forces[step]
                M[i, i] += d[_INERTIA] + 0.5 * h * d[_DAMP]  # the damper is implicit
                r[i] = force - b[i] - d[_DAMP] * v[i]
                level = h * _level(rate[i], t, load[i], d)
                most[i], less[i] = level * (1.0 + d[_SKEW]), level * (1.0 - d[_SKEW])
            inverse(M, n, W)
            for i in range(n):
                total = 0.0
                for k in range(n):
                    total += W[i, k] * r[k]
                end[i] = v[i] + h * total
            rub(end, most, less, W, impulse, n)
            worst = 0.0
            for i in range(n):
                worst = max(worst, abs(end[i] - old[i]) / (1.0 + abs(end[i])))
            if worst <= CLOSED:
                break
        for i in range(n):
            x[i] += 0.5 * h * (v[i] + end[i])
            change[i], v[i], pull[i] = end[i] - v[i], end[i], within(pulled[i], -1.0, 1.0)


@compiled
def _accelerations(
    code: int,
    bodies: Array,
    rail: float,
    g: float,
    damping: Array,
    q: Array,
    v: Array,
    force: float,
    implicit: float,
    out: Array,
) -> None:
    """Write the accelerations of ideal joints.

    `implicit` is the step of implicit dampers, or zero.
    """
    n = len(q)
    M, W, b, load = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), np.zeros(n)
    _equations(code, bodies, rail, g, q, v, M, b, load)
    for i in range(n):
        M[i, i] += implicit * damping[i]
        b[i] = -b[i] - damping[i] * v[i]
    if code == _ON_CART:
        b[0] += force
    inverse(M, n, W)
    for i in range(n):
        out[i] = 0.0
        for k in range(n):
            out[i] += W[i, k] * b[k]


@compiled
def _first(
    code: int,
    bodies: Array,
    rail: float,
    g: float,
    damping: Array,
    first: Array,
    forces: Array,
    h: float,
    substeps: int,
    out: Array,
) -> None:
    """March in semi-implicit steps of Euler."""
    q, v, a = first[0].copy(), first[1].copy(), np.zeros(len(damping))
    for step in range(len(forces)):
        if step % substeps == 0:
            out[step // substeps, 0], out[step // substeps, 1] = q, v
        _accelerations(code, bodies, rail, g, damping, q, v, forces[step], h, a)
        v = v + h * a
        q = q + h * v


@compiled
def _fourth(
    code: int,
    bodies: Array,
    rail: float,
    g: float,
    damping: Array,
    first: Array,
    forces: Array,
    h: float,
    substeps: int,
    out: Array,
) -> None:
    """March in steps of Runge and Kutta."""
    n = len(damping)
    q, v = first[0].copy(), first[1].copy()
    a1, a2, a3, a4 = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    for step in range(len(forces)):
        if step % substeps == 0:
            out[step // substeps, 0], out[step // substeps, 1] = q, v
        f = forces[step]
        _accelerations(code, bodies, rail, g, damping, q, v, f, 0.0, a1)
        v2 = v + 0.5 * h * a1
        _accelerations(code, bodies, rail, g, damping, q + 0.5 * h * v, v2, f, 0.0, a2)
        v3 = v + 0.5 * h * a2
        _accelerations(code, bodies, rail, g, damping, q + 0.5 * h * v2, v3, f, 0.0, a3)
        v4 = v + h * a3
        _accelerations(code, bodies, rail, g, damping, q + h * v3, v4, f, 0.0, a4)
        q = q + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
        v = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
