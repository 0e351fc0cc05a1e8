"""Split of a model's effects into MuJoCo elements and laws.

Numbers of joints, tendons and bodies, springs beside a joint, and numbers of actuators are MuJoCo's own. MuJoCo applies
an actuator's elements in a fixed order: delay, range, filter, gain, bias. Effects on one actuator act in the order of
their list. The last effects of the list become elements as long as both orders agree; all earlier ones are laws.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco

from vlab.physics.attach import Attached, actuators_at, attach
from vlab.physics.native import Spring, add_springs, numbers, springs
from vlab.plants.mjcf import MjcfPlant
from vlab.plants.numbers import numbers_into_spec

TAU_SAMPLES = 1.0
"""TAU_SAMPLES [1]: least delay in integration steps that MuJoCo can hold; its ring buffer is read before it is
written."""


@dataclass(frozen=True, kw_only=True)
class NativeParts:
    """A model with its native effects, and the laws that are left.

    Parameters
    ----------
    spec : mujoco.MjSpec
        Model with calibrated numbers and native effects.
    native : dict of str to str
        Native element by effect and place.
    left : list of Attached
        Effects that stay laws, in order.
    plant : MjcfPlant
        Plant with numbers in its model and laws as running physics.
    reasons : dict of str to str
        Why an effect stays a law, by effect and place.
    """

    spec: Any
    native: dict[str, str]
    left: list[Attached]
    plant: MjcfPlant
    reasons: dict[str, str] = field(default_factory=dict)


def native_parts(
    plant: MjcfPlant, effects: Sequence[Attached], *, channels: Sequence[str] = (), with_elements: bool = True
) -> NativeParts:
    """Split effects into MuJoCo elements and laws.

    Parameters
    ----------
    plant : MjcfPlant
        Plant with calibrated numbers, without the effects.
    effects : sequence of Attached
        Effects in the order in which they act.
    channels : sequence of str
        Channel names of the case; sensor effects may name them.
    with_elements : bool
        Whether effects may become new elements or new states, beside numbers.

    Returns
    -------
    NativeParts
        Model and laws.
    """
    native: dict[str, str] = {}
    reasons: dict[str, str] = {}
    extra: list[tuple[Attached, tuple[Spring, ...]]] = []
    left, as_numbers = [], []
    into = _into_actuators(plant, effects, with_elements)
    for one in effects:
        if one.effect.kind == "actuator":
            if one.label in into.native:
                native[one.label] = into.native[one.label]
            else:
                left.append(one)
                reasons[one.label] = into.reasons[one.label]
            continue
        if one.effect.kind == "sensor":
            left.append(one)
            reasons[one.label] = "it changes readings, not the motion"
            continue
        own = numbers(plant, one.effect, one.place, one.values)
        beside = springs(plant, one.effect, one.place, one.values) if with_elements else None
        if own is not None:
            as_numbers.append(one)
            native[one.label] = ", ".join(dict.fromkeys(what for what, _, _ in own))
        elif beside is not None:
            extra.append((one, beside))
            native[one.label] = "a fixed tendon" if len(beside) == 1 else f"{len(beside)} fixed tendons"
        else:
            left.append(one)
            reasons[one.label] = "MuJoCo has no such element"
    running = attach(plant, [*as_numbers, *left], channels=channels)
    assert isinstance(running, MjcfPlant)
    at_work = {a.effect.name for a in running.physics}
    for one in [one for one in left if one.effect.name not in at_work]:
        left.remove(one)
        native[one.label] = "numbers of the actuator" if "servo" in one.effect.needs else "numbers of the model"
        del reasons[one.label]
    spec = plant.spec.copy()
    numbers_into_spec(spec, running.model)
    for change in into.changes:
        change(spec)
    for one, beside in extra:
        add_springs(spec, plant, one.place, one.label, beside)
    return NativeParts(spec=spec, native=native, left=left, plant=running, reasons=reasons)


@dataclass(kw_only=True)
class _IntoActuators:
    """Effects that become parts of actuators."""

    native: dict[str, str] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    changes: list[Callable[[Any], None]] = field(default_factory=list)


ORDER = ("actuator-delay", "actuator-clipping", "actuator-lag", "actuator-gain", "actuator-offset")
"""ORDER: effects that an actuator can take, in MuJoCo's order."""
CALLED = {
    "actuator-delay": "delay",
    "actuator-clipping": "ctrlrange",
    "actuator-lag": "dyntype, dynprm",
    "actuator-gain": "gainprm",
    "actuator-offset": "biasprm",
}
NEW_STATES = ("actuator-delay", "actuator-lag")
"""NEW_STATES: effects that add states to the model."""


def _into_actuators(plant: MjcfPlant, effects: Sequence[Attached], with_elements: bool) -> _IntoActuators:
    """Return the actuator effects that MuJoCo takes over.

    An effect on all actuators is taken over by all or by none.
    """
    out = _IntoActuators()
    every = [one for one in effects if one.effect.kind == "actuator"]
    later: dict[int, int] = {}
    """By actuator, the place in `ORDER` of the following effect; -1 after a law."""
    for one in reversed(every):
        indices = actuators_at(plant, one.place)
        at = ORDER.index(one.effect.name) if one.effect.name in ORDER else -1
        reason = "MuJoCo has no such element" if at < 0 else ""
        if one.effect.name in NEW_STATES and not with_elements:
            reason = "the model takes no new states"
        if any(later.get(i, len(ORDER)) <= at for i in indices):
            reason = reason or "an effect that follows it must act before"
        for i in indices:
            reason = reason or _refused(plant.model, plant.timestep, i, one)
        for i in indices:
            later[i] = -1 if reason else at
        if reason:
            out.reasons[one.label] = reason
            continue
        out.native[one.label] = CALLED[one.effect.name]
        out.changes += [_changed(i, one) for i in indices]
    return out


def _refused(model: Any, h: float, i: int, one: Attached) -> str:
    """Return why an actuator cannot take an effect; "" if it can."""
    name = one.effect.name
    is_fixed = model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_FIXED
    is_affine = int(model.actuator_biastype[i]) in (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
    if name == "actuator-delay":
        if model.actuator_delay[i] > 0 or model.actuator_history[i].any():
            return "the actuator has a delay of its own"
        return "" if one.values["delay"] >= TAU_SAMPLES * h else "the delay is shorter than an integration step"
    if model.actuator_dyntype[i] != mujoco.mjtDyn.mjDYN_NONE:
        return "the actuator has dynamics of its own"
    if model.actuator_ctrllimited[i]:
        return "the actuator has a control range of its own"
    if name != "actuator-clipping" and not (is_fixed and is_affine):
        return "the actuator's force is not linear in its control"
    return ""


def _changed(i: int, one: Attached) -> Callable[[Any], None]:
    """Return a spec's change that puts an effect into an actuator.

    Changes are made from the last effect to the first, so an offset sees the gain without the effects before it.
    """
    values, name = one.values, one.effect.name

    def change(spec: Any) -> None:
        actuator = spec.actuators[i]
        if name == "actuator-delay":
            actuator.delay, actuator.interp = values["delay"], mujoco_linear()
            actuator.nsample = delay_samples(values["delay"], float(spec.option.timestep))
        elif name == "actuator-clipping":
            actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
            actuator.ctrlrange = [-values["limit"], values["limit"]]
        elif name == "actuator-lag":
            actuator.dyntype, actuator.actearly = mujoco.mjtDyn.mjDYN_FILTEREXACT, 1
            actuator.dynprm[0] = values["time_constant"]
        elif name == "actuator-gain":
            actuator.gainprm[0] *= 1.0 + values["gain"]
        else:
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.biasprm[0] += actuator.gainprm[0] * values["offset"]

    return change


def delay_samples(delay: float, h: float) -> int:
    """Return the samples of a delay's ring buffer.

    Parameters
    ----------
    delay : float
        Delay [s].
    h : float
        Integration step [s].

    Returns
    -------
    int
        Samples, so that the buffer reaches back to the delayed time.
    """
    return int(-(-delay // h)) + 1


def mujoco_linear() -> int:
    """Return MuJoCo's number of linear interpolation in a ring buffer."""
    return 1
