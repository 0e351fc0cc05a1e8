"""Figures of a diagnosis: the worst channel, the missing force."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from vlab.cases.misfit import Misfit, misfit
from vlab.diagnose.export import Done
from vlab.diagnose.findings import Reportable, unit_at
from vlab.diagnose.frequency_pipeline import FrequencyDiagnosed
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.pipeline import Diagnosed
from vlab.diagnose.validation.checked import Checked
from vlab.signals import Recording
from vlab.units import quantity
from vlab.views.figures import to_svg
from vlab.views.figures.diagnosis import force_figure, mismatch_figure, overlay_figure
from vlab.views.figures.restoring_force import restoring_force
from vlab.views.reports.diagnosis_frequency import figures


def worst_first(checked: Sequence[Checked]) -> list[tuple[Checked, str]]:
    """Return recordings and channels, the worst of every recording in turn.

    Parameters
    ----------
    checked : sequence of Checked
        Checked recordings.

    Returns
    -------
    list of (Checked, str)
        Recording and channel.
    """
    orders = [sorted(c.channels, key=lambda n, c=c: -_finite_or(c.channels[n][1])) for c in checked]  # type: ignore[misc]
    depth = max((len(order) for order in orders), default=0)
    return [(c, order[k]) for k in range(depth) for c, order in zip(checked, orders, strict=True) if k < len(order)]


def _finite_or(value: float, otherwise: float = 1e9) -> float:
    return value if math.isfinite(value) else otherwise


def overlay(run: Checked, calibrated: Recording, name: str) -> Figure:
    """Return the figure of a channel with the models.

    Parameters
    ----------
    run : Checked
        Checked recording.
    calibrated : Recording
        Simulation of the calibrated or nominal model.
    name : str
        Channel.

    Returns
    -------
    Figure
        Figure with four panels.
    """
    worst = misfit(run.measured, calibrated, name)
    middle = float(worst.window_time_s[int(np.argmax(worst.window_nrmse))])
    noise = run.channels[name][3] * float(np.std(run.measured[name]))
    return overlay_figure(run.measured, calibrated, run.extended, name, noise=noise, worst_s=middle, before=run.stands)


def main_figure(done: Done) -> Figure | None:
    """Return the figure of the worst channel with measurement and models.

    Parameters
    ----------
    done : Done
        Completed diagnosis.

    Returns
    -------
    Figure or None
        None where no model can follow a recording.
    """
    if isinstance(done, FrequencyDiagnosed):
        return next((figure for _, figure, _ in figures(done)), None)
    for run, name in worst_first(done.diagnosis.tried):
        if run.standing is not None:
            return overlay(run, run.standing, name)
    return None


def missing_force_figure(done: Done) -> Figure | None:
    """Return the figure of the missing force and its law.

    Parameters
    ----------
    done : Done
        Completed diagnosis.

    Returns
    -------
    Figure or None
        None without a force, or for a diagnosis in frequency.
    """
    if isinstance(done, FrequencyDiagnosed) or not drawn_terms(done):
        return None
    found = restoring_force(done, drawn_terms(done)[0])
    return force_figure(found.curves, found.label, series=found.series)


def drawn_terms(done: Diagnosed) -> tuple[Term, ...]:
    """Return the terms with drawn forces.

    Parameters
    ----------
    done : Diagnosed
        Completed diagnosis.

    Returns
    -------
    tuple of Term
        Terms of the findings, or the best force that was tried.
    """
    if done.diagnosis.findings or done.diagnosis.verdict != "none-of-these":
        return done.fit.terms
    attempt = done.diagnosis.attempt
    tried = (done.choice.best, *done.found.hypotheses) if attempt is None else (attempt.fit,)
    forces = [t for h in tried for t in h.terms if t.effect.kind == "port"]
    return tuple(forces[:1])


def values_of(term: Term, problem: Reportable) -> str:
    """Return the parameters of a term as text, with units.

    Parameters
    ----------
    term : Term
        Effect with its place and values.
    problem : Reportable
        Problem of the diagnosis, which knows the units of channels and commands.

    Returns
    -------
    str
        Such as ``"force = 0.6 N m, rise = 0.01 rad/s"``.
    """
    units = {p.name: unit_at(p.unit, term, problem) for p in term.effect.parameters}
    return ", ".join(f"{name} = {quantity(float(value), units.get(name, ''))}" for name, value in term.values.items())


def mismatch_picture(
    found: Sequence[tuple[Checked, str, Misfit]], edges: Sequence[float], title: str, scale: float | None
) -> str:
    """Return a drawing of residuals over frequency and time.

    Parameters
    ----------
    found : sequence of (Checked, str, Misfit)
        Recording, channel and residual of each row.
    edges : sequence of float
        Edges of the bands [Hz].
    title : str
        Title.
    scale : float or None
        Residual of the brightest colour [-]; by default the largest.

    Returns
    -------
    str
        SVG.
    """
    rows = [f"{run.name}: {name}" if len({r.name for r, _, _ in found}) > 1 else name for run, name, _ in found]
    bands = np.array([m.nrmse * np.sqrt(m.band_share) for _, _, m in found])
    times = [(m.window_time_s, m.window_nrmse) for _, _, m in found]
    return to_svg(mismatch_figure(rows, np.array(edges), bands, times, title=title, scale=scale))
