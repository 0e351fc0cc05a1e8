"""Time histories of the 41 Hz study (section 6.1), beside predictions.

MuJoCo simulates the loop with the amplifier limit.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlab.controllers import Controller
from vlab.controllers.catalogue import published_controller
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
"""LIMIT [N]: largest force of an amplifier; assumed, for the text gives none."""
NOISE = 1e-6
"""NOISE [m/s]: rms noise of the velocity sensors, the seed of a limit cycle; assumed."""
SECONDS, SHORT = 240.0, 60.0
"""SECONDS, SHORT [s]: durations of the growing experiments and the nominal one; section 6.1 states two or three minutes."""
MODES = 16
"""MODES [-]: modes of the simulated plant, up to 250 Hz, above the controller's own 92 Hz."""


def simulated_seconds(seconds: float = SECONDS) -> float:
    """Return the simulated time of `histories` [s]."""
    return 2 * seconds + min(seconds, SHORT)


def bench(rate: float = RATE, *, limit: float = LIMIT, noise: float = NOISE) -> Hardware:
    """Return the laboratory's hardware with amplifier limit and noise.

    Parameters
    ----------
    rate : float
        Sample rate [Hz].
    limit : float
        Amplifier limit [N].
    noise : float
        Sensor noise [m/s], rms.

    Returns
    -------
    Hardware
        Hardware.
    """
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
    """Simulate the modal plant of a model in MuJoCo.

    Parameters
    ----------
    fe : FeModel
        FE model.
    law : Controller
        Control law.
    hardware : Hardware
        Hardware of the laboratory.
    seconds : float
        Duration [s].
    release : float
        Static force at the base before the start [N]; zero for a start at rest.
    seed : int
        Seed of the noise.
    progress : callable or None
        Receives the simulated time [s].

    Returns
    -------
    Recording
        Recording.
    """
    plant = build_modal(fe, modes=MODES, timestep=0.5 / hardware.converter.rate)
    excitation = Release(level=release) if release else None
    experiment = Experiment(
        plant=plant, seconds=seconds, controller=law, hardware=hardware, seed=seed, excitation=excitation, excite="base"
    )
    return run_experiment(experiment, progress=progress).recording


def levels_of(recording: Recording, channel: str, *, window: float = 1.0) -> tuple[Array, Array]:
    """Return middles of windows [s] and the rms in each."""
    n = round(window * recording.rate)
    x = recording[channel][: len(recording) // n * n].reshape(-1, n)
    return (np.arange(len(x)) + 0.5) * window, np.sqrt(np.mean(x**2, axis=1))


def growth(recording: Recording, channel: str, *, window: float = 1.0) -> dict[str, float]:
    """Return final level, frequency, growth rate and rise time of a vibration.

    Levels are rms values over windows. The growth is fitted between 1 % and 33 % of the final level; NaN without such
    a stretch.

    Parameters
    ----------
    recording : Recording
        Recording.
    channel : str
        Name of the channel.
    window : float
        Length of a window [s].

    Returns
    -------
    dict
        Values by name.
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
    """Simulated experiment beside its prediction.

    Parameters
    ----------
    predicted_growth : float
        Growth rate of the least stable pole [1/s].
    predicted : LimitCycle or None
        Harmonic balance; None for a stable loop.
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
    """Return histories of the nominal loop and of a growing mode.

    The upper cable is solid wire as in the structure file, with the damping of steel wire. Nothing is tuned to 41 Hz.
    One run starts at rest, another after a release of 1 N, as after additional excitation.

    Parameters
    ----------
    structure : Structure
        Structure.
    seconds : float
        Duration of each run [s]; at most `SHORT` for the nominal loop.
    rate : float
        Sample rate [Hz].
    seed : int
        Seed of the noise.
    progress : callable or None
        Receives the simulated time [s], of `simulated_seconds` in all.

    Returns
    -------
    list of History
        Experiments with predictions.
    """
    law, parts = published_controller(structure, "lqg", rate=rate), bench(rate)
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
