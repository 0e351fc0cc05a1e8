"""Measured frequency responses and modal tables, with noise and model error.

The noise of a response without stated coherence comes from its roughness over lines. With coherence gamma^2 and n
averages the relative error is sqrt((1 - gamma^2) / (gamma^2 n)) (Bendat and Piersol, Random Data, 4th ed., 9.81).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.ndimage import median_filter

from vlab.cases.case import Case
from vlab.cases.description import FrfTable, ModalTable
from vlab.diagnose.settings import RESPONSES
from vlab.errors import BadCase
from vlab.recordings.responses import to_frequency_response
from vlab.recordings.selection import parse_where, select_rows
from vlab.recordings.table import Table
from vlab.signals import Array, ComplexArray

Role = Literal["fit", "holdout"]
ORDERS = {"receptance": 0, "mobility": 1, "accelerance": 2}
"""Time derivatives of displacement in each form of a response."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """Measured responses to one input.

    Parameters
    ----------
    name : str
        Name in the report.
    role : {"fit", "holdout"}
        Use of the data.
    input : str
        Location of the force.
    outputs : tuple of str
        Locations of the motion.
    order : int
        0 receptance, 1 mobility, 2 accelerance.
    freq : (n,) array
        Lines [Hz], above zero.
    H : (n, n_outputs) complex array
        Response [SI]; magnitude where `is_magnitude`.
    noise : (n, n_outputs) array
        Standard deviation of the measurement noise.
    spread : (n, n_outputs) array
        Standard deviation with the error from the line spacing.
    is_magnitude : bool
        Whether the phase is unknown.
    level : float or None
        Level of the excitation: rms of the input in its unit, or on a scale common to all responses.
    is_random : bool
        Whether the excitation is Gaussian noise over the band of the lines, instead of a stepped sine.
    """

    name: str
    role: Role
    input: str
    outputs: tuple[str, ...]
    order: int
    freq: Array
    H: ComplexArray
    noise: Array
    spread: Array
    is_magnitude: bool
    level: float | None = None
    is_random: bool = False

    @property
    def omega(self) -> Array:
        """Circular frequencies of the lines [rad/s]."""
        return 2 * np.pi * self.freq

    @property
    def gives_power(self) -> bool:
        """Whether the driving point returns power, unlike any passive structure.

        The cause is a reversed sign or a conjugated response; a mobility does not show conjugation.
        """
        if self.is_magnitude or self.input not in self.outputs:
            return False
        mobility = self.H[:, self.outputs.index(self.input)] / (1j * self.omega) ** (self.order - 1)
        return float(np.sum(mobility.real)) < -RESPONSES.gives * float(np.sum(np.abs(mobility)))

    def on(self, keep: Array) -> "Response":
        """Return the response on some of its lines."""
        return replace(self, freq=self.freq[keep], H=self.H[keep], noise=self.noise[keep], spread=self.spread[keep])

    def of_output(self, index: int) -> "Response":
        """Return the response of one output.

        Parameters
        ----------
        index : int
            Index of the output.

        Returns
        -------
        Response
            Response with a single column.
        """
        one = slice(index, index + 1)
        return replace(
            self,
            name=f"{self.name}:{self.outputs[index]}",
            outputs=self.outputs[one],
            H=self.H[:, one],
            noise=self.noise[:, one],
            spread=self.spread[:, one],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Modes:
    """Measured modal table.

    Parameters
    ----------
    name : str
        Name in the report.
    role : {"fit", "holdout"}
        Use of the data.
    freq, zeta : (n,) array
        Natural frequencies [Hz] and damping ratios [1]; NaN where unknown.
    at : tuple of str
        Locations of the shapes.
    shapes : (n, n_places) array
        Shapes of unit maximum; without columns where unknown.
    freq_sd, zeta_sd, shape_sd : (n,) array
        Standard deviations with model error: relative, relative, and of shapes of unit maximum.
    amplitude : (n,) array or None
        Amplitude of every mode at `amplitude_at` [m or rad], or on a scale common to all tables; None where unknown.
    amplitude_at : str
        Location of the amplitudes.
    """

    name: str
    role: Role
    freq: Array
    zeta: Array
    at: tuple[str, ...]
    shapes: Array
    freq_sd: Array
    zeta_sd: Array
    shape_sd: Array
    amplitude: Array | None = None
    amplitude_at: str = ""

    @property
    def n(self) -> int:
        """Number of modes."""
        return len(self.freq)

    @property
    def entries(self) -> int:
        """Number of values in the table without the shapes' scales."""
        return int(self.n + np.isfinite(self.zeta).sum() + self.n * max(self.shapes.shape[1] - 1, 0))

    def without(self, mode: int) -> "Modes":
        """Return the table without the values of one mode.

        The mode remains known to exist.
        """
        sds = {name: getattr(self, name).copy() for name in ("freq_sd", "zeta_sd", "shape_sd")}
        for sd in sds.values():
            sd[mode] = 1e6
        return replace(self, **sds)


Measured = Response | Modes


def read_measured(case: Case, roles: Sequence[str]) -> list[Measured]:
    """Read the frequency responses and modal tables of a case.

    Parameters
    ----------
    case : Case
        Case.
    roles : sequence of str
        Roles to read.

    Returns
    -------
    list of Response or Modes
        Measured data.

    Raises
    ------
    BadRecording
        A file is damaged or contradicts the case.
    """
    out: list[Measured] = []
    for i, frf in enumerate(case.table.frf):
        if frf.role in roles:
            out.append(_response(case, frf, f"frf{i + 1}"))
    for i, modal in enumerate(case.table.modal):
        if modal.role in roles:
            out.append(_modes(modal, f"modal{i + 1}"))
    return out


def thinned(measured: Sequence[Measured]) -> list[Measured]:
    """Thin responses to at most `RESPONSES.most_lines` lines each.

    Lines are dropped where the responses change least. Responses on equal lines keep equal lines, in one array.

    Parameters
    ----------
    measured : sequence of Response or Modes
        Measured data.

    Returns
    -------
    list of Response or Modes
        Thinned data.
    """
    groups: dict[bytes, list[Response]] = {}
    for data in measured:
        if isinstance(data, Response):
            groups.setdefault(data.freq.tobytes(), []).append(data)
    chosen = {key: _telling(group) for key, group in groups.items()}
    lines = {key: group[0].freq[chosen[key]] for key, group in groups.items()}
    out: list[Measured] = []
    for data in measured:
        if isinstance(data, Response):
            key = data.freq.tobytes()
            out.append(replace(data.on(chosen[key]), freq=lines[key]))
        else:
            out.append(data)
    return out


def _telling(group: Sequence[Response]) -> Array:
    """Return the kept lines, dense where a response changes fast."""
    n = len(group[0].freq)
    if n <= RESPONSES.most_lines:
        return np.arange(n)
    weight = np.zeros(n)
    for data in group:
        power = np.log(np.maximum(np.sum(np.abs(data.H) ** 2, axis=1), 1e-300))
        change = median_filter(np.abs(np.gradient(power)), 3)
        weight += change / max(float(change.mean()), 1e-300) + 2.0
    covered = np.cumsum(weight) / weight.sum() * RESPONSES.most_lines
    return np.unique(np.searchsorted(covered, np.arange(0.5, RESPONSES.most_lines)))


def _response(case: Case, table: FrfTable, name: str) -> Response:
    file = select_rows(case.open_file(table.file), parse_where(table.where) if table.where else ())
    read = to_frequency_response(file, table)
    used = (read.freq > 0) & (read.freq >= table.low_hz) & (read.freq <= (table.high_hz or np.inf))
    scales = np.abs(_scales(table)) if read.is_magnitude else _scales(table)
    freq, H = read.freq[used], read.H[used, :, 0] * scales
    turned = np.array([table.conjugate != own for own in _conjugated(table)])
    H = np.where(turned, np.conj(H), H)
    if len(freq) < RESPONSES.fewest_lines:
        raise BadCase(
            f"{case.path}: {table.file} has {len(freq)} lines above 0 Hz in its band; "
            f"at least {RESPONSES.fewest_lines} are needed"
        )
    if not np.all(np.any(H != 0, axis=0)):
        raise BadCase(f"{case.path}: {table.file}: an output is zero on all lines; leave it out")
    guessed = np.sqrt(_roughness(freq, H))
    noise = np.column_stack(
        [
            guessed[:, k] if given is None else given
            for k, given in enumerate(_given_noise(file, table, H, used, len(read.freq)))
        ]
    )
    steps = np.abs(np.diff(H, axis=0))
    change = np.maximum(np.concatenate([steps[:1], steps]), np.concatenate([steps, steps[-1:]]))
    return Response(
        name=name,
        role=table.role,
        input=table.input,
        outputs=table.outputs,
        order=ORDERS[table.form],
        freq=freq,
        H=H,
        noise=noise,
        spread=np.hypot(noise, RESPONSES.slope * change),
        is_magnitude=read.is_magnitude,
        level=table.level,
        is_random=table.excitation == "random",
    )


def _scales(table: FrfTable) -> Array:
    """Return the scale factors (n_outputs,) of the responses."""
    each = {channel.at: channel.scale for channel in table.channel}
    return table.scale * np.array([each.get(output, 1.0) for output in table.outputs])


def _conjugated(table: FrfTable) -> list[bool]:
    """Return whether the case conjugates each output on its own."""
    each = {channel.at: channel.conjugate for channel in table.channel}
    return [each.get(output, False) for output in table.outputs]


def _given_noise(file: Table, table: FrfTable, H: ComplexArray, used: Array, lines: int) -> list[Array | None]:
    """Return outputs' standard deviations from stated coherence or variance, or None."""
    by_output = {channel.at: channel for channel in table.channel}
    out: list[Array | None] = []
    for k, output in enumerate(table.outputs):
        channel = by_output.get(output)
        column = "" if channel is None else channel.coherence or channel.variance
        if channel is None or not column:
            out.append(None)
            continue
        values = file.real(column)
        if len(values) != lines:
            raise BadCase(f"{table.file}: column {column!r} has {len(values)} lines, the frequencies {lines}")
        values = values[used]
        if channel.variance:
            if np.any(values < 0):
                raise BadCase(f"{table.file}: column {column!r} holds a negative variance")
            size = np.abs(H[:, k])
            out.append(np.sqrt(values) * abs(_scales(table)[k]) + 1e-6 * np.sqrt(np.mean(size**2)))
            continue
        if np.any((values < 0) | (values > 1)):
            raise BadCase(f"{table.file}: column {column!r} is no coherence; one lies between 0 and 1")
        # Bendat and Piersol, Random Data, 4th ed., (9.81): the relative error of a response
        known = np.clip(values, 1e-3, 1 - 1e-6)
        out.append(np.abs(H[:, k]) * np.sqrt((1 - known) / (known * table.averages)))
    return out


def _roughness(freq: Array, H: ComplexArray) -> Array:
    """Return the noise variance from lines' distances to neighbours' cubics.

    A running median follows the noise over frequency: a hammer excites high frequencies weakly, so division by a small
    force amplifies noise. A resonance sharper than the lines is no noise.
    """
    weights = np.stack([_lagrange(freq, k) for k in range(2, len(freq) - 2)])  # (n, 4)
    around = np.stack([H[:-4], H[1:-3], H[3:-1], H[4:]], axis=1)
    apart = np.abs(H[2:-2] - np.einsum("nk,nko->no", weights, around)) ** 2 / (1 + np.sum(weights**2, axis=1))[:, None]
    apart = np.concatenate([apart[:1], apart[:1], apart, apart[-1:], apart[-1:]])
    middle = median_filter(apart, size=(min(RESPONSES.around, len(freq) // 2), 1), mode="nearest") / np.log(2)
    return np.asarray(middle + 1e-12 * np.mean(np.abs(H) ** 2, axis=0))


def _lagrange(freq: Array, k: int) -> Array:
    """Return the cubic's weights at line k of four neighbours."""
    nodes = freq[[k - 2, k - 1, k + 1, k + 2]] - freq[k]
    return np.array([np.prod(np.delete(nodes, i) / (np.delete(nodes, i) - nodes[i])) for i in range(4)])


def _modes(table: ModalTable, name: str) -> Modes:
    n = len(table.frequency_hz)
    freq = np.array(table.frequency_hz)
    order = np.argsort(freq)
    zeta = np.array(table.zeta) if table.zeta else np.full(n, np.nan)
    zeta = np.where(zeta > 0, zeta, np.nan)
    shapes = np.array(table.shape).reshape(n, -1) if table.shape else np.zeros((n, 0))
    largest = np.abs(shapes).max(axis=1, keepdims=True) if shapes.size else np.ones((n, 1))
    if np.any(largest == 0):
        raise BadCase("a modal table has a shape of zeros; leave out that mode or its shape")
    freq_sd = np.array(table.frequency_sd_hz) / freq if table.frequency_sd_hz else np.full(n, RESPONSES.frequency_sd)
    zeta_sd = np.array(table.zeta_sd) / zeta if table.zeta_sd else np.full(n, RESPONSES.zeta_sd)
    shape_sd = np.array(table.shape_sd) / largest[:, 0] if table.shape_sd else np.full(n, RESPONSES.shape_sd)
    return Modes(
        name=name,
        role=table.role,
        freq=freq[order],
        zeta=zeta[order],
        at=table.at if table.shape else (),
        shapes=(shapes / largest)[order],
        freq_sd=np.hypot(freq_sd, RESPONSES.frequency_error)[order],
        zeta_sd=np.hypot(zeta_sd, RESPONSES.zeta_error)[order],
        shape_sd=np.hypot(shape_sd, RESPONSES.shape_error)[order],
        amplitude=np.array(table.amplitude)[order] if table.amplitude else None,
        amplitude_at=(table.amplitude_at or table.at[0]) if table.amplitude else "",
    )
