"""Settings of the check before a diagnosis."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class PrecheckSettings:
    """Settings of `vlab.diagnose.precheck`."""

    band_share: float = 0.9
    """band_share [1]: share of a channel's power in the printed band, 0 to 1; default a convention. Raising it widens
    the band."""
    least_samples: int = 16
    """least_samples [samples]: shortest channel with a band, at least 4; default untested. Raising it leaves out the
    band of short channels."""
    simulations_per_freedom: float = 20.0
    """simulations_per_freedom [1]: processor time of a diagnosis over that of one simulation of the fitted recordings
    and over the degrees of freedom, above 0; default from a servo bench (9 s) and an arm of two servos (32 s). Raising
    it foretells longer times."""
    least_seconds: float = 3.0
    """least_seconds [s]: time of a diagnosis of next to nothing, at least 0; default untested. Raising it foretells
    longer times."""


PRECHECK = PrecheckSettings()
