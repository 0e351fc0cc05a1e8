"""Concealed case of an arm on position servos: arm, hidden effects, log, truth."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from vlab.errors import BadExperiment, Diverged
from vlab.proof.generator import statement
from vlab.proof.generator.arm_commands import MOTIONS, motion
from vlab.proof.generator.arm_models import ARMS, FLOOR, Arm, benign_of, built, mjcf_of
from vlab.proof.generator.arm_setup import ServoArm, direct, scales_of
from vlab.proof.generator.arm_sizing import ArmRefit
from vlab.proof.generator.bench import Benign, Nominal
from vlab.proof.generator.concealed import CLOSE, DRAWS, LARGEST, MOST_HALVED, TRIES, Concealed, Wanted
from vlab.proof.generator.hardware import red_noise
from vlab.proof.generator.hidden import Hidden, Kind
from vlab.proof.generator.plan import Plan, Recording
from vlab.proof.generator.sizing import Size
from vlab.signals import Array

STATED: dict[str, tuple[float, ...]] = {
    "mass": (0.03, 0.05, 0.1),
    "inertia": (0.05, 0.1),
    "centre-of-mass": (0.01, 0.02, 0.03),
    "length": (0.001, 0.002, 0.003),
    "damping": (0.2, 0.3, 0.5),
    "armature": (0.05, 0.1, 0.2),
    "gain": (0.02, 0.05),
    "velocity-gain": (0.05, 0.1),
}
"""STATED [-]: round standard deviations that a case states, by kind."""
EXACT = 1e-3
"""EXACT [-]: stated standard deviation of the encoders' gains; the true gains are exact."""
RATES, SECONDS = {50.0: 0.25, 100.0: 0.5, 200.0: 0.25}, (5.0, 6.0, 8.0, 10.0)
"""RATES [Hz], SECONDS [s]: rates of the log with their frequencies, and lengths of the recordings."""
TIMESTEPS = {0.001: 0.4, 0.002: 0.4, 0.005: 0.2}
"""TIMESTEPS [s]: steps of the nominal model with their frequencies; the last one is coarse."""
INTEGRATORS = {"implicitfast": 0.7, "Euler": 0.3}
GENERAL, RATED, EFFORT = 0.25, 0.3, 0.15
"""GENERAL, RATED, EFFORT [-]: frequencies of general actuators, logged rates, logged moments."""
NOISE = {"arm": (5e-5, 4e-4), FLOOR.name: (3e-5, 2e-4)}
"""NOISE [rad]: range of the white noise of an angle."""
OTHER_NOISE = {"rate": 0.01, "effort": 0.02}
"""OTHER_NOISE [-]: noise of rates and moments over their rms."""
FINE_S, SEARCH_S, REFIT_S = 2.5e-4, 5e-4, 1e-3
"""FINE_S, SEARCH_S, REFIT_S [s]: largest steps of the integration of a case, of the search for a size, and of the
derivatives."""
REFINED, HALVED_S = 4, 4.0
"""REFINED [-], HALVED_S [s]: halvings of the step before a case is given up, and part of the first recording that
compares the steps."""
KINDS_OF = {"angle": ("angle", "rad"), "rate": ("angular-velocity", "rad/s"), "effort": ("moment", "N m")}


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmPlan(Plan):
    """Recordings in which all servos are commanded."""

    servos: tuple[str, ...]

    @property
    def driven(self) -> tuple[str, ...]:
        """All servos."""
        return self.servos


@dataclass(frozen=True, kw_only=True, eq=False)
class _Drawn:
    """Arm as built with its plan, statement, noise and readings without hidden effects."""

    arm: Arm
    nominal: Nominal
    factors: dict[str, float]
    benign: tuple[Benign, ...]
    plan: ArmPlan
    setup: ServoArm
    sigma: Array
    noise: Array
    quantum: Array
    described: dict[str, Any]


def conceal_arm(wanted: Wanted, rng: np.random.Generator) -> Concealed:
    """Make one case of an arm.

    Parameters
    ----------
    wanted : Wanted
        Wanted content; loops and levels do not apply.
    rng : Generator
        Random numbers.

    Returns
    -------
    Concealed
        Finished case.

    Raises
    ------
    BadExperiment
        No effect of the wanted kinds and size was found.
    """
    drawn = _draw(rng)
    hidden, size, error = _hide(wanted, drawn, rng)
    try:
        setup, halved = _refined(drawn, hidden)
        y = setup.run(drawn.plan.commands, hidden) + drawn.noise
    except Diverged as fault:  # in a held-out recording, or with a smaller step
        raise BadExperiment(f"the {drawn.arm.name} ran away with {hidden[0].kind.name}") from fault
    step = drawn.quantum[None, :, None]
    outputs = np.where(step > 0.0, np.round(y / np.where(step > 0.0, step, 1.0)) * step, y)
    truth = {
        "suite": wanted.suite,
        "bench": "arm",
        "hidden": [_described(x, drawn.arm) for x in hidden],
        "size": None if size is None else {**asdict(size), "absorbed": size.absorbed},
        "sigma": drawn.sigma.tolist(),
        "benign": drawn.factors,
        "in_loop": False,
        "one_level": False,
        "recordings": [asdict(r) for r in drawn.plan.recordings],
        "step_halved": halved,
        **drawn.described,
    }
    if error is not None:
        truth["model_error"] = error
    sensors = tuple(
        (f"{link.joint}_effort" if quantity == "effort" else f"joint:{link.joint}", *KINDS_OF[quantity])
        for quantity in setup.logged
        for link in drawn.arm.links
    )
    return Concealed(blueprint=drawn.nominal, plan=drawn.plan, sensors=sensors, outputs=outputs, law=None, truth=truth)


def _picked(rng: np.random.Generator, options: Mapping[Any, float]) -> Any:
    names = list(options)
    return names[int(rng.choice(len(names), p=list(options.values())))]


def _draw(rng: np.random.Generator) -> _Drawn:
    arm = ARMS[int(rng.integers(len(ARMS)))]
    stated = statement.stated(STATED, rng)
    benign = benign_of(stated, arm)
    is_wrong = bool(rng.random() < statement.WRONG)
    factors = statement.deviations(benign, rng, is_wrong=is_wrong)
    logged: tuple[str, ...] = ("angle",)
    logged += ("rate",) if rng.random() < RATED else ()
    logged += ("effort",) if rng.random() < EFFORT else ()
    rate_hz, timestep, integrator = _picked(rng, RATES), _picked(rng, TIMESTEPS), _picked(rng, INTEGRATORS)
    is_general = bool(rng.random() < GENERAL)
    text = mjcf_of(arm, timestep=timestep, integrator=integrator, is_general=is_general, has_effort="effort" in logged)
    nominal = Nominal(
        name="arm",
        title=arm.title,
        model={"mjcf": "arm.xml"},
        files={"arm.xml": text},
        uncertain={**stated, "sensor": EXACT},
        rate_hz=rate_hz,
        input_kind="command",
        input_unit="rad",
        exciters=arm.servos,
        initial="",
    )
    plan = _plan(arm, rate_hz, rng)
    setup = ServoArm(
        arm=arm,
        machine=built(arm, factors),
        ways=direct(len(arm.links)),
        rate_hz=rate_hz,
        substeps=_substeps(rate_hz, FINE_S),
        logged=logged,
    )
    quiet = setup.run(plan.commands)
    sigma, noise, quantum, about = _noise(arm, setup, quiet, rng)
    return _Drawn(
        arm=arm, nominal=nominal, factors=factors, benign=benign, plan=plan, setup=setup, sigma=sigma, noise=noise,
        quantum=quantum,
        described={"arm": arm.name, "stated": stated, "twice_the_statement": is_wrong, "timestep": timestep,
                   "integrator": integrator, **about},
    )  # fmt: skip


def _plan(arm: Arm, rate_hz: float, rng: np.random.Generator) -> ArmPlan:
    """Draw two or three fit recordings of different motions, and a held-out one."""
    count = int(rng.integers(2, 4))
    names = [*rng.permutation(MOTIONS)[:count], str(rng.choice(MOTIONS))]
    time = np.arange(round(float(rng.choice(SECONDS)) * rate_hz)) / rate_hz
    commands = np.stack([motion(str(name), rng, time, arm.home, arm.reach) for name in names], axis=-1)
    recordings = tuple(
        Recording(signal=str(name), level=1.0, actuator="all", role="fit" if i < count else "holdout")
        for i, name in enumerate(names)
    )
    return ArmPlan(recordings=recordings, commands=np.round(commands, 6), servos=arm.servos)


def _noise(
    arm: Arm, setup: ServoArm, quiet: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array, dict[str, Any]]:
    """Draw the noise; return standard deviations, values, encoder steps and a description."""
    n, (low, high) = setup.n, NOISE.get(arm.name, NOISE["arm"])
    where = float(rng.random())
    white = low * (high / low) ** where
    bits = int(rng.choice(arm.encoder_bits)) if rng.random() < 0.7 else 0
    coloured, tau = statement.coloured_part(rng, statement.COLOURED)
    quantum = np.zeros(quiet.shape[1])
    quantum[:n] = 2 * np.pi / 2**bits if bits else 0.0
    plain = np.full(quiet.shape[1], white)
    for k, name in enumerate(setup.logged[1:], 1):
        part = slice(k * n, (k + 1) * n)
        plain[part] = OTHER_NOISE[name] * np.sqrt(np.mean(quiet[:, part] ** 2, axis=(0, 2)))
    noise = rng.standard_normal(quiet.shape)
    if coloured:
        noise = noise + coloured * red_noise(rng, quiet.shape, setup.rate_hz, tau)
    sigma = np.sqrt(plain**2 * (1.0 + coloured**2) + quantum**2 / 12.0)
    about = {
        "noise": ("low", "middle", "high")[min(int(3 * where), 2)],
        "white": white,
        "coloured": {"over_white": coloured, "time_constant": tau},
        "encoder_bits": bits,
    }
    return sigma, np.asarray(noise * plain[None, :, None]), quantum, about


def _substeps(rate_hz: float, most: float) -> int:
    return int(np.ceil(1.0 / (rate_hz * most) - 1e-9))


def _hide(
    wanted: Wanted, drawn: _Drawn, rng: np.random.Generator
) -> tuple[list[Hidden], Size | None, dict[str, float] | None]:
    """Draw hidden effects until their size is in the range.

    Sizes count in units of noise and model error together.
    """
    if not wanted.kinds:
        return [], None, None
    commands = drawn.plan.commands[:, :, drawn.plan.fit]
    coarse = replace(drawn.setup, substeps=_substeps(drawn.setup.rate_hz, REFIT_S))
    refit = ArmRefit(
        lambda factors: replace(coarse, machine=built(drawn.arm, factors)).run(commands),
        drawn.factors,
        drawn.benign,
        drawn.sigma,
    )
    search = replace(drawn.setup, substeps=_substeps(drawn.setup.rate_hz, SEARCH_S))
    shift = refit.null - search.run(commands)  # the error of the coarser steps
    scales = scales_of(search, commands)
    error = _model_error(drawn, refit, commands)
    unit = float(np.hypot(1.0, error["over_noise"]))
    wanted = replace(wanted, low=wanted.low * unit, high=wanted.high * unit)

    def readings(hidden: list[Hidden]) -> Array:
        return search.run(commands, hidden) + shift

    for _ in range(DRAWS):
        found = _sized(wanted, drawn, refit, scales, readings, rng)
        if found is None:
            continue
        try:
            size = refit.size(readings(found))
        except Diverged:
            continue
        in_range = wanted.low / CLOSE <= size.left <= wanted.high * CLOSE and size.of_signal <= 1.5 * LARGEST
        if in_range and size.absorbed >= wanted.absorbed:
            return found, size, error
    raise BadExperiment(f"no {wanted.suite} case of the wanted size was found on the {drawn.arm.name}")


def _model_error(drawn: _Drawn, refit: ArmRefit, commands: Array) -> dict[str, float]:
    """Return what a calibration leaves of the error of the nominal model's step."""
    coarse = drawn.setup.nominal_readings(
        commands,
        float(drawn.described["timestep"]),
        is_servo_implicit=drawn.described["integrator"] != "Euler",
    )
    size = refit.size(coarse - drawn.setup.run(commands) + refit.null)
    return {"over_noise": size.left, "over_signal": size.of_signal, "uncalibrated": size.change}


def _places(kind: Kind, arm: Arm) -> list[str]:
    return {
        "servo": [f"actuator:{servo}" for servo in arm.servos],
        "all servos": ["chain"],
        "joint": [f"joint:{link.joint}" for link in arm.links],
        "all joints": [f"joint:{arm.links[0].joint}"],
        "tip": ["site:tip"],
    }[kind.on]


def _joint(place: str, setup: ServoArm) -> int:
    """Return the joint of a place, the last one for tip and chain."""
    return setup.n - 1 if place in ("chain", "site:tip") else setup.joint(place)


def _sized(
    wanted: Wanted, drawn: _Drawn, refit: ArmRefit, scales: Any, readings: Any, rng: np.random.Generator
) -> list[Hidden] | None:
    """Draw effects and places, and find the size of each alone."""
    out: list[Hidden] = []
    taken: set[int] = set()
    for candidates in wanted.kinds:
        others = tuple(k for k in candidates if k.name not in {x.kind.name for x in out})
        kind = others[int(rng.integers(len(others)))]
        options = [p for p in _places(kind, drawn.arm) if _joint(p, drawn.setup) not in taken]
        place = options[int(rng.integers(len(options)))]
        joint = _joint(place, drawn.setup)
        taken |= {joint} if len(options) > 1 else set()
        scale = replace(scales[joint], each=scales)
        spread = (refit.null - refit.null.mean(axis=0)) / drawn.sigma[None, :, None]
        most = min(wanted.high, LARGEST * float(np.sqrt(np.mean(spread**2))))
        target = float(np.exp(rng.uniform(np.log(wanted.low), np.log(max(most, wanted.low * 1.01)))))
        one = Hidden(kind=kind, place=place, shapes=kind.draw(rng), scale=scale, size=min(kind.start, kind.most))
        found = _to_size(one, target, refit, readings)
        if found is None:
            return None
        out.append(found)
    return out


def _to_size(one: Hidden, target: float, refit: ArmRefit, readings: Any) -> Hidden | None:
    """Change the size of an effect to a target after calibration.

    The result is None for an unreachable target.
    """
    low, high = 0.0, np.inf  # bracket: too small, too large
    for _ in range(TRIES):
        try:
            y = readings([one])
            left = refit.quick(y)
            if left <= target * CLOSE:  # the linear step overrates what a full calibration leaves
                left = refit.size(y).left
        except Diverged:
            left = np.inf
        if target / CLOSE <= left <= target * CLOSE:
            return one
        if left < target:
            low = one.size
        else:
            high = one.size
        factor = 0.3 if not np.isfinite(left) else float(np.clip(target / max(left, 1e-12), 0.05, 20.0))
        new = one.size * factor
        if low > 0 and np.isfinite(high) and not low < new < high:
            new = float(np.sqrt(low * high))
        new = min(new, one.kind.most)
        if new == one.size or (np.isfinite(high) and low > 0.98 * high):
            return None
        one = replace(one, size=new)
    return None


def _refined(drawn: _Drawn, hidden: list[Hidden]) -> tuple[ServoArm, dict[str, float]]:
    """Halve the step until the first recording stays within a part of the noise."""
    count = round(HALVED_S * drawn.setup.rate_hz)
    commands, sigma = drawn.plan.commands[:count, :, :1], drawn.sigma[None, :, None]
    setup = drawn.setup
    coarse = setup.run(commands, hidden)
    for _ in range(REFINED):
        finer = replace(setup, substeps=2 * setup.substeps)
        fine = finer.run(commands, hidden)
        over = float(np.sqrt(np.mean(((coarse - fine) / sigma) ** 2)))
        if over <= MOST_HALVED:
            return setup, {"seconds": HALVED_S, "over_noise": over, "substeps": setup.substeps}
        setup, coarse = finer, fine
    raise BadExperiment(f"half the step of the {drawn.arm.name} changes the recordings by {over:.2g} of their noise")


def _described(x: Hidden, arm: Arm) -> dict[str, Any]:
    """Return the truth about a hidden effect."""
    joints = [link.joint for link in arm.links]
    everywhere = [f"joint:{name}" for name in joints] + [f"actuator:{name}" for name in arm.servos]
    alike: list[str] = []
    near: list[str] = []
    if x.place == "chain" or x.kind.on == "all joints":
        alike = everywhere
    elif x.place == "site:tip":
        alike = [f"site:tip{axis}" for axis in (".x", ".y", ".z")] + [f"body:{arm.links[-1].name}"]
        near = [f"joint:{joints[-1]}", f"body:{arm.links[-2].name}"]
    else:
        name = x.place.partition(":")[2].removesuffix("_servo")
        at = joints.index(name)
        alike = [f"joint:{name}", f"actuator:{name}_servo", f"body:{arm.links[at].name}"]
        beside = [j for j in (at - 1, at + 1) if 0 <= j < len(joints)]
        near = [p for j in beside for p in (f"joint:{joints[j]}", f"actuator:{arm.servos[j]}")]
    accepted = x.kind.accepted or ((x.kind.name,) if x.kind.same or x.kind.form else ())
    return {
        "effect": x.kind.name,
        "family": x.kind.family,
        "form": x.kind.form,
        "accepted": list(accepted),
        "place": x.place,
        "places_alike": [p for p in alike if p != x.place],
        "places_near": near,
        "at_actuator": True,
        "parameters": {k: float(v) for k, v in x.parameters.items()},
        "same_parameters": x.kind.same,
        "size": x.size,
    }
