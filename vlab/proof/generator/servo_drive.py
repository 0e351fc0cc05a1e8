"""Arm on position servos, marched by an implicit midpoint rule with exact dry friction.

The numbers of a drive are a table with one column a joint, see `NUMBERS`. A drive gives

    f = clip(k_p (u - x) - k_v x', low, high)

at its angle x, which is that of the joint, or of a motor of its own behind an elastic train. The rates at the end of a step
h obey Coulomb's law as in time stepping with impulses [1]_; between its edges the scheme has second order.

References
----------
.. [1] J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, in *Nonsmooth Mechanics and
       Applications*, CISM 302, Springer, 1988, 1-82.
"""

from dataclasses import dataclass, replace

import numpy as np

from vlab.proof.generator.compilation import compiled
from vlab.proof.generator.impulses import inverse, rub, within
from vlab.proof.generator.rigid_body import Chain, masses, moments, place
from vlab.signals import Array

NUMBERS = {
    "gain": 0.0,
    "velocity_gain": 0.0,
    "low": -np.inf,
    "high": np.inf,
    "damping": 0.0,
    "armature": 0.0,
    "torque": 1.0,
    "dead_zone": 0.0,
    "soft_zone": 0.0,
    "soft_limit": np.inf,
    "dry": 0.0,
    "excess": 0.0,
    "speed": 1.0,
    "skew": 0.0,
    "loaded": 0.0,
    "smooth": 0.0,
    "smooth_speed": 1.0,
    "push": 0.0,
    "drag": 0.0,
    "has_train": 0.0,
    "gap": 0.0,
    "train": 0.0,
    "train_damper": 0.0,
    "motor_share": 0.0,
    "cog": 0.0,
    "cogs": 0.0,
    "cog_phase": 0.0,
    "integral": 0.0,
    "lag": 0.0,
    "sag": 0.0,
    "ripple": 0.0,
    "ripple_rate": 0.0,
    "ripple_phase": 0.0,
    "warm": 0.0,
    "warm_time": 1.0,
    "cable": 0.0,
    "cable_yield": 1.0,
    "coupled": 0.0,
}
"""NUMBERS: numbers of a drive with their values in an ideal one. Moments in N m, angles in rad, times in s."""
_AT = {name: i for i, name in enumerate(NUMBERS)}
(_KP, _KV, _LOW, _HIGH, _DAMP, _ARM, _TORQUE, _DEAD, _SOFT, _TANH, _DRY, _EXCESS, _SPEED, _SKEW, _LOADED, _SMOOTH, _WIDTH,
 _PUSH, _DRAG, _TRAIN, _GAP, _TK, _TC, _SHARE, _COG, _COGS, _PHASE, _KI, _LAG, _SAG, _RIPPLE, _RIPPLING, _RIPPLED, _WARM,
 _WARMING, _CABLE, _YIELD, _COUPLED) = range(len(NUMBERS))  # fmt: skip
SETTLE_S = 1.5
"""SETTLE_S [s]: time at the first command before the recording begins."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Machine:
    """Chain with its drives.

    Parameters
    ----------
    drives : (numbers, n) array
        One row a number of `NUMBERS`, one column a joint.
    """

    chain: Chain
    drives: Array

    def number(self, name: str) -> Array:
        """Return one number of all drives, (n,)."""
        return self.drives[_AT[name]]

    def with_numbers(self, joint: int, **numbers: float) -> "Machine":
        """Return the machine with other numbers of one drive."""
        drives = self.drives.copy()
        for name, value in numbers.items():
            drives[_AT[name], joint] = value
        return replace(self, drives=drives)

    def rest(self, command: Array) -> Array:
        """Return the angles at which ideal drives hold a command.

        Parameters
        ----------
        command : (n,) array
            Command [rad].

        Returns
        -------
        (n,) array
            Angles [rad], by fixed-point steps.
        """
        q, still = np.array(command, float), np.zeros(len(command))
        for _ in range(60):
            q = command - self.chain.bias(q, still) / self.number("gain")
        return q

    def march(self, commands: Array, step: float, substeps: int, first: Array | None = None) -> Array:
        """Return motion and drive moments at the samples.

        Parameters
        ----------
        commands : (n_fine, n) array
            Commands on the fine clock, as the loops of the drives receive them [rad].
        step : float
            Fine step [s].
        substeps : int
            Fine steps per sample.
        first : (n,) array, optional
            Angles at the beginning, at rest [rad]; `rest` under the first command by default.

        Returns
        -------
        (n_samples, 3, n) array
            Angles [rad], rates [rad/s] and drive moments [N m] before the command of the sample.
        """
        first = self.rest(commands[0]) if first is None else np.array(first, float)
        out = np.zeros((len(commands) // substeps, 3, self.chain.n))
        _march(first, np.ascontiguousarray(commands), step, substeps, *self.chain.arrays, self.drives, out)
        return out

    def march_coarsely(self, commands: Array, step: float, substeps: int, *, is_servo_implicit: bool) -> Array:
        """Return the motion of ideal drives in first-order steps of a simulator.

        The rates at the end of a step move the angles [1]_. Dampers of the joints are implicit.

        Parameters
        ----------
        commands : (n_steps, n) array
            Commands of the steps [rad].
        step : float
            Step [s].
        substeps : int
            Steps per sample.
        is_servo_implicit : bool
            Whether the velocity gains are implicit within the limits of force, too.

        Returns
        -------
        (n_samples, 2, n) array
            Angles [rad] and rates [rad/s].

        References
        ----------
        .. [1] E. Hairer, C. Lubich and G. Wanner, *Geometric Numerical Integration*, Springer, 2nd ed., 2006, I.1.2.
        """
        out = np.zeros((len(commands) // substeps, 2, self.chain.n))
        first, given = self.rest(commands[0]), np.ascontiguousarray(commands)
        _coarse(first, given, step, substeps, is_servo_implicit, *self.chain.arrays, self.drives, out)
        return out


def ideal(chain: Chain, **numbers: Array) -> Machine:
    """Return a machine with ideal drives of the given numbers."""
    drives = np.repeat(np.array(list(NUMBERS.values()))[:, None], chain.n, axis=1)
    for name, values in numbers.items():
        drives[_AT[name]] = values
    return Machine(chain=chain, drives=drives)


@compiled
def _error(e: float, d: Array) -> float:
    """Return the position error that a controller acts on."""
    e = e - within(e, -d[_DEAD], d[_DEAD])
    return e - d[_SOFT] * np.tanh(e / d[_SOFT]) if d[_SOFT] > 0.0 else e


@compiled
def _drive(u: float, x: float, rate: float, total: float, load: float, t: float, d: Array) -> float:
    """Return the moment of a drive.

    `total` is the integral of its error, `load` its last moment.
    """
    gain = d[_KP] / (1.0 + d[_SAG] * abs(load))
    f = within(gain * _error(u - x, d) + d[_KI] * total - d[_KV] * rate, d[_LOW], d[_HIGH])
    if d[_TANH] < np.inf:
        f = d[_TANH] * np.tanh(f / d[_TANH])
    return d[_TORQUE] * f * (1.0 + d[_RIPPLE] * np.sin(d[_RIPPLING] * t + d[_RIPPLED]))


@compiled
def _passed(s: float, rate: float, d: Array) -> tuple[float, float]:
    """Return the moment of a gear train and its slope by the rate."""
    beyond = s - within(s, -d[_GAP], d[_GAP])
    T = d[_TK] * beyond + d[_TC] * rate
    if d[_GAP] > 0.0 and T * beyond <= 0.0:  # within the play; and a tooth does not pull
        return 0.0, 0.0
    return T, d[_TC]


@compiled
def _march(
    first: Array,
    commands: Array,
    h: float,
    substeps: int,
    offset: Array,
    turn: Array,
    axis: Array,
    mass: Array,
    centre: Array,
    inertia: Array,
    gravity: Array,
    drives: Array,
    out: Array,
) -> None:
    """March from rest; the coordinates are the joints, then the motors with trains."""
    n = len(first)
    owner = np.concatenate((np.arange(n), np.flatnonzero(drives[_TRAIN] > 0.0)))
    size = len(owner)
    x, v, last = np.zeros(size), np.zeros(size), np.zeros(size)
    for i in range(size):
        x[i] = first[owner[i]]
    motor = np.arange(n)
    for i in range(n, size):
        motor[owner[i]] = i
    hidden = np.zeros((4, n))  # integral of the error, lagged moment, warmth, pull of the cable
    origins, axes, centres = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    inertias, M, b = np.zeros((n, 3, 3)), np.zeros((n, n)), np.zeros(n)
    A, W, r, impulse = np.zeros((size, size)), np.zeros((size, size)), np.zeros(size), np.zeros(n)
    most, less, middle, rate = np.zeros(n), np.zeros(n), np.zeros(size), np.zeros(size)
    load = np.zeros(n)
    for step in range(len(commands)):
        if step % substeps == 0:
            k, u = step // substeps, commands[max(step - 1, 0)]
            for i in range(n):
                d, m = drives[:, i], motor[i]
                out[k, 0, i], out[k, 1, i] = x[i], v[i]
                f = _drive(u[i], x[m], v[m], hidden[0, i], load[i], step * h, d)
                out[k, 2, i] = hidden[1, i] if d[_LAG] > 0.0 else f
        for i in range(size):
            middle[i] = x[i] + 0.5 * h * (v[i] + 0.25 * h * last[i])
            rate[i] = v[i] + 0.5 * h * last[i]
        place(middle[:n], offset, turn, axis, mass, centre, inertia, gravity, origins, axes, centres, inertias)
        masses(mass, origins, axes, centres, inertias, M)
        moments(rate[:n], mass, gravity, origins, axes, centres, inertias, b)
        A[:, :] = 0.0
        A[:n, :n] = M
        r[:] = 0.0
        r[:n] = -b
        t = (step + 0.5) * h
        for i in range(n):
            _load(i, motor[i], commands[step, i], middle, rate, v, h, t, drives[:, i], hidden, load, A, r)
        for i in range(n):
            _oppose(i, rate[i], h, drives[:, i], hidden, load, most, less)
            if drives[_COUPLED, i] != 0.0:
                r[i] += drives[_COUPLED, i] * load[(i + 1) % n if i + 1 < n else i - 1]
        inverse(A, size, W)
        for i in range(size):
            total = 0.0
            for k in range(size):
                total += W[i, k] * r[k]
            last[i] = v[i] + h * total  # the rates at the end, for now
        rub(last, most, less, W, impulse, n)
        for i in range(size):
            end = last[i]
            x[i] += 0.5 * h * (v[i] + end)
            last[i], v[i] = (end - v[i]) / h, end


@compiled
def _coarse(
    first: Array,
    commands: Array,
    h: float,
    substeps: int,
    is_servo_implicit: bool,
    offset: Array,
    turn: Array,
    axis: Array,
    mass: Array,
    centre: Array,
    inertia: Array,
    gravity: Array,
    drives: Array,
    out: Array,
) -> None:
    """March in semi-implicit steps of Euler."""
    n = len(first)
    q, v, r = first.copy(), np.zeros(n), np.zeros(n)
    origins, axes, centres = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    inertias, A, W, b = np.zeros((n, 3, 3)), np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    for step in range(len(commands)):
        if step % substeps == 0:
            out[step // substeps, 0], out[step // substeps, 1] = q, v
        place(q, offset, turn, axis, mass, centre, inertia, gravity, origins, axes, centres, inertias)
        masses(mass, origins, axes, centres, inertias, A)
        moments(v, mass, gravity, origins, axes, centres, inertias, b)
        for i in range(n):
            d = drives[:, i]
            f = d[_KP] * (commands[step, i] - q[i]) - d[_KV] * v[i]
            is_free = d[_LOW] < f < d[_HIGH]
            r[i] = within(f, d[_LOW], d[_HIGH]) - d[_DAMP] * v[i] - b[i]
            A[i, i] += d[_ARM] + h * d[_DAMP] + h * d[_KV] * (is_servo_implicit and is_free)
        inverse(A, n, W)
        v = v + h * (W @ r)
        q = q + h * v


@compiled
def _load(
    i: int,
    m: int,
    u: float,
    x: Array,
    rate: Array,
    v: Array,
    h: float,
    t: float,
    d: Array,
    hidden: Array,
    load: Array,
    A: Array,
    r: Array,
) -> None:
    """Add drive, dampers, train and disturbances of a joint to matrix and moments."""
    f = _drive(u, x[m], rate[m], hidden[0, i], load[i], t, d)
    hidden[0, i] += h * (u - x[m])
    if d[_LAG] > 0.0:
        left = np.exp(-h / d[_LAG])
        mean = f + (hidden[1, i] - f) * (1.0 - left) * d[_LAG] / h
        hidden[1, i] = f + (hidden[1, i] - f) * left
        f = mean
    elif _drive(u, x[m], rate[m] + 1e-9, hidden[0, i], load[i], t, d) != f:  # implicit within the limits
        slope = d[_TORQUE] * d[_KV]
        A[m, m] += 0.5 * h * slope
        r[m] += slope * (rate[m] - v[m])
    load[i] = f
    A[m, m] += d[_ARM]
    share = d[_SHARE] if m != i else 0.0
    A[i, i] += 0.5 * h * (1.0 - share) * d[_DAMP]
    r[i] -= (1.0 - share) * d[_DAMP] * v[i]
    r[m] += f + d[_COG] * np.sin(d[_COGS] * x[m] + d[_PHASE])
    r[i] += d[_PUSH] - d[_DRAG] * rate[i] * abs(rate[i])
    if d[_SMOOTH] > 0.0:
        part = np.tanh(v[i] / d[_WIDTH])
        A[i, i] += 0.5 * h * d[_SMOOTH] / d[_WIDTH] * (1.0 - part * part)
        r[i] -= d[_SMOOTH] * part
    if d[_CABLE] > 0.0:
        z, way = hidden[3, i], h * rate[i] / d[_YIELD]
        z += way * (1.0 - (0.5 * np.sign(way * z) + 0.5) * z * z)
        hidden[3, i] = z
        r[i] -= d[_CABLE] * max(z, 0.0)
    if m != i:
        A[m, m] += 0.5 * h * share * d[_DAMP]
        r[m] -= share * d[_DAMP] * v[m]
        T, c = _passed(x[m] - x[i], rate[m] - rate[i], d)
        T -= c * (rate[m] - rate[i] - v[m] + v[i])  # the damper at the beginning, the rest is implicit
        slope = 0.5 * h * c
        A[m, m] += slope
        A[i, i] += slope
        A[m, i] -= slope
        A[i, m] -= slope
        r[m] -= T
        r[i] += T


@compiled
def _oppose(i: int, rate: float, h: float, d: Array, hidden: Array, load: Array, most: Array, less: Array) -> None:
    """Write the largest impulses of dry friction against and along a joint."""
    level = d[_DRY] + d[_LOADED] * abs(load[i])
    if d[_EXCESS] > 0.0:
        level += d[_EXCESS] * np.exp(-((rate / d[_SPEED]) ** 2))
    if d[_WARM] != 0.0:
        hidden[2, i] += h / d[_WARMING]
        level *= max(1.0 + d[_WARM] * (np.exp(-hidden[2, i]) - 1.0), 0.0)
    most[i] = h * level * (1.0 + d[_SKEW])
    less[i] = h * level * (1.0 - d[_SKEW])
