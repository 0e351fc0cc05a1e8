"""Channel map: drives, compared channels and the law of a recording."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from vlab import units
from vlab.cases.description import ChannelTable, ControllerTable, RecordingTable
from vlab.cases.places import suggest
from vlab.cases.timestamps import in_time
from vlab.controllers import Controller, DirectRateFeedback, ObserverFeedback
from vlab.errors import BadCase, BadController, BadRecording, UnknownName, VlabError, unknown_name
from vlab.hardware import Hardware
from vlab.plants.base import Plant
from vlab.recordings.assemble import own_si
from vlab.signals import ORDER, Array, Recording, check_sizes

FAR_S = 1e6
"""FAR_S [s]: first time of a file, such as seconds since 1970, beyond which times count from the file's first sample."""
_UNITS = {
    "m": ("displacement", "velocity", "acceleration"),
    "rad": ("angle", "angular-velocity", "angular-acceleration"),
}


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Channel that drives the plant, by an actuator or at a port.

    Parameters
    ----------
    is_held, is_first : bool
        Whether the channel stays constant between samples, and whether readings see its present sample already.
    through_chain : bool
        Whether delay, hold and filter of the hardware act on the command.
    """

    channel: str
    actuator: int | None = None
    port: str = ""
    is_held: bool = True
    is_first: bool = False
    through_chain: bool = False


@dataclass(frozen=True, kw_only=True)
class Compared:
    """Channel compared with the plant: sensor, port motion or actuator command.

    Parameters
    ----------
    order : int
        Order of the time derivative at a port: 0 position, 1 velocity, 2 acceleration.
    noise : float or None
        Standard deviation of the readings' noise that the case states [SI unit of the channel].
    """

    channel: str
    sensor: int | None = None
    port: str = ""
    order: int = 0
    actuator: int | None = None
    from_rest: bool = False
    noise: float | None = field(default=None, compare=False)


@dataclass(frozen=True, kw_only=True, eq=False)
class Law:
    """Control law in the loop.

    Parameters
    ----------
    sensors, actuators : sequence of int
        Sensors and actuators of the plant, in the order of the law.
    per_sensor : (n_sensors,) array
        Units of the law per model unit of its sensors.
    per_actuator : (n_actuators,) array
        Model units per unit of the law of its actuators.
    """

    controller: Controller
    rate_hz: float
    sensors: tuple[int, ...]
    actuators: tuple[int, ...]
    per_sensor: Array
    per_actuator: Array

    def step(self, y: Array) -> Array:
        """Return commands in model units for the plant's sensor values."""
        return np.asarray(self.controller.step(y[list(self.sensors)] * self.per_sensor) * self.per_actuator)


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """One recording with its channel map.

    Parameters
    ----------
    measured : Recording
        Compared part of the recording.
    before : Recording or None
        Part of the file before `measured`.
    valid : (n_samples, n_channels) array of bool or None
        Valid samples of `measured`; None if its values are unchanged.
    start : tuple of (array, array) or None
        Stated qpos and qvel at the first sample of `measured`.
    period_s : float or None
        Stated period of the excitation [s].
    repeats : tuple of Recording
        Other recordings with the inputs of `measured`, sample by sample.
    unsettled : tuple of str
        Channels whose response differs between periods of the excitation by motion.
    """

    name: str
    role: Literal["fit", "holdout"]
    measured: Recording
    before: Recording | None
    drives: tuple[Drive, ...]
    compared: tuple[Compared, ...]
    law: Law | None
    hardware: Hardware | None
    initial: Literal["auto", "rest", "estimated"]
    valid: NDArray[np.bool_] | None = None
    start: tuple[Array, Array] | None = None
    period_s: float | None = None
    repeats: tuple[Recording, ...] = ()
    unsettled: tuple[str, ...] = ()

    @property
    def outputs(self) -> Recording:
        """The compared channels of the recording."""
        return self.measured.select([c.channel for c in self.compared])


def compared_names(runs: Sequence[Run]) -> list[str]:
    """Return the compared channels of all runs, without commands."""
    return list(dict.fromkeys(c.channel for run in runs for c in run.compared if c.actuator is None))


# ---- finding names --------------------------------------------------------------------------------------------------


def find_input(plant: Plant, channel: ChannelTable, recording: RecordingTable) -> Drive:
    """Find the drive of an input channel.

    Parameters
    ----------
    plant : Plant
        Plant.
    channel : ChannelTable
        Channel of the case file.
    recording : RecordingTable
        Recording of the case file.

    Returns
    -------
    Drive
        Actuator or port, with the factor on the recorded values.

    Raises
    ------
    BadCase, UnknownName
        No actuator and no port has that name, or the unit does not fit.
    """
    label = _label(channel, recording)
    for i, tap in enumerate(plant.actuators):
        if channel.at in (tap.name, tap.at, f"actuator:{tap.name}") and tap.name:
            _check_input_unit(channel, tap.unit)
            is_command = channel.kind == "command" and tap.unit != "command"
            return Drive(
                channel=label,
                actuator=i,
                is_held=channel.is_held,
                is_first=channel.is_first,
                through_chain=is_command,
            )
    if channel.at in plant.ports:
        if channel.kind in ORDER:
            raise BadCase(
                f"{channel.at!r} is pushed by an input, the column {channel.column!r} is a {channel.kind}; to prescribe a motion, "
                "give the model a stiff <position> or <velocity> actuator there and drive that"
            )
        _check_input_unit(channel, "N" if plant.ports[channel.at].unit == "m" else "N m")
        return Drive(channel=label, port=channel.at, is_held=channel.is_held, is_first=channel.is_first)
    names = [tap.name for tap in plant.actuators if tap.name]
    raise unknown_place("actuator", channel, plant, [*names, *plant.ports])


def _check_input_unit(channel: ChannelTable, unit: str) -> None:
    given = _si(channel)
    if unit == "command" or channel.scale is not None:
        return
    if not units.same_dimension(given or "1", unit):
        raise BadCase(
            f"{channel.at!r} takes {unit}, the column {channel.column!r} is in {channel.unit or 'no unit'}; "
            f"give scale = {unit} per {channel.unit or 'unit of the file'}"
        )


def find_output(plant: Plant, channel: ChannelTable, recording: RecordingTable) -> Compared:
    """Find the plant's counterpart of a measured channel.

    Parameters
    ----------
    plant : Plant
        Plant.
    channel : ChannelTable
        Channel of the case file.
    recording : RecordingTable
        Recording of the case file.

    Returns
    -------
    Compared
        Sensor, port motion or actuator command.

    Raises
    ------
    BadCase, UnknownName
        No sensor, port or actuator under a law has that name, or its quantity differs.
    """
    label, at, noise = _label(channel, recording), channel.at, channel.si_noise
    sensors = [i for i, tap in enumerate(plant.sensors) if at in (tap.name, tap.at, f"sensor:{tap.name}")]
    for i in sensors:
        if "other" in (plant.sensors[i].kind, channel.kind) or plant.sensors[i].kind == channel.kind:
            return Compared(channel=label, sensor=i, from_rest=channel.from_rest, noise=noise)
    if at in plant.ports and channel.kind in _UNITS[plant.ports[at].unit]:
        return Compared(channel=label, port=at, order=ORDER[channel.kind], from_rest=channel.from_rest, noise=noise)
    for i, tap in enumerate(plant.actuators):
        if at in (tap.name, tap.at, f"actuator:{tap.name}") and tap.name and not sensors:
            if recording.controller is None or at not in recording.controller.actuators:
                raise BadCase(f"{at!r} is an actuator that no law commands; say input = true, or name a sensor")
            _check_input_unit(channel, tap.unit)
            return Compared(channel=label, actuator=i, noise=noise)
    if sensors or at in plant.ports:
        kinds = [plant.sensors[i].kind for i in sensors] or list(_UNITS[plant.ports[at].unit])
        raise BadCase(f"{at!r} gives {' or '.join(kinds)}, the column {channel.column!r} is {channel.kind}")
    raise _unknown_sensor(plant, at, channel)


def _unknown_sensor(plant: Plant, at: str, channel: ChannelTable | None = None) -> VlabError:
    parts = [tap.name for tap in plant.sensors if tap.name.startswith(f"{at}.")]
    if parts:
        return BadCase(f"sensor {at!r} has several values; say one of {', '.join(parts)}")
    names = [tap.name for tap in plant.sensors] + [tap.name for tap in plant.actuators if tap.name]
    if channel is not None:
        return unknown_place("sensor", channel, plant, [*names, *plant.ports])
    return unknown_name("sensor", at, [*names, *plant.ports])


def unknown_place(kind: str, channel: ChannelTable, plant: Plant, names: Sequence[str]) -> VlabError:
    """Return the error for a place that the model does not have.

    Parameters
    ----------
    kind : str
        Kind of place, for the message.
    channel : ChannelTable
        Channel with the place.
    plant : Plant
        Model.
    names : sequence of str
        Accepted names.

    Returns
    -------
    UnknownName
        Error with the place that the given name, or else the column, suggests.
    """
    error = unknown_name(kind, channel.at, names)
    guess = suggest(channel.at, plant, is_input=channel.input)
    if guess is None and "did you mean" not in str(error):
        guess = suggest(channel.column, plant, is_input=channel.input)
    if guess is None or guess.at not in names:
        return error
    listed = str(error)[str(error).index("(accepted") :]
    return UnknownName(f"unknown {kind} {channel.at!r}; did you mean {guess.at!r}? {listed}")


def find_place(plant: Plant, name: str) -> None:
    """Check that a name is an actuator, a sensor or a port.

    Parameters
    ----------
    plant : Plant
        Plant.
    name : str
        Name of the place.

    Raises
    ------
    BadCase, UnknownName
        The plant has no such place.
    """
    names = {n for tap in plant.sensors for n in (tap.name, tap.at)} | {
        n for tap in plant.actuators for n in (tap.name, tap.at)
    }
    if name not in names | set(plant.ports):
        raise _unknown_sensor(plant, name)


def _label(channel: ChannelTable, recording: RecordingTable) -> str:
    return recording.channel_names[recording.channel.index(channel)]


def _si(channel: ChannelTable) -> str:
    return channel.spec().channel_and_factor()[0].unit


# ---- the law --------------------------------------------------------------------------------------------------------


def _law(plant: Plant, table: ControllerTable) -> Law:
    sensors = tuple(_sensor(plant, name) for name in table.sensors)
    actuators = tuple(plant.actuator_index(name) for name in table.actuators)
    y_units = [plant.sensors[i].unit for i in sensors]
    u_units = [plant.actuators[i].unit for i in actuators]
    u_units = [_actuator_unit(table, unit, name) for unit, name in zip(u_units, table.actuators, strict=True)]
    per_sensor, per_actuator = np.ones(len(sensors)), np.ones(len(actuators))
    controller: Controller
    if table.gains_unit:
        for unit, name in zip((*y_units, *u_units), (*table.sensors, *table.actuators), strict=True):
            if not unit:
                raise BadCase(
                    f"gains_unit cannot be converted: {name!r} has no unit; give sensor_scale and actuator_scale"
                )
        gains = [
            [g * units.factor(table.gains_unit, f"{u}/({y})") for g, y in zip(row, y_units, strict=False)]
            for row, u in zip(table.gains, u_units, strict=False)
        ]
    else:
        gains = [list(row) for row in table.gains]
        per_sensor = np.array([1.0 / _factor(table.sensor_unit, table.sensor_scale, u) for u in y_units])
        per_actuator = np.array([_factor(table.actuator_unit, table.actuator_scale, u) for u in u_units])
    if table.gains:
        _check_shape(table)
        controller = DirectRateFeedback(gains, sensors=table.sensors, actuators=table.actuators)
    else:
        controller = ObserverFeedback(
            table.A,
            table.B,
            table.C,
            K=table.K,
            M=table.M,
            sensors=table.sensors,
            actuators=table.actuators,
            limit=table.limit,
        )
    return Law(
        controller=controller,
        rate_hz=table.rate_hz,
        sensors=sensors,
        actuators=actuators,
        per_sensor=per_sensor,
        per_actuator=per_actuator,
    )


def _check_shape(table: ControllerTable) -> None:
    if len(table.gains) != len(table.actuators) or any(len(row) != len(table.sensors) for row in table.gains):
        raise BadController(
            f"gains must have {len(table.actuators)} rows (actuators) of {len(table.sensors)} numbers (sensors)"
        )


def _sensor(plant: Plant, name: str) -> int:
    try:
        return plant.sensor_index(name.removeprefix("sensor:") if name not in {t.name for t in plant.sensors} else name)
    except LookupError as error:
        raise _unknown_sensor(plant, name) from error


def _actuator_unit(table: ControllerTable, unit: str, name: str) -> str:
    """Return the SI unit of an actuator's command."""
    if unit != "command":
        return unit
    if table.gains_unit and not table.actuator_unit:
        raise BadCase(f"actuator {name!r} takes a bare command; say in which unit: actuator_unit = ...")
    return own_si(table.actuator_unit) if table.actuator_unit else ""


def _factor(unit: str, scale: float | None, si: str) -> float:
    if scale is not None:
        return scale
    if not unit:
        return 1.0
    return units.factor(unit, si or own_si(unit))


# ---- the run --------------------------------------------------------------------------------------------------------


def wire(plant: Plant, table: RecordingTable) -> tuple[tuple[Drive, ...], tuple[Compared, ...], Law | None]:
    """Map the channels of a recording to a plant by name."""
    _stated_start(plant, table)
    drives = tuple(find_input(plant, c, table) for c in table.channel if c.input)
    compared = tuple(find_output(plant, c, table) for c in table.channel if not c.input)
    return drives, compared, None if table.controller is None else _law(plant, table.controller)


def make_run(plant: Plant, name: str, table: RecordingTable, whole: Recording, hardware: Hardware | None = None) -> Run:
    """Cut the requested part out of a recording and map its channels.

    Parameters
    ----------
    plant : Plant
        Plant.
    name : str
        Name of the run.
    table : RecordingTable
        Recording of the case file.
    whole : Recording
        Complete recording.
    hardware : Hardware or None
        Hardware of the laboratory, if the case names one.

    Returns
    -------
    Run
        Recording with its channel map.

    Raises
    ------
    BadRecording
        Fewer than two samples between start and stop, or samples so large that MuJoCo reports divergence.
    """
    start = -np.inf if table.start_s is None else table.start_s
    stop = np.inf if table.stop_s is None else table.stop_s
    whole = in_time(whole, table)
    # a start on a sample includes the sample, within rounding; a double of the year 2025 holds 0.2 microseconds
    edge = 1e-9 * max(1.0, whole.time[-1] - whole.time[0]) + 2.0 * np.spacing(abs(whole.time[-1]))
    measured = _part(whole, start - edge, stop - edge)
    if measured is None:
        raise BadRecording(
            f"{table.file}: fewer than 2 samples from start_s = {table.start_s} to stop_s = {table.stop_s}; "
            f"the recording runs from {whole.time[0]:.12g} to {whole.time[-1]:.12g} s"
        )
    before = _part(whole, -np.inf, start - edge)
    if abs(whole.time[0]) > FAR_S:
        measured = replace(measured, time=measured.time - whole.time[0])
        before = None if before is None else replace(before, time=before.time - whole.time[0])
    check_sizes(measured, table.file, largest=mujoco.mjMAXVAL, why=", for beyond it MuJoCo takes a run for diverged")
    drives, compared, law = wire(plant, table)
    return Run(
        name=name,
        role=table.role,
        measured=measured,
        before=before,
        drives=drives,
        compared=compared,
        law=law,
        hardware=hardware,
        initial=table.initial,
        start=_stated_start(plant, table),
        period_s=table.period_s,
    )


def _stated_start(plant: Plant, table: RecordingTable) -> tuple[Array, Array] | None:
    """Return the stated state of a recording's first sample."""
    if not table.qpos:
        return None
    sizes = {"qpos": plant.model.nq, "qvel": plant.model.nv}
    for key, size in sizes.items():
        given = getattr(table, key)
        if given and len(given) != size:
            names = [plant.model.joint(i).name or f"number {i}" for i in range(plant.model.njnt)]
            raise BadCase(
                f"{key} has {len(given)} numbers, the model has {size}; give one for each of its coordinates, "
                f"joints in order: {', '.join(names)}"
            )
    return np.array(table.qpos), np.array(table.qvel) if table.qvel else np.zeros(plant.model.nv)


def _part(whole: Recording, start: float, stop: float) -> Recording | None:
    keep = (whole.time >= start) & (whole.time < stop)
    return whole.between(start, stop) if keep.sum() >= 2 else None


def compared_with_sensors(run: Run, sensors: Sequence[int]) -> list[Compared] | None:
    """Return measured channels of some sensors, or None."""
    by_sensor = {c.sensor: c for c in run.compared if c.sensor is not None}
    return [by_sensor[i] for i in sensors] if all(i in by_sensor for i in sensors) else None
