"""Linear effects at a port: missing mass, stiffness and damping."""

from typing import Any, ClassVar

from vlab.physics.effect import LinearPortEffect, Parameter, Values


class AddedMass(LinearPortEffect):
    """Mass of wires, targets, fittings or entrained air."""

    name = "added-mass"
    family = "mass"
    law = "F = -m a"
    words = "mass that the model does not have: wires, sensor targets, fittings, air that moves along"
    parameters: ClassVar = (Parameter(name="mass", unit="kg", low=1e-5, high=1e3, words="mass added"),)
    needs = ("translation",)

    def impedance(self, p: Values, own_stiffness: Any) -> tuple[Any, Any, Any]:
        """See `LinearPortEffect`."""
        return p["mass"], 0.0, 0.0


class RotaryInertia(LinearPortEffect):
    """Rotary inertia of a coil or a sensor's arm."""

    name = "rotary-inertia"
    family = "mass"
    law = "M = -J alpha"
    words = "rotary inertia that the model does not have: a coil, a fitting or a sensor's arm that turns along"
    parameters: ClassVar = (Parameter(name="inertia", unit="kg m^2", low=1e-9, high=1e3, words="inertia added"),)
    needs = ("rotation",)

    def impedance(self, p: Values, own_stiffness: Any) -> tuple[Any, Any, Any]:
        """See `LinearPortEffect`."""
        return p["inertia"], 0.0, 0.0


class TensionError(LinearPortEffect):
    """Cable tension that differs from the drawing."""

    name = "tension-error"
    family = "stiffness"
    law = "F = +d(T w')/dx along the bar, T/L w at its cables"
    words = "the cables pull more or less than the model says, so all lateral stiffness that comes of tension is off"
    parameters: ClassVar = (
        Parameter(name="tension", unit="N", low=1e-3, high=1e4, signed=True, words="tension added"),
    )
    needs = ("tension",)

    def impedance(self, p: Values, own_stiffness: Any) -> tuple[Any, Any, Any]:
        """See `LinearPortEffect`; on every row of the place."""
        return 0.0, 0.0, p["tension"]


class LostStiffness(LinearPortEffect):
    """Softening by a crack, a splice or a clamp."""

    name = "lost-stiffness"
    family = "stiffness"
    law = "F = +r k z, k the element's own stiffness"
    words = "an element is softer than drawn: a crack, a loose splice, a clamp or joint that gives"
    parameters: ClassVar = (
        Parameter(name="share", unit="1", low=0.005, high=0.95, words="share of the stiffness lost"),
    )
    needs = ("stiffness",)

    def impedance(self, p: Values, own_stiffness: Any) -> tuple[Any, Any, Any]:
        """See `LinearPortEffect`."""
        return 0.0, 0.0, -p["share"] * own_stiffness


class StiffnessToGround(LinearPortEffect):
    """Stiffness of a lead, wire or omitted pendulum."""

    name = "stiffness-to-ground"
    family = "stiffness"
    law = "F = -k z"
    words = "something holds the structure there: a lead, a wire, a pendulum stiffness that was left out"
    parameters: ClassVar = (Parameter(name="stiffness", unit="N/m", low=1e-3, high=1e7, words="stiffness added"),)

    def impedance(self, p: Values, own_stiffness: Any) -> tuple[Any, Any, Any]:
        """See `LinearPortEffect`."""
        return 0.0, 0.0, p["stiffness"]


class NegativeStiffness(LinearPortEffect):
    """Magnetic attraction away from the centre position."""

    name = "magnetic-negative-stiffness"
    family = "stiffness"
    law = "F = +k z"
    words = "a magnet pulls the moving part away from its centre"
    parameters: ClassVar = (Parameter(name="stiffness", unit="N/m", low=1e-3, high=1e7, words="stiffness taken away"),)
    needs = ("magnet",)

    def impedance(self, p: Values, own_stiffness: Any) -> tuple[Any, Any, Any]:
        """See `LinearPortEffect`."""
        return 0.0, 0.0, -p["stiffness"]


class ViscousDamping(LinearPortEffect):
    """Viscous damping by eddy currents, back-EMF or lubrication."""

    name = "viscous-damping"
    family = "damping"
    law = "F = -c v"
    words = "energy is lost in proportion to the velocity there: eddy currents, back-EMF of a coil, a lubricated guide"
    parameters: ClassVar = (Parameter(name="damping", unit="N s/m", low=1e-6, high=1e6, words="damping added"),)

    def impedance(self, p: Values, own_stiffness: Any) -> tuple[Any, Any, Any]:
        """See `LinearPortEffect`."""
        return 0.0, p["damping"], 0.0
