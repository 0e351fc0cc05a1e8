"""Settings of validation."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FrequencyValidationSettings:
    """Settings of `vlab.diagnose.validation.frequency`."""

    neighbours: int = 9
    drowned: float = 0.3
    """Lines whose noise is more than this share of the response say nothing of a model."""


@dataclass(frozen=True, kw_only=True)
class GapSettings:
    """Settings of `vlab.diagnose.validation.gap`."""

    no_worse: float = 1.02
    """A model is no worse than another where it leaves at most this multiple, which is what the fits' own convergence is good for."""
    lost: float = 1.0
    """An error as large as the recording itself: a model that leaves it there explains nothing, however far off another one is."""


@dataclass(frozen=True, kw_only=True)
class ResponseChecksSettings:
    """Settings of `vlab.diagnose.validation.response_checks`."""

    share: float = 0.3
    """A response is early where its phase turns the wrong way by this share of what the model's turns the right way."""
    turns: float = 0.02
    """Least turn of a model's phase from line to line, as a share of its power, beside which a measured one says something."""


@dataclass(frozen=True, kw_only=True)
class ValidationSettings:
    """Settings of `vlab.diagnose.validation.simulation`."""

    finer: int = 4
    """Steps are compared with steps so many times as short; what these change is said where it is this share of what is unexplained."""
    coarse: float = 0.2
    """See `finer`."""


FREQUENCY_VALIDATION = FrequencyValidationSettings()
GAP = GapSettings()
RESPONSE_CHECKS = ResponseChecksSettings()
VALIDATION = ValidationSettings()
