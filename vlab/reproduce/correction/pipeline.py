"""Correction of a model by a simulated modal test, section 3.3.

The structure on the bench deviates from the model by benign variation of stiffnesses, joint masses and plates. The
test is noisy, as in a laboratory. The measured modes then correct the reduced model.

The default coordinates are the displacements at the sensors, the twelve joints of the grid. The set of the
dissertation (`GRID_SECTION_33`) replaces two joints by the rotations of the bearings. For such a rotation the test
adds a velocity sensor at the plate's centre, which the structure file lacks.

The set matters. With the joints alone the plates follow statically, and Guyan's reduction misses one of the three
lowest modes. The correction then has to invent it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlab.errors import BadExperiment, BadRecording, unknown_name
from vlab.fe import build_fe_model
from vlab.fe.correction import Correction, correct_sequentially
from vlab.fe.model import FeModel
from vlab.fe.reduction import Reduction, exact_reduction, guyan_reduction
from vlab.hardware import load_hardware
from vlab.lab.excitation import Multisine
from vlab.lab.experiment import Experiment, run_experiment
from vlab.modal.mac import mac, match_modes
from vlab.modal.modal_test import ModalTest, ModalTestResult, run_modal_test
from vlab.plants.base import named_sensors
from vlab.plants.modal import build_modal
from vlab.reproduce.correction.measured_shapes import measured_at, measured_coordinates
from vlab.signals import Array, ModalModel
from vlab.structure import load_structure
from vlab.structure.model import Structure

REDUCTIONS: dict[str, Callable[..., Reduction]] = {"guyan": guyan_reduction, "exact": exact_reduction}
"""REDUCTIONS: reductions by name; the dissertation uses Guyan's."""
MARGIN = (0.5, 1.08)
"""MARGIN [-]: ends of the test band over the first and the last frequency of the coordinates."""
PLANT_MODES = 20
"""PLANT_MODES [-]: modes of the structure on the bench, including the nearest out of band."""
RATE = 200.0
"""RATE [Hz]: sample rate, ten times the band."""
PEAK = 4.0
"""PEAK [-]: divisor from half the linear travel to the rms motion of the most mobile sensor, for peaks within the range."""
REPRODUCED = 1e-9
"""REPRODUCED [-]: relative error of frequencies and shapes of a correction, exact up to rounding."""
ROUNDINGS = 10.0
"""ROUNDINGS [-]: roundings amplified by the condition of the mass; that of the exact reduction reaches 1e7 on the grid."""
TRUTH = 2.0
"""TRUTH [-]: multiple of the band below which modes can pair with measured ones."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CorrectionTest:
    """Modal test, with the model before and after its correction.

    Parameters
    ----------
    fe, real : FeModel
        Model, and structure on the bench.
    test : ModalTestResult
        All results of the test.
    measured : ModalModel
        Used modes by frequency: real shapes of unit maximum at the coordinates of the reduced models.
    confidence : (p,) array
        Confidence of the used modes.
    reductions : dict of str to Reduction
        Model reduced to the measured coordinates, by method.
    reduction : str
        Method of the corrected model.
    steps : tuple of Correction
        Corrections with the first measured mode, the first two, and so on.
    fe_hz, true_hz : (p,) array
        Frequencies of the modes of `fe` and `real` nearest in shape to the measured ones [Hz]; NaN without partner.
    """

    fe: FeModel
    real: FeModel
    seed: int
    spread: float
    noise: float
    test: ModalTestResult
    measured: ModalModel
    confidence: Array
    reductions: dict[str, Reduction]
    reduction: str
    steps: tuple[Correction, ...]
    fe_hz: Array
    true_hz: Array

    @property
    def correction(self) -> Correction:
        """Correction to all measured modes."""
        return self.steps[-1]

    @property
    def model_hz(self) -> Array:
        """Frequencies of the replaced modes of the reduced model [Hz]."""
        return self.correction.uncorrected.freq[self.correction.origin]

    @property
    def mac_before(self) -> Array:
        """MAC of each measured shape with the replaced mode."""
        shapes = self.correction.uncorrected.eigen[1][:, self.correction.origin]
        return np.diag(mac(shapes, self.measured.shapes))

    @property
    def corrected(self) -> ModalModel:
        """Measured modes in the corrected model, in measured sign and scale."""
        model, wanted = self.correction.model, self.measured.shapes
        chosen = [int(np.argmax(row)) for row in (wanted.T @ model.M @ model.eigen[1]) ** 2]
        shapes = model.eigen[1][:, chosen]
        peak = np.abs(wanted).argmax(axis=0), np.arange(wanted.shape[1])
        return replace(
            self.measured,
            freq=model.freq[chosen],
            zeta=model.zeta[chosen],
            shapes=shapes * (wanted[peak] / shapes[peak]),
        )

    @property
    def error(self) -> float:
        """Largest relative error of the corrected modes."""
        found = self.corrected
        return float(
            max(np.abs(found.freq / self.measured.freq - 1).max(), np.abs(found.shapes - self.measured.shapes).max())
        )

    @property
    def accepted(self) -> float:
        """Accepted error: `REPRODUCED`, or more for an ill-conditioned mass."""
        mass = self.correction.model.M
        scale = np.sqrt(np.diag(mass))
        return max(REPRODUCED, ROUNDINGS * float(np.finfo(float).eps * np.linalg.cond(mass / np.outer(scale, scale))))

    @property
    def holds(self) -> bool:
        """Whether the corrected model has the measured modes."""
        return self.error <= self.accepted

    @property
    def before_use_hz(self) -> Array:
        """Frequency of each mode after correction of the lower ones [Hz].

        See section 3.3.
        """
        origin = self.correction.origin
        earlier = [self.correction.uncorrected.freq, *(step.tracked for step in self.steps[:-1])]
        return np.array([tracked[mode] for tracked, mode in zip(earlier, origin, strict=True)])

    def unused_error(self, used: int) -> float:
        """Return the rms relative error of the unused measured modes.

        The value is NaN if the first `used` modes are all.

        Parameters
        ----------
        used : int
            Number of used modes.

        Returns
        -------
        float
            Relative error [-].
        """
        if not 0 <= used <= len(self.steps):
            raise BadRecording(f"{used} modes used of {len(self.steps)} measured ones; 0 to {len(self.steps)} can be")
        tracked = self.steps[used - 1].tracked if used else self.correction.uncorrected.freq
        miss = (tracked[self.correction.origin] / self.measured.freq - 1)[used:]
        return float(np.sqrt(np.mean(miss**2))) if miss.size else float("nan")

    def off_diagonal(self, reduction: str) -> tuple[float, float]:
        """Return the largest and mean off-diagonal of orthogonality.

        These two numbers accompany Tables 4 and 6.

        Parameters
        ----------
        reduction : str
            Method of the reduced mass.

        Returns
        -------
        (float, float)
            Largest and mean absolute value.
        """
        if reduction not in self.reductions:
            raise unknown_name("reduction", reduction, self.reductions)
        phi, mass = self.measured.shapes, self.reductions[reduction].model.M
        product = phi.T @ mass @ phi
        size = np.sqrt(np.diag(product))
        values = np.abs(product / np.outer(size, size))[~np.eye(len(size), dtype=bool)]
        return (float(values.max()), float(values.mean())) if values.size else (0.0, 0.0)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        columns = {
            "model_hz": self.model_hz,
            "fe_hz": self.fe_hz,
            "true_hz": self.true_hz,
            "measured_hz": self.measured.freq,
            "before_use_hz": self.before_use_hz,
            "corrected_hz": self.corrected.freq,
            "mac_before": self.mac_before,
            "zeta": self.measured.zeta,
            "confidence": self.confidence,
        }
        last = self.correction
        sizes = {name: self.off_diagonal(name) for name in self.reductions}
        return {
            "structure": self.fe.structure.name,
            "variant": self.fe.variant,
            "seed": self.seed,
            "spread": self.spread,
            "noise": self.noise,
            "reduction": self.reduction,
            "coordinates": list(self.measured.coordinates),
            "modes": [
                {"mode": i + 1} | {name: float(values[i]) for name, values in columns.items()}
                for i in range(self.measured.freq.size)
            ],
            "unmeasured": [
                {"model_hz": float(last.uncorrected.freq[i]), "corrected_hz": float(last.tracked[i])}
                for i in last.others
            ],
            "orthogonality": {name: {"max": size[0], "mean": size[1]} for name, size in sizes.items()},
            "unused_rms_error": [self.unused_error(used) for used in range(len(self.steps))],
            "change": {"mass": last.mass_change, "stiffness": last.stiffness_change, "damping": last.damping_change},
            "identified_modes": int(self.test.poles.freq.size),
            "fit_residual": self.test.poles.residual,
            "reproduced_to": self.error,
        }


def vary_structure(structure: Structure, spread: float, seed: int) -> Structure:
    """Return the structure with benign variation.

    Lognormal factors have mean 1. They act on bending and torsional stiffness of every section, on every joint mass with
    its rotary inertia, and on every plate's weight moment. Bars of one section share a factor. So do masses on a bar
    carried by its first symmetric mode.

    Parameters
    ----------
    structure : Structure
        Structure.
    spread : float
        Relative standard deviation of the factors [-].
    seed : int
        Seed of the factors.

    Returns
    -------
    Structure
        Varied structure.
    """
    if not (np.isfinite(spread) and 0 <= spread <= 0.5):
        raise BadExperiment(f"the spread {spread} is no relative standard deviation from 0 to 0.5")
    rng = np.random.default_rng([_checked_seed(seed), 0])
    sigma = np.sqrt(np.log1p(spread**2))

    def vary(value: float) -> float:
        return value * float(np.exp(sigma * rng.standard_normal() - sigma**2 / 2))

    sections = {
        name: replace(
            section,
            bending_stiffness=vary(section.bending_stiffness),
            torsion_stiffness=vary(section.torsion_stiffness),
        )
        for name, section in structure.section.items()
    }
    single = {variant.one_mode_bar for variant in structure.variant.values()}
    alike = {point: bar.name for bar in structure.bar if bar.name in single for point in bar.points}
    drawn: dict[str, float] = {}
    masses = []
    for part in structure.mass:
        group = alike.get(part.at, f"mass {part.name}")
        factor = drawn[group] if group in drawn else drawn.setdefault(group, vary(1.0))
        masses.append(replace(part, mass=part.mass * factor, rotary_inertia=part.rotary_inertia * factor))
    plates = [replace(part, weight_moment=vary(part.weight_moment)) for part in structure.plate]
    return replace(structure, section=sections, mass=tuple(masses), plate=tuple(plates))


def correct_by_test(
    structure_name: str = "grid",
    *,
    seed: int,
    modes: int = 11,
    retained: Sequence[str] | None = None,
    spread: float = 0.05,
    noise: float = 0.03,
    reduction: str = "guyan",
    variant: str = "published",
    period_s: float = 100.0,
    periods: int = 3,
    progress: Callable[[float], None] | None = None,
) -> CorrectionTest:
    """Test a deviating structure, and correct the reduced model.

    Parameters
    ----------
    structure_name : str
        Built-in structure or structure file.
    seed : int
        Seed of variation, multisine phases and sensor noise.
    modes : int
        Most measured modes, the lowest reliable ones; fewer than coordinates.
    retained : sequence of str or None
        Coordinates of the reduced model: displacements at sensors (``"v:joint1"``) and rotations of bearings
        (``"rx:point13"``), each by the probe on the plate below. None for those of the structure file.
    spread : float
        Relative standard deviation of the structure's variation [-].
    noise : float
        White noise of each sensor over the mean rms velocity of the model [-].
    reduction : str
        Corrected reduced model: ``"guyan"`` or ``"exact"``.
    variant : str
        Variant of the model.
    period_s, periods : float and int
        Period of the multisine [s] and number of periods, half of them for settling. Modes nearer than 1/period_s are
        hardly resolved.
    progress : callable or None
        Receives the simulated time [s].

    Returns
    -------
    CorrectionTest
        Test and correction.

    Raises
    ------
    UnknownName
        The structure, variant, reduction or coordinate is unknown.
    BadStructure
        A sensor has no coordinate in the FE model, or the coordinates cannot carry the modes.
    BadExperiment
        A setting is out of range.
    BadRecording
        No mode was identified reliably.
    """
    if reduction not in REDUCTIONS:
        raise unknown_name("reduction", str(reduction), REDUCTIONS)
    structure = load_structure(structure_name)
    fe = build_fe_model(structure, variant)
    keep = measured_coordinates(fe, retained)
    _check_settings(modes, len(keep), noise, periods)
    real = build_fe_model(vary_structure(structure, spread, seed), variant)
    reductions = {name: reduce(fe.linear, keep) for name, reduce in REDUCTIONS.items()}
    band = (MARGIN[0] * float(fe.linear.freq[0]), MARGIN[1] * float(fe.linear.freq[len(keep) - 1]))
    test = _tested(fe, real, band, seed, noise, period_s, periods, progress)
    measured, confidence = measured_at(structure, test, keep, modes)
    return CorrectionTest(
        fe=fe,
        real=real,
        seed=int(seed),
        spread=float(spread),
        noise=float(noise),
        test=test,
        measured=measured,
        confidence=confidence,
        reductions=reductions,
        reduction=reduction,
        steps=tuple(correct_sequentially(reductions[reduction].model, measured)),
        fe_hz=_partners(fe, measured, band[1]),
        true_hz=_partners(real, measured, band[1]),
    )


def _check_settings(modes: int, n_coordinates: int, noise: float, periods: int) -> None:
    if isinstance(modes, bool) or not isinstance(modes, int | np.integer) or not 1 <= modes < n_coordinates:
        raise BadExperiment(
            f"{modes} modes for {n_coordinates} measured coordinates; accepted: 1 to {n_coordinates - 1}, so that something of the "
            "model is left"
        )
    if not (np.isfinite(noise) and 0 <= noise <= 1):
        raise BadExperiment(f"the noise {noise} is no share of the rms from 0 to 1")
    if isinstance(periods, bool) or not isinstance(periods, int | np.integer) or periods < 2:
        raise BadExperiment(f"{periods} periods are too few; at least 2 are needed, the first one to settle")


def _checked_seed(seed: int) -> int:
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise BadExperiment(f"the seed {seed} is no whole number from 0")
    return int(seed)


def _tested(
    fe: FeModel,
    real: FeModel,
    band: tuple[float, float],
    seed: int,
    noise: float,
    period_s: float,
    periods: int,
    progress: Callable[[float], None] | None,
) -> ModalTestResult:
    """Excite the structure, with level and noise from the model."""
    structure = fe.structure
    phases, samples = (int(number) for number in np.random.default_rng([seed, 1]).integers(2**32, size=2))
    hardware = load_hardware().at_rate(RATE)
    unit = Multisine(level=1.0, low_hz=band[0], high_hz=band[1], period_s=period_s, seed=phases)
    velocity, displacement = _rms(fe, [sensor.at for sensor in structure.sensor], band, period_s)
    level = hardware.velocity_sensor.linear_range / 2 / PEAK / float(displacement.max())
    sensors = replace(hardware.velocity_sensor, noise=noise * level * float(velocity.mean()))
    probe = hardware.displacement_probe
    if structure.probe:
        swing = _rms(fe, [probe.at for probe in structure.probe], band, period_s)[1]
        probe = replace(probe, noise=noise * level * float(swing.mean()))
    experiment = Experiment(
        plant=build_modal(real, modes=min(PLANT_MODES, real.linear.n)),
        seconds=period_s * periods,
        excitation=replace(unit, level=level),
        excite=structure.exciter,
        hardware=replace(hardware, velocity_sensor=sensors, displacement_probe=probe),
        seed=samples,
    )
    recording = run_experiment(experiment, progress=progress).recording
    names = tuple(name for name, _ in named_sensors(structure))
    return run_modal_test([recording], ModalTest(outputs=names, band_hz=band))


def _rms(fe: FeModel, places: list[str], band: tuple[float, float], period_s: float) -> tuple[Array, Array]:
    """Return predicted rms velocity and displacement per unit rms force."""
    freq = np.arange(np.ceil(band[0] * period_s), np.floor(band[1] * period_s) + 1) / period_s
    rows = fe.deflections(places)
    force = fe.deflections([next(coil.at for coil in fe.structure.coil if coil.name == fe.structure.exciter)]).T
    velocity = np.abs(fe.linear.frequency_response(freq, force, rows).H[:, :, 0])
    displacement = velocity / (2 * np.pi * freq[:, None])
    return np.sqrt(np.mean(velocity**2, axis=0)), np.sqrt(np.mean(displacement**2, axis=0))


def _partners(fe: FeModel, measured: ModalModel, highest: float) -> Array:
    """Return frequencies of the most similar modes, one to one."""
    rows = np.array([fe.linear.coordinates.index(label) for label in measured.coordinates])
    near = max(int(np.sum(fe.linear.freq <= TRUTH * highest)), 1)
    candidates = fe.linear.modal_model(np.eye(fe.linear.n)[rows], measured.coordinates, near)
    pairs = match_modes(measured, candidates)
    out = np.full(measured.freq.size, np.nan)
    out[pairs.a] = candidates.freq[pairs.b]
    return out
