"""Cases from arrays: a model in memory, and runs of named columns."""

import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from vlab.errors import BadCase, VlabError, unknown_name
from vlab.files.text import one_line, with_article
from vlab.plants.base import Plant, Port
from vlab.plants.mjcf import AXES, build_mjcf, build_mjcf_spec
from vlab.recordings.frames import seconds_of
from vlab.recordings.table import Table
from vlab.signals import KIND_UNITS, Array
from vlab.structure.reader import BUILT_IN

LABEL = "case in memory"
"""Name of the case in messages, in place of a file."""
MODEL_FILE = "model.xml"
"""Name of a model without a file."""
HELD_OUT = 1 / 3
"""HELD_OUT [1]: share of a single run that is held out by default, at the end of the run. Raising it verifies on more
data and fits on less; untested."""
EXACT = 1e-4
"""EXACT [1]: relative difference of a number that MuJoCo has written to XML and read again; it writes six digits."""
_OF_ANGLE = {"displacement": "angle", "velocity": "angular-velocity", "acceleration": "angular-acceleration"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Given:
    """A model and runs, in the form of a case file.

    Parameters
    ----------
    raw : mapping
        Contents of the case file.
    tables : mapping of str to Table
        Runs by file name in `raw`.
    plant : Plant or None
        Plant of a model in memory; None for a structure or a file.
    folder : Path
        Folder of the model's files.
    """

    raw: Mapping[str, Any]
    tables: Mapping[str, Table]
    plant: Plant | None
    folder: Path


# ---- the model ------------------------------------------------------------------------------------------------------


def read_model(model: Any) -> tuple[dict[str, Any], Plant | None, Path]:
    """Return the ``[model]`` table, the plant and the folder of files.

    Parameters
    ----------
    model : MjModel, MjSpec, str or Path
        MuJoCo model or spec, XML text, MJCF file, structure file, or name of a built-in structure.

    Returns
    -------
    tuple of (dict, Plant or None, Path)
        The plant is None for a structure, which the case builds.

    Raises
    ------
    BadStructure
        MuJoCo refuses the model.
    BadCase
        The source of an `MjModel` is unknown, or `model` is of another type.
    """
    if isinstance(model, mujoco.MjModel):
        model = _spec_of(model)
    if isinstance(model, mujoco.MjSpec):
        folder = Path(model.modelfiledir or ".")
        return {"mjcf": MODEL_FILE}, build_mjcf_spec(model.copy(), "MjSpec"), folder
    if isinstance(model, str) and model.lstrip().startswith("<"):
        return {"mjcf": MODEL_FILE}, build_mjcf(model), Path()
    if isinstance(model, str) and model in BUILT_IN:
        return {"structure": model}, None, Path()
    if not isinstance(model, str | Path):
        raise BadCase(
            f"{LABEL}: the model is {with_article(type(model).__name__)}; accepted: MjModel, MjSpec, XML text, a path, or the name of a "
            f"structure ({', '.join(BUILT_IN)})"
            + ("; the model is the first argument: from_arrays(model, t, inputs, outputs)" if np.ndim(model) else "")
        )
    path = Path(model)
    if path.suffix == ".toml":
        return {"structure": path.name}, None, path.parent
    return {"mjcf": path.name}, build_mjcf(path), path.parent


def _spec_of(model: Any) -> Any:
    """Return the spec of a compiled model.

    A compiled model holds no source. MuJoCo keeps the source of the last XML that it has loaded.
    """
    fix = "give what the model was compiled from: the path, the XML text or the MjSpec"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / MODEL_FILE
        try:
            mujoco.mj_saveLastXML(str(file), model)
            spec = mujoco.MjSpec.from_string(file.read_text(encoding="utf-8"))
            compiled = spec.compile()
        except Exception as error:  # MuJoCo raises several kinds with one meaning
            raise BadCase(f"{LABEL}: the source of the MjModel is not known ({one_line(error)}); {fix}") from error
    if not _is_same(model, compiled):
        raise BadCase(f"{LABEL}: the source of the MjModel is not known, another model was loaded after it; {fix}")
    spec.copy_back(model)
    return spec


def _is_same(model: Any, other: Any) -> bool:
    """Return whether two compiled models agree within the digits of XML."""
    if model.signature != other.signature or model.names != other.names:
        return False
    for name in dir(model):
        own = getattr(model, name) if not name.startswith("_") else None
        if not isinstance(own, np.ndarray) or own.dtype.kind not in "fiub":
            continue
        theirs = getattr(other, name)
        scale = float(np.abs(own).max(initial=0.0))
        if own.shape != theirs.shape or not np.allclose(own, theirs, rtol=EXACT, atol=EXACT * scale, equal_nan=True):
            return False
    return True


# ---- runs -----------------------------------------------------------------------------------------------------------


def read_arrays(
    plant: Plant,
    t: Any,
    inputs: Any,
    outputs: Any,
    *,
    channels: Mapping[str, Any],
    holdout: Any = None,
    initial: str = "auto",
) -> tuple[list[dict[str, Any]], dict[str, Table]]:
    """Return the ``[[recording]]`` tables of runs, and their columns.

    Parameters
    ----------
    plant : Plant
        Model, which gives kinds and units.
    t, inputs, outputs : object
        Times and columns of one run, or lists with one entry a run, see `vlab.cases.Case.from_arrays`.
    channels : mapping of str to mapping or str
        Keys of ``[[recording.channel]]`` by column, in place of those of the model.
    holdout : object
        Runs that are held out, or a share of every run.
    initial : str
        Initial state of the runs.

    Returns
    -------
    tuple of (list of dict, dict of str to Table)
        Tables of the case file, and columns by file name.

    Raises
    ------
    BadCase
        Lengths differ, a column is no array, or `holdout` is impossible.
    UnknownName
        A column has no counterpart in the model.
    """
    runs = list(_runs(plant, t, inputs, outputs))
    tables: dict[str, Table] = {}
    recordings: list[dict[str, Any]] = []
    unused = dict(channels)
    for i, (time, driving, measured) in enumerate(runs):
        name = f"run{i + 1}"
        columns, described = _columns(plant, name, time, driving, measured, channels)
        for channel in described:
            unused.pop(channel["column"], None)
        label = "time" if "time" not in columns else "time [s]"
        file = Table(path=Path(name), columns={label: time, **columns}, blanks=frozenset(columns))
        tables[name] = file
        recordings.append({"file": name, "name": name, "time": label, "initial": initial, "channel": described})
    if unused:
        known = {channel["column"] for recording in recordings for channel in recording["channel"]}
        raise unknown_name("column", next(iter(unused)), sorted(known), where=f"{LABEL}: channels")
    return _with_roles(recordings, tables, holdout), tables


def _runs(plant: Plant, t: Any, inputs: Any, outputs: Any) -> Iterator[tuple[Array, dict[str, Any], dict[str, Any]]]:
    """Yield times, inputs and outputs of each run."""
    is_many = isinstance(outputs, list | tuple)
    measured = list(outputs) if is_many else [outputs]
    if not measured:
        raise BadCase(f"{LABEL}: outputs has no run; give at least one")
    for what, given in (("inputs", inputs), ("t", t)):
        if is_many and isinstance(given, list | tuple) and _is_list_of_runs(what, given):
            if len(given) != len(measured):
                raise BadCase(
                    f"{LABEL}: {what} has {_count(len(given))}, outputs {_count(len(measured))}; give one for each run"
                )
        elif isinstance(given, list | tuple) and what == "inputs":
            raise BadCase(f"{LABEL}: inputs is a list of runs, outputs is not; give both as lists")
    for i, output in enumerate(measured):
        one_input = inputs[i] if isinstance(inputs, list | tuple) else inputs
        one_time = t[i] if is_many and isinstance(t, list | tuple) and _is_list_of_runs("t", t) else t
        frames = [frame for frame in (one_input, output) if frame is not None]
        time, name = _times(one_time, frames, i)
        columns = [{k: v for k, v in _named(frame).items() if k != name} for frame in (one_input, output)]
        yield time, *_sides(plant, columns[0], columns[1])


def _sides(plant: Plant, inputs: dict[str, Any], outputs: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return inputs and outputs of a run from one common table.

    The model then tells the sides apart: columns of actuators are inputs, columns of sensors and joints outputs.
    """
    is_one = len(inputs) > 1 and set(inputs) == set(outputs)
    if not is_one or not all(inputs[k] is outputs[k] or _is_equal(inputs[k], outputs[k]) for k in inputs):
        return inputs, outputs
    into = {name for name in inputs if _tap(plant.actuators, "actuator", name) is not None}
    both = [name for name in into if _tap(plant.sensors, "sensor", name) is not None]
    if both:
        raise BadCase(
            f"{LABEL}: column {both[0]!r} is in inputs and outputs, and the model has an actuator and a sensor of this name; "
            "give inputs and outputs their own columns"
        )
    return {k: inputs[k] for k in inputs if k in into}, {k: outputs[k] for k in outputs if k not in into}


def _is_equal(one: Any, other: Any) -> bool:
    a, b = np.asarray(one), np.asarray(other)
    return a.shape == b.shape and bool(np.array_equal(a, b, equal_nan=a.dtype.kind in "fc" and b.dtype.kind in "fc"))


def _tap(taps: Sequence[Any], side: str, at: str) -> Any:
    """Return the actuator or sensor of a name, or None."""
    return next((tap for tap in taps if tap.name and at in (tap.name, tap.at, f"{side}:{tap.name}")), None)


def _is_list_of_runs(what: str, given: Sequence[Any]) -> bool:
    return what != "t" or (len(given) > 0 and (np.ndim(given[0]) > 0 or isinstance(given[0], str)))


def _count(runs: int) -> str:
    return f"{runs} run{'s' * (runs != 1)}"


def _times(t: Any, frames: Sequence[Any], run: int) -> tuple[Array, str | None]:
    """Return the times of a run [s], and their column."""
    name = t if isinstance(t, str) else None
    if name is not None:
        holders = [frame for frame in frames if name in _named(frame)]
        if not holders:
            known = [column for frame in frames for column in _named(frame)]
            raise unknown_name("column", name, known, where=f"{LABEL}: t")
        t = _named(holders[0])[name]
    elif t is None:
        indexed = [frame for frame in frames if hasattr(frame, "index") and hasattr(frame, "columns")]
        if not indexed:
            raise BadCase(f"{LABEL}: t is None and run {run + 1} is no DataFrame with an index of times; give t in s")
        t = indexed[0].index
    return _numbers(seconds_of(t), f"t of run {run + 1}"), name


def _named(frame: Any) -> dict[str, Any]:
    """Return the columns of a mapping or data frame by name."""
    if frame is None:
        return {}
    if isinstance(frame, Mapping):
        return {str(name): values for name, values in frame.items()}
    if hasattr(frame, "columns") and hasattr(frame, "__getitem__"):
        return {str(name): frame[name] for name in frame.columns}
    raise BadCase(
        f"{LABEL}: a run is {with_article(type(frame).__name__)}; accepted: a dict of name to array, or a DataFrame with named columns"
    )


def _numbers(values: Any, what: str) -> Array:
    if np.iscomplexobj(values):
        raise BadCase(f"{LABEL}: {what} is complex; give real samples in time, such as its real part")
    try:
        numbers = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise BadCase(f"{LABEL}: {what} is not numeric: {one_line(error)}") from error
    if numbers.ndim not in (1, 2) or not numbers.size:
        raise BadCase(f"{LABEL}: {what} has the shape {numbers.shape}; give one number a sample")
    return numbers


def _columns(
    plant: Plant,
    run: str,
    time: Array,
    inputs: Mapping[str, Any],
    outputs: Mapping[str, Any],
    channels: Mapping[str, Any],
) -> tuple[dict[str, Array], list[dict[str, Any]]]:
    """Return the columns of a run, and the tables of their channels."""
    columns: dict[str, Array] = {}
    tables = []
    for is_input, given in ((True, inputs), (False, outputs)):
        for name, values in given.items():
            numbers = _numbers(values, f"{name!r} of {run}")
            if len(numbers) != len(time):
                raise BadCase(f"{LABEL}: {name!r} of {run} has {len(numbers)} samples, t has {len(time)}")
            for part, column in _parts(name, numbers):
                label = f"{'input' if is_input else 'output'}:{part}" if part in columns or part in _twins(
                    inputs, outputs
                ) else part  # fmt: skip
                own = _own_keys(label if label in channels else part, channels)
                columns[label] = column
                tables.append({"column": label, **_described(plant, part, is_input, own)})
    if all(table.get("input") for table in tables):
        raise BadCase(f"{LABEL}: {run} has no outputs; name at least one sensor or joint that was measured")
    return columns, tables


def _own_keys(name: str, channels: Mapping[str, Any]) -> dict[str, Any]:
    """Return the stated keys of a column; text is its unit."""
    own = channels.get(name, {})
    if isinstance(own, str):
        return {"unit": own}
    if not isinstance(own, Mapping):
        raise BadCase(
            f'{LABEL}: channels[{name!r}] is {with_article(type(own).__name__)}; accepted: a unit such as "mm", or a dict of '
            'keys such as {"at": "encoder", "unit": "mm"}'
        )
    return dict(own)


def _twins(inputs: Mapping[str, Any], outputs: Mapping[str, Any]) -> set[str]:
    """Return names of inputs that are also names of outputs."""
    return set(inputs) & set(outputs)


def _parts(name: str, numbers: Array) -> list[tuple[str, Array]]:
    """Return the scalar columns of an array; a vector sensor has three."""
    if numbers.ndim == 1:
        return [(name, numbers)]
    if numbers.shape[1] == 1:
        return [(name, numbers[:, 0])]
    if numbers.shape[1] == len(AXES):
        return [(f"{name}.{axis}", numbers[:, k]) for k, axis in enumerate(AXES)]
    raise BadCase(f"{LABEL}: {name!r} has {numbers.shape[1]} columns; give one array a sensor, of one or three columns")


def _described(plant: Plant, name: str, is_input: bool, own: dict[str, Any]) -> dict[str, Any]:
    """Return a column's channel table, with the model's kind and unit."""
    at = str(own.pop("at", name))
    taps: Sequence[Any] = plant.actuators if is_input else plant.sensors
    side = "actuator" if is_input else "sensor"
    tap = _tap(taps, side, at)
    port = None
    if tap is None:
        at, port = _port(plant, at)
        if port is None:
            known = [tap.name for tap in taps if tap.name] + list(plant.ports)
            raise unknown_name(side, at, known, where=f"{LABEL}: column {name!r}")
    kind, unit = (tap.kind, tap.unit) if tap is not None else _of_port(port, is_input)
    kind = str(own.pop("kind", kind))
    kind = _OF_ANGLE.get(kind, kind) if port is not None and port.unit == "rad" else kind
    table: dict[str, Any] = {"at": at, "kind": kind, **({"input": True} if is_input else {})}
    if "unit" not in own and "scale" not in own:
        si = KIND_UNITS.get(kind) or ("" if unit == "command" else unit)
        own |= {"unit": si} if si else {"scale": 1.0}
    return table | own


def _port(plant: Plant, at: str) -> tuple[str, Port | None]:
    """Return the port at a place, with or without a prefix."""
    for name in (at, f"joint:{at}", f"tendon:{at}"):
        if name in plant.ports:
            return name, plant.ports[name]
    return at, None


def _of_port(port: Any, is_input: bool) -> tuple[str, str]:
    if is_input:
        return ("force", "N") if port.unit == "m" else ("moment", "N m")
    return ("displacement", "m") if port.unit == "m" else ("angle", "rad")


# ---- roles ----------------------------------------------------------------------------------------------------------


def _with_roles(
    recordings: Sequence[dict[str, Any]], tables: Mapping[str, Table], holdout: Any
) -> list[dict[str, Any]]:
    """Return the tables with roles; a share makes two tables."""
    count = len(recordings)
    if holdout is None:
        holdout = HELD_OUT if count == 1 else count - 1
    if isinstance(holdout, float):
        if not 0 < holdout < 1:
            raise BadCase(f"{LABEL}: holdout is {holdout:g}; a share of every run is above 0 and below 1")
        return [part for recording in recordings for part in _split(recording, tables[recording["file"]], holdout)]
    held = [holdout] if isinstance(holdout, int) and not isinstance(holdout, bool) else holdout
    try:
        numbers = {range(count)[int(number)] for number in held}
    except (TypeError, ValueError, IndexError) as error:
        raise BadCase(
            f"{LABEL}: holdout is {holdout!r}; accepted: numbers of runs from 0 to {count - 1}, () for none, or a share of "
            "every run such as 0.3"
        ) from error
    if len(numbers) == count:
        held_out = "the only run is" if count == 1 else f"all {count} runs are"
        raise BadCase(f"{LABEL}: {held_out} held out; leave at least one to fit, or give a share such as 0.3")
    return [{**r, "role": "holdout" if i in numbers else "fit"} for i, r in enumerate(recordings)]


def _split(recording: Mapping[str, Any], table: Table, share: float) -> list[dict[str, Any]]:
    """Split a run into a fitted part and the held-out rest."""
    time = table[recording["time"]]
    first = min(max(round((1.0 - share) * time.size), 2), time.size - 2)
    if first < 2:
        raise BadCase(f"{LABEL}: {recording['name']} has {time.size} samples; at least 4 can be split")
    border = float(time[first])
    name = recording["name"]
    return [
        {**recording, "role": "fit", "stop_s": border},
        {**recording, "name": f"{name} held out", "role": "holdout", "start_s": border},
    ]


# ---- messages -------------------------------------------------------------------------------------------------------

IN_PYTHON = (
    (re.compile(r'say blank = "hold" in its channel'), 'say channels={COLUMN: {"blank": "hold"}}'),
    (re.compile(r"cut the part with start_s and stop_s"), "give runs without these samples"),
    (re.compile(r"give rate_hz instead"), "give even times instead, such as t = numpy.arange(n) / rate"),
    (re.compile(r"give rate_hz or the name of the time column"), "give times in s as t"),
)
"""IN_PYTHON: advice on a case file, and the same for `vlab.Case.from_arrays`."""
_CHANNEL = re.compile(r"recording\[(\d+)\]\.channel\[(\d+)\]")
_RECORDING = re.compile(r"recording\[(\d+)\](\.initial)?")


def in_memory_error(error: VlabError, recordings: Sequence[Mapping[str, Any]] = ()) -> VlabError:
    """Return an error with arguments in place of a file's keys.

    Parameters
    ----------
    error : VlabError
        Error with the words for a case file.
    recordings : sequence of mapping
        Tables of the recordings, whose numbers the message may hold.

    Returns
    -------
    VlabError
        Error of the same type, with the name of its case.
    """
    text = str(error)

    def channel(found: re.Match[str]) -> str:
        return f"channels[{recordings[int(found[1])]['channel'][int(found[2])]['column']!r}]"

    def recording(found: re.Match[str]) -> str:
        return "initial" if found[2] else f"run {recordings[int(found[1])]['name']!r}"

    if recordings:
        text = _RECORDING.sub(recording, _CHANNEL.sub(channel, text))
    text = text.replace("model: uncertain", "uncertain")
    for pattern, words in IN_PYTHON:
        text = pattern.sub(words, text)
    return type(error)(text if LABEL in text else f"{LABEL}: {text}")
