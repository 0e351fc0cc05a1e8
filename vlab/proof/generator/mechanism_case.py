"""Concealed case of a mechanism: deviations, noise, hidden effects, truth.

A mechanism is an arm on servos or a pendulum, with its clock and its log.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from vlab.errors import BadExperiment, Diverged
from vlab.proof.generator.bench import Benign, Nominal
from vlab.proof.generator.concealed import DRAWS, LARGEST, MOST_HALVED, Concealed, Wanted
from vlab.proof.generator.hardware import red_noise
from vlab.proof.generator.hidden import Hidden, Kind, Scale
from vlab.proof.generator.motion_sizing import MotionRefit
from vlab.proof.generator.plan import Plan
from vlab.proof.generator.sizing import CLOSE, Size, to_size
from vlab.proof.generator.statement import COLOURED, coloured_part
from vlab.signals import Array

EXACT = 1e-3
"""EXACT [-]: stated standard deviation of the encoders' gains; the true gains are exact."""
FINE_S, SEARCH_S, REFIT_S = 2.5e-4, 5e-4, 1e-3
"""FINE_S, SEARCH_S, REFIT_S [s]: largest steps of the integration of a case, of the search for a size, and of the
derivatives."""
REFINED, HALVED_S = 4, 4.0
"""REFINED [-], HALVED_S [s]: halvings of the step before a case is given up, and part of the first recording that
compares the steps."""


class Mechanism(Protocol):
    """Mechanism with the clock of its log."""

    @property
    def rate_hz(self) -> float:
        """Rate of the log [Hz]."""

    @property
    def substeps(self) -> int:
        """Steps of the integration per sample."""

    def run(self, commands: Array, hidden: Sequence[Hidden] = ()) -> Array:
        """Return readings without noise, (n_samples, channels, runs)."""

    def stepped(self, substeps: int) -> "Mechanism":
        """Return the mechanism with another number of steps per sample."""

    def rebuilt(self, factors: Mapping[str, float]) -> "Mechanism":
        """Return the mechanism with other log-factors."""

    def scales(self, commands: Array) -> tuple[Scale, ...]:
        """Return the signal sizes of all coordinates."""

    def scale_at(self, place: str, scales: tuple[Any, ...]) -> Scale:
        """Return the signal sizes at a place."""

    def places(self, kind: Kind) -> list[str]:
        """Return the possible places of a kind."""

    def coordinate(self, place: str) -> int:
        """Return the coordinate of a place, which effects do not share."""

    def alike(self, x: Hidden) -> dict[str, Any]:
        """Return other names of a place, and places near it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """Mechanism as built with its plan, statement and noise.

    Parameters
    ----------
    bench, name : str
        Names of the bench and of the mechanism.
    coarse : callable
        Maps commands to the readings that the steps of the nominal model give.
    sensors : tuple
        Place, quantity and unit of each channel.
    sigma, quantum : (channels,) array
        Standard deviations of the noise with that of the encoders, and encoder steps.
    noise : (n_samples, channels, runs) array
        Noise.
    described : dict
        Entries of the truth.
    """

    bench: str
    name: str
    nominal: Nominal
    factors: dict[str, float]
    benign: tuple[Benign, ...]
    plan: Plan
    setup: Mechanism
    coarse: Callable[[Array], Array]
    sensors: tuple[tuple[str, str, str], ...]
    sigma: Array
    noise: Array
    quantum: Array
    described: dict[str, Any]


def picked(rng: np.random.Generator, options: Mapping[Any, float]) -> Any:
    """Draw one of some options by their frequencies."""
    names = list(options)
    return names[int(rng.choice(len(names), p=list(options.values())))]


def steps_within(rate_hz: float, most: float) -> int:
    """Return the steps per sample that stay below a length [s]."""
    return int(np.ceil(1.0 / (rate_hz * most) - 1e-9))


def drawn_noise(
    quiet: Array,
    rng: np.random.Generator,
    *,
    rate_hz: float,
    white: tuple[float, float],
    encoder_bits: Sequence[int],
    units: Array,
    relative: Sequence[tuple[slice, float]] = (),
) -> tuple[Array, Array, Array, dict[str, Any]]:
    """Draw the noise of a log.

    Parameters
    ----------
    quiet : (n_samples, channels, runs) array
        Readings without noise.
    rng : Generator
        Random numbers.
    rate_hz : float
        Rate of the log [Hz].
    white : (float, float)
        Range of the white noise of an encoder [rad].
    encoder_bits : sequence of int
        Possible resolutions in bits per turn.
    units : (encoders,) array
        Units of the first channels per radian of their encoders.
    relative : sequence of (slice, float)
        Other channels with their noise over their rms.

    Returns
    -------
    tuple
        Standard deviations and encoder steps, (channels,) each with the noise, (n_samples, channels, runs), between them; and a description.
    """
    n, (low, high) = len(units), white
    where = float(rng.random())
    level = low * (high / low) ** where
    bits = int(rng.choice(encoder_bits)) if rng.random() < 0.7 else 0
    coloured, tau = coloured_part(rng, COLOURED)
    quantum = np.zeros(quiet.shape[1])
    quantum[:n] = 2 * np.pi / 2**bits * units if bits else 0.0
    plain = np.full(quiet.shape[1], level)
    plain[:n] *= units
    for part, share in relative:
        plain[part] = share * np.sqrt(np.mean(quiet[:, part] ** 2, axis=(0, 2)))
    noise = rng.standard_normal(quiet.shape)
    if coloured:
        noise = noise + coloured * red_noise(rng, quiet.shape, rate_hz, tau)
    sigma = np.sqrt(plain**2 * (1.0 + coloured**2) + quantum**2 / 12.0)
    about = {
        "noise": ("low", "middle", "high")[min(int(3 * where), 2)],
        "white": level,
        "coloured": {"over_white": coloured, "time_constant": tau},
        "encoder_bits": bits,
    }
    return sigma, np.asarray(noise * plain[None, :, None]), quantum, about


def finished(drawn: Drawn, wanted: Wanted, rng: np.random.Generator) -> Concealed:
    """Hide what is wanted in a drawn mechanism, and record it.

    Parameters
    ----------
    drawn : Drawn
        Mechanism with its plan and noise.
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
    hidden, size, error = _hide(wanted, drawn, rng)
    try:
        setup, halved = _refined(drawn, hidden)
        y = setup.run(drawn.plan.commands, hidden) + drawn.noise
    except Diverged as fault:  # in a held-out recording, or with a smaller step
        raise BadExperiment(f"the {drawn.name} ran away with {hidden[0].kind.name}") from fault
    step = drawn.quantum[None, :, None]
    outputs = np.where(step > 0.0, np.round(y / np.where(step > 0.0, step, 1.0)) * step, y)
    truth = {
        "suite": wanted.suite,
        "bench": drawn.bench,
        "hidden": [_described(x, drawn.setup) for x in hidden],
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
    return Concealed(
        blueprint=drawn.nominal, plan=drawn.plan, sensors=drawn.sensors, outputs=outputs, law=None, truth=truth
    )


def _hide(
    wanted: Wanted, drawn: Drawn, rng: np.random.Generator
) -> tuple[list[Hidden], Size | None, dict[str, float] | None]:
    """Draw hidden effects until their size is in the range.

    Sizes count in units of noise and model error together.
    """
    if not wanted.kinds:
        return [], None, None
    commands = drawn.plan.commands[:, :, drawn.plan.fit]
    rate_hz = drawn.setup.rate_hz
    coarse = drawn.setup.stepped(steps_within(rate_hz, REFIT_S))
    refit = MotionRefit(
        lambda factors: coarse.rebuilt(factors).run(commands),
        drawn.factors,
        drawn.benign,
        drawn.sigma,
        is_relinearised=any(b.kind == "start" for b in drawn.benign),
    )
    search = drawn.setup.stepped(steps_within(rate_hz, SEARCH_S))
    shift = refit.null - search.run(commands)  # the error of the coarser steps
    scales = search.scales(commands)
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
    raise BadExperiment(f"no {wanted.suite} case of the wanted size was found on the {drawn.name}")


def _model_error(drawn: Drawn, refit: MotionRefit, commands: Array) -> dict[str, float]:
    """Return what a calibration leaves of the error of the nominal model's step."""
    size = refit.size(drawn.coarse(commands) - drawn.setup.run(commands) + refit.null)
    return {"over_noise": size.left, "over_signal": size.of_signal, "uncalibrated": size.change}


def _sized(
    wanted: Wanted,
    drawn: Drawn,
    refit: MotionRefit,
    scales: tuple[Scale, ...],
    readings: Callable[[list[Hidden]], Array],
    rng: np.random.Generator,
) -> list[Hidden] | None:
    """Draw effects and places, and find the size of each alone."""
    out: list[Hidden] = []
    taken: set[int] = set()
    for candidates in wanted.kinds:
        others = tuple(k for k in candidates if k.name not in {x.kind.name for x in out})
        kind = others[int(rng.integers(len(others)))]
        options = [p for p in drawn.setup.places(kind) if drawn.setup.coordinate(p) not in taken]
        if not options:
            return None
        place = options[int(rng.integers(len(options)))]
        taken |= {drawn.setup.coordinate(place)} if len(options) > 1 else set()
        spread = (refit.null - refit.null.mean(axis=0)) / drawn.sigma[None, :, None]
        most = min(wanted.high, LARGEST * float(np.sqrt(np.mean(spread**2))))
        target = float(np.exp(rng.uniform(np.log(wanted.low), np.log(max(most, wanted.low * 1.01)))))
        scale = drawn.setup.scale_at(place, scales)
        one = Hidden(kind=kind, place=place, shapes=kind.draw(rng), scale=scale, size=min(kind.start, kind.most))
        found = to_size(one, target, partial(_left, target=target, refit=refit, readings=readings))
        if found is None:
            return None
        out.append(found)
    return out


def _left(one: Hidden, target: float, refit: MotionRefit, readings: Callable[[list[Hidden]], Array]) -> float:
    """Return the residual of an effect after calibration, over the noise."""
    try:
        y = readings([one])
        quick = refit.quick(y)
        # the linear step overrates what a full calibration leaves
        return refit.size(y).left if quick <= target * CLOSE else quick
    except Diverged:
        return np.inf


def _refined(drawn: Drawn, hidden: list[Hidden]) -> tuple[Mechanism, dict[str, float]]:
    """Halve the step until the first recording stays within a part of the noise."""
    count = round(HALVED_S * drawn.setup.rate_hz)
    commands, sigma = drawn.plan.commands[:count, :, :1], drawn.sigma[None, :, None]
    setup = drawn.setup
    coarse = setup.run(commands, hidden)
    for _ in range(REFINED):
        finer = setup.stepped(2 * setup.substeps)
        fine = finer.run(commands, hidden)
        over = float(np.sqrt(np.mean(((coarse - fine) / sigma) ** 2)))
        if over <= MOST_HALVED:
            return setup, {"seconds": HALVED_S, "over_noise": over, "substeps": setup.substeps}
        setup, coarse = finer, fine
    raise BadExperiment(f"half the step of the {drawn.name} changes the recordings by {over:.2g} of their noise")


def _described(x: Hidden, setup: Mechanism) -> dict[str, Any]:
    """Return the truth about a hidden effect."""
    accepted = x.kind.accepted or ((x.kind.name,) if x.kind.same or x.kind.form else ())
    about = setup.alike(x)
    return {
        "effect": x.kind.name,
        "family": x.kind.family,
        "form": x.kind.form,
        "accepted": list(accepted),
        "place": x.place,
        "places_alike": [p for p in about["places_alike"] if p != x.place],
        "places_near": about["places_near"],
        "at_actuator": about["at_actuator"],
        "parameters": {k: float(v) for k, v in x.parameters.items()},
        "same_parameters": x.kind.same,
        "size": x.size,
    }
