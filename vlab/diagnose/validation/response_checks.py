"""Checks of frequency responses against the nominal model.

A response with reversed phase precedes its cause, which shows without a model. Signs and units are checked as in
`vlab.cases.checks`, with responses instead of spectra.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab import units
from vlab.cases.case import Case
from vlab.cases.checks.bands import Bands, bands_of_responses, together
from vlab.cases.checks.beside import FEWEST
from vlab.cases.checks.correction import FileCheck, Found, Severity
from vlab.cases.checks.slips import is_turned, slip_of_unit
from vlab.cases.description import FrfTable
from vlab.diagnose.data.responses import Response, read_measured
from vlab.diagnose.predictors.frequency_problem import FrequencyProblem
from vlab.diagnose.predictors.level_answer import answer_at_level
from vlab.diagnose.settings import RESPONSE_CHECKS
from vlab.diagnose.validation.frequency import heard, nominal_model
from vlab.recordings.responses import FORM_UNITS
from vlab.signals import ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class _Measured:
    """Measured response with its description and the modelled response."""

    table: FrfTable
    data: Response
    own: ComplexArray


def check_responses(problem: FrequencyProblem) -> FileCheck:
    """Check signs, units and phases of a case's frequency responses.

    Parameters
    ----------
    problem : FrequencyProblem
        Problem with the nominal model.

    Returns
    -------
    FileCheck
        Findings on the case description.
    """
    case = problem.case
    tables = {f"frf{i + 1}": table for i, table in enumerate(case.table.frf)}
    read = [d for d in read_measured(case, ("fit", "holdout")) if isinstance(d, Response)]
    view, state = nominal_model(problem.plant, problem.wires).seen()
    all_of_it = [
        _Measured(table=tables[d.name], data=d, own=answer_at_level(view, state, d, problem.wires).H) for d in read
    ]
    early = [one for one in all_of_it if _is_early(one)]
    found = [_conjugated(case, early)] if early else []
    causal = [_conjugate(one) if one in early else one for one in all_of_it]
    found += _signs_and_units(case, causal)
    named = {name for f in found for name in f.channels}
    found += [_gives(one.data) for one in causal if one.data.gives_power and one.data.input not in named]
    return FileCheck(found=tuple(found))


# ---- phases that count the other way -------------------------------------------------------------------------------


def _is_early(one: _Measured) -> bool:
    """Return whether a response precedes its cause, over all outputs."""
    if one.data.is_magnitude:
        return False
    usable = heard(one.data)
    turn, own = (sum(_turn(H[:, k], usable[:, k]) for k in range(H.shape[1])) for H in (one.data.H, one.own))
    return own < -RESPONSE_CHECKS.turns * one.own.shape[1] and turn > -RESPONSE_CHECKS.share * own


def _turn(H: ComplexArray, usable: ComplexArray) -> float:
    """Return the power-weighted phase change of a response per line.

    The power-weighted derivative of phase by frequency is minus the mean time of the impulse response. A causal
    response has a negative value.
    """
    pair = usable[1:] & usable[:-1]
    steps = np.where(pair, H[1:] * np.conj(H[:-1]), 0.0)
    size = float(np.sum(np.abs(steps)))
    return float(np.sum(steps.imag)) / size if size > 0.0 else 0.0


def _conjugate(one: _Measured) -> _Measured:
    return replace(one, data=replace(one.data, H=np.conj(one.data.H)))


def _conjugated(case: Case, early: Sequence[_Measured]) -> Found:
    names, files = (
        " and ".join(dict.fromkeys(x)) for x in ([e.data.name for e in early], [e.table.file for e in early])
    )
    text = (
        f"{names}: the response comes before its cause: its phase rises through resonances, as if it was written with exp(-i omega t), "
        f"conjugated; to mend it, say in {case.path.name}: conjugate = true in [[frf]] with file = {files}"
    )
    return Found(severity="fatal", text=text, channels=tuple(o for e in early for o in e.data.outputs))


def _gives(data: Response) -> Found:
    text = (
        f"{data.name}: the response at {data.input} to a force there gives back power, which no passive thing does; its sign is turned, or "
        "its phase counts the other way"
    )
    return Found(severity="note", text=text, channels=(data.input,))


# ---- signs and units ------------------------------------------------------------------------------------------------


def _signs_and_units(case: Case, measured: Sequence[_Measured]) -> list[Found]:
    """Return the simplest sign or unit errors of the responses."""
    inputs = tuple(dict.fromkeys(one.data.input for one in measured))
    outputs = tuple(dict.fromkeys(output for one in measured for output in one.data.outputs))
    groups = (
        [_Group(what="the responses", where="every [[frf]]", inputs=inputs, outputs=outputs)],
        [_of_output(output, inputs) for output in outputs],
        [_of_input(force, outputs) for force in inputs],
    )
    for level in groups:
        found = [f for group in level if (f := _slip(case, measured, group)) is not None]
        if found:
            return found
    return []


@dataclass(frozen=True, kw_only=True)
class _Group:
    """Responses that share one description error.

    Parameters
    ----------
    what, where : str
        Names of the responses, and of the case's tables to correct.
    inputs, outputs : tuple of str
        Inputs and outputs of the responses.
    """

    what: str
    where: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def _of_output(output: str, inputs: tuple[str, ...]) -> _Group:
    where = f'every [[frf.channel]] with at = "{output}"'
    return _Group(what=f"the responses of {output}", where=where, inputs=inputs, outputs=(output,))


def _of_input(force: str, outputs: tuple[str, ...]) -> _Group:
    where = f'every [[frf]] with input = "{force}"'
    return _Group(what=f"the responses to {force}", where=where, inputs=(force,), outputs=outputs)


def _slip(case: Case, measured: Sequence[_Measured], group: _Group) -> Found | None:
    each = [_bands(one, group.outputs) for one in measured if one.data.input in group.inputs]
    beside = [together(of_outputs) for of_outputs in each if of_outputs]
    described = {(one.table.form, one.table.unit) for one in measured if one.data.input in group.inputs}
    unit = None
    if len(described) == 1:
        form, said = described.pop()
        si = FORM_UNITS[form]
        unit = slip_of_unit(beside, {u: 1.0 / ratio for u, ratio in units.mistaken(said or si, si).items()})
    if unit is not None:
        name, factor = unit
        is_line = factor > 0.0 and "channel" not in group.where
        line = f'unit = "{name}"' if is_line else f"scale = {1.0 / factor:.12g}"
        size = float(np.exp(np.median([np.median(b.log_ratio) for b in beside])))
        text = f"{group.what} are {np.sign(factor) * size:.4g} times what the model gives, as if in {name} and not in {said or si}"
        return _mended(case, "fatal", text, f"{line} in {group.where}", group)
    if not is_turned(beside):
        return None
    text = f"{group.what} have the sign turned beside the model in all bands"
    return _mended(case, "warning", text, f"scale = -1 in {group.where}", group)


def _mended(case: Case, severity: Severity, text: str, line: str, group: _Group) -> Found:
    return Found(severity=severity, text=f"{text}; to mend it, say in {case.path.name}: {line}", channels=group.outputs)


def _bands(one: _Measured, outputs: Sequence[str]) -> list[Bands]:
    """Return measured over modelled responses by bands."""
    out = []
    for k, output in enumerate(one.data.outputs):
        usable = heard(one.data)[:, k] & (one.data.H[:, k] != 0.0) & (one.own[:, k] != 0.0)
        if output not in outputs or not usable.any():
            continue
        own = np.abs(one.own[usable, k]) if one.data.is_magnitude else one.own[usable, k]
        found = bands_of_responses(one.data.freq[usable], one.data.H[usable, k], own)
        out += [found] if len(found) >= FEWEST else []
    return out
