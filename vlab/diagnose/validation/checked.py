"""Errors of the models on one recording, with the simulations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vlab.cases.channel_map import Run
from vlab.diagnose.data.band import below
from vlab.diagnose.data.residual_noise import incoherent_rms, is_gaussian
from vlab.diagnose.validation.gap import Distance
from vlab.signals import Array, Recording, longest_read, rms


@dataclass(frozen=True, kw_only=True, eq=False)
class Checked(Distance):
    """Errors of the models on one recording.

    Errors are rms over channels of error over the recording's rms about its mean; infinite after divergence.

    Parameters
    ----------
    run : Run
        Recording.
    simulated : tuple of Recording or None
        Nominal, calibrated and extended simulation.
    """

    run: Run
    simulated: tuple[Recording | None, Recording | None, Recording | None]

    @property
    def measured(self) -> Recording:
        """Recorded channels."""
        return self.run.measured

    @property
    def notes(self) -> tuple[str, ...]:
        """Note on a comparison that leaves out fast motion."""
        if np.isinf(self.band_hz):
            return ()
        return (
            f"{self.name}: compared below {self.band_hz:.3g} Hz, above which no fitted recording tells of the modes",
        )

    @cached_property
    def incoherent(self) -> float:
        """See `Distance`; at least the noise.

        The difference of the nominal and the calibrated model is the noise-free signal that shows the bias of the
        method.
        """
        nominal, calibrated, _ = self.simulated
        shares = []
        for rows, names, left in self._residuals:
            cut = replace(self.run, measured=self.measured.rows(rows), valid=None)
            apart = None
            if nominal is not None and calibrated is not None:
                columns = [self.measured.index(name) for name in names]
                apart = (nominal.data - calibrated.data)[rows, columns]
            noise = [self.channels[name][-1] for name in names]
            shares.append(np.maximum(incoherent_rms(cut, names, left, apart) / self._scale(names), noise))
        return rms(np.concatenate(shares)) if shares else self.noise

    def is_gaussian(self, false_alarm_rate: float) -> bool:
        """Return whether the residual may be stationary Gaussian noise.

        The residual of parts that start from states of their own grows in each part, so it is not tested.

        Parameters
        ----------
        false_alarm_rate : float
            Probability of a negative answer for such noise [1].

        Returns
        -------
        bool
            False if a channel without lost readings contradicts such noise.
        """
        if np.isfinite(self.horizon_s) or not self.measured.is_uniform:
            return True
        rate = false_alarm_rate / max(len(self._residuals), 1)
        return all(is_gaussian(left / self._scale(names), rate) for _, names, left in self._residuals)

    def error_until(self, time: float) -> float:
        """Return the error `before` up to a time.

        Parameters
        ----------
        time : float
            Time of the last sample [s].

        Returns
        -------
        float
            Rms over channels of the error over the recording's rms about its mean; zero without samples or simulation.
        """
        if self.standing is None:
            return 0.0
        shares = []
        for name in self.channels:
            left = self.measured[name] - self.standing[name]
            rows = self.measured.is_read(name) & (self.measured.time <= time)
            shares.append(rms(left[rows]) / float(self._scale([name])[0]) if rows.any() else 0.0)
        return rms(np.array(shares))

    @cached_property
    def _residuals(self) -> list[tuple[slice, list[str], Array]]:
        """Residuals of `before` by longest stretches without lost readings.

        Each has its rows and its channels. There are none without a simulation.
        """
        if self.standing is None:
            return []
        parts: dict[tuple[int, int], list[str]] = {}
        for name in self.channels:  # spectra need neighbouring samples
            part = longest_read(self.measured, name)
            parts.setdefault((part.start, part.stop), []).append(name)
        left = self.measured.data - self.standing.data
        if np.isfinite(self.band_hz):
            left = below(left, self.measured.sample_period, self.band_hz)
        return [
            (slice(*part), names, left[slice(*part), [self.measured.index(name) for name in names]])
            for part, names in parts.items()
        ]

    def _scale(self, names: Sequence[str]) -> Array:
        """Return the rms (n_names,) of channels about their means."""
        return np.array([np.std(self.measured[name][self.measured.is_read(name)]) for name in names])

    @property
    def standing(self) -> Recording | None:
        """Simulation of the nominal or calibrated model that remains.

        Its error is `before`.
        """
        return self.simulated[0] if self.stands == "nominal" else self.simulated[1]

    @property
    def extended(self) -> Recording | None:
        """Simulation of the extended model, where available."""
        return None if self.simulated[2] is self.standing else self.simulated[2]

    def against_nominal(self) -> "Checked":
        """Return the errors against the nominal instead of the calibrated model."""
        channels = {
            name: (nominal, nominal, after, noise) for name, (nominal, _, after, noise) in self.channels.items()
        }
        return replace(self, before=self.nominal, channels=channels, is_refuted=True)

    def without_findings(self) -> "Checked":
        """Return the errors without any finding."""
        channels = {
            name: (nominal, before, before, noise) for name, (nominal, before, _, noise) in self.channels.items()
        }
        nominal, calibrated, _ = self.simulated
        simulated = (nominal, calibrated, self.standing)
        return replace(self, after=self.before, channels=channels, simulated=simulated, log_ratios=np.zeros(0))
