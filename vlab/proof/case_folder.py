"""Case folder of a concealed case: recordings and nominal model."""

import json
import os
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from vlab.proof.generator.concealed import Concealed

STAMP = 946_684_800
"""STAMP [s]: time of every file, the first second of 2000."""


def write_case(case: Concealed, folder: Path) -> None:
    """Write ``case.toml``, the nominal model and Parquet recordings.

    Names, order and layout do not depend on the hidden effect. The files hold numbers and column names only.
    """
    folder.mkdir(parents=True)
    for name, text in case.blueprint.files.items():
        (folder / name).write_text(text, encoding="utf-8")
    driven = sorted(case.plan.driven, key=case.blueprint.exciters.index)
    lines = [f"title = {json.dumps(case.blueprint.title)}", "[model]", *_keys(case.blueprint.model)]
    lines += ["[model.uncertain]", *_keys(case.blueprint.uncertain)]
    for i, recording in enumerate(case.plan.recordings):
        file = f"run{i + 1}.parquet"
        columns = {
            f"u{j + 1}": case.plan.commands[:, case.blueprint.exciters.index(a), i] for j, a in enumerate(driven)
        }
        columns |= {f"y{j + 1}": case.outputs[:, j, i] for j in range(case.outputs.shape[1])}
        pq.write_table(pa.table(columns), folder / file, compression="zstd", use_dictionary=False)
        lines += ["[[recording]]", *_keys({"file": file, "role": recording.role, "rate_hz": case.blueprint.rate_hz})]
        lines += _keys({"initial": case.blueprint.initial}) if case.blueprint.initial else []
        for j, name in enumerate(driven):
            channel = {"column": f"u{j + 1}", "at": name, "kind": case.blueprint.input_kind}
            lines += ["[[recording.channel]]", *_keys(channel), f'unit = "{case.blueprint.input_unit}"']
            lines += ["input = true", 'hold = "zero"']
        for j, (name, kind, unit) in enumerate(case.sensors):
            channel = {"column": f"y{j + 1}", "at": name, "kind": kind, "unit": unit}
            lines += ["[[recording.channel]]", *_keys(channel)]
        if case.law is not None:
            lines += ["[recording.controller]", *_keys({**case.law, "rate_hz": case.blueprint.rate_hz})]
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    for path in (*folder.iterdir(), folder):  # file times would reveal the hidden effect
        os.utime(path, (STAMP, STAMP))


def _keys(table: Any) -> list[str]:
    return [f"{key} = {json.dumps(value)}" for key, value in table.items()]
