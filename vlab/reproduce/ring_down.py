"""Releases on the bench: decay from a static force, by law."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from vlab.controllers import Controller
from vlab.lab.effort import ActuatorEffort
from vlab.lab.excitation import Release
from vlab.lab.experiment import Experiment, run_experiment
from vlab.lab.ring_down import Decay, LoopPoles, decays, loop_poles
from vlab.reproduce.control_bench import NAMES, ControlBench
from vlab.signals import Recording

SHARE = 0.8
"""SHARE [-]: initial motion of the most mobile sensor over half the linear travel."""
SECONDS = {"beam": (30.0, 8.0), "grid": (30.0, 20.0)}
"""SECONDS [s]: durations without and with control, in which the lightest damped mode falls to a third or less."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RingDown:
    """Release.

    Parameters
    ----------
    channel : str
        Drawn sensor.
    decays : tuple of Decay
        Identified modes beside the predicted poles.
    """

    law: str
    force: float
    channel: str
    recording: Recording
    poles: LoopPoles | None
    decays: tuple[Decay, ...]
    effort: tuple[ActuatorEffort, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, without the recording."""
        return {
            "law": self.law,
            "force_n": self.force,
            "modes": [part.as_dict() for part in self.decays],
            "effort": [part.as_dict() for part in self.effort],
        }


def ring_downs(bench: ControlBench, laws: dict[str, Controller | None]) -> tuple[RingDown, ...]:
    """Release the structure from the exciter under every law.

    Parameters
    ----------
    bench : ControlBench
        Bench.
    laws : dict
        Laws by name; None for the open loop.

    Returns
    -------
    tuple of RingDown
        One release per law.
    """
    structure, fe = bench.study.structure, bench.real
    moved = fe.deflections([s.at for s in structure.sensor]) @ np.linalg.solve(
        fe.linear.K, fe.deflection(bench.exciter)
    )
    force = SHARE * bench.hardware.velocity_sensor.linear_range / 2 / float(np.abs(moved).max())
    place = "30in" if bench.study.name == "beam" else bench.exciter
    free, controlled = SECONDS[bench.study.name]
    made = []
    for name, law in laws.items():
        rate = getattr(law, "rate", None)
        hardware = bench.hardware if rate is None else bench.hardware.at_rate(rate)
        bench.progress(f"{bench.study.name}, {name}: release")
        experiment = Experiment(
            plant=bench.plant,
            seconds=controlled if law else free,
            excitation=Release(level=force),
            excite=structure.exciter,
            controller=law,
            hardware=hardware,
            seed=bench.seed,
        )
        result = run_experiment(experiment)
        poles = loop_poles(fe, law, hardware)
        made.append(
            RingDown(
                law=name,
                force=force,
                channel=f"{NAMES[bench.test.quantity]}:{place}",
                recording=result.recording,
                poles=poles,
                decays=() if poles is None else decays(result.recording, poles),
                effort=result.effort,
            )
        )
    return tuple(made)
