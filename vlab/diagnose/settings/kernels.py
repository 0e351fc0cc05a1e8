"""Settings of the compiled loops."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class KernelsSettings:
    """Settings of `vlab.diagnose.kernels`."""

    runaway: float = 1e12
    """runaway [1]: magnitude of a force or state in SI units from which a trial has diverged, above 0; default
    untested. Raising it detects divergence later."""
    checked: int = 8
    """checked [samples]: interval of the divergence check, at least 1; default untested. Raising it saves time and
    detects divergence later."""
    most: float = 1e9
    """most [1]: magnitude in SI units to which a diverged state is clipped, below `runaway`; default untested. Raising
    it risks overflow."""
    block: int = 256
    """block [samples]: samples of a matrix product, at least 1; default fills the second-level cache for 24 modes.
    Raising it takes more memory."""


KERNELS = KernelsSettings()
