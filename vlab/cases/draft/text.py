"""Text of a drafted case file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vlab.cases.draft.logs import Log, LogClock, Part
from vlab.cases.draft.matching import LeftOut, Match
from vlab.cases.draft.model import DraftModel, relative, uncertain_kinds
from vlab.cases.draft.unit_choice import channel_keys
from vlab.files.text import one_line
from vlab.files.toml_writer import toml_value

CHECK = "CHECK"
"""CHECK: word before a guess in the comments."""
_PATTERN = "*?["
MOST_LEFT = 40
"""MOST_LEFT [1]: largest number of left-out columns in the comments."""


def case_text(
    model: DraftModel,
    folder: Path,
    logs: Sequence[Log],
    parts: Sequence[Part],
    clock: LogClock,
    used: Sequence[Match],
    left_out: Sequence[LeftOut],
    remarks: Sequence[str],
) -> str:
    """Return the text of a case file.

    Parameters
    ----------
    model : DraftModel
        Model.
    folder : Path
        Folder of the case.
    logs : sequence of Log
        Logs.
    parts : sequence of Part
        Recordings with their roles.
    clock : LogClock
        Clock of the logs.
    used, left_out : sequence
        Columns.
    remarks : sequence of str
        Open questions.

    Returns
    -------
    str
        TOML with comments.
    """
    lines = [f"# Drafted by vlab init. {CHECK} marks a guess: confirm or correct the line, and delete the mark."]
    lines += [f"# {CHECK}: {one_line(remark)}" for remark in remarks]
    lines += [f"title = {toml_value(one_line(model.title))}", ""]
    lines += ["[model]", f"{model.key} = {toml_value(model.value)}", ""]
    if model.key == "mjcf":
        lines += ["[model.uncertain]  # relative standard deviations of the numbers in the model; edit as known"]
        lines += [f"{kind} = {value:g}  # {why}" for kind, (value, why) in uncertain_kinds(model.plant).items()]
        lines.append("")
    names = {log.path: relative(log.path, folder)[0] for log in logs}
    for part in parts:
        lines += [*_recording(part, names, clock), ""]
    for match in used:
        lines += [*_channel(match), ""]
    return "\n".join([*lines, *_left(left_out)]).rstrip() + "\n"


def _recording(part: Part, names: dict[Path, str], clock: LogClock) -> list[str]:
    files = [names[path] for path in part.paths]
    lines: list[str] = []
    several = len(files) > 1 and not any(sign in file for file in files for sign in _PATTERN)
    for group in [files] if several else [[file] for file in files]:
        why = "search for missing physics" if part.role == "fit" else "kept aside, to verify what is found"
        lines += ["", "[[recording]]"] if lines else ["[[recording]]"]
        lines.append(f"files = {toml_value(group)}" if several else f"file = {toml_value(group[0])}")
        lines += [f"role = {toml_value(part.role)}  # {why}"]
        name = part.name or ("" if several or part.episodes else _own_name(group[0], list(names.values())))
        lines += [f"name = {toml_value(one_line(name))}"] if name else []
        lines += [f"episodes = {toml_value(list(part.episodes))}"] if part.episodes else []
        lines += _clock(clock)
        lines += [f"start_s = {part.start_s!r}"] if part.start_s is not None else []
        lines += [f"stop_s = {part.stop_s!r}"] if part.stop_s is not None else []
    return lines


def _own_name(file: str, files: list[str]) -> str:
    """Return a file's name without suffixes.

    The folder comes first where several files have that name.
    """
    own = _stem(file)
    is_shared = sum(_stem(other) == own for other in files) > 1
    return f"{Path(file).parent.name} {own}".strip() if is_shared else own


def _stem(file: str) -> str:
    name = Path(file).name
    return name.removesuffix("".join(Path(name).suffixes)) or name


def _clock(clock: LogClock) -> list[str]:
    mark = "" if clock.is_sure else f"{CHECK}: "
    if clock.time is None:
        return [f"rate_hz = {clock.rate_hz!r}  # {mark}{one_line(clock.why)}"]
    lines = [f"time = {toml_value(clock.time)}  # {mark}{one_line(clock.why)}"]
    return lines + ([f"time_unit = {toml_value(clock.unit)}"] if clock.unit != "s" else [])


def _channel(match: Match) -> list[str]:
    keys: dict[str, Any] = channel_keys(match)
    notes = {"at": match.why if match.is_place_sure else f"{CHECK}: {match.why}"}
    if match.why_unit:
        notes["unit"] = match.why_unit if match.is_unit_sure else f"{CHECK}: {match.why_unit}"
    notes["scale"] = f"{CHECK}: model unit per file unit, such as the torque constant"
    notes["unwrap"] = jumps_of(match)
    lines = [f"{key} = {toml_value(value)}" for key, value in keys.items()]
    said = [
        f"{line}  # {one_line(notes[key])}" if notes.get(key) else line for key, line in zip(keys, lines, strict=True)
    ]
    return ["[[channel]]", *said]


def jumps_of(match: Match) -> str:
    """Return the words on the jumps of a wrapped angle."""
    return f"the column jumps by a full turn {match.wraps} time{'' if match.wraps == 1 else 's'}"


def _left(left_out: Sequence[LeftOut]) -> list[str]:
    if not left_out:
        return []
    lines = ["# Columns that are left out:"]
    for left in left_out[:MOST_LEFT]:
        lines.append(f"# {one_line(toml_value(left.label))}: {one_line(left.why)}")
    if len(left_out) > MOST_LEFT:
        lines.append(f"# and {len(left_out) - MOST_LEFT} more")
    return lines
