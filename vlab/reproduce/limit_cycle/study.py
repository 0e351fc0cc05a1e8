"""Limit cycle near 41 Hz of LQG on the beam, section 6.1.

According to the text, a vibration of about 41 Hz grew for two or three minutes at rest under control, to a moderately
low level. The text suspects the delay of the array controller and a nearby mode. Nothing here is fitted to 41 Hz,
except for one candidate that states so. The nominal loop comes first. Then one omission of the model at a time is
added, and the resulting motion is reported at any frequency.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from vlab.controllers.catalogue import in_a_loop, published_way
from vlab.controllers.linear import LinearController
from vlab.controllers.lqg import RATE
from vlab.fe.assembly import build_fe_model
from vlab.fe.model import FeModel
from vlab.fe.string_modes import add_string_modes, string_frequency, string_shares, with_cable_mass
from vlab.hardware import Hardware, load_hardware
from vlab.lab.prediction import SampledLoop, loop_on
from vlab.lab.robustness import damper_strengths, find_margin, robustness_report
from vlab.signals import Array
from vlab.structure.model import Structure

OBSERVED_HZ = 41.0
"""OBSERVED_HZ [Hz]: approximate frequency in section 6.1."""
NEAR_HZ = (38.0, 44.0)
"""NEAR_HZ [Hz]: band near 41 Hz, about 7 % to either side; the model's error in modes 1 to 6 is at most 2.5 %."""
ROPE_FILL = 0.62
"""ROPE_FILL [-]: metal fraction of a wire rope's cross-section, which puts the lower cable's own frequency near 41 Hz."""
WIRE_ZETA = 2e-4
"""WIRE_ZETA [-]: damping ratio of a taut steel wire between good ends; assumed, of the order measured on strings."""
MOST_DELAY = 8.0
"""MOST_DELAY [samples]: longest tried delay, six times the measured one."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """Omission of the nominal model, and its effect in the LQG loop.

    Parameters
    ----------
    name, words : str
        Short name, and description of the change.
    own_hz, own_zeta : float
        Frequency [Hz] and damping ratio of the mode without control.
    hz, zeta, growth_per_s : float
        Frequency [Hz], damping ratio and growth [1/s] of the mode in the loop.
    needed_zeta : float
        Own damping ratio below which the mode would grow; zero if the loop damps the mode.
    delay_to_grow : float or None
        Total delay [samples] above which the mode grows; None up to `MOST_DELAY`.
    is_stable : bool
        Whether the whole loop is stable.
    """

    name: str
    words: str
    own_hz: float
    own_zeta: float
    hz: float
    zeta: float
    growth_per_s: float
    needed_zeta: float
    delay_to_grow: float | None
    is_stable: bool


def cable_candidate(
    structure: Structure,
    law: LinearController,
    hardware: Hardware,
    cable: str,
    *,
    mass: float,
    zeta: float,
    words: str,
    modes: int = 1,
) -> tuple[Candidate, FeModel]:
    """Return the candidate of a cable's first mode, and its FE model.

    Parameters
    ----------
    structure : Structure
        Structure.
    law : LinearController
        Control law.
    hardware : Hardware
        Hardware of the laboratory.
    cable : str
        Name of the cable.
    mass : float
        Factor on the cable's mass per length; 1 is solid wire.
    zeta : float
        Damping ratio of the string between held ends.
    words : str
        Description of the change.
    modes : int
        Own modes of each cable in the model.

    Returns
    -------
    (Candidate, FeModel)
        Candidate and model.
    """
    fe = add_string_modes(build_fe_model(with_cable_mass(structure, cable, mass)), modes, zeta=zeta)
    held = string_frequency(with_cable_mass(structure, cable, mass), cable)
    shares = string_shares(fe) * np.exp(
        -((np.log(fe.linear.freq / held) / 0.1) ** 2)
    )  # the string mode nearest to its own
    return _candidate(f"{cable} x {mass:.3g}", words, int(shares.argmax()), loop_on(fe, law, hardware.converter)), fe


def tuned_mass(structure: Structure, cable: str, hz: float = OBSERVED_HZ) -> float:
    """Return the mass factor that gives a cable's own mode a frequency."""
    return float((string_frequency(structure, cable) / hz) ** 2)


def shifted_mode_candidate(loop: SampledLoop, mode: int, hz: float) -> Candidate:
    """Return the candidate of a structural mode with another frequency.

    Parameters
    ----------
    loop : SampledLoop
        Nominal loop.
    mode : int
        Number of the mode, from 1.
    hz : float
        Frequency of the mode [Hz].

    Returns
    -------
    Candidate
        Candidate.
    """
    omega = loop.omega.copy()
    omega[mode - 1] = 2 * np.pi * hz
    damping = loop.damping.copy()
    damping[mode - 1, mode - 1] *= hz * 2 * np.pi / loop.omega[mode - 1]  # the same ratio
    shifted = replace(loop, omega=omega, damping=damping)
    return _candidate(
        f"mode {mode} at {hz:.3g} Hz", "the structure's mode is not where the design has it", mode - 1, shifted
    )


def _candidate(name: str, words: str, mode: int, loop: SampledLoop) -> Candidate:
    own_hz = float(loop.omega[mode] / (2 * np.pi))
    own_zeta = float(loop.damping[mode, mode] / (2 * loop.omega[mode]))
    pole = loop.mode_poles([mode])[0]
    return Candidate(
        name=name,
        words=words,
        own_hz=own_hz,
        own_zeta=own_zeta,
        hz=pole.hz,
        zeta=pole.zeta,
        growth_per_s=pole.growth,
        needed_zeta=max(own_zeta - pole.zeta, 0.0),
        delay_to_grow=delay_to_grow(loop, mode),
        is_stable=loop.radius < 1,
    )


def delay_to_grow(loop: SampledLoop, mode: int, *, step: float = 0.05) -> float | None:
    """Return the total delay from which a mode grows, or None [samples]."""
    delays = np.arange(loop.converter.delay_samples, MOST_DELAY, step)
    return next((float(d) for d in delays if loop.with_delay(float(d)).mode_poles([mode])[0].growth > 0), None)


def crossings_by_delay(loop: SampledLoop, *, step: float = 0.05) -> list[dict[str, Any]]:
    """Return each mode's delay of first growth, up to 100 Hz.

    Parameters
    ----------
    loop : SampledLoop
        Sampled loop.
    step : float
        Resolution of the delay [samples].

    Returns
    -------
    list of dict
        Growing modes with total delay [samples].
    """
    found: dict[int, dict[str, Any]] = {}
    for delay in np.arange(loop.converter.delay_samples, MOST_DELAY, step):
        for pole in loop.with_delay(float(delay)).poles():
            if pole.growth > 0 and pole.hz < 100 and pole.mode not in found:
                found[pole.mode] = {
                    "mode": pole.mode,
                    "hz": pole.hz,
                    "delay_samples": float(delay),
                    "delay_s": float(delay) / loop.rate,
                }
    return sorted(found.values(), key=lambda row: row["delay_samples"])


def driven_bands(loop: SampledLoop, freq: Array) -> list[dict[str, float]]:
    """Return bands in which the law drives more combinations than it damps.

    Combinations are those of the coils.

    Parameters
    ----------
    loop : SampledLoop
        Sampled loop.
    freq : array
        Frequencies [Hz].

    Returns
    -------
    list of dict
        Bands [Hz].
    """
    strengths = damper_strengths(loop, freq)
    driven = (strengths < 0).sum(axis=1) > strengths.shape[1] / 2
    edges = np.flatnonzero(np.diff(np.concatenate([[0], driven.astype(int), [0]])))
    return [
        {"from_hz": float(freq[a]), "to_hz": float(freq[b - 1]), "least_n_s_per_m": float(strengths[a:b].min())}
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]


def limit_cycle_report(
    structure: Structure, *, rate: float = RATE, string_zeta: Sequence[float] = (1e-3, WIRE_ZETA)
) -> dict[str, Any]:
    """Return the model's results on the 41 Hz limit cycle.

    Parameters
    ----------
    structure : Structure
        Structure.
    rate : float
        Sample rate of the law and the loop [Hz].
    string_zeta : sequence of float
        Damping ratios of the cables' own modes: of the structure's higher modes, and of steel wire.

    Returns
    -------
    dict
        Plain data, without time histories.
    """
    hardware, design = load_hardware().at_rate(rate), published_way(structure, "lqg", rate=rate)
    law = in_a_loop(design)
    nominal = loop_on(build_fe_model(structure), law, hardware.converter)
    candidates = [
        cable_candidate(structure, law, hardware, cable, mass=mass, zeta=zeta, words=f"{words}, own damping {zeta:g}")[
            0
        ]
        for zeta in string_zeta
        for cable, mass, words in (
            ("cable-lower", 1.0, "own mode of the lower cable, solid wire"),
            ("cable-lower", ROPE_FILL, "own mode of the lower cable, wire rope"),
            ("cable-upper", 1.0, "own mode of the upper cable, solid wire"),
            (
                "cable-upper",
                tuned_mass(structure, "cable-upper"),
                "own mode of the upper cable, its mass set for 41 Hz between held ends",
            ),
        )
    ]
    seventh = nominal.omega[6] / (2 * np.pi)
    candidates += [shifted_mode_candidate(nominal, 7, float(hz)) for hz in (seventh * 1.025, OBSERVED_HZ, 45.0)]
    crossings, bands = crossings_by_delay(nominal), driven_bands(nominal, np.arange(1.0, 100.0, 0.25))
    return {
        "observed_hz": OBSERVED_HZ,
        "nominal": robustness_report(nominal, modelled=range(1, design.model.n + 1), sweeps=False),
        "driven_bands": bands,
        "delay_alone": crossings,
        "gain_alone": _gain_alone(nominal),
        "string_modes": [_more_strings(structure, law, hardware, count) for count in (1, 2, 3)],
        "candidates": [asdict(c) for c in candidates],
        "near": [asdict(c) for c in candidates if _is_near(c.hz) and c.zeta < c.own_zeta],
        "verdict": verdict(nominal, crossings, candidates, bands),
    }


def _more_strings(structure: Structure, law: LinearController, hardware: Hardware, count: int) -> dict[str, Any]:
    """Return the growing poles with own modes of solid-wire cables."""
    poles = loop_on(add_string_modes(build_fe_model(structure), count), law, hardware.converter).poles()
    growing = [{"hz": p.hz, "growth_per_s": p.growth} for p in poles if p.growth > 0]
    return {"modes_each": count, "growing": growing}


def _gain_alone(loop: SampledLoop) -> dict[str, Any]:
    margin = find_margin(loop.with_gain, np.geomspace(1.0, 100.0, 121))
    return {"factor": margin.value, "hz": None if margin.first is None else margin.first.hz}


def verdict(
    nominal: SampledLoop,
    crossings: list[dict[str, Any]],
    candidates: Sequence[Candidate],
    bands: Sequence[dict[str, float]] = (),
) -> list[str]:
    """Return the conclusions in sentences, derived from numbers alone.

    Parameters
    ----------
    nominal : SampledLoop
        Nominal loop.
    crossings : list of dict
        Result of `crossings_by_delay`.
    candidates : sequence of Candidate
        Candidates.
    bands : sequence of dict
        Result of `driven_bands`.

    Returns
    -------
    list of str
        Sentences.
    """
    least = nominal.critical()
    state = "stable with its delay; its least stable pole is" if least.growth < 0 else "unstable:"
    lines = [f"The nominal loop is {state} {least.hz:.1f} Hz, damping ratio {least.zeta:.2g}."]
    near = next((i for i, row in enumerate(crossings) if _is_near(row["hz"])), None)
    first = ", ".join(f"{row['hz']:.1f} Hz at {row['delay_samples']:.2f} samples" for row in crossings[:4])
    if not crossings:
        lines.append("No delay that was tried makes a mode below 100 Hz grow.")
    elif near is None:
        lines.append(f"More delay alone makes other modes grow ({first}); none of them is near {OBSERVED_HZ:g} Hz.")
    else:
        lines.append(f"More delay alone reaches {crossings[near]['hz']:.1f} Hz after {near} other modes ({first}).")
    for band in bands:
        if band["from_hz"] <= OBSERVED_HZ <= band["to_hz"]:
            lines.append(
                f"From {band['from_hz']:g} to {band['to_hz']:g} Hz the law drives more combinations of the coils than it damps: "
                "a light mode there that the design does not know can lose damping."
            )
    lines += [_candidate_sentence(c) for c in candidates]
    growing = ", ".join(f"{c.name} ({c.hz:.1f} Hz)" for c in candidates if _is_near(c.hz) and c.growth_per_s > 0)
    where = f"between {NEAR_HZ[0]:g} and {NEAR_HZ[1]:g} Hz at the delay of {nominal.converter.delay_samples:g} samples"
    lines.append(f"Of what was tried, {growing or 'nothing'} grows {where}.")
    return lines


def _is_near(hz: float) -> bool:
    return NEAR_HZ[0] <= hz <= NEAR_HZ[1]


def _candidate_sentence(c: Candidate) -> str:
    effect = "gains" if c.zeta > c.own_zeta else "loses"
    change = f"{c.name} ({c.words}): {c.hz:.1f} Hz {effect} {abs(c.zeta - c.own_zeta):.2g} of damping ratio and"
    if c.growth_per_s > 0:
        return f"{change} grows."
    needs = f"would grow with own damping below {c.needed_zeta:.2g}" if c.needed_zeta else "is damped"
    later = "" if c.delay_to_grow is None else f"; from {c.delay_to_grow:.2f} samples of delay on it grows"
    return f"{change} {needs}{later}."
