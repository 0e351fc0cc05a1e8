"""Interface of the kinds of nominal models.

A kind states the errors of its models, their uncertain parameters, and their files. Its names are the reasons for which
diagnoses of different models differ.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from vlab.cases.case import Case
from vlab.diagnose.parameters.mjcf import Uncertain
from vlab.diagnose.parameters.mode_selection import KeptModes
from vlab.diagnose.parameters.recorded_runs import RecordedRuns
from vlab.diagnose.parameters.reduced_model import CoilShift, ModalDamping, Part, ReducedModel, Shift
from vlab.physics.attach import Attached
from vlab.physics.effect import Effect
from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalUncertainty:
    """Uncertain parameters of a model and their parts in the dynamic modes.

    Parameters
    ----------
    parameters : tuple of Uncertain
        Uncertain parameters.
    parts : tuple of Part
        Matrix parts under the parameters.
    shifts : tuple of Shift
        Additional rows of shifted sensors.
    coil_shifts : tuple of CoilShift
        Additional modal forces of shifted coils.
    """

    parameters: tuple[Uncertain, ...]
    parts: tuple[Part, ...]
    shifts: tuple[Shift, ...] = ()
    coil_shifts: tuple[CoilShift, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibratedModel:
    """Calibrated model of a case.

    Parameters
    ----------
    case : Case
        Case of the nominal model.
    plant : Plant
        Calibrated plant.
    parameters : tuple of Uncertain
        Uncertain parameters.
    theta : (n_parameters,) array
        Log factors for a rebuilt plant.
    """

    case: Case
    plant: Plant
    parameters: tuple[Uncertain, ...]
    theta: Array


@dataclass(frozen=True, kw_only=True)
class WrittenModel:
    """Written file of an extended model.

    Parameters
    ----------
    file : str
        Name in the output folder.
    entries : mapping of str to str
        Entries of ``[model]`` in the case.
    beside : tuple of Attached
        Effects that the file cannot hold.
    """

    file: str
    entries: Mapping[str, str]
    beside: tuple[Attached, ...]


class ModelKind(ABC):
    """Kind of a nominal model."""

    has_mesh_error: ClassVar[bool]
    """Whether mesh error biases the parameters and resembles linear elements."""
    stays_linear: ClassVar[bool]
    """Whether the model deflects little and stays time-invariant."""
    has_open_conventions: ClassVar[bool]
    """Whether the sampling convention of the recordings may be unknown."""
    has_stated_time_step: ClassVar[bool]
    """Whether the author of the model chose the time step, which may be too long."""
    has_doubtful_nonlinearity: ClassVar[bool]
    """Whether the model's own nonlinearity counts only if the recordings show it."""
    has_mjcf_file: ClassVar[bool]
    """Whether the model is an MJCF file, which MuJoCo reads."""
    holds_actuator_gains: ClassVar[bool]
    """Whether the model file holds calibrated gains of actuators."""

    # ---- errors -----------------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def own_error(self) -> float:
        """Least relative residual of a complete model on fitted recordings."""

    @property
    @abstractmethod
    def correlated_error(self) -> float:
        """Relative model error that is correlated over samples."""

    @property
    @abstractmethod
    def holdout_error(self) -> float:
        """Relative residual that a complete model may leave on hold-out recordings."""

    def predicted_band(self, highest_hz: float) -> float:
        """Return the highest frequency that the fitted model predicts [Hz].

        Parameters
        ----------
        highest_hz : float
            Frequency below which nearly all power of the fitted recordings lies [Hz].
        """
        return float("inf")

    @abstractmethod
    def is_mismatch(self, error: float, noise: float) -> bool:
        """Return whether an error on recordings exceeds noise and model error.

        Parameters
        ----------
        error : float
            Error over the recordings' rms.
        noise : float
            Noise over the recordings' rms.

        Returns
        -------
        bool
            Whether the model misses something.
        """

    @abstractmethod
    def explained_residual(self, noise_share: float, error_share: float) -> float:
        """Return the normalised residual of a full explanation.

        Parameters
        ----------
        noise_share : float
            Share of the noise in the variance of the weights.
        error_share : float
            Share of the model's own error in the variance of the weights.

        Returns
        -------
        float
            Residual up to which no further effect is searched.
        """

    # ---- preparation of a case --------------------------------------------------------------------------------------

    @abstractmethod
    def with_corrected_mesh(self, case: Case) -> Case:
        """Return a case whose plant has the frequencies of a fine mesh."""

    @abstractmethod
    def with_soft_cables(self, case: Case) -> Case | None:
        """Return a case without stretch stiffening, or None without such cables."""

    # ---- uncertain parameters ---------------------------------------------------------------------------------------

    def with_coupled_modes(self, plant: Plant, modes: KeptModes) -> KeptModes:
        """Return the dynamic modes with those that uncertain parameters couple to them.

        Parameters
        ----------
        plant : Plant
            Nominal plant.
        modes : KeptModes
            Observable modes.
        """
        return modes

    @abstractmethod
    def uncertainty_about_rest(self, case: Case, recorded: RecordedRuns, modes: KeptModes) -> ModalUncertainty:
        """Return the uncertain parameters of recordings near rest.

        Parameters
        ----------
        case : Case
            Case.
        recorded : RecordedRuns
            Fit recordings.
        modes : KeptModes
            Modes of the plant.

        Returns
        -------
        ModalUncertainty
            Parameters and their parts.
        """

    @abstractmethod
    def damping_about_rest(
        self, plant: Plant, modes: KeptModes, reduced_model: ReducedModel, parameters: Sequence[Uncertain]
    ) -> ModalDamping | None:
        """Return the damping by ratios of the kept modes.

        Parameters
        ----------
        plant : Plant
            Nominal plant.
        modes : KeptModes
            Modes of the plant.
        reduced_model : ReducedModel
            Reduced model without this damping.
        parameters : sequence of Uncertain
            Uncertain parameters.

        Returns
        -------
        ModalDamping or None
            Damping; None where a matrix states the damping.
        """

    @abstractmethod
    def parameters_of_responses(
        self, plant: Plant, given: Mapping[str, float], channels: Sequence[str], actuators: Sequence[int]
    ) -> Sequence[Uncertain]:
        """Return the uncertain parameters of frequency data.

        Parameters
        ----------
        plant : Plant
            Nominal plant.
        given : mapping
            ``[model.uncertain]`` of the case.
        channels : sequence of str
            Names of the outputs.
        actuators : sequence of int
            Driven actuators.

        Returns
        -------
        sequence of Uncertain
            Parameters.
        """

    @abstractmethod
    def parts_of_responses(
        self, plant: Plant, parameters: Sequence[Uncertain], omega: Array, shapes: Array
    ) -> tuple[Part, ...]:
        """Return the modal matrix parts under the parameters of frequency data.

        Parameters
        ----------
        plant : Plant
            Nominal plant.
        parameters : sequence of Uncertain
            Uncertain parameters.
        omega : (m,) array
            Natural frequencies [rad/s].
        shapes : (nv, m) array
            Mode shapes.

        Returns
        -------
        tuple of Part
            Parts of M, C and K.
        """

    @abstractmethod
    def damping_of_responses(
        self, plant: Plant, parameters: Sequence[Uncertain], shapes: Array, M: Array, K: Array
    ) -> ModalDamping | None:
        """Return the damping by ratios, smooth in the parameters.

        Parameters
        ----------
        plant : Plant
            Nominal plant.
        parameters : sequence of Uncertain
            Uncertain parameters.
        shapes : (nv, m) array
            Mode shapes.
        M, K : (m, m) array
            Nominal modal matrices.

        Returns
        -------
        ModalDamping or None
            Damping; None where a matrix states the damping.
        """

    @abstractmethod
    def common_scale(self, plant: Plant, parameters: Sequence[Uncertain], *, loaded: bool) -> Array | None:
        """Return log factors that scale all impedances and gains.

        Parameters
        ----------
        plant : Plant
            Nominal plant.
        parameters : sequence of Uncertain
            Uncertain parameters.
        loaded : bool
            Whether measured forces act.

        Returns
        -------
        (n_parameters,) array or None
            Log factors; None where measured forces or certain parameters fix the scale.
        """

    @abstractmethod
    def adjusted(self, plant: Plant, parameters: Sequence[Uncertain], theta: Array) -> Plant:
        """Return the plant at given log factors.

        Parameters
        ----------
        plant : Plant
            Nominal plant.
        parameters : sequence of Uncertain
            Uncertain parameters.
        theta : (n_parameters,) array
            Log factors for a rebuilt plant.

        Returns
        -------
        Plant
            Adjusted plant with the same effects.
        """

    @abstractmethod
    def for_plant(
        self, reduced_model: ReducedModel, plant: Plant, parameters: Sequence[Uncertain], theta: Array
    ) -> Array:
        """Return log factors that give a rebuilt plant the reduced model's frequencies.

        Parameters
        ----------
        reduced_model : ReducedModel
            Reduced model in nominal modal coordinates.
        plant : Plant
            Nominal plant.
        parameters : sequence of Uncertain
            Uncertain parameters.
        theta : (n_parameters,) array
            Log factors of the reduced model.

        Returns
        -------
        (n_parameters,) array
            Log factors for a rebuilt plant.
        """

    # ---- report and files -------------------------------------------------------------------------------------------

    @abstractmethod
    def reported_place(self, name: str, effect: Effect, driven: int) -> str:
        """Return the reported name of a location.

        Parameters
        ----------
        name : str
            Name of the location.
        effect : Effect
            Effect there.
        driven : int
            Number of driven actuators.

        Returns
        -------
        str
            Name in the report.
        """

    @abstractmethod
    def write(self, model: CalibratedModel, effects: Sequence[Attached], folder: Path) -> WrittenModel:
        """Write the file of an extended model.

        Parameters
        ----------
        model : CalibratedModel
            Calibrated model.
        effects : sequence of Attached
            Effects of the findings.
        folder : Path
            Output folder.

        Returns
        -------
        WrittenModel
            File with its entries in the case.

        Raises
        ------
        OSError
            A file cannot be written.
        """
