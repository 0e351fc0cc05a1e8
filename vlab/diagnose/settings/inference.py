"""Settings of fits and evidence."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class EvidenceSettings:
    """Settings of `vlab.diagnose.inference.evidence`."""

    model_error_samples: float = 40.0
    """model_error_samples [1]: effective sample size of a model's own error, which does not average out, above 0;
    default untested. Raising it makes differences of model error more decisive."""
    unheld: float = 40.0
    """unheld [nat]: negative log prior of a nonlinear or negative spring at a free port, above 0; default a residual
    smaller by a factor of e. Raising it rejects such springs more often."""
    all_alike: float = 4.0
    """all_alike [nat]: negative log prior of an effect in all drives, for families usual in one drive, above 0; default
    untested. Raising it favours the effect in a single drive."""
    noise_known: float = 0.03
    """noise_known [1]: relative uncertainty of the noise variance, above 0; default untested. Raising it counts more of
    the residual as noise."""


@dataclass(frozen=True, kw_only=True)
class FrequencyFitSettings:
    """Settings of `vlab.diagnose.inference.frequency_least_squares`."""

    prior_bound: float = 3.0
    """prior_bound [sd]: bound of uncertain parameters about their prior means, above 0; default untested. Raising it
    lets the fit calibrate larger deviations instead of reporting an effect."""
    iterations: int = 25
    """iterations [1]: most Gauss-Newton iterations of a fit, at least 1; default untested. Raising it costs time."""
    coarse: tuple[float, ...] = (0.25, 0.08)
    """coarse [1]: relative widths of the frequency bands in the first fits, widest first, above 0; default untested.
    Wider bands admit worse starting values."""
    coarse_iterations: int = 5
    """coarse_iterations [1]: iterations per band width, at least 1; default untested. Raising it costs time."""
    loose: float = 3.0
    """loose [1]: upper bound of the standard deviation of an effect parameter's logarithm, above 0; default untested.
    Raising it reports wider intervals for unidentifiable parameters."""
    still: float = 1e-4
    """still [1]: relative decrease of the cost below which a fit ends, above 0; default untested. Raising it ends fits
    earlier."""
    damping: float = 1e-3
    """damping [1]: first Levenberg-Marquardt damping, above 0; default untested. Raising it begins with smaller steps."""
    relaxed: float = 0.2
    """relaxed [1]: factor on the damping after a decrease of the cost, 0 to 1; default untested. Raising it keeps small
    steps longer."""
    stiffened: float = 8.0
    """stiffened [1]: factor on the damping where a step does not decrease the cost, above 1; default untested. Raising it
    ends fits with fewer evaluations."""
    damping_range: tuple[float, float] = (1e-9, 1e8)
    """damping_range [1]: least damping, and the damping at which a fit ends, above 0; default untested. A wider range
    costs evaluations."""
    most_step: float = 2.0
    """most_step [1]: largest step of any coordinate, above 0; default a factor of seven in a logarithm, untested. Raising
    it risks jumps to distant optima."""


@dataclass(frozen=True, kw_only=True)
class HypothesisFitsSettings:
    """Settings of `vlab.diagnose.inference.hypothesis_fits`."""

    quick: int = 5
    """quick [1]: iterations of the first fit of every hypothesis, at least 1; default untested. Raising it ranks
    hypotheses better and costs time."""
    finished: int = 4
    """finished [1]: best hypotheses that are fitted to convergence, at least 1; default untested. Raising it costs
    time."""
    first: int = 2
    """first [1]: iterations that select among discrete starting values, at least 1; default untested. Raising it costs
    time."""
    whole_iterations: int = 5
    """whole_iterations [1]: iterations of a fit to whole runs, at least 1; default untested. Raising it costs time."""
    whole_finished: int = 3
    """whole_finished [1]: best hypotheses that are fitted to whole runs, at least 1; default untested. Raising it costs
    time."""
    nearly_as_little: float = 1.25
    """nearly_as_little [1]: mean square over the least mean square up to which a whole-run fit continues, above 1;
    default untested. Raising it continues more fits."""
    places: int = 5
    """places [1]: locations at which the chosen effect is fitted again, at least 1; default untested. Raising it widens
    the location posterior and costs time."""
    enough: float = 1.3
    """enough [1]: normalised residual below which a hypothesis explains the recordings, above 1; default untested.
    Raising it ends the search earlier."""
    hopeless: float = 12.0
    """hopeless [nat]: score below the best at which a hypothesis is dropped, above 0; default untested. A law in all joints
    that far behind ends its selection. Raising it fits more hypotheses to convergence."""


@dataclass(frozen=True, kw_only=True)
class JacobianSettings:
    """Settings of `vlab.diagnose.inference.jacobian`."""

    smooth_step: float = 1e-4
    """smooth_step [sd]: finite-difference step of uncertain parameters without nonsmooth laws, above 0; default
    untested. Raising it adds truncation error."""
    moved: float = 0.25
    """moved [1]: rms of the normalised residual's change by one finite-difference step, above 0; default untested.
    Raising it averages over nonsmooth events with more truncation error."""
    widest: tuple[float, ...] = (100.0, 5.0)
    """widest [1]: largest factors on the usual steps of uncertain parameters and of effect parameters, above 1; default
    untested. The factors allow one standard deviation and a twentieth; raising them allows more truncation error."""


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """Settings of `vlab.diagnose.inference.least_squares`."""

    iterations: int = 12
    """iterations [1]: most Levenberg-Marquardt iterations of a fit, at least 1; default untested. Raising it costs
    time."""
    frozen: int = 2
    """frozen [1]: first iterations with fixed shape parameters, at least 0; default untested. A gap or slip limit that
    moves at once moves out of the motion; raising it delays the shapes."""
    explained: float = 1.7
    """explained [1]: mean square of the normalised residual below which no second start is needed, above 1; default
    untested. Raising it makes fewer second starts."""
    distant: float = 1.5
    """distant [1]: squared prior distance over the number of parameters above which a second start is made, above 1;
    default untested. Raising it makes fewer second starts."""
    near_enough: float = 1.0
    """near_enough [nat]: cost decrease in squared standard deviations below which a comparison of hypotheses ends,
    above 0; default untested. Raising it ends fits earlier."""
    exact: float = 0.02
    """exact [nat]: cost decrease in squared standard deviations below which a parameter estimate ends, above 0; default
    untested. Raising it ends final fits earlier."""
    cheaper: float = 0.5
    """cheaper [nat]: cost decrease above which a descent continues although the residual is noise, above 0; default
    untested. Raising it ends such descents earlier."""
    more: int = 12
    """more [1]: additional iterations of a descent that still decreases the cost, at least 0; default untested. Raising
    it costs time."""
    noise: float = 0.95
    """noise [1]: mean square of the normalised residual below which the residual is noise, about 1; default untested.
    Raising it ends fits earlier."""
    undamped: float = 1e-10
    """undamped [1]: Levenberg-Marquardt damping of a full Gauss-Newton step, near 0; default untested. Raising it slows
    descents along narrow valleys of correlated parameters."""
    parts: tuple[float, ...] = (1.0, 0.3, 0.1)
    """parts [1]: trial fractions of the full Gauss-Newton step, 0 to 1; default untested. A further entry follows bent
    valleys better and costs one evaluation."""
    passes: int = 2
    """passes [1]: recomputations of the final Jacobian along its own singular directions, at least 0; default untested.
    Raising it improves intervals and costs time."""
    reused: int = 3
    """reused [1]: iterations with a Broyden update before a new Jacobian, at least 0; default untested. Raising it
    saves evaluations at worse steps."""
    loose_start: float = 0.03
    """loose_start [1]: standard deviation of a window's initial state over its rms, above 0; default untested. Raising
    it lets initial states absorb more residual."""
    most_directions: int = 100
    """most_directions [1]: most identifiable directions of the uncertain parameters, at least 1; default untested.
    Raising it costs time."""
    most_started: int = 6
    """most_started [1]: modes whose initial state is estimated, at least 0; default untested. Raising it adds nuisance
    parameters."""
    informed: float = 0.005
    """informed [1]: least rms change of the normalised channels by one prior standard deviation of an identifiable
    direction, above 0; default untested. Raising it fixes more directions at the prior mean."""
    probe: float = 0.3
    """probe [sd]: step of uncertain parameters in the search for the identifiable subspace, above 0; default untested.
    Raising it averages over more nonlinearity."""
    largest: float = 1e8
    """largest [1]: bound of a normalised residual of a diverged trial, above 1; default untested. Raising it risks
    overflow of squares."""
    damping: float = 1e-3
    """damping [1]: first Levenberg-Marquardt damping, above 0; default untested. Raising it begins with smaller steps."""
    damped: tuple[float, ...] = (1.0, 1e2, 1e5)
    """damped [1]: factors on the damping of the trial steps, above 0; default untested. A further entry costs one
    evaluation."""
    relaxed: float = 0.1
    """relaxed [1]: factor on the damping after a decrease of the cost, 0 to 1; default untested. Raising it keeps small
    steps longer."""
    stiffened: float = 1e4
    """stiffened [1]: factor on the damping where no step decreases the cost, above 1; default untested. Raising it ends
    such descents earlier."""
    damping_range: tuple[float, float] = (1e-8, 1e6)
    """damping_range [1]: least damping, and the damping above which a descent ends, above 0; default untested. A wider
    range costs evaluations."""
    beside: tuple[float, ...] = (1.0, 0.3, 0.05)
    """beside [1]: shares of a new term's amplitude in the starts beside an earlier fit, 0 to 1; default untested. A
    further entry costs one evaluation."""
    least_highest_hz: float = 5e-4
    """least_highest_hz [Hz]: least highest frequency of a fit, above 0; default for models without stiffness, untested.
    Raising it integrates slow models in finer steps."""


@dataclass(frozen=True, kw_only=True)
class ModelChoiceSettings:
    """Settings of `vlab.diagnose.inference.model_choice`."""

    explained: float = 0.5
    """explained [1]: share of the excess over the noise that an effect must remove, 0 to 1; default untested. Raising
    it accepts fewer effects. Laws in all joints need the same share of the largest gain of such a law."""
    together: float = 0.75
    """together [1]: share of the excess that two effects must remove where neither alone suffices, 0 to 1; default
    untested. Raising it accepts fewer pairs."""
    second_share: float = 0.005
    """second_share [1]: share of the initial excess that a second effect must remove, 0 to 1; default untested. Raising
    it accepts fewer second effects."""
    above_noise: float = 1.3
    """above_noise [1]: normalised residual below which nothing remains to be explained, above 1; default untested.
    Raising it accepts fewer effects."""
    beyond_prior: float = 10.0
    """beyond_prior [nat]: least posterior gain of a nonlinear effect over the refit, plus 2 per further parameter,
    above 0. A chi-squared of one degree of freedom exceeds 20 once in 10^5; raising it accepts fewer effects."""
    of_linear: float = 6.0
    """of_linear [nat]: least posterior gain of a linear effect over the refit, above 0. A chi-squared of one degree of
    freedom exceeds 12 once in 2000, and linear laws are few; raising it accepts fewer effects."""
    of_pairs: float = 6.0
    """of_pairs [nat]: additional gain for two effects at once, above 0. The best of a thousand pairs gains 7 by chance;
    raising it accepts fewer pairs."""
    lapse: float = 0.04
    """lapse [1]: probability of physics outside the catalogue or of a wrong optimum, 0 to 1; default from the named
    effects of an earlier campaign of concealed cases. Raising it lowers every probability."""
    near_mains: float = 0.5
    """near_mains [Hz]: distance from a mains harmonic within which a force needs more than likelihood, above 0; default
    untested. Interference adds up over all recordings; raising it rejects more periodic forces."""
    alike: float = 3.0
    """alike [nat]: score difference within which hypotheses are indistinguishable, above 0; default odds of 1 to 20.
    Raising it lists more alternatives."""
    ranked: int = 6
    """ranked [1]: hypotheses that share the probability with the best one in the ranking, at least 1; default untested.
    Raising it lowers every probability."""


@dataclass(frozen=True, kw_only=True)
class ParameterVectorSettings:
    """Settings of `vlab.diagnose.inference.parameter_vector`."""

    prior_bound: float = 6.0
    """prior_bound [sd]: bound of uncertain parameters about their prior means, above 0; default untested. An active
    bound stops a descent, so raising it lets fits move further; only the prior enters the score."""
    furthest: float = 9.0
    """furthest [1]: bound of the log ratio of a positive effect parameter to its start, above 0; default untested.
    Raising it widens the search."""
    step: float = 1e-2
    """step [1]: finite-difference step of uncertain parameters and offsets [sd], and relative step of effect
    parameters, above 0; default untested. Raising it adds truncation error."""
    start_step: float = 0.1
    """start_step [1]: finite-difference step of initial states in their scale, above 0; default untested. Raising it
    adds truncation error."""
    least_step: float = 1e-12
    """least_step [1]: least finite-difference step of a signed effect parameter in its unit, above 0; default untested.
    Raising it blurs small parameters."""
    start_size: float = 0.01
    """start_size [1]: scale of estimated initial states over the largest one, above 0; default untested. Raising it
    loosens the initial states."""


@dataclass(frozen=True, kw_only=True)
class ScoreTestSettings:
    """Settings of `vlab.diagnose.inference.score_test`."""

    slow: float = 1e-3
    """slow [1]: factor on the unknown-force intensity of the slow observer, 0 to 1; default untested. A slow observer
    detects effects that accumulate over many cycles; raising it speeds the observer up."""
    refits: int = 4
    """refits [1]: refits of the uncertain parameters before the screening, at least 1; default untested. Each refit
    uses a filter with less process noise; raising it costs time."""
    offset_sd: tuple[float, ...] = (0.005, 0.05, 0.05)
    """offset_sd [1]: prior standard deviations of a displacement, velocity and acceleration offset over the channel's
    rms, above 0; default untested. Raising it lets offsets absorb constant forces."""
    tones: int = 3
    """tones [1]: most tones that are estimated from the residual, at least 0; default untested. Raising it adds trial
    frequencies."""
    tone_width: float = 4.0
    """tone_width [lines]: least distance of two tones, above 0; default untested. Raising it merges close tones."""
    highest_tone: float = 0.3
    """highest_tone [1]: highest tone over the sample rate, 0 to 0.5; default untested. Raising it searches a wider
    band."""
    tone_stands_out: float = 8.0
    """tone_stands_out [1]: least power of a tone over the median of its neighbours, above 1; white noise exceeds the
    default in one of 3000 lines. Raising it misses weak tones."""
    tone_neighbours: float = 30.0
    """tone_neighbours [lines]: half-width of a tone's neighbourhood, above `tone_width`; default untested. Raising it
    averages over more coloured residual."""
    model_error_samples: float = 500.0
    """model_error_samples [1]: effective sample size of the innovations in the estimate of the uncertain parameters,
    above 0; default untested. Raising it moves the parameters further from their priors."""
    shares: int = 2
    """shares [1]: processes of the screening, at least 1; default for two cores. Each process integrates all hysteretic
    laws once; raising it repeats that work."""
    zoom: tuple[float, ...] = (1.5, 1.25, 1.12, 1.06, 1.03, 1.015, 1.007, 1.0035, 1.0017)
    """zoom [1]: successive factors on shape parameters around the best grid value, above 1; default untested. A further
    entry refines the shapes."""
    coarse_zoom: int = 4
    """coarse_zoom [1]: factors of `zoom` for a hysteretic law, at least 0; default untested. Raising it refines the
    shapes and costs time."""
    no_gain: float = 1e-3
    """no_gain [nat]: least log-likelihood gain of another grid value, above 0; default above rounding. Raising it keeps
    coarser values."""
    most_rows: int = 60_000
    """most_rows [1]: samples times channels of the screening, above 0; default untested. Raising it costs time and
    memory."""
    settled: tuple[float, float] = (0.02, 1e-4)
    """settled [sd and 1]: step of the uncertain parameters that ends the refits, over the prior and absolute, above 0;
    default untested. Raising it ends the refits earlier."""
    most_theta: float = 2.0
    """most_theta [1]: bound of the log factors of uncertain parameters in the screening, above 0; default a factor of
    seven, untested. Raising it admits more distant models."""
    least_projection: float = 0.2
    """least_projection [1]: least estimated amplitude of an effect without amplitudes, in units of its own change, 0 to
    1; default untested. Raising it screens out more such effects."""
    least_amplitude: float = 0.02
    """least_amplitude [1]: least amplitude of an unsigned parameter over its earlier one, 0 to 1; default untested.
    Raising it keeps vanishing effects larger."""


@dataclass(frozen=True, kw_only=True)
class SensorOffsetSettings:
    """Settings of `vlab.diagnose.inference.sensor_offset`."""

    benign_offset: float = 0.01
    """benign_offset [1]: largest unreported sensor offset over the channel's rms, above 0; default untested. Raising it
    reports fewer offsets."""
    over_error: float = 1.0
    """over_error [1]: least reported offset over the channel's residual rms, above 0; default untested. Raising it
    reports fewer offsets."""
    least_sd: float = 0.01
    """least_sd [1]: least standard deviation of a reported offset over the offset, above 0; default untested. Raising it
    widens the reported intervals."""


@dataclass(frozen=True, kw_only=True)
class SimulatorFitSettings:
    """Settings of `vlab.diagnose.inference.simulator_least_squares`."""

    corrections: int = 2
    """corrections [1]: corrections of the fit by MuJoCo's own run, at least 0; default untested. Raising it costs time.
    """
    steps: int = 5
    """steps [1]: iterations after each correction, at least 1; default untested. Raising it costs time."""
    enough: float = 0.97
    """enough [1]: ratio of successive residual rms above which the corrections end, 0 to 1; default untested. Raising
    it continues for smaller improvements."""
    follows: float = 0.5
    """follows [1]: largest residual of MuJoCo's run over a recording's rms for a valid correction, above 0; default
    untested. Raising it corrects worse fits."""
    diverged: float = 1e5
    """diverged [1]: normalised residual of a run that diverges, above that of every run that does not; default above the
    ratio of motion and noise. Raising it loses the prior cost by rounding."""
    most_steps: float = 1e5
    """most_steps [1]: integration steps times degrees of freedom of a Jacobian in MuJoCo, above 0; default half a second.
    Raising it fits larger models in MuJoCo itself, and costs time."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryFitSettings:
    """Settings of `vlab.diagnose.inference.trajectory_least_squares`."""

    windows: int = 12
    """windows [1]: windows of a run, at least 1; default untested. Raising it shortens the windows."""
    least_window: int = 60
    """least_window [samples]: shortest window, at least 2; default untested. Raising it lengthens the windows."""
    preroll: int = 120
    """preroll [samples]: smoothed motion before a window that a hysteretic law receives, above 0; default untested.
    Raising it lets longer memory settle."""
    loose: float = 6.0
    """loose [1]: spread of a window's initial state over the predicted standard deviation, above 0; default untested.
    It covers effects missing from the nominal model; raising it lets initial states absorb more residual."""
    settled: int = 20
    """settled [samples]: samples after which the predicted covariance is that of a known motion, above 0; default
    untested. Raising it uses a later covariance."""
    probe: float = 0.02
    """probe [1]: finite-difference step of initial states over their spread, above 0; default untested. Raising it
    averages over more nonlinearity."""
    pad: int = 400
    """pad [samples]: odd extension of a record before its start for sensors with dynamics, above 0; default untested.
    Raising it lets slower sensors settle."""
    settlings: int = 2
    """settlings [1]: updates of the initial states of whole runs for a hypothesis, at least 0; default untested.
    Raising it costs time."""
    most_move: float = 3.0
    """most_move [1]: largest move of an initial state over its spread, above 0; default untested. Raising it allows
    larger corrections."""
    even: float = 1e-6
    """even [1]: relative spread of sample intervals up to which sampling is uniform, above 0; default untested. Raising
    it treats more jitter as uniform."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryScoreTestSettings:
    """Settings of `vlab.diagnose.inference.trajectory_score_test`."""

    settled: int = 10
    """settled [samples]: first samples whose innovations are ignored, at least 0; default untested. Raising it discards
    more of the transient."""
    often: float = 25.0
    """often [1]: points per cycle of the highest frequency for forces of uncertain parameters, above 2; default
    untested. Raising it costs time; splines interpolate between the points."""
    change: float = 1e-4
    """change [1]: finite-difference step of the log factor of an uncertain parameter, above 0; default untested.
    Raising it adds truncation error."""


@dataclass(frozen=True, kw_only=True)
class WindowFitSettings:
    """Settings of `vlab.diagnose.inference.window_least_squares`."""

    whole: int = 3000
    """whole [samples]: run length up to which a run is not divided into windows, above 0; default untested. Slow
    amplitude effects show in whole runs only; raising it fits longer runs undivided."""
    least_omega: float = 0.1
    """least_omega [rad/s]: natural frequency above which a mode counts as oscillating for the length of windows, above 0;
    default untested. Raising it shortens the windows of slow models."""


@dataclass(frozen=True, kw_only=True)
class TrialScanSettings:
    """Settings of `vlab.diagnose.inference.trial_scan`."""

    cycle: float = 0.25
    """cycle [1]: spacing of trial values in cycles, 0 to 0.5: of the highest recorded frequency for delays, of the rounding
    error at the largest command for steps. Default a mismatch of an eighth of a cycle at most, at which the linear
    prediction keeps 0.7 of its correlation. Raising it saves time and misses narrow peaks."""
    ratio: float = 1.6
    """ratio [1]: ratio of neighbouring trial slopes, above 1; default a mismatch of 26 % at most, untested. Raising it
    saves time and starts fits further off."""
    damping_ratio: float = 0.04
    """damping_ratio [1]: damping ratio whose half-power bandwidth separates trial resonances, 0 to 1; default the larger
    trial damping of an attached oscillator. Raising it saves time and misses sharp resonances."""
    most: int = 400
    """most [1]: most trial values of a hold or a step, at least 1; default all whole sample periods up to 0.2 s at 2 kHz.
    Raising it costs time and finds finer steps."""
    kept: int = 3
    """kept [1]: best values of a scan that the screening keeps, at least 1; default untested. Raising it costs time."""
    columns: int = 32
    """columns [1]: values that are evaluated at a time, at least 1; default 15 MB of columns for the longest screening.
    Raising it takes more memory."""


EVIDENCE = EvidenceSettings()
FREQUENCY_FIT = FrequencyFitSettings()
HYPOTHESIS_FITS = HypothesisFitsSettings()
JACOBIAN = JacobianSettings()
FIT = FitSettings()
MODEL_CHOICE = ModelChoiceSettings()
PARAMETER_VECTOR = ParameterVectorSettings()
SCORE_TEST = ScoreTestSettings()
SENSOR_OFFSET = SensorOffsetSettings()
SIMULATOR_FIT = SimulatorFitSettings()
TRAJECTORY_FIT = TrajectoryFitSettings()
TRAJECTORY_SCORE_TEST = TrajectoryScoreTestSettings()
TRIAL_SCAN = TrialScanSettings()
WINDOW_FIT = WindowFitSettings()
