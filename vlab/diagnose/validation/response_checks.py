"""Checks of frequency responses against the nominal model.

A response with reversed phase precedes its cause, which shows without a model. Signs, units and exchanged outputs are
checked as in `vlab.cases.checks`, with responses instead of spectra. A wrong form or unit of frequency is found by
trial.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from vlab import units
from vlab.cases.case import Case
from vlab.cases.checks.bands import Bands, bands_of_responses, together
from vlab.cases.checks.beside import EXPLAINED, FEWEST, UNEXPLAINED
from vlab.cases.checks.correction import FileCheck, Found, Severity
from vlab.cases.checks.recordings import SLACK, SMALLER
from vlab.cases.checks.slips import is_turned, slip_of_unit
from vlab.cases.description import FrfTable
from vlab.diagnose.data.responses import ORDERS, Response, read_measured
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
    """Check signs, units, forms, phases and outputs of a case's frequency responses.

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

    def modelled(data: Response) -> ComplexArray:
        return answer_at_level(view, state, data, problem.wires).H

    all_of_it = [_Measured(table=tables[d.name], data=d, own=modelled(d)) for d in read]
    early = [(one, _early(one)) for one in all_of_it]
    whole = [one for one, columns in early if len(columns) == len(one.data.outputs)]
    found = [_conjugated(case, whole)] if whole else []
    single = {one.data.outputs[k]: None for one, columns in early if one not in whole for k in columns}
    found += [_conjugated_output(case, output) for output in single]
    causal = [_conjugate(one, columns) for one, columns in early]
    found += _forms(case, causal, modelled) or _signs_and_units(case, causal) or _exchanged(case, causal)
    named = {name for f in found for name in f.channels}
    found += [_gives(one.data) for one in causal if one.data.gives_power and one.data.input not in named]
    return FileCheck(found=tuple(found))


# ---- phases that count the other way -------------------------------------------------------------------------------


def _early(one: _Measured) -> tuple[int, ...]:
    """Return the columns of outputs whose response precedes its cause.

    Outputs without a phase turn of their own go with the others, if all the others are early.
    """
    count = one.own.shape[1]
    if one.data.is_magnitude:
        return ()
    usable = heard(one.data)
    turn, own = (np.array([_turn(H[:, k], usable[:, k]) for k in range(count)]) for H in (one.data.H, one.own))
    tells = own < -RESPONSE_CHECKS.turns
    is_early = tells & (turn > -RESPONSE_CHECKS.share * own)
    is_whole = (
        bool(np.all(is_early == tells))
        and own.sum() < -RESPONSE_CHECKS.turns * count
        and turn.sum() > -RESPONSE_CHECKS.share * own.sum()
    )
    return tuple(range(count)) if is_whole else tuple(int(k) for k in np.flatnonzero(is_early))


def _turn(H: ComplexArray, usable: ComplexArray) -> float:
    """Return the power-weighted phase change of a response per line.

    The power-weighted derivative of phase by frequency is minus the mean time of the impulse response. A causal
    response has a negative value.
    """
    pair = usable[1:] & usable[:-1]
    steps = np.where(pair, H[1:] * np.conj(H[:-1]), 0.0)
    size = float(np.sum(np.abs(steps)))
    return float(np.sum(steps.imag)) / size if size > 0.0 else 0.0


def _conjugate(one: _Measured, columns: Sequence[int]) -> _Measured:
    """Return a response with the conjugate of some outputs."""
    H = one.data.H.copy()
    H[:, list(columns)] = np.conj(H[:, list(columns)])
    return replace(one, data=replace(one.data, H=H)) if columns else one


def _conjugated(case: Case, early: Sequence[_Measured]) -> Found:
    names, files = (
        " and ".join(dict.fromkeys(x)) for x in ([e.data.name for e in early], [e.table.file for e in early])
    )
    text = (
        f"{names}: the response comes before its cause: its phase rises through resonances, as if it was written with exp(-i omega t), "
        "conjugated"
    )
    outputs = tuple(o for e in early for o in e.data.outputs)
    return _mended(case, "fatal", text, f"conjugate = true in [[frf]] with file = {files}", outputs)


def _conjugated_output(case: Case, output: str) -> Found:
    text = (
        f"the responses of {output}, unlike those of the other outputs, come before their cause: the phase rises through "
        "resonances, conjugated"
    )
    return _mended(case, "fatal", text, f'conjugate = true in every [[frf.channel]] with at = "{output}"', (output,))


def _gives(data: Response) -> Found:
    text = (
        f"{data.name}: the response at {data.input} to a force there gives back power, which no passive thing does; its sign is turned, or "
        "its phase counts the other way"
    )
    return Found(severity="note", text=text, channels=(data.input,))


# ---- forms and units of frequency ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Reading:
    """Form of responses and unit of their frequencies."""

    form: str
    frequency_unit: str

    @classmethod
    def of(cls, table: FrfTable) -> "_Reading":
        """Return the reading that a case states."""
        return cls(form=table.form, frequency_unit=table.frequency_unit)

    def on(self, one: _Measured) -> Response:
        """Return a response in this reading."""
        scale = units.factor(self.frequency_unit, "Hz") / units.factor(one.table.frequency_unit, "Hz")
        return replace(one.data, order=ORDERS[self.form], freq=scale * one.data.freq)

    def others(self) -> list["_Reading"]:
        """Return the readings with another form or unit."""
        forms = [replace(self, form=form) for form in FORM_UNITS if form != self.form]
        return forms + [replace(self, frequency_unit=unit) for unit in FREQUENCIES if unit != self.frequency_unit]


FREQUENCIES = ("Hz", "rad/s")
"""FREQUENCIES: units in which programs write the lines of a response."""


def _forms(case: Case, measured: Sequence[_Measured], modelled: Callable[[Response], ComplexArray]) -> list[Found]:
    """Return readings other than the stated one with which responses agree.

    As stated no output agrees with the model. In the other reading all do.
    """
    out = []
    for stated in dict.fromkeys(_Reading.of(one.table) for one in measured):
        these = [one for one in measured if _Reading.of(one.table) == stated]
        if min(_residuals(these), default=0.0) < UNEXPLAINED:
            continue

        def residual(other: _Reading, these: Sequence[_Measured] = these) -> float:
            return max(_residuals([replace(one, data=(d := other.on(one)), own=modelled(d)) for one in these]))

        other = min(stated.others(), key=residual)
        if residual(other) <= EXPLAINED:
            out.append(_read_as(case, these, stated, other))
    return out


def _read_as(case: Case, these: Sequence[_Measured], stated: _Reading, other: _Reading) -> Found:
    names, files = (
        " and ".join(dict.fromkeys(x)) for x in ([e.data.name for e in these], [e.table.file for e in these])
    )
    if other.form != stated.form:
        what = f"the responses are those of the model as {other.form} and not as {stated.form}"
        power = ORDERS[other.form] - ORDERS[stated.form]
        said = dict.fromkeys(
            f"{one.table.unit}{'/' if power > 0 else '*'}s^{abs(power)}" for one in these if one.table.unit
        )
        line = " and ".join([f'form = "{other.form}"', *(f'unit = "{unit}"' for unit in said)])
    else:
        what = f"the lines are those of the model in {other.frequency_unit} and not in {stated.frequency_unit}"
        line = f'frequency_unit = "{other.frequency_unit}"'
    outputs = tuple(dict.fromkeys(o for e in these for o in e.data.outputs))
    return _mended(case, "fatal", f"{names}: {what}", f"{line} in [[frf]] with file = {files}", outputs)


def _residuals(measured: Sequence[_Measured]) -> list[float]:
    """Return the residual shares of all outputs with enough bands."""
    return [found.left() for one in measured for found in _bands(one, one.data.outputs)]


# ---- outputs exchanged -----------------------------------------------------------------------------------------------


def _exchanged(case: Case, measured: Sequence[_Measured]) -> list[Found]:
    """Return pairs of outputs that show each other's response."""
    out: list[Found] = []
    for pair in combinations(dict.fromkeys(o for one in measured for o in one.data.outputs), 2):
        both = [one for one in measured if set(pair) <= set(one.data.outputs)]
        if not both or set(pair) & {name for f in out for name in f.channels}:
            continue
        before = [max(_left(both, name, name), default=0.0) for name in pair]
        crossed = _left(both, *pair) + _left(both, *pair[::-1])
        if crossed and min(before) > SLACK and max(crossed) <= SMALLER * min(before):
            text = f"the responses of {pair[0]} and {pair[1]} show each other's motion, as if they were exchanged"
            line = f"{pair[0]} in place of {pair[1]}, and {pair[1]} in place of {pair[0]}, in every [[frf]]"
            out.append(_mended(case, "fatal", text, line, pair))
    return out


def _left(measured: Sequence[_Measured], output: str, other: str) -> list[float]:
    """Return an output's residual shares beside another output's modelled response."""
    crossed = [
        replace(
            one,
            own=one.own[
                :, [one.data.outputs.index(other) if o == output else k for k, o in enumerate(one.data.outputs)]
            ],
        )
        for one in measured
    ]
    return [found.left() for one in crossed for found in _bands(one, (output,))]


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
    if unit is not None and (unit[1] > 0.0 or is_turned(beside)):  # beyond a resonance the sign turns as well
        name, factor = unit
        is_line = factor > 0.0 and "channel" not in group.where
        line = f'unit = "{name}"' if is_line else f"scale = {1.0 / factor:.12g}"
        size = float(np.exp(np.median([np.median(b.log_ratio) for b in beside])))
        text = f"{group.what} are {np.sign(factor) * size:.4g} times what the model gives, as if in {name} and not in {said or si}"
        return _mended(case, "fatal", text, f"{line} in {group.where}", group.outputs)
    if not is_turned(beside):
        return None
    text = f"{group.what} have the sign turned beside the model in all bands"
    return _mended(case, "warning", text, f"scale = -1 in {group.where}", group.outputs)


def _mended(case: Case, severity: Severity, text: str, line: str, outputs: tuple[str, ...]) -> Found:
    words = f"{text}; to mend it, say in {case.path.name}: {line}"
    return Found(severity=severity, text=words, channels=outputs, mend=line)


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
