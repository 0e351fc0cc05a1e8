"""From motion to samples: the roll-off of coil sensors outside their travel, noise, quantisation."""

from dataclasses import dataclass

import numpy as np

from vlab.hardware.laboratory import Hardware
from vlab.signals import Array


def coil_gain(displacement: Array, linear_range: float) -> Array:
    """Return the gain of a coil sensor at a displacement from its centre [m].

    One inside the linear travel; outside it falls as the coil leaves the gap, 1/(1 + (e/r)^2) with e the excess and r
    half the travel. The form is assumed: the text says only that the signal is linear over about a quarter inch.
    """
    half = linear_range / 2
    excess = np.maximum(np.abs(displacement) - half, 0.0)
    return np.asarray(1.0 / (1.0 + (excess / half) ** 2))


@dataclass(frozen=True, eq=False)
class Sampling:
    """How true sensor values become samples.

    Parameters
    ----------
    is_velocity : (n_sensors,) bool array
        Which sensors are coils.
    noise : (n_samples, n_sensors) array or None
        Additive noise, drawn beforehand so that a seed gives the same bits on any number of threads.
    """

    hardware: Hardware
    is_velocity: Array
    noise: Array | None

    @classmethod
    def draw(cls, hardware: Hardware, is_velocity: Array, samples: int, rng: np.random.Generator) -> "Sampling":
        """Draw the noise of a whole run."""
        sd = np.where(is_velocity, hardware.velocity_sensor.noise, hardware.displacement_probe.noise)
        noise = rng.standard_normal((samples, len(sd))) * sd if np.any(sd > 0) else None
        return cls(hardware, is_velocity, noise)

    @property
    def is_ideal(self) -> bool:
        """Whether samples inside the linear travel are the true values."""
        return self.noise is None and self.hardware.converter.resolution == 0.0

    def samples(self, values: Array, travel: Array | None, at: int | slice) -> Array:
        """Return what the converter gives for true sensor values.

        Parameters
        ----------
        values : (..., n_sensors) array
            True velocities and displacements.
        travel : (..., n_coils) array or None
            Displacements of the coil sensors, in their order; None where the plant does not know them.
        at : int or slice
            Which samples of the run these are, for the noise.
        """
        return self.converted(self.rolled_off(values, travel), at)

    def rolled_off(self, values: Array, travel: Array | None) -> Array:
        """Return what coil sensors give of true values: less, outside their linear travel."""
        if travel is not None:
            values = values.copy()
            values[..., self.is_velocity] *= coil_gain(travel, self.hardware.velocity_sensor.linear_range)
        return values

    def converted(self, values: Array, at: int | slice) -> Array:
        """Return what the converter gives of the sensors' values: with noise, in its steps."""
        if self.noise is not None:
            values = values + self.noise[at]
        step = self.hardware.converter.resolution
        if step > 0:
            values = np.where(self.is_velocity, np.round(values / step) * step, values)
        return values
