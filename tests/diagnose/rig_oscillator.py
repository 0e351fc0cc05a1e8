"""Three masses in a row with one hidden effect of many, integrated without MuJoCo.

Between samples the linear part moves exactly (matrix exponential) and the force of the effect is a second-order
predictor-corrector; dry friction is the impulse that stops the motion, as far as it reaches. All recordings run at once.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rig_folder import Channel, Record, Rig, multisine, write_case
from scipy.linalg import expm
from scipy.signal import chirp

RATE, SECONDS, SUBSTEPS = 500.0, 20.0, 4
MASS, STIFFNESS, DAMPING = 1.0, 2000.0, 2.0
"""Of each mass and each spring [kg, N/m, N s/m]: 3.2, 8.9 and 12.8 Hz with 1.0, 2.8 and 4.0 %."""
NOISE = 0.005
LEVELS = (1.0, 2.0, 4.0)
"""Rms of the force in the recordings to fit [N]."""

CHAIN = """<mujoco model="three masses">
  <option timestep="0.001" integrator="RK4" gravity="0 0 0"><flag contact="disable"/></option>
  <default>
    <joint type="slide" axis="1 0 0"/>
    <geom type="box" size="0.05 0.05 0.05" mass="1"/>
    <tendon stiffness="2000" damping="2" springlength="0"/>
  </default>
  <worldbody>
    <body name="mass1"><joint name="mass1"/><geom/></body>
    <body name="mass2" pos="0.3 0 0"><joint name="mass2"/><geom/></body>
    <body name="mass3" pos="0.6 0 0"><joint name="mass3"/><geom/></body>
  </worldbody>
  <tendon>
    <fixed name="spring1"><joint joint="mass1" coef="1"/></fixed>
    <fixed name="spring2"><joint joint="mass1" coef="-1"/><joint joint="mass2" coef="1"/></fixed>
    <fixed name="spring3"><joint joint="mass2" coef="-1"/><joint joint="mass3" coef="1"/></fixed>
  </tendon>
  <actuator><motor name="motor" joint="mass1"/></actuator>
  <sensor>{sensors}</sensor>
</mujoco>
"""

Force = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Force on a place from its displacement and velocity, one each recording; positive pushes along the displacement."""


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A hidden effect: where it sits and its parameters at size 1, SI."""

    place: str
    parameters: dict[str, float]
    grows: str = ""  # the parameter that the size multiplies; the first one by default

    def at(self, size: float) -> dict[str, float]:
        grows = self.grows or next(iter(self.parameters), "")
        return {name: value * (size if name == grows else 1.0) for name, value in self.parameters.items()}


EFFECTS = {
    "none": Effect(place="", parameters={}),
    "coulomb-friction": Effect(place="joint:mass2", parameters={"force": 0.2}),
    "viscous-damping": Effect(place="joint:mass3", parameters={"damping": 0.5}),
    "quadratic-drag": Effect(place="joint:mass3", parameters={"coefficient": 6.0}),
    "cubic-stiffness": Effect(place="tendon:spring2", parameters={"k3": 4e6}),
    "quadratic-stiffness": Effect(place="tendon:spring1", parameters={"k2": 6e4}),
    "dead-band": Effect(place="tendon:spring3", parameters={"gap": 2e-4}),
    "jenkins-slip": Effect(place="tendon:spring2", parameters={"force": 0.4, "slip": 1.3e-3}),
    "plastic-set": Effect(place="tendon:spring2", parameters={"yield": 0.006}),
    "one-sided-stiffness": Effect(place="joint:mass3", parameters={"stiffness": 1000.0, "gap": 0.006}),
    "detent": Effect(place="joint:mass2", parameters={"force": 1.5, "pitch": 0.0007}),
    "added-mass": Effect(place="joint:mass2", parameters={"mass": 0.05}),
    "lost-stiffness": Effect(place="tendon:spring3", parameters={"share": 0.1}),
    "actuator-clipping": Effect(place="actuator:motor", parameters={"limit": 2.5}),
    "actuator-gain": Effect(place="actuator:motor", parameters={"gain": 0.15}),
    "actuator-delay": Effect(place="actuator:motor", parameters={"delay": 0.008}),
    "sensor-gain": Effect(place="sensor:sensor2", parameters={"gain": 0.15}),
    "sensor-polarity": Effect(place="sensor:sensor3", parameters={}),
    "mains-hum": Effect(place="sensor:sensor2", parameters={"share": 0.3, "frequency": 50.0}),
    "sensor-offset": Effect(place="sensor:sensor1", parameters={"share": 0.3}),
}
"""By name, as in `vlab effects` (a wrong polarity is a sensor gain of -2 there; the catalogue has no detent). The share of hum (rms) and offset is
of the channel's rms at the middle level; `oscillator_case` gives their size in metres."""


def _row(place: str) -> np.ndarray:
    """Return what a joint or a spring measures of the three displacements."""
    number = int(place[-1]) - 1
    row = np.zeros(3)
    row[number] = 1.0
    if place.startswith("tendon:") and number:
        row[number - 1] = -1.0
    return row


def _jenkins(force: float, slip: float) -> Callable[..., np.ndarray]:
    """Return a spring in series with a dry slider; its memory moves on with every accepted step."""
    slider, stiffness = np.zeros(1), force / slip

    def law(d: np.ndarray, v: np.ndarray, accept: bool = False) -> np.ndarray:
        nonlocal slider
        pull = np.clip(stiffness * (d - slider), -force, force)
        if accept:
            slider = d - pull / stiffness
        return -pull

    return law


def _law(name: str, p: dict[str, float], stiffness: float) -> Force | None:
    """Return the force of an effect, or None where it is not a force or is dry friction."""
    laws: dict[str, Force] = {
        "viscous-damping": lambda d, v: -p["damping"] * v,
        "quadratic-drag": lambda d, v: -p["coefficient"] * np.abs(v) * v,
        "cubic-stiffness": lambda d, v: -p["k3"] * d**3,
        "quadratic-stiffness": lambda d, v: -p["k2"] * d**2,
        "dead-band": lambda d, v: stiffness * np.clip(d, -p["gap"], p["gap"]),
        "detent": lambda d, v: -p["force"] * np.sin(d / p["pitch"]) * np.exp(-((d / (3 * p["pitch"])) ** 2)),
        "one-sided-stiffness": lambda d, v: -p["stiffness"] * np.maximum(d - p["gap"], 0.0),
    }
    if name == "plastic-set":  # the whole spring slips, in place of the one that does not
        own = _jenkins(stiffness * p["yield"], p["yield"])
        return lambda d, v, accept=False: stiffness * d + own(d, v, accept)
    return _jenkins(**p) if name == "jenkins-slip" else laws.get(name)


@dataclass(frozen=True, kw_only=True)
class _Chain:
    """Masses, spring stiffnesses and dampings, and the gain of the motor."""

    masses: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    gain: float

    def matrices(self, step: float, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the exact move of [x, x'] over a step and what constant forces of motor and effect add to it."""
        springs = np.array([_row(f"tendon:spring{i}") for i in (1, 2, 3)])
        inverse = np.diag(1 / self.masses)
        A = np.zeros((8, 8))
        A[:3, 3:6] = np.eye(3)
        A[3:6, :3] = -inverse @ (springs.T * self.stiffness) @ springs
        A[3:6, 3:6] = -inverse @ (springs.T * self.damping) @ springs
        A[3:6, 6], A[3:6, 7] = inverse[0] * self.gain, inverse @ row
        move = expm(A * step)
        return move[:6, :6], move[:6, 6:]


def _integrate(chain: _Chain, u: np.ndarray, row: np.ndarray, law: Force | None, dry: float) -> np.ndarray:
    """Return displacements and velocities, (samples, 6, recordings), of forces held between samples (samples, recordings)."""
    move, drive = chain.matrices(1 / (RATE * SUBSTEPS), row)
    push, pull = drive[:, :1], drive[:, 1:]
    at, speed = np.concatenate([row, np.zeros(3)]), np.concatenate([np.zeros(3), row])
    stop = float(speed @ pull[:, 0])
    x = np.zeros((6, u.shape[1]))
    out = np.zeros((u.shape[0], 6, u.shape[1]))
    has_memory = law is not None and law.__defaults__ is not None
    for k in range(u.shape[0]):
        out[k] = x
        forced = push * u[k]
        for _ in range(SUBSTEPS):
            free = move @ x + forced
            if dry:
                free += pull * np.clip(-(speed @ free) / stop, -dry, dry)
            elif law is not None:
                now = law(at @ x, speed @ x)
                ahead = free + pull * now
                free += pull * (0.5 * (now + law(at @ ahead, speed @ ahead)))
                if has_memory:
                    law(at @ free, speed @ free, True)  # type: ignore[call-arg]
            x = free
    return out


def _excitation(rng: np.random.Generator) -> tuple[list[tuple[str, str]], np.ndarray]:
    """Return name and role of the recordings, and their commands in columns."""
    time = np.arange(round(SECONDS * RATE)) / RATE
    named = [(f"multisine {level:g} N", "fit") for level in LEVELS]
    columns = [multisine(rng, 0.5, 25.0, SECONDS / 2, level)(time) for level in LEVELS]
    named += [("sweep", "holdout"), ("other multisine", "holdout")]
    columns += [3.0 * chirp(time, 0.5, SECONDS, 20.0, phi=-90), multisine(rng, 0.5, 25.0, SECONDS / 2, 3.0)(time)]
    return named, np.column_stack(columns)


def _built(rng: np.random.Generator, benign: float) -> _Chain:
    """Return a chain as it was built: 2 % off in stiffness, mass and gain, 20 % in damping, times `benign`."""
    return _Chain(
        masses=MASS * (1 + 0.02 * benign * rng.standard_normal(3)),
        stiffness=STIFFNESS * (1 + 0.02 * benign * rng.standard_normal(3)),
        damping=DAMPING * (1 + 0.2 * benign * rng.standard_normal(3)),
        gain=1 + 0.02 * benign * rng.standard_normal(),
    )


def _commanded(name: str, p: dict[str, float], u: np.ndarray) -> np.ndarray:
    """Return the force that the actuator makes of the commands."""
    if name == "actuator-clipping":
        return np.clip(u, -p["limit"], p["limit"])
    if name == "actuator-gain":
        return u * (1 + p["gain"])
    if name == "actuator-delay":
        late = np.arange(len(u)) - p["delay"] * RATE
        return np.array([np.interp(late, np.arange(len(u)), column, left=0.0) for column in u.T]).T
    return u


def _sensed(name: str, p: dict[str, float], place: str, y: np.ndarray) -> np.ndarray:
    """Return what the sensors give, (samples, 3, recordings); a share is turned into metres in `p`."""
    y = y.copy()
    if not place.startswith("sensor:"):
        return y
    i = int(place[-1]) - 1
    if "share" in p:
        p["offset" if name == "sensor-offset" else "amplitude"] = p.pop("share") * float(y[:, i, 1].std())
    if name == "sensor-gain":
        y[:, i] *= 1 + p["gain"]
    elif name == "sensor-polarity":
        y[:, i] *= -1
    elif name == "mains-hum":
        time = np.arange(len(y))[:, None] / RATE
        y[:, i] += np.sqrt(2) * p["amplitude"] * np.sin(2 * np.pi * p["frequency"] * time)
    elif name == "sensor-offset":
        y[:, i] += p["offset"]
    return y


def oscillator_case(
    folder: Path | str,
    *,
    effect: str = "none",
    size: float = 1.0,
    seed: int = 0,
    place: str = "",
    sensors: str = "displacement",
    benign: float = 1.0,
) -> Rig:
    """Write the case of three masses on springs, the first one driven, all three measured.

    20 s at 500 Hz, from rest: multisines of 1, 2 and 4 N rms to fit; a sweep and another multisine held out. The nominal
    parameters are 2 % off (damping 20 %), the noise is 0.5 % of each channel's rms.

    Parameters
    ----------
    effect : str
        One of `EFFECTS`.
    size : float
        Multiplies the first parameter of the effect; of clipping it divides the limit.
    place : str
        ``joint:mass1`` to ``joint:mass3``, ``tendon:spring1`` to ``tendon:spring3``, ``actuator:motor``,
        ``sensor:sensor1`` to ``sensor:sensor3``; as in `EFFECTS` by default.
    sensors : str
        ``"displacement"`` or ``"velocity"``.
    benign : float
        Multiplies the errors of the nominal parameters.
    """
    hidden = EFFECTS[effect]
    place = place or hidden.place
    p = hidden.at(1 / size if effect == "actuator-clipping" else size)
    rng = np.random.default_rng([seed, 3])
    chain = _built(rng, benign)
    named, commands = _excitation(rng)
    row, at = np.zeros(3), 0
    if place.startswith(("joint:", "tendon:")):
        row, at = _row(place), int(place[-1]) - 1
    if effect == "added-mass":
        chain = replace(chain, masses=chain.masses + p["mass"] * row)
    if effect == "lost-stiffness":
        chain = replace(chain, stiffness=chain.stiffness * (1 - p["share"] * (np.arange(3) == at)))
    law = _law(effect, p, float(chain.stiffness[at]))
    dry = p["force"] if effect == "coulomb-friction" else 0.0
    states = _integrate(chain, _commanded(effect, p, commands), row, law, dry)
    y = _sensed(effect, p, place, states[:, :3] if sensors == "displacement" else states[:, 3:])
    y += NOISE * y.std(axis=0) * rng.standard_normal(y.shape)
    records = [
        Record(
            name=name,
            role=role,
            columns={"force": commands[:, i], **{f"y{j + 1}": y[:, j, i] for j in range(3)}},
            rate_hz=RATE,
        )
        for i, (name, role) in enumerate(named)
    ]
    _write(Path(folder), sensors, records)
    return Rig(folder=Path(folder), effect=effect, place=place, parameters=p)


def _write(folder: Path, sensors: str, records: list[Record]) -> None:
    kind = {"displacement": "jointpos", "velocity": "jointvel"}[sensors]
    measured = "".join(f'<{kind} name="sensor{i}" joint="mass{i}"/>' for i in (1, 2, 3))
    unit = {"displacement": "m", "velocity": "m/s"}[sensors]
    write_case(
        folder,
        title="Three masses",
        mjcf=CHAIN.format(sensors=measured),
        uncertain={"stiffness": 0.02, "mass": 0.02, "damping": 0.2, "gain": 0.02},
        channels=[
            Channel(column="force", at="motor", kind="force", unit="N", is_input=True, hold="zero"),
            *[Channel(column=f"y{i}", at=f"sensor{i}", kind=sensors, unit=unit) for i in (1, 2, 3)],
        ],
        records=records,
    )
