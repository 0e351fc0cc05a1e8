"""Test plan: several records in one file, performed into one case.

A plan is a TOML file. ``[settings]`` holds common settings, every ``[[record]]`` its own, both with the names of
`RunSettings` (``run.toml``). A record also has a name and a role. ``[model]`` describes the case's model. File names
are relative to the working directory, as on the command line. A plan runs only code that the user named in addition.

A record is written atomically, so an interrupted plan continues with the next record. The manifest binds every record's
settings and files by hash. A record is never performed twice, nor under changed settings. A concealed plan stores
effects and their hashes in a separate folder.
"""

import hashlib
import json
import re
import shutil
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field, fields
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from vlab import __version__
from vlab.errors import BadExperiment, BadRecording, OutputRefused, VlabError, unknown_name
from vlab.files.examples import located
from vlab.files.output_folder import MANIFEST, folder_beside, output_folder
from vlab.files.plain_text import read_plain_text
from vlab.files.toml import Reader
from vlab.lab.run_folder import DoneRun, PreparedRun, RunSettings, StoredSettings, load_run, perform
from vlab.recordings.bound import RECORDING, check_run, stated_hash
from vlab.recordings.files import written_whole

CASE, TRUTH = "case.toml", "truth.json"
"""Names of the case file and of the concealed truth."""
SHARED = ("structure", "variant", "hardware")
"""Settings common to all records of a case."""
OF_EXCITATION = ("level", "low_hz", "high_hz", "period_s", "odd")
"""Settings of an excitation. A record with another excitation than ``[settings]`` takes none of them from there."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")
_FILE = re.compile(r"^(.+?\.(?:toml|py))(?=$|:)")
_RESERVED = (CASE, MANIFEST, "structure.toml", "hardware.toml")


@dataclass(frozen=True, kw_only=True)
class PlannedRecord(StoredSettings):
    """``[[record]]``: settings of a run with name and role."""

    name: str
    role: Literal["fit", "holdout"]

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name) or self.name in _RESERVED:
            raise BadExperiment(
                f"the record's name {self.name!r} cannot be that of its folder; accepted: letters, digits, - _ and ."
            )

    @property
    def settings(self) -> StoredSettings:
        """Settings without name and role."""
        return StoredSettings(**{f.name: getattr(self, f.name) for f in fields(RunSettings)})


@dataclass(frozen=True, kw_only=True)
class PlannedModel:
    """``[model]``: model of the case.

    Plant and variant default to those of the settings.
    """

    plant: str = ""
    variant: str = ""
    uncertain: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Contents of a plan file.

    Parameters
    ----------
    concealed : bool
        Whether to omit effects from everything beside the recordings.
    """

    title: str
    record: tuple[PlannedRecord, ...]
    model: PlannedModel = field(default_factory=PlannedModel)
    concealed: bool = False

    def __post_init__(self) -> None:
        names = [record.name.lower() for record in self.record]  # some file systems ignore case
        for record in self.record:
            if names.count(record.name.lower()) > 1:
                raise BadExperiment(f"two records are called {record.name!r}; their folders would be one")
            for key in SHARED:
                if getattr(record, key) != getattr(self.record[0], key):
                    raise BadExperiment(
                        f"record {record.name!r} has {key} = {getattr(record, key)!r}, record {self.record[0].name!r} "
                        f"has {getattr(self.record[0], key)!r}; the records of one case share it: make two plans"
                    )

    @property
    def seconds(self) -> float:
        """Simulated time of all records [s]."""
        return sum(record.seconds for record in self.record)

    def model_table(self) -> dict[str, Any]:
        """Return the case's model table.

        File names refer to the originals, before copying.
        """
        first = self.record[0]
        table = {"structure": first.structure, "plant": self.model.plant or first.plant}
        table |= {"variant": self.model.variant or first.variant, "hardware": first.hardware}
        return {key: value for key, value in table.items() if value} | {"uncertain": dict(self.model.uncertain)}

    def prepare(self, *, code: Collection[str] = ()) -> list[PreparedRun]:
        """Build every run, so that an error precedes the first start.

        Parameters
        ----------
        code : collection of str
            Python files and entry points that the user named; a plan runs no further code.

        Returns
        -------
        list of PreparedRun
            Prepared runs in order.

        Raises
        ------
        BadExperiment
            A record cannot run as planned; the message has its name.
        """
        out = []
        for record in self.record:
            try:
                prepared = record.settings.prepare(code=code)
            except VlabError as error:
                raise BadExperiment(f"record {record.name!r}: {error}") from error
            out.append(prepared.concealed() if self.concealed else prepared)
        return out


def load_plan(path: Path | str) -> Plan:
    """Load a plan strictly.

    An unknown key is refused with the accepted keys.

    Parameters
    ----------
    path : Path or str
        Plan file.

    Returns
    -------
    Plan
        Plan.

    Raises
    ------
    BadExperiment
        The file is malformed or has no records, a key is unknown or missing, or a value has the wrong kind.
    """
    reader = Reader(located(path), provenance_required=False, error=BadExperiment)
    raw = reader.load()
    accepted = ("title", "concealed", "settings", "model", "record")
    for key in raw:
        if key not in accepted:
            raise reader.fail("", str(unknown_name("key", key, accepted)))
    shared, records = raw.get("settings", {}), raw.get("record", [])
    if not isinstance(shared, Mapping):
        raise reader.fail("settings", "a table was expected: [settings]")
    for key in ("name", "role"):
        if key in shared:
            raise reader.fail(f"settings.{key}", "every record has its own; give it in [[record]]")
    if not isinstance(records, list) or not records or not all(isinstance(r, Mapping) for r in records):
        raise reader.fail("record", "the plan has no records; write [[record]] with name and role for each")
    reader.table(PlannedRecord, {"structure": "", "name": "settings", "role": "fit", **shared}, "settings")
    tables = [{**_shared_with(record, shared), **record} for record in records]
    planned = tuple(reader.table(PlannedRecord, table, f"record[{i}]") for i, table in enumerate(tables))
    model = reader.table(PlannedModel, raw.get("model", {}), "model")
    title, concealed = raw.get("title", Path(path).stem), raw.get("concealed", False)
    if not isinstance(title, str) or not isinstance(concealed, bool):
        raise reader.fail("title" if not isinstance(title, str) else "concealed", "text and true or false are expected")
    try:
        return Plan(title=title, record=planned, model=model, concealed=concealed)
    except VlabError as error:
        raise reader.fail("", str(error)) from error


def _shared_with(record: Mapping[str, Any], shared: Mapping[str, Any]) -> dict[str, Any]:
    """Return the common settings that a record takes.

    Settings of the common excitation apply only to a record with the same excitation.
    """
    usual = shared.get("excite", RunSettings.excite)
    own = record.get("excite", usual) != usual
    return {key: value for key, value in shared.items() if not (own and key in OF_EXCITATION)}


# ---- performing it --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class PlanProgress:
    """Progress of a plan.

    Parameters
    ----------
    share : float
        Share of the simulated time done, 0 to 1.
    record : str
        Record in progress.
    """

    share: float
    record: str


@dataclass(frozen=True, kw_only=True)
class DonePlan:
    """Performed and earlier records."""

    performed: tuple[str, ...]
    kept: tuple[str, ...]


def perform_plan(
    plan: Plan,
    folder: Path,
    *,
    code: Collection[str] = (),
    views: Callable[[Path, DoneRun], None] = lambda folder, done: None,
    progress: Callable[[PlanProgress], None] = lambda progress: None,
) -> DonePlan:
    """Perform a folder's missing records and write the case.

    Parameters
    ----------
    plan : Plan
        Loaded plan.
    folder : Path
        Output folder.
    code : collection of str
        Python files and entry points that the user named, see `Plan.prepare`.
    views : callable
        Writer of views into a record's folder. A concealed plan writes none, because views show more than the sensors.
    progress : callable
        Called with the progress.

    Returns
    -------
    DonePlan
        Performed and earlier records.

    Raises
    ------
    OutputRefused
        The folder belongs to another plan or to nobody's plan, or its records have other settings.
    BadExperiment
        A record cannot run as planned; no record was performed.
    KeyboardInterrupt
        Interruption; the message counts the complete records.
    """
    prepared = plan.prepare(code=code)
    done = _bind(plan, folder)
    performed, seconds = [], sum(r.seconds for r in plan.record if r.name in done)
    try:
        for record, run in zip(plan.record, prepared, strict=True):
            if record.name in done:
                continue
            _perform(record, run, folder, seconds / plan.seconds, plan, views, progress)
            performed.append(record.name)
            seconds += record.seconds
    except KeyboardInterrupt:
        whole = len(done) + len(performed)
        raise KeyboardInterrupt(
            f"{whole} of {len(plan.record)} records are whole in {folder}; the same command goes on from there"
        ) from None
    _write_case(plan, folder)
    return DonePlan(performed=tuple(performed), kept=tuple(done))


def _perform(
    record: PlannedRecord,
    run: PreparedRun,
    folder: Path,
    share: float,
    plan: Plan,
    views: Callable[[Path, DoneRun], None],
    progress: Callable[[PlanProgress], None],
) -> None:
    def report(done_s: float) -> None:
        progress(PlanProgress(share=share + done_s / plan.seconds, record=record.name))

    report(0.0)
    with output_folder(folder / record.name, overwrite=True) as fresh:
        done = perform(run, fresh, progress=report)
        if not plan.concealed:
            views(fresh, done)
        done.finish(fresh)


def _bind(plan: Plan, folder: Path) -> tuple[str, ...]:
    """Bind the folder to the plan's settings.

    A bound folder is checked. The result lists the complete records.
    """
    bound = {record.name: _binding(record.settings) for record in plan.record}
    public = {name: _without_effects(binding) for name, binding in bound.items()} if plan.concealed else bound
    truth = folder_beside(folder, "{}-truth") / TRUTH
    if folder.is_dir() and any(folder.iterdir()):
        manifest = _read_json(folder / MANIFEST) if (folder / MANIFEST).exists() else {}
        if manifest.get("written_by") != "vlab" or manifest.get("verb") != "plan":
            raise OutputRefused(f"the folder {folder} holds files of no plan; name an empty or new one with --out")
        if bool(manifest.get("concealed")) != plan.concealed:
            raise OutputRefused(f"{folder} was begun with concealed = {not plan.concealed}; name another with --out")
        earlier = manifest["records"]
        if plan.concealed:
            if not truth.is_file():
                raise OutputRefused(f"{truth} is missing: it binds what {folder} conceals; name another with --out")
            earlier = _read_json(truth)["records"]
        _check_same(earlier, bound, folder)
    elif folder.exists() and not folder.is_dir():
        raise OutputRefused(f"the output folder {folder} is a file; name another folder with --out")
    elif plan.concealed and truth.exists():
        raise OutputRefused(f"{truth} is the truth of an earlier plan and would be lost; name another with --out")
    content: dict[str, Any] = {"written_by": "vlab", "verb": "plan", "vlab": __version__, "title": plan.title}
    content |= {"concealed": plan.concealed, "records": public}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if plan.concealed:
            truth.parent.mkdir(exist_ok=True)
            _write_json(truth, {"written_by": "vlab", "of": folder.name, "records": bound})
    except OSError as error:
        raise OutputRefused(f"the output folder {folder} cannot be written: {error.strerror or error}") from error
    _write_json(folder / MANIFEST, content)
    return tuple(record.name for record in plan.record if _is_whole(folder / record.name))


def _binding(settings: RunSettings) -> dict[str, Any]:
    """Return the inputs that determine a record's bits.

    The inputs are settings, files and versions, with a hash of all.
    """
    values = json.loads(json.dumps(asdict(settings)))
    words = [word for value in values.values() for word in (value if isinstance(value, list) else [value])]
    named = [m[1] for m in (_FILE.match(word) for word in words if isinstance(word, str)) if m is not None]
    files = {name: hashlib.sha256(Path(name).read_bytes()).hexdigest() for name in named if Path(name).is_file()}
    versions = {"vlab": __version__, "mujoco": metadata.version("mujoco")}
    bound: dict[str, Any] = {"settings": values, "files": files, "versions": versions}
    return bound | {"sha256": _digest(bound)}


def _without_effects(binding: Mapping[str, Any]) -> dict[str, Any]:
    """Return a binding without effects, in the hash as well."""
    effects = " ".join(binding["settings"]["effect"])
    bound = {
        "settings": {key: value for key, value in binding["settings"].items() if key != "effect"},
        "files": {name: digest for name, digest in binding["files"].items() if name not in effects},
        "versions": binding["versions"],
    }
    return bound | {"sha256": _digest(bound)}


def _digest(bound: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(bound, sort_keys=True).encode()).hexdigest()


def _check_same(earlier: Mapping[str, Any], bound: Mapping[str, Any], folder: Path) -> None:
    """Refuse settings that differ from the folder's."""
    fix = f"name another folder with --out, or delete {folder}"
    for name, before in earlier.items():
        if name not in bound:
            raise OutputRefused(f"{folder} was begun with a record {name!r} that the plan has no more; {fix}")
        now = bound[name]
        if before["sha256"] == now["sha256"]:
            continue
        for part in ("settings", "files", "versions"):
            for key in sorted({*before[part], *now[part]}):
                was, given = before[part].get(key), now[part].get(key)
                if was != given:
                    what = {"settings": "", "files": "the file ", "versions": "version of "}[part] + key
                    said = "has other content" if part == "files" else f"was {was!r} and is {given!r}"
                    raise OutputRefused(
                        f"{folder} was begun with other settings: record {name!r}: {what} {said}; {fix}"
                    )
        raise OutputRefused(f"{folder / MANIFEST}: its hash of record {name!r} is not that of its settings; {fix}")


def _is_whole(folder: Path) -> bool:
    """Return whether a folder holds an intact record."""
    try:
        check_run(folder)
    except BadRecording:
        return False
    return stated_hash(folder) is not None


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(read_plain_text(path))
    except (OSError, ValueError) as error:
        raise OutputRefused(f"{path} cannot be read, so nothing is known of its folder: {error}") from error
    if not isinstance(content, dict) or not isinstance(content.get("records", {}), dict):
        raise OutputRefused(f"{path} is not what vlab wrote; name another folder with --out")
    return content


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    with written_whole(path) as stream:
        stream.write((json.dumps(content, indent=2, sort_keys=True) + "\n").encode())


# ---- the case -------------------------------------------------------------------------------------------------------


def _write_case(plan: Plan, folder: Path) -> None:
    """Write the case of the records.

    The recorded forces drive the model, with or without a law.
    """
    model = plan.model_table()
    for key in ("structure", "hardware"):
        if str(model.get(key, "")).endswith(".toml"):
            shutil.copyfile(model[key], folder / f"{key}.toml")
            model[key] = f"{key}.toml"
    uncertain = model.pop("uncertain")
    lines = [f"title = {json.dumps(plan.title)}", "", "[model]", *_lines(model)]
    if uncertain:
        lines += ["", "[model.uncertain]", *_lines(uncertain)]
    for record in plan.record:
        recording = load_run(folder / record.name)[0]
        table = {"name": record.name, "file": f"{record.name}/{RECORDING}", "role": record.role, "time": "time"}
        said = json.dumps(record.hardware_values)
        lines += ["", *([f"# its hardware had {said}, the case's has not"] if record.hardware_values else [])]
        lines += ["[[recording]]", *_lines(table)]
        for channel in recording.channels:
            drives = channel.kind == "force" and bool(recording[channel.name].any())
            if not drives and channel.kind in ("force", "command", "excitation"):
                continue
            at = channel.at if drives else channel.name
            table = {"column": channel.name, "at": at, "kind": channel.kind, "unit": channel.unit}
            lines += ["[[recording.channel]]", *_lines(table)]
            lines += ["input = true", 'hold = "zero"'] if drives else []  # inputs are means over each sample
    with written_whole(folder / CASE) as stream:
        stream.write(("\n".join(lines) + "\n").encode())


def _lines(table: Mapping[str, Any]) -> list[str]:
    """Return the lines of a flat table.

    JSON's text, numbers and truth values are valid TOML.
    """
    return [f"{json.dumps(key) if ':' in key else key} = {json.dumps(value)}" for key, value in table.items()]
