"""Score of concealed cases: answers, frozen hashes, opened truth, counts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from vlab.errors import BadProof
from vlab.files.locks import sole_use
from vlab.files.output_folder import output_folder, write_manifest
from vlab.physics.catalogue import EFFECTS
from vlab.proof import document_schema as shapes
from vlab.proof.answer import Report, answer_case, write_worst
from vlab.proof.campaign import run_all
from vlab.proof.judge import Judged, judge
from vlab.proof.levels import level_rows
from vlab.proof.manifest import is_set_down, manifest, scoring_digest
from vlab.proof.pack import changed_measures, read_pack, unpack
from vlab.proof.peers.registry import check_peers
from vlab.proof.peers.scoring import peer_rows
from vlab.proof.score import score
from vlab.proof.seal import (
    ANSWERS,
    FROZEN,
    MANIFEST,
    SCORE,
    answers_folder,
    committed,
    digest,
    folder_digest,
    read_json,
    read_shaped,
    truth_folder,
    write_json,
)
from vlab.proof.servo_scoring import arm_rows, partial_rows
from vlab.proof.stated import decision_rows, stated_rows
from vlab.proof.targets import SHAPE, with_targets
from vlab.proof.truth import check_remade, note_opening, open_truth

SHOWN = (
    "case",
    "suite",
    "bench",
    "noise",
    "hidden",
    "form",
    "in_library",
    "truth_place",
    "size",
    "verdict",
    "answered",
    "place",
    "right_effect",
    "right_class",
    "in_claimed",
    "hit",
    "all_right",
    "place_exact",
    "place_near",
    "place_covered",
    "probability",
    "errors",
    "gap",
    "seconds",
    "error",
)
"""SHOWN: parts of every case in the score."""
MANIFEST_SHAPE = {"targets?": SHAPE}
"""MANIFEST_SHAPE: counted parts of a manifest; see `vlab.proof.document_schema.has_shape`."""
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Baselines:
    """Peers of a campaign.

    Parameters
    ----------
    count : int or None
        Number of cases for slow peers; None for no peers at all.
    peers : tuple of str
        Names of the peers; all by default.
    """

    count: int | None = None
    peers: tuple[str, ...] = ()

    @property
    def settings(self) -> dict[str, Any]:
        """Entries of the manifest; without named peers those of earlier manifests."""
        return {"baselines": self.count, **({"peers": list(self.peers)} if self.peers else {})}


def prove(
    cases: Path,
    out: Path,
    *,
    truth: Path | None = None,
    first: int = 0,
    baselines: int | None = None,
    peers: Sequence[str] = (),
    reports: int = 0,
    report: Report | None = None,
    engine: str = "joblib",
    jobs: int = 0,
    scheduler: str = "",
    progress: Progress = lambda done, total: None,
) -> dict[str, Any]:
    """Diagnose every case, freeze the answers, open the truth and score.

    Earlier answers are kept. An interrupted campaign continues, and a frozen one is only counted again. One process
    at a time works in the folder of the answers.

    Parameters
    ----------
    cases : Path
        Folder of the cases.
    out : Path
        Folder of the answers.
    truth : Path, optional
        Folder of the truth, beside the cases by default; untouched before all answers are frozen.
    first : int
        Number of answered and scored cases in drawn order. By default all, or after freezing the answered ones.
    baselines : int, optional
        Whether peers answer, and number of cases for slow ones.
    peers : sequence of str
        Names of the peers, see `vlab.proof.peers.registry`; all by default.
    reports : int
        Number of worst cases with a report.
    report : Report or None
        Function that writes a report.
    engine : str
        Engine of `vlab.proof.campaign.run_all`.
    jobs : int
        Number of processes; 0 for all cores.
    scheduler : str
        Address of a dask scheduler.
    progress : Progress
        Receives the numbers of completed and of all cases.

    Returns
    -------
    dict
        Score as plain values.

    Raises
    ------
    BadProof
        Cases, truth or answers differ from their commitments, or the answers belong to other code.
    OutputRefused
        Another process works in the folder of the answers, or the folder cannot be written.
    """
    check_peers(peers)
    commitments = read_commitments(cases, recordings=not (out / FROZEN).exists())
    with sole_use(out, of="vlab prove"):
        found = _counted(
            cases,
            out,
            commitments,
            truth or truth_folder(cases),
            first,
            Baselines(count=baselines, peers=tuple(peers)),
            engine,
            jobs,
            scheduler,
            progress,
        )
        if report is not None and reports:
            _write_worst(cases, out, found, reports, report)
    return found


def prove_packed(
    file: Path,
    out: Path,
    *,
    engine: str = "joblib",
    jobs: int = 0,
    scheduler: str = "",
    progress: Progress = lambda done, total: None,
) -> tuple[dict[str, Any], list[str]]:
    """Unpack a campaign, check its hashes, and count again.

    Parameters
    ----------
    file : Path
        File of `vlab.proof.pack`.
    out : Path
        New folder of cases, answers and truth.
    engine : str
        Engine of `vlab.proof.campaign.run_all`, which remakes the recordings of truths without salts.
    jobs : int
        Number of processes; 0 for all cores.
    scheduler : str
        Address of a dask scheduler.
    progress : Progress
        Receives the numbers of completed and of all cases.

    Returns
    -------
    (dict, list of str)
        Score as plain values, and measures that differ from those of the packed score.

    Raises
    ------
    BadProof
        The file is damaged, or its content differs from the hashes; nothing is written then.
    OutputRefused
        The folder exists, or cannot be written.
    """
    campaign = read_pack(file)
    with output_folder(out) as fresh:
        cases = unpack(campaign, fresh)
        try:
            answers = frozen_answers(answers_folder(cases), campaign.commitments)
            open_truth(truth_folder(cases), campaign.commitments, answers)
        except BadProof as error:  # the folder goes, so the message names the file
            raise BadProof(str(error).replace(str(fresh), str(file))) from error
        write_manifest(fresh, verb="prove", pack=file.name)
    cases = out / cases.name
    found = prove(cases, answers_folder(cases), engine=engine, jobs=jobs, scheduler=scheduler, progress=progress)
    return found, changed_measures(campaign.score, found)


def _counted(
    cases: Path,
    out: Path,
    commitments: dict[str, Any],
    truth: Path,
    first: int,
    baselines: Baselines,
    engine: str,
    jobs: int,
    scheduler: str,
    progress: Progress,
) -> dict[str, Any]:
    """Answer the rest, freeze, open the truth, count and write."""
    if not (out / FROZEN).exists():
        names = sorted(commitments["cases"])[: first or None]
        _answer(cases, out, commitments, names, baselines, engine, jobs, scheduler, progress)
        freeze(out, commitments, names)
    answers = frozen_answers(out, commitments)
    is_first = note_opening(truth, digest(read_json(out / FROZEN)))
    truths, remade = open_truth(truth, commitments, answers)
    check_remade(truths, commitments, remade, out, engine, jobs, scheduler, progress)
    judged = [judge(truths[name], answer) for name, answer in answers.items()]
    found = score(judged)
    answered_with = read_shaped(out / MANIFEST, MANIFEST_SHAPE, "a manifest")
    found["measures"] += [*arm_rows(judged), *partial_rows(truths, answers)]
    found["measures"] = with_targets(found["measures"], answered_with.get("targets", {}))
    found["levels"] = level_rows(judged, truths, answers)
    found["decisions"] = decision_rows(judged)
    found["stated"] = stated_rows(judged, truths, answers)
    found["baselines"] = peer_rows(judged, answers, truths)
    found["plan"] = truths["plan"]
    found["never_hidden"] = sorted(
        {e.physics for e in EFFECTS.values()} - {e for n in answers for h in truths[n]["hidden"] for e in h["accepted"]}
    )
    found["answered_with"] = answered_with
    found["counted_with"] = scoring_digest()
    found["is_answered_first"] = is_first
    if remade:
        found["truths_made_again"] = remade
    found["is_counted_as_set_down"] = is_set_down(answered_with)
    found["judged"] = [_row(j) for j in judged]
    for row in found["worst"]:
        row["report"] = None
    write_json(out / SCORE, found)
    return found


def _write_worst(cases: Path, out: Path, found: dict[str, Any], reports: int, report: Report) -> None:
    """Write reports of the worst answers, and their paths."""
    answered = [row for row in found["worst"] if not row["error"]][:reports]
    paths = write_worst(cases, [row["case"] for row in answered], out / "worst", report)
    for row in found["worst"]:
        row["report"] = paths.get(row["case"])
    write_json(out / SCORE, found)


def read_commitments(cases: Path, *, recordings: bool = True) -> dict[str, Any]:
    """Read the commitments of cases and check the recordings.

    Parameters
    ----------
    cases : Path
        Folder of the cases.
    recordings : bool
        Whether the recordings must exist; counting needs none.

    Returns
    -------
    dict
        Document of commitments.

    Raises
    ------
    BadProof
        A recording differs from its commitment.
    """
    document = committed(cases)
    for name, kept in document["cases"].items():
        if not recordings and not (cases / name).exists():
            continue
        if not (cases / name).is_dir():
            raise BadProof(f"{cases}: the case {name!r} is missing; restore its folder")
        if folder_digest(cases / name) != kept["recordings"]:
            raise BadProof(f"{cases / name}: the files are not those that were committed to; restore the folder")
    return document


def _answer(
    cases: Path,
    out: Path,
    commitments: dict[str, Any],
    names: Sequence[str],
    baselines: Baselines,
    engine: str,
    jobs: int,
    scheduler: str,
    progress: Progress,
) -> None:
    """Answer the open cases; each answer is written whole."""
    now = manifest(commitments, **baselines.settings)
    if (out / MANIFEST).exists():
        _check_same(read_shaped(out / MANIFEST, {}, "a manifest"), now, out)
    else:
        (out / ANSWERS).mkdir(parents=True, exist_ok=True)
        write_json(out / MANIFEST, now, is_new=True)
    left = [(n, (cases / n).resolve()) for n in names if not (out / ANSWERS / f"{n}.json").exists()]
    progress(len(names) - len(left), len(names))
    done = len(names) - len(left)
    slow_on = frozenset(names[: baselines.count or 0])
    work = partial(answer_case, baselines=baselines.count is not None, slow_on=slow_on, peers=baselines.peers)
    for name, answer in run_all(work, left, engine=engine, jobs=jobs, scheduler=scheduler):
        write_json(out / ANSWERS / f"{name}.json", answer, is_new=True)
        done += 1
        progress(done, len(names))
    # late processes read the present state
    _check_same(now, manifest(commitments, **baselines.settings), out)


def _check_same(before: Any, now: dict[str, Any], out: Path) -> None:
    """Refuse to continue with answers of other code."""
    for key, value in now.items():
        if before.get(key) != value:
            raise BadProof(
                f"{out}: these answers were begun with another {key.replace('_', ' ')}; "
                "go on with what they were begun with, or name a new folder with --out"
            )


def freeze(out: Path, commitments: dict[str, Any], names: Sequence[str]) -> None:
    """Write the hashes of the answers; later changes are detected.

    Parameters
    ----------
    out : Path
        Folder of the answers.
    commitments : dict
        Commitments of the cases.
    names : sequence of str
        Names of the answered cases; no others are counted.

    Raises
    ------
    BadProof
        An answer is missing.
    OutputRefused
        The answers are frozen already.
    """
    hashes = {name: digest(_read_answer(out, name)) for name in names}
    frozen = {"answers": hashes, "manifest": digest(read_json(out / MANIFEST)), "commitments": digest(commitments)}
    write_json(out / FROZEN, frozen, is_new=True)


def _read_answer(out: Path, name: str) -> dict[str, Any]:
    return dict(read_shaped(out / ANSWERS / f"{name}.json", shapes.ANSWER, "an answer"))


def frozen_answers(out: Path, commitments: dict[str, Any]) -> dict[str, Any]:
    """Return the answers after a check of their hashes.

    Parameters
    ----------
    out : Path
        Folder of the answers.
    commitments : dict
        Commitments of the cases.

    Returns
    -------
    dict
        Answers by case.

    Raises
    ------
    BadProof
        An answer or the manifest was changed, or belongs to other cases.
    """
    frozen = read_shaped(out / FROZEN, shapes.FROZEN, "a list of frozen answers")
    if frozen["commitments"] != digest(commitments):
        raise BadProof(f"{out}: these answers were given to other cases; name another folder with --out")
    if frozen["manifest"] != digest(read_json(out / MANIFEST)):
        raise BadProof(f"{out / MANIFEST}: the manifest was changed after the answers were frozen; restore it")
    names = sorted(frozen["answers"])
    if names != sorted(commitments["cases"])[: len(names)]:
        raise BadProof(f"{out}: answers were left out that belong among those that are frozen; restore {out / FROZEN}")
    answers = {}
    for name in names:
        answers[name] = _read_answer(out, name)
        if digest(answers[name]) != frozen["answers"][name]:
            path = out / ANSWERS / f"{name}.json"
            raise BadProof(f"{path}: the answer was changed after it was frozen; restore it, or answer all cases anew")
    return answers


def _row(j: Judged) -> dict[str, Any]:
    """Return one judged case as a row of the score."""
    row = {k: list(v) if isinstance(v := getattr(j, k), tuple) else v for k in SHOWN}
    return {**row, "right": not j.is_wrong}


def table_rows(found: Mapping[str, Any]) -> tuple[list[str], Sequence[Sequence[Any]]]:
    """Return heads and rows of the table of measures.

    A target is met if the whole interval meets it.

    Parameters
    ----------
    found : mapping
        Score.

    Returns
    -------
    tuple
        Headings and rows.
    """
    rows = []
    for m in found["measures"]:
        interval = f"{m['ci95'][0]:.3f} to {m['ci95'][1]:.3f}" if m.get("ci95") and m["of"] else ""
        count = f"{m['count']}/{m['of']}" if "count" in m else f"{m['of']}"
        met = "shown" if m.get("shown") else {True: "met", False: "missed", None: ""}[m["met"]]
        rows.append([m["measure"], m["value"], count, interval, m["target"], met])
    return ["measure", "value", "cases", "95 % interval", "target", ""], rows
