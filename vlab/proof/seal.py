"""Sealing: truth is committed to by a salted hash before anything is diagnosed, and answers by theirs before it is opened."""

import hashlib
import json
import math
import re
import secrets
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from vlab.errors import BadProof
from vlab.proof import document_schema as shapes
from vlab.proof.document_schema import has_shape
from vlab.recordings.files import written_whole

FORMAT = "vlab-concealed-1"
COMMITMENTS = "commitments.json"
TRUTH = "truth.json"
_NAME = re.compile(r"case-[0-9]{3,9}")


def canonical(document: Any) -> bytes:
    """Return the one text of plain values that is hashed: sorted keys, no spaces, shortest numbers."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def digest(document: Any) -> str:
    """Return the SHA-256 of plain values."""
    return hashlib.sha256(canonical(document)).hexdigest()


def sealed(truth: Any) -> tuple[dict[str, Any], str]:
    """Return truth with a fresh salt, as it is kept, and the commitment, as it is published."""
    salt = secrets.token_hex(16)
    return {"salt": salt, "truth": truth}, _commitment(salt, truth)


def _commitment(salt: str, truth: Any) -> str:
    return hashlib.sha256(salt.encode() + canonical(truth)).hexdigest()


def opened(kept: Any, commitment: str, *, where: str) -> Any:
    """Return truth that matches its commitment.

    Raises
    ------
    BadProof
        It is not the truth that was committed to.
    """
    if not isinstance(kept, dict) or set(kept) != {"salt", "truth"} or not isinstance(kept["salt"], str):
        raise BadProof(
            f"{where}: not a sealed truth (a table with salt and truth); restore the file that conceal wrote"
        )
    if _commitment(kept["salt"], kept["truth"]) != commitment:
        raise BadProof(f"{where}: the truth does not match its commitment; it was changed after it was sealed")
    return kept["truth"]


def made_again(truth: Any, recordings: str) -> dict[str, Any]:
    """Return truth as it is kept where it was made again from the seed: with the digest of the recordings that came with it."""
    return {"recordings": recordings, "truth": truth}


def is_made_again(kept: Any) -> bool:
    """Whether kept truth was made again from the seed, so that it has no salt."""
    return isinstance(kept, dict) and set(kept) == {"recordings", "truth"}


def folder_digest(folder: Path) -> str:
    """Return the SHA-256 of a folder's files, by name and content."""
    return files_digest((p.relative_to(folder).as_posix(), p) for p in folder.rglob("*") if p.is_file())


def files_digest(files: Iterable[tuple[str, Path]]) -> str:
    """Return the SHA-256 of named files, in the order of their names."""
    total = hashlib.sha256()
    for name, path in sorted(files):
        content = hashlib.sha256(path.read_bytes()).hexdigest()
        total.update(f"{name} {content}\n".encode())
    return total.hexdigest()


def read_json(path: Path) -> Any:
    """Read a JSON document; its numbers are finite, as JSON has it.

    Raises
    ------
    BadProof
        It is missing or malformed, or a number is not finite.
    """
    try:
        text = path.read_text(encoding="utf-8")
        return json.loads(text, parse_float=_finite, parse_constant=_finite, parse_int=_whole)
    except FileNotFoundError:
        raise BadProof(f"{path}: there is no such file; check the folder, or conceal the cases first") from None
    except (OSError, ValueError, RecursionError) as error:
        raise BadProof(f"{path}: not readable as JSON: {error}") from error


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
    shape : Any
        See `vlab.proof.document_schema.has_shape`.
    what : str
        What the document must be.

    Raises
    ------
    BadProof
        It is missing, malformed, or of another shape.
    """
    document = read_json(path)
    if not has_shape(document, shape):
        raise BadProof(f"{path}: not {what} as vlab writes it; restore the file")
    return document


def committed(cases: Path) -> dict[str, Any]:
    """Return the commitments of a folder of cases.

    Raises
    ------
    BadProof
        There are none, or one has a name that no case has.
    """
    path = cases / COMMITMENTS
    document = read_json(path)
    if not has_shape(document, shapes.COMMITMENTS) or document["format"] != FORMAT:
        raise BadProof(f"{path}: not a list of commitments ({FORMAT}); conceal the cases again")
    for name in document["cases"]:
        if not _NAME.fullmatch(name):
            raise BadProof(f"{path}: {name!r} is no commitment to a case; restore the file")
    return dict(document)


def write_json(path: Path, document: Any, *, is_new: bool = False) -> None:
    """Write plain values as JSON, whole or not at all; with `is_new` never over a file that is there.

    Raises
    ------
    OutputRefused
        The file cannot be written, or must be new and is not.
    """
    with written_whole(path, is_new=is_new) as stream:
        stream.write((json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n").encode())
