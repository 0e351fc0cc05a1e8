"""Arms on position servos, integrated without MuJoCo and written as case folders.

Two rigs: a lever on one servo, and a planar arm of two links on two servos. Both hang in gravity. The equations of motion are
Lagrange's in closed form; Runge-Kutta steps of fourth order integrate them between the samples of the held commands.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rig_folder import Channel, Record, Rig, multisine, write_case

RATE, SECONDS, NOISE = 100.0, 5.0, 2e-4
"""Samples per second, length of a recording [s], noise of an angle [rad]."""
GRAVITY = 9.81
RISE = 0.05
"""Speed [rad/s] at which three quarters of a gear's friction are there."""
STEPS = 5
"""Runge-Kutta steps to a sample."""


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Numbers of a position servo with all that may be wrong within it."""

    gain: float
    damping: float
    limit: float
    dead: float = 0.0
    soft: float = math.inf
    """Limit that the torque approaches gradually."""
    no_load: float = math.inf
    """Speed at which the limit of the driving torque is zero."""
    loss: float = 0.0
    """Share of the torque that rubs in the gear."""
    integral: float = 0.0
    """Integral gain [N m/(rad s)]."""
    scale: float = 1.0
    """Factor on the command."""
    step: float = 0.0
    """Step of the command's converter [rad]."""

    def force(self, command: float, q: float, v: float, total: float = 0.0) -> float:
        """Return the torque [N m] at an angle, a rate and an integral of the error."""
        command = self.step * round(command / self.step) if self.step else command
        error = self.scale * command - q
        beyond = error - min(max(error, -self.dead), self.dead)
        forward, backward = self.limit * (1 - v / self.no_load), self.limit * (1 + v / self.no_load)
        torque = min(max(self.gain * beyond + self.integral * total - self.damping * v, -backward), forward)
        torque = torque if math.isinf(self.soft) else self.soft * math.tanh(torque / self.soft)
        return torque - self.loss * abs(torque) * math.tanh(v / RISE)


@dataclass(frozen=True, kw_only=True)
class Link:
    """Mass [kg], distance of its centre and length [m], moment of inertia about the centre, damping of the joint."""

    mass: float
    centre: float
    length: float
    inertia: float
    armature: float
    damping: float


@dataclass(frozen=True, kw_only=True)
class Arm:
    """Links with their drives, from the base."""

    links: tuple[Link, ...]
    drives: tuple[Drive, ...]
    names: tuple[str, ...]
    reach: float = 0.5
    """Size of the steps of the commands [rad]."""

    def acceleration(self, q: np.ndarray, v: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Return the accelerations of the joints [rad/s2]; angles count from hanging, each from the link before."""
        torque = torque - [link.damping * b for link, b in zip(self.links, v, strict=True)]
        first = self.links[0]
        own = first.inertia + first.mass * first.centre**2
        weight = first.mass * first.centre * GRAVITY * np.sin(q[0])
        if len(self.links) == 1:
            return (torque - weight) / (own + first.armature)
        second = self.links[1]
        far = second.inertia + second.mass * second.centre**2
        arm = second.mass * first.length * second.centre
        c, s = np.cos(q[1]), np.sin(q[1])
        mass = np.array(
            [
                [own + second.mass * first.length**2 + far + 2 * arm * c + first.armature, far + arm * c],
                [far + arm * c, far + second.armature],
            ]
        )
        coriolis = arm * s * np.array([-v[1] * (2 * v[0] + v[1]), v[0] ** 2])
        below = second.mass * second.centre * GRAVITY * np.sin(q[0] + q[1])
        gravity = np.array([weight + second.mass * first.length * GRAVITY * np.sin(q[0]) + below, below])
        return np.linalg.solve(mass, torque - coriolis - gravity)

    def motion(self, commands: np.ndarray, drives: tuple[Drive, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return angles and torques of the servos (n, joints) under held commands (n, joints), from rest at zero.

        The torques are logged before the commands of their rows are sent.
        """
        h, n = 1.0 / RATE / STEPS, len(self.links)
        x, out, efforts, last = np.zeros((3, n)), np.zeros(commands.shape), np.zeros(commands.shape), np.zeros(n)

        def torques(state: np.ndarray, command: np.ndarray) -> np.ndarray:
            return np.array([d.force(*numbers) for d, *numbers in zip(drives, command, *state, strict=True)])

        def rate(state: np.ndarray, command: np.ndarray) -> np.ndarray:
            q, v, _ = state
            return np.stack([v, self.acceleration(q, v, torques(state, command)), command - q])

        for k, command in enumerate(commands):
            out[k] = x[0]
            efforts[k] = torques(x, last)
            last = command
            for _ in range(STEPS):
                a = rate(x, command)
                b = rate(x + 0.5 * h * a, command)
                c = rate(x + 0.5 * h * b, command)
                x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, command))
        return out, efforts

    @property
    def mjcf(self) -> str:
        """The same arm for MuJoCo."""
        bodies, at = "", 0.0
        for name, link in zip(self.names, self.links, strict=True):
            i = link.inertia
            bodies += f"""<body name="{name}_link" pos="0 0 {-at}">
              <inertial pos="0 0 {-link.centre}" mass="{link.mass}" diaginertia="{i} {i} {i / 2}"/>
              <joint name="{name}" axis="0 -1 0" damping="{link.damping}" armature="{link.armature}"/>
              <geom size="0.01" contype="0" conaffinity="0"/>"""
            at = link.length
        servos = "".join(
            f'<position name="{name}_servo" joint="{name}" kp="{d.gain}" kv="{d.damping}" '
            f'forcerange="-{d.limit} {d.limit}"/>'
            for name, d in zip(self.names, self.drives, strict=True)
        )
        sensors = "".join(f'<actuatorfrc name="{name}_effort" actuator="{name}_servo"/>' for name in self.names)
        return f"""<mujoco><compiler angle="radian" autolimits="true"/>
          <option timestep="0.001" gravity="0 0 -{GRAVITY}" integrator="implicitfast"/>
          <worldbody>{bodies}{"</body>" * len(self.links)}</worldbody><actuator>{servos}</actuator>
          <sensor>{sensors}</sensor></mujoco>"""


@dataclass(frozen=True, kw_only=True)
class Train:
    """Drive train between the motor and the joint of a lever.

    Half the play [rad], stiffness [N m/rad], damper [N m s/rad], and the share of the joint's damping on the motor's side.
    """

    gap: float
    stiffness: float
    damper: float
    share: float

    def angles(self, lever: Arm, commands: np.ndarray) -> np.ndarray:
        """Return the lever's angles (n, 1) under held commands (n, 1), from rest at zero.

        Semi-implicit steps of a twentieth of a millisecond: the damper's edge in the play has no higher order.
        """
        (link,), (drive,) = lever.links, lever.drives
        own, weight = link.inertia + link.mass * link.centre**2, link.mass * link.centre * GRAVITY
        h = 5e-5
        steps, out = round(1.0 / RATE / h), np.zeros(commands.shape)
        m = q = r = w = 0.0
        for k, command in enumerate(commands[:, 0].tolist()):
            out[k] = q
            for _ in range(steps):
                s = m - q
                beyond = s - min(max(s, -self.gap), self.gap)
                moment = self.stiffness * beyond + self.damper * (r - w) * (beyond != 0.0)
                r += h * (drive.force(command, m, r) - self.share * link.damping * r - moment) / link.armature
                w += h * (moment - (1.0 - self.share) * link.damping * w - weight * math.sin(q)) / own
                m, q = m + h * r, q + h * w
        return out


LEVER = Arm(
    links=(Link(mass=0.5, centre=0.12, length=0.15, inertia=1.5e-3, armature=0.006, damping=0.08),),
    drives=(Drive(gain=12.0, damping=0.35, limit=6.0),),
    names=("shaft",),
)
TWO_LINKS = Arm(
    links=(
        Link(mass=0.6, centre=0.12, length=0.25, inertia=3e-3, armature=0.012, damping=0.2),
        Link(mass=0.35, centre=0.11, length=0.22, inertia=1.8e-3, armature=0.008, damping=0.15),
    ),
    drives=(Drive(gain=40.0, damping=1.3, limit=25.0), Drive(gain=22.0, damping=0.8, limit=15.0)),
    names=("shoulder", "elbow"),
)
ARMS = {"lever": LEVER, "two links": TWO_LINKS}


def commands_of(arm: Arm, rng: np.random.Generator) -> np.ndarray:
    """Return commands (n, joints): a multisine and steps between postures, from zero."""
    time = np.arange(int(SECONDS * RATE)) / RATE
    out = np.zeros((len(time), len(arm.links)))
    for j in range(len(arm.links)):
        posture = arm.reach * rng.uniform(-1.0, 1.0, 4)
        wave = multisine(rng, 0.4, 3.0, SECONDS, 0.12)(time)
        out[:, j] = posture[np.minimum((time / SECONDS * 4).astype(int), 3)] + wave
    out[time < 0.2] = 0.0
    return out


def servo_case(
    folder: Path,
    arm_name: str,
    *,
    hidden: tuple[Drive, ...] = (),
    effect: str = "none",
    place: str = "",
    parameters: dict[str, float] | None = None,
    uncertain: dict[str, float] | None = None,
    train: Train | None = None,
    effort_noise: float | None = None,
    seed: int = 0,
) -> Rig:
    """Write a case of an arm whose true drives are `hidden`; the model's own drives where there are none.

    A `train` stands between motor and lever. With `effort_noise`, the servos' torques are logged with that share of noise.
    """
    arm, rng = ARMS[arm_name], np.random.default_rng([seed, len(arm_name)])
    drives = tuple(hidden) or arm.drives
    records = []
    for name, role in (("one", "fit"), ("two", "fit"), ("three", "holdout")):
        commands = commands_of(arm, rng)
        if train is None:
            true, efforts = arm.motion(commands, drives)
        else:
            true, efforts = train.angles(arm, commands), np.zeros(commands.shape)
        read = true + NOISE * rng.standard_normal(commands.shape)
        columns = {f"{n}_cmd": commands[:, j] for j, n in enumerate(arm.names)}
        columns |= {f"{n}_pos": read[:, j] for j, n in enumerate(arm.names)}
        if effort_noise is not None:
            efforts = efforts + effort_noise * np.std(efforts, axis=0) * rng.standard_normal(efforts.shape)
            columns |= {f"{n}_effort": efforts[:, j] for j, n in enumerate(arm.names)}
        records.append(Record(name=name, role=role, columns=columns, rate_hz=RATE))
    channels = [
        Channel(column=f"{n}_cmd", at=f"{n}_servo", kind="command", unit="rad", is_input=True, hold="zero")
        for n in arm.names
    ]
    channels += [Channel(column=f"{n}_pos", at=f"joint:{n}", kind="angle", unit="rad") for n in arm.names]
    if effort_noise is not None:
        channels += [Channel(column=f"{n}_effort", at=f"{n}_effort", kind="moment", unit="N m") for n in arm.names]
    write_case(
        folder, title="An arm on servos", mjcf=arm.mjcf, uncertain=uncertain or {}, channels=channels, records=records
    )
    return Rig(folder=folder, effect=effect, place=place, parameters=parameters or {})
