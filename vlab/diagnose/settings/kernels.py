"""Settings of the compiled loops."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class KernelsSettings:
    """Settings of `vlab.diagnose.kernels.expression_graph`."""

    runaway: float = 1e12
    """Forces and states beyond this have run away."""
    checked: int = 8
    """Every so many samples states are looked at whether they ran away."""
    most: float = 1e9
    """What such states are brought back to."""


KERNELS = KernelsSettings()
