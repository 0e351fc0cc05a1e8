"""Settings of the search."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class AlternativeConventionsSettings:
    """Settings of `vlab.diagnose.search.alternative_conventions`."""

    no_more: float = 1.01
    """What leaves this multiple of a mean square leaves no more."""


@dataclass(frozen=True, kw_only=True)
class AttemptSettings:
    """Settings of `vlab.diagnose.search.attempt`."""

    most_attempts: int = 3
    """Hypotheses besides the chosen one that are tried until one is an attempt."""


@dataclass(frozen=True, kw_only=True)
class ConfirmationSettings:
    """Settings of `vlab.diagnose.search.confirmation`."""

    steps_along_motion: int = 6
    """Steps of the last fit along a motion, before those that MuJoCo's own run corrects."""
    most_tried: int = 3
    """Hypotheses that are tried in MuJoCo until it confirms one."""


@dataclass(frozen=True, kw_only=True)
class CrossValidationSettings:
    """Settings of `vlab.diagnose.search.cross_validation`."""

    left_out: int = 12
    """Most parts of the data that are left out one after the other."""
    refitted: int = 6


@dataclass(frozen=True, kw_only=True)
class FinalFitSettings:
    """Settings of `vlab.diagnose.search.final_fit`."""

    worse: float = 1.5
    """The fit is done again where MuJoCo leaves this multiple of what the twin left."""
    least_excess: float = 0.02
    """...and at least this share of a channel's rms."""
    most_directions: int = 5
    steps: int = 6
    """Most steps; the move that slopes are taken with, as a logarithm or share; a step that leaves more than this share of the cost is
    not worth another one, each takes seconds."""
    step: float = 0.02
    """See `steps`."""
    worthwhile: float = 0.97
    """See `steps`."""
    dampings: tuple[float, ...] = (1e-3, 0.3, 10.0)
    longest: int = 10_000
    """Samples of a recording that are simulated in every trial; samples times degrees of freedom at most."""
    most_work: int = 300_000
    """See `longest`."""
    least_part: float = 0.1
    """Share of a recording that must be simulated: of a large model's first moments, noise is what most is left of."""
    far: float = 1e4
    """Residual of a trial that MuJoCo cannot follow, in standard deviations."""


@dataclass(frozen=True, kw_only=True)
class FrequencyScreeningSettings:
    """Settings of `vlab.diagnose.search.frequency_screening`."""

    shares: int = 8
    """Parts of the work that go to the processes."""
    modes_tried: int = 8
    """Modes beyond those of a table with which trials are made."""


@dataclass(frozen=True, kw_only=True)
class FrequencySelectionSettings:
    """Settings of `vlab.diagnose.search.frequency_selection`."""

    shortlist: int = 10
    """Trials that are fitted because they gained most, in each of the two views."""
    far: int = 6
    """Best trials of the coarse view that are fitted from the model as given, too."""
    finished: int = 8
    """Best of them that are fitted to the end."""
    coarse: float = 0.08
    """Width of the bands of the coarse view, about the model as given."""
    seeds: int = 3
    """Single effects on which a second one is tried, and how many second ones are fitted on each."""
    seconds: int = 5
    """See `seeds`."""
    places: int = 10
    """Places at which the best effect is fitted again."""
    quick: int = 5


@dataclass(frozen=True, kw_only=True)
class ModelClassSettings:
    """Settings of `vlab.diagnose.search.model_class`."""

    less: float = 0.95
    """A structure's own nonlinearity is believed in where a refit leaves this share of the mean square with it, or less."""


@dataclass(frozen=True, kw_only=True)
class PermanentChangeSettings:
    """Settings of `vlab.diagnose.search.permanent_change`."""

    shares: tuple[float, ...] = tuple(np.geomspace(0.4, 1.6, 13).tolist())
    """Shapes that are tried, as multiples of what they refer to: the motion as an observer without the law makes it out is off by
    as much."""
    between: tuple[float, ...] = tuple(np.geomspace(1.0 / 1.12, 1.12, 9).tolist())
    """The same again, of the best of these: until all else is fitted, a place is as good as its best shape."""
    most: int = 3
    """Laws with their places that are worth a fit."""


@dataclass(frozen=True, kw_only=True)
class SamplingConventionSettings:
    """Settings of `vlab.diagnose.search.sampling_convention`."""

    near: float = 0.2
    """Another convention is believed where the recordings ask for it and for nothing else: for this much more or less of it at most."""
    least_skew: float = 0.2
    """Skews that are believed, in halves of an integration step or of a sample, whichever is shorter: other simulators take finer steps."""
    most_skew: float = 1.2
    """See `least_skew`."""
    gain: float = 30.0
    """A convention must gain this much in log-likelihood: as much as the refitted parameters' directions could together by chance, and
    more; and this much more beside another one."""
    gain_each: float = 10.0
    """See `gain`."""
    explained: float = 0.003
    """It must explain this share of what the refitted model leaves."""
    hint: float = 0.5
    """Where the innovations gain but so much from another hold, a refit to whole recordings has the word: where it leaves this share of the
    mean square with it. So has a fit of what was found in the end."""
    much_less: float = 0.7
    """See `hint`."""
    most_passes: int = 2
    """What is wrong with the readings hides what is wrong with the inputs: the filter takes it for unknown forces."""
    beside: int = 12
    """Effects that may be missing besides: what they leave in the recordings may look like other inputs in part."""
    seen: float = 0.5
    """Conventions are compared where half a sample moves the readings by this multiple of their noise."""


@dataclass(frozen=True, kw_only=True)
class SecondEffectSettings:
    """Settings of `vlab.diagnose.search.second_effect`."""

    zoomed: int = 3
    """Candidates whose shapes are sought between the values of their grids, one a family."""
    rows: float = 0.5
    """The second screening looks at this share of the first one's samples."""
    seeds: int = 2
    """Hypotheses that a second effect is sought beside, besides the best; second effects, of a family each, tried on top of each;
    and the candidates of their screening that count."""
    seconds: int = 3
    """See `seeds`."""
    most_seconds: int = 60
    """See `seeds`."""
    second_places: int = 10
    """Places of every effect, as the first screening ranks them, at which it is sought as a second one; pairs that are fitted."""
    most_pairs: int = 14
    """See `second_places`."""
    closer: float = 0.98
    """A hypothesis leaves less than another one where it leaves no more than this share of it."""
    part: float = 0.2
    """A second effect is sought where something is left that one effect explains this share of, or that is more than this multiple of
    the noise..."""
    much: float = 3.0
    """See `part`."""
    prior_violation: float = 20.0
    """...or where one takes uncertain parameters that are less likely than their priors' means by e to this power, or one of them that is
    this many standard deviations away: a mass or a damper beside what was found hides there."""
    outlying: float = 4.0
    """See `prior_violation`."""


@dataclass(frozen=True, kw_only=True)
class SelectionSettings:
    """Settings of `vlab.diagnose.search.selection`."""

    slowest: float = 1e-6
    """The slowest observer, see `vlab.diagnose.inference.score_test.SLOW`, sees stiffness and damping of a ring-down change with its size; and effects
    that are fitted because they gained most with one."""
    slow_shortlist: int = 5
    """See `slowest`."""
    whole_singles: int = 7
    """Single effects and pairs that are fitted over whole runs."""
    whole_pairs: int = 4
    """See `whole_singles`."""
    reformed: int = 3
    """Pairs of which other forms are fitted as well, and every effect alone."""
    explains: float = 1.05
    """A single effect that leaves no more than this multiple of what noise leaves needs neither slower observers nor a second effect."""
    enough_of_mesh: float = 0.5
    """Share of the variance of the model's own error that one of the two structures may leave beside the noise before a second effect is
    sought: a grid with nothing hidden left .4."""
    finer: float = 0.5
    """Share of the simulation's allowed error that is allowed where a refit alone stays within it."""


@dataclass(frozen=True, kw_only=True)
class ShortlistSettings:
    """Settings of `vlab.diagnose.search.shortlist`."""

    shortlist: int = 6
    """Effects that are fitted because they gained most in the screening."""
    families: int = 4
    """Effects of other families that are fitted besides."""
    least_gain: float = 3.0
    """Log-likelihood that a candidate must gain in the screening to be fitted for its family's sake."""
    clear: float = 60.0
    """Gain in the screening above which an effect stands out."""
    nearly: float = 0.9
    """Share of the gain of another form of an effect that the effect itself must have to be tried first."""
    same_site_alternatives: int = 3
    """Other effects of the family of a second one that are fitted at its place."""


@dataclass(frozen=True, kw_only=True)
class TrialValuesSettings:
    """Settings of `vlab.diagnose.search.trial_values`."""

    gains: tuple[float, ...] = (-2.0, -0.5, -0.2, -0.08, 0.08, 0.2, 0.5, 1.0)
    shares: tuple[float, ...] = (0.05, 0.12, 0.25, 0.4, 0.6, 0.8, 0.92)
    picked: tuple[float, ...] = (-0.4, -0.15, -0.05, 0.05, 0.15, 0.4)
    ratios: tuple[float, ...] = (0.02, 0.15)
    times: tuple[float, ...] = (0.02, 0.06, 0.2, 0.6, 2.0)
    """In radians of the highest frequency."""
    slow_times: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0, 10.0)
    """In radians of the lowest frequency, of what a channel loses there."""
    masses: tuple[float, ...] = tuple(np.geomspace(2e-3, 5.0, 9))
    """In modal masses of the mode that moves most at the place."""
    stiffnesses: tuple[float, ...] = tuple(np.geomspace(1e-3, 30.0, 11))
    """In modal stiffnesses at the place of the mode that is easiest to move there."""
    dampings: tuple[float, ...] = tuple(np.geomspace(1e-4, 3.0, 9))
    oscillator_masses: tuple[float, ...] = (0.01, 0.1)
    frequencies: int = 12
    resonances: int = 8
    """Frequencies of an oscillator that are tried beside a table of modes."""
    unseen: float = 1e-4
    """A mode moves at a place where it does so by more than this share of the mode that does most."""


ALTERNATIVE_CONVENTIONS = AlternativeConventionsSettings()
ATTEMPT = AttemptSettings()
CONFIRMATION = ConfirmationSettings()
CROSS_VALIDATION = CrossValidationSettings()
FINAL_FIT = FinalFitSettings()
FREQUENCY_SCREENING = FrequencyScreeningSettings()
FREQUENCY_SELECTION = FrequencySelectionSettings()
MODEL_CLASS = ModelClassSettings()
PERMANENT_CHANGE = PermanentChangeSettings()
SAMPLING_CONVENTION = SamplingConventionSettings()
SECOND_EFFECT = SecondEffectSettings()
SELECTION = SelectionSettings()
SHORTLIST = ShortlistSettings()
TRIAL_VALUES = TrialValuesSettings()
