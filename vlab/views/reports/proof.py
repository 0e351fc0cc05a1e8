"""Report of a campaign of concealed cases: counts, intervals, figures, failures."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from vlab.proof.judge import NOTHING
from vlab.proof.levels import level_table
from vlab.proof.peers.scoring import peer_table
from vlab.proof.prove import table_rows
from vlab.proof.score import STRUCTURES
from vlab.proof.stated import EDGE, decision_table, stated_table
from vlab.views.figures import to_svg
from vlab.views.figures.proof import confusion_figure, detection_figure, rates_figure, reliability_figure
from vlab.views.reports.page import Section, write_report


def write_proof(found: Mapping[str, Any], path: Path) -> None:
    """Write a score of `vlab.proof.prove.prove` as one HTML page.

    Parameters
    ----------
    found : mapping
        Score.
    path : Path
        Output file.

    Raises
    ------
    OutputRefused
        The file cannot be written.
    """
    missed = [m["measure"] for m in found["measures"] if m["met"] is False]
    open_ = sum(m["met"] is None and bool(m["target"]) for m in found["measures"])
    met = "Every target that could be counted is met" + (f"; {open_} had no cases." if open_ else ".")
    rules = (
        "" if found["is_counted_as_set_down"] else " The rules of counting were changed after the answers were begun."
    )
    first = "answered before their truth was opened"
    if not found["is_answered_first"]:
        first = "answered after their truth had been opened for other answers, and so no evidence"
    again = found.get("truths_made_again", ())
    remade = (
        f" The truth of {len(again)} was made again from the seed of the plan, and so were the recordings, bit for bit: its salts were lost."
        if again
        else ""
    )
    untried = f"Never hidden: {', '.join(found['never_hidden'])}." if found["never_hidden"] else ""
    summary = (
        f"{found['cases']} cases, seed {found['plan']['seed']}, {first}; "
        f"thresholds {found['answered_with']['thresholds_sha256'][:12]}, code {found['answered_with']['code'][:12]}.{rules}{remade} {untried}",
        f"Targets missed: {'; '.join(missed)}." if missed else met,
    )
    parts = [
        _measures(found),
        _suites(found),
        _levels(found),
        _detection(found),
        _calibration(found),
        _confusion(found),
    ]
    parts += [_failures(found), _baselines(found)]
    write_report(path, title="What was concealed, and what was found", sections=parts, summary=summary)


def evidence_figure(found: Mapping[str, Any]) -> str:
    """Return the counted rates of a score as a drawing."""
    return to_svg(rates_figure(_rates(found["measures"])))


def _rates(
    measures: Sequence[Mapping[str, Any]],
) -> list[tuple[str, int, int, tuple[float, float], tuple[float | None, float | None]]]:
    """Return the rows of `rates_figure` with at least one count."""
    rows = []
    for m in measures:
        if "count" not in m or not m["of"]:
            continue
        value = m["target"].partition(",")[0]  # the bound of the interval's lower end is not drawn
        ends = [float(word) for word in value.strip("<>= ").split(" to ") if word]
        least = None if not ends or m["target"].startswith("<=") else ends[0]
        most = ends[-1] if len(ends) > 1 or m["target"].startswith("<=") else None
        rows.append((m["measure"], m["count"], m["of"], tuple(m["ci95"]), (least, most)))
    return rows


def _measures(found: Mapping[str, Any]) -> Section:
    heads, rows = table_rows(found)
    caption = (
        "Every share that was counted, with its 95 % interval, beside its target: exact (Clopper and Pearson), of parameters by "
        "drawing whole cases with replacement."
    )
    return Section(title="What was counted", tables=[(heads, rows)], figures=[(evidence_figure(found), caption)])


def _suites(found: Mapping[str, Any]) -> Section:
    heads = ("suite", "cases", "right", "95 % interval", "verdicts", "by bench", "by noise")
    rows = []
    for name, s in found["suites"].items():
        low, high = s["right"]["ci95"]
        verdicts = ", ".join(f"{v} {n}" for v, n in s["verdicts"].items())
        parts = [", ".join(f"{k} {r['count']}/{r['of']}" for k, r in s[of].items()) for of in ("benches", "noise")]
        right = f"{s['right']['count']}/{s['right']['of']}"
        rows.append([name, s["cases"], right, f"{low:.3f} to {high:.3f}", verdicts, *parts])
    text = (
        "Right is: the hidden effect named in its equivalence class; of nothing hidden, nothing-missing; of what is not in the "
        "library, none-of-these."
    )
    return Section(title="By suite", text=text, tables=[(heads, rows)])


def _levels(found: Mapping[str, Any]) -> Section:
    text = (
        "First finding of cases with an effect of the library: exact place, and family, and effect in its class, and the very law. "
        "A level counts only with all before it. missing-physics counts out of all cases of the bench, a partial verdict out of "
        "its own cases; the form counts where the hidden law is that of the library."
    )
    return Section(title="How far down an answer is right", text=text, tables=[level_table(found["levels"])])


def _detection(found: Mapping[str, Any]) -> Section:
    heads = ("effect", "cases", "noticed", "in 50 %", "in 90 %", "named in class", "in 50 %", "in 90 %")
    rows = [[name, d["cases"], *_limits(d["noticed"]), *_limits(d)] for name, d in found["detection"].items()]
    alone = [
        j
        for j in found["judged"]
        if len(j["hidden"]) == 1 and j["size"] and j["in_library"] and j["bench"] not in STRUCTURES
    ]
    figures = []
    if alone:
        drawn = detection_figure(
            [j["size"] for j in alone],
            {
                "noticed": [j["verdict"] != NOTHING for j in alone],
                "named in class": [j["right_class"] for j in alone],
            },
        )
        caption = "Single effects of the library in the rigs: noticed and named, over their residual after calibration."
        figures.append((to_svg(drawn), caption))
    text = (
        "Size: residual of the calibrated model without the effect, in multiples of the noise; with its 95 % interval within the "
        "tried sizes. Noticed: any verdict but nothing-missing. A dash: too few cases for a limit."
    )
    return Section(title="What size is found", text=text, tables=[(heads, rows)], figures=figures)


def _limits(d: Mapping[str, Any]) -> list[Any]:
    """Return the detected count and size limits."""
    return [d["detected"], *(_limit(d, key) for key in ("size_50", "size_90"))]


def _limit(d: Mapping[str, Any], key: str) -> str | None:
    if d[key] is None:
        return None
    interval = f" ({d['ci95'][key][0]:.3g} to {d['ci95'][key][1]:.3g})" if key in d["ci95"] else ""
    return f"{d['beyond'].get(key, '')}{d[key]:.3g}{interval}"


def _calibration(found: Mapping[str, Any]) -> Section:
    figures = []
    if found["calibration"]:
        caption = "Dotted: as often as said. Numbers: findings in the bin; intervals of 95 %."
        figures.append((to_svg(reliability_figure(found["calibration"])), caption))
    text = (
        "Decisions: a name counts from the stated probability on, everything else abstains; right is the class. Wrong names "
        "with nothing hidden and outside the library stand apart.",
        "Log score: mean negative log likelihood that the first finding is there, of the unknown law that something is at its place; "
        f"probabilities end at {EDGE:g} and {1 - EDGE:g}. Verdicts without a finding state none. The last column is the score of "
        "the share that holds, stated always.",
    )
    tables = [decision_table(found["decisions"]), stated_table(found["stated"])]
    return Section(title="How far probabilities hold", text=text, tables=tables, figures=figures)


def _confusion(found: Mapping[str, Any]) -> Section:
    single = {truth: row for truth, row in found["confusion"].items() if " + " not in truth}
    if not single:
        return Section(title="What was taken for what", text="Two things were hidden in every case.")
    caption = "A row for what was hidden alone, a column for the first answer; the ring is the effect's own name."
    return Section(title="What was taken for what", figures=[(to_svg(confusion_figure(single)), caption)])


def _failures(found: Mapping[str, Any]) -> Section:
    heads = ("case", "suite", "bench", "noise", "hidden", "at", "size", "answered", "at", "probability")
    keys = ("case", "suite", "bench", "noise", "hidden", "truth_place", "size", "answered", "place", "probability")
    wrong = [{**j, "hidden": " + ".join(j["hidden"]) or "nothing"} for j in found["judged"] if not j["right"]]
    rows = [[j[key] for key in keys] for j in wrong]
    failed = [f"{f['case']}: {f['error']}" for f in found["failed"]]
    return Section(title="Every wrong answer", text=failed, tables=[(heads, rows)] if rows else [])


def _baselines(found: Mapping[str, Any]) -> Section:
    heads, rows = peer_table(found)
    return Section(title="Beside other methods", text="vlab: on the same cases.", tables=[(heads, rows)])
