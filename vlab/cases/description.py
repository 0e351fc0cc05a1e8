"""Tables of ``case.toml`` as frozen dataclasses, read strictly by `vlab.files.toml.Reader`."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from vlab.cases.kinds import HELD_KINDS, UNCERTAIN_KINDS, check_unit, check_unit_of_kind, known_kind
from vlab.errors import BadCase, unknown_name
from vlab.recordings.assemble import ColumnSpec
from vlab.signals import KIND_UNITS

Role = Literal["fit", "holdout"]
Matrix = tuple[tuple[float, ...], ...]


Hold = Literal["", "zero", "zero-first", "past", "linear"]


LEAST_SCALE = 1e-30
"""LEAST_SCALE [1]: smallest scale of a channel."""
MOST_HZ = 1e9
"""MOST_HZ [Hz]: largest sample rate, above any laboratory's."""


def _same_length(what: str, values: tuple[object, ...], n: int, against: str) -> None:
    if len(values) != n:
        raise BadCase(f"{what} has {len(values)} entries, {against} has {n}")


def _check_scale(scale: float) -> None:
    if not LEAST_SCALE <= abs(scale) <= 1.0 / LEAST_SCALE:
        raise BadCase(f"the scale is {scale:g}; it must be model unit per file unit, and no such unit is that far off")


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
    hold : str
        Input between samples. ``"linear"``: a straight line. ``"zero"``: constant from its sample to the next, with
        readings taken before the change. ``"zero-first"``: same, with readings taken after the change. ``"past"``:
        constant from the preceding sample to its own. Default: ``"zero"`` for `HELD_KINDS`, else ``"linear"``; a
        diagnosis reports a contradiction by the recordings.
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
    hold: Hold = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", known_kind(self.kind, self.unit))
        if self.scale is not None:
            _check_scale(self.scale)
        if self.input and self.from_rest:
            raise BadCase("from_rest is for what is compared with the model, not for its inputs")
        if self.input and self.delay_s:
            raise BadCase("delay_s is for what is compared with the model; when an input acts is said by its hold")
        si = KIND_UNITS[self.kind]
        if self.scale is None and si is not None:
            check_unit_of_kind(self.unit, self.kind, si)
        elif self.unit:
            check_unit(self.unit, self.unit)

    def spec(self, name: str = "") -> ColumnSpec:
        """Return the column specification for the file reader.

        Parameters
        ----------
        name : str
            Name of the channel.

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
        )

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
    channel: tuple[ChannelTable, ...]
    controller: ControllerTable | None = None

    def __post_init__(self) -> None:
        if (self.rate_hz is None) == (self.time is None):
            raise BadCase("give rate_hz, or time = the name of the time column, and not both")
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
class FrfChannelTable:
    """``[[frf.channel]]``: a column with one output's response.

    Parameters
    ----------
    imaginary : str
        Column of the imaginary part, with `column` the real part.
    phase, phase_unit : str
        Column of the phase and its unit, with `column` the magnitude (also in dB).
    coherence, variance : str
        Column of the coherence, or of the response's variance in the square of its unit, if any.
    scale : float
        Factor on the response; -1 for a reversed sign.
    """

    column: str
    at: str
    imaginary: str = ""
    phase: str = ""
    phase_unit: str = "deg"
    coherence: str = ""
    variance: str = ""
    scale: float = 1.0

    def __post_init__(self) -> None:
        _check_scale(self.scale)
        if self.coherence and self.variance:
            raise BadCase(f"channel {self.column!r} has both coherence and variance; give one of them")
        if self.imaginary and self.phase:
            raise BadCase(f"channel {self.column!r} has both imaginary and phase; give one of them")
        check_unit(self.phase_unit, "rad")


@dataclass(frozen=True, kw_only=True)
class FrfTable:
    """``[[frf]]``: measured frequency responses to one input.

    Parameters
    ----------
    form_db : bool
        Whether columns hold 20 log10 of the magnitude.
    frequency : str
        Name of the frequency column.
    unit : str
        Unit of the response; the SI unit of the form by default.
    level : float
        Excitation level (rms of the input, in a unit common to all responses of the case), if known.
    excitation : {"sine", "random"}
        Whether the level is that of each line of a stepped sine, or of noise over the band of the lines.
    averages : float
        Number of averages of the coherence.
    scale : float
        Factor on all responses of the file; -1 for a reversed sign.
    conjugate : bool
        Whether the file uses exp(-i omega t) in place of exp(i omega t).
    low_hz, high_hz : float
        Used frequency range [Hz]. Lines outside are beyond the excitation or belong to modes outside the model.
    """

    file: str
    role: Role
    form: Literal["receptance", "mobility", "accelerance"]
    form_db: bool = False
    input: str
    outputs: tuple[str, ...]
    frequency: str = "f"
    frequency_unit: str = "Hz"
    unit: str = ""
    level: float | None = None
    excitation: Literal["sine", "random"] = "sine"
    averages: float = 10.0
    scale: float = 1.0
    conjugate: bool = False
    low_hz: float = 0.0
    high_hz: float | None = None
    channel: tuple[FrfChannelTable, ...] = ()

    def __post_init__(self) -> None:
        check_unit(self.frequency_unit, "Hz")
        _check_scale(self.scale)
        if self.unit:
            check_unit(self.unit, {"receptance": "m/N", "mobility": "m/s/N", "accelerance": "m/s^2/N"}[self.form])
        if not self.outputs:
            raise BadCase("outputs must name at least one place")
        if self.level is not None and not self.level > 0:
            raise BadCase(f"level is {self.level:g}; it must be positive")
        if not 0 <= self.low_hz < (np.inf if self.high_hz is None else self.high_hz):
            raise BadCase(f"low_hz is {self.low_hz:g} and high_hz is {self.high_hz}; the lower must come first")
        if not self.averages > 1:
            raise BadCase(f"averages is {self.averages:g}; a coherence comes of more than one")
        for channel in self.channel:
            if channel.at not in self.outputs:
                raise unknown_name("output", channel.at, self.outputs, where=f"channel {channel.column!r}")
            if channel.imaginary and self.form_db:
                raise BadCase(f"channel {channel.column!r}: a magnitude in dB has no imaginary part")
        if self.channel:
            _same_length("channel", self.channel, len(self.outputs), "outputs")


@dataclass(frozen=True, kw_only=True)
class ModalTable:
    """``[[modal]]``: measured frequencies, damping ratios and shapes.

    Parameters
    ----------
    at : tuple of str
        Places of the shapes' entries.
    shape : tuple of tuples
        One row a mode, one entry a place.
    frequency_sd_hz, zeta_sd, shape_sd : tuple of float
        Standard deviations, one a mode.
    amplitude : tuple of float
        Amplitude of the displacement at `amplitude_at` in each mode [m or rad], or on a scale common to all tables.
    amplitude_at : str
        Place of the amplitudes; the first place of the shapes by default.
    """

    role: Role
    frequency_hz: tuple[float, ...]
    zeta: tuple[float, ...] = ()
    at: tuple[str, ...] = ()
    shape: Matrix = ()
    frequency_sd_hz: tuple[float, ...] = ()
    zeta_sd: tuple[float, ...] = ()
    shape_sd: tuple[float, ...] = ()
    amplitude: tuple[float, ...] = ()
    amplitude_at: str = ""

    def __post_init__(self) -> None:
        n = len(self.frequency_hz)
        if not n or not all(f > 0 for f in self.frequency_hz):
            raise BadCase("frequency_hz must hold at least one positive frequency")
        if not all(0 <= z < 1 for z in self.zeta):
            raise BadCase("zeta is a ratio from 0 to below 1, not a percentage")
        if not all(a > 0 for a in self.amplitude):
            raise BadCase("amplitude must hold positive displacements, one a mode")
        if self.amplitude and not (self.amplitude_at or self.at):
            raise BadCase("amplitude needs amplitude_at, the place where it was measured")
        for name in ("zeta", "shape", "frequency_sd_hz", "zeta_sd", "shape_sd", "amplitude"):
            if getattr(self, name):
                _same_length(name, getattr(self, name), n, "frequency_hz")
        for row in self.shape:
            _same_length("a row of shape", row, len(self.at), "at")


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
