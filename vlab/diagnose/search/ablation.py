"""An amended model with its findings taken away, to tell what every one of them does in a recording."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from vlab.diagnose.data_findings import DataFindings
from vlab.diagnose.diagnosis import Finding
from vlab.diagnose.inference.sensor_offset import explained_sensor_offsets
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.problem import Problem
from vlab.diagnose.validation.simulation import Ablations, ExtendedModel, extended


def ablate(problem: Problem, fit: Fit, seen: DataFindings, findings: Sequence[Finding]) -> Ablations:
    """Return the model of a fit and of what the recordings show, without every finding in turn and without all of them.

    Parameters
    ----------
    findings : sequence of Finding
        Of the limit of a law in the loop, of the fit's terms, and of sensors, in this order.
    """
    models = list(_without_each(problem, fit, seen))
    if len(models) > 1:
        zeros = {*(offset.channel for offset in seen.zeros), *explained_sensor_offsets(problem, fit)}
        models.append(extended(problem, replace(fit, terms=()), zeros))
    return Ablations(names=tuple(f"{f.name} at {f.place}" for f in findings), models=tuple(models))


def _without_each(problem: Problem, fit: Fit, seen: DataFindings) -> Iterator[ExtendedModel]:
    whole = seen.on(extended(problem, fit))
    if seen.limit is not None:
        yield replace(whole, limit=None)
    for term in fit.terms:
        rest = replace(fit, terms=tuple(t for t in fit.terms if t is not term))
        zeros = set(explained_sensor_offsets(problem, fit)) - set(explained_sensor_offsets(problem, rest))
        yield seen.on(extended(problem, rest, zeros))
    for stop in seen.stops:
        yield replace(whole, stops=tuple(other for other in seen.stops if other is not stop))
    for step in seen.steps:
        yield replace(whole, steps=tuple(other for other in seen.steps if other is not step))
    for interference in seen.interferences:
        yield replace(whole, interferences=tuple(other for other in seen.interferences if other is not interference))
    for offset in seen.zeros:
        yield seen.on(extended(problem, fit, {offset.channel}))
