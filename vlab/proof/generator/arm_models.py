"""Three arms on position servos, with 3, 6 and 7 joints.

The equations of motion are those of `vlab.proof.generator.rigid_body`. The MJCF is text for the case and is not read here.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from vlab.proof.generator.bench import Benign
from vlab.proof.generator.rigid_body import Chain
from vlab.proof.generator.servo_drive import Machine, ideal
from vlab.signals import Array

GRAVITY = 9.81


@dataclass(frozen=True, kw_only=True)
class Link:
    """Body with its joint and drive, in SI units.

    Parameters
    ----------
    name, joint : str
        Names of body and joint.
    offset, quat : tuple of float
        Origin and axes (unnormalised quaternion) in the body before.
    axis : tuple of float
        Axis of the joint.
    mass : float
        Mass.
    centre, inertia : tuple of float
        Centre of mass, and moments of inertia about it.
    damping, armature : float
        Damping and reflected motor inertia of the joint.
    gain, velocity_gain, limit : float
        Gains and force limit of the servo.
    home, reach : float
        Middle and half range of usual commands.
    """

    name: str
    joint: str
    offset: tuple[float, float, float]
    axis: tuple[float, float, float]
    mass: float
    centre: tuple[float, float, float]
    inertia: tuple[float, float, float]
    damping: float
    armature: float
    gain: float
    velocity_gain: float
    limit: float
    home: float
    reach: float
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Arm:
    """Links from the base, and the tip that carries a payload.

    Parameters
    ----------
    tip : tuple of float
        Point of the payload in the axes of the last body.
    payload : float
        Mass of a usual payload [kg].
    encoder_bits : tuple of int
        Possible resolutions of the encoders, in bits per turn.
    """

    name: str
    title: str
    links: tuple[Link, ...]
    tip: tuple[float, float, float]
    payload: float
    encoder_bits: tuple[int, ...]

    @property
    def servos(self) -> tuple[str, ...]:
        """Names of the actuators."""
        return tuple(f"{link.joint}_servo" for link in self.links)

    @property
    def home(self) -> Array:
        """Middle of the commands [rad]."""
        return np.array([link.home for link in self.links])

    @property
    def reach(self) -> Array:
        """Half range of the commands [rad]."""
        return np.array([link.reach for link in self.links])


_YAW, _PITCH = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
_UP, _DOWN = (1.0, 1.0, 0.0, 0.0), (1.0, -1.0, 0.0, 0.0)

DESK = Arm(
    name="arm of three joints",
    title="Desk arm",
    links=(
        Link(
            name="turret",
            joint="yaw",
            offset=(0.0, 0.0, 0.09),
            axis=_YAW,
            mass=0.7,
            centre=(0.0, 0.0, 0.03),
            inertia=(1.1e-3, 1.1e-3, 9e-4),
            damping=0.3,
            armature=0.014,
            gain=50.0,
            velocity_gain=1.6,
            limit=15.0,
            home=0.0,
            reach=0.9,
        ),
        Link(
            name="upper",
            joint="shoulder",
            offset=(0.0, 0.0, 0.06),
            axis=_PITCH,
            mass=0.6,
            centre=(0.0, 0.01, 0.12),
            inertia=(3.2e-3, 3.2e-3, 3.5e-4),
            damping=0.3,
            armature=0.014,
            gain=50.0,
            velocity_gain=1.6,
            limit=15.0,
            home=0.4,
            reach=0.6,
        ),
        Link(
            name="fore",
            joint="elbow",
            offset=(0.0, 0.0, 0.25),
            axis=_PITCH,
            mass=0.4,
            centre=(0.0, 0.0, 0.11),
            inertia=(2.1e-3, 2.1e-3, 1.8e-4),
            damping=0.2,
            armature=0.008,
            gain=30.0,
            velocity_gain=0.9,
            limit=9.0,
            home=0.9,
            reach=0.7,
        ),
    ),
    tip=(0.0, 0.0, 0.22),
    payload=0.25,
    encoder_bits=(12, 14),
)
"""DESK: hobby arm with smart servos in every joint."""

BENCHTOP = Arm(
    name="arm of six joints",
    title="Bench-top arm with wrist",
    links=(
        Link(name="base_link", joint="waist", offset=(0.0, 0.0, 0.08), axis=_YAW, mass=1.1, centre=(0.0, 0.005, 0.03),
             inertia=(2.4e-3, 2.2e-3, 2.0e-3), damping=0.6, armature=0.03, gain=90.0, velocity_gain=4.0, limit=24.0,
             home=0.0, reach=0.8),
        Link(name="upper_arm", joint="shoulder", offset=(0.0, 0.0, 0.06), axis=_PITCH, mass=1.2,
             centre=(0.02, 0.0, 0.16), inertia=(9.5e-3, 9.3e-3, 1.1e-3), damping=0.8, armature=0.045, gain=140.0,
             velocity_gain=7.0, limit=32.0, home=0.2, reach=0.5),
        Link(name="fore_arm", joint="elbow", offset=(0.05, 0.0, 0.28), axis=_PITCH, mass=0.8, centre=(0.09, 0.0, 0.01),
             inertia=(8e-4, 4.1e-3, 4.0e-3), damping=0.5, armature=0.025, gain=90.0, velocity_gain=3.6, limit=20.0,
             home=0.3, reach=0.6),
        Link(name="roll_link", joint="forearm_roll", offset=(0.18, 0.0, 0.0), axis=(1.0, 0.0, 0.0), mass=0.35,
             centre=(0.05, 0.0, 0.0), inertia=(2e-4, 5.5e-4, 5.5e-4), damping=0.12, armature=0.008, gain=25.0,
             velocity_gain=0.7, limit=7.0, home=0.0, reach=0.9),
        Link(name="wrist", joint="wrist_pitch", offset=(0.12, 0.0, 0.0), axis=_PITCH, mass=0.3, centre=(0.04, 0.0, 0.0),
             inertia=(1.6e-4, 3.5e-4, 3.2e-4), damping=0.12, armature=0.008, gain=25.0, velocity_gain=0.7, limit=7.0,
             home=0.3, reach=0.7),
        Link(name="gripper", joint="wrist_roll", offset=(0.07, 0.0, 0.0), axis=(1.0, 0.0, 0.0), mass=0.25,
             centre=(0.05, 0.004, 0.0), inertia=(2.2e-4, 3.0e-4, 2.6e-4), damping=0.06, armature=0.005, gain=14.0,
             velocity_gain=0.4, limit=4.0, home=0.0, reach=1.0),
    ),
    tip=(0.1, 0.0, 0.0),
    payload=0.35,
    encoder_bits=(12, 14),
)  # fmt: skip
"""BENCHTOP: research arm of 1 m reach with smart servos."""

FLOOR = Arm(
    name="arm of seven joints",
    title="Arm of seven joints",
    links=(
        Link(name="link1", joint="joint1", offset=(0.0, 0.0, 0.33), axis=_YAW, mass=3.6, centre=(0.0, -0.03, -0.09),
             inertia=(0.021, 0.019, 0.011), damping=4.0, armature=0.2, gain=900.0, velocity_gain=55.0, limit=90.0,
             home=0.0, reach=0.6),
        Link(name="link2", joint="joint2", offset=(0.0, 0.0, 0.0), quat=_DOWN, axis=_YAW, mass=3.4,
             centre=(0.0, -0.08, 0.03), inertia=(0.025, 0.011, 0.022), damping=4.0, armature=0.2, gain=900.0,
             velocity_gain=65.0, limit=90.0, home=0.2, reach=0.5),
        Link(name="link3", joint="joint3", offset=(0.0, -0.31, 0.0), quat=_UP, axis=_YAW, mass=3.0,
             centre=(0.03, 0.03, -0.06), inertia=(0.018, 0.016, 0.011), damping=3.0, armature=0.15, gain=700.0,
             velocity_gain=40.0, limit=90.0, home=0.0, reach=0.6),
        Link(name="link4", joint="joint4", offset=(0.08, 0.0, 0.0), quat=_UP, axis=_YAW, mass=2.9,
             centre=(-0.04, 0.05, 0.025), inertia=(0.017, 0.012, 0.018), damping=3.0, armature=0.15, gain=700.0,
             velocity_gain=36.0, limit=80.0, home=-1.6, reach=0.5),
        Link(name="link5", joint="joint5", offset=(-0.08, 0.38, 0.0), quat=_DOWN, axis=_YAW, mass=2.6,
             centre=(0.0, 0.035, -0.11), inertia=(0.026, 0.024, 0.006), damping=1.0, armature=0.08, gain=250.0,
             velocity_gain=10.0, limit=14.0, home=0.0, reach=0.7),
        Link(name="link6", joint="joint6", offset=(0.0, 0.0, 0.0), quat=_UP, axis=_YAW, mass=1.4,
             centre=(0.05, -0.01, -0.01), inertia=(0.003, 0.0045, 0.0052), damping=1.0, armature=0.08, gain=200.0,
             velocity_gain=8.0, limit=13.0, home=1.8, reach=0.6),
        Link(name="hand", joint="joint7", offset=(0.09, 0.0, 0.0), quat=_UP, axis=_YAW, mass=1.1,
             centre=(0.01, 0.0, 0.09), inertia=(0.004, 0.0035, 0.0022), damping=0.6, armature=0.05, gain=80.0,
             velocity_gain=3.0, limit=10.0, home=0.6, reach=0.9),
    ),
    tip=(0.0, 0.0, 0.18),
    payload=1.2,
    encoder_bits=(17, 19),
)  # fmt: skip
"""FLOOR: arm with strain-wave gears and skew joints."""

ARMS = (DESK, BENCHTOP, FLOOR)


def rotation_of(quat: tuple[float, float, float, float]) -> Array:
    """Return the rotation of a quaternion.

    Parameters
    ----------
    quat : tuple of float
        Unnormalised quaternion (w, x, y, z).

    Returns
    -------
    (3, 3) array
        Rotation.
    """
    w, x, y, z = np.array(quat) / np.linalg.norm(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def benign_of(stated: Mapping[str, float], arm: Arm) -> tuple[Benign, ...]:
    """Return the parameters that vary from arm to arm.

    Parameters
    ----------
    stated : mapping of str to float
        Relative standard deviations by kind, as the case states them.
    arm : Arm
        Arm.

    Returns
    -------
    tuple of Benign
        One parameter a body, joint or servo.
    """
    at_body = ("mass", "inertia", "centre-of-mass", "length")
    out = []
    for kind, sd in stated.items():
        for i, (link, servo) in enumerate(zip(arm.links, arm.servos, strict=True)):
            if kind == "length" and not any(arm.links[i].offset):
                continue
            owner = link.name if kind in at_body else servo if "gain" in kind else link.joint
            out.append(Benign(name=f"{kind}:{owner}", kind=kind, sd=sd))
    return tuple(out)


def built(arm: Arm, factors: Mapping[str, float]) -> Machine:
    """Return an arm with ideal drives and log-factors on its parameters.

    Parameters
    ----------
    arm : Arm
        Arm.
    factors : mapping of str to float
        Log-factors by the names of `benign_of`; missing ones are zero.

    Returns
    -------
    Machine
        Arm as built. A factor on a centre of mass is a shift along the body, over the radius of gyration.
    """

    def all_of(kind: str, names: tuple[str, ...]) -> Array:
        return np.exp([factors.get(f"{kind}:{name}", 0.0) for name in names])

    bodies, joints = tuple(link.name for link in arm.links), tuple(link.joint for link in arm.links)
    mass = np.array([link.mass for link in arm.links])
    centre = np.array([link.centre for link in arm.links])
    inertia = np.array([link.inertia for link in arm.links])
    gyration = np.sqrt(inertia.sum(axis=1) / (2.0 * mass))
    along = centre / np.linalg.norm(centre, axis=1)[:, None]
    shift = np.log(all_of("centre-of-mass", bodies)) * gyration
    heavier, wider = all_of("mass", bodies), all_of("inertia", bodies)
    chain = Chain(
        offset=np.array([link.offset for link in arm.links]) * all_of("length", bodies)[:, None],
        turn=np.array([rotation_of(link.quat) for link in arm.links]),
        axis=np.array([link.axis for link in arm.links]),
        mass=mass * heavier,
        centre=centre + shift[:, None] * along,
        inertia=np.array([np.diag(row) for row in inertia]) * (heavier * wider)[:, None, None],
        gravity=np.array([0.0, 0.0, -GRAVITY]),
    )
    limit = np.array([link.limit for link in arm.links])
    return ideal(
        chain,
        gain=np.array([link.gain for link in arm.links]) * all_of("gain", arm.servos),
        velocity_gain=np.array([link.velocity_gain for link in arm.links]) * all_of("velocity-gain", arm.servos),
        damping=np.array([link.damping for link in arm.links]) * all_of("damping", joints),
        armature=np.array([link.armature for link in arm.links]) * all_of("armature", joints),
        low=-limit,
        high=limit,
    )


def with_payload(machine: Machine, arm: Arm, mass: float, away: Array, size: float) -> Machine:
    """Return a machine with a solid ball at its tip.

    Parameters
    ----------
    machine : Machine
        Machine.
    arm : Arm
        Arm of the machine.
    mass : float
        Mass of the ball [kg].
    away : (3,) array
        Centre of the ball from the tip, in the axes of the last body [m].
    size : float
        Radius of the ball [m].

    Returns
    -------
    Machine
        Machine with a heavier last body.
    """
    chain = machine.chain
    own, at = chain.mass[-1], chain.centre[-1]
    ball = np.array(arm.tip) + away
    whole = own + mass
    middle = (own * at + mass * ball) / whole
    inertia = chain.inertia[-1] + 0.4 * mass * size**2 * np.eye(3)
    for m, r in ((own, at - middle), (mass, ball - middle)):
        inertia = inertia + m * (float(r @ r) * np.eye(3) - np.outer(r, r))
    moved = replace(
        chain,
        mass=np.append(chain.mass[:-1], whole),
        centre=np.vstack([chain.centre[:-1], middle]),
        inertia=np.concatenate([chain.inertia[:-1], inertia[None]]),
    )
    return replace(machine, chain=moved)


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(str(float(x)) for x in values)


def mjcf_of(arm: Arm, *, timestep: float, integrator: str, is_general: bool, has_effort: bool) -> str:
    """Return the nominal MJCF as its user has it.

    Parameters
    ----------
    arm : Arm
        Arm.
    timestep : float
        Step of the model [s].
    integrator : str
        Integrator of MuJoCo.
    is_general : bool
        Whether the servos are written as ``general`` actuators.
    has_effort : bool
        Whether the model has sensors of the drive moments.

    Returns
    -------
    str
        Model with one position servo a joint.
    """
    bodies, servos = [], []
    for depth, (link, servo) in enumerate(zip(arm.links, arm.servos, strict=True)):
        pad = "  " * (depth + 2)
        quat = "" if link.quat == (1.0, 0.0, 0.0, 0.0) else f' quat="{_numbers(link.quat)}"'
        end = arm.links[depth + 1].offset if depth + 1 < len(arm.links) else arm.tip
        shape = f'type="capsule" fromto="0 0 0 {_numbers(end)}" size="0.02"' if any(end) else 'size="0.03"'
        bodies += [
            f'{pad}<body name="{link.name}" pos="{_numbers(link.offset)}"{quat}>',
            f'{pad}  <inertial pos="{_numbers(link.centre)}" mass="{link.mass:g}" diaginertia="{_numbers(link.inertia)}"/>',
            f'{pad}  <joint name="{link.joint}" axis="{_numbers(link.axis)}" damping="{link.damping:g}" armature="{link.armature:g}"/>',
            f"{pad}  <geom {shape}/>",
        ]
        gains = f'kp="{link.gain:g}" kv="{link.velocity_gain:g}"'
        if is_general:
            gains = f'gainprm="{link.gain:g}" biastype="affine" biasprm="0 {-link.gain:g} {-link.velocity_gain:g}"'
        kind = "general" if is_general else "position"
        limits = f'forcerange="{-link.limit:g} {link.limit:g}"'
        servos.append(f'    <{kind} name="{servo}" joint="{link.joint}" {gains} {limits}/>')
    ends = ["  " * (depth + 2) + "</body>" for depth in reversed(range(len(arm.links)))]
    site = "  " * (len(arm.links) + 2) + f'<site name="tip" pos="{_numbers(arm.tip)}"/>'
    efforts = [
        f'    <actuatorfrc name="{link.joint}_effort" actuator="{servo}"/>'
        for link, servo in zip(arm.links, arm.servos, strict=True)
    ]
    return "\n".join(
        [
            f'<mujoco model="{arm.title.lower()}">',
            '  <compiler angle="radian" autolimits="true"/>',
            f'  <option timestep="{timestep:g}" integrator="{integrator}" gravity="0 0 {-GRAVITY:g}"/>',
            '  <default><geom contype="0" conaffinity="0"/></default>',
            "  <worldbody>",
            *bodies,
            site,
            *ends,
            "  </worldbody>",
            "  <actuator>",
            *servos,
            "  </actuator>",
            *(["  <sensor>", *efforts, "  </sensor>"] if has_effort else []),
            "</mujoco>",
            "",
        ]
    )
