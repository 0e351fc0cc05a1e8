"""Base of all effects: description, family, parameters."""

from abc import ABC
from typing import Any, ClassVar, Literal

from vlab.physics.effect.parameter import Parameter, Values
from vlab.physics.family import FAMILIES, Family, register_family

Kind = Literal["port", "actuator", "sensor"]
OWN_SHARE = 0.1
"""OWN_SHARE [1]: smallest share of an element's stiffness at which a law describes the element itself."""


class Effect(ABC):
    """One effect of the catalogue.

    Class attributes give the description and the parameters. Subclasses of `PortEffect`, `LinearPortEffect`,
    `ActuatorEffect` and `SensorEffect` give the law. A user's own effect is a subclass in a user's file.
    """

    name: ClassVar[str]
    family: ClassVar[str]
    kind: ClassVar[Kind]
    law: ClassVar[str]
    words: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    needs: ClassVar[tuple[str, ...]] = ()
    """Requirements on a place. For a port: ``"stiffness"`` (an elastic element), ``"coil"`` (an actuator along the
    port), ``"magnet"`` (an actuator, or no elastic element), ``"translation"`` or ``"rotation"``. ``"tension"``
    means the rows of a stretched bar, ``"servo"`` a position servo, ``"armature"`` an inertia of the servo's motor. For a sensor: ``"command"`` or ``"sensor"``, the
    kind of the picked-up signal."""
    probe: ClassVar[float] = 1.0
    """Amplitude at which the screening evaluates a law; small where the law is linear in small amplitudes only."""
    form_of: ClassVar[str] = ""
    """Name of the effect of which this class is another form; reports use that name."""
    confirmed_by: ClassVar[str] = ""
    """Measurement that confirms a finding which needs no fit; "" for none."""
    lasts: ClassVar[bool] = False
    """Whether an event leaves a permanent change. A run that begins after the event, from the motion at that time, need
    not show the change. The law's amplitude is then a stiffness of the changed element."""
    is_linear: ClassVar[bool] = False
    """Whether the effect adds mass, damping or stiffness."""
    response: ClassVar[Literal["any", "linear", "none"]] = "any"
    """Dependence of a port's force on the port's motion. ``"linear"``: force and memory are linear in motion and memory,
    the same at all times and under every command. ``"none"``: the force depends on time alone. Both kinds are simulated
    much faster than ``"any"``."""
    is_fast: ClassVar[bool] = False
    """Whether the law moves faster than samples, so that the search takes several steps a sample."""
    picks_up: ClassVar[bool] = False
    """Whether a sensor effect picks up a second signal."""
    numbers: ClassVar[tuple[str, ...]] = ()
    """Fields of `vlab.physics.servo.Servo` that the law also takes as values, where a calibration changes them:
    ``servo.NAME`` for the servo, ``model.NAME`` for the simulated model to which the force is added."""
    simulated_by: ClassVar[tuple[str, ...]] = ("stepper",)
    """Methods that a simulation calls."""
    sought_at: frozenset[str] | None = None
    """Names of the places at which alone the effect is sought, with or without their kind; None for all places."""
    is_last_resort: ClassVar[bool] = False
    """Whether the effect is tried only where no other effect explains the recordings."""
    is_on_request: ClassVar[bool] = False
    """Whether a search tries the effect only if the user names it, because it takes up the residue of many causes."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        own: Any = cls.__dict__.get("family")
        if isinstance(own, Family):  # a family that the effect's own file defines
            register_family(own)
            cls.family = own.name

    @property
    def traits(self) -> Family:
        """Family of the effect; an unknown family has no traits."""
        return FAMILIES.get(self.family, Family(name=self.family))

    @property
    def acts_in_drive(self) -> bool:
        """Whether a sensor of the actuator's force reads the effect."""
        return self.kind == "actuator" or "servo" in self.needs or "coil" in self.needs

    @property
    def needs_rest(self) -> bool:
        """Whether the law needs an element with a position of rest."""
        return self.traits.needs_rest or "magnet" in self.needs

    @property
    def is_force(self) -> bool:
        """Whether the effect is a force, not an added impedance."""
        return self.kind == "port" and not self.is_linear

    @property
    def is_in_servo(self) -> bool:
        """Whether the effect acts within a position servo's loop."""
        return "servo" in self.needs

    @property
    def has_state(self) -> bool:
        """Whether the law remembers the motion."""
        return False

    @property
    def physics(self) -> str:
        """Name in reports, shared by all forms of an effect."""
        return self.form_of or self.name

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        """Parameters that the screening tries on a grid."""
        return tuple(p for p in self.parameters if p.role == "shape")

    @property
    def amplitudes(self) -> tuple[Parameter, ...]:
        """Parameters in which the law is linear."""
        return tuple(p for p in self.parameters if p.role == "amplitude")

    def taken(self, p: Values, h: float) -> Values:
        """Return parameter values as the law uses them.

        Most laws use `p` unchanged; a law with discrete values rounds `p`.

        Parameters
        ----------
        p : Values
            Parameter values.
        h : float
            Sample period [s].
        """
        return p

    def parameter(self, name: str) -> Parameter:
        """Return a parameter by name."""
        return next(p for p in self.parameters if p.name == name)

    def of_element(self, p: Values, stiffness: float) -> dict[str, float] | None:
        """Return values of a law that takes an element's whole stiffness.

        In large motion the law with these values acts like the law with `p`.

        Parameters
        ----------
        p : Values
            Parameter values.
        stiffness : float
            Stiffness of the elastic element [N/m or N m/rad].

        Returns
        -------
        dict of str to float or None
            Parameter values; None for a law without such a form.
        """
        return None

    def is_meant(self, p: Values, stiffness: float) -> bool:
        """Return whether fitted values agree with the effect's description.

        Parameters
        ----------
        p : Values
            Fitted parameter values.
        stiffness : float
            Stiffness of the element at the place, 0 without one [N/m or N m/rad].
        """
        return True
