"""Settings of verdicts, findings and notes."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class AdviceSettings:
    """Settings of `vlab.diagnose.advice`."""

    far_off: float = 2.9
    """Standard deviations beyond which one of a dozen uncertain parameters lies by chance once in twenty models."""
    least_probability: float = 0.001
    """Probabilities below this one are not told apart."""


@dataclass(frozen=True, kw_only=True)
class DataFindingsSettings:
    """Settings of `vlab.diagnose.data_findings`."""

    benign_interference: float = 0.03
    """Hum below this share of its channel's rms, or this multiple of its noise, is what every laboratory has."""
    interference_over_noise: float = 2.0
    """See `benign_interference`."""
    benign_stop: float = 0.002
    """A sensor that stands at its limit for a smaller share of the samples is said among the recordings' defects only, unless that many ends
    of recordings stand at exactly the same, or the signal came and went so fast that it would have gone that many steps further: a single
    flat top may be a coarse reading of a smooth one."""
    same_tops: int = 2
    """See `benign_stop`."""
    beyond: float = 10.0
    """See `benign_stop`."""


@dataclass(frozen=True, kw_only=True)
class ExportSettings:
    """Settings of `vlab.diagnose.export`."""

    least: float = 1e-9
    """Refitted gains closer to one, and offsets smaller than this share of a channel, are not written."""


@dataclass(frozen=True, kw_only=True)
class FindingsSettings:
    """Settings of `vlab.diagnose.findings`."""

    seen: float = 0.99
    """Probability of what recordings show without any model."""
    most_alternatives: int = 8
    """Hypotheses that are listed beside what is reported."""


@dataclass(frozen=True, kw_only=True)
class FrequencyVerdictSettings:
    """Settings of `vlab.diagnose.frequency_pipeline`."""

    above_noise: float = 1.5
    least_gap: float = 0.4
    """An effect is reported as found where it closes at least this share of the gap on held-out data, or on parts left out."""
    least_misfit: float = 0.04
    """Responses within this relative difference are explained."""
    least_score: float = 2.0
    """An effect must gain this much in score, the number of effects and places that were tried counted."""
    unverified: float = 3.0
    """Where nothing was held out, the amended model must come within this multiple of the noise: an effect that takes the edge off
    a misfit on the very data that it was fitted to may be anything."""
    least_parts: int = 6
    """Where so many parts of the data were left out one after the other, their prediction decides in the place of held-out data."""
    bands: int = 12


@dataclass(frozen=True, kw_only=True)
class VerdictSettings:
    """Settings of `vlab.diagnose.verdict`."""

    above_noise: float = 1.5
    """Held-out recordings are not explained where the refitted model leaves more than this multiple of their noise..."""
    least_misfit: float = 0.005
    """...and more than this share of their rms, or what the mesh of a structure leaves: what integration and interpolation leave of
    a user's model."""
    least_gap: float = 0.78
    """An effect is reported as found where it closes this share of the held-out gap down to noise and what the simulation itself
    misses, and this share of the gap down to the noise alone. On concealed cases of two rigs effects that were there closed .91 and
    more, other forms of them .78 and more, laws fitted to what no law describes .58 to .77."""
    least_to_noise: float = 0.5
    """See `least_gap`."""
    near_noise: float = 1.1
    """Where no more than this multiple of the noise is left, this share is enough: the gap was small."""
    least_near_noise: float = 0.7
    """See `near_noise`."""
    better: float = 0.998
    """A model is better than another where it leaves at most this multiple: hum within the noise has another phase in every recording, and
    fits none kept aside."""
    better_of_mesh: float = 0.9
    """...of a structure beside its noise, where the refitted model leaves no more than its mesh does: effects that bend a mesh gain
    hundredths."""
    nearly_all: float = 0.9
    """Share of the gap that is closed in most recordings where a single one may have less."""


ADVICE = AdviceSettings()
DATA_FINDINGS = DataFindingsSettings()
EXPORT = ExportSettings()
FINDINGS = FindingsSettings()
FREQUENCY_VERDICT = FrequencyVerdictSettings()
VERDICT = VerdictSettings()
