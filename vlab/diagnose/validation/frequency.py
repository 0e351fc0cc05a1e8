"""Validation on hold-out responses and modal tables.

Nominal, calibrated and extended plants are linearised by MuJoCo and compared with the data.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from vlab.cases.case import Case
from vlab.diagnose.data.responses import Measured, Modes, Response, read_measured, thinned
from vlab.diagnose.parameters.terms import Fit, with_effects
from vlab.diagnose.predictors.frequency import State
from vlab.diagnose.predictors.frequency_model import View, Wires, view_of, wires_of
from vlab.diagnose.predictors.frequency_modes import ModelModes, model_modes, state_matrix
from vlab.diagnose.predictors.frequency_problem import FrequencyProblem
from vlab.diagnose.predictors.frequency_residual import shape_rows, tracked
from vlab.diagnose.predictors.level_answer import answer_at_level
from vlab.diagnose.predictors.level_modes import acts_in_table, modes_at_amplitude
from vlab.diagnose.settings import FREQUENCY_VALIDATION, RESPONSES, VALIDATION
from vlab.diagnose.validation.gap import Distance, block_log_ratios, part_of, total
from vlab.diagnose.validation.simulation import Ablations
from vlab.modal.mac import mac
from vlab.plants.base import Plant
from vlab.signals import Array, ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class ExtendedFrequencyModel:
    """Calibrated plant with added physics and channel gains.

    Parameters
    ----------
    plant : Plant
        Plant.
    wires : Wires
        Inputs and outputs of the data.
    sensor_gain : (n_outputs,) array
        Gains of the outputs, in the order of `names`.
    input_gain : (n_columns,) array
        Gains of the inputs; of forces measured at ports beyond the actuators.
    offset : None
        Responses have no offset.
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
        """Return MuJoCo's linearisation of the plant, and its matrices."""
        view = view_of(self.plant, self.wires)
        return view, State(M=view.M, C=view.C, K=view.K, input_gain=self.input_gain, output_gain=self.sensor_gain)


def nominal_model(plant: Plant, wires: Wires) -> ExtendedFrequencyModel:
    """Return a plant without calibration."""
    columns = len(plant.actuators) + sum(a is None for a in wires.actuators)
    return ExtendedFrequencyModel(
        plant=plant, wires=wires, sensor_gain=np.ones(len(wires.names)), input_gain=np.ones(columns)
    )


def extended_by(problem: FrequencyProblem, fit: Fit) -> ExtendedFrequencyModel:
    """Return a problem's plant extended by a fit.

    Parameters
    ----------
    problem : FrequencyProblem
        Problem.
    fit : Fit
        Fit.

    Returns
    -------
    ExtendedFrequencyModel
        Extended model.
    """
    given = nominal_model(problem.plant, problem.wires)
    sensors, inputs = given.sensor_gain.copy(), given.input_gain.copy()
    for parameter, value in zip(problem.parameters, fit.theta, strict=True):
        if parameter.sensor is not None:
            sensors[parameter.sensor] *= np.exp(value)
        if parameter.actuator is not None and parameter.actuator >= len(problem.plant.actuators):
            inputs[parameter.actuator] *= np.exp(value)
    return ExtendedFrequencyModel(
        plant=with_effects(problem.adjusted(fit.theta), fit.terms, problem.names),
        wires=problem.wires,
        sensor_gain=sensors,
        input_gain=inputs,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalAnswer:
    """Modes of a model in the order of a table.

    Parameters
    ----------
    freq, zeta : (n,) array
        Natural frequencies [Hz] and damping ratios [1]; NaN for a mode missing in the model.
    mac : (n,) array
        Modal assurance criterion of measured and modelled shapes; NaN without shapes.
    """

    freq: Array
    zeta: Array
    mac: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class CheckedFrequency(Distance):
    """Errors of the models on frequency data.

    Errors of responses are rms over lines and outputs of the difference over the mean magnitude. Errors of modes are
    rms relative differences. Damping and shape errors are scaled by their uncertainty over that of frequency; the
    channels are "frequency", "damping" and "shape".

    Parameters
    ----------
    measured : Response or Modes
        Data.
    answers : tuple
        Nominal, calibrated and extended model: (n, n_outputs) responses, or modes.
    """

    measured: Measured
    answers: tuple[ComplexArray | ModalAnswer, ...]

    @property
    def standing(self) -> ComplexArray | ModalAnswer:
        """Response of the better of nominal and calibrated model.

        Its error is `before`.
        """
        return self.answers[0 if self.is_spoilt else 1]

    def without_findings(self) -> "CheckedFrequency":
        """Return the errors without any finding."""
        channels = {
            name: (nominal, before, before, noise) for name, (nominal, before, _, noise) in self.channels.items()
        }
        answers = (*self.answers[:2], self.standing)
        return replace(self, after=self.before, channels=channels, answers=answers, log_ratios=np.zeros(0))


def check_frequency(
    models: Sequence[ExtendedFrequencyModel],
    measured: Sequence[Measured],
    unfitted: Mapping[str, float] | None = None,
    ablations: Ablations | None = None,
) -> list[CheckedFrequency]:
    """Compare nominal, calibrated and extended plant with data.

    Parameters
    ----------
    models : sequence of ExtendedFrequencyModel
        Nominal, calibrated and extended model.
    measured : sequence of Response or Modes
        Data.
    unfitted : mapping of str to float
        Relative standard deviations of input gains without data to fit. Calibrated and extended plant use their most
        probable gain each.
    ablations : Ablations or None
        Models without single findings.

    Returns
    -------
    list of CheckedFrequency
        Errors of every data set.
    """
    ablations = ablations or Ablations()
    seen = [model.seen() for model in (*models, *ablations.models)]
    out = []
    for data in measured:
        if isinstance(data, Response):
            given, *fitted = [answer_at_level(v, s, data, models[0].wires).H for v, s in seen]
            sd = (unfitted or {}).get(data.input, 0.0)
            answers = [given, *(H * _likeliest_gain(H, data, sd) for H in fitted)]
            out.append(_checked_response(data, answers, ablations.names))
        else:
            out.append(_checked_modes(data, [modal_answer(v, s, data) for v, s in seen], ablations.names))
    return out


def _likeliest_gain(H: ComplexArray, data: Response, sd: float) -> float:
    """Return the most probable input gain under its prior.

    All lines have equal weight, as in the reported error.

    Parameters
    ----------
    H : (n, n_outputs) complex array
        Modelled response.
    data : Response
        Measured response.
    sd : float
        Prior standard deviation of the gain [1].
    """
    if sd == 0.0:
        return 1.0
    usable = np.isfinite(data.H) & np.isfinite(H)
    own, seen = H[usable], data.H[usable]
    size = float(np.mean(data.spread[usable] ** 2 + RESPONSES.model_error**2 * np.abs(seen) ** 2))
    weight, pull = float(np.sum(np.abs(own) ** 2)) / size, float(np.sum((np.conj(own) * seen).real)) / size
    return (pull + sd**-2) / (weight + sd**-2)


def checked_again(case: Case, names: Collection[str]) -> float:
    """Return the nominal error of a case's model.

    Parameters
    ----------
    case : Case
        Case.
    names : collection of str
        Names of the data sets.

    Returns
    -------
    float
        Relative rms error.
    """
    fit, held_out = read_measured(case, ("fit",)), read_measured(case, ("holdout",))
    wires = wires_of(case, [*fit, *held_out])
    chosen = [*thinned(fit), *held_out]
    model = nominal_model(case.plant, wires)
    return total(check_frequency([model] * 3, [d for d in chosen if d.name in names]), "nominal")


def apart(data: Response, own: ComplexArray) -> Array:
    """Return the squared relative difference of responses.

    Parameters
    ----------
    data : Response
        Measured response.
    own : (n, n_outputs) complex array
        Modelled response.

    Returns
    -------
    (n, n_outputs) array
        Squared difference over the mean squared magnitude; NaN below the noise.
    """
    measured = data.H
    difference = np.abs(measured) - np.abs(own) if data.is_magnitude else measured - own
    size = 0.5 * (np.abs(measured) ** 2 + np.abs(own) ** 2)
    return np.where(heard(data), np.abs(difference) ** 2 / np.maximum(size, 1e-300), np.nan)


def heard(data: Response) -> Array:
    """Return the mask of lines above the noise.

    Neighbouring lines decide as well, since selection of single lines lifted by noise would bias the error.

    Parameters
    ----------
    data : Response
        Measured response.

    Returns
    -------
    (n, n_outputs) array of bool
        Usable lines.
    """
    size = median_filter(np.abs(data.H), size=(FREQUENCY_VALIDATION.neighbours, 1), mode="nearest")
    out = data.noise < FREQUENCY_VALIDATION.drowned * size
    return np.where(out.any(axis=0), out, True)


def noise_apart(data: Response) -> Array:
    """Return the squared relative difference of an exact model."""
    square = np.abs(data.H) ** 2
    return np.where(heard(data), np.minimum(data.noise**2 / np.maximum(square, 1e-300), 2.0), np.nan)


def _checked_response(data: Response, answers: list[ComplexArray], findings: Sequence[str]) -> CheckedFrequency:
    names = list(data.outputs)
    errors = [dict(zip(names, np.sqrt(np.nanmean(apart(data, H), axis=0)), strict=True)) for H in answers]
    noise = dict(zip(names, np.sqrt(np.nanmean(noise_apart(data), axis=0)), strict=True))
    total = [_rms(e) for e in errors]
    size = np.where(heard(data), np.abs(data.H) ** 2, np.nan)

    def moved(H: ComplexArray) -> dict[str, float]:
        """Return the relative change of the extended model's responses."""
        difference = np.abs(H) - np.abs(answers[2]) if data.is_magnitude else H - answers[2]
        square = np.abs(difference) ** 2 / np.maximum(size, 1e-300)
        return dict(zip(names, np.sqrt(np.nanmean(square, axis=0)), strict=True))

    own = _checked(
        data, total, errors, (noise, _rms(noise)), answers, findings, [moved(H) for H in answers[3:]], len(data.freq)
    )
    return _with_log_ratios(own, [np.sqrt(np.nan_to_num(apart(data, H))) for H in answers], VALIDATION.blocks)


def _with_log_ratios(checked: CheckedFrequency, errors: Sequence[Array], blocks: int) -> CheckedFrequency:
    """Return checked data with both models' log error ratios.

    Parameters
    ----------
    checked : CheckedFrequency
        Errors on the data.
    errors : sequence of (n, n_channels) array
        Errors of every model; the last is that without findings.
    blocks : int
        Number of blocks.
    """
    without = errors[-1] if checked.bare < checked.before else errors[0 if checked.is_spoilt else 1]
    return replace(checked, log_ratios=block_log_ratios(without, errors[2], blocks))


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
    """Return the errors of all models.

    Parameters
    ----------
    data : Response or Modes
        Data.
    total : sequence of float
        Error of every model over all channels.
    errors : sequence of mapping
        Error of every model by channel.
    noise : (mapping, float)
        Noise by channel and over all channels.
    answers : sequence
        Responses or modes of every model.
    findings : sequence of str
        Names of the findings.
    moved : sequence of mapping
        Change by removal of every finding, by channel.
    samples : int
        Values per channel.
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
    """Return the modes of a model in the order of a table.

    Parameters
    ----------
    view : View
        Linearised plant.
    state : State
        Matrices.
    data : Modes
        Modal table.

    Returns
    -------
    ModalAnswer
        Modes, NaN where missing.
    """
    A = state_matrix(state, view.fixed, 2 * np.pi * 2 * float(data.freq[-1]))
    modes: ModelModes = model_modes(A, view.m)
    rows = shape_rows(view, data)
    pairs = tracked(modes, data, rows)
    if acts_in_table(view, data, ()):
        modes, pairs = modes_at_amplitude(view, state, data, (), modes, pairs)
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
    """Return the relative errors of every mode.

    Parameters
    ----------
    data : Modes
        Modal table.
    own : ModalAnswer
        Modes of the model.

    Returns
    -------
    dict of str to (n,) array
        Errors by "frequency", "damping" and "shape" [1].
    """
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
    own = _checked(data, total, errors, (floor, unit), answers, findings, moved, data.n)
    values = [np.concatenate([e[n] / floor[n] for n in e])[:, None] for e in each]
    return _with_log_ratios(own, values, len(values[0]))
