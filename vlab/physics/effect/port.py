"""Effects at ports: forces, and added mass, damping and stiffness."""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

from vlab.physics.effect.base import Effect, Kind
from vlab.physics.effect.parameter import Values


class Step(NamedTuple):
    """Data of one integration step that a law may use.

    Parameters
    ----------
    h : float or array
        Length of the step [s].
    t : float or array
        Time at the middle of the step [s].
    mobility : float or array
        Velocity at the port after a unit force over the step [m/s/N].
    free_velocity : array or None
        Velocity at the end of the step without the effect's own force [m/s]; None if unknown.
    command : float or array
        Command of the actuator at the port, if any.
    first_velocity : array or None
        Velocity at the beginning of the step [m/s]; None if unknown.
    damped : float or None
        Share of the step's change of velocity on which the damping of actuators acts, where mobility and free velocity
        leave that damping out: 0 explicit, 1 implicit. None if both include the damping.
    """

    h: Any
    t: Any = 0.0
    mobility: Any = 0.0
    free_velocity: Any = None
    command: Any = 0.0
    first_velocity: Any = None
    damped: float | None = None


class PortEffect(Effect):
    """A force along the coordinate of a port."""

    kind: ClassVar[Kind] = "port"
    simulated_by = ("memory", "force")

    @property
    def has_state(self) -> bool:
        """Whether the law remembers the motion."""
        return self.memory((1,)) is not None

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """Return the law's memory at rest.

        Parameters
        ----------
        shape : tuple of int
            Shape of each state.

        Returns
        -------
        list of object or None
            One array a state; None for a law without memory.
        """
        return None

    @abstractmethod
    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """Return the force along the port and the new memory.

        Parameters
        ----------
        z, v : float or array
            Displacement of the port from rest, and velocity, at the middle of the step.
        p : mapping
            Parameter values.
        step : Step
            Data of the step.
        memory : list or None
            Result of `memory` or of the last call.

        Returns
        -------
        tuple of (object, object)
            Force on the structure [N or N m], and the memory after the step.
        """


class LinearPortEffect(Effect):
    """Mass, damping and stiffness added at a port."""

    kind: ClassVar[Kind] = "port"
    is_linear: ClassVar[bool] = True

    @abstractmethod
    def impedance(self, p: Values, own_stiffness: Any) -> tuple[Any, Any, Any]:
        """Return the added mass, damping and stiffness.

        Parameters
        ----------
        p : Values
            Parameter values.
        own_stiffness : float
            Stiffness of the elastic element at the port, if any [N/m or N m/rad].

        Returns
        -------
        tuple of (object, object, object)
            Mass [kg], damping [N s/m], stiffness [N/m], or their rotational counterparts.
        """
