"""Settings of validation."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FrequencyValidationSettings:
    """Settings of `vlab.diagnose.validation.frequency`."""

    neighbours: int = 9
    """neighbours [lines]: lines of the running median of a response's magnitude, at least 1; default untested. Raising
    it smooths the signal-to-noise test."""
    drowned: float = 0.3
    """drowned [1]: noise over response above which a line is ignored, above 0; default untested. Raising it keeps
    noisier lines."""


@dataclass(frozen=True, kw_only=True)
class GapSettings:
    """Settings of `vlab.diagnose.validation.gap`."""

    no_worse: float = 1.02
    """no_worse [1]: residual over another up to which a model is no worse, above 1; default the convergence tolerance
    of the fits. Raising it tolerates worse models."""
    lost: float = 1.0
    """lost [1]: residual over a recording's rms from which a model explains nothing, above 0; default the recording
    itself. Raising it accepts models that diverge."""
    within_noise: float = 1.1
    """within_noise [1]: residual over the noise up to which no gap is defined, at least 1; default untested. Raising it
    leaves small gaps undefined."""


@dataclass(frozen=True, kw_only=True)
class ResponseChecksSettings:
    """Settings of `vlab.diagnose.validation.response_checks`."""

    share: float = 0.3
    """share [1]: reversed phase turn of a response over the modelled turn from which the response is early, above 0;
    default untested. Raising it reports fewer conjugated responses."""
    turns: float = 0.02
    """turns [1]: least modelled phase turn per line over its power for the test, above 0; default untested. Raising it
    tests fewer responses."""


@dataclass(frozen=True, kw_only=True)
class ValidationSettings:
    """Settings of `vlab.diagnose.validation.simulation`."""

    finer: int = 4
    """finer [1]: factor by which the step of the check simulation is shorter, above 1; default untested. Raising it
    costs time."""
    coarse: float = 0.2
    """coarse [1]: change by shorter steps over the unexplained residual from which a note is written, above 0; default
    untested. Raising it writes fewer notes."""
    least_part: int = 100
    """least_part [samples]: shortest part of a recording that is predicted from a state of its own, at least 20;
    default five times the shortest window of an initial state. Raising it keeps parts longer."""
    blocks: int = 8
    """blocks [1]: parts of a recording whose errors count as independent in a test between models, at least 2; default
    untested. Raising it overstates the evidence of correlated errors."""
    levels: tuple[float, ...] = (1.0 / 3.0, 1.0, 3.0)
    """levels [1]: factors on a recorded excitation that a next experiment may have, above 0; default half a decade to
    each side, untested. Raising them asks more of the rig."""


FREQUENCY_VALIDATION = FrequencyValidationSettings()
GAP = GapSettings()
RESPONSE_CHECKS = ResponseChecksSettings()
VALIDATION = ValidationSettings()
