"""Writing the case folder of a made-up rig: model, recordings, case file."""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq


@dataclass(frozen=True, kw_only=True)
class Channel:
    """A column of every recording and what it is in the model."""

    column: str
    at: str
    kind: str
    unit: str
    is_input: bool = False
    hold: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """One recording: its columns, and the name of the time column or else the rate."""

    name: str
    role: str
    columns: dict[str, np.ndarray]
    rate_hz: float | None = None
    initial: str = "rest"


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A case folder and what is hidden in it; the folder says nothing of it.

    Parameters
    ----------
    effect, place : str
        What the nominal model lacks and where; ``"none"`` and empty in a null case.
    parameters : mapping
        Its true parameters, SI.
    starts : mapping
        By recording: true positions and velocities at its first sample, where it does not start from rest.
    """

    folder: Path
    effect: str
    place: str
    parameters: dict[str, float]
    starts: dict[str, tuple[float, ...]] = field(default_factory=dict)


def write_case(
    folder: Path,
    *,
    title: str,
    mjcf: str,
    uncertain: dict[str, float],
    channels: list[Channel],
    records: list[Record],
) -> None:
    """Write ``rig.xml``, one Parquet file a recording and ``case.toml``."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.xml").write_text(mjcf, encoding="utf-8")
    lines = [f"title = {json.dumps(title)}", "[model]", 'mjcf = "rig.xml"', "[model.uncertain]"]
    lines += [f"{json.dumps(name)} = {value}" for name, value in uncertain.items()]
    for record in records:
        file = record.name.replace(" ", "_") + ".parquet"
        pq.write_table(pa.table(record.columns), folder / file)
        lines += ["[[recording]]", f'file = "{file}"', f'name = "{record.name}"', f'role = "{record.role}"']
        lines += ['time = "time"' if record.rate_hz is None else f"rate_hz = {record.rate_hz}"]
        lines += [f'initial = "{record.initial}"']
        for c in channels:
            lines += ["[[recording.channel]]", f'column = "{c.column}"', f'at = "{c.at}"', f'kind = "{c.kind}"']
            lines += [f'unit = "{c.unit}"']
            lines += ["input = true", f'hold = "{c.hold}"'] if c.is_input else []
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def multisine(rng: np.random.Generator, low: float, high: float, period: float, rms: float):
    """Return a function of time: a random-phase multisine on all lines from `low` to `high` [Hz]."""
    lines = np.arange(np.ceil(low * period), np.floor(high * period) + 1) / period
    phase = rng.uniform(0, 2 * np.pi, lines.size)
    amplitude = rms * np.sqrt(2 / lines.size)

    def signal(time):
        return amplitude * np.sin(2 * np.pi * np.multiply.outer(time, lines) + phase).sum(axis=-1)

    return signal
