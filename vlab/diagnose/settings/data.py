"""Settings of data quality, noise and detectors."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class AmplitudeDependenceSettings:
    """Settings of `vlab.diagnose.data.amplitude_dependence`."""

    differ: float = 3.0
    """differ [1]: rms over lines of the difference of two responses over its noise, above 0; default untested. Raising
    it lets larger differences pass as noise."""
    least_shift: float = 0.2
    """least_shift [1]: least relative shift of a natural frequency over the levels, in units of the damping ratio,
    above 0; default a tenth of the half-power width, untested. Raising it leaves larger shifts unreported."""
    least_damping: float = 0.15
    """least_damping [1]: least log ratio of a damping ratio over the levels, above 0; default untested. Raising it
    leaves larger changes of damping unreported."""
    same_mode: float = 0.1
    """same_mode [1]: largest log ratio of two natural frequencies of one mode, above 0; default untested. Raising it
    pairs modes further apart."""


@dataclass(frozen=True, kw_only=True)
class CommandLimitSettings:
    """Settings of `vlab.diagnose.data.command_limit`."""

    explained: float = 0.5
    """explained [1]: least share of the replay's squared error that a limit removes, 0 to 1; default untested. Raising
    it reports fewer limits."""
    grid: int = 24
    """grid [1]: number of trial limits between 0.5 and 1.3 of the largest command, at least 2; default untested.
    Raising it refines the limit and costs one replay per value."""
    at_limit: float = 0.98
    """at_limit [1]: share of the limit from which a command counts as limited, 0 to 1; default untested. Raising it
    counts fewer samples when the limited actuator is identified."""
    span: tuple[float, float] = (0.5, 1.3)
    """span [1]: least and largest trial limit over the largest command, above 0; default untested. A wider span costs
    resolution."""
    most: float = 1.02
    """most [1]: largest limit over the largest command that still acts, above 1; default untested. Raising it reports
    limits that no command reached."""
    near: float = 0.04
    """near [1]: relative half-width of the fine search about the best trial limit, above 0; default about one step of the
    coarse grid. Raising it costs resolution."""
    fine: int = 17
    """fine [1]: trial limits of the fine search, at least 3; default untested. Raising it costs one replay per value."""
    sd: float = 0.0025
    """sd [1]: relative standard deviation of the limit, above 0; default half a step of the fine search. Raising it
    reports wider intervals."""


@dataclass(frozen=True, kw_only=True)
class InterferenceSettings:
    """Settings of `vlab.diagnose.data.mains_interference`."""

    mains_hz: tuple[float, ...] = (50.0, 60.0)
    """mains_hz [Hz]: nominal mains frequencies; a further entry adds a grid."""
    spread_hz: float = 0.2
    """spread_hz [Hz]: largest deviation of the mains, or of the recorder's clock, from nominal, above 0; default
    untested. Raising it searches a wider band around every line."""
    harmonics: tuple[int, ...] = (1, 2, 3)
    """harmonics [1]: multiples of the mains frequency that are searched, from 1; default untested. A further entry adds
    a line."""
    stands_out: float = 30.0
    """stands_out [1]: least power of a line over the median of its neighbours, above 1. White noise exceeds the default
    in one of 10^9 bins; raising it misses weak lines."""
    quarters: int = 4
    """quarters [1]: parts of a recording in which a line's amplitude is estimated, at least 2; default untested.
    Raising it makes the steadiness test stricter and noisier."""
    steady: float = 0.4
    """steady [1]: largest scatter of a line's complex amplitude over the parts, as share of the mean, above 0; default
    untested. A ringing mode scatters more; raising it accepts ringing modes as interference."""
    neighbours: tuple[int, ...] = (*range(6, 30), *range(-6, -30, -1))
    """neighbours [bins]: offsets of the bins that give a line's background, outside the window's main lobe; default
    untested. A wider range averages over more coloured background."""
    one_line: float = 0.8
    """one_line [1]: share of a drive's power in one line from which the drive is a sine, 0 to 1; default untested.
    Raising it keeps more drives broadband."""
    least_cycles: int = 40
    """least_cycles [1]: fewest mains cycles in a recording that separate a line from motion, above 0; default untested.
    Raising it skips more short recordings."""
    highest: float = 0.45
    """highest [1]: highest line as share of the sample rate, 0 to 0.5; default untested. Raising it searches lines
    closer to the Nyquist frequency."""
    blocks_hz: float = 16.0
    """blocks_hz [Hz]: rate to which the band around a line is decimated, above 0; default untested. Raising it costs
    time and widens the band."""
    overlap: int = 4
    """overlap [1]: blocks that a window of the decimation's low-pass spans, at least 1. The default keeps motion of a
    hundred times the interference from aliasing onto the line; raising it costs time."""


@dataclass(frozen=True, kw_only=True)
class NoiseSettings:
    """Settings of `vlab.diagnose.data.noise`."""

    noise_band: float = 0.7
    """noise_band [1]: share of the Nyquist frequency above which the median spectrum is the noise, 0 to 1; default
    untested. Raising it leaves fewer lines and less motion in the band."""
    least_noise: float = 1e-4
    """least_noise [1]: lower bound of the noise as share of a channel's rms, above 0; default untested. It covers
    integrator and converter error; raising it weights clean channels less."""
    segment: int = 1024
    """segment [samples]: longest segment of the spectra, at least 64; default untested. Raising it resolves narrower
    floors with fewer averages."""
    bursts: float = 0.5
    """bursts [1]: ratio of median to mean spectrum below which the median over segments is used, 0 to 1; default
    untested. Raising it discards bursts such as hammer blows more readily."""
    groups: int = 64
    """groups [1]: parts of the spectrum that are compared in the search for a low-pass filter, at least 7; default
    untested. Raising it locates the corner better from noisier medians."""
    flat_groups: int = 6
    """flat_groups [1]: fewest neighbouring groups of a noise floor, at least 2; default a tenth of the spectrum,
    untested. Raising it requires a wider floor."""
    flat: float = 2.0
    """flat [1]: largest power ratio within a noise floor, above 1; default twice the scatter of medians over few
    segments. Raising it accepts sloped spectra as floor."""
    cliff: float = 4.0
    """cliff [1]: least drop in power from the floor to the upper end of the spectrum, above 1; default half in standard
    deviation. Raising it misses weak filters."""
    heard: float = 100.0
    """heard [1]: least ratio of the spectrum's maximum to the floor in power, above 1; default untested. Raising it
    requires a larger signal-to-noise ratio."""
    coherent: float = 0.5
    """coherent [1]: multiple coherence with the inputs above which a floor is response, 0 to 1; default untested.
    Raising it accepts more response as noise."""
    least_segments: int = 8
    """least_segments [1]: fewest segments per input in a coherence estimate, at least 2; default untested. Raising it
    lowers the coherence's bias and resolution."""
    most_order: int = 60
    """most_order [1]: largest order of the one-step predictor, at least 1; default ten modes with three times as many
    coefficients, untested. Raising it predicts more modes and costs time."""
    most_samples: int = 20000
    """most_samples [samples]: samples of a record in the one-step predictor and in the fit of free decays, at least
    64; default a scatter of 0.5 %, untested. Raising it costs time."""
    samples_per_unknown: int = 4
    """samples_per_unknown [1]: fewest samples per coefficient of the predictor, at least 2; default untested. Raising
    it lowers the order in short records."""
    most_decays: int = 24
    """most_decays [1]: most poles of the transient between repeats, at least 2; default twelve modes, untested. Raising
    it removes transients of more modes, and more of a noise that a few modes shape."""
    decay_window: int = 300
    """decay_window [samples]: samples of the windows in which decays are compared, above `most_decays`; default
    untested. Raising it separates closer modes and costs time."""
    degrees: tuple[int, ...] = (1, 3)
    """degrees [1]: degrees of the local polynomials for differences of repeats, from 1; default untested. A further
    entry explains closer resonances in wider bands and costs time."""
    least_left: float = 0.25
    """least_left [1]: least share of the power of a difference of repeats that inputs do not explain, 0 to 1; default
    half in amplitude, untested. Raising it leaves out repeats of slightly different inputs or structures."""
    repeated: float = 0.1
    """repeated [1]: largest rms of the difference of two inputs over their rms in a repeat, above 0; default untested.
    Response to the difference is removed, so raising it accepts repeats whose nonlinear response differs."""
    fewest: int = 64
    """fewest [samples]: fewest samples of an even channel whose noise is estimated, at least 16; default untested.
    Raising it leaves more short channels at `least_noise`."""
    fewest_uneven: int = 16
    """fewest_uneven [samples]: fewest samples of an uneven channel whose noise is estimated, at least 5; default
    untested. Raising it leaves more short channels at `least_noise`."""


@dataclass(frozen=True, kw_only=True)
class QualitySettings:
    """Settings of `vlab.diagnose.data.quality`."""

    most_lost: float = 0.2
    """most_lost [1]: share of lost samples above which a case is refused, 0 to 1; default untested. Raising it accepts
    worse recordings."""
    most_at_limit: float = 0.9
    """most_at_limit [1]: least share of the flat samples at one value for a sensor limit, 0 to 1; default untested.
    Raising it reports fewer limits."""
    same_limit: float = 0.99
    """same_limit [1]: size of a flat top over the largest from which the top is at the limit, 0 to 1; default untested.
    Raising it reports fewer limits."""
    over_limit: float = 1.01
    """over_limit [1]: largest sample over a sensor limit, above 1; default untested. Raising it reports more limits."""
    reach: float = 1.01
    """reach [1]: distance over the longer of both sample periods within which a masked sample masks a point of another
    clock, at least 1; default above rounding. Raising it masks more."""


@dataclass(frozen=True, kw_only=True)
class QuantisationSettings:
    """Settings of `vlab.diagnose.data.quantisation`."""

    benign_step: float = 0.01
    """benign_step [1]: largest unreported quantisation step as share of a channel's rms, above 0; default untested.
    Raising it reports fewer coarse channels."""
    over_noise: float = 2.0
    """over_noise [1]: least step over the high-frequency noise, above 0. Uniform rounding alone has a step of 3.5 times
    its noise; noise over several steps has less than 1. Raising it misses steps under noise."""
    fewest_jumps: int = 10
    """fewest_jumps [1]: fewest jumps of half a step that show quantisation, at least 3; default untested. Raising it
    misses slow channels."""
    fewest: int = 3
    """fewest [1]: fewest steps that the values span, at least 3 since two values are a switch. Raising it misses coarse
    quantisation."""
    sharp: float = 0.42
    """sharp [1]: least modulus of the empirical characteristic function at one cycle per step, 0 to 1. Noise of a fifth
    of the step leaves 0.49, a steady sine below 0.27; raising it misses steps under noise."""
    exact: float = 0.9
    """exact [1]: least modulus of the characteristic function for steps above the rms, 0 to 1; default untested.
    Raising it misses coarse steps under noise."""
    clear: float = 4.0
    """clear [1]: least ratio of the peak of the characteristic function to its preceding minimum, above 1; default
    untested. Raising it misses steps above the rms, where the function falls little."""
    all: float = 0.98
    """all [1]: share of the moving values on steps that replaces the peak ratio, 0 to 1; default untested. Raising it
    requires exact steps."""
    between: float = 0.25
    """between [steps]: distance from a step above which a value lies between steps, 0 to 0.5; default untested. Raising
    it judges smoothness from fewer values."""
    smooth: float = 0.5
    """smooth [1]: mean cosine of successive phase turns above which motion between steps is smooth, -1 to 1; default
    untested. Raising it accepts more signals as quantised."""
    most_peaks: int = 8
    """most_peaks [1]: candidate steps that are examined, largest first, at least 1; default untested. Raising it costs
    time."""
    fine: int = 16
    """fine [1]: histogram bins per smallest step, at least 2; default untested. Raising it refines the histogram and
    costs memory."""
    padded: int = 8
    """padded [1]: length of the zero-padded histogram over its bins, at least 1; default untested. Raising it resolves
    peaks of the characteristic function better and costs time."""
    before_peak: tuple[float, float] = (0.3, 0.8)
    """before_peak [1]: range of the minimum that precedes a peak, as shares of the peak's abscissa, 0 to 1; default
    untested. A wider range finds lower minima."""
    refined: int = 81
    """refined [1]: trial steps about a peak of the characteristic function, at least 3; default untested. Raising it
    costs time."""


@dataclass(frozen=True, kw_only=True)
class ResidualNoiseSettings:
    """Settings of `vlab.diagnose.data.residual_noise`."""

    degree: int = 1
    """degree [1]: degree of the local polynomials, at least 1; resonances that one band may hold. Raising it needs
    wider bands."""
    lines_per_unknown: int = 2
    """lines_per_unknown [1]: spectral lines of a band per unknown of the local fit, at least 2. Raising it widens the
    bands and leaves more degrees of freedom to the noise."""
    motion_band: float = 2.0
    """motion_band [1]: band of the motion in the nonlinear functions over the frequency that holds nearly all power,
    above 1; default untested. Raising it admits more noise."""
    rank: float = 1e-8
    """rank [1]: least singular value over the largest that is no rounding, above 0; default untested. Raising it drops
    more columns."""
    least_freedom: float = 1e-6
    """least_freedom [1]: lower bound of one minus a line's leverage, above 0; default untested. Raising it bounds the
    leave-one-out residual closer."""
    first_lines: int = 3
    """first_lines [1]: lowest spectral lines from which the noise of the mean is extrapolated, at least 1; default
    untested. Raising it averages over more coloured noise."""
    least_snr: float = 10.0
    """least_snr [1]: least ratio of a channel's rms to its incoherent residual, above 1; default 20 dB, untested.
    Raising it reports incoherent noise for cleaner channels only."""


@dataclass(frozen=True, kw_only=True)
class ResponsesSettings:
    """Settings of `vlab.diagnose.data.responses`."""

    model_error: float = 0.02
    """model_error [1]: relative error of a modelled response from truncation, ideal joints and transducers, above 0;
    default untested. Raising it weights large responses less."""
    slope: float = 0.2
    """slope [1]: error of a response as share of the change to the next line, above 0; default untested. Raising it
    weights resonances sharper than the lines less."""
    around: int = 25
    """around [lines]: lines of the running median that estimates a line's noise, at least 3; default untested. Raising
    it smooths the noise estimate."""
    most_lines: int = 250
    """most_lines [lines]: most lines of a response in the search, at least 2; default untested. Raising it thins
    responses less and costs time."""
    frequency_sd: float = 0.01
    """frequency_sd [1]: relative standard deviation of natural frequencies without a stated one, above 0; default the
    repeatability of a modal test between laboratories, untested. Raising it weights frequencies less."""
    zeta_sd: float = 0.25
    """zeta_sd [1]: relative standard deviation of damping ratios without a stated one, above 0; default the
    repeatability between laboratories, untested. Raising it weights damping less."""
    shape_sd: float = 0.05
    """shape_sd [1]: standard deviation of shapes of unit maximum without a stated one, above 0; default the
    repeatability between laboratories, untested. Raising it weights shapes less."""
    frequency_error: float = 0.001
    """frequency_error [1]: relative model error of natural frequencies, above 0; default untested. Raising it weights
    accurate tables less."""
    zeta_error: float = 0.05
    """zeta_error [1]: relative model error of damping ratios, above 0; default untested. Raising it weights accurate
    tables less."""
    shape_error: float = 0.01
    """shape_error [1]: model error of shapes of unit maximum, above 0; default untested. Raising it weights accurate
    tables less."""
    smallest_zeta: float = 1e-5
    """smallest_zeta [1]: lower bound of a modelled damping ratio in log ratios, above 0; default untested. Raising it
    hides differences between lightly damped modes."""
    gives: float = 0.1
    """gives [1]: share of the driving-point mobility with negative real part above which a response is active, 0 to 1;
    default untested. Raising it reports fewer active responses."""
    fewest_lines: int = 8
    """fewest_lines [lines]: fewest lines of a table of responses, at least 3; default untested. Raising it refuses more
    tables."""


@dataclass(frozen=True, kw_only=True)
class RunsSettings:
    """Settings of `vlab.diagnose.data.runs`."""

    points_per_cycle: float = 14.0
    """points_per_cycle [1]: samples per cycle of the highest frequency with power, above 2; default for phase errors
    below 2 %. Raising it thins runs less and costs time."""
    enough_samples: int = 6000
    """enough_samples [samples]: run length below which no run is thinned, above 0; default untested. Raising it keeps
    more samples."""
    most_samples: int = 8000
    """most_samples [samples]: longest part of a run in the search, above 0; default untested. Raising it costs time;
    the verdict always uses whole runs."""
    first_will_do: float = 0.25
    """first_will_do [1]: power of the first part over the strongest part from which the first is used, 0 to 1; default
    untested. The initial state is known best there; raising it selects later parts."""
    band_order: int = 4
    """band_order [1]: order of the low-pass that limits a comparison to a band, at least 1; default untested. Raising it
    separates modes close to the limit and rings longer."""
    power_share: float = 0.99
    """power_share [1]: share of the spectrum's power below the highest frequency, 0 to 1; default untested. Raising it
    raises the highest frequency and the sample rate."""
    windows: int = 16
    """windows [1]: windows of a run in the first fits, at least 1; default untested. Raising it shortens windows and
    follows less slow motion."""
    cycles: float = 3.0
    """cycles [1]: fewest cycles of the slowest oscillating mode in a window, above 0; default untested. Raising it
    lengthens the windows."""
    least_window: int = 150
    """least_window [samples]: shortest window, at least 2; default untested. Raising it lengthens the windows."""
    preroll: int = 120
    """preroll [samples]: smoothed motion and commands before a window that a hysteretic law receives, above 0; default
    untested. Raising it lets longer memory settle and costs time."""
    long_preroll: int = 2000
    """long_preroll [samples]: motion before a window that a law with linear memory receives, and commands that
    hysteresis of an actuator receives, above 0; default untested. Raising it lets lighter oscillators ring, and older
    extremes of a command count, at negligible cost."""
    band_segment: int = 4096
    """band_segment [samples]: longest segment of the spectrum for the highest frequency with power, at least 64; default
    untested. Raising it resolves narrower bands with fewer averages."""
    over_floor: float = 6.0
    """over_floor [1]: least power of a line over the noise floor in the highest frequency, above 1; default untested.
    Raising it lowers the highest frequency of noisy channels."""


AMPLITUDE_DEPENDENCE = AmplitudeDependenceSettings()
COMMAND_LIMIT = CommandLimitSettings()
INTERFERENCE = InterferenceSettings()
NOISE = NoiseSettings()
QUALITY = QualitySettings()
QUANTISATION = QuantisationSettings()
RESIDUAL_NOISE = ResidualNoiseSettings()
RESPONSES = ResponsesSettings()
RUNS = RunsSettings()
