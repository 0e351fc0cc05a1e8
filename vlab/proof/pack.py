"""One compressed file for a finished campaign.

The file is a table of canonical JSON lines in an xz container. The first line holds plan, manifest, hashes and score.
Every further line is one case: its commitment, and where answered its truth, frozen hash and answer. Recordings are not
packed, because they follow from the seed of the plan.
"""

import lzma
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType
from typing import Any

from vlab.errors import BadProof
from vlab.files.output_folder import manifest_text
from vlab.proof import document_schema as shapes
from vlab.proof.document_schema import has_shape
from vlab.proof.seal import (
    ANSWERS,
    COMMITMENTS,
    FROZEN,
    MANIFEST,
    OPENED,
    PLAN,
    SCORE,
    answers_folder,
    canonical,
    checked_commitments,
    committed,
    parse_json,
    read_json,
    read_shaped,
    truth_folder,
    write_json,
)
from vlab.recordings.files import read_guarded, unpacked_limit, written_whole

PACKED = "vlab-campaign-1"
"""PACKED: format of the file."""
CASES = "cases"
"""CASES: folder of unpacked cases; those of answers and truth stand beside."""
PRESET = 9 | lzma.PRESET_EXTREME
"""PRESET: setting of the xz container; the same library gives the same bytes."""
SAME = 1e-6
"""SAME [1]: largest relative difference of equal measures; versions of scipy differ in the last digits."""
HEAD = {
    "format": str,
    "commitments": {"format": str, "plan": str},
    "frozen": {"manifest": str, "commitments": str},
    "manifest": {},
    "plan": {},
    "opened": [str],
    "concealed_with": ({}, NoneType),
    "score": ({"measures": [{"measure": str, "value": (*shapes.NUMBER, NoneType)}]}, NoneType),
}
OPEN_CASE = {"case": str, "commitment": {"truth": str, "recordings": str}}
ANSWERED_CASE = {**OPEN_CASE, "frozen": str, "truth": {}, "answer": shapes.ANSWER}
"""HEAD, OPEN_CASE, ANSWERED_CASE: shapes of the lines; see `vlab.proof.document_schema.has_shape`."""


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """Documents of a finished campaign.

    Parameters
    ----------
    commitments : dict
        Document of commitments to all cases.
    plan : dict
        Plan with seed and salt.
    frozen : dict
        Hashes of the frozen answers.
    manifest : dict
        Manifest of the answers.
    opened : list of str
        Hashes of the frozen answers for which the truth was opened.
    truths, answers : dict
        Salted truth and answer by the name of the case, of the frozen answers.
    concealed_with : dict or None
        Manifest of the truth, with the versions that made the recordings.
    score : dict or None
        Score as first counted.
    """

    commitments: dict[str, Any]
    plan: dict[str, Any]
    frozen: dict[str, Any]
    manifest: dict[str, Any]
    opened: list[str]
    truths: dict[str, Any] = field(default_factory=dict)
    answers: dict[str, Any] = field(default_factory=dict)
    concealed_with: dict[str, Any] | None = None
    score: dict[str, Any] | None = None


def is_pack(path: Path) -> bool:
    """Return whether a path names a packed campaign, not a folder."""
    return os.path.isfile(path) or (path.suffix == ".xz" and not os.path.isdir(path))  # accepts names of any length


def gather(cases: Path, answers: Path, truth: Path) -> Campaign:
    """Read the documents of a finished campaign.

    Parameters
    ----------
    cases, answers, truth : Path
        Folders of the campaign.

    Returns
    -------
    Campaign
        Documents, with the truth of the frozen answers only.

    Raises
    ------
    BadProof
        A document is missing or malformed.
    """
    frozen = read_shaped(answers / FROZEN, shapes.FROZEN, "a list of frozen answers")
    names = sorted(frozen["answers"])
    concealed, score = truth / MANIFEST, answers / SCORE
    return Campaign(
        commitments=committed(cases),
        plan=read_shaped(truth / PLAN, {}, "a sealed plan"),
        frozen=frozen,
        manifest=read_shaped(answers / MANIFEST, {}, "a manifest"),
        opened=read_shaped(truth / OPENED, [str], "a list of openings"),
        truths={name: read_shaped(truth / f"{name}.json", {}, "a sealed truth") for name in names},
        answers={name: read_shaped(answers / ANSWERS / f"{name}.json", shapes.ANSWER, "an answer") for name in names},
        concealed_with=read_json(concealed) if concealed.exists() else None,
        score=read_json(score) if score.exists() else None,
    )


def packed(campaign: Campaign) -> bytes:
    """Return the bytes of a packed campaign.

    Parameters
    ----------
    campaign : Campaign
        Documents.

    Returns
    -------
    bytes
        Content of the file; equal documents give equal bytes.
    """
    lines = b"".join(canonical(line) + b"\n" for line in _lines(campaign))
    return lzma.compress(lines, format=lzma.FORMAT_XZ, preset=PRESET)


def _lines(campaign: Campaign) -> Iterator[dict[str, Any]]:
    """Yield the head and one line per case."""
    known, hashes = campaign.commitments["cases"], campaign.frozen["answers"]
    yield {
        "format": PACKED,
        "commitments": {key: value for key, value in campaign.commitments.items() if key != "cases"},
        "frozen": {key: value for key, value in campaign.frozen.items() if key != "answers"},
        "manifest": campaign.manifest,
        "plan": campaign.plan,
        "opened": campaign.opened,
        "concealed_with": campaign.concealed_with,
        "score": campaign.score,
    }
    for name in sorted(known):
        line = {"case": name, "commitment": known[name]}
        if name in hashes:
            line |= {"frozen": hashes[name], "truth": campaign.truths[name], "answer": campaign.answers[name]}
        yield line


def write_pack(campaign: Campaign, file: Path) -> None:
    """Write a packed campaign, whole or not at all.

    Parameters
    ----------
    campaign : Campaign
        Documents.
    file : Path
        New file.

    Raises
    ------
    OutputRefused
        The file exists or cannot be written.
    """
    with written_whole(file, is_new=True) as stream:
        stream.write(packed(campaign))


def read_pack(file: Path) -> Campaign:
    """Read a packed campaign; its hashes are not checked yet.

    Parameters
    ----------
    file : Path
        File of `write_pack`.

    Returns
    -------
    Campaign
        Documents.

    Raises
    ------
    BadProof
        The file is damaged, or of another kind.
    BadRecording
        There is no such file, or the file cannot be opened.
    """
    head, *rows = _read_lines(file)
    if not has_shape(head, HEAD) or head["format"] != PACKED:
        raise BadProof(f"{file}: not a packed campaign ({PACKED}); name a file of vlab prove --pack")
    for number, row in enumerate(rows, 2):
        if not has_shape(row, OPEN_CASE) or (set(row) != set(OPEN_CASE) and not has_shape(row, ANSWERED_CASE)):
            raise BadProof(f"{file}: line {number} is no case of a packed campaign; restore the file")
    if len({row["case"] for row in rows}) < len(rows):
        raise BadProof(f"{file}: a case is there twice; restore the file")
    answered = {row["case"]: row for row in rows if "answer" in row}
    document = {**head["commitments"], "cases": {row["case"]: row["commitment"] for row in rows}}
    return Campaign(
        commitments=checked_commitments(document, where=str(file)),
        plan=head["plan"],
        frozen={**head["frozen"], "answers": {name: row["frozen"] for name, row in answered.items()}},
        manifest=head["manifest"],
        opened=head["opened"],
        truths={name: row["truth"] for name, row in answered.items()},
        answers={name: row["answer"] for name, row in answered.items()},
        concealed_with=head["concealed_with"],
        score=head["score"],
    )


def _read_lines(file: Path) -> list[Any]:
    """Return the documents of a file, line by line."""
    data = read_guarded(file)
    limit, stream = unpacked_limit(len(data)), lzma.LZMADecompressor(lzma.FORMAT_XZ)
    try:
        content = stream.decompress(data, limit + 1)
        if len(content) > limit:
            raise BadProof(f"{file}: more than {limit} bytes when unpacked; name a file of vlab prove --pack")
        if not stream.eof or stream.unused_data:
            raise lzma.LZMAError("its end is missing or more follows")
        return [parse_json(line) for line in content.decode().splitlines()] or [None]
    except (lzma.LZMAError, ValueError, RecursionError) as error:
        if isinstance(error, BadProof):
            raise
        raise BadProof(f"{file}: damaged, or not a packed campaign: {error}; copy the file again") from error


def unpack(campaign: Campaign, folder: Path) -> Path:
    """Write the documents of a campaign as its original folders.

    Parameters
    ----------
    campaign : Campaign
        Documents.
    folder : Path
        Existing folder without cases.

    Returns
    -------
    Path
        Folder of the cases; answers and truth are beside.

    Raises
    ------
    OutputRefused
        A file cannot be written.
    """
    cases = folder / CASES
    answers, truth = answers_folder(cases), truth_folder(cases)
    for made in (cases, answers / ANSWERS, truth):
        made.mkdir(parents=True)
    write_json(cases / COMMITMENTS, campaign.commitments)
    write_json(truth / PLAN, campaign.plan)
    write_json(truth / OPENED, campaign.opened)
    if campaign.concealed_with is not None:
        (truth / MANIFEST).write_text(manifest_text(campaign.concealed_with), encoding="utf-8")
    for name, answer in campaign.answers.items():
        write_json(answers / ANSWERS / f"{name}.json", answer)
        write_json(truth / f"{name}.json", campaign.truths[name])
    write_json(answers / MANIFEST, campaign.manifest)
    write_json(answers / FROZEN, campaign.frozen)
    if campaign.score is not None:
        write_json(answers / SCORE, campaign.score)
    return cases


def changed_measures(score: Mapping[str, Any] | None, found: Mapping[str, Any]) -> list[str]:
    """Return the measures of a score that another count does not give.

    Parameters
    ----------
    score : mapping or None
        Score of a packed campaign.
    found : mapping
        Score that was counted now.

    Returns
    -------
    list of str
        Names; new measures do not count.
    """
    now = {row["measure"]: row for row in found["measures"]}
    return [row["measure"] for row in (score or {"measures": []})["measures"] if not _is_same(row, now)]


def _is_same(row: Mapping[str, Any], now: Mapping[str, Mapping[str, Any]]) -> bool:
    """Return whether a count gives the same number of cases and value."""
    other = now.get(row["measure"], {})
    if any(row.get(key) != other.get(key) for key in ("count", "of")):
        return False
    before, after = row["value"], other.get("value")
    if before is None or after is None:
        return before is after
    return math.isclose(before, after, rel_tol=SAME, abs_tol=SAME)
