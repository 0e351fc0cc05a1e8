"""Settings of data quality, noise and detectors."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class AmplitudeDependenceSettings:
    """Settings of `vlab.diagnose.data.amplitude_dependence`."""

    differ: float = 3.0
    """Responses of one pair differ where they do so by more than this multiple of their noise, root mean square over lines."""
    least_shift: float = 0.002
    """Change of a frequency and of a damping ratio over the levels that is worth a word."""
    least_damping: float = 0.15
    """See `least_shift`."""
    same_mode: float = 0.1


@dataclass(frozen=True, kw_only=True)
class CommandLimitSettings:
    """Settings of `vlab.diagnose.data.command_limit`."""

    explained: float = 0.5
    """Share of the replay's squared error that a limit must take away."""
    grid: int = 24
    at_limit: float = 0.98
    """Commands above this share of the limit stand at it; it belongs to the actuator with most of them."""


@dataclass(frozen=True, kw_only=True)
class InterferenceSettings:
    """Settings of `vlab.diagnose.data.mains_interference`."""

    mains_hz: tuple[float, ...] = (50.0, 60.0)
    spread_hz: float = 0.2
    """How far the mains, or the recorder's clock, may be from the nominal frequency."""
    harmonics: tuple[int, ...] = (1, 2, 3)
    stands_out: float = 30.0
    """Power of a line over the median of its neighbours: white noise reaches that once in 10^9 bins..."""
    quarters: int = 4
    """...and the complex amplitudes in the quarters of a recording scatter by less than this share of their mean: those of a mode
    that rings scatter more."""
    steady: float = 0.4
    """See `quarters`."""
    neighbours: tuple[int, ...] = (*range(6, 30), *range(-6, -30, -1))
    """Bins around a line, those under its own window aside."""
    one_line: float = 0.8
    """A drive with more than this share of its power in one line is a sine."""
    least_cycles: int = 40
    """Cycles of the mains that a recording must hold for its lines to be told from motion."""
    highest: float = 0.45
    """Lines are looked for below this share of the sample rate."""
    blocks_hz: float = 16.0
    """Rate to which a band around a line is thinned, so that the looking costs nothing, and how many blocks a window of the low-pass before
    it spans: motion a hundred times as large as the hum must not fold onto its line."""
    overlap: int = 4
    """See `blocks_hz`."""


@dataclass(frozen=True, kw_only=True)
class NoiseSettings:
    """Settings of `vlab.diagnose.data.noise`."""

    noise_band: float = 0.7
    """The noise is read off the spectrum above this share of half the sample rate, as its median there."""
    least_noise: float = 1e-4
    """Least noise that is believed, as a share of a channel's rms: what integrators and converters leave."""
    segment: int = 1024
    """Longest segment of the spectra in samples."""
    bursts: float = 0.5
    """The median over segments is taken where it is below this share of their mean: most of them know nothing of a blow in a few."""
    groups: int = 64
    """Parts of the spectrum whose medians are compared where a filter is looked for."""
    flat_groups: int = 6
    """Fewest neighbouring groups that are a floor, a tenth of the spectrum."""
    flat: float = 2.0
    """A floor's groups are within this ratio in power; medians of few segments scatter by half of it."""
    cliff: float = 4.0
    """A filter takes this ratio in power off the noise at the upper end: less is half the standard deviation or less."""
    heard: float = 100.0
    """Somewhere a channel has this many times the floor's power: what was measured must stand out of a floor."""
    coherent: float = 0.5
    """A floor of which the inputs explain this share is no noise: the thing answers, up to where its excitation ends."""
    least_segments: int = 8
    """Fewest segments per input that a coherence is averaged over."""


@dataclass(frozen=True, kw_only=True)
class QualitySettings:
    """Settings of `vlab.diagnose.data.quality`."""

    most_lost: float = 0.2
    """A case of which a larger share of samples is lost says nothing."""
    most_at_limit: float = 0.9
    """Share of the samples at flat tops that must stand at one limit for it to be one."""


@dataclass(frozen=True, kw_only=True)
class QuantisationSettings:
    """Settings of `vlab.diagnose.data.quantisation`."""

    benign_step: float = 0.01
    """A step below this share of its channel's rms, in all recordings together, is what every laboratory has."""
    over_noise: float = 2.0
    """...and so is one below this multiple of the noise at the upper end of the spectrum: evenly spread roundings alone are 3.5
    times theirs, roundings of what noise has spread over several steps less than once."""
    fewest: int = 3
    """Steps that the values reach over at least: two values are a switch."""
    sharp: float = 0.42
    """Characteristic function at one cycle per step, of the values that move, above which they stand on steps: noise of a fifth of
    the step that comes after it leaves .49. A steady sine has |J0|, which is less than .27 for steps below its rms; larger steps must be
    exact."""
    exact: float = 0.9
    """See `sharp`."""
    clear: float = 4.0
    """...and by this factor over what it has fallen to before, unless all that moves stands on them: of steps larger than the rms most
    values are zero, and the function falls little in between."""
    all: float = 0.98
    """See `clear`."""
    between: float = 0.25
    """Values further off their steps than this share of one say how they got there: smoothly where the mean cosine of the turn from the value
    before them, a step being a whole one, is above this."""
    smooth: float = 0.5
    """See `between`."""
    most_peaks: int = 8
    """Steps that are looked at, the largest first."""
    fine: int = 16
    """Bins of the histogram for the smallest step looked for."""


@dataclass(frozen=True, kw_only=True)
class ResidualNoiseSettings:
    """Settings of `vlab.diagnose.data.residual_noise`."""

    degree: int = 1
    """Degree of the local polynomials [1]: resonances that one band may hold."""
    lines_per_unknown: int = 2
    """Spectral lines of a band per unknown of its fit [1]: half of them are left to tell noise from what is explained."""
    motion_band: float = 2.0
    """Nonlinear functions are taken of the motion below this multiple of the frequency that holds nearly all of its power [1]."""
    rank: float = 1e-8
    """Singular values below this share of the largest are rounding [1]."""
    least_freedom: float = 1e-6
    """Least share of a line that its own fit leaves free [1]: rounding alone is below."""
    first_lines: int = 3
    """Spectral lines from which the noise's share of the mean is extrapolated [1]."""
    least_snr: float = 10.0
    """Least ratio of a channel's rms to its incoherent residual [1]: of more (20 dB) no noise is told from physics that these functions miss."""


@dataclass(frozen=True, kw_only=True)
class ResponsesSettings:
    """Settings of `vlab.diagnose.data.responses`."""

    model_error: float = 0.02
    """Relative error of a model's response that is no missing physics: modes cut off, joints idealised, transducers."""
    slope: float = 0.2
    """Share of the change to the neighbouring line that a response may be off by: resonances sharper than the lines."""
    around: int = 25
    """Lines around one from which its noise is estimated."""
    most_lines: int = 250
    """Lines of a response that the search uses; where a file has more, those that change little are thinned out."""
    frequency_sd: float = 0.01
    """Relative standard deviations of natural frequencies and damping ratios, and that of shapes of unit maximum, where a table
    says nothing: what the repetition of a modal test by others leaves."""
    zeta_sd: float = 0.25
    """See `frequency_sd`."""
    shape_sd: float = 0.05
    """See `frequency_sd`."""
    frequency_error: float = 0.001
    """What a model may be off by besides, which is no missing physics."""
    zeta_error: float = 0.05
    """See `frequency_error`."""
    shape_error: float = 0.01
    """See `frequency_error`."""
    smallest_zeta: float = 1e-5
    gives: float = 0.1
    """A response whose mobility at the driven place has a negative real part, on the whole, by this share of its size gives power."""


@dataclass(frozen=True, kw_only=True)
class RunsSettings:
    """Settings of `vlab.diagnose.data.runs`."""

    points_per_cycle: float = 14.0
    """Samples of the search per cycle of the fastest motion that carries power: phase errors of its laws stay below 2 %."""
    enough_samples: int = 6000
    """A run is not thinned below this length."""
    most_samples: int = 8000
    """The search looks at a part of longer runs, see `liveliest`; the verdict at all of them."""
    first_will_do: float = 0.25
    """It is the first part, whose start is known best, where that has this share of the power of any other."""
    power_share: float = 0.99
    windows: int = 16
    """A run is cut into this many windows for the first fits."""
    cycles: float = 3.0
    """A window holds at least this many cycles of the slowest mode that oscillates; whole runs say more of it."""
    least_window: int = 150
    preroll: int = 120
    """Samples of smoothed motion that a law with memory sees before a window, and of commands, which may come out late."""
    long_preroll: int = 2000
    """The same of laws that are linear in what they remember, which costs them nothing: a light oscillator rings for that long."""


AMPLITUDE_DEPENDENCE = AmplitudeDependenceSettings()
COMMAND_LIMIT = CommandLimitSettings()
INTERFERENCE = InterferenceSettings()
NOISE = NoiseSettings()
QUALITY = QualitySettings()
QUANTISATION = QuantisationSettings()
RESIDUAL_NOISE = ResidualNoiseSettings()
RESPONSES = ResponsesSettings()
RUNS = RunsSettings()
