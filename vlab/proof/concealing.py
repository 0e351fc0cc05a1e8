"""Making a folder of concealed cases and, apart from it, the sealed truth."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from vlab.errors import BadExperiment, BadProof
from vlab.outputs import output_folder, write_manifest
from vlab.proof.campaign import run_all
from vlab.proof.sealing import COMMITMENTS, FORMAT, folder_digest, opened, read_json, sealed, write_json
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
    items = _items(suites, count, seed)
    names = [name for _, _, name in items]
    with output_folder(truth_folder(out)) as truths, output_folder(out) as cases:
        work = partial(_one, folder=cases.resolve(), benches=tuple(benches), seed=seed)
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


def regenerate_cases(
    sealed_cases: Path,
    out: Path,
    *,
    truth: Path | None = None,
    engine: str = "joblib",
    jobs: int = 0,
    scheduler: str = "",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, str]:
    """Make the recordings of sealed cases again from their seed; return the commitment of every case.

    Parameters
    ----------
    sealed_cases : Path
        A folder with commitments; its recordings need not be there any more.
    truth : Path, optional
        Where the truth is, which holds the seed.

    Raises
    ------
    BadProof
        The plan is not what was committed to, or a recording comes out with other bits.
    """
    document = read_json(sealed_cases / COMMITMENTS)
    path = (truth or truth_folder(sealed_cases)) / "plan.json"
    plan = opened(read_json(path), document["plan"], where=str(path))
    items = _items(plan["suites"], len(document["cases"]), plan["seed"])
    with output_folder(out) as cases:
        work = partial(_one, folder=cases.resolve(), benches=tuple(plan["benches"]), seed=plan["seed"])
        for done, (name, _) in enumerate(run_all(work, items, engine=engine, jobs=jobs, scheduler=scheduler)):
            if folder_digest(cases / name) != document["cases"][name]["recordings"]:
                raise BadProof(
                    f"{name}: the recordings come out with other bits than those that were sealed; "
                    "use the versions of vlab, numpy and scipy that made them"
                )
            progress(done + 1, len(items))
        write_json(cases / COMMITMENTS, document)
        write_manifest(cases, verb="conceal")
    return {name: kept["truth"] for name, kept in document["cases"].items()}


def _items(suites: Sequence[str], count: int, seed: int) -> list[tuple[int, str, str]]:
    """Return index, suite and name of every case."""
    order = drawn_suites(suites, count, seed)
    return [(i, suite, f"case-{i + 1:0{max(3, len(str(count)))}d}") for i, suite in enumerate(order)]


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
