"""Binding of a run folder's recording to its manifest.

A recording with another hash than the manifest's is refused by every reader.
"""

import hashlib
import json
import os
from pathlib import Path

from vlab.errors import BadRecording
from vlab.files.output_folder import MANIFEST
from vlab.recordings.files import read_guarded, refuse

RECORDING = "recording.parquet"
"""File name of the recording in a run folder."""
STATED = "recording_sha256"
"""Manifest key of the recording's hash."""


def stated_hash(folder: Path) -> str | None:
    """Return the recording's SHA-256 from a folder's manifest.

    Parameters
    ----------
    folder : Path
        Folder with a manifest.

    Returns
    -------
    str or None
        Hexadecimal hash; None without a statement.
    """
    try:
        content = json.loads(read_guarded(MANIFEST, folder=folder))
    except (BadRecording, ValueError, RecursionError):
        return None
    stated = content.get(STATED) if isinstance(content, dict) else None
    return stated if isinstance(stated, str) else None


def check_bound(data: bytes, file: Path) -> None:
    """Check a recording's bytes against a manifest.

    Parameters
    ----------
    data : bytes
        Bytes as read.
    file : Path
        Path of the file; the manifest is in the same folder.

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
    """Check that a folder holds its manifest's recording.

    Without a manifest any recording passes.

    Parameters
    ----------
    folder : Path
        Run folder.

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
