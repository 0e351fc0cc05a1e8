"""The description of the laboratory's hardware."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_type_hints

from vlab.errors import BadExperiment, unknown_name
from vlab.files.assets import asset
from vlab.files.toml import Reader, number

_VALUE = re.compile(r"^\s*(\w+)\.(\w+)\s*=\s*(true|false|[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*$")
"""TABLE.KEY=VALUE, the unit behind it."""


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
        Quantisation step of the inputs [V]; 0 for none. What it is in motion follows from a sensor's sensitivity.
    """

    rate: float = number("Hz", positive=True)
    lowest_rate: float = number("Hz", positive=True)
    highest_rate: float = number("Hz", positive=True)
    delay_samples: float = number("1", at_least=0.0)
    filter_corner: float = number("Hz", at_least=0.0)
    resolution: float = number("V", default=0.0, at_least=0.0)

    def __post_init__(self) -> None:
        if not self.lowest_rate <= self.rate <= self.highest_rate:
            raise BadExperiment(
                f"the rate {self.rate:g} Hz is outside the converter's {self.lowest_rate:g} to {self.highest_rate:g} Hz"
            )


@dataclass(frozen=True, kw_only=True)
class VelocitySensor:
    """A coil in an annular magnet: its gain falls once the coil leaves the linear travel.

    Its voltage Bl v reaches the converter through an operational amplifier at unit gain, which takes no current. Without
    that buffer the converter's own input loads the coil: a current flows, its force brakes the structure by
    Bl^2/(R + R_load), and of the voltage only R_load/(R + R_load) is left (section 5.1).

    Parameters
    ----------
    linear_range : float
        Full travel over which the gain is constant [m].
    noise : float
        White noise at the samples, rms [m/s].
    drift : float
        Standard deviation, over the sensors, of the rate at which their zeros wander [m/s^2].
    sensitivity : float
        Bl of the coil [V s/m].
    resistance : float
        R of the coil [ohm].
    buffered : bool
        Whether the operational amplifiers are there; the current into their megohm is neglected.
    unbuffered_load : float
        R_load, what the coil sees without them [ohm].
    """

    linear_range: float = number("m", positive=True)
    noise: float = number("m/s", default=0.0, at_least=0.0)
    drift: float = number("m/s^2", default=0.0, at_least=0.0)
    sensitivity: float = number("V s/m", default=5.0, positive=True)
    resistance: float = number("ohm", default=8.0, positive=True)
    buffered: bool = True
    unbuffered_load: float = number("ohm", default=600.0, positive=True)

    @property
    def back_emf_damping(self) -> float:
        """Viscous damping by the current that a missing buffer lets flow [N s/m]; zero with one."""
        return 0.0 if self.buffered else self.sensitivity**2 / (self.resistance + self.unbuffered_load)

    @property
    def signal_share(self) -> float:
        """What is left of the coil's voltage at the converter; one with a buffer."""
        return 1.0 if self.buffered else self.unbuffered_load / (self.resistance + self.unbuffered_load)


@dataclass(frozen=True, kw_only=True)
class Leads:
    """The wires from the coils: unshielded, they are antennas for the mains and for radio (section 5.1).

    Every lead picks both up with a phase of its own. The radio carrier is sampled as it stands, without a filter before the
    converter, and shows at the frequency that it is folded to.

    Parameters
    ----------
    mains, radio : float
        Voltage that an unshielded lead picks up, rms [V].
    mains_frequency, radio_frequency : float
        [Hz].
    """

    shielded: bool = True
    mains: float = number("V", at_least=0.0)
    mains_frequency: float = number("Hz", positive=True)
    radio: float = number("V", at_least=0.0)
    radio_frequency: float = number("Hz", positive=True)

    @property
    def carriers(self) -> tuple[tuple[float, float], ...]:
        """Amplitude [V] and frequency [Hz] of what is picked up; nothing on shielded leads."""
        both = ((self.mains, self.mains_frequency), (self.radio, self.radio_frequency))
        return () if self.shielded else tuple((2**0.5 * rms, hz) for rms, hz in both if rms > 0)


@dataclass(frozen=True, kw_only=True)
class DisplacementProbe:
    """A non-contacting displacement probe.

    Parameters
    ----------
    sensitivity : float
        Output per displacement [V/m].
    noise : float
        White noise at the samples, rms [m].
    drift : float
        Standard deviation, over the probes, of the rate at which their zeros wander [m/s].
    """

    sensitivity: float = number("V/m", positive=True)
    noise: float = number("m", default=0.0, at_least=0.0)
    drift: float = number("m/s", default=0.0, at_least=0.0)


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
    """All of it; leads, array controller and the faults of powering up are missing where a file does not describe them."""

    format: Literal["vlab-hardware-1"] = "vlab-hardware-1"
    converter: Converter
    velocity_sensor: VelocitySensor
    displacement_probe: DisplacementProbe
    coil: ForceCoil
    leads: Leads | None = None
    array: ArraySize | None = None
    power_up: PowerUpFaults | None = None

    def at_rate(self, rate_hz: float) -> "Hardware":
        """Return the same hardware sampling at another rate."""
        return replace(self, converter=replace(self.converter, rate=rate_hz))


def load_hardware(path: Path | str | None = None, values: Sequence[str] = ()) -> Hardware:
    """Load the hardware description; the laboratory's own by default.

    Parameters
    ----------
    values : sequence of str
        Other values for single numbers and switches: ``leads.shielded=false``, ``coil.limit=0.2lbf``. Without a unit, SI.

    Raises
    ------
    BadStructure
        A file that is malformed, or a value that it would not accept.
    BadExperiment
        A text that has not this form.
    """
    reader = Reader(asset("laboratory.toml") if path is None else path)
    content = reader.load()
    for text in values:
        _put(content, text)
    return reader.table(Hardware, content)


def _put(content: dict[str, Any], text: str) -> None:
    """Write one value into the content of a hardware file, as the file would spell it."""
    match = _VALUE.match(text)
    if match is None:
        raise BadExperiment(
            f"the hardware value {text!r} has not the form TABLE.KEY=VALUE, for example leads.shielded=false or "
            "velocity_sensor.noise=0.1mm/s"
        )
    name, key, value, unit = match.groups()
    tables = {field.name: field for field in fields(Hardware) if field.name != "format"}
    if name not in tables:
        raise unknown_name("hardware table", name, tables)
    hint = get_type_hints(Hardware)[name]
    kind = next(part for part in (*get_args(hint), hint) if part is not type(None))
    keys = {field.name: field for field in fields(kind)}
    if key not in keys:
        raise unknown_name("hardware value", key, keys, where=name)
    table = content.setdefault(name, {})
    if not isinstance(table, dict):
        return  # the reader refuses the file
    if value in ("true", "false"):
        table[key] = value == "true"
    elif "si" in keys[key].metadata:
        si = keys[key].metadata["si"]
        table[key] = {"value": float(value), "unit": unit or si, "origin": "assumed", "source": "given with the run"}
    else:
        table[key] = int(value) if value.lstrip("+-").isdigit() else float(value)
