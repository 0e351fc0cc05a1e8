"""Choices of a structure's models: discretisation, reduction and tuned values."""

from dataclasses import dataclass

from vlab.errors import BadStructure
from vlab.files.toml import number


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Tuned values of a plant's first coil-driven modes.

    No mesh has every frequency to one part in a thousand, which light damping makes visible. A coarse mesh also rotates
    the shapes of close modes.

    Parameters
    ----------
    frequencies : tuple of float
        Factors on the first frequencies, from a test of the structure; shapes stay.
    of_fe : int
        Number of first modes of the physical plant with frequencies and shapes of the FE model, before the factors.
    at_step : float
        Integration step [s] in which the modes have their frequencies. Steps of length h raise omega by the relative
        amount (omega h)^2/24, which exceeds the width of a lightly damped resonance. 0 for the equations of motion.
    beside : tuple of float
        Offset of the sensors from their points along the bars [m], in channel order (coil sensors, then probes), as
        estimated from the FE model's modes.
    coils_beside : tuple of float
        Offset of the coils' forces from their points along the bars [m], in the order of the coils.
    """

    frequencies: tuple[float, ...] = number("1", positive=True, default=())
    of_fe: int = 0
    at_step: float = number("s", default=0.0, at_least=0.0)
    beside: tuple[float, ...] = number("m", default=())
    coils_beside: tuple[float, ...] = number("m", default=())

    def __post_init__(self) -> None:
        if self.of_fe < 0:
            raise BadStructure(f"of_fe = {self.of_fe} is no number of modes; it must be 0 or more")
        for key, what in (("beside", "sensors'"), ("coils_beside", "coils'")):
            if getattr(self, key) and not self.of_fe:
                raise BadStructure(
                    f"{key} tells {what} places in the FE model's modes; say with of_fe how many these are"
                )


@dataclass(frozen=True, kw_only=True)
class Reduction:
    """Retained coordinates of a structure's reduced models.

    Parameters
    ----------
    retained : tuple of str
        FE coordinates such as ``"v:joint1"`` or ``"rx:point13"``.
    source : str
        Source of the choice.
    exact : tuple of str
        Coordinates of the exact reduction; empty for the same.
    exact_modes : tuple of int
        Modes of the exact reduction, from 1; empty for the lowest.
    exact_source : str
        Source of the exact reduction's choices.
    """

    retained: tuple[str, ...]
    source: str
    exact: tuple[str, ...] = ()
    exact_modes: tuple[int, ...] = ()
    exact_source: str = ""


@dataclass(frozen=True, kw_only=True)
class Variant:
    """Discretisation of a structure's model.

    Parameters
    ----------
    elements_per_span : int
        Beam elements between neighbouring points of a bar.
    one_mode_bar : str
        Bar represented by its first symmetric mode, with tip deflection as coordinate.
    in_plane_moments : bool
        Whether in-plane bending moments of gravity act on the out-of-plane motion.
    moment_boundary_factor : float
        Factor of the boundary term of the moments' geometric stiffness: 0.5 for invariance to rigid rotation
        (semitangential end moments), 1 for a plate strip.
    """

    note: str = ""
    elements_per_span: int = 1
    one_mode_bar: str = ""
    in_plane_moments: bool = False
    moment_boundary_factor: float = 0.5

    def __post_init__(self) -> None:
        if not 1 <= self.elements_per_span <= 200:
            raise BadStructure(f"elements_per_span is {self.elements_per_span}; accepted: 1 to 200")
