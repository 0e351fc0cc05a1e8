"""Making a folder of concealed cases and, apart from it, the sealed truth."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from vlab.errors import BadExperiment
from vlab.outputs import output_folder, write_manifest
from vlab.proof.campaign import run_all
from vlab.proof.sealing import COMMITMENTS, FORMAT, folder_digest, sealed, write_json
from vlab.proof.suites import BENCHES, check_benches, drawn_suites, make_case
from vlab.proof.writing import write_case

MOST_CASES = 100_000


def truth_folder(folder: Path) -> Path:
    """Return where the truth of a folder of cases is kept: beside it."""
    return folder.with_name(f"{folder.name}-truth")


def conceal_cases(
    out: Path,
    *,
    suites: Sequence[str],
    count: int,
    seed: int,
    benches: Sequence[str] = tuple(BENCHES),
    engine: str = "joblib",
    jobs: int = 0,
    scheduler: str = "",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, str]:
    """Conceal cases; return the commitment of every case.

    Parameters
    ----------
    out : Path
        Folder of the recordings; the truth goes to `truth_folder`.
    suites : sequence of str
        Names of suites or mixtures.

    Raises
    ------
    BadExperiment
        A count, seed or bench that makes no sense.
    OutputRefused
        A folder cannot be written.
    """
    if not 1 <= count <= MOST_CASES:
        raise BadExperiment(f"{count} cases cannot be made; accepted: 1 to {MOST_CASES}")
    if seed < 0:
        raise BadExperiment(f"the seed is {seed}; accepted: 0 or more")
    check_benches(benches)
    order = drawn_suites(suites, count, seed)
    names = [f"case-{i + 1:0{max(3, len(str(count)))}d}" for i in range(count)]
    items = [(i, suite, name) for i, (suite, name) in enumerate(zip(order, names, strict=True))]
    with output_folder(truth_folder(out)) as truths, output_folder(out) as cases:
        work = partial(_one, folder=cases, benches=tuple(benches), seed=seed)
        found: dict[str, dict[str, Any]] = {}
        for done, (name, truth) in enumerate(run_all(work, items, engine=engine, jobs=jobs, scheduler=scheduler)):
            found[name] = truth
            progress(done + 1, count)
        commitments = {name: _seal(truths / f"{name}.json", found[name]) for name in names}
        plan = _seal(truths / "plan.json", {"seed": seed, "suites": list(suites), "benches": list(benches)})
        document = {
            "format": FORMAT,
            "cases": {n: {"truth": commitments[n], "recordings": folder_digest(cases / n)} for n in names},
            "plan": plan,
        }
        write_json(cases / COMMITMENTS, document)
        write_manifest(cases, verb="conceal")
        write_manifest(truths, verb="conceal", seed=seed, suites=list(suites), benches=list(benches))
    return commitments


def _one(
    item: tuple[int, str, str], *, folder: Path, benches: tuple[str, ...], seed: int
) -> tuple[str, dict[str, Any]]:
    index, suite, name = item
    case = make_case(suite, benches, seed, index)
    write_case(case, folder / name)
    return name, {"case": name, **case.truth}


def _seal(path: Path, truth: dict[str, Any]) -> str:
    kept, commitment = sealed(truth)
    write_json(path, kept)
    return commitment
