"""The recording of a run folder, bound by its manifest: one that is not as it was written is refused wherever it is read."""

import hashlib
import json
import os
from pathlib import Path

from vlab.errors import BadRecording
from vlab.files.output_folder import MANIFEST
from vlab.recordings.files import read_guarded, refuse

RECORDING = "recording.parquet"
"""Its name in every run folder."""
STATED = "recording_sha256"
"""The key of the manifest that states its hash."""


def stated_hash(folder: Path) -> str | None:
    """Return the SHA-256 of the recording that the manifest of a folder states; None where there is no such statement."""
    try:
        content = json.loads(read_guarded(MANIFEST, folder=folder))
    except (BadRecording, ValueError, RecursionError):
        return None
    stated = content.get(STATED) if isinstance(content, dict) else None
    return stated if isinstance(stated, str) else None


def check_bound(data: bytes, file: Path) -> None:
    """Check the bytes of a recording against the manifest beside it, where it is that of a run folder.

    Parameters
    ----------
    data : bytes
        What was read.
    file : Path
        From where.

    Raises
    ------
    BadRecording
        The manifest states another hash.
    """
    if file.name != RECORDING:
        return
    stated = stated_hash(file.parent)
    if stated is not None and stated != hashlib.sha256(data).hexdigest():
        raise refuse(
            file,
            f"the recording is not the one whose hash the {MANIFEST} beside it states",
            fix="restore the folder, or run the experiment again",
        )


def check_run(folder: Path) -> None:
    """Check that a folder holds a recording, the one whose hash its manifest states; without a manifest any.

    Raises
    ------
    BadRecording
        There is no recording, the manifest states no hash, or the recording is another one.
    """
    if not (folder / RECORDING).is_file():
        raise BadRecording(
            f"{folder}: no {RECORDING} in this folder; give a run folder written by vlab experiment, or a recording file"
        )
    if stated_hash(folder) is None and os.path.lexists(folder / MANIFEST):
        raise BadRecording(
            f"{folder}: its {MANIFEST} does not state the hash of {RECORDING}; restore the folder, or give the recording file"
        )
    check_bound(read_guarded(RECORDING, folder=folder), folder / RECORDING)
