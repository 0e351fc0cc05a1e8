"""Port forces with memory: micro-slip, hysteresis, friction states, drifting stiffness."""

from typing import Any, ClassVar

import numpy as np

from vlab.physics.effect import OWN_SHARE, Parameter, PortEffect, Step, Values, limited

RATES = (0.1, 1.0, 10.0)
"""RATES [1]: relaxation rates of the Maxwell elements of `StructuralDamping`, relative to the centre frequency."""
LOSS_AT_CENTRE = sum(r / (1 + r * r) for r in RATES)
"""Loss stiffness of the Maxwell elements at the centre frequency, for unit stiffness each: 0.698. Over the two
decades the loss stiffness stays between 0.607 and 0.698."""
STORED_AT_CENTRE = sum(1 / (1 + r * r) for r in RATES)
"""Storage stiffness of the Maxwell elements at the centre frequency; the law subtracts this stiffness."""


def zeros(states: int, shape: tuple[int, ...]) -> list[Any]:
    """Return a law's states at rest.

    Parameters
    ----------
    states : int
        Number of states.
    shape : tuple of int
        Shape of each state.

    Returns
    -------
    list of object
        Arrays, or plain floats for a single run.
    """
    return [np.zeros(shape) if shape else 0.0 for _ in range(states)]


class JenkinsSlip(PortEffect):
    """A spring in series with a Coulomb slider.

    The Jenkins element models micro-slip of a bolted joint and is the building block of Iwan's model [1]_.

    References
    ----------
    .. [1] W. D. Iwan, A distributed-element model for hysteresis and its steady-state dynamic response, Journal of
           Applied Mechanics 33 (1966) 893-900.
    """

    name = "jenkins-slip"
    family = "hysteresis"
    law = "dF/dt = -k v while |F| < Fs, F = +-Fs in slip"
    words = "micro-slip: a spring in series with a dry slider, as in bolted joints and clamps"
    parameters: ClassVar = (
        Parameter(name="force", unit="N", low=1e-8, high=1e6),
        Parameter(
            name="slip", unit="m", low=0.01, high=1.5, role="shape", reference="displacement", grid=(0.05, 0.2, 0.6)
        ),
    )

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """See `PortEffect`: the deflection of the spring in units of `slip`."""
        return zeros(1, shape)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        after = limited(memory[0] + v * step.h / p["slip"], 1.0)
        return -p["force"] * 0.5 * (memory[0] + after), [after]


SLIDERS, SPACING = 10, 1.7
"""SLIDERS [1]: sliders of `IwanSlip`, at least 2. Raising the number extends the power law to smaller amplitudes: 10
sliders cover amplitudes from 1/119 of the limit.
SPACING [1]: ratio of neighbouring slider limits of `IwanSlip`, above 1. Raising the ratio extends the power law, and
its ripple: at 1.7 the loss per cycle follows the power law to 5 % rms."""
_LOG_SPACING = float(np.log(SPACING))
SPANS = tuple(SPACING ** (j + 1 - SLIDERS) for j in range(SLIDERS))
"""SPANS [1]: upper ends of the ranges of limits that one slider of `IwanSlip` stands for, over the largest limit."""


class IwanSlip(PortEffect):
    """Sliders in parallel with a power-law distribution of limits.

    The model of a joint in micro-slip has the density of limits rho(x) = (1 + a) F0/d (x/d)^(a - 1) for 0 < x < d
    [1]_, [2]_. The exponent a is 1 + chi of [2]_, without the jump at d. First loading gives the force F0 ((1 + a) s -
    s^(1 + a))/a with s = |z|/d <= 1, and F0 beyond. Reversals follow Masing's rule. A cycle of amplitude A <= d loses
    the energy 4 F0 d (A/d)^(2 + a)/(2 + a), and the secant stiffness is F0 ((1 + a) - (A/d)^a)/(a d).

    A slider stands for all limits of a range, with their stiffness and their force. The first loading is exact at the
    ends of the ranges.

    References
    ----------
    .. [1] W. D. Iwan, A distributed-element model for hysteresis and its steady-state dynamic response, Journal of
           Applied Mechanics 33 (1966) 893-900.
    .. [2] D. J. Segalman, A four-parameter Iwan model for lap-type joints, Journal of Applied Mechanics 72 (2005)
           752-760.
    """

    name = "iwan-slip"
    family = "hysteresis"
    law = "first loading F = -F0 ((1 + a) s - s^(1 + a))/a sgn(z), s = |z|/d up to 1; reversals by Masing's rule"
    words = (
        "micro-slip that spreads over a contact: losses grow with a power of the amplitude, as in bolted and lap joints"
    )
    parameters: ClassVar = (
        Parameter(name="force", unit="N", low=1e-8, high=1e6, words="at which the whole contact slips"),
        Parameter(
            name="limit", unit="m", low=0.05, high=10.0, role="shape", reference="displacement", grid=(0.3, 1.0, 4.0),
            words="deflection at which the whole contact slips",
        ),
        Parameter(
            name="exponent", unit="1", low=0.1, high=2.0, role="shape", grid=(0.3, 1.0),
            words="the loss per cycle grows with the amplitude to the power 2 + a",
        ),
    )  # fmt: skip

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """See `PortEffect`: the places of the sliders.

        A run that begins in the middle of a motion begins on the first loading from rest.
        """
        return zeros(SLIDERS, shape)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`: displacements in a unit in which the limits are `SPANS`."""
        q = np.exp(-_LOG_SPACING * p["exponent"])
        first, unit = _slider_units(p["exponent"], q)
        at = z / (p["limit"] * unit)
        stretch = limited(at - memory[0], first * SPANS[0])
        total, after = stretch / (1.0 - q), [at - stretch]
        for span, place in zip(SPANS[1:], memory[1:], strict=True):
            stretch = limited(at - place, span)
            total = total * q + stretch
            after.append(at - stretch)
        return -p["force"] * (1.0 - q / SPACING) * total, after

    @staticmethod
    def sliders(p: Values) -> list[tuple[float, float]]:
        """Return the law as springs in series with dry sliders.

        Parameters
        ----------
        p : Values
            Parameter values.

        Returns
        -------
        list of tuple of (float, float)
            Stiffness [N/m] and deflection at slip [m] of every slider.
        """
        q = SPACING ** -float(p["exponent"])
        first, unit = _slider_units(float(p["exponent"]), q)
        limits = [p["limit"] * unit * span for span in (first * SPANS[0], *SPANS[1:])]
        weights = [(1.0 - q / SPACING) * q ** (SLIDERS - 1 - j) for j in range(SLIDERS)]
        weights[0] /= 1.0 - q
        return [(p["force"] * w / (p["limit"] * unit), x) for w, x in zip(weights, limits, strict=True)]


def _slider_units(exponent: Any, q: Any) -> tuple[Any, Any]:
    """Return the finest slider's relative limit, and the unit of deflection.

    The unit is relative to the limit of the whole contact. The finest slider stands for all limits down to zero. The
    ratio of force to stiffness of a range gives its slider's limit.
    """
    first = (1.0 - q) / (1.0 - q / SPACING)
    return first, exponent / ((1.0 + exponent) * first)


class BoucWen(PortEffect):
    """Smooth hysteresis of wire rope, foams and joints.

    The hysteretic variable s follows Bouc [1]_ and Wen [2]_ with exponent 2, beta = gamma = 1/2 and unit limit.

    References
    ----------
    .. [1] R. Bouc, Forced vibration of mechanical systems with hysteresis, Proc. 4th Conference on Nonlinear
           Oscillation, Prague, 1967.
    .. [2] Y.-K. Wen, Method for random vibration of hysteretic systems, Journal of the Engineering Mechanics Division
           102 (1976) 249-263.
    """

    name = "bouc-wen"
    family = "hysteresis"
    law = "F = -F0 s, ds/dt = (v - 0.5 |v| |s|^(n-1) s - 0.5 v |s|^n)/d, n = 2"
    words = "smooth hysteresis without a clear limit, as in wire ropes, foams and joints of many parts"
    parameters: ClassVar = (
        Parameter(name="force", unit="N", low=1e-8, high=1e6),
        Parameter(
            name="yield", unit="m", low=0.02, high=2.0, role="shape", reference="displacement", grid=(0.1, 0.3, 1.0)
        ),
    )

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """See `PortEffect`: the hysteretic variable."""
        return zeros(1, shape)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`: integrated by the midpoint rule."""

        def rate(s: Any) -> Any:
            return v - 0.5 * abs(v) * abs(s) * s - 0.5 * v * s * s

        s, h = memory[0], step.h / p["yield"]
        after = limited(s + h * rate(limited(s + 0.5 * h * rate(s), 1.5)), 1.5)
        return -p["force"] * 0.5 * (s + after), [after]


class LooseningStiffness(PortEffect):
    """Stiffness drift of a loosening joint or warming cable."""

    name = "drifting-stiffness"
    family = "time-variation"
    law = "F = -r t z"
    words = (
        "the stiffness drifts during the recording: a joint that loosens, a cable whose tension follows the temperature"
    )
    parameters: ClassVar = (
        Parameter(name="rate", unit="N/m/s", low=1e-6, high=1e6, signed=True, words="stiffness gained per second"),
    )

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        return -p["rate"] * step.t * z, memory


class LuGreFriction(PortEffect):
    """Dry friction with elastic bristles [1]_.

    References
    ----------
    .. [1] C. Canudas de Wit, H. Olsson, K. J. Astrom and P. Lischinsky, A new model for control of systems with
           friction, IEEE Transactions on Automatic Control 40 (1995) 419-425.
    """

    name = "lugre-friction"
    family = "friction"
    law = "F = -Fc x, dx/dt = (v - |v| x/g)/d, g = 1 + s exp(-(v/vs)^2)"
    words = "dry friction with elastic presliding and a larger force near rest: bristles that bend before they slip"
    parameters: ClassVar = (
        Parameter(name="force", unit="N", low=1e-8, high=1e5),
        Parameter(
            name="bristle", unit="m", low=1e-3, high=0.5, role="shape", reference="displacement", grid=(0.01, 0.06),
            words="deflection at which the force of sliding is reached",
        ),
        Parameter(name="excess", unit="1", low=0.01, high=2.0, role="shape", grid=(0.5,), words="of the force at rest"),
        Parameter(name="speed", unit="m/s", low=0.002, high=0.5, role="shape", reference="velocity", grid=(0.05,)),
    )  # fmt: skip

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """See `PortEffect`: the bristles' deflection in units of `bristle`."""
        return zeros(1, shape)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`: exact for constant velocity over the step."""
        top = 1.0 + p["excess"] * np.exp(-limited((v / p["speed"]) ** 2, 700.0))
        slide = abs(v) * step.h / (p["bristle"] * top)
        kept = np.exp(-slide)
        after = memory[0] * kept + top * np.sign(v) * (1.0 - kept)
        return -p["force"] * 0.5 * (memory[0] + after), [after]


class PlasticSet(PortEffect):
    """An element that yields and stays bent."""

    name = "plastic-set"
    family = "hysteresis"
    law = "F = +k s, ds = what |z - s| exceeds the yield by: the element's spring ends where it was left"
    words = "an elastic element yields beyond a deflection and does not come back all the way: an offset after an event"
    parameters: ClassVar = (
        Parameter(name="stiffness", unit="N/m", low=1e-3, high=1e8, words="of the element that yields"),
        Parameter(name="yield", unit="m", low=0.1, high=0.99, role="shape", reference="displacement", grid=(0.5, 0.8)),
    )
    needs = ("stiffness",)
    lasts = True

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """See `PortEffect`: the plastic set."""
        return zeros(1, shape)

    def is_meant(self, p: Values, stiffness: float) -> bool:
        """See `PortEffect`: a small yielding share is micro-slip."""
        return p["stiffness"] >= OWN_SHARE * stiffness

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`."""
        after = z - limited(z - memory[0], p["yield"])
        return p["stiffness"] * after, [after]


class AttachedOscillator(PortEffect):
    """A mass that swings on a spring.

    Examples: a cable's own mode, a lead, a loose part, a tuned mass.
    """

    name = "attached-oscillator"
    family = "substructure"
    response = "linear"
    law = "F = -m x'', x'' = w^2 (z - x) + 2 D w (v - x')"
    words = "something with a resonance of its own swings along: a cable's transverse mode, a lead, a loose part"
    parameters: ClassVar = (
        Parameter(name="mass", unit="kg", low=1e-6, high=1e3),
        Parameter(
            name="frequency",
            unit="Hz",
            low=0.05,
            high=500.0,
            role="shape",
            grid=(1.0, 3.0, 10.0, 30.0),
            scan="resonance",
        ),
        Parameter(name="damping_ratio", unit="1", low=1e-4, high=0.5, role="shape", grid=(0.01, 0.04)),
    )

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """See `PortEffect`: deflection against the port, and velocity."""
        return zeros(2, shape)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`: semi-implicit steps with the damper at mid-step."""
        w, h = 2 * np.pi * p["frequency"], step.h
        relative, speed = memory[0] + 0.5 * h * (v - memory[1]), memory[1]
        c = p["damping_ratio"] * w * h
        after = (speed * (1 - c) + h * w * w * relative + 2 * c * v) / (1 + c)
        acceleration = (after - speed) / h
        return -p["mass"] * acceleration, [memory[0] + h * (v - 0.5 * (speed + after)), after]


class StructuralDamping(PortEffect):
    """Frequency-independent loss in material and joints.

    Three Maxwell elements, one decade apart, approximate a constant loss factor over two decades.
    """

    name = "structural-damping"
    family = "damping"
    response = "linear"
    law = "K(1 + j eta) about the centre frequency: three Maxwell elements, loss constant to 7 % over two decades"
    words = "energy is lost per cycle whatever the frequency, as in materials and bolted joints (loss factor)"
    parameters: ClassVar = (
        Parameter(name="loss", unit="N/m", low=1e-6, high=1e7, words="loss factor times the element's stiffness"),
        Parameter(name="centre", unit="Hz", low=0.05, high=500.0, role="shape", grid=(5.0,)),
    )

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """See `PortEffect`: the dashpots' deflections."""
        return zeros(len(RATES), shape)

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`: exact for constant deflection over the step.

        The added stiffness is zero at the centre frequency.
        """
        w = 2 * np.pi * p["centre"] * step.h
        after, total = [], -STORED_AT_CENTRE * z
        for rate, s in zip(RATES, memory, strict=True):
            end = z + (s - z) * np.exp(-rate * w)
            after.append(end)
            total = total + z - 0.5 * (s + end)
        return -p["loss"] / LOSS_AT_CENTRE * total, after
