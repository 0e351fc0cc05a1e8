"""Errors of models on data, and the closed gap.

The gap is the error of the model without findings minus the noise. Every finding's contribution is the change by its
removal.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from scipy import stats

from vlab.diagnose.settings import GAP, MODEL_CHOICE
from vlab.signals import Array, rms

D = TypeVar("D", bound="Distance")


@dataclass(frozen=True, kw_only=True)
class Part:
    """Contribution of one finding to one data set.

    Parameters
    ----------
    name : str
        Finding.
    left : float
        Relative error of the extended model without the finding.
    information : float
        Expected log-likelihood ratio of both models if the residual is noise [nat].
    """

    name: str
    left: float
    information: float

    @property
    def is_idle(self) -> bool:
        """Whether the finding has no detectable effect on the data."""
        return self.information < MODEL_CHOICE.alike


@dataclass(frozen=True, kw_only=True, eq=False)
class Distance:
    """Errors of the models on one data set.

    Parameters
    ----------
    name, role : str
        Name and role of the data.
    nominal, before, after, noise : float
        Relative errors: nominal model, the better of nominal and calibrated, extended model, noise.
    channels : dict
        (nominal, before, after, noise) by channel, `before` of one model throughout.
    calibrated : float
        Relative error of the calibrated model; NaN without one.
    bare : float
        Relative error of the extended model without any finding, that is its calibration alone.
    parts : tuple of Part
        Contributions of the findings.
    horizon_s : float
        Length of the parts that are predicted one by one [s]; infinite for data predicted as a whole.
    band_hz : float
        Highest compared frequency [Hz]; infinite without a limit.
    log_ratios : (n_blocks,) array
        Log ratio of the mean-square errors of the model of `start` and the extended model, by block of the data.
    is_refuted : bool
        Whether the calibrated model has implausible parameters; the nominal model then remains.
    spread : mapping of str to float
        Standard deviation of a channel over all recordings of the case, relative to these data; 1 for absent channels.
    """

    name: str
    role: str
    nominal: float
    before: float
    after: float
    noise: float
    channels: dict[str, tuple[float, float, float, float]]
    calibrated: float = float("nan")
    bare: float = float("nan")
    parts: tuple[Part, ...] = ()
    horizon_s: float = float("inf")
    band_hz: float = float("inf")
    log_ratios: Array = field(default_factory=lambda: np.zeros(0))
    is_refuted: bool = False
    spread: Mapping[str, float] = field(default_factory=dict)

    @property
    def lost(self) -> float:
        """Error from which a model explains nothing.

        The mean over all recordings of the case is as good a prediction. In a recording that hardly moves, the mean over this
        recording alone would be far better than any model.
        """
        return GAP.lost * rms(np.array([self.spread_of(name) for name in self.channels])) if self.channels else GAP.lost

    def spread_of(self, channel: str) -> float:
        """Return a channel's spread over all recordings or these data."""
        return max(self.spread.get(channel, 1.0), 1.0)

    @property
    def incoherent(self) -> float:
        """Relative rms of the incoherent part of the residual of `before`.

        The part is coherent with neither inputs nor motion; 0 where unknown.
        """
        return 0.0

    @property
    def is_spoilt(self) -> bool:
        """Whether calibration increases the error; the nominal model then remains."""
        return self.calibrated > self.nominal

    @property
    def stands(self) -> str:
        """Name of the model that remains: ``"nominal"`` or ``"calibrated"``."""
        return "nominal" if self.is_spoilt or self.is_refuted else "calibrated"

    @property
    def start(self) -> float:
        """Least error without findings.

        The minimum is over nominal, calibrated and extended calibration. A gap closed by calibration is no gap closed
        by a finding.
        """
        return float(np.fmin(self.before, self.bare))

    @property
    def is_idle(self) -> bool:
        """Whether no finding has a detectable effect on hold-out data.

        Such data cannot verify a finding.
        """
        return self.role == "holdout" and bool(self.parts) and all(part.is_idle for part in self.parts)

    @property
    def gap_closed(self) -> float | None:
        """Closed share of the gap; None within the noise."""
        return None if self.is_idle else gap_closed(self.before, self.after, self.noise)


def block_log_ratios(without: Array, extended: Array, blocks: int, noise: Array | float = 0.0) -> Array:
    """Return log ratios of mean-square errors by block.

    Parameters
    ----------
    without, extended : (n, n_channels) array
        Errors of both models over the channels' rms.
    blocks : int
        Number of blocks of equal length.
    noise : (n_channels,) array or float
        Noise over the channels' rms.

    Returns
    -------
    (n_blocks,) array
        Log ratios, positive where the extended model is better. Blocks in which neither model errs by more than the noise
        are absent: the start of a slow sweep, or a pause.
    """
    within = float(np.mean(np.square(noise)))
    pairs = [
        (float(np.mean(a**2)), float(np.mean(b**2)))
        for a, b in zip(np.array_split(without, blocks), np.array_split(extended, blocks), strict=True)
        if a.size
    ]
    return np.array([np.log(a / b) for a, b in pairs if min(a, b) > 0.0 and max(a, b) > within])


def predicts_better(log_ratios: Array, false_alarm_rate: float) -> bool:
    """Return whether one model predicts significantly better.

    One-sided tests on the log ratios of all blocks [1]_: a t test, and Wilcoxon's signed-rank test. A limit acts in few
    blocks, whose large ratios raise the variance of the t test; ranks are robust, but need seven blocks. Each test has half
    of the false-alarm rate. The scale of every block's error is unknown, as in a predictive log score with estimated
    variance.

    Parameters
    ----------
    log_ratios : (n_blocks,) array
        Log ratios of the mean-square errors, positive where the model is better.
    false_alarm_rate : float
        Probability of a positive answer for equal models [1].

    Returns
    -------
    bool
        True if the mean or the median log ratio is significantly positive.

    References
    ----------
    .. [1] F. X. Diebold, R. S. Mariano, Comparing predictive accuracy, J. Bus. Econ. Stat. 13 (1995) 253-263.
    """
    if len(log_ratios) < 2:
        return False
    if np.ptp(log_ratios) == 0.0:
        return bool(log_ratios[0] > 0.0)
    of_mean = stats.ttest_1samp(log_ratios, 0.0, alternative="greater").pvalue
    of_median = stats.wilcoxon(log_ratios, alternative="greater").pvalue
    return bool(min(of_mean, of_median) < 0.5 * false_alarm_rate)


def gap_closed(before: float, after: float, noise: float) -> float | None:
    """Return the closed share of the gap to the noise.

    Parameters
    ----------
    before, after, noise : float
        Relative errors.

    Returns
    -------
    float or None
        Share; None where `before` is within the noise.
    """
    if not np.isfinite(before):
        return 1.0 if np.isfinite(after) else 0.0
    if before <= GAP.within_noise * noise:
        return None
    return float((before - after) / (before - noise)) if np.isfinite(after) else -np.inf


def part_of(name: str, left: float, moved: Array, noise: Array, samples: int) -> Part:
    """Return the contribution of a finding.

    Detectability is relative to the noise alone. A finding acts even where the residual exceeds the noise.

    Parameters
    ----------
    name : str
        Finding.
    left : float
        Relative error of the extended model without the finding.
    moved, noise : (n_channels,) array
        Change by removal, and noise, over the channels' rms; infinite after divergence.
    samples : int
        Samples per channel.

    Returns
    -------
    Part
        Contribution.
    """
    return Part(
        name=name, left=left, information=float(0.5 * samples * np.sum((moved / np.maximum(noise, 1e-300)) ** 2))
    )


def verifying(checked: Sequence[D]) -> list[D]:
    """Return the data that can verify a finding, otherwise all."""
    return [c for c in checked if not c.is_idle] or list(checked)


def whole_gap(checked: Sequence[Distance]) -> float | None:
    """Return the closed share over all verifying data."""
    chosen = [c for c in checked if not c.is_idle]
    return gap_closed(*(total(chosen, key) for key in ("before", "after", "noise"))) if chosen else None


def explained_share(checked: Sequence[Distance]) -> float | None:
    """Return the share of the mismatch that the extended model explains.

    The mismatch is the mean square of `Distance.before` beyond the noise, which no physics explains.

    Parameters
    ----------
    checked : sequence of Distance
        Errors.

    Returns
    -------
    float or None
        Share, negative for a worse extended model; None within the noise.
    """
    tests = verifying(checked)
    before, after, noise = (total(tests, key) for key in ("before", "after", "noise"))
    if not before > noise:
        return None
    if not np.isfinite(before):
        return 1.0 if np.isfinite(after) else 0.0
    return (before**2 - after**2) / (before**2 - noise**2) if np.isfinite(after) else -np.inf


def total(checked: Sequence[Distance], which: str) -> float:
    """Return the rms of one error over the recordings."""
    values = np.array([getattr(c, which) for c in checked])
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
