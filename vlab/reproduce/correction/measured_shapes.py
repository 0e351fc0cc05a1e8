"""Measured modes at the coordinates of a reduced model.

Sensors at joints measure displacements, probes on plates rotations.
"""

from collections.abc import Sequence

import numpy as np

from vlab.errors import BadExperiment, BadRecording, unknown_name
from vlab.fe.model import FeModel
from vlab.modal.modal_test import ModalTestResult
from vlab.signals import Array, ModalModel
from vlab.structure.model import Structure

RELIABLE = 0.9
"""RELIABLE [-]: least confidence of a used mode, found again at nearly every model order."""


def measured_coordinates(fe: FeModel, retained: Sequence[str] | None = None) -> list[str]:
    """Return the coordinates of the measurement.

    Parameters
    ----------
    fe : FeModel
        FE model.
    retained : sequence of str or None
        Coordinates; those retained by the structure file by default.

    Returns
    -------
    list of str
        Names of the coordinates.

    Raises
    ------
    UnknownName
        No sensor and no probe measures a coordinate.
    BadExperiment
        Fewer than two coordinates.
    """
    structure = fe.structure
    seen = [f"v:{sensor.at}" for sensor in structure.sensor]
    seen += [f"rx:{plate.at}" for plate in structure.plate if any(p.at == plate.name for p in structure.probe)]
    measurable = [label for label in seen if label in fe.linear.coordinates]
    if retained is None:
        retained = structure.reduction.retained if structure.reduction is not None else measurable
    keep = [retained] if isinstance(retained, str) else list(retained)
    for label in keep:
        if label not in measurable:
            raise unknown_name("measured coordinate", str(label), measurable)
    if len(keep) < 2:
        raise BadExperiment(f"{len(keep)} measured coordinates show no shapes; at least 2 are needed")
    return keep


def measured_at(
    structure: Structure, test: ModalTestResult, coordinates: Sequence[str], modes: int
) -> tuple[ModalModel, Array]:
    """Return reliable modes at some coordinates, with their confidence.

    Parameters
    ----------
    structure : Structure
        Structure.
    test : ModalTestResult
        Result of the modal test.
    coordinates : sequence of str
        Displacements at sensors (``"v:joint1"``) and rotations of bearings (``"rx:point13"``).
    modes : int
        Most modes, the lowest first.

    Returns
    -------
    (ModalModel, array)
        Modes with unit maximum, and confidence.

    Raises
    ------
    BadRecording
        No mode was identified reliably.
    """
    every = test.poles.to_modal_model()
    used = np.flatnonzero(test.poles.confidence >= RELIABLE)[:modes]
    if used.size == 0:
        raise BadRecording(
            f"none of {every.freq.size} identified modes is reliable; lengthen the period or lower the noise"
        )
    seen = [_seen_by(structure, label) for label in coordinates]
    rows = [every.coordinates.index(channel) for channel, _ in seen]
    shapes = every.shapes[rows][:, used] / np.array([[arm] for _, arm in seen])
    measured = ModalModel(
        freq=every.freq[used],
        zeta=every.zeta[used],
        shapes=shapes / shapes[np.abs(shapes).argmax(axis=0), np.arange(used.size)],
        coordinates=tuple(coordinates),
    )
    return measured, test.poles.confidence[used]


def _seen_by(structure: Structure, label: str) -> tuple[str, float]:
    """Return the channel of a coordinate and its motion per unit.

    A probe measures a plate below its axis.
    """
    motion, _, place = label.partition(":")
    if motion == "rx":
        plate = next(plate for plate in structure.plate if plate.at == place)
        return next(f"probe:{probe.name}" for probe in structure.probe if probe.at == plate.name), plate.offset
    return next(f"sensor:{sensor.name}" for sensor in structure.sensor if sensor.at == place), 1.0
