"""Power-up of the laboratory: order of section 5.4.2 and faults."""

from dataclasses import dataclass, replace
from typing import Literal, NoReturn

import numpy as np

from vlab.errors import BadExperiment, unknown_name
from vlab.hardware.laboratory import Hardware, PowerUpFaults

Equipment = Literal["computers", "software", "array", "control", "amplifiers", "op-amps"]
ORDER: dict[Equipment, str] = {
    "computers": "the two computer systems",
    "software": "their application software, on line",
    "array": "the array controller's power",
    "control": "its control program, running",
    "amplifiers": "the power amplifiers of the force coils",
    "op-amps": "the power supply of the sensors' operational amplifiers",
}
"""Equipment in the right order of power-up, with descriptions."""
NEEDS: dict[Equipment, tuple[Equipment, ...]] = {"software": ("computers",), "control": ("software", "array")}
"""Equipment required by a step; any other step can be taken in a wrong order."""
STARTS: tuple[Equipment, ...] = ("computers",)
"""Equipment with large transients at its start."""

PAUSE = 60.0
"""PAUSE [s]: assumed time between two steps of a given order; the text has no value."""

FaultKind = Literal["starting-impulse", "coil-tripped", "unstable-sensors"]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault during power-up.

    Parameters
    ----------
    time : float
        Time since the first switch [s].
    value : float
        Impulse [N s] of a starting transient, temperature rise [K] of a tripped coil, or noise [m/s] of unstable
        sensors.
    words : str
        Event and cause in one line.
    """

    kind: FaultKind
    time: float
    value: float
    words: str


class PowerUp:
    """Power switches of the bench.

    Parameters
    ----------
    hardware : Hardware
        Hardware with a table [power_up].
    interlocked : bool
        Whether a wrong step is refused. Without the interlock a wrong step causes the described fault.

    Raises
    ------
    BadExperiment
        The hardware has no description of faults.
    """

    def __init__(self, hardware: Hardware, *, interlocked: bool = True) -> None:
        if hardware.power_up is None:
            raise BadExperiment(
                "this hardware does not say what powering up can do; add a table [power_up] to its file"
            )
        self._hardware, self._facts, self.interlocked = hardware, hardware.power_up, interlocked
        self._on: set[Equipment] = set()
        self.time, self.coil_rise = 0.0, 0.0
        self._tripped = self._unstable = False
        self.faults: list[Fault] = []

    @property
    def on(self) -> tuple[Equipment, ...]:
        """Active equipment in the right order."""
        return tuple(step for step in ORDER if step in self._on)

    @property
    def is_ready(self) -> bool:
        """Whether an experiment can run.

        All equipment is on, no coil is tripped, and the sensors are quiet.
        """
        return len(self._on) == len(ORDER) and not self._tripped and not self._unstable

    @property
    def is_tripped(self) -> bool:
        """Whether a coil's thermostat holds the amplifiers off."""
        return self._tripped

    @property
    def next_step(self) -> Equipment | None:
        """Next equipment to switch on; None at the end."""
        return next((step for step in ORDER if step not in self._on), None)

    @property
    def coil_current(self) -> float:
        """Direct current in every coil [A].

        An array without its program drives the current through live amplifiers.
        """
        driven = {"array", "amplifiers"} <= self._on and "control" not in self._on and not self._tripped
        return self._facts.direct_current if driven else 0.0

    @property
    def coil_force(self) -> float:
        """Static force of every coil on the structure [N]."""
        return self.coil_current * self._hardware.coil.force_constant

    def switch_on(self, step: str) -> None:
        """Switch one item on.

        Parameters
        ----------
        step : str
            Equipment, a name of `ORDER`.

        Raises
        ------
        UnknownName
            No such equipment.
        BadExperiment
            The item cannot run yet, is on already, or the interlock refuses.
        """
        what = _equipment(step)
        if what in self._on:
            _refuse(f"{ORDER[what]} are on already" if what != "array" else "the array controller is on already")
        missing = [need for need in NEEDS.get(what, ()) if need not in self._on]
        if missing:
            _refuse(f"{what!r} cannot run before {missing[0]!r} is on")
        if self.interlocked and what != self.next_step:
            _refuse(f"{what!r} was asked for, the interlock allows {self.next_step!r} next (order: {', '.join(ORDER)})")
        if what == "amplifiers" and self._tripped:
            _refuse(
                f"a coil is still {self.coil_rise:.0f} K above the room; the thermostat lets go below half of {self._facts.trip_rise:g} K"
            )
        self._disturb(what, "on")
        self._on.add(what)
        if what in STARTS and "amplifiers" in self._on:
            impulse = self._facts.starting_impulse
            self._fault(
                "starting-impulse",
                impulse,
                f"{ORDER[what]} started while the amplifiers were on: an impulse of {impulse:g} N s went to the structure",
            )

    def switch_off(self, step: str) -> None:
        """Switch one item off, with its dependants.

        Parameters
        ----------
        step : str
            Equipment, a name of `ORDER`.

        Raises
        ------
        UnknownName
            No such equipment.
        BadExperiment
            The item is off, or the interlock requires another step first.
        """
        what = _equipment(step)
        if what not in self._on:
            _refuse(f"{what!r} is off already")
        if self.interlocked and what != self.on[-1]:
            _refuse(f"{what!r} was asked for, the interlock switches {self.on[-1]!r} off first")
        self._on.discard(what)
        for other, needs in NEEDS.items():
            if what in needs and other in self._on:
                self.switch_off(other)
        if what == "op-amps":
            self._unstable = False
        self._disturb(what, "off")

    def wait(self, seconds: float) -> None:
        """Advance the time.

        Coils warm up or cool down, and a thermostat trips or resets.

        Parameters
        ----------
        seconds : float
            Duration [s].

        Raises
        ------
        BadExperiment
            The time is negative or not finite.
        """
        if not (np.isfinite(seconds) and seconds >= 0):
            raise BadExperiment(f"a wait of {seconds} s makes no sense; accepted: finite numbers from 0")
        facts = self._facts
        if self.coil_current > 0:
            until_trip = time_to_rise(facts, self._hardware.coil.resistance, self.coil_rise)
            if until_trip <= seconds:
                self.time += until_trip
                self.coil_rise, self._tripped = facts.trip_rise, True
                self._on.discard("amplifiers")
                self._fault(
                    "coil-tripped",
                    facts.trip_rise,
                    f"the array was on without its program: {facts.direct_current:g} A warmed the coils by {facts.trip_rise:g} K, and the thermostat cut the amplifiers",
                )
                self.wait(seconds - until_trip)
                return
        final = facts.thermal_resistance * self._hardware.coil.resistance * self.coil_current**2
        left = float(np.exp(-seconds / (facts.thermal_resistance * facts.heat_capacity)))
        self.coil_rise = final + (self.coil_rise - final) * left
        self.time += seconds
        if self._tripped and self.coil_rise < facts.trip_rise / 2:
            self._tripped = False

    def bench(self) -> Hardware:
        """Return the present hardware for an experiment.

        Disturbed sensors are noisy.

        Raises
        ------
        BadExperiment
            Equipment is off, or a coil is tripped.
        """
        if self.next_step is not None:
            _refuse(f"{self.next_step!r} is off: {ORDER[self.next_step]} must be on for an experiment")
        if not self._unstable:
            return self._hardware
        noisy = replace(self._hardware.velocity_sensor, noise=self._facts.unstable_noise)
        return replace(self._hardware, velocity_sensor=noisy)

    def _disturb(self, what: Equipment, way: str) -> None:
        """Disturb unity-gain operational amplifiers by switching."""
        if "op-amps" in self._on and what != "op-amps" and not self._unstable:
            self._unstable = True
            noise = self._facts.unstable_noise
            self._fault(
                "unstable-sensors",
                noise,
                f"{ORDER[what]} went {way} while the operational amplifiers were on: they became unstable, with {noise:g} m/s of noise, until they are switched off and on again",
            )

    def _fault(self, kind: FaultKind, value: float, words: str) -> None:
        self.faults.append(Fault(kind=kind, time=self.time, value=value, words=words))


def power_up(hardware: Hardware) -> PowerUp:
    """Return the bench after power-up in the right order."""
    switches = PowerUp(hardware)
    for step in ORDER:
        switches.switch_on(step)
    return switches


def power_up_as_told(hardware: Hardware, order: str) -> PowerUp:
    """Switch the bench on in a given order without interlock.

    `PAUSE` separates two steps.

    Parameters
    ----------
    hardware : Hardware
        Hardware between law and structure.
    order : str
        Names of `ORDER`, separated by commas.

    Returns
    -------
    PowerUp
        Switches after the last step.

    Raises
    ------
    UnknownName
        No such equipment.
    BadExperiment
        An item cannot run yet, is repeated or missing, or a coil is tripped.
    """
    switches = PowerUp(hardware, interlocked=False)
    for step in order.split(","):
        switches.switch_on(step.strip())
        switches.wait(PAUSE)
    tripped = next((fault for fault in switches.faults if fault.kind == "coil-tripped"), None)
    if tripped is not None and not switches.is_ready:
        _refuse(
            f"after {tripped.time:.0f} s {tripped.words}; no experiment can run (the right order: {', '.join(ORDER)})"
        )
    return switches


def time_to_rise(facts: PowerUpFaults, resistance: float, rise: float = 0.0) -> float:
    """Return the time until the direct current trips a coil [s].

    Parameters
    ----------
    facts : PowerUpFaults
        Description of the faults.
    resistance : float
        Resistance of the coil [ohm].
    rise : float
        Present temperature rise [K].

    Returns
    -------
    float
        Time [s]; infinite if the coil stays below the limit.
    """
    final = facts.thermal_resistance * resistance * facts.direct_current**2
    if rise >= facts.trip_rise:
        return 0.0
    if final <= facts.trip_rise:
        return float("inf")
    tau = facts.thermal_resistance * facts.heat_capacity
    return float(tau * np.log((final - rise) / (final - facts.trip_rise)))


def _equipment(step: str) -> Equipment:
    for known in ORDER:
        if step == known:
            return known
    raise unknown_name("equipment", step, ORDER)


def _refuse(message: str) -> NoReturn:
    raise BadExperiment(f"powering up: {message}")
