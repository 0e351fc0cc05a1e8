"""Modal test of recordings, run folders, foreign files or frequency responses."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vlab.errors import BadRecording, VlabError
from vlab.files.arguments import checked
from vlab.files.examples import located
from vlab.files.text import with_article
from vlab.lab.run_folder import DoneRun, RunSettings, load_run
from vlab.modal.dwell import DwellResult
from vlab.modal.frf import Estimator
from vlab.modal.modal_test import (
    ModalTest,
    ModalTestResult,
    read_signals,
    run_dwell_test,
    run_modal_test,
    run_response_test,
)
from vlab.recordings import open_table
from vlab.recordings.assemble import ColumnSpec, on_even_stamps, to_recording
from vlab.recordings.frames import DataFrame, table_of
from vlab.recordings.response_files import SideSpec, check_names, read_responses, response_labels
from vlab.recordings.response_labels import frequency_column
from vlab.recordings.table import EVERY, Table, not_finite
from vlab.signals import KIND_UNITS, FrequencyResponse, Recording

TIME_NAMES = ("time", "t", "time [s]", "time (s)", "t [s]", "t (s)", "time_s", "x_value", "timestamp")
"""TIME_NAMES: names of the time column in foreign recordings."""
OPTIONS = {
    "--input": "inputs",
    "--output": "outputs",
    "--time": "time",
    "--rate": "rate_hz",
    "--frequency": "frequency",
    "--band": "band_hz",
    "--modes": "modes",
    "--signal": "signal",
    "--period": "period_s",
    "--segment": "segment_s",
    "--dwell": "dwell_s",
    "--window-end": "window_end",
}
"""OPTIONS: argument by option of ``vlab modal-test``."""
Source = Recording | FrequencyResponse | DoneRun | DataFrame | Path | str
"""A recording, frequency responses, a run, a data frame, a run folder or a file."""
Loaded = tuple[Recording | tuple[FrequencyResponse, ...], RunSettings | None]
"""A recording or frequency responses, with the settings of a run folder."""


@checked(
    BadRecording,
    options=OPTIONS,
    runs="for samples, give a DataFrame with named columns, its times as index or column, and inputs and outputs",
)
def modal_test(
    runs: Source | Sequence[Source],
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    time: str | None = None,
    rate_hz: float | None = None,
    frequency: str | None = None,
    band_hz: tuple[float, float] | None = None,
    modes: int | None = None,
    estimator: Estimator = "H1",
    signal: str | None = None,
    period_s: float | None = None,
    segment_s: float | None = None,
    dwell_s: float | None = None,
    window_end: float = ModalTest.end_level,
) -> ModalTestResult | list[DwellResult]:
    """Estimate frequency responses, poles and mode shapes, as ``vlab modal-test`` does.

    Recordings of one input are averaged, of different inputs combined. The same holds for measured frequency responses,
    which take the place of recordings.

    Parameters
    ----------
    runs : Recording, FrequencyResponse, DoneRun, DataFrame, Path, str, or a sequence
        Recordings, runs of `vlab.experiment`, run folders, files or data frames; or frequency responses or files with
        such. A data frame has its times in a column or in its index.
    inputs, outputs : sequence of str
        Channels; by default the recording's inputs and sensors. Foreign files need them, as ``"NAME=KIND,UNIT"`` such as
        ``"acc1=acceleration,g"``.
    time : str, optional
        Time column of a foreign file; the column named time or t by default.
    rate_hz : float, optional
        Sample rate of a foreign file without a time column [Hz].
    frequency : str, optional
        Frequency column of a file of frequency responses; the column named f or frequency by default.
    band_hz : (low, high), optional
        Band of the modes [Hz]; all lines by default.
    modes : int, optional
        Number of reported modes; as many as the data support by default.
    estimator : str
        ``"H1"``, ``"H2"`` or ``"Hv"``.
    signal : str, optional
        Kind of excitation; from notes or samples of the recording by default.
    period_s : float, optional
        Period of the excitation [s].
    segment_s : float, optional
        Length of segments of random data, or of blocks of bursts or blows [s].
    dwell_s : float, optional
        Duration of each step of a stepped sine [s].
    window_end : float
        Value of the exponential window at the end of a hammer block; 1 for no window.

    Returns
    -------
    ModalTestResult or list of DwellResult
        Responses, poles and shapes; one result a recording where every recording is a dwell.

    Raises
    ------
    BadRecording
        A recording is damaged, or a setting is impossible.
    UnknownName
        No such channel.
    """
    test = ModalTest(
        inputs=tuple(_name(text) for text in inputs),
        outputs=tuple(_name(text) for text in outputs),
        band_hz=band_hz,
        n_modes=modes,
        estimator=estimator,
        signal=signal,
        period_s=period_s,
        segment_s=segment_s,
        dwell_s=dwell_s,
        end_level=window_end,
    )
    sources: list[Source] = list(runs) if isinstance(runs, list | tuple) else [runs]  # type: ignore[list-item]
    loaded = load_runs(sources, inputs=inputs, outputs=outputs, time=time, rate_hz=rate_hz, frequency=frequency)
    recordings = [data for data, _ in loaded if isinstance(data, Recording)]
    responses = [response for data, _ in loaded if not isinstance(data, Recording) for response in data]
    if responses:
        notes = dict.fromkeys(note for response in responses for note in getattr(response, "notes", ()))
        return run_response_test(responses, test, notes=tuple(notes))
    if all(signal.kind == "dwell" for signal in read_signals(recordings, test)):
        return [run_dwell_test(recording, test) for recording in recordings]
    return run_modal_test(recordings, test)


def load_runs(
    sources: Sequence[Source],
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    time: str | None = None,
    rate_hz: float | None = None,
    frequency: str | None = None,
) -> list[Loaded]:
    """Load recordings, or frequency responses in place of recordings.

    Parameters
    ----------
    sources : sequence
        Objects, run folders or files, all with records in time or all with frequency responses.
    inputs, outputs : sequence of str
        Channels of foreign files, as ``"NAME=KIND,UNIT"``.
    time, rate_hz : optional
        Time column, and sample rate of foreign files [Hz].
    frequency : str, optional
        Frequency column of files of frequency responses.

    Returns
    -------
    list
        One recording or tuple of frequency responses a source, with the settings of a run folder.

    Raises
    ------
    BadRecording
        Records in time and frequency responses are mixed, a file is damaged, or its columns are not named.
    """
    sources = [located(one) if isinstance(one, str) else one for one in sources]
    named = [_name(text) for text in (*inputs, *outputs)] if inputs and outputs else []
    tables = [_table(one, named, time, rate_hz) for one in sources]
    given = [
        isinstance(one, FrequencyResponse) if table is None else _holds_responses(table, named, frequency)
        for one, table in zip(sources, tables, strict=True)
    ]
    if any(given) and not all(given):
        first, other = (_called(sources[given.index(side)]) for side in (False, True))
        raise BadRecording(
            f"{first} holds records in time and {other} frequency responses; test records and responses one by one"
        )
    if any(given):
        for key, value in (("time", time), ("rate", rate_hz)):
            if value is not None:
                raise BadRecording(f"frequency responses have no {key}; leave out --{key}")
    into, out = ([SideSpec(*_parts(text)) for text in texts] for texts in (inputs, outputs))
    of_files = [table for table, is_given in zip(tables, given, strict=True) if is_given and table is not None]
    labels = [label for table in of_files for label in response_labels(table, frequency=frequency)]
    if labels and len(of_files) == len(sources):
        check_names(labels, inputs=into, outputs=out, where=", ".join(map(_called, sources[:4])))
    loaded: list[Loaded] = []
    for one, table, is_given in zip(sources, tables, given, strict=True):
        if isinstance(one, Recording):
            loaded.append((one, None))
        elif isinstance(one, FrequencyResponse):
            loaded.append(((one,), None))
        elif isinstance(one, DoneRun):
            loaded.append((one.recording, None))
        elif isinstance(one, str | Path) and (table is None or table.channels is not None):
            loaded.append(load_run(one))
        elif table is None:  # a data frame has one
            raise BadRecording(f"{_called(one)} cannot be read as a recording")
        elif is_given:
            if len(sources) > 1 and not inputs:
                _check_named(table, frequency)
            loaded.append((read_responses(table, inputs=into, outputs=out, frequency=frequency, is_part=True), None))
        else:
            loaded.append((_labelled(table, inputs, outputs, time, rate_hz), None))
    return loaded


def _table(source: Source, named: Sequence[str], time: str | None, rate_hz: float | None) -> Table | None:
    """Return the columns of a file or a data frame.

    A column that is not used may hold anything.
    """
    if isinstance(source, str | Path):
        if Path(source).is_dir():
            return None
        try:
            return open_table(source)
        except BadRecording:
            if not named:
                raise
            used = [*named, time] if time is not None else named
            columns = used if time is not None or rate_hz is not None else None  # else the time column is to be found
            try:
                table = open_table(source, columns=columns, blanks=EVERY)
            except VlabError:
                table = None
            if table is None:
                raise
            return _whole(table, used)
    is_own = isinstance(source, Recording | FrequencyResponse | DoneRun)
    if is_own or not isinstance(source, DataFrame):
        return None
    table = table_of(source, times=TIME_NAMES)
    return _whole(table, named)


def _whole(table: Table, used: Sequence[str]) -> Table:
    """Return a table, or refuse a used column with gaps."""
    times = [name for name in table.names if name.strip().lower() in TIME_NAMES]
    for name in (*used, *times):
        if not np.isfinite(table[name]).all():
            raise BadRecording(f"{table.path}: column {name!r}: {not_finite(table[name])}")
    return table


def _called(source: Source) -> str:
    return str(source) if isinstance(source, Path | str) else with_article(type(source).__name__)


def _holds_responses(table: Table, named: Sequence[str], frequency: str | None) -> bool:
    """Return whether a file is read as frequency responses.

    A file with both is read as records in time if the user names only real columns of the records.
    """
    if table.channels is not None:
        return False
    if frequency is not None:
        return True
    labels = response_labels(table)
    has_time = any(name.strip().lower() in TIME_NAMES for name in table.names)
    if has_time and not any(np.iscomplexobj(table[label.column]) for label in labels):
        return False  # magnitudes and phases over time are records
    if labels:
        used = {name for label in labels for name in (label.column, label.imaginary, label.phase)}
        return not named or any(name in used or name not in table.names for name in named)
    return bool(frequency_column(table.names, table.units)) and not named


def _check_named(table: Table, frequency: str | None) -> None:
    """Refuse responses to unnamed inputs beside those of other files."""
    if any(not label.input for label in response_labels(table, frequency=frequency)):
        raise BadRecording(
            f"{table.path}: the file does not name the input of its responses; name it with --input, or name columns "
            "OUTPUT/INPUT where the files have different inputs"
        )


def _labelled(
    table: Table, inputs: Sequence[str], outputs: Sequence[str], time: str | None, rate_hz: float | None
) -> Recording:
    """Return a foreign file's columns as a recording."""
    path = table.path
    if not inputs or not outputs:
        raise BadRecording(
            f"{path}: the columns carry no labels; name them with --input and --output (columns: {', '.join(table.names[:20])})"
        )
    specs = [_spec(text, is_input=True, table=table) for text in inputs]
    specs += [_spec(text, is_input=False, table=table) for text in outputs]
    if time is None and rate_hz is None:
        time = next((name for name in table.names if name.strip().lower() in TIME_NAMES), None)
    if time is None and rate_hz is None:
        raise BadRecording(
            f"{path}: no column is named time; name it with --time, or give --rate (columns: {', '.join(table.names[:20])})"
        )
    return on_even_stamps(to_recording(table, specs, rate_hz=rate_hz, time=time))


def _name(text: str) -> str:
    return text.partition("=")[0]


def _parts(text: str) -> tuple[str, str, str]:
    """Return name, kind and unit of ``NAME``, ``NAME=KIND`` or ``NAME=KIND,UNIT``."""
    name, equals, rest = text.partition("=")
    kind, _, unit = rest.partition(",")
    if equals and not kind:
        raise BadRecording(f"{text!r} has not the form NAME=KIND,UNIT (kinds: {', '.join(KIND_UNITS)})")
    return name, kind, unit


def _spec(text: str, *, is_input: bool, table: Table) -> ColumnSpec:
    """Read ``NAME``, ``NAME=KIND`` or ``NAME=KIND,UNIT``; values stay unscaled without a kind."""
    name, kind, unit = _parts(text)
    if not kind:
        return ColumnSpec(column=name, kind="other", name=name, scale=1.0, is_input=is_input)
    unit = unit or table.units.get(name) or KIND_UNITS.get(kind) or ""
    return ColumnSpec(column=name, kind=kind, unit=unit, name=name, is_input=is_input)
