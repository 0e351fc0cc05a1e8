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
class ArraySize:
    """What the array controller's matrix has room for.

    Parameters
    ----------
    inputs, outputs, states : int
        Channels from sensors and to actuators, and internal states.
    """

    inputs: int
    outputs: int
    states: int
    source: str = ""

    def __post_init__(self) -> None:
        if min(self.inputs, self.outputs) < 1 or self.states < 0:
            raise BadExperiment("an array needs at least one input and one output, and no negative number of states")


@dataclass(frozen=True, kw_only=True)
class PowerUpFaults:
    """What goes wrong when the equipment is switched on in a wrong order (section 5.4.2).

    A coil under direct current warms to the first order: C dT/dt = I^2 R - T/R_th, T its rise above the room.

    Parameters
    ----------
    direct_current : float
        In a coil, from an array controller that is on without its control program [A].
    thermal_resistance : float
        R_th from coil to room [K/W].
    heat_capacity : float
        C of coil and former [J/K].
    trip_rise : float
        Rise at which the thermostat cuts the amplifier [K].
    starting_impulse : float
        Of a force coil whose amplifier is on while a computer starts [N s].
    unstable_noise : float
        Noise of velocity sensors whose operational amplifiers were disturbed, rms [m/s].
    """

    direct_current: float = number("A", positive=True)
    thermal_resistance: float = number("K/W", positive=True)
    heat_capacity: float = number("J/K", positive=True)
    trip_rise: float = number("K", positive=True)
    starting_impulse: float = number("N s", positive=True)
    unstable_noise: float = number("m/s", positive=True)


@dataclass(frozen=True, kw_only=True)
class Hardware:
    """All of it; the array controller and the faults of powering up are missing where a file does not describe them."""

    format: Literal["vlab-hardware-1"] = "vlab-hardware-1"
    converter: Converter
    velocity_sensor: VelocitySensor
    displacement_probe: DisplacementProbe
    coil: ForceCoil
    array: ArraySize | None = None
    power_up: PowerUpFaults | None = None

    def at_rate(self, rate_hz: float) -> "Hardware":
        """Return the same hardware sampling at another rate."""
        return replace(self, converter=replace(self.converter, rate=rate_hz))


def load_hardware(path: Path | str | None = None) -> Hardware:
    """Load the hardware description; the laboratory's own by default."""
    reader = Reader(asset("laboratory.toml") if path is None else path)
    return reader.table(Hardware, reader.load())
