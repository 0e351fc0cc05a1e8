"""Simple methods on the same case: mujoco.sysid and sparse regression.

mujoco.sysid fits all parameters. Sparse regression works on the states. A third method, calibration of the uncertain
parameters alone, is a step of the diagnosis (`before` in its answer).
"""

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout, sysid
from scipy import signal

from vlab.cases import Case
from vlab.cases.channel_map import Run
from vlab.diagnose.validation.gap import total
from vlab.diagnose.validation.simulation import ExtendedModel, check
from vlab.plants.mjcf import MjcfPlant
from vlab.proof.sparse_regression import TERMS, Named, sparse_terms
from vlab.signals import Array

HAS_SYSID = hasattr(sysid, "optimize")
"""HAS_SYSID: whether the extra of mujoco.sysid is installed."""
BOUND = 0.7
"""BOUND [-]: limit on log-factors of freed parameters, a factor of two."""
MOST_ITERATIONS = 8
MOST_RUNS = 3
"""MOST_RUNS [-]: loudest recordings in the fit; each derivative simulates all of them once per parameter."""
SMOOTH_S = 0.03
"""SMOOTH_S [s]: window of the local cubic whose derivatives give velocity and acceleration."""


def baselines_of(case: Case, *, frees_all: bool = True) -> dict[str, dict[str, Any]]:
    """Return the result of each simple method on a case.

    A result holds the held-out error and the named effect, or the reason of a failure.

    Parameters
    ----------
    case : Case
        Case.
    frees_all : bool
        Whether mujoco.sysid is used: minutes per case instead of a second.

    Returns
    -------
    dict
        Result by method.
    """
    out = {"sparse regression": _guarded(_sparse, case)}
    return {"mujoco.sysid": _guarded(freed, case), **out} if frees_all else out


def _guarded(method: Callable[[Case], dict[str, Any]], case: Case) -> dict[str, Any]:
    """Return a method's result; a failure is a result."""
    try:
        return method(case)
    except (ArithmeticError, ValueError, LookupError, AttributeError, np.linalg.LinAlgError) as error:
        return {"note": f"failed: {type(error).__name__}: {' '.join(str(error).split())}"}


# ---- all parameters free --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Free:
    """Freed number of the model, multiplied by the exponential or set."""

    name: str
    array: str
    index: int
    added: float = 0.0  # 0: multiply the value; else add the parameter times this factor


def _free_parameters(model: Any, friction: bool) -> list[_Free]:
    """Return stiffness, damping, mass and optional friction of all elements."""
    out = []
    for i in range(1, model.nbody):
        out += [_Free(f"mass:{i}", "body_mass", i)] if model.body_mass[i] > 0 else []
    for i in range(model.nv):
        out.append(_Free(f"damping:{i}", "dof_damping", i))
        out += [_Free(f"friction:{i}", "dof_frictionloss", i, added=1.0)] if friction else []
    for i in range(model.njnt):
        out += [_Free(f"stiffness:{i}", "jnt_stiffness", i)] if model.jnt_stiffness[i] > 0 else []
    for i in range(model.ntendon):
        out += [_Free(f"stiffness:tendon{i}", "tendon_stiffness", i)] if model.tendon_stiffness[i] > 0 else []
        out += [_Free(f"damping:tendon{i}", "tendon_damping", i)] if model.tendon_damping[i] > 0 else []
    out += [_Free(f"gain:{i}", "actuator_gear", i) for i in range(model.nu)]
    return [f for f in out if f.added or np.any(np.asarray(getattr(model, f.array)[f.index]))]


def freed(case: Case, *, friction: bool = True) -> dict[str, Any]:
    """Fit all parameters with the optimiser of mujoco.sysid.

    The fitted model simulates the held-out recordings.

    Parameters
    ----------
    case : Case
        Case.
    friction : bool
        Whether dry friction is a parameter, although the model has none.

    Returns
    -------
    dict
        Result for the answer.
    """
    if not HAS_SYSID:
        return {"note": "not run: mujoco.sysid needs its extras; pip install 'vlab-vibration[sysid]'"}
    plant, runs = case.plant, case.runs(("fit",))
    if not isinstance(plant, MjcfPlant) or any(run.law is not None for run in runs):
        return {"note": "not run: for MJCF models without a law in the loop"}
    runs = sorted(runs, key=_loudness)[-MOST_RUNS:]
    free = _free_parameters(plant.model, friction)
    largest = max(float(np.abs(run.measured[d.channel]).max()) for run in runs for d in run.drives)
    parameters = sysid.ParameterDict()
    for f in free:
        most = 0.5 * largest if f.added else BOUND
        parameters.add(sysid.Parameter(f.name, 0.01 * most if f.added else 0.0, 0.0 if f.added else -BOUND, most))

    def residual(x: Array, known: Any) -> tuple[list[Array], None, None]:
        # one candidate, (n,), or all perturbed ones of a derivative, (n, k)
        columns = [
            np.concatenate([_misfit(run, plant, _changed(plant.model, free, column)) for run in runs])
            for column in np.atleast_2d(x.T)
        ]
        return [np.array(columns).T if x.ndim == 2 else columns[0]], None, None

    with contextlib.redirect_stdout(io.StringIO()):  # silence the optimiser
        _, found = sysid.optimize(parameters, residual, max_iters=MOST_ITERATIONS, verbose=False)
    fitted = replace(plant, model=_changed(plant.model, free, found.x))
    checked = check(case.runs(("holdout",)), ExtendedModel(plant=plant), ExtendedModel(plant=fitted))
    return {"nrmse": total(checked, "after"), "parameters": len(free), "note": ""}


def _loudness(run: Run) -> float:
    return sum(float(np.std(run.measured[d.channel])) for d in run.drives)


def _changed(model: Any, free: list[_Free], x: Array) -> Any:
    out = mujoco.MjModel.__copy__(model)
    for f, value in zip(free, x, strict=True):
        array = getattr(out, f.array)
        if f.added:
            array[f.index] = max(float(value), 0.0)
            continue
        array[f.index] *= np.exp(value)
        if f.array == "body_mass":
            out.body_inertia[f.index] *= np.exp(value)
    mujoco.mj_setConst(out, mujoco.MjData(out))
    return out


def _misfit(run: Run, plant: MjcfPlant, model: Any) -> Array:
    """Return simulated minus measured channels over their rms."""
    measured = run.measured
    substeps = max(1, round(1.0 / measured.rate / model.opt.timestep))
    controls = np.zeros((len(measured), model.nu))
    for drive in run.drives:
        if drive.actuator is not None:
            controls[:, list(plant.actuators[drive.actuator].controls)] += measured[drive.channel][:, None]
    data = mujoco.MjData(model)
    data.qpos[:] = plant.rest
    first = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, first, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    held = np.repeat(controls[:-1], substeps, axis=0)
    _, sensors = rollout.rollout(model, data, first[None], control=held[None])
    seen = np.vstack([np.zeros((1, model.nsensordata)), sensors[0][substeps - 1 :: substeps]])
    out = []
    for c in run.compared:
        if c.sensor is not None:
            value = seen[:, list(plant.sensors[c.sensor].addresses)].sum(axis=1)
            out.append((value - measured[c.channel]) / np.std(measured[c.channel]))
    return np.concatenate(out)


# ---- sparse regression ----------------------------------------------------------------------------------------------


def _sparse(case: Case) -> dict[str, Any]:
    """Regress accelerations on a library of terms."""
    plant, runs = case.plant, case.runs(("fit",))
    if not isinstance(plant, MjcfPlant) or any(run.law is not None for run in runs):
        return {"note": "not run: for MJCF models without a law in the loop"}
    joints = {plant.model.joint(i).name: i for i in range(plant.model.njnt)}
    seen = {plant.model.sensor(i).name: int(plant.model.sensor_objid[i]) for i in range(plant.model.nsensor)}
    order = {c.channel: seen.get(plant.sensors[c.sensor].name) for c in runs[0].compared if c.sensor is not None}
    if sorted(v for v in order.values() if v is not None) != sorted(joints.values()):
        return {"note": "not run: not every state is measured"}
    blocks = [_states(run, order) for run in runs]
    q, v, a, u = (np.vstack([b[i] for b in blocks]) for i in range(4))
    rows = {f"joint:{name}": np.eye(len(joints))[i] for name, i in joints.items()}
    for i in range(plant.model.ntendon):
        name = f"tendon:{plant.model.tendon(i).name}"
        rows[name] = plant.port_rows([name])[0]
    named: Named | None = sparse_terms(q, v, a, u, rows)
    found = [] if named is None else [{"effect": named.effect, "place": named.place, "share": named.share}]
    return {"named": found, "names": list(TERMS), "note": ""}


def _states(run: Run, order: dict[str, int | None]) -> tuple[Array, Array, Array, Array]:
    """Return smoothed states and inputs of a run, every fifth sample."""
    rate = run.measured.rate
    window = max(5, round(SMOOTH_S * rate) | 1)
    kinds = {c.name: c.kind for c in run.measured.channels}
    q: list[Array] = []
    v: list[Array] = []
    a: list[Array] = []
    for channel in sorted(order, key=lambda c: order[c] or 0):
        y = run.measured[channel]
        derivatives = [signal.savgol_filter(y, window, 3, deriv=d, delta=1 / rate) for d in range(3)]
        if "velocity" in kinds[channel]:
            derivatives = [np.cumsum(derivatives[0]) / rate, derivatives[0], derivatives[1]]
        for out, value in zip((q, v, a), derivatives, strict=True):
            out.append(value)
    u = [signal.savgol_filter(run.measured[d.channel], window, 3) for d in run.drives]
    thin = slice(window, -window, 5)
    return tuple(np.array(x).T[thin] for x in (q, v, a, u))  # type: ignore[return-value]
