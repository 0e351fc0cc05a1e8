"""Time histories for the 41 Hz study (section 6.1), simulated in MuJoCo with the amplifiers' limit, beside their prediction."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlab.controllers import Controller
from vlab.controllers.catalogue import published_way
from vlab.controllers.lqg import RATE
from vlab.fe.assembly import build_fe_model
from vlab.fe.model import FeModel
from vlab.fe.string_modes import add_string_modes
from vlab.hardware import Hardware, load_hardware
from vlab.lab.excitation import Release
from vlab.lab.experiment import Experiment, run_experiment
from vlab.lab.prediction import loop_on
from vlab.lab.saturation import LimitCycle, harmonic_balance
from vlab.plants.modal import build_modal
from vlab.reproduce.limit_cycle.study import WIRE_ZETA
from vlab.signals import Array, Recording
from vlab.structure.model import Structure

LIMIT = 1.0
"""Largest force of an amplifier [N]; assumed, the text gives none."""
NOISE = 1e-6
"""Noise of the velocity sensors [m/s], rms; assumed. It is what a limit cycle starts from."""
SECONDS, SHORT = 240.0, 60.0
"""Duration of the experiments in which something grows, and of the nominal one [s]; section 6.1 speaks of two or three minutes."""
MODES = 16
"""Modes of the simulated plant: up to 250 Hz, beyond the controller's own 92 Hz."""


def simulated_seconds(seconds: float = SECONDS) -> float:
    """Return how much `histories` simulates in all [s]."""
    return 2 * seconds + min(seconds, SHORT)


def bench(rate: float = RATE, *, limit: float = LIMIT, noise: float = NOISE) -> Hardware:
    """Return the laboratory's hardware at a rate, with an amplifier limit [N] and sensor noise [m/s]."""
    hardware = load_hardware().at_rate(rate)
    return replace(
        hardware,
        coil=replace(hardware.coil, limit=limit),
        velocity_sensor=replace(hardware.velocity_sensor, noise=noise),
    )


def time_history(
    fe: FeModel,
    law: Controller,
    hardware: Hardware,
    *,
    seconds: float,
    release: float = 0.0,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Run an experiment in MuJoCo on the modal plant of a model: from rest, or released from a static force [N] at the base."""
    plant = build_modal(fe, modes=MODES, timestep=0.5 / hardware.converter.rate)
    excitation = Release(level=release) if release else None
    experiment = Experiment(
        plant=plant, seconds=seconds, controller=law, hardware=hardware, seed=seed, excitation=excitation, excite="base"
    )
    return run_experiment(experiment, progress=progress).recording


def levels_of(recording: Recording, channel: str, *, window: float = 1.0) -> tuple[Array, Array]:
    """Return the middles of windows [s] and the channel's rms in each."""
    n = round(window * recording.rate)
    x = recording[channel][: len(recording) // n * n].reshape(-1, n)
    return (np.arange(len(x)) + 0.5) * window, np.sqrt(np.mean(x**2, axis=1))


def growth(recording: Recording, channel: str, *, window: float = 1.0) -> dict[str, float]:
    """Return how a vibration grew: final level, frequency there, the rate of growth before it, and when it got there.

    Levels are rms over windows [s] of the channel. The growth is fitted between a hundredth and a third of the final
    level; it is NaN where no such stretch is seen.
    """
    x, rate, n = recording[channel], recording.rate, round(window * recording.rate)
    levels = levels_of(recording, channel, window=window)[1]
    final = float(levels[-max(5, len(levels) // 10) :].mean())
    last = x[-min(len(x), 8 * n) :]
    spectrum = np.abs(np.fft.rfft((last - last.mean()) * np.hanning(len(last)), 4 * len(last)))
    hz = float(spectrum.argmax() * rate / (4 * len(last)))
    reached = np.flatnonzero(levels >= 0.9 * final)
    end = int(np.argmax(levels > final / 3)) if np.any(levels > final / 3) else 0
    below = np.flatnonzero(levels[:end] < final / 100)
    start = int(below[-1]) + 1 if below.size else 0
    stretch = np.arange(start, end)
    slope = float(np.polyfit(stretch * window, np.log(levels[stretch]), 1)[0]) if len(stretch) >= 4 else float("nan")
    return {
        "final_rms": final,
        "hz": hz,
        "growth_per_s": slope,
        "reached_s": float(reached[0] * window) if reached.size else float("nan"),
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class History:
    """One simulated experiment beside its prediction.

    Parameters
    ----------
    predicted_growth : float
        Of the loop's least stable pole [1/s].
    predicted : LimitCycle or None
        By harmonic balance; None for a stable loop.
    """

    name: str
    words: str
    recording: Recording
    predicted_growth: float
    predicted: LimitCycle | None

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, without the recording."""
        command = max(
            (n for n in self.recording.names if n.startswith("command:")),
            key=lambda n: float(np.std(self.recording[n])),
        )
        facts = growth(self.recording, command)
        known = {key: value if np.isfinite(value) else None for key, value in facts.items()}
        found = {"channel": command, "amplitude_n": float(np.sqrt(2) * facts["final_rms"]), **known}
        predicted: dict[str, Any] = {"growth_per_s": self.predicted_growth}
        if self.predicted is not None:
            predicted |= {"hz": self.predicted.hz, "amplitude_n": float(self.predicted.commands.max())}
        return {"name": self.name, "words": self.words, "simulated": found, "predicted": predicted}


def histories(
    structure: Structure,
    *,
    seconds: float = SECONDS,
    rate: float = RATE,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> list[History]:
    """Return time histories of the nominal loop and of one in which an own mode of a cable grows.

    The upper cable is solid wire as in the structure file, its own mode damped as little as steel wire is: nothing is
    set for 41 Hz. It starts at rest, and once more after a release of 1 N, as after additional excitation.

    Parameters
    ----------
    seconds : float
        Duration of each [s]; the nominal loop is run for `SHORT` at most.
    progress : callable or None
        Called with the simulated seconds done, of `simulated_seconds` in all.
    """
    law, parts = published_way(structure, "lqg", rate=rate).controller, bench(rate)
    nominal = build_fe_model(structure)
    words = f"first own mode of each cable, solid wire of damping ratio {WIRE_ZETA:g}"
    fe = add_string_modes(nominal, zeta=WIRE_ZETA)
    made: list[History] = []
    done = 0.0
    for name, text, model, release, duration in (
        (
            "nominal, released",
            "cables without modes of their own, released from 1 N",
            nominal,
            1.0,
            min(seconds, SHORT),
        ),
        ("cables swing, at rest", f"{words}, from rest", fe, 0.0, seconds),
        ("cables swing, released", f"{words}, released from 1 N", fe, 1.0, seconds),
    ):
        loop, before = loop_on(model, law, parts.converter), done
        report = None if progress is None else lambda now, before=before: progress(before + now)
        recording = time_history(model, law, parts, seconds=duration, release=release, seed=seed, progress=report)
        done += duration
        made.append(
            History(
                name=name,
                words=text,
                recording=recording,
                predicted_growth=loop.critical().growth,
                predicted=harmonic_balance(loop, parts.coil.limit),
            )
        )
    return made
