"""Rerun files: atomic output, arranged views, colours of the figures."""

import hashlib
import os
import uuid
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from vlab.errors import OutputRefused
from vlab.files.leftovers import part_beside
from vlab.signals import Array, Recording
from vlab.views.figures import COLOURS, ROLES


def _bytes(colour: str) -> tuple[int, ...]:
    return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))


APPLICATION = "vlab"
BLUE, ORANGE, GREEN, PURPLE = map(_bytes, COLOURS[:4])
GREY, LIGHT = (130, 130, 130), (225, 225, 225)
PAPER = (255, 255, 255)
"""PAPER: background of every plot; a black curve is invisible on the dark one of the viewer."""
TOWARDS_EYE = np.array([0.72, -0.66, 0.16])
EYE_DISTANCE = 1.13
"""EYE_DISTANCE [-]: distance of the default eye in extents of the scene."""
FIELD_OF_VIEW = np.radians(55.0)
"""FIELD_OF_VIEW [rad]: vertical angle of the viewer."""
WIDTH_TO_HEIGHT = 0.5
"""WIDTH_TO_HEIGHT [-]: aspect of the moving picture in a common window, see `arranged`."""


@contextmanager
def rrd_file(path: Path | str, name: str, layout: Any, identity: Any) -> Iterator[Any]:
    """Yield a recording stream whose file appears only when complete.

    Parameters
    ----------
    path : Path or str
        Output file.
    name : str
        Name of the recording.
    layout : object
        Blueprint of the views.
    identity : object
        Identity of the content.

    Yields
    ------
    object
        Rerun stream.
    """
    path = Path(path)
    try:
        with part_beside(path) as part:  # detect an unwritable folder before Rerun warns
            # Equal content has equal identity, without the wall clock; a viewer does not merge different runs.
            stream = rr.RecordingStream(APPLICATION, recording_id=identity, send_properties=False)
            try:
                _save(stream, part, layout)
                stream.send_recording_name(name)
                yield stream
            finally:
                stream.disconnect()
            _check_whole(part)
            os.replace(part, path)
    except OSError as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise OutputRefused(f"{path} cannot be written: {reason}; check the folder and its free space") from error


def _save(stream: Any, part: Path, layout: Any) -> None:
    try:
        stream.save(part, default_blueprint=layout)
    except RuntimeError as error:  # error of Rerun for an unwritable file
        raise OSError(str(error)) from error


def _check_whole(part: Path) -> None:
    """Refuse a file without its end."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            RrdReader(part).recordings()
    except (RuntimeError, Warning) as error:
        raise OSError("the file came out incomplete") from error


def identity_of(*recordings: Recording) -> uuid.UUID:
    """Return an identity derived from the content of recordings.

    Parameters
    ----------
    recordings : Recording
        Recordings.

    Returns
    -------
    uuid.UUID
        Identity.
    """
    content = hashlib.sha256()
    for recording in recordings:
        content.update(repr((recording.channels, dict(recording.meta))).encode())
        content.update(recording.time.tobytes() + recording.data.tobytes())
    return uuid.UUID(bytes=content.digest()[:16], version=4)


def time_columns(time: Array, steps: NDArray[np.int64]) -> list[Any]:
    """Return the two timelines: seconds and sample number."""
    return [rr.TimeColumn("sim_time", duration=time), rr.TimeColumn("step", sequence=steps)]


def send(stream: Any, path: str, indexes: list[Any], look: Any, columns: Any) -> None:
    """Log the look of an entity once, and its values over time."""
    stream.log(path, look, static=True)
    stream.send_columns(path, indexes, columns)


def rgb(index: int) -> tuple[int, ...]:
    """Return the colour of a curve number."""
    return _bytes(COLOURS[index % len(COLOURS)])


def role_rgb(role: str) -> tuple[int, ...]:
    """Return the colour of a role, that of the figures."""
    return _bytes(ROLES[role]["color"])


def plain(words: object) -> str:
    """Return text on one line, without control characters."""
    return "".join(c if c.isprintable() else " " for c in str(words))


def eye_view(name: str, origin: str, middle: Array, extent: float) -> Any:
    """Return a view from the front right.

    Parameters
    ----------
    name : str
        Name of the view.
    origin : str
        Entity.
    middle : array
        Centre of the scene [m].
    extent : float
        Extent of the scene [m].

    Returns
    -------
    object
        View.
    """
    position = middle + EYE_DISTANCE * extent * TOWARDS_EYE
    eye = rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=position, look_target=middle, eye_up=[0, 0, 1])
    return rrb.Spatial3DView(
        name=plain(name),
        origin=origin,
        eye_controls=eye,
        line_grid=rrb.LineGrid3D(visible=False),
    )


def extent_in_view(points: Array, middle: Array) -> float:
    """Return the smallest extent for `eye_view`.

    Parameters
    ----------
    points : array
        Points, (n, 3) [m].
    middle : array
        Centre of the scene [m].

    Returns
    -------
    float
        Extent [m].
    """
    towards = TOWARDS_EYE / np.linalg.norm(TOWARDS_EYE)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    above, at = np.cross(towards, right), points - middle
    half_height = 0.93 * np.tan(FIELD_OF_VIEW / 2)  # at distance 1, with a margin
    half_width = WIDTH_TO_HEIGHT * half_height
    depth = np.maximum(np.abs(at @ right) / half_width, np.abs(at @ above) / half_height)
    return float(np.max(depth + at @ towards) / (EYE_DISTANCE * np.linalg.norm(TOWARDS_EYE)))


def arranged(scene: Any, bars: Any | None, pages: Sequence[tuple[str, Sequence[Any]]], papers: Sequence[Any]) -> Any:
    """Arrange picture, bars, plots and documents.

    Parameters
    ----------
    scene : object
        Moving picture.
    bars : object or None
        View of bars below the picture, if any.
    pages : sequence of (name, views)
        Views in one column each; pages without views are omitted.
    papers : sequence of object
        Documents and images.

    Returns
    -------
    object
        Container of the views.
    """
    left = scene if bars is None else rrb.Vertical(scene, bars, row_shares=[3, 1])
    shown = [rrb.Vertical(*views, name=name) for name, views in pages if views]
    plots = rrb.Tabs(*shown) if len(shown) > 1 else shown[0]
    return rrb.Horizontal(left, plots, rrb.Vertical(*papers), column_shares=[3, 4, 3])


def blueprint(views: Any, *, playing: str = "playing") -> Any:
    """Return views with folded panels and running time.

    Parameters
    ----------
    views : object
        Container of the views.
    playing : str
        State of the time; ``"following"`` stays at its end.

    Returns
    -------
    object
        Blueprint.
    """
    return rrb.Blueprint(
        views,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline="sim_time",
            loop_mode="all" if playing == "playing" else "off",
            play_state=playing,
        ),
    )
