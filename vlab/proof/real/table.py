"""Rows, Markdown and counts of real cases."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from vlab.proof.real.known import KnownCase

ERRORS = ("nominal", "calibrated", "extended", "linear", "nonlinear")
"""ERRORS: models whose hold-out errors are printed: three of physics, two black boxes."""
SHOWN_NAME = {"linear": "linear black box", "nonlinear": "nonlinear black box"}
IMPROBABLE = 0.5
"""IMPROBABLE [-]: probability below which a right finding is marked."""
MOST_PRINTED = 10.0
"""MOST_PRINTED [-]: relative error above which no digits are printed."""


def errors_by_model(answer: Mapping[str, Any], boxes: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the relative hold-out error of every model.

    Parameters
    ----------
    answer : mapping
        Diagnosis.
    boxes : mapping
        Black boxes.

    Returns
    -------
    dict
        Error over all hold-out recordings by model; None where a model has none or diverges.
    """
    heldout = answer.get("heldout") or {}
    has_findings = bool(answer.get("findings"))
    return {
        "nominal": heldout.get("nrmse_nominal"),
        "calibrated": heldout.get("nrmse_refitted"),
        "extended": heldout.get("nrmse_after") if has_findings else None,
        **{kind: (boxes.get(kind) or {}).get("nrmse") for kind in ("linear", "nonlinear")},
    }


def is_held_out(answer: Mapping[str, Any]) -> bool:
    """Return whether all errors are of hold-out data."""
    rows = (answer.get("heldout") or {}).get("per_recording") or []
    return bool(rows) and all(row["role"] == "holdout" for row in rows)


def metrics_of(known: KnownCase | None, answer: Mapping[str, Any], boxes: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the errors in the form of the benchmark's community.

    Parameters
    ----------
    known : KnownCase or None
        Key with the benchmark.
    answer, boxes : mapping
        Diagnosis and black boxes.

    Returns
    -------
    list of dict
        Error of every model on every hold-out recording: absolute in the printed unit, and relative to the recorded
        values' norm [%]; None after divergence.
    """
    if known is None or not known.benchmark:
        return []
    mark, out = known.benchmark[0], []
    for name, errors in (answer.get("absolute") or {}).items():
        size = errors["size"].get(mark.channel)
        found = {model: errors[model].get(mark.channel) for model in ERRORS if model in errors}
        if not answer.get("findings"):
            found.pop("extended", None)
        for kind in ("linear", "nonlinear"):
            rows = (boxes.get(kind) or {}).get("per_recording") or []
            own = next((row for row in rows if row["name"] == name), None)
            found |= {} if own is None else {kind: own["absolute"].get(mark.channel)}
        for model, error in found.items():
            relative = None if error is None or not size else 100.0 * error / size
            absolute = None if error is None else mark.factor * error
            out.append({"recording": name, "model": model, "rmse": absolute, "unit": mark.unit, "relative": relative})
    return out


def counts(rows: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Return the number of cases by result of the comparison."""
    return dict(Counter(row["met"] for row in rows))


def count_sentence(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the counts in words.

    Parameters
    ----------
    rows : sequence of mapping
        Cases.

    Returns
    -------
    str
        Sentence without its full stop.
    """
    keyed = [row for row in rows if row["met"] not in ("no key", "undocumented")]
    words = [f"{n} {word}" for word, n in counts(keyed).items()]
    met = [row for row in keyed if row["met"] == "met"]
    partial, improbable = sum(row["verdict"] == "partly-explained" for row in met), sum(map(is_improbable, met))
    note = (
        f"; of those met, {partial} are partial explanations, {improbable} improbable" if partial or improbable else ""
    )
    return f"{len(keyed)} of {len(rows)} cases have a documented key: {', '.join(words) or 'none'}{note}"


def percent(error: float | None) -> str:
    """Return a relative error as printed.

    Parameters
    ----------
    error : float or None
        Relative error [-].

    Returns
    -------
    str
        Two digits in percent; a dash without an error.
    """
    if error is None:
        return "-"
    return (
        f"> {100 * MOST_PRINTED:.0f}"
        if error > MOST_PRINTED
        else f"{100 * error:.2g}"
        if error < 0.1
        else f"{100 * error:.0f}"
    )


def finding_words(row: Mapping[str, Any]) -> str:
    """Return the findings of a case in words, with places and probabilities."""
    if row["error"]:
        return str(row["error"])
    words = [f"{f['effect']} at {f['place']} ({f['probability']:.2f})" for f in row["findings"]]
    return ", ".join(words) or "-"


def key_words(row: Mapping[str, Any]) -> str:
    """Return the result of the comparison in words."""
    further = row["further"] if row["met"] in ("met", "in part", "family") else []
    return row["met"] + (" (improbable)" if is_improbable(row) else "") + "".join(f" + {name}" for name in further)


def is_improbable(row: Mapping[str, Any]) -> bool:
    """Return whether a right finding has a probability below one half."""
    return row["probability"] is not None and row["probability"] < IMPROBABLE


def box_words(row: Mapping[str, Any], kind: str) -> str:
    """Return a black box's error as printed, or the reason."""
    found = row["black_boxes"].get(kind) or {}
    if found.get("nrmse") is not None:
        return percent(found["nrmse"])
    return "diverged" if "diverged" in found.get("note", "") else "n/a"


def markdown(found: Mapping[str, Any]) -> str:
    """Return the tables of the cases and of the benchmarks.

    Parameters
    ----------
    found : mapping
        Result of `vlab.proof.real.prove.prove_real`.

    Returns
    -------
    str
        Markdown text.
    """
    heads = ["case", "known", "verdict", "findings (probability)", "key", "nominal", "calibrated", "extended"]
    lines = _table(
        [*heads, "linear black box", "nonlinear black box", "s"],
        [_cells(row) for row in found["cases"]],
    )
    lines += ["", f"{found['summary']}.", ""]
    lines += ["Errors are in % of the rms of the hold-out recordings. A star marks errors of fitted recordings."]
    marks = [row for row in found["cases"] if row["metrics"]]
    if marks:
        heads = ["benchmark", "recording", "model", "RMSE", "relative error [%]"]
        lines += ["", *_table(heads, [cells for row in marks for cells in metric_cells(row)])]
        lines += ["", *(f"{row['benchmark']['name']}: {row['benchmark']['remark']}" for row in marks)]
    return "\n".join(lines) + "\n"


def _cells(row: Mapping[str, Any]) -> list[str]:
    star = "" if row["is_held_out"] else "*"
    shown = [percent(row["errors"][model]) for model in ("nominal", "calibrated", "extended")]
    known = row["known"]["known"] if row["known"] else "-"
    return [
        row["case"],
        known,
        row["verdict"],
        finding_words(row),
        key_words(row),
        *(text if text == "-" else text + star for text in shown),
        box_words(row, "linear"),
        box_words(row, "nonlinear"),
        f"{row['seconds']:.0f}",
    ]


def metric_cells(row: Mapping[str, Any]) -> list[list[str]]:
    """Return the printed errors of a benchmark.

    Parameters
    ----------
    row : mapping
        Case with metrics.

    Returns
    -------
    list of list of str
        Benchmark, recording, model, absolute and relative error, one list a model.
    """
    return [
        [
            row["benchmark"]["name"],
            one["recording"],
            SHOWN_NAME.get(one["model"], one["model"]),
            "diverged" if one["rmse"] is None else f"{one['rmse']:.3g} {one['unit']}",
            "-" if one["relative"] is None else f"{one['relative']:.2f}",
        ]
        for one in row["metrics"]
    ]


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(" ".join(cell.replace("|", "\\|").split()) for cell in cells) + " |"

    return [line(heads), "|" + "---|" * len(heads), *(line(row) for row in rows)]
