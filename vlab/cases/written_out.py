"""Short forms of a case file, written out.

Shared channels, patterns of files, episodes and folders of recordings become plain ``[[recording]]`` tables with one
file and their channels. The rest of vlab knows the plain form only.
"""

import copy
import re
import stat
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vlab.errors import VlabError
from vlab.files.containment import NotInside, file_inside, path_inside
from vlab.files.text import one_line
from vlab.files.toml import Reader
from vlab.recordings.datasets import EPISODE, DataSet, bag_file, dataset_above, episodes_in, read_dataset

MOST_UNCHOSEN = 20
"""MOST_UNCHOSEN [1]: largest number of episodes that are all taken where a recording names none."""
MOST_FILES = 1000
"""MOST_FILES [1]: largest number of files of a pattern, and of episodes."""
_SIGNS = re.compile(r"[*?\[]")


@dataclass(frozen=True, kw_only=True)
class WrittenOut:
    """Plain form of a case file.

    Parameters
    ----------
    raw : mapping
        Contents with plain recordings.
    places : tuple of str
        Table of the case file by plain recording, for messages.
    channels : tuple of tuple of str
        Table of the case file by channel of each plain recording, for messages.
    notes : tuple of str
        Choices that the case file leaves open.
    """

    raw: Mapping[str, Any]
    places: tuple[str, ...]
    channels: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def origins(self) -> dict[str, str]:
        """Return the table of the case file by table of the plain form."""
        places = {f"recording[{i}]": place for i, place in enumerate(self.places)}
        for i, tables in enumerate(self.channels):
            places |= {f"recording[{i}].channel[{j}]": table for j, table in enumerate(tables)}
        return places

    @property
    def shared(self) -> frozenset[str]:
        """Columns of shared channels that a recording uses."""
        tables = zip(self.raw.get("recording", ()), self.channels, strict=True)
        return frozenset(
            str(channel["column"])
            for table, origins in tables
            for channel, origin in zip(table.get("channel", ()), origins, strict=True)
            if origin.startswith("channel[")
        )


def labels_of(raw: Mapping[str, Any]) -> dict[str, str]:
    """Return the recordings and channels of a case file in the user's words.

    Parameters
    ----------
    raw : mapping
        Parsed case file.

    Returns
    -------
    dict of str to str
        File or column by place in the case file; places count from 0.
    """
    out: dict[str, str] = {}
    for i, recording in enumerate(_tables(raw.get("recording"))):
        file = recording.get("name") or recording.get("file") or recording.get("files")
        if isinstance(file, str):
            out[f"recording[{i}]"] = f"recording {i + 1}, {one_line(file)!r}"
        out |= _columns_of(recording, f"recording[{i}].", f" of {one_line(file)!r}" if isinstance(file, str) else "")
    return out | _columns_of(raw, "", " of all recordings")


def _tables(value: Any) -> list[dict[str, Any]]:
    return value if _are_tables(value) else []


def _columns_of(table: Mapping[str, Any], place: str, rest: str) -> dict[str, str]:
    return {
        f"{place}channel[{j}]": f"column {one_line(channel['column'])!r}{rest}"
        for j, channel in enumerate(_tables(table.get("channel")))
        if isinstance(channel.get("column"), str)
    }


def check_file(reader: Reader, key: str, file: str, *, allow_outside: bool = False) -> None:
    """Check that a file of a case can be read.

    Parameters
    ----------
    reader : Reader
        Reader of the case file.
    key : str
        Key that names the file.
    file : str
        Name of the file.
    allow_outside : bool
        Whether files outside the folder of the case may be read.

    Raises
    ------
    BadCase
        The file is missing, no ordinary file, or outside.
    """
    folder = Path(reader.file).parent
    try:
        if not allow_outside:
            file_inside(file, folder, called="the case's folder")
        elif not stat.S_ISREG((folder / file).stat().st_mode):
            raise NotInside("is no ordinary file")
    except (NotInside, OSError, ValueError) as error:
        why = str(error) if isinstance(error, NotInside) else "is not there"
        fix = "check its name"
        if "outside" in why:
            fix = "copy it into the case's folder, or allow it with --allow-outside"
        elif not allow_outside:
            fix = "copy it into the case's folder and check its name"
        raise reader.fail(key, f"there is no file {file!r} of the case: it {why}; {fix}") from error


def write_out(raw: Mapping[str, Any], reader: Reader, *, allow_outside: bool = False) -> WrittenOut:
    """Return the plain form of a case file.

    Parameters
    ----------
    raw : mapping
        Parsed case file.
    reader : Reader
        Reader of the case file, for messages.
    allow_outside : bool
        Whether files outside the folder of the case may be read.

    Returns
    -------
    WrittenOut
        Plain form and the origin of its tables.

    Raises
    ------
    BadCase
        A pattern matches no file, an episode or element is unknown, or keys contradict each other.
    """
    out = copy.deepcopy(dict(raw))
    given = out.get("recording", [])
    shared = out.pop("channel", [])
    if not _are_tables(given) or not _are_tables(shared):
        where = "recording" if not _are_tables(given) else "channel"
        raise reader.fail(where, f"a list of tables was expected; write [[{where}]]")
    if shared and not given:
        raise reader.fail("channel", "shared channels belong to recordings; give [[recording]] too")
    writer = _Writer(reader=reader, allow_outside=allow_outside)
    plain, places, channels = [], [], []
    for i, table in enumerate(given):
        place = f"recording[{i}]"
        for one in writer.recordings(table, place):
            one["channel"], origins = _merged(one.get("channel"), shared, place)
            if one["channel"] is None:
                del one["channel"]
            writer.name_columns(one, origins)
            plain.append(one)
            places.append(place)
            channels.append(tuple(origins))
    if given:
        out["recording"] = [{k: v for k, v in one.items() if not k.startswith("\0")} for one in plain]
    return WrittenOut(raw=out, places=tuple(places), channels=tuple(channels), notes=tuple(writer.notes))


def _are_tables(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(part, dict) for part in value)


def _merged(own: Any, shared: Sequence[Mapping[str, Any]], place: str) -> tuple[Any, list[str]]:
    """Return the channels of a recording and their origin.

    A channel of its own takes the place of the shared channel of the same column; all others are added.
    """
    if own is None and not shared:
        return None, []
    if own is not None and not _are_tables(own):
        return own, []  # the reader of tables says what is wrong
    replaced = {str(channel.get("column")): i for i, channel in enumerate(own or ())}
    merged: list[Any] = []
    origins: list[str] = []
    used = set()
    for i, channel in enumerate(shared):
        k = replaced.get(str(channel.get("column")))
        merged.append(copy.deepcopy(dict(channel)) if k is None or own is None else own[k])
        origins.append(f"channel[{i}]" if k is None else f"{place}.channel[{k}]")
        used |= set() if k is None else {k}
    for k, channel in enumerate(own or ()):
        if k not in used:
            merged.append(channel)
            origins.append(f"{place}.channel[{k}]")
    return merged, origins


_SET = "\0set"
"""Key of the data set of a plain recording, until its columns are named."""
_FOLDER = "\0folder"
"""Key of the folder of a data set, until a file is chosen."""


@dataclass(frozen=True, kw_only=True)
class _Writer:
    """Writer of plain recordings."""

    reader: Reader
    allow_outside: bool
    notes: list[str] = field(default_factory=list)

    @property
    def folder(self) -> Path:
        return Path(self.reader.file).parent

    def recordings(self, table: Mapping[str, Any], place: str) -> Iterator[dict[str, Any]]:
        """Yield the plain recordings of one table, without channels written out."""
        if "files" not in table:
            yield from self.episodes(copy.deepcopy(dict(table)), place)
            return
        if "file" in table:
            raise self.reader.fail(place, "file and files are both given; give one of them")
        files = self.matches(table["files"], f"{place}.files")
        stems = [_stem(file) for file in files]
        for file, stem in zip(files, stems, strict=True):
            one = {k: copy.deepcopy(v) for k, v in table.items() if k != "files"}
            label = stem if stems.count(stem) == 1 else file
            one |= {"file": file, "name": f"{table['name']} {label}" if "name" in table else label}
            yield from self.episodes(one, place)

    def matches(self, given: Any, key: str) -> list[str]:
        """Return the files of patterns, in the order of their numbers."""
        patterns = [given] if isinstance(given, str) else given
        if not isinstance(patterns, list) or not patterns or not all(isinstance(p, str) and p for p in patterns):
            raise self.reader.fail(key, 'a pattern such as "run*.csv" or a list of files was expected')
        found: list[str] = []
        for pattern in patterns:
            some = self.glob(pattern, key) if _SIGNS.search(pattern) else [pattern]
            found += [file for file in some if file not in found]
        return found

    def glob(self, pattern: str, key: str) -> list[str]:
        """Return the files that match a pattern."""
        path = Path(pattern)
        if (path.is_absolute() or ".." in path.parts) and not self.allow_outside:
            raise self.reader.fail(
                key, f"the pattern {pattern!r} leaves the case's folder; allow it with --allow-outside"
            )
        top = Path(path.anchor) if path.is_absolute() else self.folder
        relative = str(path.relative_to(path.anchor)) if path.is_absolute() else pattern
        try:
            names: list[str] = []
            for hit in top.glob(relative):
                if len(names) > MOST_FILES:
                    break
                names.append(str(hit) if path.is_absolute() else str(hit.relative_to(self.folder)))
        except (ValueError, OSError, NotImplementedError) as error:
            raise self.reader.fail(key, f"{pattern!r} is no pattern: {error}") from error
        if not names or len(names) > MOST_FILES:
            count = f"more than {MOST_FILES} files match" if names else "no file matches"
            there = sorted(p.name for p in self.folder.iterdir() if p.is_file())[:10]
            raise self.reader.fail(
                key, f"{count} {pattern!r}; files of the case's folder: {', '.join(map(one_line, there))}"
            )
        return sorted(names, key=natural_key)

    def episodes(self, one: dict[str, Any], place: str) -> Iterator[dict[str, Any]]:
        """Yield the recordings of the episodes that a table names."""
        if "episode" in one and "episodes" in one:
            raise self.reader.fail(place, "episode and episodes are both given; give one of them")
        wanted = [one.pop("episode")] if "episode" in one else one.pop("episodes", None)
        key = f"{place}.episode"
        is_list = isinstance(wanted, list) and all(type(n) is int and n >= 0 for n in wanted)
        if wanted is not None and not (is_list and 0 < len(wanted) <= MOST_FILES):
            raise self.reader.fail(key, f"numbers of episodes from 0 were expected, {wanted!r} was given")
        if not isinstance(one.get("file"), str):
            yield one  # the reader of tables says what is missing
            return
        data = self.dataset(one, f"{place}.file")
        if "time" not in one and "rate_hz" not in one and _FOLDER not in one:  # a data set would state its own time
            check_file(self.reader, f"{place}.file", one["file"], allow_outside=self.allow_outside)
        if wanted is None:
            wanted = self.unchosen(one, data, key)
        for number in [None] if wanted is None else wanted:
            part = copy.deepcopy({k: v for k, v in one.items() if k != _SET})
            self.choose(part, one.get(_SET), number, place)
            if len(wanted or ()) > 1:
                part["name"] = f"{part['name']} episode {number}" if "name" in part else f"episode {number}"
            yield part

    def unchosen(self, one: Mapping[str, Any], data: DataSet | None, key: str) -> list[int] | None:
        """Return all episodes of a recording; None without episodes to choose."""
        where = one.get("where", "")
        if isinstance(where, str) and EPISODE in where:
            return None
        if _FOLDER in one and data is not None:
            known = list(range(min(data.episodes, MOST_UNCHOSEN + 1)))
        else:
            known = self.in_file(one["file"], key)
        if len(known) > MOST_UNCHOSEN:
            raise self.reader.fail(
                key,
                f"there are more than {MOST_UNCHOSEN} episodes; choose some, such as episodes = [0, 1]",
            )
        if len(known) > 1:
            self.notes.append(
                f"{one['file']}: no episode is chosen, so each of the {len(known)} episodes is a recording"
            )
        return known if len(known) > 1 or _FOLDER in one else None

    def in_file(self, file: str, key: str) -> list[int]:
        """Return the episodes of a file."""
        try:
            real = (self.folder / file).resolve() if self.allow_outside else path_inside(file, self.folder)
            return episodes_in(real) if real.is_file() else []
        except (NotInside, OSError):
            return []  # the check of files says what is wrong
        except VlabError as error:
            raise self.reader.fail(key, str(error)) from error

    def dataset(self, one: dict[str, Any], key: str) -> DataSet | None:
        """Return a recording's data set, kept in the table."""
        try:
            folder = self.folder.resolve()
            path = (folder / one["file"]).resolve() if self.allow_outside else path_inside(one["file"], folder)
            if not path.is_dir():
                data = dataset_above(path, Path(path.anchor) if self.allow_outside else folder)
            else:
                data = read_dataset(path)
                if data is None:
                    one["file"] = str(Path(one["file"]) / bag_file(path))
                else:
                    one[_FOLDER] = one["file"]
        except NotInside:
            return None  # the check of files says what is wrong
        except (OSError, RuntimeError, ValueError) as error:
            if isinstance(error, VlabError):
                raise self.reader.fail(key, str(error)) from error
            return None
        if data is not None:
            one[_SET] = data
        return data

    def located(self, folder: str, data: DataSet, number: int) -> str:
        return str(Path(folder) / data.file_of(number))

    def choose(self, part: dict[str, Any], data: DataSet | None, number: int | None, place: str) -> None:
        """Set file and rows of one episode."""
        folder = part.pop(_FOLDER, None)
        if data is not None:
            part[_SET] = data
            if "time" not in part and "rate_hz" not in part and "timestamp" in data.info.get("features", {}):
                part["time"] = "timestamp"
        if number is None:
            return
        try:
            if folder is not None and data is not None:
                part["file"] = self.located(folder, data, number)
        except VlabError as error:
            raise self.reader.fail(f"{place}.episode", str(error)) from error
        part["where"] = _joined(part.get("where"), data, number)
        if not part["where"]:
            del part["where"]

    def name_columns(self, one: dict[str, Any], origins: Sequence[str]) -> None:
        """Write the numbered columns of named elements."""
        data = one.get(_SET)
        if data is None or not _are_tables(one.get("channel")):
            return
        for channel, origin in zip(one["channel"], origins, strict=True):
            for key in ("column", "time"):
                if isinstance(channel.get(key), str):
                    try:
                        channel[key] = data.column(channel[key])
                    except VlabError as error:
                        raise self.reader.fail(f"{origin}.{key}", str(error)) from error


def _joined(where: Any, data: DataSet | None, number: int) -> Any:
    """Return the selection of rows with the number of the episode."""
    if data is not None and EPISODE not in data.info.get("features", {}):
        return where or ""
    condition = f"{EPISODE} == {number}"
    return f"{where} and {condition}" if isinstance(where, str) and where else condition


def _stem(file: str) -> str:
    name = Path(file).name
    return name.removesuffix("".join(Path(name).suffixes[-2:] if name.endswith(".gz") else Path(name).suffixes[-1:]))


def natural_key(name: str) -> list[Any]:
    """Return a key that sorts run2 before run10.

    Parameters
    ----------
    name : str
        Name of a file.

    Returns
    -------
    list
        Sort key.
    """
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name)]
