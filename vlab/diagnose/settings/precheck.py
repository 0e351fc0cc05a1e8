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
    simulations: float = 30.0
    """simulations [1]: time of a diagnosis over that of one simulation of the fitted recordings, above 0; default from
    four servo and friction cases of 1 to 3 degrees of freedom. Raising it foretells longer times."""
    simulations_per_freedom: float = 10.0
    """simulations_per_freedom [1]: increase of that ratio by degree of freedom, at least 0; default from the same
    cases. Raising it foretells longer times for large models."""
    least_seconds: float = 5.0
    """least_seconds [s]: time of a diagnosis of next to nothing, at least 0; default from the same cases, compilation
    included. Raising it foretells longer times."""


PRECHECK = PrecheckSettings()
