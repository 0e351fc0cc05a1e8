"""Folders of recordings: LeRobot data sets and ROS 2 bags.

A LeRobot data set describes itself in ``meta/info.json``: the features with the names of their elements, and the files
of the episodes. Version 2 has a file for each episode, version 3 has several episodes in a file and lists them in
``meta/episodes``. Source: https://github.com/huggingface/lerobot.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from vlab.errors import unknown_name
from vlab.files.text import one_line
from vlab.recordings.files import read_guarded, refuse
from vlab.recordings.table import EVERY, Table, open_table

INFO = Path("meta") / "info.json"
"""INFO: description of a LeRobot data set."""
BAG = "metadata.yaml"
"""BAG: description of a ROS 2 bag."""
EPISODE = "episode_index"
"""EPISODE: column with the number of the episode."""
_MOST_BYTES = 2**24  # of the description
_NESTED, _TEXT = (".json", ".jsonl", ".ndjson"), (".csv", ".tsv", ".txt")  # kinds of files that may hold episodes
_HEAD = 2**16  # bytes that hold the names of the columns
_FIELD = re.compile(r"\{(\w+)(?::0?(\d{1,2})d)?\}")


@dataclass(frozen=True, kw_only=True)
class DataSet:
    """Description of a LeRobot data set.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    elements : mapping of str to tuple of str
        Names of the elements of each vector.
    episodes : int
        Number of episodes.
    info : mapping
        Contents of the description.
    """

    folder: Path
    elements: Mapping[str, tuple[str, ...]]
    episodes: int
    info: Mapping[str, Any]

    def column(self, name: str) -> str:
        """Return the numbered column of a named element.

        Parameters
        ----------
        name : str
            ``action[elbow.pos]``, ``action[2]``, or a plain column.

        Returns
        -------
        str
            ``action[2]``; any other name unchanged.

        Raises
        ------
        UnknownName
            The vector has no such element, or several vectors have it.
        """
        match = re.fullmatch(r"(.+)\[(.+)\]", name)
        if match is not None and match[1] in self.elements and not match[2].isdecimal():
            known = self.elements[match[1]]
            if match[2] not in known:
                raise unknown_name("element", match[2], known, where=match[1])
            return f"{match[1]}[{known.index(match[2])}]"
        owners = [vector for vector, known in self.elements.items() if name in known]
        if owners and name not in self.info.get("features", {}):
            raise unknown_name("column", name, [f"{owner}[{name}]" for owner in owners])
        return name

    def file_of(self, episode: int) -> str:
        """Return the Parquet file of an episode, relative to the data set.

        Parameters
        ----------
        episode : int
            Number of the episode, from 0.

        Returns
        -------
        str
            Path of the file.

        Raises
        ------
        BadRecording
            There is no such episode, or the description is damaged.
        """
        if not 0 <= episode < self.episodes:
            raise refuse(self.folder, f"there is no episode {episode}", fix=f"accepted: 0 to {self.episodes - 1}")
        template = self.info.get("data_path")
        if not isinstance(template, str) or len(template) > 1000:
            raise refuse(self.folder / INFO, "data_path is missing", fix="copy the data set again")
        chunk = self.info.get("chunks_size", 1000)
        numbers = {
            "episode_index": episode,
            "episode_chunk": episode // chunk if isinstance(chunk, int) and chunk > 0 else 0,
        }
        if "{file_index" in template:
            numbers |= self._file_numbers(episode)
        unknown = [match[1] for match in _FIELD.finditer(template) if match[1] not in numbers]
        if unknown:
            raise refuse(
                self.folder / INFO, f"data_path has the unknown field {unknown[0]!r}", fix="copy the data set again"
            )
        return _FIELD.sub(lambda match: f"{numbers[match[1]]:0{int(match[2] or 0)}d}", template)

    def _file_numbers(self, episode: int) -> dict[str, int]:
        """Return the numbers of the file of an episode in version 3."""
        wanted = [EPISODE, "data/chunk_index", "data/file_index"]
        for path in sorted((self.folder / "meta" / "episodes").glob("*/*.parquet")):
            table = open_table(path.relative_to(self.folder), folder=self.folder, columns=wanted)
            at = np.flatnonzero(table[EPISODE] == episode)
            if at.size:
                chunk, file = (int(table[name][at[0]]) for name in wanted[1:])
                return {"chunk_index": chunk, "file_index": file}
        raise refuse(self.folder, f"episode {episode} is not listed in meta/episodes", fix="copy the data set again")


def read_dataset(folder: Path) -> DataSet | None:
    """Return the description of a folder.

    Parameters
    ----------
    folder : Path
        Folder.

    Returns
    -------
    DataSet or None
        None for a folder without a description of LeRobot.

    Raises
    ------
    BadRecording
        The description is damaged.
    """
    if not (folder / INFO).is_file():
        return None
    path = folder / INFO
    data = read_guarded(INFO, folder=folder)
    try:
        info = json.loads(data) if len(data) <= _MOST_BYTES else None
    except (ValueError, RecursionError) as error:
        raise refuse(path, f"not JSON: {error}", fix="copy the data set again") from error
    features = info.get("features") if isinstance(info, dict) else None
    episodes = info.get("total_episodes") if isinstance(info, dict) else None
    if not isinstance(info, dict) or not isinstance(features, dict) or not isinstance(episodes, int):
        raise refuse(path, "features or total_episodes are missing", fix="copy the data set again")
    elements: dict[str, tuple[str, ...]] = {
        str(name): names for name, feature in features.items() if (names := _element_names(feature))
    }
    return DataSet(folder=folder, elements=elements, episodes=episodes, info=info)


def _element_names(feature: Any) -> tuple[str, ...]:
    """Return the names of a vector's elements.

    The names are a list, a table of lists by kind, or a table of numbers by name.
    """
    if not isinstance(feature, dict) or feature.get("dtype") in ("video", "image", "string"):
        return ()
    given = feature.get("names")
    names = given
    if isinstance(given, dict):
        values = list(given.values())
        if values and all(isinstance(value, int) for value in values):
            names = sorted(given, key=lambda name: given[name])
        else:
            names = [name for value in values if isinstance(value, list) for name in value]
    return tuple(names) if isinstance(names, list) and all(isinstance(name, str) for name in names) else ()


def dataset_above(path: Path, top: Path) -> DataSet | None:
    """Return the data set that a file belongs to.

    Parameters
    ----------
    path : Path
        File, with links resolved.
    top : Path
        Folder that is not left.

    Returns
    -------
    DataSet or None
        Data set in one of the three folders above the file.
    """
    for folder in list(path.parents)[:3]:
        if not folder.is_relative_to(top):
            return None
        found = read_dataset(folder)
        if found is not None:
            return found
    return None


def episodes_in(path: Path) -> list[int]:
    """Return the episodes of a file.

    Parameters
    ----------
    path : Path
        Parquet, JSON or CSV file.

    Returns
    -------
    list of int
        Numbers in increasing order; empty without a column of episodes.

    Raises
    ------
    BadRecording
        The column is damaged.
    """
    suffix = path.suffix.lower()
    try:
        if suffix == ".parquet":
            has_episodes = EPISODE in pq.read_schema(path).names
        elif suffix in _NESTED:  # runs may stand in any entry
            has_episodes = EPISODE in open_table(path, blanks=EVERY).names
        else:
            with path.open("rb") as stream:
                has_episodes = suffix in _TEXT and EPISODE.encode() in stream.read(_HEAD)
    except (OSError, ValueError, pa.ArrowException):  # the reader says what is wrong
        return []
    return episodes_of(open_table(path, columns=[EPISODE])) if has_episodes else []


def episodes_of(table: Table) -> list[int]:
    """Return the episodes of a table.

    Parameters
    ----------
    table : Table
        Columns of a file.

    Returns
    -------
    list of int
        Numbers in increasing order; empty without a column of episodes.
    """
    if EPISODE not in table.names:
        return []
    values = table.real(EPISODE)
    return [int(number) for number in np.unique(values[np.isfinite(values)])]


def bag_file(folder: Path) -> str:
    """Return the log in a folder of a ROS 2 bag.

    Parameters
    ----------
    folder : Path
        Folder.

    Returns
    -------
    str
        Name of the only log in it.

    Raises
    ------
    BadRecording
        The folder is no bag, or has several logs.
    """
    logs: Sequence[str] = (
        sorted(p.name for p in folder.iterdir() if p.suffix in (".mcap", ".db3")) if folder.is_dir() else []
    )
    if not (folder / BAG).is_file() or not logs:
        raise refuse(
            folder, "the folder is no recording", fix=f"name a file, a LeRobot data set ({INFO}) or a ROS 2 bag ({BAG})"
        )
    if len(logs) > 1:
        raise refuse(folder, f"the bag has {len(logs)} logs", fix=f"name one: {', '.join(map(one_line, logs[:10]))}")
    return logs[0]


def open_any(path: Path, episode: int = 0) -> tuple[Table, dict[str, str]]:
    """Open a recording, a data set's episode or a bag's log.

    Parameters
    ----------
    path : Path
        File or folder.
    episode : int
        Episode of a LeRobot data set.

    Returns
    -------
    tuple of (Table, dict of str to str)
        Columns of the file, blank cells allowed, and the other name of a column by its name.

    Raises
    ------
    BadRecording
        The file or the description is damaged.
    """
    data = None
    if path.is_dir():
        data = read_dataset(path)
        path = path / (bag_file(path) if data is None else data.file_of(episode))
    elif path.exists() and path.resolve().parent.name.startswith("chunk-"):  # the layout of a data set
        above = [read_dataset(folder) for folder in list(path.resolve().parents)[:3]]
        data = next((found for found in above if found is not None), None)
    names: dict[str, str] = {}
    for vector, elements in ({} if data is None else data.elements).items():
        names |= {f"{vector}[{i}]": f"{vector}[{name}]" for i, name in enumerate(elements)}
    table = open_table(path, blanks=EVERY)
    names |= {column: alias for alias, column in table.aliases.items()}
    return table, names
