"""Bench of a user's MJCF model: sensors, hardware, excitation, law.

The hardware is ideal: a command acts in the sample that it is computed from, and is held for the sample. A recording
therefore holds all that drives the model. Every named actuator is excited by a signal of its own. Band and levels follow
from the model about its rest:

    band: up to REACH times the fastest pole; level: the motion of every joint, H(f) U(f), stays in its room.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from scipy import linalg

from vlab.controllers import Controller
from vlab.controllers.law_file import is_law_file, load_law
from vlab.controllers.user_law import check_code, is_user_law, load_user_law
from vlab.errors import BadExperiment, BadStructure, UnknownName, unknown_name
from vlab.fe.second_order import SecondOrderModel
from vlab.files.assets import asset
from vlab.files.text import one_line
from vlab.hardware import Hardware, load_hardware
from vlab.lab.excitation import EXCITATIONS, Excitation, Release, build_excitation, forces_at
from vlab.lab.given_law import refuse_record
from vlab.plants.base import ONE_WAY, Plant
from vlab.plants.mjcf import MjcfPlant, build_mjcf, build_mjcf_spec
from vlab.signals import Array

if TYPE_CHECKING:
    from vlab.lab.run_folder import RunSettings

SUFFIXES = (".xml", ".mjcf")
"""SUFFIXES: endings of an MJCF file."""
HARDWARE = "digital.toml"
"""HARDWARE: file of the ideal hardware under ``assets/``."""
SHARE = 0.25
"""SHARE [1]: largest motion of a joint relative to its room. The room is the way to the nearest limit of the joint;
without limits 1 rad, or the extent of the model."""
REACH = 2.0
"""REACH [1]: upper end of the band relative to the fastest pole. The response of a mode falls to a third there."""
PER_CYCLE = 8
"""PER_CYCLE [1]: fewest samples of one cycle at the upper end of the band."""
DECADE = 10.0
"""DECADE [1]: smallest ratio of the upper to the lower end of the band."""
TINY = 1e-12
"""TINY [1]: motion over room, or signal, that counts as none."""
QUIET = 1e-3
"""QUIET [1]: spectral lines of a signal relative to its largest, below which their response is left out."""


def is_model_file(name: str) -> bool:
    """Return whether a name means an MJCF file, not a structure."""
    return Path(name).suffix.lower() in SUFFIXES


def bench_plant(name: str) -> MjcfPlant:
    """Build the plant of a user's model.

    A model without sensors gets a position sensor at every named hinge and slide, ``joint:NAME``.

    Parameters
    ----------
    name : str
        MJCF file.

    Returns
    -------
    MjcfPlant
        Plant at rest.

    Raises
    ------
    BadStructure
        The model cannot be built, or has nothing to record or to drive.
    UnknownName
        No such file.
    """
    if not Path(name).is_file():
        raise UnknownName(
            f"there is no model file {one_line(name)!r}; give beam, grid, a structure file or an MJCF file"
        )
    plant, label = build_mjcf(name), one_line(name)
    if not plant.sensors:
        model, spec = plant.model, plant.spec
        joints = [model.joint(i).name for i in range(model.njnt) if int(model.jnt_type[i]) in ONE_WAY]
        for joint in filter(None, joints):
            spec.add_sensor(
                name=f"joint:{joint}",
                type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint,
            )
        plant = build_mjcf_spec(spec, label)
    if not plant.sensors:
        raise BadStructure(f"{label}: the model has no sensor, and no hinge or slide with a name; add a <sensor>")
    if not any(tap.name for tap in plant.actuators):
        raise BadStructure(f"{label}: the model has no actuator with a name to drive it; add an <actuator>")
    return plant


def bench_hardware(settings: "RunSettings", timestep: float) -> Hardware:
    """Return the hardware of a run on a user's model.

    Parameters
    ----------
    settings : RunSettings
        Settings; without a hardware file the hardware is ideal.
    timestep : float
        Step of the model [s]; without a stated rate every step is a sample.

    Returns
    -------
    Hardware
        Hardware at the rate of the run.
    """
    hardware = load_hardware(settings.hardware or asset(HARDWARE), settings.hardware_values)
    if settings.rate_hz is not None:
        return hardware.at_rate(settings.rate_hz)
    return hardware if settings.hardware else hardware.at_rate(1.0 / timestep)


def bench_law(name: str, *, code: Collection[str]) -> Controller:
    """Return the law of a run on a user's model.

    Parameters
    ----------
    name : str
        User's law or law file.
    code : collection of str
        Python files and entry points that the user named.

    Returns
    -------
    Controller
        Law.

    Raises
    ------
    UnknownName
        The name is neither.
    BadController
        The law is refused, or was an object of Python.
    """
    refuse_record(name)
    if is_user_law(name):
        check_code(name, code)
        return load_user_law(name)
    if is_law_file(name):
        return load_law(name)
    raise unknown_name("law", name, ["path/to/law.py:ClassName", "entry:NAME", "controller.toml"], where="own model")


def check_settings(settings: "RunSettings") -> None:
    """Refuse settings that belong to the structures of vlab.

    Parameters
    ----------
    settings : RunSettings
        Settings of a run on a user's model.

    Raises
    ------
    BadExperiment
        A plant, variant, design model or order of powering up is given.
    """
    default = type(settings)(structure=settings.structure)
    for key in ("plant", "variant", "model", "power_up"):
        if getattr(settings, key) != getattr(default, key):
            raise BadExperiment(
                f"{key} = {getattr(settings, key)!r} is for beam, grid and structure files; a model of your own runs as "
                "it is: leave it out"
            )


@dataclass(frozen=True, kw_only=True)
class BenchExcitation:
    """Signals of several actuators, held from sample to sample.

    Parameters
    ----------
    parts : sequence of Excitation
        One signal for each actuator, or one for all.
    scale, offset : (n_actuators,) array
        Factor on each signal, and command about which it moves [unit of the actuator].
    rate : float
        Sample rate [Hz].
    """

    parts: tuple[Excitation, ...]
    scale: Array
    offset: Array
    rate: float

    @property
    def level(self) -> float:
        """Largest level of the signals."""
        return float(max(self.levels))

    @property
    def levels(self) -> Array:
        """Level of every actuator, (n_actuators,)."""
        return np.broadcast_to([part.level for part in self.parts], self.scale.shape) * self.scale

    @property
    def period_s(self) -> float | None:
        """Period [s], or None."""
        return self.parts[0].period_s

    @property
    def facts(self) -> dict[str, Any]:
        """Signal description for the recording."""
        return self.parts[0].facts

    def sample(self, time: Array) -> Array:
        """Return the commands.

        Parameters
        ----------
        time : array
            Times [s].

        Returns
        -------
        array
            Commands in the unit of each actuator, (n_times, n_actuators).
        """
        numbers = np.floor(np.asarray(time, dtype=float) * self.rate + 1e-6).astype(int)
        drawn, back = np.unique(numbers, return_inverse=True)
        width = len(self.scale) // len(self.parts)
        columns = np.hstack([forces_at(part, drawn / self.rate, width) for part in self.parts])
        return np.asarray((self.offset + self.scale * columns)[back])


def bench_excitation(settings: "RunSettings", plant: MjcfPlant, rate: float) -> tuple[Excitation, str]:
    """Return excitation and places of a run on a user's model.

    Parameters
    ----------
    settings : RunSettings
        Settings; what is None follows from the model.
    plant : MjcfPlant
        Plant without effects.
    rate : float
        Sample rate [Hz].

    Returns
    -------
    tuple of (Excitation, str)
        Excitation, and actuators with commas between.

    Raises
    ------
    BadExperiment
        The band leaves the range of the converter, or a setting is impossible.
    UnknownName
        No such actuator or excitation.
    """
    name, _, written = settings.excite.partition(":")
    stated = {part.partition("=")[0].strip() for part in written.split(",")}
    at = settings.at or _places(name, plant)
    index = [plant.actuator_index(place) for place in at.split(",")]
    linear = _linear(plant)
    if name == "release":
        return _release(settings, plant, linear, index, stated), at
    kind = EXCITATIONS.get(name)
    options: dict[str, Any] = {"period_s": settings.period_s, "odd": settings.odd}
    if hasattr(kind, "low_hz"):
        options |= _band(settings, kind, stated, linear, rate)
    else:
        options |= {"low_hz": settings.low_hz, "high_hz": settings.high_hz}
    free = settings.level is None and "level" not in stated
    options["level"] = 1.0 if free else settings.level
    count = 1 if name == "dwell" else len(index)
    parts = tuple(build_excitation(settings.excite, **options, seed=_seed(settings.seed, i)) for i in range(count))
    offset = np.array([_room_of_command(plant, i)[0] for i in index])
    signal = BenchExcitation(parts=parts, scale=np.ones(len(index)), offset=offset, rate=rate)
    forces_at(signal, np.zeros(1), len(index))
    if not free:
        return signal, at
    scale = _levels(signal, plant, linear, index, settings.seconds)
    return replace(signal, scale=scale), at


def _seed(seed: int, number: int) -> int:
    """Return an actuator's seed; the first has that of the run."""
    return seed if number == 0 else int(np.random.default_rng([seed, number]).integers(2**32))


def _places(name: str, plant: Plant) -> str:
    """Return all named actuators for a random signal, else the first one.

    Sines at several actuators would move together, and no recording could tell their actions apart.
    """
    names = [tap.name for tap in plant.actuators if tap.name]
    return ",".join(names if name in ("multisine", "pseudo-random", "burst-random", "hammer") else names[:1])


def _linear(plant: MjcfPlant) -> SecondOrderModel | None:
    try:
        return plant.linearise()
    except BadStructure:  # no equilibrium, or constraints
        return None


def _band(
    settings: "RunSettings", kind: Any, stated: Collection[str], linear: SecondOrderModel | None, rate: float
) -> dict[str, float | None]:
    """Return the stated band, or that up to the fastest pole."""
    if settings.high_hz is not None and settings.high_hz > rate / 2:
        raise BadExperiment(
            f"the band reaches {settings.high_hz:g} Hz; samples at {rate:g} Hz drive and record up to {rate / 2:g} Hz"
        )
    if {"low_hz", "high_hz"} & set(stated) or settings.high_hz is not None:
        return {"low_hz": settings.low_hz, "high_hz": settings.high_hz}
    high = min(kind.high_hz, rate / PER_CYCLE)
    if linear is not None:
        hz = np.abs(_poles(linear)) / (2 * np.pi)
        moving = hz[hz > 1e-6 * hz.max(initial=0.0)]
        high = min(high, REACH * float(moving.max())) if moving.size else high
    low = min(kind.low_hz, high / DECADE) if settings.low_hz is None else settings.low_hz
    return {"low_hz": float(f"{low:.2g}"), "high_hz": float(f"{high:.2g}")}


def _poles(linear: SecondOrderModel) -> Array:
    n = linear.n
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(linear.M, np.hstack([linear.K, linear.C]))]])
    return np.asarray(linalg.eigvals(A))


def _room_of_command(plant: Plant, i: int) -> tuple[float, float]:
    """Return the command about which a signal moves, and its largest amplitude."""
    model, control = plant.model, plant.actuators[i].controls[0]
    if not model.actuator_ctrllimited[control]:
        return 0.0, np.inf
    low, high = model.actuator_ctrlrange[control]
    middle = 0.0 if low < 0.0 < high else float(low + high) / 2
    return middle, float(min(high - middle, middle - low))


def _rooms(plant: MjcfPlant) -> Array:
    """Return the room of every degree of freedom, (nv,) [m or rad]."""
    model = plant.model
    out = np.full(model.nv, float(model.stat.extent))
    for i in range(model.njnt):
        dof, kind = int(model.jnt_dofadr[i]), int(model.jnt_type[i])
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            out[dof + 3 : dof + 6] = 1.0
        elif kind == mujoco.mjtJoint.mjJNT_BALL:
            out[dof : dof + 3] = 1.0
        elif model.jnt_limited[i]:
            low, high = model.jnt_range[i]
            at = plant.rest[int(model.jnt_qposadr[i])]
            nearest = min(high - at, at - low)
            out[dof] = nearest if nearest > 0 else (high - low) / 2
        elif kind == mujoco.mjtJoint.mjJNT_HINGE:
            out[dof] = 1.0
    return SHARE * out


def _levels(
    signal: BenchExcitation, plant: MjcfPlant, linear: SecondOrderModel | None, index: Sequence[int], seconds: float
) -> Array:
    """Return the level of each actuator with a signal of unit level.

    Each actuator alone moves some joint to the end of its room; the forces of a dwell keep their ratios. A common factor
    then keeps the motion under all of them in the rooms, and the commands in their ranges.
    """
    samples = np.arange(max(2, round(seconds * signal.rate))) / signal.rate
    unit = replace(signal, offset=np.zeros(len(index))).sample(samples)
    limit = np.array([_room_of_command(plant, i)[1] for i in index])
    largest = np.maximum(np.abs(unit).max(axis=0), TINY)
    if linear is None:  # nothing is known of the motion: half of each range
        level = np.where(np.isfinite(limit), 0.5 * limit / largest, 1.0)
    else:
        motion = _RelativeMotion(unit, plant, linear, index, signal.rate)
        level = np.ones(len(index))
        if len(signal.parts) == len(index):
            level = 1 / np.maximum(motion.peaks(np.eye(len(index))), TINY)
        level = level / max(float(motion.peaks(level[:, None])[0]), TINY)
    level = np.minimum(level, limit / largest)
    return np.array([_two_digits(value) for value in level])


def _two_digits(value: float) -> float:
    """Return a positive number rounded down to two digits."""
    step = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.floor(value / step * (1 + TINY)) * step:.6g}")


class _RelativeMotion:
    """Linear motion of every degree of freedom over its room."""

    def __init__(
        self, unit: Array, plant: MjcfPlant, linear: SecondOrderModel, index: Sequence[int], rate: float
    ) -> None:
        self.samples = len(unit)
        spectrum, omega = np.fft.rfft(unit, axis=0), 2 * np.pi * np.fft.rfftfreq(self.samples, 1 / rate)
        size = np.abs(spectrum).max(axis=1)
        self.lines = np.flatnonzero((size > QUIET * size.max()) & (omega > 0))
        forces, room = plant.actuator_forces()[:, list(index)], _rooms(plant)
        self.response = np.zeros((len(self.lines), linear.n, len(index)), dtype=complex)
        for k, line in enumerate(self.lines):
            impedance = linear.K - omega[line] ** 2 * linear.M + 1j * omega[line] * linear.C
            self.response[k] = _solved(impedance, forces * spectrum[line]) / room[:, None]

    def peaks(self, levels: Array) -> Array:
        """Return the largest motion (n_columns,) of any degree of freedom."""
        out = np.zeros(levels.shape[1])
        for dof in range(self.response.shape[1]):
            whole = np.zeros((self.samples // 2 + 1, levels.shape[1]), dtype=complex)
            whole[self.lines] = self.response[:, dof] @ levels
            out = np.maximum(out, np.abs(np.fft.irfft(whole, self.samples, axis=0)).max(axis=0))
        return out


def _solved(impedance: Array, forces: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(impedance, forces))
    except np.linalg.LinAlgError:  # an undamped mode at a line
        return np.asarray(np.linalg.pinv(impedance) @ forces)


def _release(
    settings: "RunSettings",
    plant: MjcfPlant,
    linear: SecondOrderModel | None,
    index: Sequence[int],
    stated: Collection[str],
) -> Excitation:
    """Return a release from a deflection that stays in the rooms."""
    if linear is None or len(index) > 1:
        why = "the model has no linearisation" if linear is None else "several actuators were named"
        raise BadExperiment(f"a release needs one actuator and a model at rest between springs: {why}")
    release = build_excitation(settings.excite, level=settings.level)
    if settings.level is not None or "level" in stated:
        return Release(level=release.level)
    stiffness, force = linear.K, plant.actuator_forces()[:, index[0]]
    shape = np.linalg.lstsq(stiffness, force, rcond=1e-9)[0]
    if np.abs(stiffness @ shape - force).max() > 1e-6 * np.abs(force).max():
        raise BadExperiment(
            f"no spring holds against {plant.actuators[index[0]].name!r}: a static force moves the model away; take "
            "another excitation"
        )
    travel = float((np.abs(shape) / _rooms(plant)).max())
    return Release(level=_two_digits(1 / travel))


def bench_words(excitation: Excitation, plant: Plant, at: str) -> str:
    """Return what excites a user's model, in one line.

    Parameters
    ----------
    excitation : Excitation
        Excitation of `bench_excitation`.
    plant : Plant
        Plant.
    at : str
        Actuators with commas between.

    Returns
    -------
    str
        Levels and band.
    """
    taps = [plant.actuators[plant.actuator_index(place)] for place in at.split(",")]
    if not isinstance(excitation, BenchExcitation):
        return f"released from {excitation.level:.3g} {taps[0].unit} at {taps[0].name}"
    each = ", ".join(f"{tap.name} {level:.3g} {tap.unit}" for tap, level in zip(taps, excitation.levels, strict=True))
    low, high = getattr(excitation.parts[0], "low_hz", None), getattr(excitation.parts[0], "high_hz", None)
    return f"excited: {each}" + ("" if low is None else f"; {low:g} to {high:g} Hz")
