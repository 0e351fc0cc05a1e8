"""All numbers of a model fitted by mujoco.sysid [1]_.

The fit names the effect that its most costly number stands for.

The residual is that of free runs over all fit recordings, divided by the noise of each channel. Stated deviations of the
case are residuals, too: number over standard deviation. The optimiser of mujoco.sysid runs to its own end, `TOLERANCE` of
the step, at most `MOST_ITERATIONS`. The first of two passes takes `FIRST_NOISE` as noise; the second takes what the first
pass left. CPU time is capped at `MOST_CPU_S`; then the best values so far count.

A fitted number is not nominal if its distance from nominal is significant beside the deviations of fit and statement
together (`FALSE_ALARMS`). The covariance is that of mujoco.sysid. The named effect is that of the number whose return to nominal costs
most, with all others refitted (Wald's statistic).

References
----------
.. [1] MuJoCo, ``mujoco.sysid``, Google DeepMind, 2026.
"""

import contextlib
import io
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from mujoco import sysid
from scipy import stats

from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.cases.initial_state import InitialState, find_initial_state
from vlab.cases.simulate import simulate
from vlab.errors import VlabError
from vlab.plants.equilibrium import settle
from vlab.plants.mjcf import MjcfPlant
from vlab.proof.peers.freed_numbers import SHARE, SLOW, Freed, freed_numbers, with_numbers
from vlab.proof.peers.result import (
    MOST_ERROR,
    Deadline,
    Named,
    NotUsable,
    PeerResult,
    compared_names,
    error_of,
    mean_error,
    mjcf_runs,
)
from vlab.signals import Array

HAS_SYSID = hasattr(sysid, "optimize")
"""HAS_SYSID: whether the extra of mujoco.sysid is installed."""
MOST_ITERATIONS = 60
"""MOST_ITERATIONS [-]: most iterations of a pass."""
MOST_CPU_S = 400.0
"""MOST_CPU_S [s]: most CPU time of a case."""
TOLERANCE = 2e-3
"""TOLERANCE [-]: step at which the optimiser ends, as a logarithm or in units of an added number."""
STEP = 1e-4
"""STEP [-]: finite difference, as a logarithm or in units of an added number; rounding of a run is far below."""
FIRST_NOISE, LEAST_NOISE = 0.02, 1e-5
"""FIRST_NOISE, LEAST_NOISE [-]: noise of the first pass and least noise of the second, over a channel's rms."""
OFF_BOUNDS = 2e-3
"""OFF_BOUNDS [-]: least distance of a start from its bounds, over their distance; mujoco.sysid warns below half of it."""
FALSE_ALARMS = 0.05
"""FALSE_ALARMS [-]: probability that any nominal number seems not nominal, shared by all numbers (Bonferroni)."""
NAMES = (
    "added-mass", "rotary-inertia", "coulomb-friction", "viscous-damping", "stiffness-to-ground", "lost-stiffness",
    "actuator-gain", "servo-position-gain", "servo-velocity-gain", "servo-force-limit", "actuator-offset",
    "actuator-delay", "sensor-gain", "sensor-offset", "sensor-delay",
)  # fmt: skip
"""NAMES: effects that the peer can name."""


class _TimeIsUp(Exception):
    """End of the CPU time within an optimisation."""


def fit_all_numbers(case: Case, *, kinds: Collection[str] = ()) -> PeerResult:
    """Fit all numbers of a case's model.

    Parameters
    ----------
    case : Case
        Case.
    kinds : collection of str
        Kinds of numbers that are freed; all by default.

    Returns
    -------
    PeerResult
        Most costly number that is not nominal, and the error of the fitted model on the hold-out recordings.

    Raises
    ------
    NotUsable
        The extra is missing, or the model is no MJCF in open loop.
    """
    if not HAS_SYSID:
        raise NotUsable("needs the extra of mujoco.sysid; pip install 'vlab-vibration[peers]'")
    plant, fit, holdout = mjcf_runs(case)
    freed = [f for f in freed_numbers(plant, case.table.model.uncertain, fit) if not kinds or f.kind in kinds]
    model = _Model(plant=plant, freed=freed)
    starts = [find_initial_state(plant, run) for run in fit]
    scale = [np.array([np.std(run.measured[name]) for name in compared_names(run)]) for run in fit]
    deadline = Deadline.after(MOST_CPU_S)
    residual = _Residual(
        model=model, runs=fit, starts=starts, sigma=[FIRST_NOISE * s for s in scale], deadline=deadline
    )
    values = np.array([number.start for number in freed])
    cut = ""
    for _ in range(2):
        values, cut = _optimised(residual, _off_bounds(freed, values))
        if cut:
            break
        sigma = residual.noise_at(values, scale)
        residual = replace(residual, sigma=sigma, best=[], cache={})
    covariance = _covariance(replace(residual, deadline=Deadline.after(MOST_CPU_S), best=[], cache={}), values)
    errors = [_held_out_error(model, values, run) for run in holdout]
    remark = f"{len(freed)} numbers freed; {cut or 'converged'}"
    return PeerResult(named=_named(freed, values, covariance), names=NAMES, nrmse=mean_error(errors), remark=remark)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Model:
    """Model with freed numbers."""

    plant: MjcfPlant
    freed: Sequence[Freed]

    def plant_at(self, values: Array) -> MjcfPlant:
        """Return the plant at some values, at its equilibrium."""
        model = with_numbers(self.plant.model, self.freed, values)
        return replace(self.plant, model=model, rest=settle(model)[0] if np.any(model.opt.gravity) else self.plant.rest)

    def commanded(self, run: Run, values: Array) -> Run:
        """Return a run with moved and delayed commands."""
        data, time = run.measured.data.copy(), run.measured.time
        for number, value in zip(self.freed, values, strict=True):
            if not number.kind.startswith("command"):
                continue
            column = run.measured.index(number.channel)
            if number.kind == "command-offset":
                data[:, column] += value * SHARE * float(np.std(run.measured[number.channel]))
            else:
                data[:, column] = np.interp(time - value * SLOW, time, data[:, column])
        return replace(run, measured=replace(run.measured, data=data))

    def read(self, run: Run, simulated: Array, values: Array) -> Array:
        """Return simulated channels (n, n_channels) as the sensors read them."""
        out, names, time = simulated.copy(), compared_names(run), run.measured.time
        for number, value in zip(self.freed, values, strict=True):
            if not number.kind.startswith("sensor"):
                continue
            column = names.index(number.channel)
            if number.kind == "sensor-gain":
                out[:, column] *= np.exp(value)
            elif number.kind == "sensor-offset":
                out[:, column] += value * SHARE * float(np.std(run.measured[number.channel]))
            else:
                out[:, column] = np.interp(time - value * SLOW, time, out[:, column])
        return out


@dataclass(frozen=True, kw_only=True, eq=False)
class _Residual:
    """Residual of free runs and stated deviations, of unit variance.

    `best` holds the least sum of squares and its values; `cache` the last simulation by the numbers of the model.
    """

    model: _Model
    runs: Sequence[Run]
    starts: Sequence[InitialState]
    sigma: Sequence[Array]
    deadline: Deadline
    best: list[tuple[float, Array]] = field(default_factory=list)
    cache: dict[bytes, list[Array]] = field(default_factory=dict)

    def of(self, values: Array) -> Array:
        """Return the residual (rows,) at some values."""
        if self.deadline.is_past:
            raise _TimeIsUp
        parts = [
            ((self.model.read(run, y, values) - _measured(run)) / sigma).ravel()
            for run, y, sigma in zip(self.runs, self._simulated(values), self.sigma, strict=True)
        ]
        stated = np.array([v / f.sd for f, v in zip(self.model.freed, values, strict=True) if np.isfinite(f.sd)])
        limit = MOST_ERROR / FIRST_NOISE
        out = np.concatenate([*(np.nan_to_num(np.clip(p, -limit, limit), nan=limit) for p in parts), stated])
        size = float(out @ out)
        if not self.best or size < self.best[0][0]:
            self.best[:] = [(size, values.copy())]
        return out

    def _simulated(self, values: Array) -> list[Array]:
        """Return the channels of every run, simulated where necessary."""
        own = [not number.kind.startswith("sensor") for number in self.model.freed]
        key = values[own].tobytes()
        if key not in self.cache:
            plant = self.model.plant_at(values)
            self.cache.clear()
            self.cache[key] = [
                _simulated(plant, self.model.commanded(run, values), start)
                for run, start in zip(self.runs, self.starts, strict=True)
            ]
        return self.cache[key]

    def noise_at(self, values: Array, scale: Sequence[Array]) -> list[Array]:
        """Return the rms residual of every run and channel."""
        out = []
        for run, y, own in zip(self.runs, self._simulated(values), scale, strict=True):
            left = np.sqrt(np.mean((self.model.read(run, y, values) - _measured(run)) ** 2, axis=0))
            out.append(np.maximum(np.nan_to_num(left, nan=MOST_ERROR), LEAST_NOISE * own))
        return out


def _measured(run: Run) -> Array:
    return np.column_stack([run.measured[name] for name in compared_names(run)])


def _simulated(plant: MjcfPlant, run: Run, start: InitialState) -> Array:
    """Return the channels of a free run; NaN after divergence."""
    names = compared_names(run)
    if start.how == "rest":
        start = InitialState(qpos=plant.rest, qvel=np.zeros(plant.model.nv), how="rest")
    try:
        recording = simulate(plant, run, initial=start).recording
    except VlabError:
        return np.full((len(run.measured), len(names)), np.nan)
    return np.column_stack([recording[name] for name in names])


def _optimised(residual: _Residual, start: Array) -> tuple[Array, str]:
    """Return the optimiser's values, and why it was stopped."""
    parameters = sysid.ParameterDict()
    for number, value in zip(residual.model.freed, start, strict=True):
        parameters.add(sysid.Parameter(number.label, float(value), number.low, number.high))

    def function(x: Array, known: Any) -> tuple[list[Array], None, None]:
        # one candidate, (n,) or (n, 1), or all perturbed ones of a derivative, (n, k)
        columns = [residual.of(np.ascontiguousarray(column)) for column in np.atleast_2d(x.T)]
        return [np.array(columns).T if x.ndim == 2 else columns[0]], None, None

    log: list[Any] = []
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            _, found = sysid.optimize(
                parameters, function, max_iters=MOST_ITERATIONS, verbose=False, xtol=TOLERANCE, eps=STEP,
                iter_callback=log.append,
            )  # fmt: skip
    except _TimeIsUp:
        return residual.best[0][1], f"stopped after {MOST_CPU_S:g} s of CPU time"
    count = len(log)
    return np.asarray(found.x).ravel(), f"stopped after {count} iterations" if count >= MOST_ITERATIONS else ""


def _off_bounds(freed: Sequence[Freed], values: Array) -> Array:
    """Return values at some distance from their bounds."""
    low, high = (np.array([getattr(number, end) for number in freed]) for end in ("low", "high"))
    margin = OFF_BOUNDS * (high - low)
    return np.clip(values, low + margin, high - margin)


def _covariance(residual: _Residual, values: Array) -> Array:
    """Return the covariance of the numbers by mujoco.sysid."""
    base = residual.of(values)
    columns = []
    for i, number in enumerate(residual.model.freed):
        step = STEP if values[i] + STEP <= number.high else -STEP
        moved = values.copy()
        moved[i] += step
        columns.append((residual.of(moved) - base) / step)
    slopes = np.array(columns).T
    return np.asarray(sysid.calculate_intervals([base], slopes)[0])


def _named(freed: Sequence[Freed], values: Array, covariance: Array) -> Named | None:
    """Return the effect of the number whose return to nominal costs most."""
    found: list[Named] = []
    least = float(stats.norm.isf(0.5 * FALSE_ALARMS / len(freed)))
    for number, value, variance in zip(freed, values, np.diag(covariance), strict=True):
        effect = number.raised if value > 0 else number.lowered
        stated = number.sd if np.isfinite(number.sd) else 0.0
        sd = float(np.sqrt(max(variance, 0.0)))
        if effect and sd > 0.0 and abs(value) > least * np.hypot(sd, stated):
            found.append(Named(effect=effect, place=number.place, share=float(abs(value) / sd)))
    return max(found, key=lambda n: n.share, default=None)


def _held_out_error(model: _Model, values: Array, run: Run) -> float:
    """Return the relative error of the fitted model on a recording."""
    plant, commanded = model.plant_at(values), model.commanded(run, values)
    try:
        start = find_initial_state(plant, commanded)
    except VlabError:
        return MOST_ERROR
    return error_of(run, model.read(run, _simulated(plant, commanded, start), values))
