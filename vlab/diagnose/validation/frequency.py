"""The verdict on data that were never used: the plant with the physics found, linearised by MuJoCo, beside what was measured."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from vlab.cases.case import Case
from vlab.diagnose.data.responses import Measured, Modes, Response, read_measured, thinned
from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.predictors.frequency import State, answer
from vlab.diagnose.predictors.frequency_model import View, Wires, view_of, wires_of
from vlab.diagnose.predictors.frequency_modes import ModelModes, model_modes, state_matrix
from vlab.diagnose.predictors.frequency_problem import FrequencyProblem
from vlab.diagnose.predictors.frequency_residual import shape_rows, tracked
from vlab.diagnose.settings import FREQUENCY_VALIDATION, RESPONSES
from vlab.diagnose.validation.gap import Distance, part_of, total
from vlab.diagnose.validation.simulation import Ablations
from vlab.modal.mac import mac
from vlab.physics.attach import Attached, attach
from vlab.plants.base import Plant
from vlab.signals import Array, ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class ExtendedFrequencyModel:
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


def nominal_model(plant: Plant, wires: Wires) -> ExtendedFrequencyModel:
    """Return a plant as it is."""
    columns = len(plant.actuators) + sum(a is None for a in wires.actuators)
    return ExtendedFrequencyModel(
        plant=plant, wires=wires, sensor_gain=np.ones(len(wires.names)), input_gain=np.ones(columns)
    )


def extended_by(problem: FrequencyProblem, fit: Fit) -> ExtendedFrequencyModel:
    """Return a problem's plant as a fit has it."""
    plant = problem.adjusted(fit.theta)
    effects = [Attached(effect=t.effect, place=t.place.name, values=dict(t.values)) for t in fit.terms]
    given = nominal_model(problem.plant, problem.wires)
    sensors, inputs = given.sensor_gain.copy(), given.input_gain.copy()
    for parameter, value in zip(problem.parameters, fit.theta, strict=True):
        if parameter.sensor is not None:
            sensors[parameter.sensor] *= np.exp(value)
        if parameter.actuator is not None and parameter.actuator >= len(problem.plant.actuators):
            inputs[parameter.actuator] *= np.exp(value)
    return ExtendedFrequencyModel(
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
        Of the nominal, the refitted and the amended model: (n, n_outputs) responses, or modes.
    """

    measured: Measured
    answers: tuple[ComplexArray | ModalAnswer, ...]

    @property
    def standing(self) -> ComplexArray | ModalAnswer:
        """What the better one of the nominal and the refitted model does: that of which `before` is the error."""
        return self.answers[0 if self.is_spoilt else 1]

    def without_findings(self) -> "CheckedFrequency":
        """Return the same with nothing added to the model that stands."""
        channels = {
            name: (nominal, before, before, noise) for name, (nominal, before, _, noise) in self.channels.items()
        }
        answers = (*self.answers[:2], self.standing)
        return replace(self, after=self.before, channels=channels, answers=answers)


def check_frequency(
    models: Sequence[ExtendedFrequencyModel],
    measured: Sequence[Measured],
    unfitted: Mapping[str, float] | None = None,
    ablate: Ablations | None = None,
) -> list[CheckedFrequency]:
    """Compare the nominal, the refitted and the amended plant with data.

    Parameters
    ----------
    unfitted : mapping of str to float
        Relative standard deviations of the gains of inputs that nothing was fitted on: the refitted and the amended plant have their
        likeliest ones, each its own.
    removed : Removed or None
        Tells what every finding does.
    """
    ablate = ablate or Ablations()
    seen = [model.seen() for model in (*models, *ablate.models)]
    out = []
    for data in measured:
        if isinstance(data, Response):
            given, *fitted = [answer(v, s, data, models[0].wires).H for v, s in seen]
            sd = (unfitted or {}).get(data.input, 0.0)
            answers = [given, *(H * _likeliest_gain(H, data, sd) for H in fitted)]
            out.append(_checked_response(data, answers, ablate.names))
        else:
            out.append(_checked_modes(data, [modal_answer(v, s, data) for v, s in seen], ablate.names))
    return out


def _likeliest_gain(H: ComplexArray, data: Response, sd: float) -> float:
    """Return the gain of an input under its prior, for responses of a model (n, n_outputs) beside measured ones.

    All lines count alike, as in the error that is told.
    """
    if sd == 0.0:
        return 1.0
    usable = np.isfinite(data.H) & np.isfinite(H)
    own, seen = H[usable], data.H[usable]
    size = float(np.mean(data.spread[usable] ** 2 + RESPONSES.model_error**2 * np.abs(seen) ** 2))
    weight, pull = float(np.sum(np.abs(own) ** 2)) / size, float(np.sum((np.conj(own) * seen).real)) / size
    return (pull + sd**-2) / (weight + sd**-2)


def checked_again(case: Case, names: Collection[str]) -> float:
    """Return how far the model of a case is from its data of some names, as `CheckedFrequency.nominal` over all of them."""
    fit, read_holdout = read_measured(case, ("fit",)), read_measured(case, ("holdout",))
    wires = wires_of(case, [*fit, *read_holdout])
    chosen = [*thinned(fit), *read_holdout]
    model = nominal_model(case.plant, wires)
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
    size = median_filter(np.abs(data.H), size=(FREQUENCY_VALIDATION.neighbours, 1), mode="nearest")
    out = data.noise < FREQUENCY_VALIDATION.drowned * size
    return np.where(out.any(axis=0), out, True)


def noise_apart(data: Response) -> Array:
    """Return what `apart` is of a model without error."""
    square = np.abs(data.H) ** 2
    return np.where(heard(data), np.minimum(data.noise**2 / np.maximum(square, 1e-300), 2.0), np.nan)


def _checked_response(data: Response, answers: list[ComplexArray], findings: Sequence[str]) -> CheckedFrequency:
    names = list(data.outputs)
    errors = [dict(zip(names, np.sqrt(np.nanmean(apart(data, H), axis=0)), strict=True)) for H in answers]
    noise = dict(zip(names, np.sqrt(np.nanmean(noise_apart(data), axis=0)), strict=True))
    total = [_rms(e) for e in errors]
    size = np.where(heard(data), np.abs(data.H) ** 2, np.nan)

    def moved(H: ComplexArray) -> dict[str, float]:
        """Return by how much the amended model's responses are moved, over the measured ones."""
        difference = np.abs(H) - np.abs(answers[2]) if data.is_magnitude else H - answers[2]
        square = np.abs(difference) ** 2 / np.maximum(size, 1e-300)
        return dict(zip(names, np.sqrt(np.nanmean(square, axis=0)), strict=True))

    return _checked(
        data, total, errors, (noise, _rms(noise)), answers, findings, [moved(H) for H in answers[3:]], len(data.freq)
    )


def _checked(
    data: Measured,
    total: Sequence[float],
    errors: Sequence[Mapping[str, float]],
    noise: tuple[Mapping[str, float], float],
    answers: Sequence[ComplexArray | ModalAnswer],
    findings: Sequence[str],
    moved: Sequence[Mapping[str, float]],
    samples: int,
) -> CheckedFrequency:
    """Return distances from the errors of the nominal, the refitted and the amended model, and of that without findings.

    Parameters
    ----------
    total : sequence of float
        The error of every model over all channels.
    errors : sequence of mapping
        The same by channel.
    noise : (mapping, float)
        By channel and over all of them.
    moved : sequence of mapping
        By how much the removal of every finding moves every channel.
    samples : int
        Of a channel.
    """
    stands = 0 if total[1] > total[0] else 1
    names = list(errors[0])

    def row(values: Mapping[str, float]) -> Array:
        return np.array([values[name] for name in names])

    parts = [
        part_of(name, left, row(m), row(noise[0]), samples)
        for name, left, m in zip(findings, total[3:], moved, strict=False)
    ]
    return CheckedFrequency(
        name=data.name,
        role=data.role,
        nominal=total[0],
        before=total[stands],
        after=total[2],
        noise=noise[1],
        channels={n: tuple(float(e[n]) for e in (errors[0], errors[stands], errors[2], noise[0])) for n in names},  # type: ignore[misc]
        calibrated=total[1],
        bare=total[-1] if findings else float("nan"),
        parts=tuple(parts),
        measured=data,
        answers=tuple(answers[:3]),
    )


def _rms(values: Mapping[str, float]) -> float:
    return float(np.sqrt(np.mean([v**2 for v in values.values()])))


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
        ratio = np.log(data.zeta[known] / np.maximum(own.zeta[known], RESPONSES.smallest_zeta))
        out["damping"] = np.abs(ratio)
    if data.shapes.shape[1]:
        out["shape"] = np.sqrt(np.clip(1.0 - own.mac, 0.0, 1.0))
    return {name: np.where(np.isfinite(e), e, 1.0) for name, e in out.items()}


def _checked_modes(data: Modes, answers: list[ModalAnswer], findings: Sequence[str]) -> CheckedFrequency:
    each = [modal_errors(data, own) for own in answers]
    noise = {"frequency": data.freq_sd, "damping": data.zeta_sd, "shape": data.shape_sd}
    floor = {name: float(np.sqrt(np.mean(np.minimum(noise[name], 1.0) ** 2))) for name in each[0]}
    errors = [{name: float(np.sqrt(np.mean(e[name] ** 2))) for name in e} for e in each]
    unit = floor["frequency"]
    total = [unit * float(np.sqrt(np.mean([(e[n] / floor[n]) ** 2 for n in e]))) for e in errors]
    moved = [{n: float(np.sqrt(np.mean((e[n] - each[2][n]) ** 2))) for n in each[0]} for e in each[3:]]
    return _checked(data, total, errors, (floor, unit), answers, findings, moved, data.n)
