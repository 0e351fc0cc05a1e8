"""The verdict on data that were never used: the plant with the physics found, linearised by MuJoCo, beside what was measured."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from vlab.cases.case import Case
from vlab.diagnose.frequency.evaluate import State, answer
from vlab.diagnose.frequency.fit import Fitter, Point
from vlab.diagnose.frequency.measured import (
    MODEL_ERROR,
    SMALLEST_ZETA,
    Measured,
    Modes,
    Response,
    read_measured,
    thinned,
)
from vlab.diagnose.frequency.modes import ModelModes, model_modes, state_matrix
from vlab.diagnose.frequency.problem import FrequencyProblem
from vlab.diagnose.frequency.residual import shape_rows, tracked
from vlab.diagnose.frequency.view import View, Wires, view_of, wires_of
from vlab.diagnose.terms import Fit
from vlab.diagnose.verify import Distance, gap_closed, total
from vlab.modal.mac import mac
from vlab.physics.attach import Attached, attach
from vlab.plants.base import Plant
from vlab.signals import Array, ComplexArray

LEFT_OUT = 12
"""Most parts of the data that are left out one after the other."""
REFITTED = 6
NEIGHBOURS = 9
DROWNED = 0.3
"""Lines whose noise is more than this share of the response say nothing of a model."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyAmended:
    """A plant with uncertain parameters refitted and physics added, and the gains that are not the plant's.

    Parameters
    ----------
    sensor_gain : (n_outputs,) array
        Of the outputs, in the order of `names`.
    input_gain : (n_columns,) array
        Of inputs that are forces measured at ports.
    """

    plant: Plant
    wires: Wires
    sensor_gain: Array
    input_gain: Array
    offset: None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.wires.names

    def seen(self) -> tuple[View, State]:
        """Return the plant's linearisation by MuJoCo, and its matrices."""
        view = view_of(self.plant, self.wires)
        return view, State(M=view.M, C=view.C, K=view.K, input_gain=self.input_gain, output_gain=self.sensor_gain)


def as_given(plant: Plant, wires: Wires) -> FrequencyAmended:
    """Return a plant as it is."""
    columns = len(plant.actuators) + sum(a is None for a in wires.actuators)
    return FrequencyAmended(
        plant=plant, wires=wires, sensor_gain=np.ones(len(wires.names)), input_gain=np.ones(columns)
    )


def amended_by(problem: FrequencyProblem, fit: Fit) -> FrequencyAmended:
    """Return a problem's plant as a fit has it."""
    plant = problem.adjusted(fit.theta)
    effects = [Attached(effect=t.effect, place=t.place.name, values=dict(t.values)) for t in fit.terms]
    given = as_given(problem.plant, problem.wires)
    sensors, inputs = given.sensor_gain.copy(), given.input_gain.copy()
    for parameter, value in zip(problem.parameters, fit.theta, strict=True):
        if parameter.sensor is not None:
            sensors[parameter.sensor] *= np.exp(value)
        if parameter.actuator is not None and parameter.actuator >= len(problem.plant.actuators):
            inputs[parameter.actuator] *= np.exp(value)
    return FrequencyAmended(
        plant=attach(plant, effects, channels=problem.names) if effects else plant,
        wires=problem.wires,
        sensor_gain=sensors,
        input_gain=inputs,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalAnswer:
    """The modes of a model that a table lists.

    Parameters
    ----------
    freq, zeta : (n,) array
        NaN where the model has no such mode.
    mac : (n,) array
        Between measured and own shapes; NaN without shapes.
    """

    freq: Array
    zeta: Array
    mac: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class CheckedFrequency(Distance):
    """How far the models are from responses or from a table of modes.

    Of responses the errors are root mean squares over lines and outputs of the difference over the mean magnitude of both. Of
    modes they are root mean squares of relative differences, those of damping ratios and shapes in proportion to their
    uncertainty beside that of frequencies; their channels are "frequency", "damping" and "shape".

    Parameters
    ----------
    answers : tuple
        Of the three models: (n, n_outputs) responses, or modes.
    """

    measured: Measured
    answers: tuple[ComplexArray | ModalAnswer, ...]


def check_frequency(
    models: Sequence[FrequencyAmended], measured: Sequence[Measured], unfitted: Mapping[str, float] | None = None
) -> list[CheckedFrequency]:
    """Compare the nominal, the refitted and the amended plant with data.

    Parameters
    ----------
    unfitted : mapping of str to float
        Relative standard deviations of the gains of inputs that nothing was fitted on: the refitted and the amended plant have their
        likeliest ones, each its own.
    """
    seen = [model.seen() for model in models]
    out = []
    for data in measured:
        if isinstance(data, Response):
            given, *fitted = [answer(v, s, data, models[0].wires).H for v, s in seen]
            sd = (unfitted or {}).get(data.input, 0.0)
            out.append(_checked_response(data, [given, *(H * _likeliest_gain(H, data, sd) for H in fitted)]))
        else:
            out.append(_checked_modes(data, [modal_answer(v, s, data) for v, s in seen]))
    return out


def _likeliest_gain(H: ComplexArray, data: Response, sd: float) -> float:
    """Return the gain of an input under its prior, for responses of a model (n, n_outputs) beside measured ones.

    All lines count alike, as in the error that is told.
    """
    if sd == 0.0:
        return 1.0
    usable = np.isfinite(data.H) & np.isfinite(H)
    own, seen = H[usable], data.H[usable]
    size = float(np.mean(data.spread[usable] ** 2 + MODEL_ERROR**2 * np.abs(seen) ** 2))
    weight, pull = float(np.sum(np.abs(own) ** 2)) / size, float(np.sum((np.conj(own) * seen).real)) / size
    return (pull + sd**-2) / (weight + sd**-2)


def checked_again(case: Case, names: Collection[str]) -> float:
    """Return how far the model of a case is from its data of some names, as `CheckedFrequency.nominal` over all of them."""
    fit, held_out = read_measured(case, ("fit",)), read_measured(case, ("holdout",))
    wires = wires_of(case, [*fit, *held_out])
    chosen = [*thinned(fit), *held_out]
    model = as_given(case.plant, wires)
    return total(check_frequency([model] * 3, [d for d in chosen if d.name in names]), "nominal")


def apart(data: Response, own: ComplexArray) -> Array:
    """Return the squared difference of responses over the mean of their squared magnitudes; NaN where noise drowns them."""
    measured = data.H
    difference = np.abs(measured) - np.abs(own) if data.is_magnitude else measured - own
    size = 0.5 * (np.abs(measured) ** 2 + np.abs(own) ** 2)
    return np.where(heard(data), np.abs(difference) ** 2 / np.maximum(size, 1e-300), np.nan)


def heard(data: Response) -> Array:
    """Return on which lines a response stands above its noise; on all where it never does.

    Neighbours decide as well: single lines that noise lifts would be the ones that are kept.
    """
    size = median_filter(np.abs(data.H), size=(NEIGHBOURS, 1), mode="nearest")
    out = data.noise < DROWNED * size
    return np.where(out.any(axis=0), out, True)


def noise_apart(data: Response) -> Array:
    """Return what `apart` is of a model without error."""
    square = np.abs(data.H) ** 2
    return np.where(heard(data), np.minimum(data.noise**2 / np.maximum(square, 1e-300), 2.0), np.nan)


def _checked_response(data: Response, answers: list[ComplexArray]) -> CheckedFrequency:
    errors = [np.sqrt(np.nanmean(apart(data, H), axis=0)) for H in answers]
    noise = np.sqrt(np.nanmean(noise_apart(data), axis=0))
    total = [float(np.sqrt(np.mean(e**2))) for e in (*errors, noise)]
    channels = {name: tuple(float(e[k]) for e in (*errors, noise)) for k, name in enumerate(data.outputs)}
    return _checked(data, total, channels, answers)


def _checked(
    data: Measured,
    total: Sequence[float],
    channels: Mapping[str, Sequence[float]],
    answers: Sequence[ComplexArray | ModalAnswer],
) -> CheckedFrequency:
    nominal, before, after, noise = total
    return CheckedFrequency(
        name=data.name,
        role=data.role,
        nominal=nominal,
        before=before,
        after=after,
        noise=noise,
        channels={name: tuple(errors) for name, errors in channels.items()},  # type: ignore[misc]
        measured=data,
        answers=tuple(answers),
    )


def modal_answer(view: View, state: State, data: Modes) -> ModalAnswer:
    """Return the modes of a model that a table lists."""
    A = state_matrix(state, view.fixed, 2 * np.pi * 2 * float(data.freq[-1]))
    modes: ModelModes = model_modes(A, view.m)
    rows = shape_rows(view, data)
    pairs = tracked(modes, data, rows)
    found = pairs >= 0
    at = np.where(found, pairs, 0)
    alike = np.full(data.n, np.nan)
    if len(rows):
        own = rows @ modes.shapes[:, at]
        alike = np.diag(mac(data.shapes.T, own)).copy()
    return ModalAnswer(
        freq=np.where(found, modes.freq[at], np.nan),
        zeta=np.where(found, modes.zeta[at], np.nan),
        mac=np.where(found, alike, np.nan),
    )


def modal_errors(data: Modes, own: ModalAnswer) -> dict[str, Array]:
    """Return relative differences of every mode by "frequency", "damping" and "shape"; one where the model has no such mode."""
    out = {"frequency": np.abs(np.log(data.freq / own.freq))}
    known = np.isfinite(data.zeta)
    if known.any():
        ratio = np.log(data.zeta[known] / np.maximum(own.zeta[known], SMALLEST_ZETA))
        out["damping"] = np.abs(ratio)
    if data.shapes.shape[1]:
        out["shape"] = np.sqrt(np.clip(1.0 - own.mac, 0.0, 1.0))
    return {name: np.where(np.isfinite(e), e, 1.0) for name, e in out.items()}


def _checked_modes(data: Modes, answers: list[ModalAnswer]) -> CheckedFrequency:
    each = [modal_errors(data, own) for own in answers]
    noise = {"frequency": data.freq_sd, "damping": data.zeta_sd, "shape": data.shape_sd}
    floor = {name: float(np.sqrt(np.mean(np.minimum(noise[name], 1.0) ** 2))) for name in each[0]}
    errors = [{name: float(np.sqrt(np.mean(e[name] ** 2))) for name in e} for e in each]
    channels = {name: (*(e[name] for e in errors), floor[name]) for name in errors[0]}
    unit = floor["frequency"]
    total = [unit * float(np.sqrt(np.mean([(e[n] / floor[n]) ** 2 for n in e]))) for e in errors]
    return _checked(data, [*total, unit], channels, answers)


# ---- leaving out ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """How well hypotheses predict what they were not fitted to, part by part of the data.

    Parameters
    ----------
    parts : int
        Responses of one output, or modes, that were left out one after the other.
    before, after, noise : float
        Root mean square of the differences there, without and with the physics found.
    """

    parts: int
    before: float
    after: float
    noise: float

    @property
    def gap_closed(self) -> float | None:
        """(before - after)/(before - noise); None where before is within the noise."""
        return gap_closed(self.before, self.after, self.noise)


def leave_out(problem: FrequencyProblem, fitter: Fitter, before: Fit, after: Fit) -> LeftOut | None:
    """Fit again without one part of the data after the other and predict it; None where only one part is there."""
    parts: list[tuple[int, int]] = []
    for i, data in enumerate(problem.measured):
        count = len(data.outputs) if isinstance(data, Response) else data.n
        parts += [(i, k) for k in range(count)]
    if len(parts) < 3:
        return None
    chosen = [parts[i] for i in np.unique(np.linspace(0, len(parts) - 1, LEFT_OUT).astype(int))]
    squares = []
    for i, k in chosen:
        data = problem.measured[i]
        rest = [d for j, d in enumerate(problem.measured) if j != i]
        if isinstance(data, Response):
            rest += [data.of_output(o) for o in range(len(data.outputs)) if o != k]
        else:
            rest.append(data.without(k))
        part = Fitter(problem, rest)
        row = []
        for fit in (before, after):
            again = part.fit(fit.terms, fit.theta, iterations=REFITTED)
            row.append(_predicted(fitter, again, data, k))
        squares.append((*row, _noise(data, k)))
    means = np.sqrt(np.mean(np.array(squares), axis=0))
    return LeftOut(parts=len(chosen), before=float(means[0]), after=float(means[1]), noise=float(means[2]))


def _predicted(fitter: Fitter, fit: Fit, data: Measured, k: int) -> float:
    """Return the mean squared difference of one part of the data."""
    problem = fitter.problem
    point = Point(theta=fit.theta, terms=fit.terms)
    state = problem.state(point.theta)
    if isinstance(data, Response):
        H = answer(problem.view, state, data, problem.wires, point.terms).H
        return float(np.nanmean(apart(data, H)[:, k]))
    view = replace(problem.view, fixed=(*problem.view.fixed, *point.terms))
    errors = modal_errors(data, modal_answer(view, state, data))
    unit = float(np.sqrt(np.mean(data.freq_sd**2)))
    return (unit * errors["frequency"][k] / data.freq_sd[k]) ** 2


def _noise(data: Measured, k: int) -> float:
    if isinstance(data, Response):
        return float(np.nanmean(noise_apart(data)[:, k]))
    return float(np.mean(data.freq_sd**2))
