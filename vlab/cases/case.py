"""Case: a model and measurements on the modelled structure.

A case is a TOML file: ``case.toml`` in its folder, or a file of any other name. Several cases can therefore share a
folder. Every file that a case names lies in the folder of the case file.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from vlab.cases.channel_map import Run, find_input, find_output, find_place, make_run, wire
from vlab.cases.description import CaseTable, ChannelTable, ModelTable, RecordingTable
from vlab.cases.in_memory import LABEL, in_memory_error, read_arrays, read_model
from vlab.cases.written_out import WrittenOut, check_file, labels_of, write_out
from vlab.errors import BadCase, VlabError, unknown_name
from vlab.files.arguments import checked
from vlab.files.examples import located
from vlab.files.text import one_line
from vlab.files.toml import Reader
from vlab.hardware import Hardware, load_hardware
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import effect_named
from vlab.plants.base import Plant
from vlab.plants.build import build_plant
from vlab.plants.mjcf import build_mjcf
from vlab.recordings import open_table
from vlab.recordings.assemble import on_even_stamps, to_recording
from vlab.recordings.selection import parse_where, select_rows
from vlab.recordings.table import READERS, Table
from vlab.structure.model import Structure
from vlab.structure.reader import BUILT_IN, load_structure

CASE = "case.toml"
"""CASE: name of the case file in its folder."""
_NAMED = {
    "body": ("mass", "inertia", "centre-of-mass", "length"),
    "geom": ("mass",),
    "joint": ("stiffness", "damping", "armature"),
    "tendon": ("stiffness", "damping", "armature"),
    "actuator": ("gain", "velocity-gain"),
    "sensor": ("gain",),
}
"""Uncertain quantities by type of element; a geom's mass is the mass of its body."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """A case with names that match its model.

    The recordings are read on request.

    Parameters
    ----------
    path : Path
        The case file.
    table : CaseTable
        Contents of the case file.
    plant : Plant
        Nominal model.
    hardware : Hardware or None
        Converters and amplifiers between law and structure; None for an MJCF model, with ideal converters.
    structure : Structure or None
        Structure from which the plant was built, if any.
    raw : mapping
        Contents of the case file, with shared channels, file patterns and episodes written out.
    allow_outside : bool
        Whether files outside the folder of the case may be read.
    notes : tuple of str
        Remarks on what was written out.
    shared : frozenset of str
        Columns of shared channels.
    in_memory : mapping of str to Table
        Recordings without a file, by the name that `table` gives them.
    """

    path: Path
    table: CaseTable
    plant: Plant
    hardware: Hardware | None
    structure: Structure | None = None
    raw: Mapping[str, Any] = field(default_factory=dict)
    allow_outside: bool = False
    notes: tuple[str, ...] = ()
    shared: frozenset[str] = frozenset()
    in_memory: Mapping[str, Table] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path | str, *, allow_outside: bool = False) -> "Case":
        """Load a case file, see `load_case`."""
        return load_case(path, allow_outside=allow_outside)

    @classmethod
    @checked(BadCase)
    def from_arrays(
        cls,
        model: Any,
        t: Any,
        inputs: Any,
        outputs: Any,
        *,
        uncertain: Mapping[str, float] | None = None,
        holdout: int | float | Sequence[int] | None = None,
        channels: Mapping[str, Mapping[str, Any] | str] | None = None,
        initial: str = "auto",
        title: str = "",
    ) -> "Case":
        """Make a case from arrays, in SI units.

        Kinds and units come from the actuators, sensors and joints of the model. Several runs are lists of the same
        length; `t` may be common to all.

        Parameters
        ----------
        model : MjModel, MjSpec, str or Path
            MuJoCo model or spec, XML text, MJCF or structure file, or ``"beam"`` or ``"grid"``. An `MjModel` must be
            the last one that MuJoCo loaded from XML, because a compiled model holds no source.
        t : (n,) array, str or None
            Times [s], even or uneven; name of a column; None for the index of a data frame.
        inputs : mapping or data frame
            Columns (n,) by name of an actuator or joint; None for a free motion. One data frame may be given for inputs
            and outputs: the model tells their columns apart.
        outputs : mapping or data frame
            Columns (n,) by name of a sensor or joint, (n, 3) for a vector sensor. NaN means no reading.
        uncertain : mapping of str to float
            Relative standard deviations of the model's quantities, as in ``[model.uncertain]``; none by default.
        holdout : int, float or sequence of int
            Runs that only verify, by number from 0; a float is the share of every run that is held out at its end. The
            default is the last run, or the last third of a single run.
        channels : mapping of str to mapping or str
            Keys of ``[[recording.channel]]`` by column, such as ``{"pos": {"at": "encoder", "unit": "mm"}}``; a text alone
            is the unit of the column.
        initial : str
            Initial state of the runs: ``"auto"``, ``"rest"`` or ``"estimated"``.
        title : str
            Title of the case.

        Returns
        -------
        Case
            Case without files.

        Raises
        ------
        BadCase, BadRecording, UnknownName
            Columns do not fit together or do not fit the model.
        BadStructure
            The model cannot be built.
        """
        named, plant, folder = read_model(model)
        path = folder / LABEL
        reader = Reader(path, provenance_required=False, error=BadCase)
        raw: dict[str, Any] = {"title": title, "model": {**named, "uncertain": dict(uncertain or {})}}
        hardware, structure = None, None
        if plant is None:
            plant, hardware, structure = _build(
                reader, reader.table(ModelTable, raw["model"], "model"), allow_outside=False
            )
        try:
            recordings, tables = read_arrays(
                plant, t, inputs, outputs, channels=channels or {}, holdout=holdout, initial=initial
            )
        except VlabError as error:
            raise in_memory_error(error) from error
        raw["recording"] = recordings
        written = WrittenOut(
            raw=raw,
            places=tuple(r["name"] for r in recordings),
            channels=tuple(tuple(f"{r['name']}: {c['column']}" for c in r["channel"]) for r in recordings),
        )
        try:
            table = reader.table(CaseTable, raw)
            _check_names(reader, table, plant, written)
            case = cls(
                path=path,
                table=table,
                plant=plant,
                hardware=hardware,
                structure=structure,
                raw=raw,
                in_memory=tables,
            )
            case.runs()  # what is wrong with the samples shows here
        except VlabError as error:
            raise in_memory_error(error, recordings) from error
        return case

    def __repr__(self) -> str:
        """Return title, model and recordings in one line."""
        names = [f"{name} ({table.role})" for name, table in self.recordings()]
        names += [
            f"{len(part)} {word}" for word, part in (("frf", self.table.frf), ("modal", self.table.modal)) if part
        ]
        model = self.table.model.mjcf or self.table.model.structure
        title = one_line(self.table.title or ("" if self.in_memory else self.path.parent.name))
        return f"<Case {f'{title!r} ' if title else ''}of {one_line(model)}: {', '.join(names)}>"

    @property
    def folder(self) -> Path:
        """Folder of all files of the case."""
        return self.path.parent

    def recordings(self, roles: Sequence[str] = ("fit", "holdout")) -> list[tuple[str, RecordingTable]]:
        """Return name and table of recordings by role.

        No file is read.
        """
        named = [(r.name or f"recording{i + 1}", r) for i, r in enumerate(self.table.recording)]
        return [(name, r) for name, r in named if r.role in roles]

    def with_recordings(self, tables: Iterable[RecordingTable]) -> "Case":
        """Return the case with other tables of its recordings, in order."""
        return replace(self, table=replace(self.table, recording=tuple(tables)))

    def with_uncertain(self, uncertain: Mapping[str, float]) -> "Case":
        """Return the case with further uncertain quantities of its model."""
        model = replace(self.table.model, uncertain={**self.table.model.uncertain, **uncertain})
        return replace(self, table=replace(self.table, model=model))

    def with_channels(self, changed: Callable[[RecordingTable], Iterable[ChannelTable]]) -> "Case":
        """Return the case with other channel tables.

        Parameters
        ----------
        changed : callable
            Returns the channel tables of a recording.
        """
        return self.with_recordings(replace(t, channel=tuple(changed(t))) for t in self.table.recording)

    def runs(self, roles: Sequence[str] = ("fit", "holdout")) -> list[Run]:
        """Read recordings by role and map their channels.

        Parameters
        ----------
        roles : sequence of str
            Roles of the recordings.

        Raises
        ------
        BadRecording
            A file is damaged or contradicts the case.
        BadCase
            The model cannot take a recording's inputs.
        """
        return [self._read(name, table) for name, table in self.recordings(roles)]

    def open_file(
        self, file: str, *, columns: Sequence[str] | None = None, blanks: Collection[str] = frozenset()
    ) -> Table:
        """Open a file that the case names.

        Parameters
        ----------
        file : str
            Name relative to the folder of the case.
        columns : sequence of str, optional
            Columns to read; all by default.
        blanks : collection of str
            Columns that may have blank cells.

        Returns
        -------
        Table
            Columns of the file.

        Raises
        ------
        BadRecording
            The file is damaged, or outside the folder without permission.
        """
        if file in self.in_memory:
            return self.in_memory[file]
        wanted = None if columns is None else list(dict.fromkeys(columns))
        if self.allow_outside:
            return open_table(self.folder / file, columns=wanted, blanks=blanks)
        return open_table(file, folder=self.folder, columns=wanted, blanks=blanks)

    def _read(self, name: str, table: RecordingTable) -> Run:
        columns = [channel.column for channel in table.channel]
        times = [name for name in (table.time, *(channel.time for channel in table.channel)) if name]
        conditions = parse_where(table.where) if table.where else ()
        compared = [condition.column for condition in conditions]
        file = self.open_file(table.file, columns=[*columns, *times, *compared], blanks=[*columns, *times])
        return read_run(self.plant, name, table, file, self.hardware)


def read_run(plant: Plant, name: str, table: RecordingTable, file: Table, hardware: Hardware | None = None) -> Run:
    """Label the columns of an open file and map the channels.

    Parameters
    ----------
    plant : Plant
        Plant.
    name : str
        Name of the run.
    table : RecordingTable
        Recording of the case file.
    file : Table
        Columns of the file.
    hardware : Hardware or None
        Hardware of the laboratory, if the case names one.

    Returns
    -------
    Run
        Recording with its channel map.

    Raises
    ------
    BadRecording
        The file contradicts the description.
    BadCase
        The model cannot take the inputs.
    """
    specs = [
        c.spec(label, time_unit=table.time_unit) for c, label in zip(table.channel, table.channel_names, strict=True)
    ]
    rows = select_rows(file, parse_where(table.where) if table.where else ())
    whole = to_recording(rows, specs, rate_hz=table.rate_hz, time=table.time, time_unit=table.time_unit)
    return make_run(plant, name, table, on_even_stamps(whole), hardware)


def load_case(path: Path | str, *, allow_outside: bool = False) -> Case:
    """Load a case and check its names against the model.

    Parameters
    ----------
    path : Path or str
        Folder or file of the case, or ``example:NAME`` of a case supplied with vlab.
    allow_outside : bool
        Whether the case may name files outside its folder.

    Returns
    -------
    Case
        The case; its recordings are not read yet.

    Raises
    ------
    BadCase
        The file is malformed, a key is unknown, a file is missing or outside the folder, or a name matches nothing.
    BadStructure
        The model cannot be built.
    """
    path = Path(located(path))
    is_folder = path.is_dir()
    if is_folder and not (path / CASE).exists():
        raise BadCase(f"{path}: there is no {CASE} in this folder; draft one: vlab init MODEL.xml LOG... --out {path}")
    if path.suffix.lower() in READERS and path.is_file():
        raise BadCase(
            f"{path}: this is a recording, and a case is a TOML file that names a model and recordings; "
            f"draft one: vlab init MODEL.xml {path}"
        )
    path = path / CASE if is_folder else path
    reader = Reader(path, provenance_required=False, error=BadCase)
    if is_folder and path.exists():  # a file that the user names directly may be a link
        check_file(reader, "", path.name)
    raw = reader.load()
    reader.label(labels_of(raw))
    written = write_out(raw, reader, allow_outside=allow_outside)
    with reader.placed(written.origins()):
        table = reader.table(CaseTable, written.raw)
    for where, recording in zip(written.places, table.recording, strict=True):
        check_file(reader, f"{where}.file", recording.file, allow_outside=allow_outside)
    for i, frf in enumerate(table.frf):
        check_file(reader, f"frf[{i}].file", frf.file, allow_outside=allow_outside)
    plant, hardware, structure = _build(reader, table.model, allow_outside=allow_outside)
    plant = _with_effects(reader, table, plant)
    _check_names(reader, table, plant, written)
    return Case(
        path=path,
        table=table,
        plant=plant,
        hardware=hardware,
        structure=structure,
        raw=written.raw,
        allow_outside=allow_outside,
        notes=written.notes,
        shared=written.shared,
    )


def _build(
    reader: Reader, model: ModelTable, *, allow_outside: bool
) -> tuple[Plant, Hardware | None, Structure | None]:
    folder = Path(reader.file).parent
    if model.mjcf:
        check_file(reader, "model.mjcf", model.mjcf, allow_outside=allow_outside)
        for key in ("hardware", "plant", "variant"):
            if getattr(model, key) != type(model).__dataclass_fields__[key].default:
                raise reader.fail(f"model.{key}", "this key belongs to a structure; an MJCF model is used as it is")
        if allow_outside:  # the model's own files still lie in its folder
            real = (folder / model.mjcf).resolve()
            return build_mjcf(real.name, folder=real.parent), None, None
        return build_mjcf(model.mjcf, folder=folder), None, None
    if model.structure in BUILT_IN:
        structure = load_structure(model.structure)
    elif model.structure.endswith(".toml"):
        check_file(reader, "model.structure", model.structure)
        structure = load_structure(folder / model.structure)
    else:
        known = [*BUILT_IN, "the name of a structure file in the case's folder"]
        raise reader.fail("model.structure", str(unknown_name("structure", model.structure, known)))
    if model.hardware:
        check_file(reader, "model.hardware", model.hardware)
    try:
        plant = build_plant(structure, model.plant, model.variant)
    except LookupError as error:
        raise reader.fail("model", str(error)) from error
    return plant, load_hardware(folder / model.hardware if model.hardware else None), structure


def _with_effects(reader: Reader, table: CaseTable, plant: Plant) -> Plant:
    """Return the plant with the effects of ``[[model.effect]]``.

    Only effects of the catalogue are allowed, because a case runs no foreign code.
    """
    channels = {name for recording in table.recording for name in recording.channel_names}
    for i, effect in enumerate(table.model.effect):
        try:
            one = Attached(effect=effect_named(effect.name, code=()), place=effect.place, values=effect.parameters)
            plant = attach(plant, [one], channels=sorted(channels))
        except VlabError as error:
            raise reader.fail(f"model.effect[{i}]", str(error)) from error
    return plant


def _check_names(reader: Reader, table: CaseTable, plant: Plant, written: WrittenOut) -> None:
    for name in table.model.uncertain:
        _check_uncertain(reader, name, table, plant)
    for i, recording in enumerate(table.recording):
        for j, channel in enumerate(recording.channel):
            find = find_input if channel.input else find_output
            try:
                find(plant, channel, recording)
            except VlabError as error:
                raise reader.fail(written.channels[i][j], str(error)) from error
        try:
            wire(plant, recording)
        except VlabError as error:
            raise reader.fail(f"{written.places[i]}.controller", str(error)) from error
    places = [(f"frf[{i}]", (frf.input, *frf.outputs)) for i, frf in enumerate(table.frf)]
    places += [(f"modal[{i}].at", modal.at) for i, modal in enumerate(table.modal)]
    for key, names in places:
        for name in names:
            try:
                find_place(plant, name)
            except VlabError as error:
                raise reader.fail(key, str(error)) from error


def _check_uncertain(reader: Reader, name: str, table: CaseTable, plant: Plant) -> None:
    """Check an uncertain quantity's name against an MJCF model.

    A name has the form ``geom:arm:mass``. A structure's names are keys of its tables.
    """
    if ":" not in name or not table.model.mjcf:
        return
    kind, _, rest = name.partition(":")
    given, _, quantity = rest.rpartition(":")
    key = "model.uncertain"
    if kind not in _NAMED:
        raise reader.fail(key, str(unknown_name("type of element", kind, _NAMED, where=name)))
    if not given or not quantity:
        raise reader.fail(key, f"{name!r} is not type:name:quantity, such as geom:arm:mass")
    if quantity not in _NAMED[kind]:
        raise reader.fail(key, str(unknown_name(f"quantity of a {kind}", quantity, _NAMED[kind], where=name)))
    known = [
        n for n in (getattr(plant.model, kind)(i).name for i in range(getattr(plant.model, f"n{_COUNT[kind]}"))) if n
    ]
    if given not in known:
        raise reader.fail(key, str(unknown_name(kind, given, known, where=name)))


_COUNT = {
    "body": "body",
    "geom": "geom",
    "joint": "jnt",
    "tendon": "tendon",
    "actuator": "u",
    "sensor": "sensor",
}
"""MuJoCo's count attribute by type of element."""
