"""Sampling of motion: coil roll-off, pick-up, noise, drift, quantisation.

`vlab.physics.sensors` has the laws of pick-up, drift and quantisation; the hardware file has their values.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vlab.hardware.laboratory import Hardware
from vlab.physics.sensors import MainsHum, SensorDrift, SensorQuantisation
from vlab.signals import Array

CARRIER, DRIFT, QUANTISATION = MainsHum(), SensorDrift(), SensorQuantisation()
"""CARRIER, DRIFT,
QUANTISATION: effects that implement pick-up, drift and quantisation."""
_NO_TIMES = np.zeros(0)


def coil_gain(displacement: Array, linear_range: float) -> Array:
    """Return the gain of a coil sensor over displacement [1].

    The gain is one inside the linear travel. Outside it is 1/(1 + (e/r)^2), with the excess e and half the travel r.
    The form is assumed: the text gives only the linear range of about a quarter inch.

    Parameters
    ----------
    displacement : array
        Distance from the centre [m].
    linear_range : float
        Full linear travel [m].

    Returns
    -------
    array
        Gain, shape of `displacement`.
    """
    half = linear_range / 2
    excess = np.maximum(np.abs(displacement) - half, 0.0)
    return np.asarray(1.0 / (1.0 + (excess / half) ** 2))


@dataclass(frozen=True, eq=False)
class Sampling:
    """Conversion of true sensor values to samples.

    Parameters
    ----------
    is_velocity : (n_sensors,) bool array
        Whether the sensor is a coil; every other sensor is a probe.
    added : (n_samples, n_sensors) array or None
        Noise, pick-up and drift, drawn in advance so that a seed gives the same bits on any number of threads.
    """

    hardware: Hardware
    is_velocity: Array
    added: Array | None

    @classmethod
    def draw(cls, hardware: Hardware, is_velocity: Array, samples: int, rng: np.random.Generator) -> "Sampling":
        """Draw all random values of a run.

        The values are noise, phases of the pick-up, and drift rates.

        Parameters
        ----------
        hardware : Hardware
            Hardware between law and structure.
        is_velocity : array
            Whether each sensor is a coil, (n_sensors,).
        samples : int
            Number of samples of the run.
        rng : np.random.Generator
            Random generator.

        Returns
        -------
        Sampling
            Sampling of the run.
        """
        coil, probe = hardware.velocity_sensor, hardware.displacement_probe
        n, period = len(is_velocity), 1.0 / hardware.converter.rate
        added, is_silent, t = np.zeros((samples, n)), True, np.arange(samples) * period
        sd = np.where(is_velocity, coil.noise, probe.noise)
        if np.any(sd > 0):
            added, is_silent = rng.standard_normal((samples, n)) * sd, False
        for volts, hz in hardware.leads.carriers if hardware.leads is not None else ():
            amplitude, phase = np.where(is_velocity, volts / coil.sensitivity, 0.0), rng.uniform(0, 2 * np.pi, n)
            parts = {"sine": amplitude * np.cos(phase), "cosine": amplitude * np.sin(phase), "frequency": hz}
            added, is_silent = CARRIER.sense(added, parts, period, t), False
        wander = np.where(is_velocity, coil.drift, probe.drift)
        if np.any(wander > 0):
            added, is_silent = DRIFT.sense(added, {"rate": wander * rng.standard_normal(n)}, period, t), False
        return cls(hardware, is_velocity, None if is_silent else added)

    @property
    def is_ideal(self) -> bool:
        """Whether samples within the linear travel are exact."""
        coil = self.hardware.velocity_sensor
        return self.added is None and self.hardware.converter.resolution == 0.0 and coil.signal_share == 1.0

    def samples(self, values: Array, travel: Array | None, at: int | slice) -> Array:
        """Return the converter's samples for true sensor values.

        Parameters
        ----------
        values : (..., n_sensors) array
            True velocities and displacements.
        travel : (..., n_coils) array or None
            Displacements of the coil sensors in order; None if the plant lacks them.
        at : int or slice
            Indices of the samples in the run, for noise, pick-up and drift.
        """
        return self.converted(self.rolled_off(values, travel), at)

    def rolled_off(self, values: Array, travel: Array | None) -> Array:
        """Return the coil sensors' reduced values.

        Travel beyond the linear range and a load reduce the values.

        Parameters
        ----------
        values : array
            True sensor values, (..., n_sensors).
        travel : array or None
            Displacements of the coil sensors [m]; None if unknown.

        Returns
        -------
        array
            Values, (..., n_sensors).
        """
        coil = self.hardware.velocity_sensor
        is_linear = travel is None or bool(np.abs(travel).max(initial=0.0) <= coil.linear_range / 2)
        if is_linear and coil.signal_share == 1.0:
            return values
        values = values.copy()
        share = 1.0 if travel is None else coil_gain(travel, coil.linear_range)
        values[..., self.is_velocity] *= coil.signal_share * share
        return values

    def converted(self, values: Array, at: int | slice) -> Array:
        """Return values with noise, pick-up, drift and quantisation.

        Parameters
        ----------
        values : array
            Sensor values, (..., n_sensors).
        at : int or slice
            Indices of the samples in the run.

        Returns
        -------
        array
            Samples, (..., n_sensors).
        """
        if self.added is not None:
            values = values + self.added[at]
        if self.steps is not None:
            values = QUANTISATION.sense(values, {"step": self.steps}, 0.0, _NO_TIMES)
        return values

    @cached_property
    def steps(self) -> Array | None:
        """Quantisation steps in motion units, (n_sensors,).

        None without quantisation.
        """
        volts, coil = self.hardware.converter.resolution, self.hardware.velocity_sensor
        per_motion = np.where(self.is_velocity, coil.sensitivity, self.hardware.displacement_probe.sensitivity)
        return volts / per_motion if volts > 0 else None

    def only(self, sensors: Array) -> "Sampling":
        """Return the sampling of selected sensors."""
        added = None if self.added is None else np.ascontiguousarray(self.added[:, sensors])
        return Sampling(self.hardware, self.is_velocity[sensors], added)
