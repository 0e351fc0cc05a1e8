"""Plant from a user's MJCF: guarded loading, taps and ports.

Named actuators and sensors become taps; joints, tendons and sites become ports. The file is untrusted.
`vlab.plants.mjcf_guard` checks the file first, and an error of MuJoCo becomes one line. MuJoCo itself compiles NaN with
a warning only.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from vlab.errors import BadStructure
from vlab.fe.second_order import SecondOrderModel
from vlab.files.containment import NotInside, path_inside
from vlab.files.text import one_line
from vlab.plants.base import ActuatorTap, Plant, Port, SensorTap
from vlab.plants.computable import check_numbers
from vlab.plants.equilibrium import settle
from vlab.plants.joint_coupling import couple_by_tendons
from vlab.plants.linearise import linearise
from vlab.plants.mjcf_guard import check_file, check_text
from vlab.signals import Array

AXES = ("x", "y", "z")
"""Names of the axes."""
_POSITION, _RATE, _FORCE = 0, 1, 2
_LINEAR = (("displacement", "m"), ("velocity", "m/s"), ("force", "N"))
_ANGULAR = (("angle", "rad"), ("angular-velocity", "rad/s"), ("moment", "N m"))
_OTHER = ("other", "")
_FIXED = {
    "FRAMEPOS": _LINEAR[_POSITION],
    "FRAMELINVEL": _LINEAR[_RATE],
    "FRAMELINACC": ("acceleration", "m/s^2"),
    "FRAMEANGVEL": _ANGULAR[_RATE],
    "FRAMEANGACC": ("angular-acceleration", "rad/s^2"),
    "SUBTREECOM": _LINEAR[_POSITION],
    "SUBTREELINVEL": _LINEAR[_RATE],
    "VELOCIMETER": _LINEAR[_RATE],
    "ACCELEROMETER": ("acceleration", "m/s^2"),
    "GYRO": _ANGULAR[_RATE],
    "BALLANGVEL": _ANGULAR[_RATE],
    "FORCE": _LINEAR[_FORCE],
    "TORQUE": _ANGULAR[_FORCE],
    "TOUCH": _LINEAR[_FORCE],
    "RANGEFINDER": _LINEAR[_POSITION],
}
_BY_OBJECT = {"POS": _POSITION, "VEL": _RATE, "FRC": _FORCE, "ACTFRC": _FORCE}


@dataclass(frozen=True, kw_only=True, eq=False)
class MjcfPlant(Plant):
    """Plant of a user's MJCF model.

    Parameters
    ----------
    rest : (nq,) array
        Configuration of `new_data` and of the linearisation; an equilibrium unless `notes` states an exception. The
        joints' angles count from ``qpos0``, which may differ.
    notes : sequence of str
        Remarks on loading: settling, free motion, unnamed parts.
    """

    rest: Array
    notes: tuple[str, ...] = ()

    def new_data(self) -> Any:
        """Return fresh `MjData` at the rest configuration."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.rest
        mujoco.mj_forward(self.model, data)
        return data

    def linearise(self) -> SecondOrderModel:
        """Return M, C and K at rest, see `vlab.plants.linearise`."""
        return self._with_added(linearise(self.model, self.rest))

    def own_stiffness(self, name: str) -> float:
        """See `Plant`: the present spring of a joint or tendon."""
        kind, _, element = name.partition(":")
        if kind not in ("joint", "tendon") or name not in self.ports:
            return 0.0
        array = self.model.jnt_stiffness if kind == "joint" else self.model.tendon_stiffness
        return float(array[getattr(self.model, kind)(element).id])


def build_mjcf(source: str | Path, *, folder: Path | str | None = None) -> MjcfPlant:
    """Build the plant of a user's MJCF.

    Parameters
    ----------
    source : str or path
        The file, or XML text that starts with ``<`` and refers to no files.
    folder : path, optional
        Folder that must contain the file; `source` is then relative.

    Returns
    -------
    MjcfPlant
        Plant at rest, with notes.

    Raises
    ------
    BadStructure
        The file is missing, not MJCF, refers outside its folder, has nonfinite numbers, or does not compile.
    """
    if isinstance(source, str) and source.lstrip().startswith("<"):
        label = "MJCF text"
        check_text(source, label)
        spec = _compiled(lambda: mujoco.MjSpec.from_string(source), label)
    else:
        label = one_line(source)
        try:
            path = Path(source).resolve() if folder is None else path_inside(source, folder, called=one_line(folder))
        except NotInside as error:
            raise BadStructure(f"{label}: the model {error}; copy it into that folder") from error
        check_file(path, label)
        spec = _compiled(lambda: mujoco.MjSpec.from_file(str(path)), label)
    return build_mjcf_spec(spec, label)


def build_mjcf_spec(spec: Any, label: str) -> MjcfPlant:
    """Build the plant of a MuJoCo spec.

    The spec is trusted: its files are read wherever they lie.

    Parameters
    ----------
    spec : MjSpec
        Model; the plant keeps the object.
    label : str
        Name of the model in messages.

    Returns
    -------
    MjcfPlant
        Plant at rest, with notes.

    Raises
    ------
    BadStructure
        The model has nonfinite numbers, cannot move, or does not compile.
    """
    step = spec.option.timestep
    if not (np.isfinite(step) and 0 < step <= 1):
        raise BadStructure(f"{label}: the timestep is {step} s; accepted: above 0 up to 1 s")
    coupled = _compiled(lambda: couple_by_tendons(spec), label)
    model = _compiled(spec.compile, label)
    _check_finite(model, label)
    if model.nv == 0:
        raise BadStructure(f"{label}: nothing in the model can move; it needs at least one joint")
    wide = [i for i in range(model.nactuator) if model.actuator_ctrlnum[i] != 1]
    if wide:
        name = model.actuator(wide[0]).name or f"actuator {wide[0]}"
        raise BadStructure(
            f"{label}: {name!r} takes {model.actuator_ctrlnum[wide[0]]} inputs; only actuators of one input can be driven"
        )
    try:
        rest, notes = settle(model)
    except BadStructure as error:
        raise BadStructure(f"{label}: {error}") from error
    sensors, unread = _sensor_taps(model)
    unnamed = sum(not model.actuator(i).name for i in range(model.nu))
    if unnamed:
        notes.append(f"{unnamed} actuators have no name and cannot be used")
    return MjcfPlant(
        name="mjcf",
        model=model,
        spec=spec,
        actuators=tuple(_actuator_tap(model, i) for i in range(model.nu)),
        sensors=tuple(sensors),
        ports=_ports(model),
        rest=rest,
        notes=(*coupled, *notes, *unread),
    )


# ---- loading -------------------------------------------------------------------------------------------------------


def _compiled(make: Callable[[], Any], label: str) -> Any:
    try:
        return make()
    except Exception as error:  # MuJoCo raises ValueError, FatalError and a few more with one meaning
        raise BadStructure(f"{label}: MuJoCo refuses the model: {one_line(error)}") from error


def _check_finite(model: Any, label: str) -> None:
    for holder, prefix in ((model, ""), (model.opt, "option ")):
        for name in dir(holder):
            if name.startswith("_"):
                continue
            value = getattr(holder, name)
            is_number = isinstance(value, float | np.ndarray) and np.asarray(value).dtype.kind == "f"
            if is_number:
                check_numbers(value, f"{label}: {prefix}{name} of the compiled model")


# ---- taps and ports ------------------------------------------------------------------------------------------------


def _joint_is_angular(model: Any, joint: int) -> bool | None:
    kinds = {mujoco.mjtJoint.mjJNT_HINGE: True, mujoco.mjtJoint.mjJNT_SLIDE: False}
    return kinds.get(int(model.jnt_type[joint]))


def _tendon_is_angular(model: Any, tendon: int) -> bool | None:
    first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    wraps = range(first, first + count)
    if any(model.wrap_type[i] != mujoco.mjtWrap.mjWRAP_JOINT for i in wraps):
        return False
    kinds = {_joint_is_angular(model, int(model.wrap_objid[i])) for i in wraps}
    return kinds.pop() if len(kinds) == 1 else None


def _transmission(model: Any, actuator: int) -> tuple[bool | None, bool]:
    """Return the type of an actuator's transmission.

    The first value is whether the actuator turns (None: unknown), the second whether the gear is one.
    """
    gear = model.actuator_gear[actuator]
    used = np.flatnonzero(gear)
    is_unit = used.size == 1 and abs(gear[used[0]]) == 1.0
    kind, target = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
    if kind in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
        angular = _joint_is_angular(model, target)
        if angular is None and used.size:  # a ball joint turns; a free joint moves along its first three axes
            is_ball = model.jnt_type[target] == mujoco.mjtJoint.mjJNT_BALL
            angular = bool(is_ball or used[0] >= 3)
        return angular, is_unit
    if kind == mujoco.mjtTrn.mjTRN_TENDON:
        return _tendon_is_angular(model, target), is_unit
    if kind == mujoco.mjtTrn.mjTRN_SITE and used.size:
        return bool(used[0] >= 3), is_unit
    return None, False


def _actuator_tap(model: Any, i: int) -> ActuatorTap:
    name = model.actuator(i).name
    angular, is_unit = _transmission(model, i)
    is_plain = (
        model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_gainprm[i, 0] == 1.0
        and model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE
        and model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_NONE
    )
    if is_plain and is_unit and angular is not None:
        kind, unit = (_ANGULAR if angular else _LINEAR)[_FORCE]
        return ActuatorTap(name=name, at=name, kind=kind, unit=unit, controls=(i,))
    return ActuatorTap(name=name, at=name, kind="command", unit="command", controls=(i,))


def _sensor_kind(model: Any, i: int) -> tuple[str, str]:
    name = mujoco.mjtSensor(int(model.sensor_type[i])).name.removeprefix("mjSENS_")
    if name in _FIXED:
        return _FIXED[name]
    target = int(model.sensor_objid[i])
    for prefix in ("JOINT", "TENDON", "ACTUATOR"):
        quantity = _BY_OBJECT.get(name.removeprefix(prefix)) if name.startswith(prefix) else None
        if quantity is None:
            continue
        if prefix == "JOINT":
            angular = _joint_is_angular(model, target)
        elif prefix == "TENDON":
            angular = _tendon_is_angular(model, target)
        else:
            angular, is_unit = _transmission(model, target)
            angular = angular if is_unit else None
        return _OTHER if angular is None else (_ANGULAR if angular else _LINEAR)[quantity]
    return _OTHER


def _sensor_taps(model: Any) -> tuple[list[SensorTap], list[str]]:
    """Return taps of scalar and vector sensors, and notes."""
    taps, notes = [], []
    for i in range(model.nsensor):
        name, size, address = model.sensor(i).name, int(model.sensor_dim[i]), int(model.sensor_adr[i])
        if not name:
            notes.append(f"sensor {i} has no name and cannot be used")
        elif size not in (1, 3):
            notes.append(f"sensor {name!r} has {size} values and cannot be used")
        else:
            kind, unit = _sensor_kind(model, i)
            for k in range(size):
                label = name if size == 1 else f"{name}.{AXES[k]}"
                taps.append(SensorTap(name=label, at=label, kind=kind, unit=unit, addresses=(address + k,)))
    return taps, notes


def _ports(model: Any) -> dict[str, Port]:
    ports = [_joint_port(model, i) for i in range(model.njnt)]
    ports += [_tendon_port(model, i) for i in range(model.ntendon)]
    ports += [_site_port(model, i, axis) for i in range(model.nsite) for axis in range(3)]
    return {port.name: port for port in ports if port is not None}


def _joint_port(model: Any, i: int) -> Port | None:
    name, angular, address = model.joint(i).name, _joint_is_angular(model, i), int(model.jnt_qposadr[i])
    if not name or angular is None:
        return None
    unit = np.zeros(model.nv)
    unit[model.jnt_dofadr[i]] = 1.0

    def row(data: Any) -> Array:
        return unit.copy()

    def position(data: Any) -> float:
        return float(data.qpos[address])

    return Port(name=f"joint:{name}", unit="rad" if angular else "m", row=row, position=position, is_constant=True)


def _tendon_port(model: Any, i: int) -> Port | None:
    name = model.tendon(i).name
    if not name:
        return None

    def row(data: Any) -> Array:
        first, count = int(model.ten_J_rowadr[i]), int(model.ten_J_rownnz[i])
        out = np.zeros(model.nv)
        out[model.ten_J_colind[first : first + count]] = data.ten_J[first : first + count]
        return out

    def position(data: Any) -> float:
        return float(data.ten_length[i])

    first = int(model.tendon_adr[i])
    wrapped = model.wrap_type[first : first + int(model.tendon_num[i])]
    return Port(
        name=f"tendon:{name}",
        unit="rad" if _tendon_is_angular(model, i) else "m",
        row=row,
        position=position,
        is_constant=bool(np.all(wrapped == int(mujoco.mjtWrap.mjWRAP_JOINT))),  # a fixed tendon
    )


def _site_port(model: Any, i: int, axis: int) -> Port | None:
    name = model.site(i).name
    if not name:
        return None

    def row(data: Any) -> Array:
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, i)
        return jacobian[axis]

    def position(data: Any) -> float:
        return float(data.site_xpos[i, axis])

    return Port(name=f"site:{name}.{AXES[axis]}", unit="m", row=row, position=position)
