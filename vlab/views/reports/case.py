"""Report and Rerun file of a case: recordings beside their model."""

from pathlib import Path

from vlab.cases.compare import Comparison, RunComparison
from vlab.cases.log_units import in_log_unit, log_units
from vlab.files.text import as_sentence
from vlab.views.figures import comparison_figure, to_svg
from vlab.views.reports.page import Section, write_report
from vlab.views.rerun.scene import write_comparison

HEADERS = (
    "recording",
    "role",
    "channel",
    "NRMSE",
    "variance accounted for",
    "mean error",
    "rms error",
    "recorded/simulated rms",
    "correlation",
    "most of the error",
    "unit",
)


def misfit_rows(comparison: Comparison) -> list[list[object]]:
    """Return a row per recording and channel, in the log's units.

    Parameters
    ----------
    comparison : Comparison
        Comparison of the case.

    Returns
    -------
    list of list of object
        Cells of each row.
    """
    rows: list[list[object]] = []
    units = log_units(comparison.case.table)
    for run in comparison.runs:
        for m in run.misfits:
            band = int(m.band_share.argmax())
            where = (
                f"{100 * m.band_share[band]:.0f} % in {m.band_edges_hz[band]:.3g} to {m.band_edges_hz[band + 1]:.3g} Hz"
            )
            errors, unit = in_log_unit((m.mean_error, m.rms_error), m.unit, units.get(m.channel))
            rows.append(
                [
                    *(run.run.name, run.run.role, m.channel, m.nrmse, m.vaf, *errors),
                    *(m.rms_ratio, m.correlation, where, unit),
                ]
            )
    return rows


def case_sections(comparison: Comparison) -> list[Section]:
    """Return the residual table and one overlay per recording and channel.

    Parameters
    ----------
    comparison : Comparison
        Comparison of the case.

    Returns
    -------
    list of Section
        Sections in reading order.
    """
    return [
        Section(
            title=comparison.case.table.title,
            text=(
                "Simulated with the nominal model; only the initial state is fitted. NRMSE is the rms of the error over the "
                "rms of the recording about its mean: 0 is perfect, 1 is no better than the mean.",
                *map(as_sentence, comparison.remarks),
            ),
            tables=[(HEADERS, misfit_rows(comparison))],
            figures=[figure for run in comparison.runs for figure in _overlays(run)],
        )
    ]


def _overlays(run: RunComparison) -> list[tuple[str, str]]:
    return [
        (
            to_svg(comparison_figure(run.measured, run.simulated, m.channel)),
            f"{run.run.name} ({run.run.role}): {m.channel} measured and simulated, their difference, and spectra. NRMSE {m.nrmse:.3g}.",
        )
        for m in run.misfits
    ]


def write_case(comparison: Comparison, folder: Path) -> None:
    """Write ``report.html`` and ``run.rrd`` of a comparison.

    The Rerun file shows the first recording.
    """
    write_report(folder / "report.html", title=comparison.case.table.title, sections=case_sections(comparison))
    first = next((run for run in comparison.runs if run.misfits), None)
    if first is None:
        return  # no compared channel
    names = [m.channel for m in first.misfits]
    write_comparison(
        folder / "run.rrd", first.measured, first.simulated, channels=names, title=comparison.case.table.title
    )
