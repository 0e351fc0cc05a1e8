"""Models from MJCF files of a user."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.model_kinds.model_kind import CalibratedModel, ModalUncertainty, ModelKind, WrittenModel
from vlab.diagnose.parameters.geometry import geometry_about_rest, parts_about_rest
from vlab.diagnose.parameters.mjcf import Uncertain, adjusted, common_scale, uncertain_parameters
from vlab.diagnose.parameters.mjcf_sensitivity import parts_of
from vlab.diagnose.parameters.mode_selection import KeptModes
from vlab.diagnose.parameters.recorded_runs import RecordedRuns
from vlab.diagnose.parameters.reduced_model import Part, ReducedModel
from vlab.diagnose.settings import PROBLEM, SELECTION, VERDICT
from vlab.physics.attach import Attached, written
from vlab.physics.effect import Effect
from vlab.plants.base import Plant
from vlab.signals import Array

MODEL = "amended.xml"
"""Name of the written file."""


class MjcfModel(ModelKind):
    """Model from an MJCF file, exact but for its integration."""

    has_mesh_error = False
    stays_linear = False
    has_open_conventions = True
    has_stated_time_step = True
    has_doubtful_nonlinearity = False
    has_mjcf_file = True
    holds_actuator_gains = True

    @property
    def own_error(self) -> float:
        """See `ModelKind`."""
        return PROBLEM.integration_error

    @property
    def correlated_error(self) -> float:
        """See `ModelKind`."""
        return 0.0

    @property
    def holdout_error(self) -> float:
        """See `ModelKind`."""
        return PROBLEM.model_error

    def is_mismatch(self, error: float, noise: float) -> bool:
        """See `ModelKind`."""
        return error > max(VERDICT.above_noise * noise, VERDICT.least_misfit)

    def explained_residual(self, noise_share: float, error_share: float) -> float:
        """See `ModelKind`; the noise is the floor."""
        return SELECTION.explains * float(np.sqrt(noise_share))

    def with_corrected_mesh(self, case: Case) -> Case:
        """See `ModelKind`; without a mesh the case is unchanged."""
        return case

    def with_soft_cables(self, case: Case) -> Case | None:
        """See `ModelKind`."""
        return None

    def uncertainty_about_rest(self, case: Case, recorded: RecordedRuns, modes: KeptModes) -> ModalUncertainty:
        """See `ModelKind`."""
        given = case.table.model.uncertain
        parameters = [
            *uncertain_parameters(case.plant, given, recorded.names, recorded.driven),
            *geometry_about_rest(case.plant, given, modes.basis),
        ]
        return ModalUncertainty(
            parameters=tuple(parameters), parts=parts_about_rest(case.plant, parameters, modes.basis)
        )

    def damping_about_rest(
        self, plant: Plant, modes: KeptModes, reduced_model: ReducedModel, parameters: Sequence[Uncertain]
    ) -> None:
        """See `ModelKind`; dampers have a matrix."""

    def parameters_of_responses(
        self, plant: Plant, given: Mapping[str, float], channels: Sequence[str], actuators: Sequence[int]
    ) -> Sequence[Uncertain]:
        """See `ModelKind`."""
        return uncertain_parameters(plant, given, channels, actuators)

    def parts_of_responses(
        self, plant: Plant, parameters: Sequence[Uncertain], omega: Array, shapes: Array
    ) -> tuple[Part, ...]:
        """See `ModelKind`."""
        return parts_of(plant, parameters, shapes)

    def damping_of_responses(
        self, plant: Plant, parameters: Sequence[Uncertain], shapes: Array, M: Array, K: Array
    ) -> None:
        """See `ModelKind`; dampers have a matrix."""

    def common_scale(self, plant: Plant, parameters: Sequence[Uncertain], *, loaded: bool) -> Array | None:
        """See `ModelKind`."""
        return common_scale(plant, parameters, loaded=loaded)

    def adjusted(self, plant: Plant, parameters: Sequence[Uncertain], theta: Array) -> Plant:
        """See `ModelKind`."""
        return adjusted(plant, parameters, theta)

    def for_plant(
        self, reduced_model: ReducedModel, plant: Plant, parameters: Sequence[Uncertain], theta: Array
    ) -> Array:
        """See `ModelKind`; no parameter is a frequency."""
        return theta

    def reported_place(self, name: str, effect: Effect, driven: int) -> str:
        """See `ModelKind`."""
        return name

    def write(self, model: CalibratedModel, effects: Sequence[Attached], folder: Path) -> WrittenModel:
        """See `ModelKind`; files that the model names are copied."""
        spec, beside = written(model.plant, effects)
        (folder / MODEL).write_text(spec.to_xml(), encoding="utf-8")
        _copy_assets(spec, (model.case.folder / model.case.table.model.mjcf).parent, folder)
        return WrittenModel(file=MODEL, entries={"mjcf": MODEL}, beside=tuple(beside))


def _copy_assets(spec: Any, source: Path, folder: Path) -> None:
    """Copy the meshes, height fields, skins and textures of a model."""
    for kind, directory in (
        ("meshes", spec.meshdir),
        ("hfields", spec.meshdir),
        ("skins", spec.meshdir),
        ("textures", spec.texturedir),
    ):
        for element in getattr(spec, kind):
            names = [element.file, *getattr(element, "cubefiles", ())]
            for name in (Path(directory) / n for n in names if n):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                in_memory = spec.assets.get(str(name), spec.assets.get(name.name))
                if in_memory is None:
                    shutil.copyfile(source / name, folder / name)
                else:
                    (folder / name).write_bytes(in_memory)
