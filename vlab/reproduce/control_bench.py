"""The control tests of chapters 2 and 6 on the virtual bench: open and closed loop, analysis beside simulated experiment.

What stands on the bench is the structure as it can be built (its `physical` variant) in MuJoCo, under the laws that the
dissertation compares, with the hardware of the laboratory: unshielded leads, noise, steps of the converter, amplifiers with
a limit. What is compared with it is theory on the models that the laws are designed on, which are others: the `published`
variant, and on the grid Guyan's reduction corrected with a modal test of what stands on the bench.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vlab.controllers import Controller, lqdrf, lqg, mfdrf
from vlab.controllers.catalogue import published_way
from vlab.controllers.linear import LinearController
from vlab.design.published_tables import published_design
from vlab.design.state_model import state_model
from vlab.design.weights import noise_of, weights_of
from vlab.errors import BadExperiment, unknown_name
from vlab.fe.assembly import build_fe_model
from vlab.fe.correction import correct_model
from vlab.fe.damping import driven_modes
from vlab.fe.model import FeModel
from vlab.fe.reduction import guyan_reduction
from vlab.fe.second_order import Quantity
from vlab.hardware import Hardware, load_hardware
from vlab.lab.effort import ActuatorEffort
from vlab.lab.excitation import Multisine
from vlab.lab.experiment import Experiment, run_experiment
from vlab.lab.laws import published_law
from vlab.lab.prediction import closed_loop_response
from vlab.modal.frf import MeasuredFrequencyResponse, estimate_frf
from vlab.modal.modal_test import ModalTest, run_modal_test
from vlab.plants import Plant, build_plant
from vlab.plants.modal import build_modal
from vlab.reproduce.correction.measured_shapes import measured_at, measured_coordinates
from vlab.reproduce.study import Study
from vlab.signals import Array, FrequencyResponse, Recording

HARDWARE = (
    "leads.shielded=false",
    "velocity_sensor.noise=0.1mm/s",
    "displacement_probe.noise=1um",
    "converter.resolution=1mV",
    "coil.limit=2N",
)
"""What the bench has and the default laboratory has not; assumed, for the text gives no levels."""
LIMIT = 2.0
"""[N]; the amplifiers' limit above."""
PEAK = 4.0
"""The rms motion of the most mobile sensor is this share of half its linear travel, the rms force of the limit: a multisine
peaks at about four times its rms. Section 5.4.1: as high as possible within linear behaviour."""
LQG_RATE = 1000.0
"""Samples per second of LQG [Hz], section 5.3; direct feedback runs at the hardware's own."""
MEASURED_MODES = 11
"""Modes whose shapes correct the grid's Guyan reduction, section 3.3."""
KEPT_MODES = 40
"""Modes of what stands on the bench that its theory has; the grid's fine mesh has ten times as many coordinates."""
GRID_MODES = 20
"""Modes of the grid's modal plant: up to 20 Hz, twice the band."""


@dataclass(frozen=True, kw_only=True)
class BenchTest:
    """How a structure is tested.

    Parameters
    ----------
    band_hz : (low, high)
        Of the multisine.
    open_period_s, closed_period_s : float
        Its period, without and with control; one period settles, `periods` are measured.
    quantity : str
        What is measured: displacement by the probe, or velocity by the coils.
    plant : str
        What stands on the bench unless another plant is asked for.
    """

    band_hz: tuple[float, float]
    open_period_s: float
    closed_period_s: float
    quantity: Quantity
    plant: str
    periods: int = 2


TESTS = {
    "beam": BenchTest(
        band_hz=(0.5, 30.0), open_period_s=80.0, closed_period_s=20.0, quantity="displacement", plant="composite"
    ),
    "grid": BenchTest(
        band_hz=(0.2, 11.0), open_period_s=60.0, closed_period_s=20.0, quantity="velocity", plant="modal"
    ),
}
"""The tests of both structures. The grid's physical variant runs in modal coordinates unless the composite plant is asked
for, which takes six times as long."""
NAMES: dict[Quantity, str] = {"displacement": "probe", "velocity": "sensor"}


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopRun:
    """One simulated experiment of a control test.

    Parameters
    ----------
    law : Controller or None
        In the loop; None for the open loop.
    level : float
        Rms of the force added [N].
    response : MeasuredFrequencyResponse
        Of all sensors of the test's quantity.
    """

    law: Controller | None
    hardware: Hardware
    level: float
    recording: Recording
    response: MeasuredFrequencyResponse
    effort: tuple[ActuatorEffort, ...]


class ControlBench:
    """One structure on the bench, with the models and laws of its tests; each made once.

    Parameters
    ----------
    name : str
        ``"beam"`` or ``"grid"``.
    plant : str
        ``"composite"`` or ``"modal"``; that of `TESTS` by default.
    shorten : float
        Divides all periods, for a quick look; lines are coarser then.

    Raises
    ------
    UnknownName
        Another structure or plant.
    BadExperiment
        A seed or a factor out of range.
    """

    def __init__(
        self,
        name: str,
        *,
        plant: str = "",
        seed: int = 0,
        shorten: float = 1.0,
        progress: Callable[[str], None] = lambda text: None,
    ) -> None:
        if name not in TESTS:
            raise unknown_name("structure", name, TESTS, where="control test")
        if plant and plant not in ("composite", "modal"):
            raise unknown_name("plant", plant, ("composite", "modal"), where="control test")
        if seed < 0 or not 1 <= shorten <= 10:
            raise BadExperiment(
                f"seed {seed}, shortened {shorten}: accepted are whole numbers from 0 and factors from 1 to 10"
            )
        self.test, self.study, self.seed, self._shorten, self.progress = (
            TESTS[name],
            Study(name),
            seed,
            shorten,
            progress,
        )
        self.plant_name = plant or self.test.plant
        self._runs: dict[tuple[str, str], LoopRun] = {}

    @cached_property
    def built(self) -> FeModel:
        """The FE model of what stands on the bench."""
        return build_fe_model(self.study.structure, "physical")

    @cached_property
    def real(self) -> FeModel:
        """Its first modes; they set levels, tell where peaks are looked for, and predict what a release shows."""
        shapes = self.built.linear.eigen[1][:, :KEPT_MODES]
        names = [f"mode:{j + 1}" for j in range(shapes.shape[1])]
        return self.built.with_coordinates(self.built.linear.transformed(shapes, names), shapes)

    @cached_property
    def plant(self) -> Plant:
        """What stands on the bench."""
        if self.plant_name == "modal":
            return build_modal(self.built, modes=GRID_MODES if self.study.name == "grid" else 12)
        return build_plant(self.study.structure, self.plant_name, "physical")

    @cached_property
    def hardware(self) -> Hardware:
        """The bench's hardware."""
        return load_hardware(values=HARDWARE)

    def model(self, name: str) -> FeModel:
        """Return a model that theory is compared on: ``"full"``, ``"exact"``, or ``"corrected-guyan"`` as corrected here."""
        return self.corrected if name == "corrected-guyan" else self.study.fe(name)

    @cached_property
    def corrected(self) -> FeModel:
        """Guyan's reduction of the published model, corrected with the modes that the open-loop test of the bench shows."""
        fe, structure = self.study.fe(), self.study.structure
        keep = measured_coordinates(fe)
        self.progress("modes from the open-loop test")
        outputs = tuple(c.name for c in self.run().recording.channels if c.kind in ("velocity", "displacement"))
        test = run_modal_test([self.run().recording], ModalTest(outputs=outputs, band_hz=self.test.band_hz))
        measured, _ = measured_at(structure, test, keep, MEASURED_MODES)
        guyan = guyan_reduction(fe.linear, keep)
        rest = np.full(guyan.model.n, structure.damping.higher)
        damped = correct_model(guyan.model.with_modal_damping(rest), measured).model
        return fe.with_coordinates(damped, guyan.T)

    def law(self, name: str, model: str) -> Controller:
        """Return a law: with the printed gains where it was designed on the full or exact model, else designed on the
        corrected one as published."""
        structure = self.study.structure
        if model != "corrected-guyan":
            if name == "lqg":
                return published_way(structure, name, rate=LQG_RATE).controller
            return published_law(structure, name)
        fe, asked = self.model(model), published_design(structure.name, model)
        state = state_model(fe)
        weights = weights_of(asked, state)
        if name == "lqg":
            return lqg.design(state, weights, noise_of(asked, state), rate=LQG_RATE).controller
        if name == "mfdrf":
            return mfdrf.design(fe, damping=asked.zeta_min, modes=asked.damped_modes).controller
        diagonal = name == "lqdrf-diagonal"
        return lqdrf.design(
            fe, weights, shapes=asked.index_modes, diagonal=diagonal, damping=asked.zeta_min, modes=asked.damped_modes
        ).controller

    def run(self, law: str = "", model: str = "") -> LoopRun:
        """Return the simulated experiment under a law designed on a model; open loop without a law."""
        key = (law, model)
        if key not in self._runs:
            self._runs[key] = self._experiment(law, model)
        return self._runs[key]

    def _experiment(self, name: str, model: str) -> LoopRun:
        law = self.law(name, model) if name else None
        rate = getattr(law, "rate", None)
        hardware = self.hardware if rate is None else self.hardware.at_rate(rate)
        test = self.test
        period = (test.closed_period_s if name else test.open_period_s) / self._shorten
        low, high = test.band_hz
        level = self._level(law, hardware, period)
        self.progress(f"{self.study.name}, {name or 'open loop'}{f' ({model})' if name else ''}: experiment")
        result = run_experiment(
            Experiment(
                plant=self.plant,
                seconds=period * (1 + test.periods),
                excitation=Multisine(level=level, low_hz=low, high_hz=high, period_s=period, seed=self.seed),
                excite=self.study.structure.exciter,
                controller=law,
                hardware=hardware,
                seed=self.seed,
            )
        )
        kind = NAMES[test.quantity]
        outputs = [name for name in result.recording.names if name.startswith(f"{kind}:")]
        response = estimate_frf(result.recording, outputs=outputs, period_s=period, skip_s=period)
        return LoopRun(
            law=law,
            hardware=hardware,
            level=level,
            recording=result.recording,
            response=response.between(low, high),
            effort=result.effort,
        )

    def _level(self, law: Controller | None, hardware: Hardware, period: float) -> float:
        """Return the rms force that keeps sensors in their linear travel and the amplifier below its limit."""
        low, high = self.test.band_hz
        freq = np.arange(np.ceil(low * period), np.floor(high * period) + 1) / period
        places = [sensor.at for sensor in self.study.structure.sensor]
        moved = self._theory(self.real, law, hardware, freq, self.exciter, places, "displacement")[:, :, 0]
        largest = float(np.sqrt(np.mean(np.abs(moved) ** 2, axis=0)).max())
        return float(min(hardware.velocity_sensor.linear_range / 2 / largest, LIMIT) / PEAK)

    @property
    def exciter(self) -> str:
        """Where the force acts."""
        structure = self.study.structure
        return next(coil.at for coil in structure.coil if coil.name == structure.exciter)

    def modes_hz(self, model: str = "") -> Array:
        """Return the open-loop frequencies of a model's modes that the coils can drive; of the bench's own by default."""
        fe = self.model(model) if model else self.real
        return np.asarray(fe.linear.freq[driven_modes(fe.coils.T @ fe.linear.eigen[1])])

    def analysis(self, model: str, run: LoopRun, freq: Array, place: str) -> FrequencyResponse:
        """Return the response that theory predicts on a model under the law of a run, at `freq` [Hz]."""
        return self.theory(self.model(model), run, freq, place)

    def theory(self, fe: FeModel, run: LoopRun, freq: Array, place: str) -> FrequencyResponse:
        """Return the same on any model of the structure."""
        quantity = self.test.quantity
        H = self._theory(fe, run.law, run.hardware, freq, self.exciter, [place], quantity)
        name = f"{NAMES[quantity]}:{place}"
        unit = "m/N" if quantity == "displacement" else "m/s/N"
        return FrequencyResponse(freq=freq, H=H, outputs=(name,), inputs=run.response.inputs, unit=unit)

    def measured(self, run: LoopRun, place: str) -> FrequencyResponse:
        """Return the response of one sensor in a run."""
        i = run.response.outputs.index(f"{NAMES[self.test.quantity]}:{place}")
        coherence = run.response.coherence
        unit = "m/N" if self.test.quantity == "displacement" else "m/s/N"
        return FrequencyResponse(
            freq=run.response.freq,
            H=run.response.H[:, [i]],
            outputs=run.response.outputs[i : i + 1],
            inputs=run.response.inputs,
            unit=unit,
            coherence=None if coherence is None else coherence[:, [i]],
        )

    @staticmethod
    def _theory(
        fe: FeModel,
        law: Controller | None,
        hardware: Hardware,
        freq: Array,
        exciter: str,
        places: list[str],
        quantity: Quantity,
    ) -> Array:
        excited, rows = fe.deflections([exciter]).T, fe.deflections(places)
        if law is None:
            return fe.linear.frequency_response(freq, excited, rows, quantity=quantity).H
        if not isinstance(law, LinearController):
            raise BadExperiment(f"{type(law).__name__} is not linear: theory has no response of it")
        return closed_loop_response(
            fe.linear,
            fe.deflections(law.actuators).T,
            law,
            hardware.converter,
            freq,
            sensors=fe.deflections(law.sensors),
            excited=excited,
            outputs=rows,
            quantity=quantity,
        )


def dense_lines(low: float, high: float, modes_hz: Array) -> Array:
    """Return frequencies for a smooth analytical curve, closer around every resonance [Hz]."""
    near = [hz * (1 + 0.05 * np.sinh(np.linspace(-5, 5, 81)) / np.sinh(5)) for hz in modes_hz]
    freq = np.unique(np.concatenate([np.linspace(low, high, 800), *near]))
    return np.asarray(freq[(freq >= low) & (freq <= high)])
