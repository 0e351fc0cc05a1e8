"""Choice and limits of the model classes."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.data.runs import Signals
from vlab.diagnose.predictors.kalman import smoothed_states
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.predictors.own_nonlinearity import with_own_nonlinearity
from vlab.diagnose.predictors.trajectory_data import Motion
from vlab.diagnose.problem import Problem, model_kind_of
from vlab.diagnose.settings import SCOPE
from vlab.errors import BadCase, BadStructure
from vlab.fe.second_order import SecondOrderModel
from vlab.plants.base import Plant
from vlab.plants.linearise import check_free
from vlab.signals import Array


def linear_problem(case: Case) -> Problem | None:
    """Prepare a case where the model is linear enough.

    Parameters
    ----------
    case : Case
        Case.

    Returns
    -------
    Problem or None
        Inverse problem; None where the recorded motion leaves the linear range.

    Raises
    ------
    BadCase
        No recording to fit, or a contradiction to the model. Or the model is unstable, and recordings at rest lack any
        stabilising input.
    """
    plant = case.plant
    if not case.recordings(("fit",)):
        return prepare(case, ("fit",))
    if model_kind_of(case).stays_linear:
        problem, departure = prepare(case, ("fit",)), _departure(plant, plant.linearise(), *_large(plant))
        return problem if departure < SCOPE.exact else with_own_nonlinearity(problem)
    if np.any(plant.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE) and plant.model.nv > SCOPE.most_coordinates:
        return prepare(case, ("fit",))
    if plant.model.na:
        return None  # the reduced model has no actuator states
    try:
        linear = plant.linearise()
    except BadStructure:
        return None  # without equilibrium there is no linearisation
    problem = prepare(case, ("fit",))
    if _departure(plant, linear, *_large(plant)) < SCOPE.exact:
        _check_stable(case, problem, linear)
        return problem
    try:
        q, v = (part @ problem.reduced_model.shapes.T for part in _states(problem))
    except np.linalg.LinAlgError:  # a filter fails on a fast-growing linear model
        return None
    if _departure(plant, linear, q, v) > SCOPE.far:
        return None
    _check_stable(case, problem, linear)
    return with_own_nonlinearity(problem)


def is_linear(plant: Plant) -> bool:
    """Return whether a model is linear at any motion.

    Parameters
    ----------
    plant : Plant
        Model.

    Returns
    -------
    bool
        Within the tolerance of the linear class, and without actuator states.
    """
    if plant.model.na:
        return False
    try:
        linear = plant.linearise()
    except BadStructure:
        return False
    return _departure(plant, linear, *_large(plant)) < SCOPE.exact


def _large(plant: Plant) -> tuple[Array, Array]:
    """Return reproducible large displacements and velocities."""
    rng = np.random.default_rng(0)
    shape = (8, plant.model.nv)
    return SCOPE.large * rng.uniform(-1, 1, shape), SCOPE.large * rng.uniform(-1, 1, shape)


def _states(problem: Problem) -> tuple[Array, Array]:
    """Return smoothed modal displacements and velocities of the largest recording."""
    reduced_model = problem.reduced_model
    size = [float(np.max(np.abs(s.y) / np.max([t.scale for t in problem.signals], axis=0))) for s in problem.signals]
    run = _loudest(problem.signals[int(np.argmax(size))])
    (x,), _ = smoothed_states(reduced_model, [run])
    return x[:, : reduced_model.m], x[:, reduced_model.m :]


def _loudest(run: Signals) -> Signals:
    """Return the part of a run around its largest motion."""
    peak = int(np.argmax(np.max(np.abs(run.y) / run.scale, axis=1)))
    part = slice(max(peak - SCOPE.part // 4, 0), peak + 3 * SCOPE.part // 4)
    return replace(run, u=run.u[part], load=run.load[part], y=run.y[part], valid=None)


def _departure(plant: Plant, linear: SecondOrderModel, q: Array, v: Array) -> float:
    """Return the linear model's relative acceleration error.

    The norm is the work of the inertia forces, so coordinates of any unit add.
    """
    data, rest = mujoco.MjData(plant.model), plant.new_data()
    off, size = 0.0, 0.0
    for k in np.unique(np.linspace(0, len(q) - 1, SCOPE.looks).astype(int)):
        data.qpos[:] = rest.qpos
        mujoco.mj_integratePos(plant.model, data.qpos, q[k], 1.0)
        data.qvel[:] = v[k]
        mujoco.mj_forward(plant.model, data)
        expected = -np.linalg.solve(linear.M, linear.K @ q[k] + linear.C @ v[k])
        error = data.qacc - expected
        off += float(error @ linear.M @ error)
        size += float(expected @ linear.M @ expected)
        size += SCOPE.slowest**4 * float(q[k] @ linear.M @ q[k]) + SCOPE.slowest**2 * float(v[k] @ linear.M @ v[k])
    return float(np.sqrt(off / size)) if size > 0 else (0.0 if off == 0 else np.inf)


def _check_stable(case: Case, problem: Problem, linear: SecondOrderModel) -> None:
    omega = linear.eigen[0]
    growth = np.where(omega < 0, -omega, -np.nan_to_num(linear.zeta) * omega)  # buckling, or negative damping
    if not np.any(growth > 0):
        return
    rate = float(np.max(growth))
    for run, signals in zip(problem.runs, problem.signals, strict=True):
        if run.law is None and not run.drives and rate * len(signals) * signals.h > SCOPE.grown:
            raise BadCase(
                f"{case.path}: {run.name} stays near an equilibrium that is unstable in the model (it grows by e in "
                f"{1 / rate:.3g} s), and no input of it is recorded; record the commands that hold it, or the law in the loop"
            )


# ---- limits of the trajectory-linearised class -----------------------------------------------------------------------


def check_scope(case: Case) -> None:
    """Refuse models outside the trajectory-linearised class.

    Parameters
    ----------
    case : Case
        Case.

    Raises
    ------
    BadCase
        Free flight, muscles, or too many coordinates.
    """
    model, label = case.plant.model, f"{case.path}: the recorded motion is far from linear, and"
    check_free(model)
    free = [
        model.joint(i).name or f"joint {i}"
        for i in range(model.njnt)
        if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE
    ]
    if free:
        raise BadCase(
            f"{label} the free joint {free[0]!r} lets a body fly: free flight cannot be diagnosed; hold it by joints"
        )
    muscles = (int(mujoco.mjtDyn.mjDYN_MUSCLE), int(mujoco.mjtGain.mjGAIN_MUSCLE))
    for i in range(model.nu):
        if model.actuator_dyntype[i] == muscles[0] or model.actuator_gaintype[i] == muscles[1]:
            name = model.actuator(i).name or f"actuator {i}"
            raise BadCase(
                f"{label} {name!r} is a muscle, whose force depends on its past; give its force as an input instead"
            )
    if model.nv > SCOPE.most_coordinates:
        raise BadCase(
            f"{label} the model has {model.nv} degrees of freedom; at most {SCOPE.most_coordinates} are searched along the motion"
        )


def check_contacts(case: Case, motions: Sequence[Motion]) -> None:
    """Refuse motion with closed contacts, whose forces jump between samples.

    Parameters
    ----------
    case : Case
        Case.
    motions : sequence of Motion
        Recorded motions.

    Raises
    ------
    BadCase
        Contacts are closed along the motion.
    """
    model, data = case.plant.model, mujoco.MjData(case.plant.model)
    pairs: dict[tuple[int, int], int] = {}
    looks = 0
    for motion in motions:
        for k in range(0, len(motion.q), max(1, len(motion.q) // SCOPE.looks)):
            data.qpos[:] = motion.q[k]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            looks += 1
            for c in data.contact[: data.ncon]:
                if c.dist < 0:
                    geoms = (min(c.geom1, c.geom2), max(c.geom1, c.geom2))
                    pairs[geoms] = pairs.get(geoms, 0) + 1
    if pairs:
        (a, b), count = max(pairs.items(), key=lambda item: item[1])
        raise BadCase(
            f"{case.path}: {_geom(model, a)} and {_geom(model, b)} touch in {100 * min(count / looks, 1.0):.0f} % of the "
            f"recorded motion; contact-rich motion cannot be diagnosed: {_remedy(model, a, b)}, or cut the recording before "
            "the first contact (stop_s)"
        )


def _geom(model: Any, i: int) -> str:
    name, of = model.geom(i).name, int(model.geom_bodyid[i])
    body = f"body {model.body(of).name!r}" if model.body(of).name else f"body number {of}"
    return f"geom {name!r} of {body}" if name else f"a geom of {body}"


def _remedy(model: Any, a: int, b: int) -> str:
    """Return the edit of an MJCF file that removes the contact of two geoms."""
    condition = "if they never touch in reality"
    if any({int(one), int(other)} == {a, b} for one, other in zip(model.pair_geom1, model.pair_geom2, strict=True)):
        return f"remove their <pair> from <contact> of the model {condition}"
    names = [model.body(model.geom_bodyid[i]).name for i in (a, b)]
    named = "" if all(names) else "name both bodies and "
    one, other = (name or "NAME" for name in names)
    return f'{named}add <contact><exclude body1="{one}" body2="{other}"/></contact> to the model {condition}'
