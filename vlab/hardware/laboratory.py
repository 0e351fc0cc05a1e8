"""The description of the laboratory's hardware."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from vlab.assets import asset
from vlab.errors import BadExperiment
from vlab.schema import Reader, number


@dataclass(frozen=True, kw_only=True)
class Converter:
    """ADC, array processor, DAC with zero-order hold, and the RC low-pass behind it.

    Parameters
    ----------
    rate : float
        Samples per second [Hz].
    delay_samples : float
        From a sample to its output, in sample periods; the hold comes on top.
    filter_corner : float
        Corner of the RC low-pass [Hz]; 0 for none.
    resolution : float
        Quantisation step of the sampled velocities [m/s]; 0 for none.
    """

    rate: float = number("Hz", positive=True)
    lowest_rate: float = number("Hz", positive=True)
    highest_rate: float = number("Hz", positive=True)
    delay_samples: float = number("1", at_least=0.0)
    filter_corner: float = number("Hz", at_least=0.0)
    resolution: float = number("m/s", default=0.0, at_least=0.0)

    def __post_init__(self) -> None:
        if not self.lowest_rate <= self.rate <= self.highest_rate:
            raise BadExperiment(
                f"the rate {self.rate:g} Hz is outside the converter's {self.lowest_rate:g} to {self.highest_rate:g} Hz"
            )


@dataclass(frozen=True, kw_only=True)
class VelocitySensor:
    """A coil in an annular magnet: its gain falls once the coil leaves the linear travel.

    Parameters
    ----------
    linear_range : float
        Full travel over which the gain is constant [m].
    noise : float
        White noise at the samples, rms [m/s].
    """

    linear_range: float = number("m", positive=True)
    noise: float = number("m/s", default=0.0, at_least=0.0)


@dataclass(frozen=True, kw_only=True)
class DisplacementProbe:
    """A non-contacting displacement probe.

    Parameters
    ----------
    sensitivity : float
        Output per displacement [V/m].
    noise : float
        White noise at the samples, rms [m].
    """

    sensitivity: float = number("V/m", positive=True)
    noise: float = number("m", default=0.0, at_least=0.0)


@dataclass(frozen=True, kw_only=True)
class ForceCoil:
    """A force coil and its power amplifier.

    Parameters
    ----------
    current_controlled : bool
        With a controlled current the coil's own voltage has no effect; without it the coil brakes itself by
        force_constant^2 / resistance.
    limit : float
        Largest force of the amplifier [N]; 0 for none.
    """

    force_constant: float = number("N/A", positive=True)
    resistance: float = number("ohm", positive=True)
    limit: float = number("N", default=0.0, at_least=0.0)
    current_controlled: bool = True

    @property
    def back_emf_damping(self) -> float:
        """Viscous damping by the coil's own voltage [N s/m]; zero with a controlled current."""
        return 0.0 if self.current_controlled else self.force_constant**2 / self.resistance


@dataclass(frozen=True, kw_only=True)
class Hardware:
    """All of it."""

    format: Literal["vlab-hardware-1"] = "vlab-hardware-1"
    converter: Converter
    velocity_sensor: VelocitySensor
    displacement_probe: DisplacementProbe
    coil: ForceCoil

    def at_rate(self, rate_hz: float) -> "Hardware":
        """Return the same hardware sampling at another rate."""
        return replace(self, converter=replace(self.converter, rate=rate_hz))


def load_hardware(path: Path | str | None = None) -> Hardware:
    """Load the hardware description; the laboratory's own by default."""
    reader = Reader(asset("laboratory.toml") if path is None else path)
    return reader.table(Hardware, reader.load())
