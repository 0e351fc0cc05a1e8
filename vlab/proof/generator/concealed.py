"""Concealed case: bench as built, hidden effects, recordings, truth."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from vlab.errors import BadExperiment, Diverged
from vlab.proof.generator.bench import Bench, Blueprint, Nominal
from vlab.proof.generator.hardware import Converted, Output, Pickup, red_noise
from vlab.proof.generator.hidden import Hidden, Kind, places_for
from vlab.proof.generator.integration import Feedback, semi_implicit
from vlab.proof.generator.plan import Plan, plan
from vlab.proof.generator.simulate import Setup, scale_at
from vlab.proof.generator.sizing import CLOSE, Refit, Size, to_size
from vlab.proof.generator.statement import OF_COMMAND, TIME_CONSTANT, coloured_part, deviations
from vlab.signals import Array

NOISE = {"low": 0.002, "middle": 0.007, "high": 0.02}
"""NOISE [-]: standard deviation of the noise over the rms of each channel at the middle level."""
SEARCH_HZ = 1000.0
"""SEARCH_HZ [Hz]: least integration rate during the search for the size."""
DRAWS = 12
"""DRAWS [-]: draws per case before the case is given up."""
LARGEST = 0.6
"""LARGEST [-]: largest change of the signals by a hidden effect, as a share of their rms."""
HALVED_S, MOST_HALVED = 4.0, 0.1
"""HALVED_S [s], MOST_HALVED [-]: part of the loudest recording integrated with half the step, and largest change over
the noise. A case with coarser integration is worthless."""
MOST_VEILED = 0.7
"""MOST_VEILED [-]: largest visible share of an effect in a veiling loop over that without the loop."""
MOST_LARGER = 1e3
"""MOST_LARGER [-]: largest output over that without effects; beyond it a recording has run away."""
DELAY_SAMPLES, CORNER_HZ = 1.35, 677.0
"""DELAY_SAMPLES [samples], CORNER_HZ [Hz]: nominal converter of the laboratory; the true one is within 2 %."""


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """Wanted content of a case.

    Parameters
    ----------
    kinds : tuple of tuples of Kind
        One tuple of candidates per hidden effect; empty for nothing.
    low, high : float
        Range of the size after calibration, in units of the noise.
    one_level : bool
        Whether the fit recordings stay near one level.
    absorbed : float
        Least share of the change that calibration absorbs.
    in_loop : bool
        Whether a rate feedback acts in every recording.
    veiled : bool
        Whether the feedback also makes the effect less visible, see `MOST_VEILED`.
    """

    suite: str
    kinds: tuple[tuple[Kind, ...], ...] = ()
    low: float = 1.5
    high: float = 30.0
    one_level: bool = False
    absorbed: float = 0.0
    in_loop: bool = False
    veiled: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Concealed:
    """Finished case.

    Parameters
    ----------
    outputs : (n_samples, n_sensors, runs) array
        Recorded values.
    law : dict or None
        Sensors, actuators and gains of the rate feedback.
    truth : dict
        Plain values.
    """

    blueprint: Nominal
    plan: Plan
    sensors: tuple[tuple[str, str, str], ...]
    outputs: Array
    law: dict[str, Any] | None
    truth: dict[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Drawn:
    """Bench as built, with planned recordings and its response without hidden effects."""

    factors: dict[str, float]
    plan: Plan
    commands: Array
    """Commands as applied: those of the plan, and stray ones that are not recorded."""
    variations: dict[str, Any]
    setup: Setup
    pickup: Pickup
    noise: Array
    level: str
    null: Array
    law: dict[str, Any] | None
    open: Setup
    """The same without a law in the loop."""
    error: dict[str, float] | None
    """Size of what a calibration of the nominal model leaves of the benign deviations; None if it has all of them."""

    @property
    def unit(self) -> float:
        """Size of noise and model error together, over the noise."""
        return 1.0 if self.error is None else float(np.hypot(1.0, self.error["over_noise"]))


def conceal(blueprint: Blueprint, wanted: Wanted, rng: np.random.Generator) -> Concealed:
    """Make one case.

    Parameters
    ----------
    blueprint : Blueprint
        Kind of bench.
    wanted : Wanted
        Wanted content.
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
    chance = rng.spawn(1)[0]  # cases without variations keep their draws
    if blueprint.varied is not None:
        blueprint = blueprint.varied(blueprint, chance)
    drawn = _draw(blueprint, wanted, rng, chance)
    wanted = replace(wanted, low=wanted.low * drawn.unit, high=wanted.high * drawn.unit)
    hidden, size, y = _hide(blueprint, wanted, drawn, rng)
    halved = _halved(drawn, hidden)
    if halved["over_noise"] > MOST_HALVED:
        raise BadExperiment(
            f"{blueprint.name}: half the step changes the recordings by {halved['over_noise']:.2g} of their noise"
        )
    outputs = drawn.pickup.quantised(drawn.setup.read(y + drawn.noise, hidden))
    truth = {
        "suite": wanted.suite,
        "bench": blueprint.name,
        "hidden": [_described(x, drawn.setup.bench) for x in hidden],
        "size": None if size is None else {**asdict(size), "absorbed": size.absorbed},
        "noise": drawn.level,
        "sigma": drawn.pickup.sigma.tolist(),
        "hum": {"over_sigma": drawn.pickup.hum, "hz": drawn.pickup.hum_hz},
        "quantisation_over_sigma": drawn.pickup.step,
        "benign": drawn.factors,
        "output": asdict(drawn.setup.output),
        **(drawn.variations if blueprint.wrong else {}),  # sealed truths without variations keep their keys
        "in_loop": wanted.in_loop,
        "one_level": wanted.one_level,
        "recordings": [asdict(r) for r in drawn.plan.recordings],
        "step_halved": halved,
    }
    if drawn.error is not None:
        truth["model_error"] = drawn.error
    sensors = tuple((name, s.kind, s.unit) for name, s in drawn.setup.bench.sensors.items())
    return Concealed(blueprint=blueprint, plan=drawn.plan, sensors=sensors, outputs=outputs, law=drawn.law, truth=truth)


def _draw(blueprint: Blueprint, wanted: Wanted, rng: np.random.Generator, chance: np.random.Generator) -> _Drawn:
    is_wrong = bool(chance.random() < blueprint.wrong)
    factors = deviations(blueprint.benign, rng, is_wrong=is_wrong)
    recordings = plan(blueprint, rng, one_level=wanted.one_level)
    names = [b.name.partition(":")[2] for b in blueprint.benign if b.kind == "sensor"]
    shifts = {name: float(blueprint.place_sd * rng.standard_normal()) for name in names}
    bench = blueprint.build(factors, shifts)
    output = Output()
    if blueprint.input_kind == "command":
        delay, corner = DELAY_SAMPLES * rng.uniform(0.98, 1.02), CORNER_HZ * rng.uniform(0.98, 1.02)
        output = Output(delay_s=delay / blueprint.rate_hz, corner_hz=corner)
        if blueprint.command_step:
            output = Converted(**asdict(output), step_n=blueprint.command_step)
    setup = Setup(
        bench=bench,
        output=output,
        rate_hz=blueprint.rate_hz,
        substeps=blueprint.substeps,
        seed=int(rng.integers(2**31)),
    )
    commands, stray = _applied(blueprint, recordings, chance)
    coloured, time_constant = coloured_part(chance, blueprint.coloured)
    quiet = setup.run(commands, ())
    level, relative = _noise(blueprint, rng)
    sigma = relative * np.sqrt(np.mean(quiet[:, :, recordings.middle] ** 2, axis=0))
    pickup = Pickup(
        sigma=sigma,
        hum=float(rng.uniform(0.0, 0.4)),
        hum_hz=50.0 + float(rng.uniform(-0.05, 0.05)),
        step=float(rng.uniform(0.2, 1.0)),
        coloured=coloured,
        time_constant=time_constant,
    )
    noise = pickup.noise(rng, len(commands), commands.shape[2], blueprint.rate_hz)
    law, opened, error = None, setup, None
    if stray or blueprint.coarse_step or any(b.sd and not b.prior for b in blueprint.benign):
        error = _model_error(blueprint, factors, setup, recordings, quiet, sigma)
    if wanted.in_loop:
        setup, law = _closed(blueprint, setup, noise, rng)
        quiet = setup.run(commands, ())
    return _Drawn(
        factors=factors,
        plan=recordings,
        commands=commands,
        variations={
            "stated": dict(blueprint.uncertain),
            "twice_the_statement": is_wrong,
            "coloured": {"over_white": coloured, "time_constant": time_constant},
            "stray_force": stray,
            "coarse_step": blueprint.coarse_step,
        },
        setup=setup,
        pickup=pickup,
        noise=noise,
        level=level,
        null=quiet,
        law=law,
        open=opened,
        error=error,
    )


def _applied(blueprint: Blueprint, recordings: Plan, chance: np.random.Generator) -> tuple[Array, float]:
    """Return the commands with stray ones, and the share of these."""
    if not blueprint.stray or chance.random() >= blueprint.stray:
        return recordings.commands, 0.0
    share = float(chance.uniform(*OF_COMMAND))
    red = red_noise(
        chance, recordings.commands.shape, blueprint.rate_hz, float(np.exp(chance.uniform(*np.log(TIME_CONSTANT))))
    )
    return recordings.commands + share * np.sqrt(np.mean(recordings.commands**2, axis=0)) * red, share


def _noise(blueprint: Blueprint, rng: np.random.Generator) -> tuple[str, float]:
    """Draw the noise level; return its name and share of the signals."""
    if blueprint.noise_db is None:
        level = str(rng.choice(list(NOISE)))
        return level, NOISE[level]
    ratio = float(rng.uniform(*blueprint.noise_db))
    low = 10 * int(ratio // 10)
    return f"{low} to {low + 10} dB", 10.0 ** (-ratio / 20.0)


def _model_error(
    blueprint: Blueprint, factors: dict[str, float], setup: Setup, recordings: Plan, quiet: Array, sigma: Array
) -> dict[str, float]:
    """Return what the calibrated nominal model leaves of the quiet fit recordings.

    The calibration starts at the bench as built, if the nominal model has all of its parameters.
    """
    fit = recordings.fit
    start = {} if any(b.sd and not b.prior for b in blueprint.benign) else factors
    nominal = blueprint.build(start, {})
    reduced = nominal.up_to(blueprint.refit_hz)
    commands = recordings.commands[:, :, fit]
    refit = Refit(blueprint, start, reduced, setup.output, commands, sigma, _every(blueprint))
    modelled = replace(setup, bench=nominal).run(commands, ())
    if blueprint.coarse_step:
        modelled = semi_implicit(nominal, commands, 1.0 / blueprint.rate_hz, blueprint.coarse_step)
    size = refit.size(quiet[:, :, fit], modelled)
    signal = np.sqrt(np.mean((quiet[:, :, fit] / sigma[None, :, None]) ** 2))
    return {"over_noise": size.left, "over_signal": float(size.left / signal), "uncalibrated": size.change}


def _every(blueprint: Blueprint) -> int:
    return max(1, int(blueprint.rate_hz / (blueprint.per_period * blueprint.band_hz[1])))


def _closed(blueprint: Blueprint, setup: Setup, noise: Array, rng: np.random.Generator) -> tuple[Setup, dict[str, Any]]:
    """Close a collocated rate feedback around an actuator."""
    bench = setup.bench
    for i, (name, load) in enumerate(bench.actuators.items()):
        for j, (sensor, s) in enumerate(bench.sensors.items()):
            aligned = abs(s.row @ load) / np.linalg.norm(s.row) / np.linalg.norm(load)
            if s.order == 1 and aligned > 0.99:
                omega = 2 * np.pi * bench.frequencies()[0]
                critical = omega / float(s.row @ np.linalg.solve(bench.M, load))
                gain = float(rng.uniform(0.2, 0.6)) * critical
                feedback = Feedback(actuators=(i,), sensors=(j,), gains=np.array([[gain]]), noise=noise[:, [j]])
                law = {"sensors": [sensor], "actuators": [name], "gains": [[gain]]}
                return replace(setup, feedback=feedback), law
    raise BadExperiment(f"the {blueprint.name} has no velocity sensor beside an actuator: no rate feedback there")


def _hide(
    blueprint: Blueprint, wanted: Wanted, drawn: _Drawn, rng: np.random.Generator
) -> tuple[list[Hidden], Size | None, Array]:
    """Draw hidden effects until their size is in the range."""
    if not wanted.kinds:
        return [], None, drawn.null
    fit = drawn.plan.fit
    setup = drawn.setup
    commands = drawn.commands
    bench, feedback = setup.bench, setup.feedback
    if feedback is not None:  # calibration treats the loop as a damper
        load, row = bench.loads[:, feedback.actuators[0]], list(bench.sensors.values())[feedback.sensors[0]].row
        bench = bench.adding(C=float(feedback.gains[0, 0]) * np.outer(load, row))
    refit = Refit(
        blueprint,
        drawn.factors,
        bench if np.isinf(blueprint.refit_hz) else bench.up_to(blueprint.refit_hz),
        setup.output,
        commands[:, :, fit],
        drawn.pickup.sigma,
        _every(blueprint),
    )
    for _ in range(DRAWS):
        found = _sized(blueprint, wanted, drawn, refit, rng)
        if found is None:
            continue
        try:
            with np.errstate(all="ignore"):
                y = setup.sensed(commands, found)
        except Diverged:
            continue
        if not _is_bounded(y, drawn.null):  # a calibration to it would run away
            continue
        size = refit.size(setup.read(y, found)[:, :, fit], drawn.null[:, :, fit])
        in_range = wanted.low / CLOSE <= size.left <= wanted.high * CLOSE and size.of_signal <= 1.5 * LARGEST
        if in_range and size.absorbed >= wanted.absorbed and (not wanted.veiled or _is_veiled(drawn, found, y)):
            return found, size, y
    raise BadExperiment(f"no {wanted.suite} case of the wanted size was found on the {blueprint.name}")


def _is_veiled(drawn: _Drawn, hidden: list[Hidden], y: Array) -> bool:
    """Return whether the loop makes hidden effects less visible."""
    loud = [drawn.plan.loudest]
    commands = drawn.commands[:, :, loud]
    try:
        with np.errstate(all="ignore"):
            bare, bare_null = drawn.open.run(commands, hidden), drawn.open.run(commands, ())
    except Diverged:
        return False
    sigma = drawn.pickup.sigma[None, :, None]
    shown = np.sqrt(np.mean(((y - drawn.null)[:, :, loud] / sigma) ** 2))
    return bool(shown <= MOST_VEILED * np.sqrt(np.mean(((bare - bare_null) / sigma) ** 2)))


def _sized(
    blueprint: Blueprint, wanted: Wanted, drawn: _Drawn, refit: Refit, rng: np.random.Generator
) -> list[Hidden] | None:
    """Draw effects and places, and find the size of each alone."""
    out: list[Hidden] = []
    taken: set[str] = set()
    for candidates in wanted.kinds:
        kind = candidates[int(rng.integers(len(candidates)))]
        driven = (drawn.plan.driven[0],)
        options = [
            p for p in places_for(drawn.setup.bench, kind.on, angular=kind.angular, driven=driven) if p not in taken
        ]
        if not options:
            return None
        place = options[int(rng.integers(len(options)))]
        taken.add(place)
        shapes = kind.draw(rng)
        relative = drawn.pickup.sigma / np.sqrt(np.mean(drawn.null[:, :, drawn.plan.loudest] ** 2, axis=0))
        most = min(wanted.high, LARGEST / float(np.mean(relative)))
        target = float(np.exp(rng.uniform(np.log(wanted.low), np.log(max(most, wanted.low * 1.01)))))
        loud = drawn.plan.loudest
        scale = scale_at(drawn.setup, drawn.commands[:, :, loud], place, drawn.null[:, :, loud], blueprint.band_hz)
        if kind.on == "element" and scale.own <= 0:
            return None
        one = Hidden(kind=kind, place=place, shapes=shapes, scale=scale, size=min(kind.start, kind.most))
        found = _to_size(one, target, drawn, refit)
        if found is None:
            return None
        out.append(found)
    return out


def _to_size(one: Hidden, target: float, drawn: _Drawn, refit: Refit) -> Hidden | None:
    """Change the size of an effect to a target, in coarser steps."""
    fit = drawn.plan.fit
    commands = drawn.commands[:, :, fit]
    substeps = max(1, round(SEARCH_HZ / drawn.setup.rate_hz))
    feedback = drawn.setup.feedback
    if feedback is not None:
        feedback = replace(feedback, noise=feedback.noise[:, :, fit])
    setup = replace(drawn.setup, substeps=substeps, feedback=feedback)
    null = drawn.null[:, :, fit]

    def left(tried: Hidden) -> float:
        residual, share = _left(setup, commands, tried, null, refit)
        return np.inf if share > LARGEST else residual

    return to_size(one, target, left)


def _left(setup: Setup, commands: Array, one: Hidden, null: Array, refit: Refit) -> tuple[float, float]:
    """Return the residual of an effect after calibration, and its share."""
    try:
        with np.errstate(all="ignore"):
            y = setup.run(commands, [one])
    except Diverged:
        return np.inf, np.inf
    return refit.left(y, null) if _is_bounded(y, null) else (np.inf, np.inf)


def _is_bounded(y: Array, null: Array) -> bool:
    """Return whether outputs are finite and of the size of those without effects."""
    return bool(np.all(np.isfinite(y)) and np.abs(y).max() <= MOST_LARGER * np.abs(null).max())


def _halved(drawn: _Drawn, hidden: Sequence[Hidden]) -> dict[str, float]:
    """Integrate the start of the loudest recording with half the step."""
    setup, loud = drawn.setup, drawn.plan.loudest
    count = round(HALVED_S * setup.rate_hz)
    commands = drawn.commands[:count, :, [loud]]
    feedback = setup.feedback
    if feedback is not None:
        feedback = replace(feedback, noise=feedback.noise[:count, :, [loud]])
    coarse = replace(setup, feedback=feedback).run(commands, hidden)
    fine = replace(setup, feedback=feedback, substeps=2 * setup.substeps).run(commands, hidden)
    change = coarse - fine
    sigma = drawn.pickup.sigma[None, :, None]
    signal = np.sqrt(np.mean(fine**2, axis=(0, 2)))
    return {
        "seconds": HALVED_S,
        "over_noise": float(np.sqrt(np.mean((change / sigma) ** 2))),
        "over_signal": float(np.max(np.sqrt(np.mean(change**2, axis=(0, 2))) / np.maximum(signal, 1e-300))),
    }


def _described(x: Hidden, bench: Bench) -> dict[str, Any]:
    """Return the truth about a hidden effect."""
    place = bench.places.get(x.place)
    alike: tuple[str, ...] = () if place is None else place.alike
    near: tuple[str, ...] = () if place is None else place.near
    pushed = x.place.startswith("actuator:") or (place is not None and bool(place.actuator))
    if place is not None and place.actuator and x.kind.name == "force-offset":
        alike = (*alike, f"actuator:{place.actuator}")
    if "/" in x.place:
        alike = (x.place.partition("/")[0],)
    accepted = x.kind.accepted or ((x.kind.name,) if x.kind.same or x.kind.form else ())
    return {
        "effect": x.kind.name,
        "family": x.kind.family,
        "form": x.kind.form,
        "accepted": list(accepted),
        "place": x.place,
        "places_alike": list(alike),
        "places_near": list(near),
        "at_actuator": pushed,
        "parameters": {k: float(v) for k, v in x.parameters.items()},
        "same_parameters": x.kind.same,
        "size": x.size,
    }


__all__ = ["NOISE", "Concealed", "Wanted", "conceal"]
