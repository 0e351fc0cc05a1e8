"""Settings of the search."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class AlternativeConventionsSettings:
    """Settings of `vlab.diagnose.search.alternative_conventions`."""

    no_more: float = 1.01
    """no_more [1]: mean square over another up to which both are equal, above 1; default untested. Raising it prefers
    another sampling convention to a clock effect."""


@dataclass(frozen=True, kw_only=True)
class AttemptSettings:
    """Settings of `vlab.diagnose.search.attempt`."""

    most_attempts: int = 3
    """most_attempts [1]: hypotheses besides the chosen one that are tried in the simulator, at least 0; default
    untested. Raising it costs time."""


@dataclass(frozen=True, kw_only=True)
class ConfirmationSettings:
    """Settings of `vlab.diagnose.search.confirmation`."""

    steps_along_motion: int = 6
    """steps_along_motion [1]: iterations of the final trajectory-linearised fit before the simulator corrects the fit,
    at least 1; default untested. Raising it costs time."""
    most_tried: int = 3
    """most_tried [1]: hypotheses that are tried in MuJoCo until one is confirmed, at least 1; default untested. Raising
    it costs time."""


@dataclass(frozen=True, kw_only=True)
class CrossValidationSettings:
    """Settings of `vlab.diagnose.search.cross_validation`."""

    left_out: int = 12
    """left_out [1]: most parts of the data that are left out in turn, at least 3; default untested. Raising it costs
    time."""
    refitted: int = 6
    """refitted [1]: iterations of the refit without one part, at least 1; default untested. Raising it costs time."""


@dataclass(frozen=True, kw_only=True)
class FinalFitSettings:
    """Settings of `vlab.diagnose.search.final_fit`."""

    worse: float = 1.5
    """worse [1]: MuJoCo residual over that of the reduced model from which the fit is repeated in MuJoCo, above 1;
    default untested. Raising it repeats fewer fits."""
    least_excess: float = 0.02
    """least_excess [1]: MuJoCo residual over a channel's rms below which no fit is repeated, above 0; default untested.
    Raising it repeats fewer fits."""
    most_directions: int = 5
    """most_directions [1]: identifiable directions of the uncertain parameters in the final fit, at least 0; default
    untested. Raising it costs simulations."""
    steps: int = 6
    """steps [1]: most iterations of the final fit, at least 1; default untested. Raising it costs seconds per
    iteration."""
    step: float = 0.02
    """step [1]: finite-difference step of the final fit in logarithm or share, above 0; default untested. Raising it
    adds truncation error."""
    worthwhile: float = 0.97
    """worthwhile [1]: cost ratio of an iteration above which the final fit ends, 0 to 1; default untested. Raising it
    continues for smaller gains."""
    dampings: tuple[float, ...] = (1e-3, 0.3, 10.0)
    """dampings [1]: trial Levenberg-Marquardt dampings of one iteration, above 0; default untested. A further entry
    costs one simulation."""
    longest: int = 10_000
    """longest [samples]: most samples of a recording in one trial simulation, above 0; default untested. Raising it
    costs time."""
    most_work: int = 300_000
    """most_work [1]: most samples times degrees of freedom of one trial simulation, above 0; default untested. Raising
    it costs time."""
    least_part: float = 0.1
    """least_part [1]: least simulated share of a recording, 0 to 1; default untested. A large model's first moments
    hold mostly noise; raising it skips more final fits."""
    far: float = 1e4
    """far [sd]: normalised residual of a trial that MuJoCo cannot simulate, above 1; default untested. Raising it risks
    overflow of squares."""


@dataclass(frozen=True, kw_only=True)
class ForwardSelectionSettings:
    """Settings of `vlab.diagnose.search.forward_selection`."""

    most_effects: int = 6
    """most_effects [1]: effects of the largest hypothesis, at least 2; default untested. Raising it lets the selection
    run longer on models that lack much."""
    most_candidates: int = 150
    """most_candidates [1]: candidates of a profile screening, at least 1; default untested. Raising it costs time."""
    fitted: int = 4
    """fitted [1]: best candidates that are fitted beside a hypothesis, at least 1; default untested. Raising it costs
    time."""


@dataclass(frozen=True, kw_only=True)
class FrequencyScreeningSettings:
    """Settings of `vlab.diagnose.search.frequency_screening`."""

    shares: int = 8
    """shares [1]: parts of the screening that are distributed to processes, at least 1; default untested. Raising it
    balances the load better."""
    modes_tried: int = 8
    """modes_tried [1]: modes beyond those of a table in the screening, at least 0; default untested. Raising it costs
    time."""


@dataclass(frozen=True, kw_only=True)
class FrequencySelectionSettings:
    """Settings of `vlab.diagnose.search.frequency_selection`."""

    shortlist: int = 10
    """shortlist [1]: trials of largest gain that are fitted from each screening, at least 1; default untested. Raising
    it costs time."""
    far: int = 6
    """far [1]: best trials of the coarse screening that are also fitted from the nominal model, at least 0; default
    untested. Raising it costs time."""
    finished: int = 8
    """finished [1]: best fits that are continued to convergence, at least 1; default untested. Raising it costs time.
    """
    coarse: float = 0.08
    """coarse [1]: relative bandwidth of the coarse screening about the nominal model, above 0; default untested.
    Raising it admits larger frequency errors."""
    calibrations: int = 2
    """calibrations [1]: best starts of a nonlinear effect among the calibrations of all, the lowest and the highest
    level, 1 to 3; default untested. Raising it costs time."""
    seeds: int = 3
    """seeds [1]: single effects to which a second one is added, at least 1; default untested. Raising it costs time."""
    seconds: int = 5
    """seconds [1]: second effects that are fitted with each seed, at least 1; default untested. Raising it costs time.
    """
    places: int = 10
    """places [1]: locations at which the best effect is fitted again, at least 1; default untested. Raising it costs
    time."""
    quick: int = 5
    """quick [1]: iterations of a first fit, at least 1; default untested. Raising it ranks trials better and costs
    time."""


@dataclass(frozen=True, kw_only=True)
class LevelTrialsSettings:
    """Settings of `vlab.diagnose.search.level_trials`."""

    freedom: float = 10.0
    """freedom [1]: factor on the prior standard deviations in the calibration of a single level, above 1; default
    untested. Raising it smooths the data less."""
    shares: tuple[float, ...] = tuple(np.geomspace(1e-4, 1.0, 9).tolist())
    """shares [1]: trial equivalent stiffnesses in the largest motion over the smallest modal stiffness, above 0;
    default untested. A further entry costs one evaluation."""
    further: tuple[float, ...] = (0.3,)
    """further [1]: trial forces of further amplitude parameters over that of the first one, above 0; default untested.
    A further entry costs one evaluation."""


@dataclass(frozen=True, kw_only=True)
class ModelClassSettings:
    """Settings of `vlab.diagnose.search.model_class`."""

    less: float = 0.95
    """less [1]: mean square with a structure's own nonlinearity over that without up to which the nonlinearity is kept,
    0 to 1; default untested. Raising it keeps weaker nonlinearity."""


@dataclass(frozen=True, kw_only=True)
class PermanentChangeSettings:
    """Settings of `vlab.diagnose.search.permanent_change`."""

    shares: tuple[float, ...] = tuple(np.geomspace(0.4, 1.6, 13).tolist())
    """shares [1]: trial shape parameters over their reference motion, above 0; default untested. The observed motion
    without the law errs by as much; a further entry costs one evaluation."""
    between: tuple[float, ...] = tuple(np.geomspace(1.0 / 1.12, 1.12, 9).tolist())
    """between [1]: factors on the best of `shares` in the second search, about 1; default untested. A further entry
    refines the shape."""
    most: int = 3
    """most [1]: located laws of permanent change that are fitted, at least 1; default untested. Raising it costs time.
    """


@dataclass(frozen=True, kw_only=True)
class ProfileScreeningSettings:
    """Settings of `vlab.diagnose.search.profile_screening`."""

    rank: float = 1e-9
    """rank [1]: singular value of the Jacobian over the largest below which a direction counts as noise, above 0;
    default far above the rounding of differences. Raising it profiles fewer directions."""
    shape_factors: tuple[float, ...] = (1.0, 0.4, 2.5)
    """shape_factors [1]: multiples of a shape of the first screening that are simulated, above 0; default untested.
    More factors cost time."""
    most_shapes: int = 6
    """most_shapes [1]: shapes of one candidate, at least 1; default untested. Raising it costs time."""
    amplitude_factors: tuple[float, ...] = (1.0, 0.3, 3.0)
    """amplitude_factors [1]: multiples of the linear optimum of an amplitude that are simulated, above 0; default
    untested. More factors cost time."""
    least_share: float = 1e-6
    """least_share [1]: first amplitude over the upper end of its range, above 0; default untested. The amplitude is
    rescaled, so the value matters little."""
    moved: tuple[float, float] = (1e-6, 0.3)
    """moved [1]: least and largest change of the residual over its norm by a finite difference; default untested. A
    wider range accepts more rounding or more nonlinearity."""
    rescalings: int = 8
    """rescalings [1]: most changes of the amplitude of a finite difference, at least 1; default untested. Raising it
    costs time for laws without effect."""
    target: float = 0.3
    """target [1]: change of the residual over the largest allowed one that a rescaled step aims at, 0 to 1; default
    untested. Raising it exceeds the range more often."""
    most_shrink: float = 0.1
    """most_shrink [1]: largest factor on a step that moved the residual too far, 0 to 1; default untested. Raising it
    needs more rescalings."""
    after_divergence: float = 1e-3
    """after_divergence [1]: factor on a step that diverged, 0 to 1; default untested. Raising it needs more rescalings.
    """
    most_growth: float = 1e-3
    """most_growth [1]: least change over the least wanted one in the growth of a step, above 0; default untested. Raising
    it needs more rescalings."""


@dataclass(frozen=True, kw_only=True)
class SamplingConventionSettings:
    """Settings of `vlab.diagnose.search.sampling_convention`."""

    near: float = 0.2
    """near [1]: largest deviation from 1 of a convention's estimated share, above 0; default untested. A convention is
    accepted whole only; raising it accepts other input errors as convention."""
    least_skew: float = 0.2
    """least_skew [1]: least accepted skew in halves of the shorter of integration step and sample, above 0; default
    untested. Raising it ignores larger skews."""
    most_skew: float = 1.2
    """most_skew [1]: largest accepted skew in halves of the shorter of integration step and sample, above `least_skew`;
    default untested. Other simulators take finer steps; raising it accepts larger skews."""
    gain: float = 30.0
    """gain [nat]: least log-likelihood gain of a convention, above 0; default above the chance gain of all refitted
    directions. Raising it changes conventions less often."""
    gain_each: float = 10.0
    """gain_each [nat]: additional gain per further convention, above 0; default untested. Raising it favours a single
    convention."""
    explained: float = 0.003
    """explained [1]: least share of the residual that a convention explains, 0 to 1; default untested. Raising it
    changes conventions less often."""
    hint: float = 0.5
    """hint [nat]: gain of an input hold from which refits to whole recordings decide, above 0; default untested.
    Raising it makes fewer refits."""
    much_less: float = 0.7
    """much_less [1]: mean square with another convention over that without up to which the convention is accepted, 0 to
    1; default untested. Raising it accepts smaller improvements."""
    most_passes: int = 2
    """most_passes [1]: successive estimates of the convention, at least 1; default untested. A wrong output convention
    hides a wrong input hold; raising it costs time."""
    beside: int = 12
    """beside [1]: candidate effects with which a convention is tested jointly, at least 0; default untested. Effects
    resemble other inputs in part; raising it costs time."""
    seen: float = 0.5
    """seen [1]: change of the channels over half a sample relative to their noise from which conventions differ, above
    0; default untested. Raising it skips the comparison more often."""


@dataclass(frozen=True, kw_only=True)
class SecondEffectSettings:
    """Settings of `vlab.diagnose.search.second_effect`."""

    zoomed: int = 3
    """zoomed [1]: candidates, one per family, whose shapes are refined between grid values, at least 0; default
    untested. Raising it costs time."""
    rows: float = 0.5
    """rows [1]: share of the first screening's samples in the second screening, 0 to 1; default untested. Raising it
    costs time."""
    seeds: int = 2
    """seeds [1]: hypotheses besides the best to which a second effect is added, at least 0; default untested. Raising
    it costs time."""
    seconds: int = 3
    """seconds [1]: second effects, one per family, that are fitted with each seed, at least 1; default untested.
    Raising it costs time."""
    most_seconds: int = 60
    """most_seconds [1]: candidates of a second screening that are considered, at least 1; default untested. Raising it
    costs time."""
    second_places: int = 10
    """second_places [1]: best locations of every effect in the second screening, at least 1; default untested. Raising
    it costs time."""
    most_pairs: int = 14
    """most_pairs [1]: pairs of effects that are fitted, at least 1; default untested. Raising it costs time."""
    closer: float = 0.98
    """closer [1]: residual over that of the best score from which a hypothesis counts as closer, 0 to 1; default
    untested. Raising it adds a second base hypothesis more often."""
    part: float = 0.2
    """part [1]: share of the excess that one effect explains from which a second is searched, 0 to 1; default untested.
    Raising it searches fewer pairs."""
    much: float = 3.0
    """much [1]: normalised residual from which a second effect is searched in any case, above 1; default untested.
    Raising it searches fewer pairs."""
    prior_violation: float = 20.0
    """prior_violation [nat]: negative log prior of the uncertain parameters from which a second effect is searched,
    above 0; default untested. A missing mass or damper biases calibration; raising it searches fewer pairs."""
    outlying: float = 4.0
    """outlying [sd]: prior distance of one uncertain parameter from which a second effect is searched, above 0; default
    untested. Raising it searches fewer pairs."""


@dataclass(frozen=True, kw_only=True)
class SelectionSettings:
    """Settings of `vlab.diagnose.search.selection`."""

    slowest: float = 1e-6
    """slowest [1]: factor on the unknown-force intensity of the slowest observer, 0 to 1; default untested. That
    observer detects amplitude-dependent stiffness and damping in ring-downs; raising it speeds the observer up."""
    slow_shortlist: int = 5
    """slow_shortlist [1]: candidates of each slow screening that are fitted, at least 0; default untested. Raising it
    costs time."""
    whole_singles: int = 7
    """whole_singles [1]: single effects that are fitted to whole runs, at least 1; default untested. Raising it costs
    time."""
    whole_pairs: int = 4
    """whole_pairs [1]: pairs of effects that are fitted to whole runs, at least 1; default untested. Raising it costs
    time."""
    reformed: int = 3
    """reformed [1]: pairs whose other forms and single effects are fitted, at least 0; default untested. Raising it
    costs time."""
    explains: float = 1.05
    """explains [1]: residual over the noise floor up to which one effect suffices, above 1; default untested. Raising
    it skips slow observers and pairs more often."""
    enough_of_mesh: float = 0.5
    """enough_of_mesh [1]: share of the mesh error variance that may remain before a second effect is searched, 0 to 1;
    default above the 0.4 of a grid with nothing hidden. Raising it searches fewer pairs."""
    finer: float = 0.5
    """finer [1]: factor on the allowed model error where a refit alone stays within it, 0 to 1; default untested.
    Raising it detects fewer weak effects."""


@dataclass(frozen=True, kw_only=True)
class ShortlistSettings:
    """Settings of `vlab.diagnose.search.shortlist`."""

    shortlist: int = 6
    """shortlist [1]: candidates of largest screening gain that are fitted, at least 1; default untested. Raising it
    costs time."""
    families: int = 4
    """families [1]: further candidates of other families that are fitted, at least 0; default untested. Raising it
    costs time."""
    least_gain: float = 3.0
    """least_gain [nat]: least screening gain of a candidate that is fitted for its family, above 0; default untested.
    Raising it fits fewer families."""
    clear: float = 60.0
    """clear [nat]: screening gain above which one effect dominates, above 0; default untested. Raising it fits all
    families more often."""
    nearly: float = 0.9
    """nearly [1]: gain of the nested form over that of the candidate from which the nested form is fitted first, 0 to
    1; default untested. Raising it prefers the richer form."""
    rivals: int = 3
    """rivals [1]: rivals of a second effect that are fitted, at least 0; default untested. Raising it costs time."""


@dataclass(frozen=True, kw_only=True)
class TrialValuesSettings:
    """Settings of `vlab.diagnose.search.trial_values`."""

    gains: tuple[float, ...] = (-2.0, -0.5, -0.2, -0.08, 0.08, 0.2, 0.5, 1.0)
    """gains [1]: trial relative gain errors of a channel; default untested. A further entry costs one evaluation."""
    shares: tuple[float, ...] = (0.05, 0.12, 0.25, 0.4, 0.6, 0.8, 0.92)
    """shares [1]: trial values of a lone dimensionless port parameter, 0 to 1; default untested. A further entry costs
    one evaluation."""
    picked: tuple[float, ...] = (-0.4, -0.15, -0.05, 0.05, 0.15, 0.4)
    """picked [1]: trial crosstalk ratios between sensors; default untested. A further entry costs one evaluation."""
    ratios: tuple[float, ...] = (0.02, 0.15)
    """ratios [1]: trial values of a dimensionless parameter among several, 0 to 1; default untested. A further entry
    costs one evaluation."""
    times: tuple[float, ...] = (0.02, 0.06, 0.2, 0.6, 2.0)
    """times [rad]: trial delays and lags times the highest frequency, above 0; default untested. A further entry costs
    one evaluation."""
    slow_times: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0, 10.0)
    """slow_times [rad]: trial time constants of a channel's high-pass times the lowest frequency, above 0; default
    untested. A further entry costs one evaluation."""
    masses: tuple[float, ...] = tuple(np.geomspace(2e-3, 5.0, 9))
    """masses [1]: trial masses over the smallest modal mass at the location, above 0; default untested. A further entry
    costs one evaluation."""
    stiffnesses: tuple[float, ...] = tuple(np.geomspace(1e-3, 30.0, 11))
    """stiffnesses [1]: trial stiffnesses over the smallest modal stiffness at the location, above 0; default untested.
    A further entry costs one evaluation."""
    dampings: tuple[float, ...] = tuple(np.geomspace(1e-4, 3.0, 9))
    """dampings [1]: trial damping constants over the smallest critical one at the location, above 0; default untested.
    A further entry costs one evaluation."""
    oscillator_masses: tuple[float, ...] = (0.01, 0.1)
    """oscillator_masses [1]: trial masses of an attached oscillator over the smallest modal mass, above 0; default
    untested. A further entry costs one evaluation."""
    frequencies: int = 12
    """frequencies [1]: trial resonances over the band of responses, at least 2; default untested. Raising it costs
    time."""
    resonances: int = 8
    """resonances [1]: trial resonances of an oscillator for a modal table, at least 2; default untested. Raising it
    costs time."""
    unseen: float = 1e-4
    """unseen [1]: squared motion of a mode at a location over the largest below which the mode is ignored, above 0;
    default untested. Raising it ignores more modes."""
    own_frequencies: int = 8
    """own_frequencies [1]: most natural frequencies of the model among the trial resonances, at least 0; default
    untested. Raising it costs time."""
    long_lags: tuple[float, ...] = (10.0, 50.0)
    """long_lags [rad]: further trial lags times the highest frequency, above 0; default untested. A further entry costs
    one evaluation."""
    fast_times: int = 2
    """fast_times [1]: first of `times` for a channel's own dynamics, at least 0; default untested. Raising it tries fewer
    time constants."""
    corners: tuple[float, float, int] = (2.0, 3.0, 10)
    """corners [1]: least trial corner over the lowest frequency, largest over the highest, and their number; default
    untested. A further value costs one evaluation."""
    crosstalk: tuple[float, ...] = (-3.0, -1.0, -0.3, -0.1, 0.1, 0.3, 1.0, 3.0)
    """crosstalk [1]: trial crosstalk of a command over the channel's median response; default untested. A further entry
    costs one evaluation."""
    any_values: int = 9
    """any_values [1]: trial values between the bounds of any other parameter, at least 2; default untested. Raising it
    costs time."""
    beside_band: tuple[float, float] = (0.9, 1.1)
    """beside_band [1]: least and largest trial resonance of an oscillator over the band of a modal table, above 0; default
    untested. A wider range costs resolution."""
    scale_band: tuple[float, float] = (0.1, 1.5)
    """scale_band [1]: frequencies of the modes that give the reference values, over the highest measured one, above 0;
    slower modes count at the lower end. Default untested; raising it changes all trial values."""


ALTERNATIVE_CONVENTIONS = AlternativeConventionsSettings()
ATTEMPT = AttemptSettings()
CONFIRMATION = ConfirmationSettings()
CROSS_VALIDATION = CrossValidationSettings()
FINAL_FIT = FinalFitSettings()
FORWARD_SELECTION = ForwardSelectionSettings()
FREQUENCY_SCREENING = FrequencyScreeningSettings()
FREQUENCY_SELECTION = FrequencySelectionSettings()
LEVEL_TRIALS = LevelTrialsSettings()
MODEL_CLASS = ModelClassSettings()
PERMANENT_CHANGE = PermanentChangeSettings()
PROFILE_SCREENING = ProfileScreeningSettings()
SAMPLING_CONVENTION = SamplingConventionSettings()
SECOND_EFFECT = SecondEffectSettings()
SELECTION = SelectionSettings()
SHORTLIST = ShortlistSettings()
TRIAL_VALUES = TrialValuesSettings()
