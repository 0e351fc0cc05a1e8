"""Recordings, frequency responses and modal models.

All three are frozen, check themselves on creation and label every channel. Arrays have time or frequency first.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlab.errors import BadRecording, unknown_name

Array = NDArray[Any]
"""Array of floats, or of indices or truth values as named."""
ComplexArray = NDArray[Any]
"""Array of complex numbers."""

SMALLEST, LARGEST = (float(limit**0.25) for limit in (np.finfo(float).tiny, np.finfo(float).max))
"""SMALLEST,
LARGEST [1]: range of sizes with products of squares (of two power spectra) within double precision."""

KIND_UNITS = {
    "command": None,  # unit of the actuator: N, V, N m
    "excitation": None,
    "force": "N",
    "moment": "N m",
    "voltage": "V",
    "current": "A",
    "displacement": "m",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "angle": "rad",
    "angular-velocity": "rad/s",
    "angular-acceleration": "rad/s^2",
    "strain": "1",
    "other": None,
}
"""SI unit of each kind of channel inside vlab; None for a free unit."""
ORDER = {
    "displacement": 0,
    "velocity": 1,
    "acceleration": 2,
    "angle": 0,
    "angular-velocity": 1,
    "angular-acceleration": 2,
}
"""ORDER [-]: time derivatives of position in each kind of motion."""


@dataclass(frozen=True, kw_only=True)
class Channel:
    """Label of one column of a recording.

    Parameters
    ----------
    name : str
        Name, unique in its recording, such as ``"sensor:base"``.
    kind : str
        One of `KIND_UNITS`.
    unit : str
        SI unit of the numbers.
    at : str
        Place, actuator or sensor of the channel.
    is_input : bool
        Whether the channel drives the structure.
    """

    name: str
    kind: str
    unit: str
    at: str = ""
    is_input: bool = False

    def __post_init__(self) -> None:
        if self.kind not in KIND_UNITS:
            raise BadRecording(str(unknown_name("kind of channel", self.kind, KIND_UNITS, where=self.name)))


def _frozen(array: Any, dtype: Any) -> Any:
    """Return a read-only array, without a copy where possible."""
    if isinstance(array, np.ndarray) and array.dtype == dtype and array.flags.owndata and not array.flags.writeable:
        return array
    out = np.array(array, dtype=dtype)
    out.setflags(write=False)
    return out


def rms(values: Array) -> float:
    """Return the root mean square of an array, or 0."""
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else 0.0


def sample_period(time: Array) -> float:
    """Return the sample period of time stamps [s], the median interval."""
    return float(np.median(np.diff(time)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Simultaneously sampled channels in SI units.

    Parameters
    ----------
    time : (n,) array
        Strictly increasing time stamps [s], even or uneven.
    data : (n, n_channels) array
        Finite samples, one column a channel.
    channels : sequence of Channel
        Labels of the columns.
    meta : mapping
        Free notes on the recording (seed, structure, law).
    missing : (n, n_channels) array of bool or None
        Samples without a reading; `data` holds a straight line between the readings there. None without such samples.

    Raises
    ------
    BadRecording
        The data are empty, ragged or not finite, time does not increase, or a channel name is repeated.
    """

    time: Array
    data: Array
    channels: tuple[Channel, ...]
    meta: Mapping[str, Any] = field(default_factory=dict)
    missing: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", _frozen(self.time, float))
        object.__setattr__(self, "data", _frozen(self.data, float))
        object.__setattr__(self, "channels", tuple(self.channels))
        object.__setattr__(self, "meta", MappingProxyType(dict(self.meta)))
        if self.time.ndim != 1 or self.data.ndim != 2 or self.data.shape != (self.time.size, len(self.channels)):
            raise BadRecording(
                f"a recording of {self.time.shape} times, {self.data.shape} samples and {len(self.channels)} channels does not fit together"
            )
        if self.time.size < 2:
            raise BadRecording(f"the recording has {self.time.size} samples; at least 2 are needed")
        if self.missing is not None:
            object.__setattr__(self, "missing", _frozen(self.missing, bool))
            if self.missing.shape != self.data.shape:
                raise BadRecording(f"a mask of shape {self.missing.shape} does not fit samples of {self.data.shape}")
        names = [channel.name for channel in self.channels]
        for name in names:
            if names.count(name) > 1:
                raise BadRecording(f"the channel name {name!r} stands {names.count(name)} times; names must be unique")
        if not np.all(np.isfinite(self.time)) or not np.all(np.diff(self.time) > 0):
            bad = (
                int(np.argmin(np.diff(self.time))) + 1
                if np.all(np.isfinite(self.time))
                else int(np.argmin(np.isfinite(self.time)))
            )
            raise BadRecording(
                f"the time stamps do not increase at sample {bad} (t = {self.time[bad]:g} s); where they are only rounded, give rate_hz instead"
            )
        if not np.all(np.isfinite(self.data)):
            row, column = (int(i) for i in np.argwhere(~np.isfinite(self.data))[0])
            raise BadRecording(
                f"channel {names[column]!r} is {self.data[row, column]} at sample {row} (t = {self.time[row]:g} s); samples must be finite"
            )

    def __len__(self) -> int:
        return int(self.time.size)

    def __repr__(self) -> str:
        """Return size, duration and channels in one line."""
        names = ", ".join(c.name + (f" [{c.unit}]" if c.unit else "") for c in self.channels)
        return f"<Recording: {len(self)} samples, {self.time[-1] - self.time[0]:.4g} s, {names}>"

    def to_pandas(self) -> Any:
        """Return a pandas data frame over time [s], NaN without a reading.

        Raises
        ------
        BadRecording
            The package pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise BadRecording("a data frame needs the package pandas; install it, or use .time and .data") from error
        data = self.data if self.missing is None else np.where(self.missing, np.nan, self.data)
        return pandas.DataFrame(data, columns=list(self.names), index=pandas.Index(self.time, name="time"))

    @property
    def names(self) -> tuple[str, ...]:
        """Channel names in column order."""
        return tuple(channel.name for channel in self.channels)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the input channels."""
        return tuple(c.name for c in self.channels if c.is_input)

    @property
    def is_uniform(self) -> bool:
        """Whether time steps are even within 1e-4."""
        steps = np.diff(self.time)
        return bool(np.ptp(steps) <= 1e-4 * np.mean(steps) + 4 * np.spacing(np.abs(self.time).max()))

    @property
    def sample_period(self) -> float:
        """Median interval of the time stamps [s], even or uneven."""
        return sample_period(self.time)

    @property
    def rate(self) -> float:
        """Sample rate [Hz].

        Raises
        ------
        BadRecording
            The time stamps are not even.
        """
        if not self.is_uniform:
            steps = np.diff(self.time)
            raise BadRecording(
                f"the time steps vary from {steps.min():g} to {steps.max():g} s: the recording has no single rate; resample it first"
            )
        return float((len(self) - 1) / (self.time[-1] - self.time[0]))

    def index(self, name: str) -> int:
        """Return the column of a channel.

        Parameters
        ----------
        name : str
            Name of the channel.

        Raises
        ------
        UnknownName
            No such channel.
        """
        if name not in self.names:
            raise unknown_name("channel", name, self.names)
        return self.names.index(name)

    def __getitem__(self, name: str) -> Array:
        return self.data[:, self.index(name)]

    def select(self, names: str | Sequence[str]) -> "Recording":
        """Return the recording of the named channel or channels."""
        columns = [self.index(name) for name in ([names] if isinstance(names, str) else names)]
        missing = None if self.missing is None else self.missing[:, columns]
        channels = tuple(self.channels[i] for i in columns)
        return replace(self, data=self.data[:, columns], channels=channels, missing=missing)

    def between(self, start: float, stop: float) -> "Recording":
        """Return the samples with start <= time < stop [s]."""
        return self.rows((self.time >= start) & (self.time < stop))

    def rows(self, keep: Array | slice) -> "Recording":
        """Return the samples of a mask, of indices or of a slice."""
        missing = None if self.missing is None else self.missing[keep]
        return replace(self, time=self.time[keep], data=self.data[keep], missing=missing)

    def is_read(self, name: str) -> Array:
        """Return the mask (n,) of a channel's samples with a reading."""
        i = self.index(name)
        return np.ones(len(self), dtype=bool) if self.missing is None else ~self.missing[:, i]


def strung_together(parts: Sequence[Recording]) -> Recording:
    """Return consecutive parts of a recording as one.

    Parameters
    ----------
    parts : sequence of Recording
        Parts of the same channels, in the order of time.

    Returns
    -------
    Recording
        Labels and notes are those of the first part.
    """
    masks = [np.zeros(part.data.shape, dtype=bool) if part.missing is None else part.missing for part in parts]
    return replace(
        parts[0],
        time=np.concatenate([part.time for part in parts]),
        data=np.concatenate([part.data for part in parts]),
        missing=np.concatenate(masks) if any(part.missing is not None for part in parts) else None,
    )


def longest_read(recording: Recording, name: str) -> slice:
    """Return the longest stretch of samples with readings of a channel.

    Parameters
    ----------
    recording : Recording
        Recording.
    name : str
        Channel.

    Returns
    -------
    slice
        Whole recording for a channel without lost readings.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], recording.is_read(name).astype(int), [0]])))
    first, last = edges[::2], edges[1::2]
    if not first.size:
        return slice(0, 0)
    longest = int(np.argmax(last - first))
    return slice(int(first[longest]), int(last[longest]))


def check_sizes(recording: Recording, what: str, *, largest: float = LARGEST, why: str = "") -> None:
    """Refuse excessive samples and vanishing motion.

    Parameters
    ----------
    recording : Recording
        Recording to check.
    what : str
        Name of the file or recording in messages.
    largest : float
        Largest allowed sample, with the reason in `why`.
    why : str
        Reason of the limit, for the message.

    Raises
    ------
    BadRecording
        A sample is too large, or a moving channel moves by less than `SMALLEST`.
    """
    for channel, samples in zip(recording.channels, recording.data.T, strict=True):
        size = float(np.abs(samples).max())
        moves = float(np.ptp(samples)) if size <= largest else size
        if size > largest:
            said = f"reaches {size:.3g} {channel.unit}; at most {largest:.0e} can be computed with{why}"
        elif 0.0 < moves < SMALLEST:
            said = f"moves by {moves:.3g} {channel.unit}; at least {SMALLEST:.0e} can be computed with"
        else:
            continue
        raise BadRecording(f"{what}: {channel.name!r} {said}; check the column, its unit and its scale")


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyResponse:
    """Frequency responses of outputs to inputs.

    Parameters
    ----------
    freq : (n,) array
        Frequencies [Hz], increasing.
    H : (n, n_outputs, n_inputs) complex array
        Response per unit input, SI.
    outputs, inputs : sequence of str
        Channel names.
    unit : str
        Common unit of H, such as ``"m/s/N"``; empty if units differ.
    coherence : (n, n_outputs) array or None
        Ordinary (one input) or multiple coherence, in [0, 1].
    """

    freq: Array
    H: ComplexArray
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    unit: str = ""
    coherence: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "freq", _frozen(self.freq, float))
        object.__setattr__(self, "H", _frozen(self.H, complex))
        object.__setattr__(self, "outputs", tuple(self.outputs))
        object.__setattr__(self, "inputs", tuple(self.inputs))
        expected = (self.freq.size, len(self.outputs), len(self.inputs))
        if self.H.shape != expected:
            raise BadRecording(
                f"a frequency response of shape {self.H.shape} does not fit {expected} (frequency, output, input)"
            )
        if not np.all(np.abs(self.H) <= LARGEST) or not np.all(np.diff(self.freq) > 0):
            raise BadRecording(f"a frequency response must be finite, up to {LARGEST:.0e}, on increasing frequencies")
        if self.coherence is not None:
            object.__setattr__(self, "coherence", _frozen(self.coherence, float))
            if self.coherence.shape != expected[:2]:
                raise BadRecording(
                    f"a coherence of shape {self.coherence.shape} does not fit {expected[:2]} (frequency, output)"
                )

    def __repr__(self) -> str:
        """Return lines, band and channels in one line."""
        band = f"{self.freq[0]:.4g} to {self.freq[-1]:.4g} Hz" if self.freq.size else "no line"
        return f"<{type(self).__name__}: {self.freq.size} lines, {band}, {len(self.outputs)} outputs, {len(self.inputs)} inputs>"

    def between(self, low: float, high: float) -> "FrequencyResponse":
        """Return the lines with low <= frequency <= high [Hz]."""
        keep = (self.freq >= low) & (self.freq <= high)
        coherence = None if self.coherence is None else self.coherence[keep]
        return replace(self, freq=self.freq[keep], H=self.H[keep], coherence=coherence)

    def to_frd(self) -> Any:
        """Return python-control's `FRD`.

        The axes are (output, input, frequency), with frequency in rad/s.
        """
        import control

        return control.FRD(np.transpose(self.H, (1, 2, 0)), 2 * np.pi * self.freq)


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalModel:
    """Natural frequencies, damping ratios and labelled mode shapes.

    Parameters
    ----------
    freq : (n_modes,) array
        Undamped natural frequencies [Hz].
    zeta : (n_modes,) array
        Damping ratios.
    shapes : (n_coordinates, n_modes) array
        Real or complex mode shapes.
    coordinates : sequence of str
        Labels of the rows of `shapes`.
    """

    freq: Array
    zeta: Array
    shapes: NDArray[Any]
    coordinates: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "freq", _frozen(self.freq, float))
        object.__setattr__(self, "zeta", _frozen(self.zeta, float))
        object.__setattr__(self, "shapes", _frozen(self.shapes, complex if np.iscomplexobj(self.shapes) else float))
        object.__setattr__(self, "coordinates", tuple(self.coordinates))
        if self.shapes.shape != (len(self.coordinates), self.freq.size) or self.zeta.shape != self.freq.shape:
            raise BadRecording(
                f"a modal model of {self.freq.size} frequencies, {self.zeta.size} damping ratios and shapes {self.shapes.shape} "
                f"at {len(self.coordinates)} coordinates does not fit together"
            )
