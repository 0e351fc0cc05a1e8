"""Settings of verdicts, findings and notes."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class AdviceSettings:
    """Settings of `vlab.diagnose.advice`."""

    far_off: float = 2.9
    """far_off [sd]: prior distance from which an uncertain parameter is reported, above 0; default exceeded by one of a
    dozen parameters in one of 20 models. Raising it reports fewer parameters."""
    least_probability: float = 0.001
    """least_probability [1]: smallest probability that is printed as a number, 0 to 1; default untested. Raising it
    prints more bounds."""
    most_alike: int = 5
    """most_alike [1]: most hypotheses of an equally small residual that are named, at least 0; default untested. Raising
    it lengthens the report."""
    likely_place: float = 0.05
    """likely_place [1]: posterior of another place from which the place is named, 0 to 1; default untested. Raising it
    names fewer places."""
    open_place: float = 0.1
    """open_place [1]: posterior of a place from which the place is open; two such places call for a sensor between, 0 to
    1; default untested. Raising it suggests fewer sensors."""


@dataclass(frozen=True, kw_only=True)
class DataFindingsSettings:
    """Settings of `vlab.diagnose.data_findings`."""

    benign_interference: float = 0.03
    """benign_interference [1]: largest unreported interference over a channel's rms, above 0; default untested. Raising
    it reports less interference."""
    interference_over_noise: float = 2.0
    """interference_over_noise [1]: least rms of reported interference over the noise, above 0; default untested.
    Raising it reports less interference."""
    benign_stop: float = 0.002
    """benign_stop [1]: share of samples at a sensor limit up to which the limit is a data-quality note only, 0 to 1;
    default untested. Raising it reports fewer limits as findings."""
    same_tops: int = 2
    """same_tops [1]: flat tops at exactly one value from which a short limit is a finding, at least 2; default
    untested. A single flat top may be quantisation; raising it reports fewer limits."""
    beyond: float = 10.0
    """beyond [steps]: extrapolated excess over a limit from which a short limit is a finding, above 0; default
    untested. Raising it reports fewer limits."""
    amplitude_sd: float = 0.05
    """amplitude_sd [1]: relative standard deviation of the amplitude of an interference, above 0; default untested.
    Raising it widens the reported interval."""
    exact_sd: float = 1e-3
    """exact_sd [1]: relative standard deviation of the frequency of an interference and of a sensor limit, above 0;
    default untested. Raising it widens the reported intervals."""


@dataclass(frozen=True, kw_only=True)
class ExportSettings:
    """Settings of `vlab.diagnose.export`."""

    least: float = 1e-9
    """least [1]: smallest exported change of a gain, or of an offset over its channel's maximum, above 0; default
    untested. Raising it exports fewer corrections."""


@dataclass(frozen=True, kw_only=True)
class FindingsSettings:
    """Settings of `vlab.diagnose.findings`."""

    seen: float = 0.99
    """seen [1]: probability of a finding that the data show without a model, 0 to 1; default untested. Raising it
    reports such findings as more certain."""
    most_alternatives: int = 8
    """most_alternatives [1]: hypotheses in the report besides the chosen one, at least 0; default untested. Raising it
    lengthens the report."""
    half_width: float = 1.645
    """half_width [sd]: half the width of a reported interval, above 0; default that of 90 % of a normal distribution.
    Raising it reports wider intervals than the 90 % that they state."""
    credible: float = 0.9
    """credible [1]: posterior of the reported set of places, 0 to 1; default as usual for intervals. Raising it reports
    more places."""


@dataclass(frozen=True, kw_only=True)
class FrequencyVerdictSettings:
    """Settings of `vlab.diagnose.frequency_pipeline`."""

    above_noise: float = 1.5
    """above_noise [1]: residual over the noise up to which responses are explained, above 1; default untested. Raising
    it reports fewer effects."""
    least_gap: float = 0.4
    """least_gap [1]: share of the hold-out or cross-validation gap that an effect must close, 0 to 1; default untested.
    Raising it reports fewer effects."""
    least_misfit: float = 0.04
    """least_misfit [1]: relative residual of responses up to which the model is complete, above 0; default untested.
    Raising it reports fewer effects."""
    least_score: float = 2.0
    """least_score [nat]: least score of an effect over the refit, corrected for the number of trials, above 0; default
    untested. Raising it reports fewer effects."""
    unverified: float = 3.0
    """unverified [1]: residual of the extended model over the noise that is accepted without a hold-out set, above 1;
    default untested. Raising it accepts more effects without verification."""
    least_parts: int = 6
    """least_parts [1]: left-out parts from which cross-validation replaces the hold-out set, at least 1; default
    untested. Raising it needs more data for cross-validation."""
    bands: int = 12
    """bands [1]: frequency bands of the reported residual, at least 1; default untested. Raising it refines the report.
    """
    most_log_odds: float = 20.0
    """most_log_odds [nat]: bound of the log odds that a note states, above 0; default untested. Raising it states larger
    odds."""


@dataclass(frozen=True, kw_only=True)
class VerdictSettings:
    """Settings of `vlab.diagnose.verdict`."""

    above_noise: float = 1.5
    """above_noise [1]: hold-out residual of the calibrated model over the noise from which physics is missing, above 1;
    default untested. Raising it reports fewer effects."""
    least_misfit: float = 0.005
    """least_misfit [1]: hold-out residual over the rms from which physics is missing, above 0; default the integration
    and interpolation error of a user model, untested. Raising it reports fewer effects."""
    least_gap: float = 0.78
    """least_gap [1]: share of the hold-out gap, down to noise and model error, that an effect must close. On concealed
    cases of two rigs true effects closed 0.91 or more, other forms 0.78 or more, fits without a true law 0.58 to 0.77.
    Raising it reports fewer effects."""
    least_to_noise: float = 0.5
    """least_to_noise [1]: share of the hold-out gap, down to the noise alone, that an effect must close, 0 to 1;
    default untested. Raising it reports fewer effects."""
    near_noise: float = 1.1
    """near_noise [1]: residual over the noise up to which `least_near_noise` replaces `least_gap`, above 1; default
    untested. Raising it relaxes the test for larger residuals."""
    least_near_noise: float = 0.7
    """least_near_noise [1]: share of the gap to close where the residual is near the noise, 0 to 1; default untested.
    Raising it rejects effects on small gaps."""
    false_alarm_rate: float = 0.01
    """false_alarm_rate [1]: probability that equal models pass a test between predictions, 0 to 0.5; default a usual
    level of significance. Raising it reports more effects as partial explanations."""
    better: float = 0.998
    """better [1]: largest residual of a better model over that of the other, 0 to 1; default untested. Interference has
    a new phase in every recording and cannot improve hold-out data; raising it accepts smaller improvements."""
    better_of_mesh: float = 0.9
    """better_of_mesh [1]: largest noise-free residual ratio of a better structure whose calibrated residual is mesh
    error, 0 to 1. Effects that absorb mesh error gain hundredths; raising it accepts smaller improvements."""
    nearly_all: float = 0.9
    """nearly_all [1]: share of the gap that makes an explanation complete, and median share over recordings from which one
    may close less, 0 to 1. True effects on two rigs closed 0.91 or more. Raising it calls more explanations partial."""


ADVICE = AdviceSettings()
DATA_FINDINGS = DataFindingsSettings()
EXPORT = ExportSettings()
FINDINGS = FindingsSettings()
FREQUENCY_VERDICT = FrequencyVerdictSettings()
VERDICT = VerdictSettings()
