"""Nested friction models of servos on the log of an arm [1]_.

The models are those of Better Actuator Models (BAM).

Every joint has the same model of its own parameters. M1 is Coulomb and viscous friction. M2 adds Stribeck's excess, M3
friction in proportion to the load, M4 both. M5 tells motor and outer moment apart. M6 adds the square of the weaker one.
M0 has no friction beyond the model's own. All models free position gain, velocity gain, armature and viscous
damping of every joint, with their stated deviations. One delay of the commands and offsets of the channels are free, too.

The fit is by output error over free runs of all fit recordings, in MuJoCo, by `scipy.optimize.least_squares` in place of
the published CMA-ES; each model starts from the best nested one. A model ends by itself (`TOLERANCE`), after `MOST_STEPS`,
or when the CPU time of the case is up (`MOST_CPU_S`).

Choice: the model with the least error on the hold-out recordings, as published, which favours the peer; a simpler one
within `AS_GOOD`. The named joint is the one whose friction is worth most in the fit. The effect is load friction if the
load part is worth more than the rest, otherwise Stribeck or Coulomb friction.

References
----------
.. [1] M. Duclusaud, G. Passault, V. Padois, O. Ly, "Extended friction models for the physics simulation of servo
   actuators", arXiv:2410.08650, 2024.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import optimize

from vlab.cases.case import Case
from vlab.cases.initial_state import find_initial_state
from vlab.plants.mjcf import MjcfPlant
from vlab.proof.peers.freed_numbers import stated_deviation
from vlab.proof.peers.friction_run import FRICTION, NO_FRICTION, ArmRun, prepared, run_with_friction
from vlab.proof.peers.result import Deadline, Named, PeerResult, compared_names, error_of, mean_error, mjcf_runs
from vlab.signals import Array

MOST_CPU_S = 400.0
"""MOST_CPU_S [s]: CPU time of a case after which no further model is fitted."""
MOST_STEPS, TOLERANCE = 15, 1e-3
"""MOST_STEPS [-]: most steps of a fit.
TOLERANCE [-]: relative decrease of the cost at which a fit ends."""
STEP = 1e-2
"""STEP [-]: finite difference in units of the parameters' scales."""
FIRST_NOISE, LEAST_NOISE = 0.02, 1e-5
"""FIRST_NOISE, LEAST_NOISE [-]: noise of the first fit, and least noise of the others, over a channel's rms."""
AS_GOOD = 1.05
"""AS_GOOD [-]: ratio of held-out errors up to which a simpler model is taken."""
WORTH = 0.1
"""WORTH [-]: share of Coulomb friction from which Stribeck's excess gives the name."""
SIGNIFICANT = 4.0
"""SIGNIFICANT [-]: stated deviations at which the model's own damping is wrong."""
FAR = 1e4
"""FAR [-]: limit of a residual; that of a run that diverges."""
DELAY_S, LONGEST_S = 1e-3, 0.05
"""DELAY_S [s]: scale of the commands' delay.
LONGEST_S [s]: longest delay."""
WIDEST = 2.0
"""WIDEST [-]: bound of the logarithms of `OWN`."""
OWN = ("gain", "velocity-gain", "armature", "damping")
"""OWN: numbers of a joint that every model frees, as logarithms."""
NAMES = ("coulomb-friction", "stribeck-friction", "servo-load-friction", "viscous-damping")
"""NAMES: effects that the peer can name."""


@dataclass(frozen=True, kw_only=True)
class Freed:
    """Parameter of the friction in a joint.

    Parameters
    ----------
    columns : tuple of str
        Entries of `FRICTION` that have its value.
    start, low, high, scale : float
        Start, bounds and scale; of a moment relative to the largest moment of the servo.
    power : int
        Power of that moment in the unit.
    """

    columns: tuple[str, ...]
    start: float
    low: float
    high: float
    scale: float
    power: int = 0


def _share(*columns: str) -> Freed:
    return Freed(columns=columns, start=0.02, low=0.0, high=0.95, scale=0.05)


BASE = Freed(columns=("base",), start=0.005, low=0.0, high=0.5, scale=0.01, power=1)
EXCESS = replace(BASE, columns=("stribeck",))
SPEED = Freed(columns=("speed",), start=0.2, low=0.01, high=3.0, scale=0.1)
POWER = Freed(columns=("power",), start=1.35, low=1.0, high=10.0, scale=0.5)
SQUARES = tuple(
    Freed(columns=(name,), start=0.005, low=0.0, high=0.5, scale=0.02, power=-1)
    for name in ("square-motor", "square-outer")
)
_LOAD, _SLOW_LOAD = _share("load-motor", "load-outer"), _share("stribeck-motor", "stribeck-outer")
_DIRECTED = tuple(_share(name) for name in ("load-motor", "load-outer", "stribeck-motor", "stribeck-outer"))
MODELS: dict[str, tuple[Freed, ...]] = {
    "M0": (),
    "M1": (BASE,),
    "M2": (BASE, EXCESS, SPEED, POWER),
    "M3": (BASE, _LOAD),
    "M4": (BASE, _LOAD, EXCESS, _SLOW_LOAD, SPEED, POWER),
    "M5": (BASE, *_DIRECTED, EXCESS, SPEED, POWER),
    "M6": (BASE, *_DIRECTED, EXCESS, SPEED, POWER, *SQUARES),
}
"""MODELS: parameters of a joint by model, simplest first."""
NESTED = {"M1": ("M0",), "M2": ("M1",), "M3": ("M1",), "M4": ("M2", "M3"), "M5": ("M4",), "M6": ("M5",)}
"""NESTED: models from whose best a model starts."""


class _TimeIsUp(Exception):
    """End of the CPU time within a fit."""


def fit_friction_models(case: Case) -> PeerResult:
    """Fit the friction models to an arm.

    Parameters
    ----------
    case : Case
        Case.

    Returns
    -------
    PeerResult
        Friction that is worth most, and the held-out error of the chosen model.

    Raises
    ------
    NotUsable
        The model is no arm with a position servo in every joint.
    """
    plant, fit, holdout = mjcf_runs(case)
    runs, tests = ([prepared(plant, run, find_initial_state(plant, run)) for run in some] for some in (fit, holdout))
    deadline = Deadline.after(MOST_CPU_S)
    given = case.table.model.uncertain
    first = [np.full(len(run.channels), FIRST_NOISE) * _rms(run) for run in runs]
    none = Fitted(
        own=np.zeros((plant.model.nv, len(OWN))), delay=0.0, friction=np.tile(NO_FRICTION, (plant.model.nv, 1))
    )
    rough = _Objective(plant=plant, given=given, runs=runs, sigma=first, freed=(), deadline=deadline)
    start, _ = rough.fitted(none)
    sigma = rough.noise_at(start)
    found: dict[str, Fitted] = {}
    costs: dict[str, float] = {}
    cut = ""
    for name, freed in MODELS.items():
        if deadline.is_past:
            cut = f"; {name} and later not fitted in {MOST_CPU_S:g} s of CPU time"
            break
        parents = [p for p in NESTED.get(name, ()) if p in found]
        parent = found[min(parents, key=lambda p: costs[p])] if parents else start
        objective = replace(rough, sigma=sigma, freed=freed)
        found[name], costs[name] = objective.fitted(parent)
    last = replace(rough, sigma=sigma, deadline=Deadline.after(MOST_CPU_S))
    errors = {name: last.held_out_error(fitted, tests) for name, fitted in found.items()}
    chosen = next(name for name in found if errors[name] <= AS_GOOD * min(errors.values()))
    table = ", ".join(f"{name} {errors[name]:.4g}" for name in found)
    return PeerResult(
        named=last.named(chosen, found[chosen]), names=NAMES, nrmse=errors[chosen], remark=f"{chosen} of {table}{cut}"
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """Parameters of an arm.

    Parameters
    ----------
    own : (nv, 4) array
        Logarithms of `OWN`.
    delay : float
        Delay of the commands [s].
    friction : (nv, 10) array
        Friction of `FRICTION` [SI].
    """

    own: Array
    delay: float
    friction: Array


def _rms(run: ArmRun) -> Array:
    return np.array([np.std(run.run.measured[name]) for name in compared_names(run.run)])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Objective:
    """Output error of an arm with a friction model."""

    plant: MjcfPlant
    given: Mapping[str, float]
    runs: Sequence[ArmRun]
    sigma: Sequence[Array]
    freed: Sequence[Freed]
    deadline: Deadline
    best: list[tuple[float, Array]] = field(default_factory=list)

    @cached_property
    def servos(self) -> list[int]:
        """Actuator of every degree of freedom."""
        model = self.plant.model
        dofs = [int(model.jnt_dofadr[model.actuator_trnid[i, 0]]) for i in range(model.nu)]
        return [dofs.index(j) for j in range(model.nv)]

    @cached_property
    def moments(self) -> Array:
        """Largest moment of every servo [N m]."""
        model, out = self.plant.model, []
        for i in self.servos:
            limit = float(model.actuator_forcerange[i, 1])
            most = max(float(np.ptp(run.controls[:, i])) for run in self.runs) * float(model.actuator_gainprm[i, 0])
            out.append(limit if model.actuator_forcelimited[i] else max(most, 1e-9))
        return np.array(out)

    @cached_property
    def stated(self) -> Array:
        """Stated deviations (nv, 4) of `OWN`."""
        model, rows = self.plant.model, []
        for j, i in enumerate(self.servos):
            joint, actuator = f"joint:{model.joint(model.dof_jntid[j]).name}", f"actuator:{model.actuator(i).name}"
            rows.append([stated_deviation(self.given, kind, actuator if "gain" in kind else joint) for kind in OWN])
        return np.array(rows)

    @property
    def scale(self) -> Array:
        """Scales of the vector."""
        own = [p.scale for p in self.freed]
        return np.concatenate([self.stated.ravel(), [DELAY_S], np.tile(own, len(self.moments))])

    def packed(self, fitted: Fitted) -> Array:
        """Return the vector of parameters; zeros begin at their start."""
        out = [*fitted.own.ravel(), max(fitted.delay, 0.1 * DELAY_S)]
        for j, moment in enumerate(self.moments):
            for p in self.freed:
                value = float(fitted.friction[j, FRICTION.index(p.columns[0])]) / moment**p.power
                out.append(value if value > 0.1 * p.start else p.start)
        return np.asarray(np.clip(out, *self.bounds))

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the vector."""
        own, count = self.stated.size, len(self.moments)
        low = [*own * [-WIDEST], 0.0, *count * [p.low for p in self.freed]]
        high = [*own * [WIDEST], LONGEST_S, *count * [p.high for p in self.freed]]
        return np.array(low), np.array(high)

    def unpacked(self, x: Array) -> Fitted:
        """Return the parameters of a vector."""
        count = len(self.moments)
        friction = np.tile(NO_FRICTION, (count, 1))
        rest = x[self.stated.size + 1 :].reshape(count, len(self.freed))
        for j, moment in enumerate(self.moments):
            for p, value in zip(self.freed, rest[j], strict=True):
                friction[j, [FRICTION.index(c) for c in p.columns]] = value * moment**p.power
        return Fitted(
            own=x[: self.stated.size].reshape(count, len(OWN)), delay=float(x[self.stated.size]), friction=friction
        )

    def simulated(self, fitted: Fitted, run: ArmRun) -> Array:
        """Return the channels of a free run."""
        model: Any = copy.copy(run.plant.model)
        for j, i in enumerate(self.servos):
            gain, velocity, armature, damping = np.exp(fitted.own[j])
            model.actuator_gainprm[i, 0] *= gain
            model.actuator_biasprm[i, 1] *= gain
            model.actuator_biasprm[i, 2] *= velocity
            model.dof_armature[j] *= armature
            model.dof_damping[j] *= damping
        return run_with_friction(run, model, fitted.friction, fitted.delay)

    def differences(self, fitted: Fitted) -> list[Array]:
        """Return simulated minus measured channels without their common mean."""
        out = []
        for run in self.runs:
            measured = np.column_stack([run.run.measured[name] for name in compared_names(run.run)])
            out.append(np.nan_to_num(self.simulated(fitted, run) - measured, nan=FAR, posinf=FAR, neginf=-FAR))
        offset = np.mean(np.vstack(out), axis=0)
        return [difference - offset for difference in out]

    def residual(self, x: Array) -> Array:
        """Return the residual of a vector, of unit variance."""
        if self.deadline.is_past:
            raise _TimeIsUp
        parts = self.of(self.unpacked(x))
        size = float(parts @ parts)
        if not self.best or size < self.best[0][0]:
            self.best[:] = [(size, x.copy())]
        return parts

    def of(self, fitted: Fitted) -> Array:
        """Return the residual of some parameters, of unit variance."""
        pairs = zip(self.differences(fitted), self.sigma, strict=True)
        parts = [np.clip(difference / sigma, -FAR, FAR).ravel() for difference, sigma in pairs]
        return np.concatenate([*parts, (fitted.own / self.stated).ravel()])

    def fitted(self, start: Fitted) -> tuple[Fitted, float]:
        """Return the fit from a start, and its sum of squares."""
        scale, (low, high) = self.scale, self.bounds
        objective = replace(self, best=[])

        def slopes(y: Array) -> Array:
            base, columns = objective.residual(y * scale), []
            for i in range(len(y)):
                step = STEP if (y[i] + STEP) * scale[i] <= high[i] else -STEP
                moved = y.copy()
                moved[i] += step
                columns.append((objective.residual(moved * scale) - base) / step)
            return np.array(columns).T

        try:
            optimize.least_squares(
                lambda y: objective.residual(y * scale), self.packed(start) / scale, jac=slopes,
                bounds=(low / scale, high / scale), max_nfev=MOST_STEPS, ftol=TOLERANCE, xtol=TOLERANCE, gtol=None,
            )  # fmt: skip
        except _TimeIsUp:
            if not objective.best:
                return start, np.inf
        size, x = objective.best[0]
        return self.unpacked(x), size

    def noise_at(self, fitted: Fitted) -> list[Array]:
        """Return the rms residual of every channel, by recording."""
        differences = self.differences(fitted)
        left = np.sqrt(np.mean(np.vstack(differences) ** 2, axis=0))
        return [np.maximum(left, LEAST_NOISE * _rms(run)) for run in self.runs]

    def held_out_error(self, fitted: Fitted, tests: Sequence[ArmRun]) -> float:
        """Return the relative error of some parameters on other recordings."""
        raw = [self.simulated(fitted, run) for run in self.runs]
        measured = [np.column_stack([r.run.measured[n] for n in compared_names(r.run)]) for r in self.runs]
        offset = np.mean(np.vstack(raw) - np.vstack(measured), axis=0)
        return mean_error([error_of(run.run, self.simulated(fitted, run) - offset) for run in tests])

    def named(self, model: str, fitted: Fitted) -> Named | None:
        """Return the friction that is worth most in the fit."""
        place = [f"joint:{self.plant.model.joint(j).name}" for j in self.plant.model.dof_jntid]
        if model == "M0":
            size = np.abs(fitted.own[:, OWN.index("damping")]) / self.stated[:, OWN.index("damping")]
            worst = int(np.argmax(size))
            is_wrong = size[worst] > SIGNIFICANT
            return Named(effect="viscous-damping", place=place[worst], share=float(size[worst])) if is_wrong else None
        base = self.cost(fitted)
        worth = [self.cost(_without(fitted, j, FRICTION[:8])) - base for j in range(len(place))]
        joint = int(np.argmax(worth))
        load = self.cost(_without(fitted, joint, [n for n in FRICTION[:8] if n not in ("base", "stribeck")])) - base
        dry = self.cost(_without(fitted, joint, ("base", "stribeck"))) - base
        excess, coulomb = (float(fitted.friction[joint, FRICTION.index(n)]) for n in ("stribeck", "base"))
        effect = "stribeck-friction" if excess > WORTH * coulomb else "coulomb-friction"
        effect = "servo-load-friction" if load > dry else effect
        return Named(effect=effect, place=place[joint], share=float(worth[joint] / max(base, 1e-300)))

    def cost(self, fitted: Fitted) -> float:
        """Return the sum of squares of some parameters."""
        parts = self.of(fitted)
        return float(parts @ parts)


def _without(fitted: Fitted, joint: int, names: Sequence[str]) -> Fitted:
    """Return parameters without some of the friction in a joint."""
    friction = fitted.friction.copy()
    friction[joint, [FRICTION.index(name) for name in names]] = 0.0
    return replace(fitted, friction=friction)
