"""Tables of ``case.toml`` as frozen dataclasses, read strictly by `vlab.files.toml.Reader`."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from vlab.cases.kinds import HELD_KINDS, UNCERTAIN_KINDS, check_unit, check_unit_of_kind, known_kind
from vlab.cases.response_tables import FrfTable, Matrix, ModalTable, Role, check_scale
from vlab.errors import BadCase, unknown_name
from vlab.recordings.assemble import ColumnSpec
from vlab.recordings.selection import excludes, parse_where
from vlab.signals import KIND_UNITS

Hold = Literal["", "zero", "zero-first", "past", "linear"]


MOST_HZ = 1e9
"""MOST_HZ [Hz]: largest sample rate, above any laboratory's."""


@dataclass(frozen=True, kw_only=True)
class EffectTable:
    """``[[model.effect]]``: an effect added to the model's file, see `vlab effects`."""

    name: str
    place: str
    parameters: dict[str, float]


@dataclass(frozen=True, kw_only=True)
class ModelTable:
    """``[model]``: an MJCF file in the case's folder, or a structure.

    Parameters
    ----------
    plant, variant : str
        For a structure: name of the plant and of the variant.
    hardware : str
        For a structure: hardware description in the case's folder; the laboratory's by default.
    uncertain : mapping
        Relative standard deviation by kind (`UNCERTAIN_KINDS`) or name (``geom:arm:mass``); in m for positions.
    effect : sequence of EffectTable
        Added effects in order.
    """

    mjcf: str = ""
    structure: str = ""
    plant: str = "composite"
    variant: str = "published"
    hardware: str = ""
    uncertain: dict[str, float] = field(default_factory=dict)
    effect: tuple[EffectTable, ...] = ()

    def __post_init__(self) -> None:
        if bool(self.mjcf) == bool(self.structure):
            raise BadCase('give either mjcf = "FILE.xml" or structure = "NAME or FILE.toml"')
        for name, value in self.uncertain.items():
            if not 0 < value <= 10:
                raise BadCase(f"uncertain.{name} is {value:g}; a relative standard deviation is above 0 and at most 10")
            if ":" not in name and name not in UNCERTAIN_KINDS:
                known = [*UNCERTAIN_KINDS, "or type:name:quantity, such as geom:arm:mass"]
                raise unknown_name("kind", name, known, where="uncertain")


@dataclass(frozen=True, kw_only=True)
class ChannelTable:
    """``[[recording.channel]]``: meaning of a column of the file.

    Parameters
    ----------
    offset : float
        Reading at zero, in the channel's own unit: a laser's standoff, an encoder's zero.
    from_rest : bool
        Whether the column counts from equilibrium. If true, the model's equilibrium value is subtracted before
        comparison.
    delay_s : float
        Age of the readings at their row's time stamp [s], less than a sample; negative for readings after the stamp.
        The value describes an instrument's skew; longer delays are physics.
    noise : float or None
        Standard deviation of the readings' noise in the channel's own unit, if known. The noise counts as white.
    hold : str
        Input between samples. ``"linear"``: a straight line. ``"zero"``: constant from its sample to the next, with
        readings taken before the change. ``"zero-first"``: same, with readings taken after the change. ``"past"``:
        constant from the preceding sample to its own. Default: ``"zero"`` for `HELD_KINDS`, else ``"linear"``; a
        diagnosis reports a contradiction by the recordings.
    time, time_unit : str
        Time column of the channel alone, and its unit; the recording's by default.
    blank : str
        Blank cells of an input. ``"hold"``: the last value stands. By default blank cells of an input are an error; those
        of a compared channel have no reading and are not compared.
    unwrap : bool
        Whether the jumps of an angle by a full turn are removed when the column is read.
    """

    column: str
    at: str
    kind: str
    unit: str = ""
    name: str = ""
    scale: float | None = None
    offset: float = 0.0
    input: bool = False
    from_rest: bool = False
    delay_s: float = 0.0
    noise: float | None = None
    hold: Hold = ""
    time: str = ""
    time_unit: str = ""
    blank: Literal["", "hold"] = ""
    unwrap: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", known_kind(self.kind, self.unit))
        if self.scale is not None:
            check_scale(self.scale)
        if self.input and self.from_rest:
            raise BadCase("from_rest is for what is compared with the model, not for its inputs")
        if self.input and self.delay_s:
            raise BadCase("delay_s is for what is compared with the model; when an input acts is said by its hold")
        if self.blank and not self.input:
            raise BadCase('blank = "hold" is for inputs; a blank cell of a compared channel is no reading')
        if self.unwrap and self.kind != "angle":
            raise BadCase(f"unwrap is for an angle, which jumps by a full turn; the column is of kind {self.kind}")
        if self.time and self.hold == "past":
            raise BadCase('hold = "past" needs the rows of the recording; give "zero" or "linear" beside time')
        if self.time_unit:
            check_unit(self.time_unit, "s")
        if self.noise is not None and self.input:
            raise BadCase("noise is for what is compared with the model, not for its inputs")
        if self.noise is not None and not 0 < self.noise < np.inf:
            raise BadCase(
                f"noise is {self.noise:g}; it must be a positive standard deviation in {self.unit or 'the unit of the file'}; "
                "leave it out where it is unknown"
            )
        si = KIND_UNITS[self.kind]
        if self.scale is None and si is not None:
            check_unit_of_kind(self.unit, self.kind, si)
        elif self.unit:
            check_unit(self.unit, self.unit)

    def spec(self, name: str = "", *, time_unit: str = "s") -> ColumnSpec:
        """Return the column specification for the file reader.

        Parameters
        ----------
        name : str
            Name of the channel.
        time_unit : str
            Unit of the recording's times.

        Returns
        -------
        ColumnSpec
            Specification.
        """
        return ColumnSpec(
            column=self.column,
            kind=self.kind,
            unit=self.unit,
            at=self.at,
            name=name,
            scale=self.scale,
            offset=self.offset,
            is_input=self.input,
            is_held=self.is_held,
            stands=self.blank == "hold",
            unwrap=self.unwrap,
            time=self.time,
            time_unit=self.time_unit or time_unit,
        )

    @property
    def si_noise(self) -> float | None:
        """Stated standard deviation of the readings' noise [SI unit of the channel]."""
        return None if self.noise is None else self.noise * abs(self.spec().channel_and_factor()[1])

    @property
    def is_held(self) -> bool:
        """Whether an input stays constant between its samples."""
        return self.kind in HELD_KINDS if not self.hold else self.hold != "linear"

    @property
    def is_first(self) -> bool:
        """Whether readings follow the change of a held input."""
        return self.hold == "zero-first"


@dataclass(frozen=True, kw_only=True)
class ControllerTable:
    """``[recording.controller]``: the control law in the loop.

    The law is static rate feedback u = -gains y, or an observer. The observer is u = -K x, x+ = A x + B u + M (y - C x)
    with |u| <= limit.

    Parameters
    ----------
    gains_unit : str
        Unit of the gains, such as ``"lbf s/in"``.
    sensor_unit, actuator_unit : str
        Units of y and u in the law; the model's own by default.
    sensor_scale, actuator_scale : float
        Model unit per unit of the law, in place of the units.
    """

    sensors: tuple[str, ...]
    actuators: tuple[str, ...]
    rate_hz: float
    gains: Matrix = ()
    gains_unit: str = ""
    A: Matrix = ()
    B: Matrix = ()
    C: Matrix = ()
    K: Matrix = ()
    M: Matrix = ()
    limit: float | None = None
    sensor_unit: str = ""
    actuator_unit: str = ""
    sensor_scale: float | None = None
    actuator_scale: float | None = None

    def __post_init__(self) -> None:
        if not self.sensors or not self.actuators:
            raise BadCase("sensors and actuators must each name at least one")
        if not self.rate_hz > 0:
            raise BadCase(f"rate_hz is {self.rate_hz:g}; it must be positive")
        missing = [name for name in "ABCKM" if not getattr(self, name)]
        if bool(self.gains) == (len(missing) < 5) or (not self.gains and missing):
            raise BadCase(
                "give either gains, or all of A, B, C, K and M"
                + (f" (missing: {', '.join(missing)})" if 0 < len(missing) < 5 else "")
            )
        if self.gains and self.limit is not None:
            raise BadCase("limit belongs to the observer form (A, B, C, K, M); static gains have none")
        for side in ("sensor", "actuator"):
            if getattr(self, f"{side}_unit") and getattr(self, f"{side}_scale") is not None:
                raise BadCase(f"{side}_unit and {side}_scale are both given; one of them says how it is converted")
            if getattr(self, f"{side}_scale") == 0.0:
                raise BadCase(f"{side}_scale is 0; it must be model unit per unit of the law")
        if self.gains_unit and (self.sensor_unit or self.sensor_scale is not None or self.actuator_scale is not None):
            raise BadCase("gains_unit says the units of y and u already; leave out sensor_unit and the scales")


@dataclass(frozen=True, kw_only=True)
class RecordingTable:
    """``[[recording]]``: a file, its role and its columns.

    Parameters
    ----------
    rate_hz, time : float, str
        Sample rate [Hz], or name of the time column.
    start_s, stop_s : float
        Compared part of the file [s], start <= t < stop. Samples before the part initialise a law's memory.
    initial : str
        Initial state: ``"rest"``, ``"estimated"`` from the first samples, or ``"auto"``: estimated unless the recording
        begins at rest.
    qpos, qvel : tuple of float
        Known state at the first compared sample, in the order and units of the model (SI); zero velocity by default.
    where : str
        Rows of the file to use, see `vlab.recordings.selection.parse_where`.
    period_s : float
        Period of a periodic excitation [s], if known.
    """

    file: str
    role: Role
    name: str = ""
    rate_hz: float | None = None
    time: str | None = None
    time_unit: str = "s"
    start_s: float | None = None
    stop_s: float | None = None
    initial: Literal["auto", "rest", "estimated"] = "auto"
    qpos: tuple[float, ...] = ()
    qvel: tuple[float, ...] = ()
    where: str = ""
    period_s: float | None = None
    channel: tuple[ChannelTable, ...]
    controller: ControllerTable | None = None

    def __post_init__(self) -> None:
        has_own_times = all(channel.time for channel in self.channel)
        if (self.rate_hz is None) == (self.time is None) and (self.rate_hz is not None or not has_own_times):
            raise BadCase("give rate_hz, or time = the name of the time column, and not both")
        if self.where:
            parse_where(self.where)
        if self.qvel and not self.qpos:
            raise BadCase("qvel is given without qpos; give both")
        if self.qpos and self.initial != "auto":
            raise BadCase(
                f'initial = "{self.initial}" and qpos are both given; one of them says how the recording begins'
            )
        if self.period_s is not None and not self.period_s > 0:
            raise BadCase(f"period_s is {self.period_s:g}; it must be positive")
        if self.rate_hz is not None and not 0 < self.rate_hz <= MOST_HZ:
            raise BadCase(f"rate_hz is {self.rate_hz:g}; it must be positive and at most {MOST_HZ:g}")
        check_unit(self.time_unit, "s")
        start = -np.inf if self.start_s is None else self.start_s
        if not start < (np.inf if self.stop_s is None else self.stop_s):
            raise BadCase(f"start_s is {self.start_s} and stop_s is {self.stop_s}; the start must come first")
        if all(channel.input for channel in self.channel):
            raise BadCase("no channel is compared with the model; give at least one without input = true")
        names = self.channel_names
        for name in names:
            if names.count(name) > 1:
                raise BadCase(f"two channels are called {name!r}; give one of them another name")

    def shares_samples_with(self, other: "RecordingTable") -> bool:
        """Return whether another recording shares samples of the file.

        Shared samples belong to the same columns of the same file.

        Parameters
        ----------
        other : RecordingTable
            Recording to compare with.

        Returns
        -------
        bool
            Whether the time ranges overlap.
        """
        if self.file != other.file or not {c.column for c in self.channel} & {c.column for c in other.channel}:
            return False
        if excludes(self.where, other.where):
            return False
        starts = [-np.inf if r.start_s is None else r.start_s for r in (self, other)]
        stops = [np.inf if r.stop_s is None else r.stop_s for r in (self, other)]
        return max(starts) < min(stops)

    @property
    def channel_names(self) -> list[str]:
        """Channel names in the recording.

        The default name is the place, with the kind if the place repeats.
        """
        places = [channel.at for channel in self.channel]
        return [c.name or (c.at if places.count(c.at) == 1 else f"{c.kind}:{c.at}") for c in self.channel]


@dataclass(frozen=True, kw_only=True)
class CaseTable:
    """Contents of a case file."""

    title: str = ""
    model: ModelTable
    recording: tuple[RecordingTable, ...] = ()
    frf: tuple[FrfTable, ...] = ()
    modal: tuple[ModalTable, ...] = ()

    def __post_init__(self) -> None:
        if not (self.recording or self.frf or self.modal):
            raise BadCase("the case has no [[recording]], [[frf]] or [[modal]]: there is nothing to compare with")
        for held in (r for r in self.recording if r.role == "holdout"):
            same = next((r for r in self.recording if r.role == "fit" and r.shares_samples_with(held)), None)
            if same is not None:
                raise BadCase(
                    f"samples of {held.file} are held out and fitted, too, which verifies nothing; "
                    "take parts of their own with start_s and stop_s, or other files"
                )
