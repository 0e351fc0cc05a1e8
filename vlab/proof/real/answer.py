"""Answer to one real case: diagnosis, its errors, and the black boxes."""

import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from vlab.cases import load_case
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.validation.checked import Checked
from vlab.diagnose.validation.horizon import parts_within
from vlab.errors import VlabError
from vlab.files.output_folder import finite
from vlab.parallel import limited_to
from vlab.proof.real.black_box import black_boxes
from vlab.proof.real.errors import errors_of

MODELS = ("nominal", "calibrated", "extended")
"""MODELS: models of physics in the order of `Checked.simulated`."""


def answer_real(item: tuple[str, Path, int], *, time_limit: float | None = None) -> tuple[str, dict[str, Any]]:
    """Return the diagnosis of a real case.

    A failure is also an answer.

    Parameters
    ----------
    item : (name, path, skip)
        Case, its file, and the first samples that absolute errors leave out.
    time_limit : float or None
        See `vlab.diagnose.pipeline.diagnose` [s].

    Returns
    -------
    (name, answer)
        Name of the case, and the diagnosis as plain values with absolute errors and parts by hold-out recording.
    """
    name, path, skip = item
    answer = _guarded(partial(_diagnosed, path, skip, time_limit))
    return name, {"case": name, "skip": skip, "time_limit": time_limit, **answer}


def black_box_real(item: tuple[str, Path, int, dict[str, int]]) -> tuple[str, dict[str, Any]]:
    """Return the errors of the black boxes on a real case.

    Parameters
    ----------
    item : (name, path, skip, parts)
        Case, its file, first samples that absolute errors leave out, and parts by hold-out recording.

    Returns
    -------
    (name, answer)
        Name of the case, and the result of `vlab.proof.real.black_box.black_boxes`.
    """
    name, path, skip, parts = item
    answer = _guarded(lambda: black_boxes(load_case(path), parts, skip))
    return name, {"case": name, "skip": skip, **answer}


def _guarded(work: Any) -> dict[str, Any]:
    """Return the answer of some work or its failure, with duration [s]."""
    began = time.monotonic()
    try:
        with limited_to(1):
            answer = work()
    except VlabError as error:
        answer = {"verdict": "refused", "findings": [], "error": " ".join(str(error).split())}
    except Exception as error:  # a program fault is listed, and does not stop the other cases
        words = f"{type(error).__name__}: {' '.join(str(error).split())}"
        answer = {"verdict": "crashed", "findings": [], "error": words}
    answer["seconds"] = time.monotonic() - began
    document: dict[str, Any] = finite(answer)
    return document


def _diagnosed(path: Path, skip: int, time_limit: float | None) -> dict[str, Any]:
    diagnosis = diagnose(load_case(path), time_limit=time_limit).diagnosis
    checked = [c for c in diagnosis.checked if isinstance(c, Checked) and c.role == "holdout"]
    return {
        **diagnosis.to_json(),
        "parts": {c.name: parts_within(c.run, c.horizon_s) if np.isfinite(c.horizon_s) else 1 for c in checked},
        "absolute": {c.name: _absolute(c, skip) for c in checked},
    }


def _absolute(checked: Checked, skip: int) -> dict[str, Any]:
    """Return absolute errors by model, and the size of the channels."""
    found = {
        model: errors_of(checked.run, simulated, skip)
        for model, simulated in zip(MODELS, checked.simulated, strict=True)
    }
    return {"size": found["nominal"].size, **{model: errors.absolute for model, errors in found.items()}}
