"""Control tests of chapters 2 and 6: analysis beside simulated experiment.

The bench holds the structure as it can be built (its `physical` variant) in MuJoCo, under the laws of the
dissertation. The hardware is that of the laboratory: unshielded leads, noise, converter steps, limited amplifiers.
The analysis uses the design models of the laws. These are the `published` variant, and on the grid Guyan's reduction
corrected by a modal test of the bench.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vlab.controllers import Controller, lqdrf, lqg, mfdrf
from vlab.controllers.catalogue import published_controller
from vlab.controllers.linear import LinearController
from vlab.design.published_tables import published_design
from vlab.design.state_model import state_model
from vlab.design.weights import noise_of, weights_of
from vlab.errors import BadExperiment, unknown_name
from vlab.fe.assembly import build_fe_model
from vlab.fe.correction import correct_model
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
"""HARDWARE: settings of the bench beyond the default laboratory; assumed, for the text gives no levels."""
LIMIT = 2.0
"""LIMIT [N]: amplifier limit of `HARDWARE`."""
PEAK = 4.0
"""PEAK [-]: divisor from half the linear travel to the rms motion of the most mobile sensor, and from the limit to the
rms force. A multisine peaks at about four times its rms. Section 5.4.1 demands the highest level with linear
behaviour."""
LQG_RATE = 1000.0
"""LQG_RATE [Hz]: sample rate of LQG, section 5.3; direct feedback runs at the rate of the hardware."""
MEASURED_MODES = 11
"""MEASURED_MODES [-]: modes whose shapes correct the grid's Guyan reduction, section 3.3."""
KEPT_MODES = 40
"""KEPT_MODES [-]: modes in the theory of the bench; the grid's fine mesh has ten times as many coordinates."""
GRID_MODES = 20
"""GRID_MODES [-]: modes of the grid's modal plant, up to 20 Hz, twice the band."""


@dataclass(frozen=True, kw_only=True)
class BenchTest:
    """Settings of the tests of a structure.

    Parameters
    ----------
    band_hz : (low, high)
        Band of the multisine [Hz].
    open_period_s, closed_period_s : float
        Period of the multisine without and with control [s]; one period settles, `periods` are measured.
    quantity : str
        Measured quantity: displacement by the probe, or velocity by the coils.
    plant : str
        Default plant of the bench.
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
"""TESTS: tests of both structures. The grid's physical variant runs in modal coordinates by default; the composite plant
takes six times as long."""
NAMES: dict[Quantity, str] = {"displacement": "probe", "velocity": "sensor"}


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopRun:
    """Simulated experiment of a control test.

    Parameters
    ----------
    law : Controller or None
        Law in the loop; None for the open loop.
    level : float
        Rms of the added force [N].
    response : MeasuredFrequencyResponse
        Response of all sensors of the test's quantity.
    """

    law: Controller | None
    hardware: Hardware
    level: float
    recording: Recording
    response: MeasuredFrequencyResponse
    effort: tuple[ActuatorEffort, ...]


class ControlBench:
    """Structure on the bench, with cached models and laws of its tests.

    Parameters
    ----------
    name : str
        ``"beam"`` or ``"grid"``.
    plant : str
        ``"composite"`` or ``"modal"``; that of `TESTS` by default.
    shorten : float
        Divisor of all periods, for a quick run with coarser lines.

    Raises
    ------
    UnknownName
        The structure or plant is unknown.
    BadExperiment
        A seed or a factor is out of range.
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
        """FE model of the structure on the bench."""
        return build_fe_model(self.study.structure, "physical")

    @cached_property
    def real(self) -> FeModel:
        """First modes of the structure on the bench.

        They set the levels, locate peaks and predict releases.
        """
        shapes = self.built.linear.eigen[1][:, :KEPT_MODES]
        names = [f"mode:{j + 1}" for j in range(shapes.shape[1])]
        return self.built.with_coordinates(self.built.linear.transformed(shapes, names), shapes)

    @cached_property
    def plant(self) -> Plant:
        """Plant on the bench."""
        if self.plant_name == "modal":
            return build_modal(self.built, modes=GRID_MODES if self.study.name == "grid" else 12)
        return build_plant(self.study.structure, self.plant_name, "physical")

    @cached_property
    def hardware(self) -> Hardware:
        """Hardware of the bench."""
        return load_hardware(values=HARDWARE)

    def model(self, name: str) -> FeModel:
        """Return a model of the theory by name.

        Names are ``"full"``, ``"exact"``, and ``"corrected-guyan"`` as corrected on the bench.
        """
        return self.corrected if name == "corrected-guyan" else self.study.fe(name)

    @cached_property
    def corrected(self) -> FeModel:
        """Guyan's reduction, corrected by the open-loop test of the bench."""
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
        """Return a law for a design model.

        Printed gains apply to designs on the full or exact model. Other laws are designed on the corrected model as
        published.

        Parameters
        ----------
        name : str
            Name of the law.
        model : str
            Design model.

        Returns
        -------
        Controller
            Control law.
        """
        structure = self.study.structure
        if model != "corrected-guyan":
            if name == "lqg":
                return published_controller(structure, name, rate=LQG_RATE)
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
        """Return the simulated experiment under a law."""
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
        """Return the largest rms force within linear travel and limit."""
        low, high = self.test.band_hz
        freq = np.arange(np.ceil(low * period), np.floor(high * period) + 1) / period
        places = [sensor.at for sensor in self.study.structure.sensor]
        moved = self._theory(self.real, law, hardware, freq, self.exciter, places, "displacement")[:, :, 0]
        largest = float(np.sqrt(np.mean(np.abs(moved) ** 2, axis=0)).max())
        return float(min(hardware.velocity_sensor.linear_range / 2 / largest, LIMIT) / PEAK)

    @property
    def exciter(self) -> str:
        """Place of the force."""
        structure = self.study.structure
        return next(coil.at for coil in structure.coil if coil.name == structure.exciter)

    def modes_hz(self, model: str = "") -> Array:
        """Return open-loop frequencies of the drivable modes [Hz]."""
        fe = self.model(model) if model else self.real
        return np.asarray(fe.linear.freq[fe.measured])

    def analysis(self, model: str, run: LoopRun, freq: Array, place: str) -> FrequencyResponse:
        """Return the predicted response under the law of a run."""
        return self.theory(self.model(model), run, freq, place)

    def theory(self, fe: FeModel, run: LoopRun, freq: Array, place: str) -> FrequencyResponse:
        """Return the predicted response on any model of the structure.

        Parameters
        ----------
        fe : FeModel
            Model of the structure.
        run : LoopRun
            Experiment with its law.
        freq : array
            Frequencies [Hz].
        place : str
            Place of the response.

        Returns
        -------
        FrequencyResponse
            Response at the place.
        """
        quantity = self.test.quantity
        H = self._theory(fe, run.law, run.hardware, freq, self.exciter, [place], quantity)
        name = f"{NAMES[quantity]}:{place}"
        unit = "m/N" if quantity == "displacement" else "m/s/N"
        return FrequencyResponse(freq=freq, H=H, outputs=(name,), inputs=run.response.inputs, unit=unit)

    def measured(self, run: LoopRun, place: str) -> FrequencyResponse:
        """Return the response of one sensor in a run.

        Parameters
        ----------
        run : LoopRun
            Experiment.
        place : str
            Place of the sensor.

        Returns
        -------
        FrequencyResponse
            Measured response.
        """
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
    """Return frequencies for a smooth curve, dense around resonances [Hz]."""
    near = [hz * (1 + 0.05 * np.sinh(np.linspace(-5, 5, 81)) / np.sinh(5)) for hz in modes_hz]
    freq = np.unique(np.concatenate([np.linspace(low, high, 800), *near]))
    return np.asarray(freq[(freq >= low) & (freq <= high)])
