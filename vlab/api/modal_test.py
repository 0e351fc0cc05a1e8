"""Modal test of recordings, run folders or foreign files."""

from collections.abc import Sequence
from pathlib import Path

from vlab.errors import BadRecording
from vlab.lab.run_folder import DoneRun, RunSettings, load_run
from vlab.modal.dwell import DwellResult
from vlab.modal.frf import Estimator
from vlab.modal.modal_test import ModalTest, ModalTestResult, read_signals, run_dwell_test, run_modal_test
from vlab.recordings import open_table
from vlab.recordings.assemble import ColumnSpec, on_even_stamps, to_recording
from vlab.recordings.table import Table
from vlab.signals import KIND_UNITS, Recording

TIME_NAMES = ("time", "t", "time [s]", "time (s)", "t [s]", "t (s)", "time_s", "x_value", "timestamp")
"""TIME_NAMES: names of the time column in foreign recordings."""
Source = Recording | DoneRun | Path | str
"""A recording, a run, a run folder or a file."""


def modal_test(
    runs: Source | Sequence[Source],
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    time: str | None = None,
    rate_hz: float | None = None,
    band_hz: tuple[float, float] | None = None,
    modes: int | None = None,
    estimator: Estimator = "H1",
    signal: str | None = None,
    period_s: float | None = None,
    segment_s: float | None = None,
    dwell_s: float | None = None,
    window_end: float = ModalTest.end_level,
) -> ModalTestResult | list[DwellResult]:
    """Estimate frequency responses, poles and mode shapes, with the defaults of ``vlab modal-test``.

    Recordings of one input are averaged, of different inputs combined.

    Parameters
    ----------
    runs : Recording, DoneRun, Path, str, or a sequence
        Recordings, runs of `vlab.experiment`, run folders or files.
    inputs, outputs : sequence of str
        Channels; by default the recording's inputs and sensors. Foreign files need them, as ``"NAME=KIND,UNIT"`` such as
        ``"acc1=acceleration,g"``.
    time : str, optional
        Time column of a foreign file; the column named time or t by default.
    rate_hz : float, optional
        Sample rate of a foreign file without a time column [Hz].
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
    recordings = [_recording(one, inputs, outputs, time, rate_hz) for one in sources]
    if all(signal.kind == "dwell" for signal in read_signals(recordings, test)):
        return [run_dwell_test(recording, test) for recording in recordings]
    return run_modal_test(recordings, test)


def _recording(
    source: Source, inputs: Sequence[str], outputs: Sequence[str], time: str | None, rate_hz: float | None
) -> Recording:
    if isinstance(source, Recording):
        return source
    if isinstance(source, DoneRun):
        return source.recording
    return load_recording(source, inputs=inputs, outputs=outputs, time=time, rate_hz=rate_hz)[0]


def load_recording(
    path: Path | str,
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    time: str | None = None,
    rate_hz: float | None = None,
) -> tuple[Recording, RunSettings | None]:
    """Load a run folder or a recording.

    Parameters
    ----------
    path : Path or str
        Run folder or file.
    inputs, outputs : sequence of str
        Channels of a foreign file, as ``"NAME=KIND,UNIT"``.
    time : str, optional
        Time column of a foreign file.
    rate_hz : float, optional
        Sample rate of a foreign file [Hz].

    Returns
    -------
    tuple of (Recording, RunSettings or None)
        Recording, and the settings of a run folder.

    Raises
    ------
    BadRecording
        The file is damaged, or its columns are not named.
    """
    if Path(path).is_dir():
        return load_run(path)
    table = open_table(path)
    if table.channels is not None:
        return load_run(path)
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
    return on_even_stamps(to_recording(table, specs, rate_hz=rate_hz, time=time)), None


def _name(text: str) -> str:
    return text.partition("=")[0]


def _spec(text: str, *, is_input: bool, table: Table) -> ColumnSpec:
    """Read ``NAME``, ``NAME=KIND`` or ``NAME=KIND,UNIT``; values stay unscaled without a kind."""
    name, equals, rest = text.partition("=")
    kind, _, unit = rest.partition(",")
    if equals and not kind:
        raise BadRecording(f"{text!r} has not the form NAME=KIND,UNIT (kinds: {', '.join(KIND_UNITS)})")
    if not equals:
        return ColumnSpec(column=name, kind="other", name=name, scale=1.0, is_input=is_input)
    unit = unit or table.units.get(name) or KIND_UNITS.get(kind) or ""
    return ColumnSpec(column=name, kind=kind, unit=unit, name=name, is_input=is_input)
