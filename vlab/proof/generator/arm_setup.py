"""Arm with drives, clock and log; true readings and sizes of signals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlab.errors import Diverged
from vlab.proof.generator.arm_commands import WAY, received
from vlab.proof.generator.arm_models import Arm, built
from vlab.proof.generator.hidden import Hidden, Kind, Scale
from vlab.proof.generator.servo_drive import SETTLE_S, Machine
from vlab.signals import Array, rms

QUANTITIES = ("angle", "rate", "effort")
"""QUANTITIES: rows of a march, in this order."""
WILD = 50.0
"""WILD [rad]: angle beyond which a march counts as diverged."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ServoArm:
    """Arm on servos with the clock of its log.

    Parameters
    ----------
    ways : mapping of str to (n,) array
        Numbers of the way of the commands, see `vlab.proof.generator.arm_commands.WAY`.
    logged : tuple of str
        Logged ones of `QUANTITIES`.
    """

    arm: Arm
    machine: Machine
    ways: Mapping[str, Array]
    rate_hz: float
    substeps: int
    logged: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.machine.chain.n

    def joint(self, place: str) -> int:
        """Return the index of the joint of a place."""
        joints = [link.joint for link in self.arm.links]
        return joints.index(place.partition(":")[2].removesuffix("_servo"))

    def coordinate(self, place: str) -> int:
        """Return the joint of a place, the last one for tip and chain."""
        return self.n - 1 if place in ("chain", "site:tip") else self.joint(place)

    def places(self, kind: Kind) -> list[str]:
        """Return the possible places of a kind.

        Parameters
        ----------
        kind : Kind
            Kind of hidden effect.

        Returns
        -------
        list of str
            Names of the places.
        """
        return {
            "servo": [f"actuator:{servo}" for servo in self.arm.servos],
            "all servos": ["chain"],
            "joint": [f"joint:{link.joint}" for link in self.arm.links],
            "all joints": [f"joint:{self.arm.links[0].joint}"],
            "tip": ["site:tip"],
        }[kind.on]

    def stepped(self, substeps: int) -> "ServoArm":
        """Return the arm with another number of steps per sample."""
        return replace(self, substeps=substeps)

    def rebuilt(self, factors: Mapping[str, float]) -> "ServoArm":
        """Return the arm with other log-factors on its parameters."""
        return replace(self, machine=built(self.arm, factors))

    def scales(self, commands: Array) -> tuple[Scale, ...]:
        """Return the signal sizes of all joints, see `scales_of`."""
        return scales_of(self, commands)

    def scale_at(self, place: str, scales: tuple[Any, ...]) -> Scale:
        """Return the signal sizes at a place, with those of all joints."""
        return replace(scales[self.coordinate(place)], each=scales)

    def alike(self, x: Hidden) -> dict[str, Any]:
        """Return other names of an effect's place, and places near.

        Parameters
        ----------
        x : Hidden
            Hidden effect.

        Returns
        -------
        dict
            Entries of the truth: ``places_alike``, ``places_near`` and ``at_actuator``.
        """
        joints = [link.joint for link in self.arm.links]
        everywhere = [f"joint:{name}" for name in joints] + [f"actuator:{name}" for name in self.arm.servos]
        alike: list[str] = []
        near: list[str] = []
        if x.place == "chain" or x.kind.on == "all joints":
            alike = everywhere
        elif x.place == "site:tip":
            alike = [f"site:tip{axis}" for axis in (".x", ".y", ".z")] + [f"body:{self.arm.links[-1].name}"]
            near = [f"joint:{joints[-1]}", f"body:{self.arm.links[-2].name}"]
        else:
            name = x.place.partition(":")[2].removesuffix("_servo")
            at = joints.index(name)
            alike = [f"joint:{name}", f"actuator:{name}_servo", f"body:{self.arm.links[at].name}"]
            beside = [j for j in (at - 1, at + 1) if 0 <= j < len(joints)]
            near = [p for j in beside for p in (f"joint:{joints[j]}", f"actuator:{self.arm.servos[j]}")]
        return {"places_alike": alike, "places_near": near, "at_actuator": True}

    def with_numbers(self, place: str, **numbers: float) -> "ServoArm":
        """Return the arm with other numbers of one drive."""
        return replace(self, machine=self.machine.with_numbers(self.joint(place), **numbers))

    def with_way(self, place: str, **numbers: float) -> "ServoArm":
        """Return the arm with another way of the commands; place ``chain`` is all drives."""
        ways = {name: values.copy() for name, values in self.ways.items()}
        for name, value in numbers.items():
            ways[name][slice(None) if place == "chain" else self.joint(place)] = value
        return replace(self, ways=ways)

    def march(self, commands: Array, hidden: Sequence[Hidden] = ()) -> Array:
        """Return angles, rates and drive moments in one recording.

        Parameters
        ----------
        commands : (n_samples, n) array
            Recorded commands [rad].
        hidden : sequence of Hidden
            Hidden effects.

        Returns
        -------
        (n_samples, 3, n) array
            Values before the command of the sample.

        Raises
        ------
        Diverged
            The arm ran away.
        """
        arm = self
        for x in hidden:
            change = x.action.machine
            assert change is not None
            arm = change(arm, x.place)
        step, before = 1.0 / (self.rate_hz * self.substeps), round(SETTLE_S * self.rate_hz)
        fine = received(commands, arm.ways, step=step, substeps=self.substeps, before=before)
        out = arm.machine.march(fine, step, self.substeps)[before:]
        if not np.all(np.isfinite(out)) or np.abs(out[:, 0]).max() > WILD:
            raise Diverged("the arm ran away")
        return out

    def run(self, commands: Array, hidden: Sequence[Hidden] = ()) -> Array:
        """Return the logged readings without noise.

        Parameters
        ----------
        commands : (n_samples, n, runs) array
            Recorded commands [rad].
        hidden : sequence of Hidden
            Hidden effects.

        Returns
        -------
        (n_samples, channels, runs) array
            Readings: all joints of one quantity after the other.
        """
        rows = [QUANTITIES.index(name) for name in self.logged]
        marched = [self.march(commands[:, :, i], hidden) for i in range(commands.shape[2])]
        return np.stack([x[:, rows].reshape(len(x), -1) for x in marched], axis=-1)

    def nominal_readings(self, commands: Array, timestep: float, *, is_servo_implicit: bool) -> Array:
        """Return the readings that the nominal model's own step gives of this arm.

        Parameters
        ----------
        commands : (n_samples, n, runs) array
            Recorded commands [rad].
        timestep : float
            Step of the nominal model [s]; whole steps fit into a sample.
        is_servo_implicit : bool
            See `vlab.proof.generator.servo_drive.Machine.march_coarsely`.

        Returns
        -------
        (n_samples, channels, runs) array
            Readings; the moments of drives are those of `run`.
        """
        substeps = int(np.ceil(1.0 / (self.rate_hz * timestep) - 1e-9))
        before = round(SETTLE_S * self.rate_hz)
        out = self.run(commands)
        rows = [k for k, name in enumerate(self.logged) if name != "effort"]
        for i in range(commands.shape[2]):
            held = np.concatenate([np.repeat(commands[:1, :, i], before, axis=0), commands[:, :, i]])
            fine = np.repeat(held, substeps, axis=0)
            step = 1.0 / (self.rate_hz * substeps)
            marched = self.machine.march_coarsely(fine, step, substeps, is_servo_implicit=is_servo_implicit)[before:]
            for k in rows:
                out[:, k * self.n : (k + 1) * self.n, i] = marched[:, QUANTITIES.index(self.logged[k])]
        return out


def direct(n: int) -> dict[str, Array]:
    """Return the numbers of an ideal way of the commands of n drives."""
    return {name: np.full(n, value) for name, value in WAY.items()}


@dataclass(frozen=True, kw_only=True)
class ServoScale(Scale):
    """Signal sizes at a joint in the fit recordings, without hidden effects.

    Of the fields of `Scale`, `z` is the rms travel, `v` and `slope` are the rms and the largest rate of the joint. `k` is
    the position gain, `m` the inertia with the armature.

    Parameters
    ----------
    moment, most_moment : float
        Rms and largest moment of the drive [N m].
    limit : float
        Force limit of the drive [N m].
    error : float
        Rms error of the position [rad].
    brake : float
        Velocity gain and damping together [N m s/rad].
    motor : float
        Armature [kg m^2].
    payload : float
        Mass of a usual payload [kg].
    each : tuple of ServoScale
        Sizes at all joints, for an effect in all of them.
    """

    moment: float = 0.0
    most_moment: float = 0.0
    limit: float = 0.0
    error: float = 0.0
    brake: float = 0.0
    motor: float = 0.0
    payload: float = 0.0
    each: tuple["ServoScale", ...] = ()


def scales_of(setup: ServoArm, commands: Array) -> tuple[ServoScale, ...]:
    """Return the signal sizes of all joints.

    Parameters
    ----------
    setup : ServoArm
        Arm without hidden effects.
    commands : (n_samples, n, runs) array
        Commands of the fit recordings [rad].

    Returns
    -------
    tuple of ServoScale
        Sizes by joint, over all recordings.
    """
    marched = np.concatenate([setup.march(commands[:, :, i]) for i in range(commands.shape[2])])
    wanted = np.concatenate([commands[:, :, i] for i in range(commands.shape[2])])
    middle = marched[:, 0].mean(axis=0)
    inertia = setup.machine.chain.mass_matrix(middle).diagonal() + setup.machine.number("armature")
    out = []
    for j in range(setup.n):
        q, v, f = marched[:, 0, j], marched[:, 1, j], marched[:, 2, j]
        out.append(
            ServoScale(
                z=float(np.std(q)),
                v=rms(v),
                slope=float(np.abs(v).max()),
                k=float(setup.machine.number("gain")[j]),
                m=float(inertia[j]),
                h=1.0 / setup.rate_hz,
                T=len(commands) / setup.rate_hz,
                moment=rms(f),
                most_moment=float(np.abs(f).max()),
                limit=float(setup.machine.number("high")[j]),
                error=rms(wanted[:, j] - q),
                brake=float((setup.machine.number("velocity_gain") + setup.machine.number("damping"))[j]),
                motor=float(setup.machine.number("armature")[j]),
                payload=setup.arm.payload,
            )
        )
    return tuple(out)
