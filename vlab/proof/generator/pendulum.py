"""Concealed case of a free pendulum, or of a cart with one."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from vlab.errors import BadExperiment
from vlab.proof.generator.bench import Nominal
from vlab.proof.generator.concealed import Concealed, Wanted
from vlab.proof.generator.excite import REST_S, excite
from vlab.proof.generator.mechanism_case import (
    EXACT,
    FINE_S,
    Drawn,
    drawn_noise,
    finished,
    picked,
    steps_within,
)
from vlab.proof.generator.pendulum_models import CARTS, SWINGS, Cart, Pendulum, benign_of, mjcf_of, starts_of
from vlab.proof.generator.pendulum_setup import ideal
from vlab.proof.generator.plan import Plan, Recording
from vlab.proof.generator.statement import WRONG, deviations, stated
from vlab.signals import Array

STATED: dict[str, tuple[float, ...]] = {
    "mass": (0.01, 0.02, 0.05),
    "inertia": (0.05, 0.1),
    "centre-of-mass": (0.01, 0.02, 0.03),
    "length": (0.001, 0.002, 0.003),
    "damping": (0.2, 0.3, 0.5),
    "gain": (0.02, 0.05),
}
"""STATED [-]: round standard deviations that a case states, by kind, where the model has parameters of the kind."""
RATES, SECONDS = {50.0: 0.3, 100.0: 0.5, 200.0: 0.2}, {"pendulum": (8.0, 12.0, 16.0), "cart": (8.0, 10.0, 12.0)}
"""RATES [Hz], SECONDS [s]: rates of the log with their frequencies, and lengths of the recordings."""
TIMESTEPS = {0.001: 0.4, 0.002: 0.4, 0.005: 0.2}
"""TIMESTEPS [s]: steps of the nominal model with their frequencies; the last one is coarse."""
INTEGRATORS = {"implicitfast": 0.6, "RK4": 0.4}
NOISE = (3e-4, 4e-3)
"""NOISE [rad]: range of the white noise of an encoder."""
LEAD_S = (0.05, 0.4)
"""LEAD_S [s]: range of the time from a release to the first sample."""
BAND_HZ = (0.25, 3.0)
"""BAND_HZ [Hz]: band of multisines and chirps."""
PUSHED = {"multisine": 0.4, "sweep": 0.3, "steps": 0.3}
"""PUSHED [-]: signals of the motor with their frequencies."""
LOUDNESS = (0.5, 1.6)
"""LOUDNESS [-]: range of the levels over the usual force."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SwingPlan(Plan):
    """Releases, whose angles no log holds, or commands of a motor."""

    motors: tuple[str, ...]

    @property
    def driven(self) -> tuple[str, ...]:
        """Logged actuators."""
        return self.motors


def conceal_pendulum(bench: str, wanted: Wanted, rng: np.random.Generator) -> Concealed:
    """Make one case of a free pendulum or of a cart.

    Parameters
    ----------
    bench : str
        ``pendulum`` or ``cart``.
    wanted : Wanted
        Wanted content; loops and levels do not apply, nor do kinds without a place.
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
    drawn = _draw(bench, rng)
    kinds = tuple(tuple(k for k in candidates if drawn.setup.places(k)) for candidates in wanted.kinds)
    if not all(kinds):
        raise BadExperiment(f"the {drawn.name} has no place for what {wanted.suite} hides; add another bench")
    return finished(drawn, replace(wanted, kinds=kinds), rng)


def _draw(bench: str, rng: np.random.Generator) -> Drawn:
    machines: Mapping[Pendulum, float] = CARTS if bench == "cart" else SWINGS
    pendulum: Pendulum = picked(rng, machines)
    every = stated(STATED, rng)
    benign = benign_of(every, pendulum)
    sd = {kind: value for kind, value in every.items() if any(b.kind == kind for b in benign)}
    is_wrong = bool(rng.random() < WRONG)
    factors = deviations(benign, rng, is_wrong=is_wrong)
    rate_hz, timestep, integrator = picked(rng, RATES), picked(rng, TIMESTEPS), picked(rng, INTEGRATORS)
    nominal = Nominal(
        name=bench,
        title=pendulum.title,
        model={"mjcf": f"{bench}.xml"},
        files={f"{bench}.xml": mjcf_of(pendulum, timestep=timestep, integrator=integrator)},
        uncertain={**sd, "sensor": EXACT},
        rate_hz=rate_hz,
        input_kind="force",
        input_unit="N",
        exciters=("motor",) if pendulum.cart is not None else (),
        initial="rest" if pendulum.cart is not None else "",
    )
    time = np.arange(round(float(rng.choice(SECONDS[bench])) * rate_hz)) / rate_hz
    plan = _released(pendulum, time, rng) if pendulum.cart is None else _pushed(pendulum.cart, time, rng)
    lead = 0 if pendulum.cart is not None else round(float(rng.uniform(*LEAD_S)) * rate_hz)
    setup = ideal(pendulum, factors, rate_hz=rate_hz, substeps=steps_within(rate_hz, FINE_S), lead=lead)
    units = np.ones(setup.n)
    if pendulum.cart is not None:
        units[0] = pendulum.cart.radius
    sigma, noise, quantum, about = drawn_noise(
        setup.run(plan.commands),
        rng,
        rate_hz=rate_hz,
        white=NOISE,
        encoder_bits=pendulum.encoder_bits,
        units=units,
    )

    def coarse(commands: Array) -> Array:
        return setup.nominal_readings(commands, timestep, is_fourth_order=integrator == "RK4")

    return Drawn(
        bench=bench, name=pendulum.name, nominal=nominal, factors=factors,
        benign=(*benign, *starts_of(pendulum, len(plan.fit))), plan=plan, setup=setup, coarse=coarse,
        sensors=tuple((f"joint:{name}", *(("displacement", "m") if name == "slide" else ("angle", "rad")))
                      for name in pendulum.joints),
        sigma=sigma, noise=noise, quantum=quantum,
        described={"pendulum": pendulum.name, "stated": sd, "twice_the_statement": is_wrong, "timestep": timestep,
                   "integrator": integrator, "lead": lead / rate_hz, **about},
    )  # fmt: skip


def _released(pendulum: Pendulum, time: Array, rng: np.random.Generator) -> SwingPlan:
    """Draw releases over the whole range, and a held-out one."""
    count, (low, high) = int(rng.integers(3, 5)), pendulum.widest
    levels = [*(np.linspace(low, high, count) * rng.uniform(0.92, 1.0, count)), float(rng.uniform(low, high))]
    commands = np.zeros((time.size, len(pendulum.joints), len(levels)))
    for i, level in enumerate(levels):
        share = np.concatenate([[1.0], rng.uniform(-0.6, 0.6, len(pendulum.joints) - 1)])
        commands[:, :, i] = rng.choice([-1.0, 1.0]) * level * share
    recordings = tuple(
        Recording(signal="release", level=float(level), actuator="hand", role="fit" if i < count else "holdout")
        for i, level in enumerate(levels)
    )
    return SwingPlan(recordings=recordings, commands=commands, motors=())


def _pushed(cart: Cart, time: Array, rng: np.random.Generator) -> SwingPlan:
    """Draw recordings of a motor at several levels, and a held-out one."""
    count = int(rng.integers(3, 5))
    main, other = picked(rng, PUSHED), picked(rng, PUSHED)
    signals = [main] * (count - 1) + [other, main]
    levels = [*np.geomspace(*LOUDNESS, count), float(rng.uniform(*LOUDNESS))]
    commands = np.zeros((time.size, 1, len(levels)))
    for i, (name, level) in enumerate(zip(signals, levels, strict=True)):
        wave = _steps(rng, time) if name == "steps" else excite(name, rng, time, BAND_HZ)
        commands[:, 0, i] = level * cart.force * wave
    recordings = tuple(
        Recording(signal=name, level=float(level), actuator="motor", role="fit" if i < count else "holdout")
        for i, (name, level) in enumerate(zip(signals, levels, strict=True))
    )
    return SwingPlan(recordings=recordings, commands=np.round(commands, 4), motors=("motor",))


def _steps(rng: np.random.Generator, time: Array) -> Array:
    """Return pairs of opposite steps, which keep the cart near."""
    out, at, side = np.zeros(time.size), REST_S, float(rng.choice([-1.0, 1.0]))
    while at < time[-1]:
        size, width, side = side * rng.uniform(0.6, 1.4), rng.uniform(0.2, 0.6), -side
        out[(time >= at) & (time < at + width)] = size
        out[(time >= at + width) & (time < at + 2 * width)] = -size
        at += 2 * width + rng.uniform(0.2, 1.0)
    return out
