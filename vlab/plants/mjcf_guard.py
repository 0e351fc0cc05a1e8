"""Guard of a user's MJCF: files, finite numbers, bounded counts.

The file is untrusted, and so is every included or attached file. MuJoCo opens absolute paths and follows links. An
asset directory named by any file applies to all files. The guard therefore resolves every name at all places where
MuJoCo may look, and refuses any place outside the folder.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from vlab.errors import BadStructure
from vlab.files.containment import NotInside, path_inside
from vlab.files.text import one_line
from vlab.plants.mjcf_counts import MOST_NUMBERS, check_counts

MAX_BYTES = 50 * 1024**2
"""MAX_BYTES [bytes]: largest MJCF file; meshes are separate files."""
MOST_PLACES = 100_000
"""MOST_PLACES [1]: largest number of candidate paths, names times directories. Real models have some hundred."""

OF_URDF = "this is a URDF; convert the file with MuJoCo (mujoco.MjSpec.from_file(URDF).to_xml() gives the text of an MJCF) and add actuators"
"""OF_URDF: remedy for a robot description in the format of ROS."""
_DIRECTORIES = ("meshdir", "texturedir", "assetdir")
_XML_FILES = ("include", "model")


def check_text(text: str, label: str) -> None:
    """Check a model given as text without file references.

    Parameters
    ----------
    text : str
        XML text.
    label : str
        Name of the model in messages.

    Raises
    ------
    BadStructure
        The model has forbidden content.
    """
    model = _Model(folder=None)
    model.add(None, text, label)
    check_counts(model.roots[None], label)


def check_file(path: Path, label: str) -> None:
    """Check a model file with all included and attached files.

    Every file must lie inside the model's folder.

    Parameters
    ----------
    path : Path
        Absolute path with links resolved.
    label : str
        Name of the file in messages.

    Raises
    ------
    BadStructure
        The model has forbidden content.
    """
    model = _Model(folder=path.parent)
    model.read(path, label)
    model.follow()
    model.check_files()
    model.check_attached()
    check_counts(model.roots[path], label, model.parts)


def model_files(path: Path, label: str) -> set[Path]:
    """Return all files of a model.

    Parameters
    ----------
    path : Path
        Absolute path of the model file with links resolved.
    label : str
        Name of the file in messages.

    Returns
    -------
    set of Path
        The model, its included and attached files, and its assets; all inside the model's folder.

    Raises
    ------
    BadStructure
        The model has forbidden content.
    """
    model = _Model(folder=path.parent)
    model.read(path, label)
    model.follow()
    read = {root for root in model.roots if root is not None}
    return read | {file for reference in model.references for file in model.found(reference)}


@dataclass(frozen=True, kw_only=True)
class _Reference:
    """Reference to a file: value, element and label."""

    source: Path
    label: str
    tag: str
    value: str
    name: str | None


@dataclass(kw_only=True)
class _Model:
    """XML files of a model.

    Parameters
    ----------
    folder : Path or None
        Folder of all files; None for a model without file references.
    """

    folder: Path | None
    roots: dict[Path | None, Any] = field(default_factory=dict)
    references: list[_Reference] = field(default_factory=list)
    directories: set[str] = field(default_factory=lambda: {""})
    _homes: dict[int, Path | None] = field(default_factory=dict)
    _parts: dict[tuple[Path | None, str, str | None], list[Any]] = field(default_factory=dict)

    def read(self, path: Path, label: str) -> None:
        """Read a file of the model."""
        if not path.is_file():
            what = "the folder is no model; name a file" if path.is_dir() else "there is no such model file"
            raise BadStructure(f"{label}: {what}; check the name and the folder")
        if path.stat().st_size > MAX_BYTES:
            raise BadStructure(f"{label}: the file has {path.stat().st_size} bytes; at most {MAX_BYTES} are read")
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise BadStructure(f"{label}: cannot be read as a text file: {one_line(error)}") from error
        self.add(path, text, label)

    def add(self, path: Path | None, text: str, label: str) -> None:
        """Add a file's text and refuse forbidden attributes."""
        root = self.roots[path] = _parse(text, label)
        for element in root.iter():
            if "}" in element.tag:
                raise BadStructure(f"{label}: <{one_line(element.tag)}> has a namespace; MJCF has none, remove it")
            if element.tag == "attach":
                self._homes[id(element)] = path
            for key, value in element.attrib.items():
                where = f"{label}: <{one_line(element.tag)} {one_line(key)}={one_line(value)!r}>"
                if {token.strip("+-").lower() for token in value.split()} & {"nan", "inf", "infinity"}:
                    raise BadStructure(f"{where}: numbers must be finite")
                if not (key.startswith("file") or key in _DIRECTORIES):
                    continue
                if path is None:
                    raise BadStructure(f"{where}: a model given as text cannot refer to files; write it into a folder")
                if _leaves(value):
                    raise BadStructure(
                        f"{where}: the path is absolute or leaves the model's folder; copy the file into it"
                    )
                if key in _DIRECTORIES:
                    self.directories.add(value)
                else:
                    name = element.get("name")
                    self.references.append(
                        _Reference(source=path, label=label, tag=element.tag, value=value, name=name)
                    )

    def follow(self) -> None:
        """Read included and attached files until none is new."""
        known = 0
        while known != len(self.roots):  # a directory named by one file applies to the names of all
            known = len(self.roots)
            self._check_places()
            for reference in [r for r in self.references if r.tag in _XML_FILES]:
                for path in self.found(reference):
                    if path not in self.roots:
                        self.read(path, one_line(reference.value))

    def _check_places(self) -> None:
        names = {(r.tag, r.value) for r in self.references}
        places = len(names) * len(self._folders())
        if places > MOST_PLACES:
            raise BadStructure(
                f"{self.references[0].label}: the model names {len(names)} files that may lie in {len(self._folders())} "
                f"folders; accepted: up to {MOST_PLACES} places to look at"
            )

    def _folders(self) -> set[Path]:
        return {path.parent / directory for path in self.roots if path is not None for directory in self.directories}

    def found(self, reference: _Reference) -> Iterator[Path]:
        """Yield the candidate files of a reference.

        The candidates are all places where MuJoCo may look. ``strippath`` removes the folders of a name.

        Raises
        ------
        BadStructure
            A link leaves the folder, or the path is a device or pipe.
        """
        assert self.folder is not None
        names = {reference.value, PureWindowsPath(reference.value).name}
        for place in (folder / name for folder in self._folders() for name in names):
            where = f"{reference.label}: <{one_line(reference.tag)} file={one_line(reference.value)!r}>"
            try:
                real = path_inside(place, self.folder)
            except NotInside as error:
                raise BadStructure(
                    f"{where}: a link that leaves the model's folder, or no name of a file ({error}); copy the file"
                ) from error
            if real.is_file():
                yield real
            elif real.exists() and not real.is_dir():
                raise BadStructure(f"{where}: it is a device or a pipe; name a file")

    def check_files(self) -> None:
        """Refuse files outside the folder and excessive pictures."""
        for reference in {(r.tag, r.value): r for r in self.references}.values():
            for path in self.found(reference):
                if _png_numbers(path) > MOST_NUMBERS:
                    raise BadStructure(
                        f"{reference.label}: the picture {one_line(reference.value)!r} unpacks to {_png_numbers(path)} "
                        f"numbers; accepted: up to {MOST_NUMBERS}; make it smaller"
                    )

    def check_attached(self) -> None:
        """Refuse a model that attaches itself.

        MuJoCo would read such a model endlessly.
        """
        after = {path: {f for r in self._models(path) for f in self.found(r)} for path in self.roots}
        ends: set[Path | None] = {None}
        while ends:
            ends = {path for path, files in after.items() if not files & after.keys()}
            after = {path: files for path, files in after.items() if path not in ends}
        if after:
            names = ", ".join(sorted(one_line(path.name) for path in after if path is not None))
            raise BadStructure(f"{names}: the model attaches itself; take its <model> out of its own file")

    def parts(self, element: Any) -> Iterable[Any]:
        """Return the roots of files in place of an element.

        See `vlab.plants.mjcf_counts.Parts`.
        """
        if element.tag not in ("include", "attach"):
            return ()
        home, name = self._homes.get(id(element)), element.get("file" if element.tag == "include" else "model")
        key = (home, element.tag, name)
        if key not in self._parts:
            wanted = [r for r in self.references if r.tag == "include" and r.value == name]
            if element.tag == "attach":  # an unnamed model takes the name of its attachment
                own, every = self._models(home), [r for r in self.references if r.tag == "model"]
                wanted = [r for r in own if r.name == name] or own or [r for r in every if r.name == name] or every
            self._parts[key] = [self.roots[path] for path in {path for r in wanted for path in self.found(r)}]
        return self._parts[key]

    def _models(self, path: Path | None) -> list[_Reference]:
        return [r for r in self.references if r.source == path and r.tag == "model"]


def _parse(text: str, label: str) -> Any:
    if "<!DOCTYPE" in text.upper() or "<!ENTITY" in text.upper():
        raise BadStructure(f"{label}: the XML declares a document type or entities; MJCF needs neither, remove them")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise BadStructure(f"{label}: malformed XML: {one_line(error)}") from error
    if root.tag not in ("mujoco", "mujocoinclude"):
        remedy = f"; {OF_URDF}" if root.tag == "robot" else ""
        raise BadStructure(
            f"{label}: the root element is <{one_line(root.tag)}>; an MJCF file starts with <mujoco>{remedy}"
        )
    return root


def _leaves(value: str) -> bool:
    windows, posix = PureWindowsPath(value), PurePosixPath(value)
    return bool(posix.is_absolute() or windows.drive or windows.root or ".." in windows.parts or value.startswith("~"))


def _png_numbers(path: Path) -> int:
    """Return the unpacked size of a PNG [numbers].

    The size comes from the header; any other file gives 0.
    """
    with open(path, "rb") as stream:
        head = stream.read(24)
    if not head.startswith(b"\x89PNG"):
        return 0
    return int.from_bytes(head[16:20], "big") * int.from_bytes(head[20:24], "big") // 2
