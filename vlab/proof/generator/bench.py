"""Bench as built: matrices, places, actuators, sensors, uncertain parameters."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import linalg

from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """Place of the structure for physics.

    Parameters
    ----------
    row : (n,) array
        Coordinate z = row q.
    angular : bool
        Whether z is an angle.
    stiffness : float
        Stiffness of the elastic element at the place [N/m or N m/rad]; zero without one.
    K : (n, n) array or None
        Stiffness matrix of the element, if it exceeds stiffness row row^T.
    alike : tuple of str
        Other names of the same coordinate.
    near : tuple of str
        Places one element or joint away.
    actuator : str
        Actuator along the place.
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
    """Sensor of displacement (`order` 0) or velocity (1) along a row."""

    row: Array
    order: int
    kind: str
    unit: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Bench:
    """Linear bench with named places, actuators and sensors.

        M q'' + C q' + K q = sum of loads times forces

    Parameters
    ----------
    actuators : mapping of str to (n,) array
        Load per unit force, with the true gain.
    basis : (n_mesh, n) array or None
        Mesh coordinates per coordinate of a projected bench.
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
        """Return A (2n, 2n) of the state [q, q'] and inv(M)."""
        inverse = np.linalg.inv(self.M)
        A = np.block([[np.zeros((self.n, self.n)), np.eye(self.n)], [-inverse @ self.K, -inverse @ self.C]])
        return A, inverse

    def frequencies(self) -> Array:
        """Undamped natural frequencies [Hz], ascending."""
        squared = linalg.eigh(self.K, self.M, eigvals_only=True)
        return np.sqrt(np.maximum(squared, 0.0)) / (2 * np.pi)

    def in_modes(self, highest_hz: float) -> "Bench":
        """Return the bench in its undamped modes up to a frequency."""
        squared, shapes = linalg.eigh(self.K, self.M)
        T = shapes[:, squared < (2 * np.pi * highest_hz) ** 2]
        return self.projected(T)

    def projected(self, T: Array) -> "Bench":
        """Return the bench in coordinates p, q = T p.

        Parameters
        ----------
        T : array
            Basis, (n, p).

        Returns
        -------
        Bench
            Projected bench.
        """
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

    def up_to(self, highest_hz: float) -> "Bench":
        """Return a bench in its modes without those above a frequency.

        Parameters
        ----------
        highest_hz : float
            Highest frequency [Hz].

        Returns
        -------
        Bench
            Bench in fewer modes.
        """
        keep = np.eye(self.n)[:, np.sqrt(self.K.diagonal()) < 2 * np.pi * highest_hz]
        basis = keep if self.basis is None else self.basis @ keep
        return self if keep.shape[1] == self.n else replace(self.projected(keep), basis=basis)

    def adding(self, M: Any = 0.0, C: Any = 0.0, K: Any = 0.0) -> "Bench":
        """Return the bench with matrices added."""
        return replace(self, M=self.M + M, C=self.C + C, K=self.K + K)

    def with_oscillator(self, place: str, mass: float, omega: float, zeta: float) -> "Bench":
        """Return the bench with a sprung and damped mass at a place.

        Parameters
        ----------
        place : str
            Name of the place.
        mass : float
            Mass [kg].
        omega : float
            Natural frequency [rad/s].
        zeta : float
            Damping ratio [-].

        Returns
        -------
        Bench
            Bench with one more coordinate.
        """
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
    """Deviation of a bench as built: a log-factor with its standard deviation.

    Parameters
    ----------
    kind : str
        ``stiffness``, ``mass``, ``damping``, ``tension``, ``frequency``, ``gain`` (of an actuator) or ``sensor``. A
        deviation of kind ``local`` is not a parameter of the nominal model.
    sd : float
        Standard deviation of the bench as built; 0 if nothing is drawn.
    stated : float or None
        Standard deviation according to the case; by default that of the bench as built, 0 for a fixed parameter.
    """

    name: str
    kind: str
    sd: float
    stated: float | None = None

    @property
    def prior(self) -> float:
        """Standard deviation in a calibration; 0 for a fixed parameter."""
        return self.sd if self.stated is None else self.stated


@dataclass(frozen=True, kw_only=True, eq=False)
class Nominal:
    """Content of a case but for its recordings.

    Parameters
    ----------
    name, title : str
        Names of the bench and of the case.
    model : mapping of str to str
        Table ``[model]`` of the case.
    files : mapping of str to str
        Files of the nominal model.
    uncertain : mapping
        Table ``[model.uncertain]`` of the case.
    rate_hz : float
        Sample rate of recordings and commands [Hz].
    input_kind, input_unit : str
        Quantity and unit of the commands.
    exciters : tuple of str
        Actuators in the order of the commands.
    initial : str
        State at the first sample, as the case states it; empty if not.
    """

    name: str
    title: str
    model: Mapping[str, str]
    files: Mapping[str, str] = field(default_factory=dict)
    uncertain: Mapping[str, float]
    rate_hz: float
    input_kind: str
    input_unit: str
    exciters: tuple[str, ...] = ()
    initial: str = "rest"


@dataclass(frozen=True, kw_only=True, eq=False)
class Blueprint(Nominal):
    """Kind of bench: assembly from log-factors, and content of its case.

    Parameters
    ----------
    build : callable
        Maps log-factors of `benign` (missing: zero) and shifts of places [m] by sensor name to a `Bench`.
    matrices : callable
        Maps log-factors to M, C and K in mesh coordinates.
    benign : tuple of Benign
        Parameters that vary from case to case without missing physics.
    substeps : int
        Integration steps per sample.
    seconds : float
        Duration of a recording [s].
    band_hz : (float, float)
        Band of the excitation [Hz].
    force : float
        Rms of the command at the middle level [N or N m].
    input_kind : str
        ``command`` passes converter, delay and filter of the laboratory; ``force`` and ``moment`` are held unchanged.
    place_sd : float
        Standard deviation of the sensor places [m].
    noise_db : (float, float) or None
        Range of the ratio of signal to noise [dB]; by default one of three levels is drawn.
    fits : int or None
        Number of fit recordings; by default three to five are drawn.
    command_step : float
        Step of the converter of the commands [N]; zero for none.
    per_period : int
        Samples per period of the highest excited frequency in the calibration.
    refit_hz : float
        Highest mode in the calibration [Hz], for benches in their modes.
    varied : callable or None
        Draws the statement and the step of the nominal model of one case; by default all cases have those given here.
    wrong, coloured, stray : float
        Shares of the cases with parameters about twice as far off as stated, with coloured noise, and with forces that
        are not recorded.
    coarse_step : float
        Step of a nominal model that is integrated semi-implicitly [s]; zero for an accurate one.
    """

    build: Callable[[Mapping[str, float], Mapping[str, float]], Bench]
    matrices: Callable[[Mapping[str, float]], tuple[Array, Array, Array]]
    benign: tuple[Benign, ...]
    substeps: int
    seconds: float
    band_hz: tuple[float, float]
    force: float
    place_sd: float = 0.0
    noise_db: tuple[float, float] | None = None
    fits: int | None = None
    command_step: float = 0.0
    per_period: int = 16
    refit_hz: float = float("inf")
    varied: Callable[["Blueprint", np.random.Generator], "Blueprint"] | None = None
    wrong: float = 0.0
    coloured: float = 0.0
    stray: float = 0.0
    coarse_step: float = 0.0
