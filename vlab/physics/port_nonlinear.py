"""Memoryless nonlinear port forces: polynomials, dry friction, gaps, stops, bias."""

from typing import Any, ClassVar

import numpy as np

from vlab.physics.effect import OWN_SHARE, Parameter, PortEffect, Step, Values, limited, positive, smooth_sign

REST_SPEED = 1e-3
"""REST_SPEED [1]: share of the largest velocity over which friction reverses if the mobility is unknown."""


class QuadraticDrag(PortEffect):
    """Air drag on bluff parts."""

    name = "quadratic-drag"
    family = "damping"
    law = "F = -c v |v|"
    words = "drag that grows with the square of the velocity, as of air on bluff parts"
    parameters: ClassVar = (Parameter(name="coefficient", unit="N s^2/m^2", low=1e-8, high=1e6),)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return -p["coefficient"] * v * abs(v), memory


class CubicStiffness(PortEffect):
    """Hardening by stretching, softening by slack."""

    name = "cubic-stiffness"
    family = "nonlinear-stiffness"
    law = "F = -k3 z^3"
    words = "the stiffness changes with the square of the deflection: hardening by stretching (k3 > 0) or softening (k3 < 0)"
    parameters: ClassVar = (Parameter(name="k3", unit="N/m^3", low=1e-6, high=1e12, signed=True),)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return -p["k3"] * z * z * z, memory


class QuadraticStiffness(PortEffect):
    """Initial curvature, a static offset on a hardening spring."""

    name = "quadratic-stiffness"
    family = "nonlinear-stiffness"
    law = "F = -k2 z^2"
    words = "the stiffness differs to the two sides: an initial curvature, an offset on a hardening spring"
    parameters: ClassVar = (Parameter(name="k2", unit="N/m^2", low=1e-6, high=1e10, signed=True),)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return -p["k2"] * z * z, memory


class PolynomialStiffness(PortEffect):
    """A spring that is both asymmetric and hardening."""

    name = "quadratic-cubic-stiffness"
    family = "nonlinear-stiffness"
    law = "F = -k2 z^2 - k3 z^3"
    words = "a spring that is asymmetric and hardens or softens: even and odd terms, no memory"
    parameters: ClassVar = (
        Parameter(name="k2", unit="N/m^2", low=1e-6, high=1e10, signed=True),
        Parameter(name="k3", unit="N/m^3", low=1e-6, high=1e12, signed=True),
    )

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return -p["k2"] * z * z - p["k3"] * z * z * z, memory


class QuinticStiffness(PortEffect):
    """A cubic spring with a quintic term."""

    name = "cubic-quintic-stiffness"
    form_of = "cubic-stiffness"
    family = "nonlinear-stiffness"
    law = "F = -k3 z^3 - k5 z^5"
    words = "a symmetric spring that hardens or softens, and does so more or less steeply in large motion"
    parameters: ClassVar = (
        Parameter(name="k3", unit="N/m^3", low=1e-6, high=1e12, signed=True),
        Parameter(name="k5", unit="N/m^5", low=1e-6, high=1e20, signed=True),
    )

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return -(p["k3"] + p["k5"] * z * z) * z * z * z, memory


class StringStiffness(PortEffect):
    """A wire, cable or sheet across the motion.

    Stretching hardens the spring in small motion; in large motion the force is about linear.
    """

    name = "string-stiffness"
    form_of = "cubic-stiffness"
    family = "nonlinear-stiffness"
    law = "F = -k z^3/(z^2 + d^2)"
    words = "hardening by stretching that comes to an end: about cubic up to a deflection d, about linear beyond"
    parameters: ClassVar = (
        Parameter(name="stiffness", unit="N/m", low=1e-3, high=1e9, signed=True),
        Parameter(name="bend", unit="m", low=0.1, high=2.0, role="shape", reference="displacement", grid=(0.25, 0.7)),
    )

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return -p["stiffness"] * z * z * z / (z * z + p["bend"] * p["bend"]), memory


def _any(flags: Any) -> bool:
    """Return whether any flag may be set.

    A MuJoCo step has a single flag, which is no array. The value of a symbol is unknown and counts as set.
    """
    if isinstance(flags, np.ndarray):
        return bool(np.count_nonzero(flags))  # ten times as fast as `any`
    return bool(flags) if isinstance(flags, (bool, np.bool_)) else True


def dry_friction(limit: Any, v: Any, step: Step) -> Any:
    """Return the force of dry friction with a limit.

    The force is the one that stops the port within the step, at most the limit. With `free_velocity` sticking is exact.
    Without `free_velocity` the present velocity serves, and a stuck port creeps by mobility times the pushing force.
    With `first_velocity` a port pushed beyond the limit reverses within the step, and friction with the port.

    See [1]_ for friction laws of machines and [2]_ for sticking in simulation.

    Parameters
    ----------
    limit : object
        Friction limit [N].
    v : object
        Velocity at the middle of the step [m/s].
    step : Step
        Data of the step.

    Returns
    -------
    object
        Force on the structure [N], shape of `v`.

    References
    ----------
    .. [1] B. Armstrong-Helouvry, P. Dupont and C. Canudas de Wit, A survey of models, analysis tools and compensation
           methods for the control of machines with friction, Automatica 30 (1994) 1083-1138.
    .. [2] D. Karnopp, Computer simulation of stick-slip friction in mechanical dynamic systems, Journal of Dynamic
           Systems, Measurement and Control 107 (1985) 100-103.
    """
    if step.free_velocity is not None:
        mobility = step.mobility + 1e-300
        stop = step.free_velocity / mobility
        force = limited(stop, limit)
        sticks = force == stop
        if step.first_velocity is None or not _any(sticks):
            return -force
        push = stop - step.first_velocity / mobility
        turns = sticks & (abs(push) > limit)
        if not _any(turns):
            return -force
        before = (push - stop) / (abs(push) + limit)  # share of the step before reversal, with the sign of the push
        turning = limit * (2.0 * before - np.sign(push))
        return turning if isinstance(turning, float) else np.where(turns, turning, -force)
    if np.any(np.asarray(step.mobility) > 0):
        return -limited(v / (step.mobility + 1e-300), limit)
    return -limit * smooth_sign(v, REST_SPEED * np.max(np.abs(v), initial=0.0))


class CoulombFriction(PortEffect):
    """Dry friction of a guide, bearing or dragging wire."""

    name = "coulomb-friction"
    family = "friction"
    law = "F = -Fc sgn(v), sticking up to Fc"
    words = "dry friction of constant size: a rubbing guide, a bearing, a wire that drags"
    parameters: ClassVar = (Parameter(name="force", unit="N", low=1e-8, high=1e5),)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return dry_friction(p["force"], v, step), memory


class SmoothFriction(PortEffect):
    """Dry friction that creeps instead of sticking.

    Causes: a lubricating film or many small contacts. Simulations regularise friction in the same way.
    """

    name = "smooth-friction"
    form_of = "coulomb-friction"
    family = "friction"
    law = "F = -Fc tanh(v/vr)"
    words = "dry friction of constant size that comes in gradually as the motion turns round"
    parameters: ClassVar = (
        Parameter(name="force", unit="N", low=1e-8, high=1e5),
        Parameter(
            name="rise",
            unit="m/s",
            low=0.02,  # below a hundredth of the largest velocity the law equals Coulomb friction
            high=0.5,
            role="shape",
            reference="velocity",
            grid=(0.03, 0.1, 0.3),
            words="the velocity at which three quarters of it are there",
        ),
    )

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`: a steep law reverses no port in a step."""
        return dry_friction(p["force"] * np.tanh(abs(v) / p["rise"]), v, step), memory


class StribeckFriction(PortEffect):
    """Dry friction larger at rest than in motion [1]_.

    References
    ----------
    .. [1] B. Armstrong-Helouvry, P. Dupont and C. Canudas de Wit, A survey of models, analysis tools and compensation
           methods for the control of machines with friction, Automatica 30 (1994) 1083-1138.
    """

    name = "stribeck-friction"
    family = "friction"
    law = "F = -(Fc + Fs exp(-(v/vs)^2)) sgn(v)"
    words = "dry friction that is larger near rest than in motion: stick-slip"
    parameters: ClassVar = (
        Parameter(name="force", unit="N", low=1e-8, high=1e5),
        Parameter(name="excess", unit="N", low=1e-8, high=1e5),
        Parameter(
            name="speed", unit="m/s", low=0.005, high=0.5, role="shape", reference="velocity", grid=(0.02, 0.06, 0.2)
        ),
    )

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        limit = p["force"] + p["excess"] * np.exp(-limited((v / p["speed"]) ** 2, 700.0))
        return dry_friction(limit, v, step), memory


FINE_GAPS = (0.003, 0.012, 0.05, 0.15, 0.4)
"""FINE_GAPS [1]: trial clearances as shares of the largest displacement. A fine clearance acts like lossless
friction."""


class DeadBand(PortEffect):
    """Clearance that disengages an elastic element."""

    name = "dead-band"
    family = "clearance"
    law = "F = +k z within the gap, +k gap sgn(z) beyond: the element's own stiffness k is missing within the gap"
    words = "clearance or backlash: an elastic element does not act within a gap"
    parameters: ClassVar = (
        Parameter(name="stiffness", unit="N/m", low=1e-3, high=1e8),
        Parameter(name="gap", unit="m", low=0.001, high=0.9, role="shape", reference="displacement", grid=FINE_GAPS),
    )

    needs = ("stiffness",)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return p["stiffness"] * limited(z, p["gap"]), memory

    def of_element(self, p: Values, stiffness: float) -> dict[str, float] | None:
        """See `PortEffect`: the gap scales so that the force beyond it holds."""
        return {"stiffness": stiffness, "gap": p["stiffness"] * p["gap"] / stiffness} if stiffness > 0 else None

    def is_meant(self, p: Values, stiffness: float) -> bool:
        """See `PortEffect`: a small disengaged share is a parallel stop."""
        return p["stiffness"] >= OWN_SHARE * stiffness


class Stop(PortEffect):
    """A stop on both sides."""

    name = "stop"
    family = "contact"
    law = "F = -k (|z| - gap) sgn(z) beyond the gap"
    words = "the motion runs against stops on both sides"
    parameters: ClassVar = (
        Parameter(name="stiffness", unit="N/m", low=1e-1, high=1e9),
        Parameter(
            name="gap", unit="m", low=0.1, high=0.99, role="shape", reference="displacement", grid=(0.4, 0.65, 0.85)
        ),
    )

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return -p["stiffness"] * (z - limited(z, p["gap"])), memory


class OneSidedStiffness(PortEffect):
    """A slack cable, a lifting support or a one-sided rattle."""

    name = "one-sided-stiffness"
    family = "contact"
    law = "F = -k (z - gap) where z > gap, nothing elsewhere"
    words = "stiffness on one side only: a stop, a cable that goes slack, a support that lifts off"
    parameters: ClassVar = (
        Parameter(name="stiffness", unit="N/m", low=1e-3, high=1e9, signed=True),
        Parameter(
            name="gap",
            unit="m",
            low=-0.95,
            high=0.95,
            role="shape",
            reference="displacement",
            grid=(-0.7, -0.35, -0.05, 0.05, 0.35, 0.7),
            signed=True,
        ),
    )

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`: a negative gap acts below -|gap|."""
        gap = p["gap"]
        side = (-1.0 if gap < 0 else 1.0) if isinstance(gap, float) else np.where(gap < 0, -1.0, 1.0)
        return -side * p["stiffness"] * positive(side * z - abs(gap)), memory


class ForceOffset(PortEffect):
    """A constant force."""

    name = "force-offset"
    family = "bias"
    response = "none"
    law = "F = F0"
    words = "a constant force: gravity along a tilted axis, a bias of the drive, a draught"
    parameters: ClassVar = (Parameter(name="force", unit="N", low=1e-9, high=1e5, signed=True),)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return p["force"] + 0.0 * z, memory


class SinusoidalForce(PortEffect):
    """Force of a machine, hum, floor motion or vortices."""

    name = "sinusoidal-force"
    family = "disturbance"
    response = "none"
    law = "F = a sin(2 pi f t) + b cos(2 pi f t)"
    words = "a force of one frequency from outside: a machine, hum of an amplifier, motion of the floor, a draught"
    parameters: ClassVar = (
        Parameter(name="sine", unit="N", low=1e-9, high=1e5, signed=True, words="at the place floor m/s^2"),
        Parameter(name="cosine", unit="N", low=1e-9, high=1e5, signed=True, words="at the place floor m/s^2"),
        Parameter(name="frequency", unit="Hz", low=0.01, high=1000.0, role="shape", grid=(50.0, 60.0)),
    )

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        phase = 2 * np.pi * p["frequency"] * step.t
        return p["sine"] * np.sin(phase) + p["cosine"] * np.cos(phase) + 0.0 * z, memory


class Cogging(PortEffect):
    """The pull of a motor's magnets towards its teeth.

    The harmonic drive, gear or screw between motor and joint shortens the pitch at the joint. A pitch that is free follows
    the residue of many other causes, so a search tries the effect on request only.
    """

    is_on_request = True

    name = "cogging"
    family = "actuator-position"
    law = "F = a sin(2 pi z/p) + b cos(2 pi z/p)"
    words = "a force that repeats with the position: magnets over teeth of a motor, eccentric gears, errors of a screw"
    confirmed_by = "the joint moved slowly at two constant velocities: the force must repeat with the position"
    parameters: ClassVar = (
        Parameter(name="sine", unit="N", low=1e-6, high=1e4, signed=True),
        Parameter(name="cosine", unit="N", low=1e-6, high=1e4, signed=True),
        Parameter(
            name="pitch",
            unit="m",
            low=0.04,
            high=0.25,  # eight periods over the travel to both sides: few ones are a spring
            role="shape",
            reference="travel",
            grid=(0.25,),
            scan="pitch",
            words="position over which the force repeats",
        ),
    )
    needs = ("coil",)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        phase = 2 * np.pi * z / p["pitch"]
        return p["sine"] * np.sin(phase) + p["cosine"] * np.cos(phase), memory
