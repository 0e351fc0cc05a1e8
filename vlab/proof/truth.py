"""Opening of the truth, by salt or by regenerated recordings."""

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from vlab.errors import BadProof
from vlab.files.locks import sole_use
from vlab.proof.conceal import make_again
from vlab.proof.seal import OPENED, PLAN, canonical, is_made_again, opened, read_json, write_json

REMADE = ".remade"
"""REMADE: folder of regenerated recordings during the check of truths without salts."""


def note_opening(folder: Path, frozen: str) -> bool:
    """Record the opening of the truth for frozen answers.

    Parameters
    ----------
    folder : Path
        Folder of the truth.
    frozen : str
        Hash of the frozen answers.

    Returns
    -------
    bool
        Whether the answers were frozen before any opening.

    Raises
    ------
    BadProof
        There is no such folder, or its list is invalid.
    """
    path = folder / OPENED
    if not folder.is_dir():
        raise BadProof(f"{folder}: there is no such folder; name that of the truth with --truth")
    if frozen not in _openings(path):
        with sole_use(folder, of="vlab prove", wait=True):
            known = _openings(path)
            if frozen not in known:
                write_json(path, [*known, frozen])
    return bool(_openings(path)[0] == frozen)


def _openings(path: Path) -> list[Any]:
    known = read_json(path) if path.exists() else []
    if not isinstance(known, list):
        raise BadProof(f"{path}: not a list of the answers that the truth was opened for; restore it")
    return known


def open_truth(folder: Path, commitments: dict[str, Any], names: Iterable[str]) -> tuple[dict[str, Any], list[str]]:
    """Return the checked truth of some cases, and the plan.

    Parameters
    ----------
    folder : Path
        Folder of the truth.
    commitments : dict
        Commitments of the cases.
    names : iterable of str
        Names of the cases.

    Returns
    -------
    (dict, list of str)
        Truths by name, and cases whose truth was regenerated after the loss of its salt (`regenerate_cases`). The
        latter count only after their recordings are made again.

    Raises
    ------
    BadProof
        A truth is missing or differs from its commitment.
    """
    path = folder / PLAN
    out = {"plan": opened(read_json(path), commitments["plan"], where=str(path))}
    remade = []
    for name in names:
        path, committed = folder / f"{name}.json", commitments["cases"][name]
        kept = read_json(path)
        if is_made_again(kept):
            if kept["recordings"] != committed["recordings"]:
                raise BadProof(
                    f"{path}: this truth was made again with other recordings than those that were committed to"
                )
            out[name] = kept["truth"]
            remade.append(name)
        else:
            out[name] = opened(kept, committed["truth"], where=str(path))
    return out, remade


def check_remade(
    truths: Mapping[str, Any],
    commitments: dict[str, Any],
    names: Sequence[str],
    out: Path,
    engine: str,
    jobs: int,
    scheduler: str,
    progress: Callable[[int, int], None],
) -> None:
    """Check truths without salts by regenerated recordings.

    Parameters
    ----------
    truths : mapping
        Truths by name, and the plan.
    commitments : dict
        Commitments of the cases.
    names : sequence of str
        Cases without salt, from `open_truth`.
    out : Path
        Folder of the answers, exclusive to this process.
    engine : str
        Engine of `vlab.proof.campaign.run_all`.
    jobs : int
        Number of processes; 0 for all cores.
    scheduler : str
        Address of a dask scheduler.
    progress : callable
        Receives the numbers of completed and of all cases.

    Raises
    ------
    BadProof
        The recordings differ from their commitments, or the truth from the kept one.
    """
    if not names:
        return
    scratch = out / REMADE
    shutil.rmtree(scratch, ignore_errors=True)  # left by a killed run; this process owns the folder
    scratch.mkdir()
    try:
        made = make_again(truths["plan"], commitments, names, scratch, engine=engine, jobs=jobs, scheduler=scheduler)
        for done, (name, found) in enumerate(made):
            if canonical(found) != canonical(truths[name]):
                raise BadProof(
                    f"{name}: the truth has no salt and is not what comes out when its recordings are made again; restore it, or "
                    "make it again with vlab conceal --again --with-truth"
                )
            shutil.rmtree(scratch / name)
            progress(done + 1, len(names))
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
