"""The whole story on the beam, in one page: cross-check, controlled experiment, and a real recording beside its model."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controllers import DirectRateFeedback
from vlab.assets import asset
from vlab.cases.compare import Comparison, compare_case
from vlab.lab.analysis import analytical_response, measured_response
from vlab.lab.experiment import Result, run_experiment
from vlab.lab.prediction import predict_rate_feedback
from vlab.lab.run_folder import PreparedRun, RunSettings
from vlab.modal.frf import MeasuredFrequencyResponse
from vlab.modal.poles import PoleEstimate, estimate_poles
from vlab.reproduce.cross_check import CrossCheck, cross_check
from vlab.reproduce.tables import ReproducedTable, reproduce_tables
from vlab.signals import Array, FrequencyResponse

BAND = (0.3, 30.0)
OPEN_LOOP_S = 120.0
"""The lightest mode takes 21 s to decay to a third: long enough for it to settle in the first half."""
CASES = ("cases/avc_cantilever/free_decay.toml", "cases/avc_cantilever/closed_loop_identified_observer.toml")


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopTest:
    """One experiment of the demo with what theory says of it."""

    label: str
    prepared: PreparedRun
    result: Result
    frf: MeasuredFrequencyResponse
    analytical: FrequencyResponse
    displacement: MeasuredFrequencyResponse
    analytical_displacement: FrequencyResponse
    poles: PoleEstimate | None = None
    predicted_freq: Array | None = None
    predicted_zeta: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Demo:
    """Everything that the demo found."""

    tables: list[ReproducedTable]
    check: CrossCheck
    open_loop: LoopTest
    closed_loop: LoopTest
    comparisons: list[Comparison]
    seconds: float

    def damping_rows(self) -> list[list[Any]]:
        """Return predicted and identified closed-loop frequencies and damping ratios, mode by mode."""
        test = self.closed_loop
        assert test.poles is not None
        assert test.predicted_freq is not None
        assert test.predicted_zeta is not None
        return [
            [i + 1, f, test.poles.freq[i], z, test.poles.zeta[i], 100 * (test.poles.zeta[i] / z - 1)]
            for i, (f, z) in enumerate(zip(test.predicted_freq, test.predicted_zeta, strict=True))
        ]


def run_demo(*, progress: Callable[[str], None] = lambda text: None) -> Demo:
    """Run the demo; about a minute on two cores."""
    begun = time.perf_counter()
    progress("published tables")
    tables = reproduce_tables(["1", "3", "5", "7", "8", "9"])
    settings = RunSettings(
        structure="beam", level=0.1, low_hz=BAND[0], high_hz=BAND[1], period_s=20.0, seconds=60.0, seed=1
    )
    prepared = settings.prepare()
    progress("FE model against MuJoCo plants")
    check = cross_check(prepared.structure)
    progress("open-loop experiment")
    open_loop = _experiment("open loop", replace(settings, seconds=OPEN_LOOP_S).prepare())
    progress("experiment with the published MFDRF law in the loop")
    closed_loop = _identified(_experiment("MFDRF", replace(settings, law="mfdrf").prepare()))
    progress("real recordings of the AVC cantilever beside their model")
    comparisons = [compare_case(asset(case)) for case in CASES]
    return Demo(
        tables=tables,
        check=check,
        open_loop=open_loop,
        closed_loop=closed_loop,
        comparisons=comparisons,
        seconds=time.perf_counter() - begun,
    )


def _experiment(label: str, prepared: PreparedRun) -> LoopTest:
    result = run_experiment(prepared.experiment)
    recording = result.recording
    measured = [measured_response(recording, kind) for kind in ("velocity", "displacement")]
    assert measured[0] is not None, "whole periods were run"
    assert measured[1] is not None
    expected = [
        analytical_response(prepared, recording, measured[0].freq, kind) for kind in ("velocity", "displacement")
    ]
    assert expected[0] is not None, "the law is a static gain"
    assert expected[1] is not None
    return LoopTest(
        label=label,
        prepared=prepared,
        result=result,
        frf=measured[0],
        analytical=expected[0],
        displacement=measured[1],
        analytical_displacement=expected[1],
    )


def _identified(test: LoopTest) -> LoopTest:
    """Add the closed-loop poles, identified from the time histories and predicted by the sampled loop."""
    law, fe = test.prepared.law, test.prepared.fe_model()
    assert isinstance(law, DirectRateFeedback)
    rate = test.prepared.hardware.converter.rate
    poles = estimate_poles(test.frf, sample_rate=rate, band_hz=BAND, n_modes=6, orders=range(10, 31, 4))
    loop = predict_rate_feedback(fe.linear, fe.deflections(law.sensors).T, law.gains, test.prepared.hardware.converter)
    freq, zeta = loop.modes(np.asarray(fe.linear.freq[:6]))
    return replace(test, poles=poles, predicted_freq=freq, predicted_zeta=zeta)
