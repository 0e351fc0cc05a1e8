"""Tables of ``case.toml`` for frequency responses and modes."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vlab.cases.kinds import check_unit
from vlab.errors import BadCase, unknown_name
from vlab.recordings.selection import parse_where

Role = Literal["fit", "holdout"]
Matrix = tuple[tuple[float, ...], ...]

LEAST_SCALE = 1e-30
"""LEAST_SCALE [1]: smallest scale of a channel."""


def same_length(what: str, values: tuple[object, ...], n: int, against: str) -> None:
    """Refuse a list of another length than its companion."""
    if len(values) != n:
        raise BadCase(f"{what} has {len(values)} entries, {against} has {n}")


def check_scale(scale: float) -> None:
    """Refuse a scale that no unit has."""
    if not LEAST_SCALE <= abs(scale) <= 1.0 / LEAST_SCALE:
        raise BadCase(f"the scale is {scale:g}; it must be model unit per file unit, and no such unit is that far off")


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
    conjugate : bool
        Whether this response alone has its phase counted the other way; turns back a ``conjugate`` of the file.
    """

    column: str
    at: str
    imaginary: str = ""
    phase: str = ""
    phase_unit: str = "deg"
    coherence: str = ""
    variance: str = ""
    scale: float = 1.0
    conjugate: bool = False

    def __post_init__(self) -> None:
        check_scale(self.scale)
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
    where : str
        Rows of the file to use, see `vlab.recordings.selection.parse_where`.
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
    where: str = ""
    channel: tuple[FrfChannelTable, ...] = ()

    def __post_init__(self) -> None:
        check_unit(self.frequency_unit, "Hz")
        check_scale(self.scale)
        if self.unit:
            check_unit(self.unit, {"receptance": "m/N", "mobility": "m/s/N", "accelerance": "m/s^2/N"}[self.form])
        if not self.outputs:
            raise BadCase("outputs must name at least one place")
        if self.where:
            parse_where(self.where)
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
            same_length("channel", self.channel, len(self.outputs), "outputs")


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
                same_length(name, getattr(self, name), n, "frequency_hz")
        for row in self.shape:
            same_length("a row of shape", row, len(self.at), "at")
