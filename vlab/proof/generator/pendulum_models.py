"""Free pendulums and carts, as built and as users model them.

The MJCF is text for the case and is not read here. Angles count from the hanging rest; a positive angle carries the rod
towards positive x.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from vlab.proof.generator.bench import Benign
from vlab.proof.generator.pendulum_motion import Swinging, free

GRAVITY = 9.81


@dataclass(frozen=True, kw_only=True)
class Rod:
    """Body on a hinge, in SI units.

    Parameters
    ----------
    name, joint : str
        Names of body and hinge.
    mass, centre, inertia : float
        Mass, centre of mass below the hinge, and moment of inertia about it.
    length : float
        Distance from the hinge to the next one, or to the tip.
    damping : float
        Damping of the hinge.
    """

    name: str
    joint: str
    mass: float
    centre: float
    inertia: float
    length: float
    damping: float


@dataclass(frozen=True, kw_only=True)
class Cart:
    """Cart on a rail with its motor, in SI units.

    Parameters
    ----------
    mass, damping : float
        Mass, and damping of the rail with that of the motor.
    force : float
        Usual rms force of the motor.
    radius : float
        Radius of the drum that turns the encoder of the rail.
    """

    mass: float
    damping: float
    force: float
    radius: float


@dataclass(frozen=True, kw_only=True)
class Pendulum:
    """One or two rods on a hinge, or one on a cart.

    Parameters
    ----------
    widest : tuple of float
        Range of the angles of release [rad]; empty with a cart.
    encoder_bits : tuple of int
        Possible resolutions of the encoders, in bits per turn.
    payload : float
        Mass of a usual body at the tip [kg].
    """

    name: str
    title: str
    rods: tuple[Rod, ...]
    cart: Cart | None = None
    widest: tuple[float, float] = (0.0, 0.0)
    encoder_bits: tuple[int, ...]
    payload: float

    @property
    def layout(self) -> Literal["single", "double", "cart"]:
        """Form of the equations of motion."""
        if self.cart is not None:
            return "cart"
        return "single" if len(self.rods) == 1 else "double"

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints in the order of the coordinates."""
        rail = ("slide",) if self.cart is not None else ()
        return (*rail, *(rod.joint for rod in self.rods))

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies in the order of the coordinates."""
        cart = ("cart",) if self.cart is not None else ()
        return (*cart, *(rod.name for rod in self.rods))


_DEGREE = np.pi / 180.0
BOB = Pendulum(
    name="pendulum with a bob",
    title="Pendulum",
    rods=(Rod(name="rod", joint="pivot", mass=0.42, centre=0.36, inertia=7.5e-3, length=0.5, damping=4e-3),),
    widest=(30 * _DEGREE, 120 * _DEGREE),
    encoder_bits=(12, 13, 14),
    payload=0.08,
)
"""BOB: rod of 0.5 m with a bob."""
BAR = Pendulum(
    name="bar pendulum",
    title="Bar pendulum",
    rods=(Rod(name="bar", joint="hinge", mass=1.3, centre=0.4, inertia=0.083, length=0.85, damping=0.03),),
    widest=(30 * _DEGREE, 120 * _DEGREE),
    encoder_bits=(12, 14),
    payload=0.25,
)
"""BAR: steel bar of 0.9 m."""
TWIN = Pendulum(
    name="double pendulum",
    title="Double pendulum",
    rods=(
        Rod(name="upper", joint="shoulder", mass=0.36, centre=0.13, inertia=2.6e-3, length=0.22, damping=3e-3),
        Rod(name="lower", joint="elbow", mass=0.21, centre=0.09, inertia=9.5e-4, length=0.19, damping=1e-3),
    ),
    widest=(15 * _DEGREE, 55 * _DEGREE),
    encoder_bits=(12, 14),
    payload=0.04,
)
"""TWIN: double pendulum, released below its chaotic range."""
SWINGS = {BOB: 0.4, BAR: 0.3, TWIN: 0.3}
"""SWINGS [-]: free pendulums with their frequencies."""

LIGHT = Pendulum(
    name="cart with a light rod",
    title="Cart with a hanging rod",
    rods=(Rod(name="rod", joint="pivot", mass=0.23, centre=0.33, inertia=7.9e-3, length=0.64, damping=2.4e-3),),
    cart=Cart(mass=0.94, damping=5.4, force=3.5, radius=0.05),
    encoder_bits=(12, 13),
    payload=0.05,
)
"""LIGHT: teaching cart on a rack with a rod of 0.64 m."""
HEAVY = Pendulum(
    name="cart with a heavy bob",
    title="Model crane",
    rods=(Rod(name="boom", joint="swivel", mass=1.6, centre=0.55, inertia=0.03, length=0.6, damping=0.02),),
    cart=Cart(mass=3.2, damping=14.0, force=11.0, radius=0.06),
    encoder_bits=(12, 14),
    payload=0.3,
)
"""HEAVY: crane trolley with a load of half its mass."""
CARTS = {LIGHT: 0.6, HEAVY: 0.4}
"""CARTS [-]: carts with their frequencies."""

START = {"angle": 0.1, "rate": 0.5}
"""START [rad, rad/s]: standard deviations of the unknown state at a release, wide beside those of a fit."""


def benign_of(stated: Mapping[str, float], pendulum: Pendulum) -> tuple[Benign, ...]:
    """Return the parameters that vary from pendulum to pendulum.

    Parameters
    ----------
    stated : mapping of str to float
        Relative standard deviations by kind, as the case states them.
    pendulum : Pendulum
        Pendulum.

    Returns
    -------
    tuple of Benign
        One parameter a body, joint or motor.
    """
    rods = tuple(rod.name for rod in pendulum.rods)
    owners = {
        "mass": pendulum.bodies,
        "inertia": rods,
        "centre-of-mass": rods,
        "length": rods[1:],
        "damping": pendulum.joints,
        "gain": ("motor",) if pendulum.cart is not None else (),
    }
    return tuple(
        Benign(name=f"{kind}:{owner}", kind=kind, sd=sd) for kind, sd in stated.items() for owner in owners[kind]
    )


def starts_of(pendulum: Pendulum, runs: int) -> tuple[Benign, ...]:
    """Return the unknown states at releases.

    Parameters
    ----------
    pendulum : Pendulum
        Pendulum.
    runs : int
        Number of recordings to fit.

    Returns
    -------
    tuple of Benign
        One parameter a recording, coordinate and entry of `START`; none with a cart.
    """
    if pendulum.cart is not None:
        return ()
    return tuple(
        Benign(name=f"{what}:{run}:{j}", kind="start", sd=sd)
        for run in range(runs)
        for what, sd in START.items()
        for j in range(len(pendulum.joints))
    )


def built(pendulum: Pendulum, factors: Mapping[str, float]) -> Swinging:
    """Return a pendulum with ideal joints and log-factors on its parameters.

    Parameters
    ----------
    pendulum : Pendulum
        Pendulum.
    factors : mapping of str to float
        Log-factors by the names of `benign_of`; missing ones are zero.

    Returns
    -------
    Swinging
        Pendulum as built. A factor on a centre of mass is a shift along the rod, over the radius of gyration.
    """

    def by(kind: str, name: str) -> float:
        return float(np.exp(factors.get(f"{kind}:{name}", 0.0)))

    mass, centre, inertia, length = [], [], [], []
    for i, rod in enumerate(pendulum.rods):
        after = pendulum.rods[i + 1].name if i + 1 < len(pendulum.rods) else ""
        gyration = np.sqrt(_moments(rod).sum() / (2.0 * rod.mass))
        mass.append(rod.mass * by("mass", rod.name))
        centre.append(rod.centre + float(np.log(by("centre-of-mass", rod.name)) * gyration))
        inertia.append(rod.inertia * by("mass", rod.name) * by("inertia", rod.name))
        length.append(rod.length * (by("length", after) if after else 1.0))
    rail = 0.0 if pendulum.cart is None else pendulum.cart.mass * by("mass", "cart")
    damping = [rod.damping * by("damping", rod.joint) for rod in pendulum.rods]
    if pendulum.cart is not None:
        damping.insert(0, pendulum.cart.damping * by("damping", "slide"))
    return free(
        pendulum.layout,
        bodies=np.array([mass, centre, inertia, length]),
        rail=rail,
        gravity=GRAVITY,
        gain=by("gain", "motor"),
        damping=np.array(damping),
    )


def _moments(rod: Rod) -> np.ndarray:
    """Return the principal moments of inertia of a slender rod."""
    return np.array([rod.inertia, rod.inertia, SLENDER * rod.inertia])


SLENDER = 0.05
"""SLENDER [-]: moment of inertia of a rod about its length, over that across."""


def mjcf_of(pendulum: Pendulum, *, timestep: float, integrator: str) -> str:
    """Return the nominal MJCF as its user has it.

    Parameters
    ----------
    pendulum : Pendulum
        Pendulum.
    timestep : float
        Step of the model [s].
    integrator : str
        Integrator of MuJoCo.

    Returns
    -------
    str
        Model with a hinge a rod, and a slide with a motor for a cart.
    """
    lines: list[str] = []
    ends: list[str] = []
    pad = "    "
    if pendulum.cart is not None:
        lines += [
            f'{pad}<body name="cart">',
            f'{pad}  <inertial pos="0 0 0" mass="{pendulum.cart.mass:g}" diaginertia="0.01 0.01 0.01"/>',
            f'{pad}  <joint name="slide" type="slide" axis="1 0 0" damping="{pendulum.cart.damping:g}"/>',
            f'{pad}  <geom type="box" size="0.08 0.05 0.03"/>',
        ]
        ends.insert(0, f"{pad}</body>")
        pad += "  "
    for i, rod in enumerate(pendulum.rods):
        above = pendulum.rods[i - 1].length if i else 0.0
        across, along = _moments(rod)[0], _moments(rod)[2]
        lines += [
            f'{pad}<body name="{rod.name}" pos="0 0 {-above:g}">',
            f'{pad}  <inertial pos="0 0 {-rod.centre:g}" mass="{rod.mass:g}" diaginertia="{across:g} {across:g} {along:g}"/>',
            f'{pad}  <joint name="{rod.joint}" axis="0 -1 0" damping="{rod.damping:g}"/>',
            f'{pad}  <geom type="capsule" fromto="0 0 0 0 0 {-rod.length:g}" size="0.008"/>',
        ]
        ends.insert(0, f"{pad}</body>")
        pad += "  "
    site = f'{pad}<site name="tip" pos="0 0 {-pendulum.rods[-1].length:g}"/>'
    motor = ["  <actuator>", '    <motor name="motor" joint="slide"/>', "  </actuator>"]
    return "\n".join(
        [
            f'<mujoco model="{pendulum.title.lower()}">',
            '  <compiler angle="radian"/>',
            f'  <option timestep="{timestep:g}" integrator="{integrator}" gravity="0 0 {-GRAVITY:g}"/>',
            '  <default><geom contype="0" conaffinity="0"/></default>',
            "  <worldbody>",
            *lines,
            site,
            *ends,
            "  </worldbody>",
            *(motor if pendulum.cart is not None else []),
            "</mujoco>",
            "",
        ]
    )
