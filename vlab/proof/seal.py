"""Sealing of truth and answers by hashes.

A salted hash commits to the truth before any diagnosis. Hashes freeze the answers before the truth is opened.
"""

import hashlib
import json
import math
import re
import secrets
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from vlab.errors import BadProof
from vlab.files.output_folder import folder_beside
from vlab.files.plain_text import read_plain_text
from vlab.proof import document_schema as shapes
from vlab.proof.document_schema import has_shape
from vlab.recordings.files import written_whole

FORMAT = "vlab-concealed-1"
COMMITMENTS, PLAN, OPENED = "commitments.json", "plan.json", "opened.json"
"""COMMITMENTS, PLAN, OPENED: files of the cases and of their truth. `OPENED` lists the hashes of the frozen answers for
which the truth was opened, in order."""
MANIFEST, ANSWERS, FROZEN, SCORE = "manifest.json", "answers", "frozen.json", "score.json"
"""MANIFEST, ANSWERS, FROZEN, SCORE: files and subfolder in the folder of the answers."""
_NAME = re.compile(r"case-[0-9]{3,9}")


def truth_folder(folder: Path) -> Path:
    """Return the folder of the truth, beside the cases."""
    return folder_beside(folder, "{}-truth")


def answers_folder(cases: Path) -> Path:
    """Return the folder of the answers, beside the cases."""
    return folder_beside(cases, "{}-answers")


def canonical(document: Any) -> bytes:
    """Return the canonical text of plain values for hashing."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def digest(document: Any) -> str:
    """Return the SHA-256 of plain values."""
    return hashlib.sha256(canonical(document)).hexdigest()


def sealed(truth: Any) -> tuple[dict[str, Any], str]:
    """Return salted truth, and its commitment."""
    salt = secrets.token_hex(16)
    return {"salt": salt, "truth": truth}, _commitment(salt, truth)


def _commitment(salt: str, truth: Any) -> str:
    return hashlib.sha256(salt.encode() + canonical(truth)).hexdigest()


def opened(kept: Any, commitment: str, *, where: str) -> Any:
    """Return truth that matches its commitment.

    Parameters
    ----------
    kept : object
        Salted truth.
    commitment : str
        Published hash.
    where : str
        File, for the message.

    Returns
    -------
    object
        Truth.

    Raises
    ------
    BadProof
        The truth does not match the commitment.
    """
    if not isinstance(kept, dict) or set(kept) != {"salt", "truth"} or not isinstance(kept["salt"], str):
        raise BadProof(
            f"{where}: not a sealed truth (a table with salt and truth); restore the file that conceal wrote"
        )
    if _commitment(kept["salt"], kept["truth"]) != commitment:
        raise BadProof(f"{where}: the truth does not match its commitment; it was changed after it was sealed")
    return kept["truth"]


def made_again(truth: Any, recordings: str) -> dict[str, Any]:
    """Return regenerated truth with the digest of its recordings."""
    return {"recordings": recordings, "truth": truth}


def is_made_again(kept: Any) -> bool:
    """Return whether kept truth was regenerated and has no salt."""
    return isinstance(kept, dict) and set(kept) == {"recordings", "truth"}


def folder_digest(folder: Path) -> str:
    """Return the SHA-256 of the files of a folder."""
    return files_digest((p.relative_to(folder).as_posix(), p) for p in folder.rglob("*") if p.is_file())


def files_digest(files: Iterable[tuple[str, Path]]) -> str:
    """Return the SHA-256 of named files, sorted by name.

    Parameters
    ----------
    files : iterable of tuple
        Names and paths.

    Returns
    -------
    str
        Hexadecimal digest.
    """
    total = hashlib.sha256()
    for name, path in sorted(files):
        content = hashlib.sha256(path.read_bytes()).hexdigest()
        total.update(f"{name} {content}\n".encode())
    return total.hexdigest()


def read_json(path: Path) -> Any:
    """Read a JSON document with finite numbers.

    Parameters
    ----------
    path : Path
        File.

    Returns
    -------
    object
        Plain values.

    Raises
    ------
    BadProof
        The file is missing or malformed, or a number is not finite.
    """
    try:
        return parse_json(read_plain_text(path))
    except FileNotFoundError:
        raise BadProof(f"{path}: there is no such file; check the folder, or conceal the cases first") from None
    except NotADirectoryError:
        raise BadProof(f"{Path(path).parent} is no folder of sealed cases; name the folder") from None
    except (OSError, ValueError, RecursionError) as error:
        raise BadProof(f"{path}: not readable as JSON: {error}") from error


def parse_json(text: str) -> Any:
    """Parse a JSON document with finite numbers.

    Parameters
    ----------
    text : str
        Document.

    Returns
    -------
    object
        Plain values.

    Raises
    ------
    ValueError
        The document is malformed, or a number is not finite.
    RecursionError
        The document is nested too deeply.
    """
    return json.loads(text, parse_float=_finite, parse_constant=_finite, parse_int=_whole)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text} is not finite")
    return value


def _whole(text: str) -> int:
    _finite(text)
    return int(text)


def read_shaped(path: Path, shape: Any, what: str) -> Any:
    """Read a JSON document of a certain shape.

    Parameters
    ----------
    path : Path
        File.
    shape : Any
        Shape of `vlab.proof.document_schema.has_shape`.
    what : str
        Kind of document, for the message.

    Returns
    -------
    object
        Plain values.

    Raises
    ------
    BadProof
        The document is missing, malformed, or of another shape.
    """
    document = read_json(path)
    if not has_shape(document, shape):
        raise BadProof(f"{path}: not {what} as vlab writes it; restore the file")
    return document


def committed(cases: Path) -> dict[str, Any]:
    """Return the commitments of a folder of cases.

    Parameters
    ----------
    cases : Path
        Folder of the cases.

    Returns
    -------
    dict
        Document of commitments.

    Raises
    ------
    BadProof
        There are no commitments, or one has an invalid name.
    """
    path = cases / COMMITMENTS
    return checked_commitments(read_json(path), where=str(path))


def checked_commitments(document: Any, *, where: str) -> dict[str, Any]:
    """Return commitments of valid format and names.

    Parameters
    ----------
    document : object
        Plain values.
    where : str
        File, for the message.

    Returns
    -------
    dict
        Document of commitments.

    Raises
    ------
    BadProof
        The document holds no commitments, or one has an invalid name.
    """
    if not has_shape(document, shapes.COMMITMENTS) or document["format"] != FORMAT:
        raise BadProof(f"{where}: not a list of commitments ({FORMAT}); conceal the cases again")
    for name in document["cases"]:
        if not _NAME.fullmatch(name):
            raise BadProof(f"{where}: {name!r} is no commitment to a case; restore the file")
    return dict(document)


def write_json(path: Path, document: Any, *, is_new: bool = False) -> None:
    """Write plain values as JSON, whole or not at all.

    Parameters
    ----------
    path : Path
        File.
    document : object
        Plain values.
    is_new : bool
        Whether an existing file is refused.

    Raises
    ------
    OutputRefused
        The file cannot be written, or must be new and exists.
    """
    with written_whole(path, is_new=is_new) as stream:
        stream.write((json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n").encode())
