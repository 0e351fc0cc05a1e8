"""A thing on the bench as it was built: matrices, places, actuators, sensors, and what may be a little off in it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import linalg

from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """A place where physics can act on the structure.

    Parameters
    ----------
    row : (n,) array
        Its coordinate z = row q.
    angular : bool
        Whether z is an angle.
    stiffness : float
        Of the elastic element at the place [N/m or N m/rad]; zero without one.
    K : (n, n) array or None
        Stiffness that the element contributes, where it is more than stiffness row row^T.
    alike : tuple of str
        Other names of the same coordinate.
    near : tuple of str
        Places one element or joint away.
    actuator : str
        The actuator that pushes along the place.
    """

    row: Array
    angular: bool = False
    stiffness: float = 0.0
    K: Array | None = None
    alike: tuple[str, ...] = ()
    near: tuple[str, ...] = ()
    actuator: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensor:
    """A sensor of displacement (`order` 0) or velocity (1) along a row."""

    row: Array
    order: int
    kind: str
    unit: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Bench:
    """M q'' + C q' + K q = sum of loads times forces, with named places, actuators and sensors.

    Parameters
    ----------
    actuators : mapping of str to (n,) array
        Load per unit force, true gain included.
    basis : (n_mesh, n) array or None
        Mesh coordinates per coordinate, where the bench was projected.
    """

    M: Array
    C: Array
    K: Array
    places: Mapping[str, Place]
    actuators: Mapping[str, Array]
    sensors: Mapping[str, Sensor]
    basis: Array | None = None

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.M)

    @property
    def loads(self) -> Array:
        """Loads of all actuators in columns, (n, n_actuators)."""
        return np.column_stack(list(self.actuators.values()))

    def first_order(self) -> tuple[Array, Array]:
        """Return A (2n, 2n) of the state [q, q'] and the inverse of M."""
        inverse = np.linalg.inv(self.M)
        A = np.block([[np.zeros((self.n, self.n)), np.eye(self.n)], [-inverse @ self.K, -inverse @ self.C]])
        return A, inverse

    def frequencies(self) -> Array:
        """Undamped natural frequencies [Hz], ascending."""
        squared = linalg.eigh(self.K, self.M, eigvals_only=True)
        return np.sqrt(np.maximum(squared, 0.0)) / (2 * np.pi)

    def in_modes(self, highest_hz: float) -> "Bench":
        """Return the bench in its undamped modes up to a frequency; every row and matrix is projected."""
        squared, shapes = linalg.eigh(self.K, self.M)
        T = shapes[:, squared < (2 * np.pi * highest_hz) ** 2]
        return self.projected(T)

    def projected(self, T: Array) -> "Bench":
        """Return the bench in coordinates p, q = T p."""
        return replace(
            self,
            M=T.T @ self.M @ T,
            C=T.T @ self.C @ T,
            K=T.T @ self.K @ T,
            places={
                name: replace(p, row=p.row @ T, K=None if p.K is None else T.T @ p.K @ T)
                for name, p in self.places.items()
            },
            actuators={name: T.T @ load for name, load in self.actuators.items()},
            sensors={name: replace(s, row=s.row @ T) for name, s in self.sensors.items()},
            basis=T,
        )

    def adding(self, M: Any = 0.0, C: Any = 0.0, K: Any = 0.0) -> "Bench":
        """Return the bench with matrices added."""
        return replace(self, M=self.M + M, C=self.C + C, K=self.K + K)

    def with_oscillator(self, place: str, mass: float, omega: float, zeta: float) -> "Bench":
        """Return the bench with one more coordinate: a mass on a spring and a damper at a place."""
        n, row = self.n, self.places[place].row
        wide = np.concatenate([-row, [1.0]])
        pair = np.outer(wide, wide)

        def grown(A: Array) -> Array:
            return np.block([[A, np.zeros((n, 1))], [np.zeros((1, n)), np.zeros((1, 1))]])

        M = grown(self.M)
        M[n, n] = mass
        return replace(
            self,
            M=M,
            C=grown(self.C) + 2 * zeta * omega * mass * pair,
            K=grown(self.K) + mass * omega**2 * pair,
            places={
                name: replace(p, row=np.append(p.row, 0.0), K=None if p.K is None else grown(p.K))
                for name, p in self.places.items()
            },
            actuators={name: np.append(load, 0.0) for name, load in self.actuators.items()},
            sensors={name: replace(s, row=np.append(s.row, 0.0)) for name, s in self.sensors.items()},
        )


@dataclass(frozen=True, kw_only=True)
class Benign:
    """Something that may be a little off: a log-factor with its standard deviation.

    Parameters
    ----------
    kind : str
        ``stiffness``, ``mass``, ``damping``, ``tension``, ``gain`` (of an actuator) or ``sensor``.
    """

    name: str
    kind: str
    sd: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Blueprint:
    """A kind of bench: how it is built with log-factors on its parameters, and what a case says of it.

    Parameters
    ----------
    build : callable
        Log-factors by the names of `benign` (missing: zero) and shifts of places [m] by sensor name to a `Bench`.
    matrices : callable
        Log-factors to M, C and K in mesh coordinates.
    benign : tuple of Benign
        Everything that varies from case to case without being physics that is missing.
    model : mapping of str to str
        What the case's ``[model]`` says.
    files : mapping of str to str
        Files of the nominal model.
    uncertain : mapping
        ``[model.uncertain]``: what the case states of it.
    rate_hz : float
        Of the recordings and the commands.
    substeps : int
        Integration steps per sample.
    seconds : float
        Length of a recording.
    band_hz : (float, float)
        Of the excitation.
    force : float
        Rms of the command at the middle level [N or N m].
    input_kind : str
        ``command`` passes the laboratory's converter, delay and filter; ``force`` and ``moment`` are held as they are.
    place_sd : float
        Standard deviation of the sensors' places [m].
    """

    name: str
    title: str
    build: Callable[[Mapping[str, float], Mapping[str, float]], Bench]
    matrices: Callable[[Mapping[str, float]], tuple[Array, Array, Array]]
    benign: tuple[Benign, ...]
    model: Mapping[str, str]
    files: Mapping[str, str] = field(default_factory=dict)
    uncertain: Mapping[str, float]
    rate_hz: float
    substeps: int
    seconds: float
    band_hz: tuple[float, float]
    force: float
    input_kind: str
    input_unit: str
    place_sd: float = 0.0
    exciters: tuple[str, ...] = ()
