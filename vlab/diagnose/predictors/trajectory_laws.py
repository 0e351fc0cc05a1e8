"""Port effects in the integration along a motion."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from vlab.diagnose.parameters.terms import Term
from vlab.physics.effect import LinearPortEffect, PortEffect, Step
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Path:
    """Coordinates of a location along the motion.

    Parameters
    ----------
    rows : (steps + 1, k, n, n_windows, nv) array
        Jacobian rows of the k coordinates.
    z, v : (steps + 1, k, n, n_windows) array
        Coordinates from rest and their rates along the model's prediction; the defect bridges to the next sample.
    h : (n, n_windows) array
        Length of a step [s].
    G : (n, n_windows, 2 nv, nv) array
        Effect of forces held over a step.
    weight : (k,) array
        Gravity along the coordinates [m/s^2], where added mass has weight; otherwise 0.
    even : float or None
        Common length of all steps [s].
    """

    rows: Array
    z: Array
    v: Array
    h: Array
    G: Array
    weight: Array
    even: float | None

    @property
    def steps(self) -> int:
        """Steps of a sample interval."""
        return len(self.z) - 1


def path_of(
    rows: Array,
    z: Array,
    v: Array,
    defect: Array,
    h: Array,
    G: Array,
    weight: Array,
    steps: int,
    even: float | None = None,
) -> Path:
    """Return a location's path by cubic interpolation between samples.

    Parameters
    ----------
    rows : (k, n, n_windows, nv) array
        Jacobian rows at the samples.
    z, v : (k, n, n_windows) array
        Coordinates and rates at the samples.
    defect : (n, n_windows, 2 nv) array
        Motion at the next sample minus the model's prediction.
    h : (n, n_windows) array
        Sample intervals [s].
    G : (n, n_windows, 2 nv, nv) array
        Effect of forces held over a step.
    weight : (k,) array
        Gravity along the coordinates [m/s^2].
    steps : int
        Steps per sample interval.
    even : float or None
        Common length of all sample intervals [s].

    Returns
    -------
    Path
        Path.
    """
    m = rows.shape[-1]
    later = np.minimum(np.arange(1, rows.shape[1] + 1), rows.shape[1] - 1)
    after = rows[:, later]
    z1 = z[:, later] - np.einsum("lkwn,kwn->lkw", after, defect[..., :m])
    v1 = v[:, later] - np.einsum("lkwn,kwn->lkw", after, defect[..., m:])
    at_rows, at_z, at_v = [], [], []
    for j in range(steps + 1):
        s = j / steps
        at_rows.append(rows + s * (after - rows))
        at_z.append(
            (1 + 2 * s) * (1 - s) ** 2 * z
            + s * (1 - s) ** 2 * h * v
            + s * s * (3 - 2 * s) * z1
            - s * s * (1 - s) * h * v1
        )
        slope = 6 * s * (1 - s) * (z1 - z) / h
        at_v.append(slope + (1 - s) * (1 - 3 * s) * v + s * (3 * s - 2) * v1)
    even = None if even is None else even / steps
    return Path(rows=np.array(at_rows), z=np.array(at_z), v=np.array(at_v), h=h / steps, G=G, weight=weight, even=even)


class Law:
    """Port effect during integration, for all parameter sets.

    Parameters
    ----------
    term : Term
        Effect and location.
    own : mapping of str to (n_sets,) array
        Parameter values, and numbers that the law takes beside its parameters.
    path : Path
        Motion of the location.
    t : (n, n_windows) array
        Times of the samples [s].
    command : (n, n_windows) array or None
        Command of the actuator along the port.
    memory : list or None
        Memory at the windows' starts.
    efforts : (p, nv) array or None
        Readings per generalised force of the actuators; none by default.
    """

    def __init__(
        self,
        term: Term,
        own: Mapping[str, Array],
        path: Path,
        t: Array,
        command: Array | None,
        memory: Any,
        efforts: Array | None = None,
    ) -> None:
        self.effect, self.path, self.t, self.command, self.memory = term.effect, path, t, command, memory
        self.p = {name: np.asarray(value)[:, None] for name, value in own.items()}
        self.numbers = tuple(name for name in own if all(name != p.name for p in term.effect.parameters))
        self.is_linear = term.effect.is_linear
        self.is_last = term.effect.traits.is_dry_friction  # sticking balances all other forces
        self.is_single = path.rows.shape[1] == 1
        m = path.rows.shape[-1]
        middle = 0.5 * (path.rows[0] + path.rows[-1])
        into = np.einsum("kwan,lkwn->lkwa", path.G, middle, optimize=True)
        self.into = into
        efforts = np.zeros((0, middle.shape[-1])) if efforts is None else efforts
        readings = np.einsum("lkwn,pn->lkwp", middle, efforts if term.effect.acts_in_drive else 0.0 * efforts)
        self.seen = np.concatenate([middle, readings], axis=-1)
        """Generalised forces and direct readings (k, n, n_windows, nv + p) of unit forces."""
        self.gain = np.einsum("lkwn,ikwn->kwli", path.rows[-1], into[..., m:], optimize=True)
        self.reach = np.einsum("lkwn,ikwn->kwli", path.rows[-1], into[..., :m], optimize=True)
        self.dof = _single_joint(path.rows[0, 0]) if self.is_single else None
        if isinstance(term.effect, LinearPortEffect):
            n_sets = len(next(iter(own.values())))
            self.impedance = [
                np.broadcast_to(np.asarray(x, dtype=float), (n_sets,))[:, None]
                for x in term.effect.impedance(own, term.place.stiffness)
            ]

    def push(self, k: int, j: int, x: Array, free: Array) -> Array:
        """Apply a step's force to the final state.

        Parameters
        ----------
        k, j : int
            Sample interval, and step in the interval.
        x, free : (n_sets, n_windows, 2 nv) array
            Deviations at the step's start, and at its end without this force.

        Returns
        -------
        (n_sets, n_windows, nv + p) array
            Generalised force and direct readings.
        """
        if not self.is_single:
            force = self._impeded(k, j, x, free)
            free += np.einsum("lwa,swl->swa", self.into[:, k], force)
            return np.einsum("lwn,swl->swn", self.seen[:, k], force)
        scalar = self._force(k, j, x, free)[..., None]
        free += scalar * self.into[0, k]
        return np.asarray(scalar * self.seen[0, k])

    def _force(self, k: int, j: int, x: Array, free: Array) -> Array:
        path, m = self.path, x.shape[-1] // 2
        h, gain, reach = path.h[k], self.gain[k, :, 0, 0], self.reach[k, :, 0, 0]
        if self.dof is not None:
            q0, q1, w0, w1 = (part[..., i] for i in (self.dof, self.dof + m) for part in (x, free))
        else:
            row, after = path.rows[j, 0, k], path.rows[j + 1, 0, k]
            q0, q1 = (x[..., :m] * row).sum(axis=-1), (free[..., :m] * after).sum(axis=-1)
            w0, w1 = (x[..., m:] * row).sum(axis=-1), (free[..., m:] * after).sum(axis=-1)
        z0, z1 = path.z[j, 0, k] + q0, path.z[j + 1, 0, k] + q1
        v0, v1 = path.v[j, 0, k] + w0, path.v[j + 1, 0, k] + w1
        z, v = 0.5 * (z0 + z1) - h * (v1 - v0) / 12.0, 0.5 * (v0 + v1)  # means over the step
        if self.is_linear:
            mass, damping, stiffness = self.impedance
            force = -mass * ((v1 - v0) / h - path.weight[0]) - damping * v - stiffness * z
            shared = (mass / h + 0.5 * damping) * gain + stiffness * (reach / 2.0 - h * gain / 12.0)
            return np.asarray(force / (1.0 + shared))
        command = 0.0 if self.command is None else self.command[k]
        now = Step(h=h, t=self.t[k] + (j + 0.5) * h, mobility=gain, free_velocity=v1, command=command)
        assert isinstance(self.effect, PortEffect)
        if self.memory is None and not self.is_last:  # second evaluation, since stiff stops change their own motion
            force, _ = self.effect.force(z, v, self.p, now, None)
            z, v = z + force * (reach / 2.0 - h * gain / 12.0), v + 0.5 * gain * force
        force, self.memory = self.effect.force(z, v, self.p, now, self.memory)
        return np.asarray(force)

    def _impeded(self, k: int, j: int, x: Array, free: Array) -> Array:
        """Return impedance forces (n_sets, n_windows, k) on several rows."""
        path, m = self.path, x.shape[-1] // 2
        h, before, after = path.h[k], path.rows[j, :, k], path.rows[j + 1, :, k]
        v0 = path.v[j, :, k, None] + np.einsum("lwn,swn->lsw", before, x[..., m:])
        v1 = path.v[j + 1, :, k, None] + np.einsum("lwn,swn->lsw", after, free[..., m:])
        z0 = path.z[j, :, k, None] + np.einsum("lwn,swn->lsw", before, x[..., :m])
        z1 = path.z[j + 1, :, k, None] + np.einsum("lwn,swn->lsw", after, free[..., :m])
        mass, damping, stiffness = self.impedance
        force = -mass * ((v1 - v0) / h - path.weight[:, None, None])
        force = force - 0.5 * damping * (v0 + v1) - 0.5 * stiffness * (z0 + z1)
        share = mass / h + 0.5 * damping
        system = np.eye(len(before)) + share[..., None, None] * self.gain[k]
        return np.asarray(np.linalg.solve(system, np.moveaxis(force, 0, -1)[..., None])[..., 0])


def _single_joint(rows: Array) -> int | None:
    """Return the single coordinate of constant rows, or None."""
    used = np.flatnonzero(np.abs(rows).max(axis=(0, 1)))
    full = rows[np.abs(rows).max(axis=2) > 0]
    return int(used[0]) if used.size == 1 and np.all(full[:, used[0]] == 1.0) else None
