"""Flexible structures that vlab meshes, with a mesh error of known size."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.model_kinds.model_kind import CalibratedModel, ModalUncertainty, ModelKind, WrittenModel
from vlab.diagnose.model_kinds.structure_file import structure_toml
from vlab.diagnose.parameters.locations import reported_name
from vlab.diagnose.parameters.mesh_correction import with_modes_of_fe, with_soft_cables
from vlab.diagnose.parameters.mjcf import Uncertain
from vlab.diagnose.parameters.mode_selection import KeptModes
from vlab.diagnose.parameters.recorded_runs import RecordedRuns
from vlab.diagnose.parameters.reduced_model import ModalDamping, Part, ReducedModel
from vlab.diagnose.parameters.structure import adjusted_structure, edited, structure_parameters
from vlab.diagnose.parameters.structure_sensitivity import (
    carried,
    coil_shifts,
    common_scale_of_structure,
    damping_of_structure,
    frequencies_of_reduced_model,
    structure_parts,
    structure_shifts,
)
from vlab.diagnose.settings import MESHED_STRUCTURE, PROBLEM, SELECTION, VERDICT
from vlab.fe import build_fe_model
from vlab.fe.damping import SILENT, driven_modes
from vlab.fe.model import FeModel
from vlab.physics.attach import Attached
from vlab.physics.effect import Effect
from vlab.plants.base import Plant
from vlab.plants.fe_modes import measured_modes_of
from vlab.signals import Array
from vlab.structure.model import Structure

STRUCTURE = "amended-structure.toml"
"""Name of the written file."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshedStructure(ModelKind):
    """Beam or grid from a structure file.

    Parameters
    ----------
    structure : Structure
        Nominal structure.
    variant : str
        Variant of the model.
    """

    structure: Structure
    variant: str

    has_mesh_error = True
    stays_linear = True
    has_open_conventions = False
    has_stated_time_step = False
    has_doubtful_nonlinearity = True
    has_mjcf_file = False
    holds_actuator_gains = False

    @property
    def own_error(self) -> float:
        """See `ModelKind`."""
        return PROBLEM.model_error

    @property
    def correlated_error(self) -> float:
        """See `ModelKind`; the mesh errs alike in all samples."""
        return self.own_error

    @property
    def holdout_error(self) -> float:
        """See `ModelKind`."""
        return PROBLEM.mesh_own_error

    def predicted_band(self, highest_hz: float) -> float:
        """See `ModelKind`; no fitted recording tells of the modes above."""
        return MESHED_STRUCTURE.band * highest_hz

    def is_mismatch(self, error: float, noise: float) -> bool:
        """See `ModelKind`."""
        return bool(error > np.hypot(VERDICT.above_noise * noise, self.holdout_error))

    def explained_residual(self, noise_share: float, error_share: float) -> float:
        """See `ModelKind`; a share of the mesh error may remain."""
        return float(np.sqrt(noise_share + SELECTION.enough_of_mesh * error_share))

    def with_corrected_mesh(self, case: Case) -> Case:
        """See `ModelKind`."""
        return with_modes_of_fe(case, self.structure)

    def with_soft_cables(self, case: Case) -> Case | None:
        """See `ModelKind`."""
        return with_soft_cables(case, self.structure)

    def with_coupled_modes(self, plant: Plant, modes: KeptModes) -> KeptModes:
        """See `ModelKind`; the silent modes that move the structure's points, as of arms in opposition."""
        if not self.structure.has_modes_of_fe:
            return modes  # no deviating arm couples them
        points = plant.points_of(self.structure)
        motion = np.abs(plant.port_rows(points) @ modes.shapes).max(axis=0)
        most = motion[modes.kept].max(initial=0.0)
        below = np.abs(modes.omega) <= np.abs(modes.omega[modes.kept]).max(initial=0.0)
        return replace(modes, kept=modes.kept | (below & (motion > SILENT * most)))

    def uncertainty_about_rest(self, case: Case, recorded: RecordedRuns, modes: KeptModes) -> ModalUncertainty:
        """See `ModelKind`; the frequencies of modes in the recorded band are parameters."""
        plant, kept = case.plant, modes.kept
        among = np.cumsum(kept) - 1
        tuned = [int(among[j]) if kept[j] else -1 for j in self._driven(plant, modes)]
        # above the band only compliance is identifiable: a free frequency there would absorb that of truncated modes
        in_band = modes.omega[kept] <= 2 * np.pi * MESHED_STRUCTURE.band * recorded.highest_hz
        last = max((k + 1 for k, j in enumerate(tuned) if j >= 0 and in_band[j]), default=0)
        given, sensors = case.table.model.uncertain, [channel.sensor for channel in recorded.channels]
        parameters = structure_parameters(self.structure, given, recorded.names, recorded.driven, last, sensors)
        fe = build_fe_model(self.structure, self.variant)
        carry = self._carried(plant, fe, modes.omega[kept], modes.basis)
        return ModalUncertainty(
            parameters=tuple(parameters),
            parts=structure_parts(fe, carry, parameters, modes.omega[kept], tuned),
            shifts=structure_shifts(fe, carry, parameters),
            coil_shifts=coil_shifts(fe, carry, parameters),
        )

    def damping_about_rest(
        self, plant: Plant, modes: KeptModes, reduced_model: ReducedModel, parameters: Sequence[Uncertain]
    ) -> ModalDamping:
        """See `ModelKind`."""
        places = [i for i, j in enumerate(self._driven(plant, modes)) if modes.kept[j]]
        at_coils = plant.port_rows(self.structure.coil_places) @ modes.basis
        return damping_of_structure(self.structure, parameters, reduced_model.M, reduced_model.K, at_coils, places)

    def parameters_of_responses(
        self, plant: Plant, given: Mapping[str, float], channels: Sequence[str], actuators: Sequence[int]
    ) -> Sequence[Uncertain]:
        """See `ModelKind`."""
        return structure_parameters(self.structure, given, channels, actuators)

    def parts_of_responses(
        self, plant: Plant, parameters: Sequence[Uncertain], omega: Array, shapes: Array
    ) -> tuple[Part, ...]:
        """See `ModelKind`."""
        fe = build_fe_model(self.structure, self.variant)
        return structure_parts(fe, self._carried(plant, fe, omega, shapes), parameters, omega)

    def damping_of_responses(
        self, plant: Plant, parameters: Sequence[Uncertain], shapes: Array, M: Array, K: Array
    ) -> ModalDamping:
        """See `ModelKind`."""
        at_coils = plant.port_rows(self.structure.coil_places) @ shapes
        places = range(len(driven_modes(at_coils)))
        ordered = damping_of_structure(self.structure, parameters, M, K, at_coils, places)
        return replace(ordered, follows_shapes=True)  # a change of the order must be smooth

    def common_scale(self, plant: Plant, parameters: Sequence[Uncertain], *, loaded: bool) -> Array | None:
        """See `ModelKind`."""
        return common_scale_of_structure(self.structure, self.variant, parameters, loaded=loaded)

    def adjusted(self, plant: Plant, parameters: Sequence[Uncertain], theta: Array) -> Plant:
        """See `ModelKind`; the plant is rebuilt."""
        return adjusted_structure(self.structure, plant, self.variant, parameters, theta)

    def for_plant(
        self, reduced_model: ReducedModel, plant: Plant, parameters: Sequence[Uncertain], theta: Array
    ) -> Array:
        """See `ModelKind`."""
        if not any(p.kind == "frequency" for p in parameters):
            return theta
        rebuilt = self.adjusted(plant, parameters, theta)
        of = (self.structure, self.variant)
        return frequencies_of_reduced_model(reduced_model, rebuilt, of, parameters, theta)

    def reported_place(self, name: str, effect: Effect, driven: int) -> str:
        """See `ModelKind`; the name is that of the hardware."""
        return reported_name(name, effect, driven)

    def write(self, model: CalibratedModel, effects: Sequence[Attached], folder: Path) -> WrittenModel:
        """See `ModelKind`; no effect has an element in the file."""
        content = structure_toml(edited(self.structure, model.parameters, model.theta))
        (folder / STRUCTURE).write_text(content, encoding="utf-8")
        entries, hardware = {"structure": STRUCTURE}, model.case.table.model.hardware
        if hardware:
            shutil.copyfile(model.case.folder / hardware, folder / Path(hardware).name)
            entries["hardware"] = Path(hardware).name
        return WrittenModel(file=STRUCTURE, entries=entries, beside=tuple(effects))

    def _driven(self, plant: Plant, modes: KeptModes) -> Array:
        """Return the indices of the modes that a test of the structure measures."""
        return measured_modes_of(plant, self.structure, self.variant, modes.omega, modes.shapes)

    def _carried(self, plant: Plant, fe: FeModel, omega: Array, shapes: Array) -> Array:
        """Return FE coordinates per modal coordinate of the plant."""
        points = plant.points_of(self.structure)
        return carried(fe, plant.port_rows(points) @ shapes, omega, points)
