"""A chain of three masses with everything that the tests of physics need: a case, its twin, runs in MuJoCo."""

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from vlab.cases.case import Case, load_case
from vlab.cases.channel_map import Run
from vlab.cases.initial_state import InitialState
from vlab.cases.simulate import simulate
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.problem import Problem
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import effect_named

RATE, SECONDS = 1000.0, 1.5

CHAIN = """<mujoco model="chain">
  <option timestep="{step}" gravity="0 0 0" integrator="{integrator}"><flag contact="disable"/></option>
  <worldbody>
    <body name="a"><joint name="a" type="{kind}" axis="{axis}" stiffness="900" damping="0.6"/>{inertia}
      <body name="b"><joint name="b" type="{kind}" axis="{axis}" stiffness="700" damping="0.5"/>{inertia}
        <body name="c"><joint name="c" type="{kind}" axis="{axis}" stiffness="500" damping="0.4"/>{inertia}
        </body>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="whole"><joint joint="a" coef="1"/><joint joint="b" coef="1"/></fixed></tendon>
  <actuator><motor name="push" joint="a"/><motor name="pull" joint="c"/></actuator>
  <sensor>
    <jointpos name="pos_a" joint="a"/><jointpos name="pos_c" joint="c"/><jointvel name="vel_b" joint="b"/>
  </sensor>
</mujoco>
"""
INERTIA = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'


@dataclass(frozen=True, eq=False)
class ChainRig:
    """The rig as a case, its search problem and one run; its files go when it goes."""

    case: Case
    problem: Problem
    run: Run
    files: TemporaryDirectory[str]
    known: dict[str, np.ndarray] = field(default_factory=dict)

    def in_mujoco(self, effects: list[tuple[str, str, dict[str, float]]]) -> np.ndarray:
        """Return all channels with effects in MuJoCo, (n_samples, n_channels)."""
        if repr(effects) not in self.known:
            self.known[repr(effects)] = self._simulated(effects)
        return self.known[repr(effects)]

    def _simulated(self, effects: list[tuple[str, str, dict[str, float]]]) -> np.ndarray:
        plant = attach(self.case.plant, [Attached(effect_named(n), at, p) for n, at, p in effects])
        rest = InitialState(qpos=plant.rest, qvel=np.zeros(plant.model.nv), how="rest")
        out = simulate(plant, self.run, initial=rest).recording
        return out.select(list(self.problem.names)).data

    def in_reduced_model(self, effects: list[tuple[str, str, dict[str, float]]]) -> np.ndarray:
        """Return the same from the reduced model, (n_samples, n_channels)."""
        refiner = object.__new__(LeastSquares)  # the simulation alone, without what a fit needs
        refiner.problem, refiner.reduced_model = self.problem, self.problem.reduced_model
        refiner.highest = float(np.abs(refiner.reduced_model.omega).max()) / (2 * np.pi)
        places = {name: p for p in self.problem.places for name in (p.name, *p.aliases)}
        terms = [Term(effect=effect_named(n), place=places[at], values=p) for n, at, p in effects]
        values = [{k: np.array([v]) for k, v in p.items()} for _, _, p in effects]
        m, runs = self.problem.reduced_model.m, [self.problem.signals[0]]
        return refiner.simulate(
            runs, terms, np.zeros((1, len(self.problem.reduced_model.changes))), values, np.zeros((1, 1, 2 * m))
        )[:, 0, 0]


@lru_cache(maxsize=8)
def chain_rig(*, kind: str = "slide", step: float = 5e-4, integrator: str = "Euler") -> ChainRig:
    """Return the chain, driven by two multisines from rest."""
    files = TemporaryDirectory(prefix="vlab-chain-")
    case = _chain_case(Path(files.name), kind, step, integrator)
    problem = prepare(case)
    return ChainRig(case, problem, problem.runs[0], files)


def _chain_case(folder: Path, kind: str, step: float, integrator: str) -> Case:
    rng = np.random.default_rng(7)
    axis = "1 0 0" if kind == "slide" else "0 0 1"
    text = CHAIN.format(step=step, integrator=integrator, kind=kind, axis=axis, inertia=INERTIA)
    (folder / "rig.xml").write_text(text, encoding="utf-8")
    t = np.arange(int(RATE * SECONDS)) / RATE
    lines = np.arange(1, 30) / 3.0
    unit = "N" if kind == "slide" else "N m"
    commands = {
        name: size * np.sin(2 * np.pi * np.outer(t, lines) + rng.uniform(0, 2 * np.pi, lines.size)).sum(axis=1)
        for name, size in (("push", 2.0), ("pull", 0.8))
    }
    outputs = dict.fromkeys(("pos_a", "pos_c", "vel_b"), commands["push"] * 1e-3)  # only their band counts here
    pq.write_table(pa.table({**commands, **outputs}), folder / "run.parquet")
    angular = kind == "hinge"
    kinds = {"pos_a": "angle" if angular else "displacement", "vel_b": "angular-velocity" if angular else "velocity"}
    units = {"pos_a": "rad" if angular else "m", "vel_b": "rad/s" if angular else "m/s"}
    toml = [
        '[model]\nmjcf = "rig.xml"\n[[recording]]\nfile = "run.parquet"\nrole = "fit"\nrate_hz = 1000.0\ninitial = "rest"'
    ]
    for name in commands:
        toml.append(
            f'[[recording.channel]]\ncolumn = "{name}"\nat = "{name}"\nkind = "{"moment" if angular else "force"}"\n'
            f'unit = "{unit}"\ninput = true\nhold = "zero"'
        )
    for name in outputs:
        like = "vel_b" if name == "vel_b" else "pos_a"
        toml.append(
            f'[[recording.channel]]\ncolumn = "{name}"\nat = "{name}"\nkind = "{kinds[like]}"\nunit = "{units[like]}"'
        )
    (folder / "case.toml").write_text("\n".join(toml) + "\n", encoding="utf-8")
    return load_case(folder)


SERVO = '<position name="push" joint="a" gear="2" kp="40" kv="0.8" forcerange="-30 30"{}/>'
"""A servo in place of the first motor; its commands are the motor's forces as lengths, 20 times as small."""
FILTER_OF_SERVO = ' timeconst="0.01"'


def servoed(folder: Path, servo: str) -> Case:
    """Return the case of a folder with a servo in place of the first motor."""
    model, text = (folder / "rig.xml").read_text(), (folder / "case.toml").read_text()
    model = model.replace('<joint name="a"', '<joint name="a" armature="0.4"')
    (folder / "rig.xml").write_text(model.replace('<motor name="push" joint="a"/>', servo))
    as_force, as_command = 'kind = "force"\nunit = "N"', 'kind = "command"\nunit = "m"\nscale = 0.05'
    (folder / "case.toml").write_text(text.replace(as_force, as_command, 1))
    return load_case(folder)


PORT_VALUES: dict[str, tuple[str, dict[str, float]]] = {
    "added-mass": ("joint:b", {"mass": 0.2}),
    "lost-stiffness": ("joint:b", {"share": 0.2}),
    "stiffness-to-ground": ("tendon:whole", {"stiffness": 80.0}),
    "magnetic-negative-stiffness": ("joint:a", {"stiffness": 60.0}),
    "viscous-damping": ("joint:b", {"damping": 1.5}),
    "quadratic-drag": ("joint:a", {"coefficient": 8.0}),
    "cubic-stiffness": ("joint:a", {"k3": 4e5}),
    "cubic-quintic-stiffness": ("joint:a", {"k3": 2e5, "k5": 1e9}),
    "string-stiffness": ("joint:a", {"stiffness": 100.0, "bend": 5e-3}),
    "quadratic-stiffness": ("joint:a", {"k2": 8e3}),
    "quadratic-cubic-stiffness": ("joint:a", {"k2": 5e3, "k3": 2e5}),
    "coulomb-friction": ("joint:a", {"force": 1.5}),
    "smooth-friction": ("joint:a", {"force": 1.0, "rise": 0.05}),
    "stribeck-friction": ("joint:a", {"force": 1.0, "excess": 0.8, "speed": 0.1}),
    "lugre-friction": ("joint:a", {"force": 1.0, "bristle": 2e-3, "excess": 0.5, "speed": 0.1}),
    "dead-band": ("joint:a", {"stiffness": 500.0, "gap": 4e-3}),
    "stop": ("joint:a", {"stiffness": 2000.0, "gap": 8e-3}),
    "one-sided-stiffness": ("joint:a", {"stiffness": 400.0, "gap": 3e-3}),
    "force-offset": ("joint:b", {"force": 2.0}),
    "sinusoidal-force": ("joint:b", {"sine": 1.0, "cosine": 0.7, "frequency": 6.0}),
    "cogging": ("joint:a", {"sine": 2.0, "cosine": -1.0, "pitch": 6e-3}),
    "jenkins-slip": ("joint:a", {"force": 2.0, "slip": 4e-3}),
    "iwan-slip": ("joint:a", {"force": 2.0, "limit": 8e-3, "exponent": 0.6}),
    "bouc-wen": ("joint:a", {"force": 2.0, "yield": 4e-3}),
    "plastic-set": ("joint:a", {"stiffness": 300.0, "yield": 8e-3}),
    "drifting-stiffness": ("joint:a", {"rate": 100.0}),
    "attached-oscillator": ("tendon:whole", {"mass": 0.1, "frequency": 4.0, "damping_ratio": 0.02}),
    "structural-damping": ("joint:b", {"loss": 60.0, "centre": 4.0}),
    "coil-force-over-travel": ("joint:a", {"loss": 150.0}),
    "rotary-inertia": ("joint:b", {"inertia": 0.2}),
    "unknown-law": (
        "joint:a",
        {
            "reach": 8e-3,
            "speed": 0.2,
            **{f"displacement_{side}_{k}": 0.2 * k for side in ("positive", "negative") for k in (1, 2, 3)},
            **{f"velocity_{side}_{k}": 0.5 / k for side in ("positive", "negative") for k in (1, 2, 3)},
        },
    ),
}
"""Of every effect at ports but tension-error: a place on the chain and values that show."""

CHANNEL_VALUES: dict[str, tuple[str, dict[str, float]]] = {
    "actuator-gain": ("actuator:push", {"gain": 0.1}),
    "actuator-offset": ("actuator:push", {"offset": 2.0}),
    "actuator-clipping": ("actuator:push", {"limit": 10.0}),
    "soft-saturation": ("actuator:push", {"limit": 15.0}),
    "actuator-dead-zone": ("actuator:push", {"threshold": 2.0}),
    "slew-limit": ("actuator:push", {"slope": 150.0}),
    "rate-limit": ("actuator:push", {"slope": 150.0}),
    "actuator-delay": ("actuator:push", {"delay": 2.4e-3}),
    "actuator-hysteresis": ("actuator:push", {"growth": 0.02, "limit": 10.0}),
    "actuator-lag": ("actuator:push", {"time_constant": 5e-3}),
    "actuator-quantisation": ("actuator:push", {"step": 4.0}),
    "actuator-hold": ("actuator:push", {"period": 7e-3}),
    "actuator-jitter": ("actuator:push", {"jitter": 3e-3}),
    "sensor-gain": ("sensor:pos_a", {"gain": 0.1}),
    "sensor-offset": ("sensor:pos_a", {"offset": 2e-3}),
    "sensor-drift": ("sensor:pos_a", {"rate": 1e-3}),
    "sensor-clipping": ("sensor:pos_a", {"limit": 8e-3}),
    "sensor-soft-saturation": ("sensor:pos_a", {"limit": 8e-3}),
    "sensor-delay": ("sensor:pos_a", {"delay": 2.4e-3}),
    "sensor-lag": ("sensor:pos_a", {"time_constant": 5e-3}),
    "sensor-high-pass": ("sensor:pos_a", {"time_constant": 0.3}),
    "sensor-quantisation": ("sensor:pos_a", {"step": 3e-3}),
    "mains-hum": ("sensor:pos_a", {"sine": 1e-3, "cosine": 5e-4, "frequency": 50.0}),
    "sensor-resonance": ("sensor:pos_a", {"frequency": 40.0, "damping_ratio": 0.05}),
    "crosstalk": ("sensor:pos_a/push", {"share": 1e-4}),
    "cross-axis": ("sensor:pos_a/pos_c", {"share": 0.1}),
    "misplaced-sensor": ("sensor:pos_a/pos_c", {"share": 0.1}),
}
"""Of every effect on actuators and sensors, the same."""

OF_SERVOS = {
    "servo-position-gain": {"gain": -0.3},
    "servo-velocity-gain": {"gain": 0.5},
    "servo-torque-constant": {"gain": -0.2},
    "servo-integral-gain": {"rate": 4.0},
    "servo-error-dead-zone": {"threshold": 0.1},
    "servo-force-limit": {"limit": 8.0},
    "servo-soft-force-limit": {"limit": 8.0},
    "servo-torque-speed-line": {"limit": 12.0, "speed": 0.5},
    "servo-load-friction": {"share": 0.2, "rise": 0.05},
    "servo-backlash": {"gap": 0.02, "stiffness": 800.0, "damping_ratio": 0.1, "motor_share": 0.5},
    "servo-compliance": {"stiffness": 200.0, "damping_ratio": 0.1, "motor_share": 1.0},
}
"""Of every effect within a servo: values that show."""
