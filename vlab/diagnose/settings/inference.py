"""Settings of fits and evidence."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class EvidenceSettings:
    """Settings of `vlab.diagnose.inference.evidence`."""

    model_error_samples: float = 40.0
    """Independent values that a model's own error is: it does not average out over a hundred thousand samples, so where it is what
    is left of the recordings, five per cent less of it are odds of e^2, not of e^5000. Noise averages out; see `weighed`."""
    unheld: float = 40.0
    """Logarithm of the odds against a nonlinear or negative spring where the model has none and the port is free to move: as much as
    a difference smaller by a factor of e, all of it the model's own error."""
    all_alike: float = 4.0
    """Logarithm of the odds against an effect of all drives, of families that usually concern one."""
    noise_known: float = 0.03
    """The noise's variance is known to this share of it: what is left within that may be noise or not."""


@dataclass(frozen=True, kw_only=True)
class FrequencyFitSettings:
    """Settings of `vlab.diagnose.inference.frequency_least_squares`."""

    prior_bound: float = 3.0
    """Uncertain parameters stay within this many standard deviations: what lies further off is a finding, no calibration."""
    iterations: int = 25
    coarse: tuple[float, ...] = (0.25, 0.08)
    """Widths of the bands in which responses are compared first."""
    coarse_iterations: int = 5
    loose: float = 3.0
    """Spread of the logarithm of an effect's parameter that its standard deviation never exceeds."""
    still: float = 1e-4
    """Relative fall of the cost below which a fit has ended."""


@dataclass(frozen=True, kw_only=True)
class HypothesisFitsSettings:
    """Settings of `vlab.diagnose.inference.hypothesis_fits`."""

    quick: int = 5
    """Iterations of the first fit of every hypothesis, and how many of the best are fitted to the end."""
    finished: int = 4
    """See `quick`."""
    first: int = 2
    """Iterations that tell which of few values a parameter has."""
    whole_iterations: int = 5
    """The same over whole runs."""
    whole_finished: int = 3
    """See `whole_iterations`."""
    nearly_as_little: float = 1.25
    """Whole runs are fitted on where they leave this multiple of the least mean square at most."""
    places: int = 5
    """Places at which the chosen effect is fitted again."""
    enough: float = 1.3
    """What leaves no more than this multiple of the noise lacks nothing that is worth much time."""
    hopeless: float = 12.0
    """Once something explains the recordings, what scores less by this much after a quick fit is not fitted any further."""


@dataclass(frozen=True, kw_only=True)
class JacobianSettings:
    """Settings of `vlab.diagnose.inference.jacobian`."""

    smooth_step: float = 1e-4
    """Step of slopes along uncertain parameters, in their standard deviations, where no law has edges."""
    moved: float = 0.25
    """Root mean square of the weighted difference by which their steps move it, and how much wider than usual they may be: of uncertain
    parameters up to a standard deviation, of a law's to a twentieth."""
    widest: tuple[float, ...] = (100.0, 5.0)
    """See `moved`."""


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """Settings of `vlab.diagnose.inference.least_squares`."""

    iterations: int = 12
    frozen: int = 2
    """Steps in which a law keeps its shape while its size and the uncertain parameters find each other: a gap or a slip that moves
    at once moves to where the law does nothing."""
    explained: float = 1.7
    """Mean square of the weighted difference below which a fit needs no second start, and square of the uncertain parameters' distance
    from their priors' means over what is usual, above which it has one all the same."""
    distant: float = 1.5
    """See `explained`."""
    near_enough: float = 1.0
    """Decrease of the cost, in squared standard deviations, below which steps are too small to go on: for a comparison of hypotheses,
    and for the values of parameters."""
    exact: float = 0.02
    """See `near_enough`."""
    cheaper: float = 0.5
    """Decrease of the cost above which a descent goes on although what is left is noise."""
    more: int = 12
    """Steps that such a descent may take beyond those it was given."""
    noise: float = 0.95
    """Mean square of what is left below which it is noise, in its squared standard deviations."""
    undamped: float = 1e-10
    """Damping of a step that goes all the way, and the parts of it that are tried: where parameters make up for each other, damped
    ones leave them as far from their priors' means as the first steps took them; and such valleys bend."""
    parts: tuple[float, ...] = (1.0, 0.3, 0.1)
    """See `undamped`."""
    passes: int = 2
    """The last slopes are taken anew so often, along directions that the ones before show."""
    reused: int = 3
    """Steps for which slopes are carried on while they keep half of their promise."""
    loose_start: float = 0.03
    """Spread of the states that windows start from, as a share of their rms over all windows."""
    most_directions: int = 100
    most_started: int = 6
    """Modes whose first state is fitted."""
    informed: float = 0.005
    """Directions of the uncertain parameters whose prior spread moves the channels by less than this share of noise and model
    error, root mean square, stay at the prior's mean."""
    probe: float = 0.3
    largest: float = 1e8
    """What residuals that ran away are cut off at."""


@dataclass(frozen=True, kw_only=True)
class ModelChoiceSettings:
    """Settings of `vlab.diagnose.inference.model_choice`."""

    explained: float = 0.5
    """An effect must explain this share of what stood above the noise before it."""
    together: float = 0.75
    """Two effects of which neither alone explains enough must explain this share of it."""
    second_share: float = 0.005
    """A second effect must explain this share of what stood above the noise without any, too."""
    above_noise: float = 1.3
    """Below this multiple of the noise there is nothing to explain."""
    beyond_prior: float = 10.0
    """An effect is also accepted where it gains this much in log-likelihood, priors of the uncertain parameters included, and 2 more for
    every further parameter: the refitted model may fit as well, but only with parameters that are less likely than the effect. Twice that
    is a chi squared of one degree of freedom, which exceeds 20 by chance once in 10^5 and 12 once in 2000; some hundred laws with their
    shapes are looked at at all places, but only a dozen linear ones."""
    of_linear: float = 6.0
    """See `beyond_prior`."""
    of_pairs: float = 6.0
    """...and this much more for two of them at once: of a thousand pairs the best one gains 7 by chance."""
    lapse: float = 0.04
    """Share of names that are wrong for reasons that no score knows of: physics that no law describes, a fit that ended elsewhere. All
    that was tried shares the rest. Counted on the named effects of an earlier campaign of concealed cases."""
    near_mains: float = 0.5
    """A force [Hz] so near the mains' frequency or a multiple is not believed in for the likelihood alone: hum within the noise of every
    sensor adds up to one over all recordings."""
    alike: float = 3.0
    """Hypotheses within odds of e^3 of the best one, one to twenty, cannot be told apart by the recordings."""


@dataclass(frozen=True, kw_only=True)
class ParameterVectorSettings:
    """Settings of `vlab.diagnose.inference.parameter_vector`."""

    prior_bound: float = 6.0
    """Uncertain parameters stay within this many standard deviations: what lies further off is a finding, no calibration. Their priors
    alone are what a score counts; a bound at work stops a descent."""
    furthest: float = 9.0
    """An effect's parameter without a sign stays within a factor of e to this power of where it starts."""
    step: float = 1e-2
    """Steps of slopes: along uncertain parameters, offsets and effects' parameters, of these relative; along first states; the least."""
    start_step: float = 0.1
    """See `step`."""
    least_step: float = 1e-12
    """See `step`."""
    start_size: float = 0.01
    """First states are fitted in this share of the largest one."""


@dataclass(frozen=True, kw_only=True)
class ScoreTestSettings:
    """Settings of `vlab.diagnose.inference.score_test`."""

    slow: float = 1e-3
    """Trust in the model, as a factor in the unknown forces, of an observer that forgets slowly and sees what only adds up over many
    cycles: where something is to be explained, it looks as well."""
    refits: int = 4
    """The uncertain parameters are refitted this often before the screening, each time on a filter that trusts the model more."""
    offset_sd: tuple[float, ...] = (0.005, 0.05, 0.05)
    """Prior standard deviation of a channel's zero, as a share of its rms: of displacements, where a constant force shows as well,
    of velocities and of accelerations, where it does not."""
    tones: int = 3
    """Frequencies that are read off what is left of the recordings, and how far apart they lie at least, in lines of a recording."""
    tone_width: float = 4.0
    """See `tones`."""
    highest_tone: float = 0.3
    """...and up to what share of the sample rate they are looked for."""
    tone_stands_out: float = 8.0
    """A tone has more power than this multiple of the median of so many lines to both sides; noise alone has it once in 3000 lines. What
    is left of a contact or a coarse step has none that stand out."""
    tone_neighbours: float = 30.0
    """See `tone_stands_out`."""
    model_error_samples: float = 500.0
    """Independent values that the innovations count as in the estimate of the uncertain parameters."""
    shares: int = 2
    """Places are looked at in so many processes, where there are the cores: each marches the laws that remember for all of them."""
    zoom: tuple[float, ...] = (1.5, 1.25, 1.12, 1.06, 1.03, 1.015, 1.007, 1.0035, 1.0017)
    """Factors by which shapes are moved off the best values of their grids, one after the other: the error of a coarse step is another
    one where the step is off by a part in the number of steps."""
    coarse_zoom: int = 4
    """How many of them are enough for a law that remembers."""
    no_gain: float = 1e-3
    """Log-likelihood by which a value must be better to be another one: two that say the same differ by rounding."""
    most_rows: int = 60_000
    """Samples times channels that the screening works on."""


@dataclass(frozen=True, kw_only=True)
class SensorOffsetSettings:
    """Settings of `vlab.diagnose.inference.sensor_offset`."""

    benign_offset: float = 0.01
    """A zero that is off by less than this share of its channel's rms is what every laboratory has..."""
    over_error: float = 1.0
    """...and one that is off by less than this multiple of what the fit leaves of the channel may be made up by what is wrong there."""


@dataclass(frozen=True, kw_only=True)
class SimulatorFitSettings:
    """Settings of `vlab.diagnose.inference.simulator_least_squares`."""

    corrections: int = 2
    """How often the difference between MuJoCo's run and the system along the motion is taken off the recordings, and the steps of
    the fit after each."""
    steps: int = 5
    """See `corrections`."""
    enough: float = 0.97
    """A correction that leaves more than this share of the last one's rms ends the fit."""
    follows: float = 0.5
    """Share of a recording's rms by which MuJoCo's run may miss it for the correction to mean anything."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryFitSettings:
    """Settings of `vlab.diagnose.inference.trajectory_least_squares`."""

    windows: int = 12
    """A run is cut into this many windows, of this many samples at least."""
    least_window: int = 60
    """See `windows`."""
    preroll: int = 120
    """Samples of smoothed motion that a law with memory sees before a window."""
    loose: float = 6.0
    """Windows start within this multiple of the predictions' standard deviation: what the nominal model lacks may act there."""
    settled: int = 20
    """Samples after which the predictions' standard deviation is that of a known motion."""
    probe: float = 0.02
    """Share of it by which starts are moved to see what they can explain."""
    pad: int = 400
    """Samples by which a record is continued to the left for sensors that remember, turned about its first sample."""
    settlings: int = 2
    """Steps by which starts are moved to where a hypothesis fits best, and the most that each may move, in their spread."""
    most_move: float = 3.0
    """See `settlings`."""
    even: float = 1e-6
    """Intervals that differ by no more than this share are the same."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryScoreTestSettings:
    """Settings of `vlab.diagnose.inference.trajectory_score_test`."""

    settled: int = 10
    """Samples after which innovations count."""
    often: float = 25.0
    """Points per cycle of the fastest motion at which the forces of uncertain parameters are found."""
    change: float = 1e-4
    """Step of the log-factors of uncertain parameters in differences of forces."""


@dataclass(frozen=True, kw_only=True)
class WindowFitSettings:
    """Settings of `vlab.diagnose.inference.window_least_squares`."""

    whole: int = 3000
    """Runs up to this many samples are not cut into windows: what changes slowly with the amplitude shows in whole runs only."""


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
WINDOW_FIT = WindowFitSettings()
