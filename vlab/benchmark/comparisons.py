"""Computing times beside the usual tools, measured in one run."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from vlab.benchmark.designs import design_timings
from vlab.benchmark.stepping import cpu_times, linear_times, replay_times, shortest, stepping_times
from vlab.cases.case import load_case
from vlab.controllers import Controller, LinearLaw
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.inference.window_least_squares import WindowLeastSquares
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.fe import FeModel, build_fe_model
from vlab.files.assets import asset
from vlab.hardware import Hardware, load_hardware
from vlab.hardware.output_chain import OutputChain
from vlab.lab import Experiment, run_experiment
from vlab.lab.excitation import Multisine
from vlab.lab.laws import published_law
from vlab.plants import build_plant
from vlab.plants.modal import build_modal
from vlab.proof.peers.mujoco_sysid import HAS_SYSID, fit_all_numbers
from vlab.reproduce.study import Study
from vlab.signals import Array
from vlab.structure import load_structure

REFITS = 3
"""REFITS [1]: turns of the refit; a diagnosis of minutes has one."""
OURS_S, PEER_S = 10.0, 1.0
"""OURS_S, PEER_S [s]: simulated durations; the peer is a hundred times slower."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """Comparison of elapsed times.

    Times are elapsed seconds per simulated second. Where `work` says so, or without a real-time factor, they are CPU
    seconds.
    """

    work: str
    ours_s: float
    peer: str
    peer_s: float
    ratio: float
    real_time_factor: float | None = None


def run_bench(*, progress: Callable[[str], None] = lambda text: None) -> list[Row]:
    """Time the beam's plants beside scipy's `solve_ivp`.

    Parameters
    ----------
    progress : callable
        Receives the present work.

    Returns
    -------
    list of Row
        One row per comparison.
    """
    structure, hardware = load_structure("beam"), load_hardware()
    law, fe = published_law(structure, "mfdrf"), build_fe_model(structure)
    excitation = Multisine(level=0.2, period_s=10.0, seed=1)
    progress("scipy solve_ivp on the FE state space")
    peer_s = shortest(lambda: integrate_with_scipy(fe, hardware, law, excitation, seconds=PEER_S), 2) / PEER_S
    rows = []
    for name in ("composite", "modal"):
        progress(f"{name} plant")
        plant = build_plant(structure, name)
        experiment = Experiment(
            plant=plant, seconds=OURS_S, excitation=excitation, excite="base", controller=law, hardware=hardware
        )
        ours_s = shortest(lambda: run_experiment(experiment), 6) / OURS_S  # noqa: B023 - called at once
        rows.append(
            Row(
                work=f"beam, {name} plant, MFDRF at 2 kHz with delay and filter, per simulated second",
                ours_s=ours_s,
                peer="scipy solve_ivp (RK45, rtol 1e-6) on the FE state space, same law and hardware",
                peer_s=peer_s,
                ratio=peer_s / ours_s,
                real_time_factor=1.0 / ours_s,
            )
        )
    rows += stepping_rows(progress)
    progress("one tick of a 24-state LQG")
    rows += [tick_row(), *design_rows(progress)]
    if not HAS_SYSID:
        progress("no refit to real recordings, for lack of its peer: pip install 'vlab-vibration[peers]'")
        return rows
    progress("a refit to real recordings, and a whole diagnosis, some minutes")
    return [*rows, *refit_rows()]


def stepping_rows(progress: Callable[[str], None] = lambda text: None) -> list[Row]:
    """Time experiments beside bare steps of MuJoCo and beside python-control.

    Beside bare steps the ratio is at most one.

    Parameters
    ----------
    progress : callable
        Receives the present work.

    Returns
    -------
    list of Row
        One row per plant, in CPU seconds.
    """
    return [
        Row(
            work=t.work,
            ours_s=t.ours_s,
            peer=t.peer,
            peer_s=t.peer_s,
            ratio=t.ratio,
            real_time_factor=1.0 / t.ours_s,
        )
        for t in (
            *stepping_times(progress=progress),
            *linear_times(progress=progress),
            *replay_times(progress=progress),
        )
    ]


def refit_rows() -> list[Row]:
    """Time calibration and diagnosis of a real rig.

    The peer mujoco.sysid fits the same parameters. Its model contains dry friction by hand.
    """
    case = load_case(asset("cases/emps/case.toml"))

    def refit() -> None:
        screen = ScoreTest(prepare(case))
        windows = WindowLeastSquares(screen)
        LeastSquares(screen).fit((), windows.fit())

    out = []
    for work, ours, runs, peer, theirs in (
        (
            "positioning system: mass, damping and gain calibrated on 25 s of recording, CPU seconds",
            refit,
            REFITS,
            "mujoco.sysid, the same parameters and recording",
            partial(fit_all_numbers, case, kinds=("mass", "damping", "gain")),
        ),
        (
            "the whole diagnosis of it: what is missing, named and verified, CPU seconds",
            lambda: diagnose(case),
            1,
            "mujoco.sysid, all numbers of the model and of the sensors free",
            partial(fit_all_numbers, case),
        ),
    ):
        ours_s, peer_s, ratio = cpu_times(ours, theirs, runs, is_warm=runs == 1)
        out.append(Row(work=work, ours_s=ours_s, peer=peer, peer_s=peer_s, ratio=ratio))
    return out


def design_rows(progress: Callable[[str], None] = lambda text: None) -> list[Row]:
    """Time the control designs [s per design]."""
    return [
        Row(work=t.work, ours_s=t.ours_s, peer=t.peer, peer_s=t.peer_s, ratio=t.ratio)
        for t in design_timings(progress=progress)
    ]


class PlainObserver:
    """Discrete law in plain numpy: four matrix products a sample."""

    def __init__(self, law: LinearLaw) -> None:
        self.sensors, self.actuators = law.sensors, law.actuators
        self.A, self.B, self.C, self.D = law.matrices
        self.reset()

    def reset(self) -> None:
        """Start from a zero state."""
        self.x = np.zeros(len(self.A))

    def step(self, y: Array) -> Array:
        """Return the commands after one sample.

        u = C x + D y,  x+ = A x + B y
        """
        u = self.C @ self.x + self.D @ y
        self.x = self.A @ self.x + self.B @ y
        return u


def tick_row() -> Row:
    """Time one sample of a 24-state LQG.

    The loop runs on the modal plant of the grid with the law and without it. The tick is the difference divided by
    the number of samples.
    """
    study = Study("grid")
    law = study.lqg("exact").controller
    hardware = load_hardware().at_rate(law.rate or 1000.0)
    plant = build_modal(study.fe("full"), modes=12, timestep=1.0 / hardware.converter.rate)

    def seconds(controller: Controller | None) -> float:
        experiment = Experiment(plant=plant, seconds=OURS_S, hardware=hardware, controller=controller)
        return shortest(lambda: run_experiment(experiment), 5) / OURS_S

    open_s = seconds(None)
    ours_s, peer_s = seconds(law) - open_s, seconds(PlainObserver(law)) - open_s
    tick = ours_s / hardware.converter.rate
    return Row(
        work=f"one control tick of a {len(law.A)}-state LQG in the loop ({1e6 * tick:.1f} us), times {hardware.converter.rate:g}",
        ours_s=ours_s,
        peer="the same loop with a plain numpy observer of four products",
        peer_s=peer_s,
        ratio=peer_s / ours_s,
        real_time_factor=1.0 / ours_s,
    )


def as_document(rows: list[Row]) -> dict[str, Any]:
    """Return plain data for JSON."""
    return {"rows": [asdict(row) for row in rows]}


def integrate_with_scipy(
    fe: FeModel, hardware: Hardware, law: Controller, excitation: Multisine, *, seconds: float
) -> Array:
    """Run the same loop with scipy, sample by sample.

    A user without vlab writes a state-space model, calls `solve_ivp` from sample to sample, and evaluates the law
    between calls. Law, output chain and excitation are those of the plants, so the result is an independent check.

    Parameters
    ----------
    fe : FeModel
        FE model.
    hardware : Hardware
        Hardware of the laboratory.
    law : Controller
        Control law.
    excitation : Multisine
        Excitation.
    seconds : float
        Duration [s].

    Returns
    -------
    array
        Sampled velocities, (n_samples, n_sensors) [m/s].
    """
    places = list(law.sensors)
    coils = fe.deflections(places).T
    A, B, C, _ = fe.linear.state_matrices(coils, coils.T)
    added = fe.linear.state_matrices(fe.deflection(fe.structure.exciter)[:, None], coils.T)[1][:, 0]
    rate = hardware.converter.rate
    chain = OutputChain(hardware.converter, channels=len(places))
    law.reset()
    x, samples = np.zeros(len(A)), round(seconds * rate)
    y = np.zeros((samples, len(places)))
    times = (np.arange(samples) + 0.5) / rate
    signal = excitation.sample(times)
    for k in range(samples):
        y[k] = C @ x
        drive = B @ chain.push(law.step(y[k]))[0] + added * signal[k]
        x = solve_ivp(
            lambda t, x, drive=drive: A @ x + drive, (0.0, 1.0 / rate), x, method="RK45", rtol=1e-6, atol=1e-12
        ).y[:, -1]
    return y
