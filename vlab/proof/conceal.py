"""Folder of concealed cases, with the sealed truth apart."""

import contextlib
import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from vlab.errors import BadExperiment, BadProof
from vlab.files.locks import sole_use
from vlab.files.output_folder import folder_beside, output_folder, write_manifest
from vlab.proof.campaign import common_instructions, run_all
from vlab.proof.case_folder import write_case
from vlab.proof.manifest import generator_digest
from vlab.proof.pack import is_pack, read_pack
from vlab.proof.seal import (
    COMMITMENTS,
    FORMAT,
    PLAN,
    committed,
    folder_digest,
    made_again,
    opened,
    read_json,
    sealed,
    truth_folder,
    write_json,
)
from vlab.proof.suites import BENCHES, OWN_FE, SHARED_FE, check_benches, check_source, drawn_suites, make_case

MOST_CASES = 100_000
SEED_BITS = 128
"""SEED_BITS [bits]: length of a drawn seed. Commands follow from the seed without noise, so a search could find a short
one."""


def conceal_cases(
    out: Path,
    *,
    suites: Sequence[str],
    count: int,
    seed: int | None = None,
    benches: Sequence[str] = BENCHES,
    structures: str = OWN_FE,
    engine: str = "joblib",
    jobs: int = 0,
    scheduler: str = "",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[dict[str, str], int]:
    """Conceal cases; return commitments and seed.

    An interrupted run keeps its cases in `unfinished_folder`. The same call continues from there.

    Parameters
    ----------
    out : Path
        Folder of the recordings; the truth goes to `truth_folder`.
    suites : sequence of str
        Names of suites or mixtures.
    count : int
        Number of cases.
    seed : int, optional
        Seed; that of the interrupted run by default, or a fresh one.
    benches : sequence of str
        Names of the benches.
    structures : str
        Source of beam and grid, one of `vlab.proof.suites.SOURCES`.
    engine : str
        Engine of `vlab.proof.campaign.run_all`.
    jobs : int
        Number of processes; 0 for all cores.
    scheduler : str
        Address of a dask scheduler.
    progress : callable
        Receives the numbers of completed and of all cases.

    Returns
    -------
    (dict, int)
        Commitment of every case, and the seed.

    Raises
    ------
    BadExperiment
        A count, seed, bench or source is invalid, or the plan differs from that of the interrupted run.
    OutputRefused
        A folder cannot be written, or another process conceals cases there.
    """
    if not 1 <= count <= MOST_CASES:
        raise BadExperiment(f"{count} cases cannot be made; accepted: 1 to {MOST_CASES}")
    if seed is not None and seed < 0:
        raise BadExperiment(f"the seed is {seed}; accepted: 0 or more")
    check_benches(benches)
    check_source(structures)
    drawn_suites(suites, count, 0)  # refuse unknown names before any output
    begun = unfinished_folder(out)
    _keep_sealed(out)
    with sole_use(begun, of="vlab conceal"):
        _keep_sealed(out)  # by the previous process
        try:
            plan = {"suites": list(suites), "benches": list(benches), "count": count, "structures": structures}
            return _conceal(out, begun, plan, seed, engine, jobs, scheduler, progress)
        finally:
            if (out / COMMITMENTS).exists() or not any((begun / "truth").glob("*")):  # nothing to continue
                shutil.rmtree(begun, ignore_errors=True)


def _conceal(
    out: Path,
    begun: Path,
    wanted: dict[str, Any],
    seed: int | None,
    engine: str,
    jobs: int,
    scheduler: str,
    progress: Callable[[int, int], None],
) -> tuple[dict[str, str], int]:
    """Make the missing cases of an unfinished folder, and seal all."""
    with output_folder(truth_folder(out)) as truths, output_folder(out) as cases:
        plan = _begin(begun, wanted, seed)
        items = _items(plan["suites"], plan["count"], plan["seed"])
        left = [item for item in items if not _is_whole(begun, item[2])]
        progress(len(items) - len(left), len(items))
        work = partial(_one_kept, folder=begun.resolve(), **_drawn_from(plan))
        made = run_all(work, left, engine=engine, jobs=jobs, scheduler=scheduler, environment=common_instructions())
        for done, _ in enumerate(made):
            progress(len(items) - len(left) + done + 1, len(items))
        commitments = {n: _seal(truths / f"{n}.json", read_json(begun / "truth" / f"{n}.json")) for _, _, n in items}
        for name in commitments:
            os.replace(begun / "cases" / name, cases / name)
        known = {key: plan[key] for key in ("seed", "suites", "benches", "generator", "count", "structures")}
        document = {
            "format": FORMAT,
            "cases": {n: {"truth": c, "recordings": folder_digest(cases / n)} for n, c in commitments.items()},
            "plan": _seal(truths / PLAN, known),
        }
        write_json(cases / COMMITMENTS, document)
        write_manifest(cases, verb="conceal")
        write_manifest(truths, verb="conceal", **known)
    return commitments, plan["seed"]


def _keep_sealed(out: Path) -> None:
    """Refuse to overwrite sealed cases, which may have answers.

    Raises
    ------
    BadExperiment
        Sealed cases exist.
    """
    if (out / COMMITMENTS).exists():
        raise BadExperiment(f"{out} holds sealed cases; name another folder with --out, or remove it and its truth")


def unfinished_folder(out: Path) -> Path:
    """Return the hidden folder of unfinished cases."""
    return folder_beside(out, ".{}-unfinished")


def _begin(folder: Path, wanted: dict[str, Any], seed: int | None) -> dict[str, Any]:
    """Return the plan of the cases of a folder, begun if necessary.

    Raises
    ------
    BadExperiment
        The folder was begun with another plan or generator.
    """
    path = folder / "plan.json"
    wanted = {**wanted, "generator": generator_digest()}
    if path.exists():
        plan: dict[str, Any] = read_json(path)
        for key, value in ({**wanted, "seed": seed} if seed is not None else wanted).items():
            if plan.get(key) != value:
                raise BadExperiment(
                    f"{folder} holds cases begun with another {key}; "
                    "repeat the command they were begun with, name another folder with --out, or remove that folder"
                )
        return plan
    for inside in ("cases", "truth"):
        (folder / inside).mkdir(parents=True, exist_ok=True)
    folder.chmod(0o700)
    plan = {**wanted, "seed": secrets.randbits(SEED_BITS) if seed is None else seed}
    write_json(path, plan)
    return plan


def _is_whole(begun: Path, name: str) -> bool:
    """Return whether an unfinished folder holds a case with its truth."""
    return (begun / "truth" / f"{name}.json").exists() and (begun / "cases" / name).exists()


def _drawn_from(plan: Mapping[str, Any]) -> dict[str, Any]:
    """Return benches, seed and source of the structures.

    Plans without a source have the FE code of the plants.
    """
    structures = plan.get("structures", SHARED_FE)
    return {"benches": tuple(plan["benches"]), "seed": plan["seed"], "structures": structures}


def _one_kept(item: tuple[int, str, str], *, folder: Path, benches: tuple[str, ...], seed: int, structures: str) -> str:
    """Make a case in an unfinished folder, truth last."""
    name = item[2]
    (folder / "truth" / f"{name}.json").unlink(missing_ok=True)
    shutil.rmtree(folder / "cases" / name, ignore_errors=True)
    _, truth = _one(item, folder=folder / "cases", benches=benches, seed=seed, structures=structures)
    write_json(folder / "truth" / f"{name}.json", truth)
    return name


def regenerate_cases(
    sealed_cases: Path,
    out: Path,
    *,
    only: Sequence[str] = (),
    truth: Path | None = None,
    with_truth: bool = False,
    engine: str = "joblib",
    jobs: int = 0,
    scheduler: str = "",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, str]:
    """Make recordings of sealed cases again from their seed.

    Parameters
    ----------
    sealed_cases : Path
        Folder with commitments, whose recordings may be missing; or a file of `vlab.proof.pack`.
    out : Path
        Folder of the new recordings.
    only : sequence of str
        Names of the cases; all by default.
    truth : Path, optional
        Folder of the truth, which holds the seed; of a packed campaign, the file itself.
    with_truth : bool
        Whether to write the truth to the `truth_folder` of `out`, after its salts were lost.
    engine : str
        Engine of `vlab.proof.campaign.run_all`.
    jobs : int
        Number of processes; 0 for all cores.
    scheduler : str
        Address of a dask scheduler.
    progress : callable
        Receives the numbers of completed and of all cases.

    Returns
    -------
    dict
        Commitments of the cases.

    Raises
    ------
    BadProof
        The plan or a recording differs from its commitment.
    BadExperiment
        There is no such case.
    """
    document, kept, where = _sealed_plan(sealed_cases, truth)
    _keep_sealed(out)
    plan = opened(kept, document["plan"], where=where)
    unknown = sorted(set(only) - set(document["cases"]))
    if unknown:
        names = sorted(document["cases"])
        raise BadExperiment(f"{sealed_cases} has no case {unknown[0]!r}; accepted: {names[0]} to {names[-1]}")
    names = [name for name in sorted(document["cases"]) if not only or name in only]
    with contextlib.ExitStack() as folders:
        truths = folders.enter_context(output_folder(truth_folder(out))) if with_truth else None
        cases = folders.enter_context(output_folder(out))
        made = make_again(plan, document, names, cases, engine=engine, jobs=jobs, scheduler=scheduler)
        for done, (name, found) in enumerate(made):
            if truths is not None:
                write_json(truths / f"{name}.json", made_again(found, document["cases"][name]["recordings"]))
            progress(done + 1, len(names))
        if truths is not None:
            write_json(truths / PLAN, kept)
        document = {**document, "cases": {name: document["cases"][name] for name in names}}
        write_json(cases / COMMITMENTS, document)
        write_manifest(cases, verb="conceal")
    return {name: kept["truth"] for name, kept in document["cases"].items()}


def _sealed_plan(sealed_cases: Path, truth: Path | None) -> tuple[dict[str, Any], Any, str]:
    """Return commitments, sealed plan, and the place of the plan."""
    if is_pack(sealed_cases):
        campaign = read_pack(sealed_cases)
        return campaign.commitments, campaign.plan, f"{sealed_cases}: plan"
    document = committed(sealed_cases)
    path = (truth or truth_folder(sealed_cases)) / PLAN
    return document, read_json(path), str(path)


def make_again(
    plan: Mapping[str, Any],
    commitments: Mapping[str, Any],
    names: Sequence[str],
    folder: Path,
    *,
    engine: str = "joblib",
    jobs: int = 0,
    scheduler: str = "",
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Make sealed cases again from the seed of their plan.

    Parameters
    ----------
    plan : mapping
        Opened plan.
    commitments : mapping
        Document of the sealed folder; the recordings may be missing.
    names : sequence of str
        Names of the cases.
    folder : Path
        Receives the recordings.
    engine : str
        Engine of `vlab.proof.campaign.run_all`.
    jobs : int
        Number of processes; 0 for all cores.
    scheduler : str
        Address of a dask scheduler.

    Yields
    ------
    (name, truth)
        Case whose recordings match their commitment.

    Raises
    ------
    BadProof
        The plan has no such case, or a recording differs from its commitment.
    """
    # plans sealed without a count have all cases, or the last ones, in one folder
    count = plan.get("count") or max(int(name.rpartition("-")[2]) for name in commitments["cases"])
    items = {item[2]: item for item in _items(plan["suites"], count, plan["seed"])}
    for name in names:
        if name not in items:
            raise BadProof(f"{name}: the plan with its {count} cases has none of this name; restore the commitments")
    work = partial(_one, folder=folder.resolve(), **_drawn_from(plan))
    wanted = [items[name] for name in names]
    made = run_all(work, wanted, engine=engine, jobs=jobs, scheduler=scheduler, environment=common_instructions())
    with contextlib.closing(made):  # the first deviating case ends the work
        for name, found in made:
            if folder_digest(folder / name) != commitments["cases"][name]["recordings"]:
                raise BadProof(
                    f"{name}: the recordings come out with other bits than those that were sealed; "
                    + (
                        "the generator, numpy, scipy or the processor is another than that which made them"
                        if plan.get("generator", "") != generator_digest()
                        else "another processor may round otherwise"
                    )
                )
            yield name, found


def _items(suites: Sequence[str], count: int, seed: int) -> list[tuple[int, str, str]]:
    """Return index, suite and name of every case."""
    order = drawn_suites(suites, count, seed)
    return [(i, suite, f"case-{i + 1:0{max(3, len(str(count)))}d}") for i, suite in enumerate(order)]


def _one(
    item: tuple[int, str, str], *, folder: Path, benches: tuple[str, ...], seed: int, structures: str
) -> tuple[str, dict[str, Any]]:
    index, suite, name = item
    case = make_case(suite, benches, seed, index, structures=structures)
    write_case(case, folder / name)
    return name, {"case": name, **case.truth}


def _seal(path: Path, truth: dict[str, Any]) -> str:
    kept, commitment = sealed(truth)
    write_json(path, kept)
    return commitment
