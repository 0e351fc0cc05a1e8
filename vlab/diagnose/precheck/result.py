"""Result of a check before a diagnosis."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from vlab.cases.checks import FileCheck
from vlab.cases.compare import Comparison


@dataclass(frozen=True, kw_only=True)
class ChannelCheck:
    """One channel of one recording.

    Parameters
    ----------
    recording, role, channel, unit : str
        Recording with its role, channel with its SI unit.
    is_input : bool
        Whether the channel drives the model.
    recorded_rms : float
        Rms about the mean [unit]; of a frequency response over its lines.
    simulated_rms : float or None
        Rms of the simulation about its mean [unit]; None for an input.
    correlation : float or None
        Correlation of recording and simulation, from -1 to 1.
    nrmse : float or None
        Rms error over the recorded rms.
    delay_s : float or None
        Shift of the recording behind the simulation with the smallest residual [s].
    left_now, left_shifted : float or None
        Share of the recorded power, in the mean over frequency bands, without and with the shift.
    period_s : float or None
        Median sample period [s]; None for a frequency response.
    low_hz, high_hz : float or None
        Band that holds most of the power about the mean, or of the squared response [Hz].
    noise : float or None
        Rms of the noise [unit], at least that of the sensor's step; None for an input.
    noise_source : str
        How the noise was obtained.
    step : float or None
        Step of the sensor's readings [unit]; None for readings on no grid.
    """

    recording: str
    role: str
    channel: str
    unit: str
    is_input: bool
    recorded_rms: float
    simulated_rms: float | None = None
    correlation: float | None = None
    nrmse: float | None = None
    delay_s: float | None = None
    left_now: float | None = None
    left_shifted: float | None = None
    period_s: float | None = None
    low_hz: float | None = None
    high_hz: float | None = None
    noise: float | None = None
    noise_source: str = ""
    step: float | None = None


@dataclass(frozen=True, kw_only=True)
class Remark:
    """One observation of a check.

    Parameters
    ----------
    channel : str
        Channel; empty for the whole case.
    what : str
        Observation.
    value : float or None
        Number of the observation, if there is one.
    mend : str
        Edit of the case or of the measurement; empty if none is needed.
    severity : str
        ``"fatal"``, ``"warning"`` or ``"note"``.
    """

    channel: str
    what: str
    value: float | None = None
    mend: str = ""
    severity: str = "note"


@dataclass(frozen=True, kw_only=True, eq=False)
class Precheck:
    """Result of a check.

    Parameters
    ----------
    title : str
        Title of the case.
    comparison : Comparison or None
        Recordings beside their simulation; None where the simulation diverges, and for frequency data.
    channels : tuple of ChannelCheck
        Channels of all recordings.
    remarks : tuple of Remark
        Observations, the worst first.
    refused : tuple of str
        Reasons for which a diagnosis would refuse the case.
    seconds_expected : float or None
        Rough time of a diagnosis [s]; None for a case that would be refused.
    """

    title: str
    comparison: Comparison | None
    channels: tuple[ChannelCheck, ...]
    remarks: tuple[Remark, ...]
    refused: tuple[str, ...]
    seconds_expected: float | None

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON document."""
        return {
            "findings": [asdict(remark) for remark in self.remarks],
            "refused": list(self.refused),
            "seconds_expected": self.seconds_expected,
            "channels": [asdict(channel) for channel in self.channels],
        }


def remarks_of_file(check: FileCheck) -> list[Remark]:
    """Return the findings on a case description as remarks."""
    return [Remark(channel=", ".join(f.channels), what=f.what, mend=f.mend, severity=f.severity) for f in check.found]


def worst_first(remarks: Iterable[Remark]) -> tuple[Remark, ...]:
    """Return remarks in the order of their severity."""
    order = ("fatal", "warning", "note")
    return tuple(sorted(remarks, key=lambda remark: order.index(remark.severity)))
