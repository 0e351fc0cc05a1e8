"""Opening the truth: by the salt of its commitment, or by making the recordings again that it says it came with."""

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from vlab.errors import BadProof
from vlab.files.locks import sole_use
from vlab.proof.conceal import make_again
from vlab.proof.seal import canonical, is_made_again, opened, read_json, write_json

REMADE = ".remade"
"""In the answers' folder while truths without salts are checked: their recordings, made again."""
OPENED = "opened.json"
"""In the folder of the truth: hashes of the frozen answers for which it was opened, the first ones first."""


def note_opening(folder: Path, frozen: str) -> bool:
    """Write down for which answers the truth is opened; return whether these were frozen before it was ever opened.

    Raises
    ------
    BadProof
        There is no such folder, or its list is not one.
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
    """Return the truth of some cases by name, and the plan, after checking them against their commitments.

    Returns
    -------
    truths : dict
    made_again : list of str
        Cases whose truth says that it was made again from the seed of the plan because its salt was lost (`regenerate_cases`). It is
        not to be believed before the recordings that come with it are made again.

    Raises
    ------
    BadProof
        A truth is missing or is not what was committed to.
    """
    path = folder / "plan.json"
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
    """Make cases whose truth has no salt again, and refuse a truth that is not what their seed conceals.

    Parameters
    ----------
    truths : mapping
        By name of the case, and the plan.
    names : sequence of str
        Of the cases, as `open_truth` returns them.
    out : Path
        Folder of the answers, which this process has to itself.

    Raises
    ------
    BadProof
        The recordings come out with other bits than those that were committed to, or with another truth than the one kept.
    """
    if not names:
        return
    scratch = out / REMADE
    shutil.rmtree(scratch, ignore_errors=True)  # of a run that was killed: this one has the folder to itself
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
