"""Concealed case of an arm on position servos: arm, hidden effects, log, truth."""

from dataclasses import dataclass

import numpy as np

from vlab.proof.generator.arm_commands import MOTIONS, motion
from vlab.proof.generator.arm_models import ARMS, FLOOR, Arm, benign_of, built, mjcf_of
from vlab.proof.generator.arm_setup import ServoArm, direct
from vlab.proof.generator.bench import Nominal
from vlab.proof.generator.concealed import Concealed, Wanted
from vlab.proof.generator.mechanism_case import (
    EXACT,
    FINE_S,
    Drawn,
    drawn_noise,
    finished,
    picked,
    steps_within,
)
from vlab.proof.generator.plan import Plan, Recording
from vlab.proof.generator.statement import WRONG, deviations, stated
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
KINDS_OF = {"angle": ("angle", "rad"), "rate": ("angular-velocity", "rad/s"), "effort": ("moment", "N m")}


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmPlan(Plan):
    """Recordings in which all servos are commanded."""

    servos: tuple[str, ...]

    @property
    def driven(self) -> tuple[str, ...]:
        """All servos."""
        return self.servos


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
    return finished(_draw(rng), wanted, rng)


def _draw(rng: np.random.Generator) -> Drawn:
    arm = ARMS[int(rng.integers(len(ARMS)))]
    sd = stated(STATED, rng)
    benign = benign_of(sd, arm)
    is_wrong = bool(rng.random() < WRONG)
    factors = deviations(benign, rng, is_wrong=is_wrong)
    logged: tuple[str, ...] = ("angle",)
    logged += ("rate",) if rng.random() < RATED else ()
    logged += ("effort",) if rng.random() < EFFORT else ()
    rate_hz, timestep, integrator = picked(rng, RATES), picked(rng, TIMESTEPS), picked(rng, INTEGRATORS)
    is_general = bool(rng.random() < GENERAL)
    text = mjcf_of(arm, timestep=timestep, integrator=integrator, is_general=is_general, has_effort="effort" in logged)
    nominal = Nominal(
        name="arm",
        title=arm.title,
        model={"mjcf": "arm.xml"},
        files={"arm.xml": text},
        uncertain={**sd, "sensor": EXACT},
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
        substeps=steps_within(rate_hz, FINE_S),
        logged=logged,
    )
    sigma, noise, quantum, about = drawn_noise(
        setup.run(plan.commands),
        rng,
        rate_hz=rate_hz,
        white=NOISE.get(arm.name, NOISE["arm"]),
        encoder_bits=arm.encoder_bits,
        units=np.ones(setup.n),
        relative=[(slice(k * setup.n, (k + 1) * setup.n), OTHER_NOISE[name]) for k, name in enumerate(logged[1:], 1)],
    )

    def coarse(commands: Array) -> Array:
        return setup.nominal_readings(commands, timestep, is_servo_implicit=integrator != "Euler")

    return Drawn(
        bench="arm", name=arm.name, nominal=nominal, factors=factors, benign=benign, plan=plan, setup=setup,
        coarse=coarse, sensors=_sensors(arm, logged), sigma=sigma, noise=noise, quantum=quantum,
        described={"arm": arm.name, "stated": sd, "twice_the_statement": is_wrong, "timestep": timestep,
                   "integrator": integrator, **about},
    )  # fmt: skip


def _sensors(arm: Arm, logged: tuple[str, ...]) -> tuple[tuple[str, str, str], ...]:
    """Return place, quantity and unit of all channels."""
    return tuple(
        (f"{link.joint}_effort" if quantity == "effort" else f"joint:{link.joint}", *KINDS_OF[quantity])
        for quantity in logged
        for link in arm.links
    )


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
