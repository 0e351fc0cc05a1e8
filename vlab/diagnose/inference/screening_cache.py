"""Results that a screening computes once."""

from dataclasses import dataclass, field, replace
from typing import Any

from vlab.diagnose.inference.innovation_regression import EffectColumns
from vlab.diagnose.inference.residual_tones import ResidualSpectra, Tones
from vlab.signals import Array


@dataclass(eq=False)
class ScreeningCache:
    """Results that a screening computes once.

    Parameters
    ----------
    columns : dict
        Columns of all tested effects by location.
    series : dict
        Forces of hysteretic laws at all ports, by batch, effect and amplitudes.
    scans : dict
        Best values of scanned parameters, by effect, parameter and location.
    tones : dict
        Strongest tones of the residual by location.
    spectra : ResidualSpectra or None
        Spectra of the residual.
    """

    columns: dict[str, EffectColumns] = field(default_factory=dict)
    series: dict[tuple[Any, ...], Array] = field(default_factory=dict)
    scans: dict[tuple[str, str, str], list[float]] = field(default_factory=dict)
    tones: dict[str, Tones] = field(default_factory=dict)
    spectra: ResidualSpectra | None = None

    def for_other_residual(self) -> "ScreeningCache":
        """Return a cache that shares all but the residual's tones."""
        return replace(self, tones={}, spectra=None)
