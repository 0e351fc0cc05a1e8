"""Real recordings: answers, black boxes, comparison with what is known."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import vlab
from vlab.errors import BadProof
from vlab.files.locks import sole_use
from vlab.proof.campaign import run_all
from vlab.proof.document_schema import FINDING, HELDOUT, NUMBER
from vlab.proof.real.answer import answer_real, black_box_real
from vlab.proof.real.folders import RealCase, black_box_digest, engine_digest, find_cases
from vlab.proof.real.judge import judge_real
from vlab.proof.real.known import KnownCase, known_of
from vlab.proof.real.table import count_sentence, counts, errors_by_model, is_held_out, markdown, metrics_of
from vlab.proof.seal import read_shaped, write_json
from vlab.recordings.files import written_whole

ANSWERS, BLACK_BOXES, RESULT, TABLE = "answers", "black_boxes", "real.json", "real.md"
SCHEMA = "vlab-real/1"
"""SCHEMA: name and version of the JSON document."""
KEPT = {"case": str, "code": str, "data": str, "skip": int, "seconds": NUMBER}
"""KEPT: parts of every kept answer."""
ANSWER = {**KEPT, "verdict": str, "findings": [{**FINDING, "family": str}], "heldout?": (HELDOUT, type(None))}
"""ANSWER: counted parts of a kept diagnosis."""
Progress = Callable[[int, int], None]


def prove_real(
    folders: Sequence[Path],
    out: Path,
    *,
    keys: Path | None = None,
    time_limit: float | None = None,
    engine: str = "joblib",
    jobs: int = 0,
    scheduler: str = "",
    progress: Progress = lambda done, total: None,
) -> dict[str, Any]:
    """Diagnose real cases and compare the answers with what is known.

    Finished answers in the output folder are kept, so an interrupted run continues. One process at a time works there.

    Parameters
    ----------
    folders : sequence of Path
        Case files, folders of a case, and folders of such folders.
    out : Path
        Output folder: answers, ``real.json`` and ``real.md``.
    keys : Path, optional
        File of answer keys; vlab's own by default.
    time_limit : float or None
        Duration of a diagnosis after which no further effects are added [s].
    engine : str
        Engine of `vlab.proof.campaign.run_all`.
    jobs : int
        Number of processes; 0 for all cores.
    scheduler : str
        Address of a dask scheduler.
    progress : Progress
        Receives the numbers of completed and of all pieces of work, two a case.

    Returns
    -------
    dict
        Result as plain values.

    Raises
    ------
    BadProof
        There is no case or a key is malformed, or a kept answer belongs to other code or other data.
    OutputRefused
        The folder lies within the cases, another process works in it, or it cannot be written.
    """
    cases = find_cases(folders)
    known = known_of(cases, keys)
    _check_apart(out, cases)
    data = {case.name: case.data_digest() for case in cases}
    with sole_use(out, of="vlab prove --real"):
        work = _Work(out=out, data=data, engine=engine, jobs=jobs, scheduler=scheduler, progress=progress)
        skips = {case.name: known[case.name].skip if case.name in known else 0 for case in cases}
        answers = work.done(
            ANSWERS,
            ANSWER,
            engine_digest(),
            partial(answer_real, time_limit=time_limit),
            {case.name: (case.name, case.path.resolve(), skips[case.name]) for case in cases},
        )
        boxes = work.done(
            BLACK_BOXES,
            KEPT,
            black_box_digest(),
            black_box_real,
            {
                case.name: (case.name, case.path.resolve(), skips[case.name], answers[case.name].get("parts") or {})
                for case in cases
            },
        )
        rows = [_row(case, known.get(case.name), answers[case.name], boxes[case.name]) for case in cases]
        found = _document(rows)
        write_json(out / RESULT, found)
        with written_whole(out / TABLE) as stream:
            stream.write(markdown(found).encode())
    return found


def _document(rows: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "vlab": vlab.__version__,
        "engine": engine_digest(),
        "black_boxes": black_box_digest(),
        "cases": rows,
        "counts": counts(rows),
        "summary": count_sentence(rows),
    }


def _check_apart(out: Path, cases: Sequence[RealCase]) -> None:
    """Refuse an output folder among the data of a case."""
    target = out.resolve()
    for case in cases:
        folder = case.folder.resolve()
        if target == folder or folder in target.parents:
            raise BadProof(
                f"the output folder {out} lies in the folder of the case {case.name}; name another with --out"
            )


class _Work:
    """Pieces of work whose finished answers are kept.

    Parameters
    ----------
    out : Path
        Output folder.
    data : dict
        Digest of the data by case.
    engine, jobs, scheduler
        See `prove_real`.
    progress : Progress
        Receives the numbers of completed and of all pieces.
    """

    def __init__(
        self, *, out: Path, data: dict[str, str], engine: str, jobs: int, scheduler: str, progress: Progress
    ) -> None:
        self.out, self.data, self.progress = out, data, progress
        self.settings: dict[str, Any] = {"engine": engine, "jobs": jobs, "scheduler": scheduler}
        self.count = 0

    def done(
        self, room: str, shape: Any, code: str, work: Callable[[Any], tuple[str, dict[str, Any]]], items: dict[str, Any]
    ) -> dict[str, dict[str, Any]]:
        """Return the answer of every case, kept or new."""
        folder = self.out / room
        folder.mkdir(parents=True, exist_ok=True)
        kept = {
            name: self._kept(folder / f"{name}.json", shape, code, name, item)
            for name, item in items.items()
            if (folder / f"{name}.json").exists()
        }
        self._report(len(kept))
        left = [item for name, item in items.items() if name not in kept]
        for name, answer in run_all(work, left, **self.settings):
            whole = {**answer, "code": code, "data": self.data[name]}
            write_json(folder / f"{name}.json", whole, is_new=True)
            kept[name] = whole
            self._report(1)
        return kept

    def _kept(self, path: Path, shape: Any, code: str, name: str, item: tuple[Any, ...]) -> dict[str, Any]:
        answer = dict(read_shaped(path, shape, "an answer"))
        for key, now, what in (
            ("code", code, "another code"),
            ("data", self.data[name], "other recordings"),
            ("skip", item[2], "another number of skipped samples"),
        ):
            if answer[key] != now:
                raise BadProof(
                    f"{path}: this answer belongs to {what}; remove the file to answer the case anew, or name a new folder "
                    "with --out"
                )
        return answer

    def _report(self, count: int) -> None:
        self.count += count
        self.progress(self.count, 2 * len(self.data))


def _row(case: RealCase, known: KnownCase | None, answer: dict[str, Any], boxes: dict[str, Any]) -> dict[str, Any]:
    """Return one case as plain values."""
    return {
        "case": case.name,
        "title": answer.get("title", ""),
        "known": None if known is None else asdict(known),
        "verdict": answer["verdict"],
        "explained": answer.get("explained"),
        "findings": [
            {key: f.get(key) for key in ("effect", "family", "place", "probability", "parameters")}
            for f in answer["findings"]
        ],
        "attempt": (answer.get("attempt") or {}).get("effect"),
        "error": answer.get("error", ""),
        **judge_real(known, answer),
        "errors": errors_by_model(answer, boxes),
        "noise": (answer.get("heldout") or {}).get("nrmse_noise"),
        "is_held_out": is_held_out(answer),
        "parts": answer.get("parts") or {},
        "black_boxes": {kind: boxes.get(kind) or {"note": boxes.get("error", "")} for kind in ("linear", "nonlinear")},
        "benchmark": asdict(known.benchmark[0]) if known is not None and known.benchmark else None,
        "metrics": metrics_of(known, answer, boxes),
        "time_limit": answer.get("time_limit"),
        "seconds": answer["seconds"],
    }
