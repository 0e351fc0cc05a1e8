"""Ablation of the findings of an extended model."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from vlab.diagnose.data_findings import DataFindings
from vlab.diagnose.diagnosis import Finding
from vlab.diagnose.inference.sensor_offset import explained_sensor_offsets
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.problem import Problem
from vlab.diagnose.validation.simulation import Ablations, ExtendedModel, extended


def ablate(problem: Problem, fit: Fit, seen: DataFindings, findings: Sequence[Finding]) -> Ablations:
    """Return the extended model without single findings.

    Parameters
    ----------
    problem : Problem
        Problem.
    fit : Fit
        Fit of the extended model.
    seen : DataFindings
        Findings from the data alone.
    findings : sequence of Finding
        Command limit, effects of the fit, and sensor findings, in this order.

    Returns
    -------
    Ablations
        Ablated models.
    """
    models = list(_without_each(problem, fit, seen))
    if len(models) > 1:
        models.append(extended(problem, replace(fit, terms=()), wrong_offsets(problem, fit, seen)))
    return Ablations(names=tuple(f"{f.name} at {f.place}" for f in findings), models=tuple(models))


def wrong_offsets(problem: Problem, fit: Fit, seen: DataFindings) -> set[str]:
    """Return the channels whose offset is a finding.

    Parameters
    ----------
    problem : Problem
        Problem.
    fit : Fit
        Fit of the extended model.
    seen : DataFindings
        Findings from the data alone.

    Returns
    -------
    set of str
        Channels; a model without findings has no offset there.
    """
    return {*(offset.channel for offset in seen.offsets), *explained_sensor_offsets(problem, fit)}


def _without_each(problem: Problem, fit: Fit, seen: DataFindings) -> Iterator[ExtendedModel]:
    whole = seen.on(extended(problem, fit))
    if seen.limit is not None:
        yield replace(whole, limit=None)
    for term in fit.terms:
        rest = replace(fit, terms=tuple(t for t in fit.terms if t is not term))
        unexplained = set(explained_sensor_offsets(problem, fit)) - set(explained_sensor_offsets(problem, rest))
        yield seen.on(extended(problem, rest, unexplained))
    for stop in seen.stops:
        yield replace(whole, stops=tuple(other for other in seen.stops if other is not stop))
    for step in seen.steps:
        yield replace(whole, steps=tuple(other for other in seen.steps if other is not step))
    for interference in seen.interferences:
        yield replace(whole, interferences=tuple(other for other in seen.interferences if other is not interference))
    for offset in seen.offsets:
        yield seen.on(extended(problem, fit, {offset.channel}))
