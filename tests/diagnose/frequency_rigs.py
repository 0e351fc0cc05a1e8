"""Cases of frequency responses and modal tables with something hidden in them, computed without MuJoCo.

Three masses in a row (the rig of `rig_oscillator`) from its own equations of motion, and the beam from its FE model, where the
diagnosis starts from the composite plant in MuJoCo. All have benign errors of the nominal numbers, and noise.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rig_oscillator import CHAIN, DAMPING, MASS, STIFFNESS

from vlab.fe import build_fe_model
from vlab.structure.reader import load_structure

LINES = np.arange(1.0, 20.0, 0.04)
NOISE = 0.01


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """What is hidden in a case: effect and place as a diagnosis names them, and its parameters in SI."""

    effect: str
    place: str
    values: dict[str, float]


CHAIN_EFFECTS = {
    "none": Hidden(effect="none", place="", values={}),
    "added-mass": Hidden(effect="added-mass", place="joint:mass3", values={"mass": 0.25}),
    "lost-stiffness": Hidden(effect="lost-stiffness", place="tendon:spring2", values={"share": 0.3}),
    "grounded-spring": Hidden(effect="stiffness-to-ground", place="joint:mass3", values={"stiffness": 400.0}),
    "viscous-damping": Hidden(effect="viscous-damping", place="joint:mass2", values={"damping": 3.0}),
    "absorber": Hidden(
        effect="attached-oscillator",
        place="joint:mass2",
        values={"mass": 0.08, "frequency": 6.0, "damping_ratio": 0.02},
    ),
    "delay": Hidden(effect="actuator-delay", place="actuator:motor", values={"delay": 0.002}),
    "gain": Hidden(effect="sensor-gain", place="sensor:sensor2", values={"gain": 0.4}),
    "polarity": Hidden(effect="sensor-gain", place="sensor:sensor3", values={"gain": -2.0}),
}
"""Effects of the chain of three masses, by a short name."""
ROWS = {
    **{f"joint:mass{k + 1}": np.eye(3)[k] for k in range(3)},
    "tendon:spring2": np.array([-1.0, 1.0, 0.0]),
    "tendon:spring3": np.array([0.0, -1.0, 1.0]),
}


def chain_matrices(rng: np.random.Generator, benign: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return M, C and K of the chain with its nominal numbers a little off."""
    mass = MASS * np.exp(0.01 * benign * rng.standard_normal(3))
    spring = STIFFNESS * np.exp(0.02 * benign * rng.standard_normal(3))
    damper = DAMPING * np.exp(0.2 * benign * rng.standard_normal(3))
    relative = np.array([[1.0, 0, 0], [-1, 1, 0], [0, -1, 1]])
    return np.diag(mass), relative.T @ np.diag(damper) @ relative, relative.T @ np.diag(spring) @ relative


def chain_response(
    hidden: Hidden, lines: np.ndarray, force: np.ndarray, rng, benign: float, matrices=None
) -> np.ndarray:
    """Return the receptance of the three masses per unit force on the chain, (n, 3)."""
    M, C, K = chain_matrices(rng, benign) if matrices is None else matrices
    s = 2j * np.pi * lines
    dynamic = K + s[:, None, None] * C + (s**2)[:, None, None] * M
    v, row = hidden.values, ROWS.get(hidden.place)
    if hidden.effect == "added-mass":
        dynamic = dynamic + (v["mass"] * s**2)[:, None, None] * np.outer(row, row)
    elif hidden.effect == "lost-stiffness":
        dynamic = dynamic - v["share"] * STIFFNESS * np.outer(row, row)
    elif hidden.effect == "stiffness-to-ground":
        dynamic = dynamic + v["stiffness"] * np.outer(row, row)
    elif hidden.effect == "viscous-damping":
        dynamic = dynamic + (v["damping"] * s)[:, None, None] * np.outer(row, row)
    elif hidden.effect == "attached-oscillator":
        w, d = 2 * np.pi * v["frequency"], v["damping_ratio"]
        carried = v["mass"] * s**2 * (w**2 + 2 * d * w * s) / (s**2 + 2 * d * w * s + w**2)
        dynamic = dynamic + carried[:, None, None] * np.outer(row, row)
    elif hidden.effect == "fractional":  # not in the catalogue: a half-order spring between masses that no port joins
        row = np.array([1.0, 0.0, -1.0])
        dynamic = dynamic + (v["strength"] * np.sqrt(s))[:, None, None] * np.outer(row, row)
    H = np.linalg.solve(dynamic, np.broadcast_to(force.astype(complex), (len(lines), 3))[..., None])[..., 0]
    H = H * np.exp(0.01 * benign * rng.standard_normal(3))
    if hidden.effect == "actuator-delay":
        H = H * np.exp(-s * v["delay"])[:, None]
    if hidden.effect == "sensor-gain":
        H[:, int(hidden.place[-1]) - 1] *= 1.0 + v["gain"]
    return H


def write_chain(folder: Path, hidden: Hidden, *, seed: int = 0, benign: float = 1.0, noise: float = NOISE) -> None:
    """Write the case of the chain: responses to the motor, to fit at sensors 1 and 3, all of another run held out."""
    rng = np.random.default_rng([seed, 7])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.xml").write_text(CHAIN.format(sensors=SENSORS), encoding="utf-8")
    matrices = chain_matrices(rng, benign)
    H = chain_response(hidden, LINES, np.array([1.0, 0.0, 0.0]), rng, benign, matrices)
    text = [
        'title = "Three masses"',
        '[model]\nmjcf = "rig.xml"',
        "[model.uncertain]\nstiffness = 0.03\nmass = 0.02\ndamping = 0.3",
    ]
    for role in ("fit", "holdout"):
        size = noise * np.median(np.abs(H), axis=0)
        measured = H * (1 + 0.5 * noise * _complex(rng, H.shape)) + size * _complex(rng, H.shape)
        write_frf(folder / f"{role}.csv", LINES, measured)
        text.append(frf_text(f"{role}.csv", role, "motor", ["sensor1", "sensor2", "sensor3"]))
    (folder / "case.toml").write_text("\n".join(text) + "\n", encoding="utf-8")


SENSORS = "".join(f'<jointpos name="sensor{k}" joint="mass{k}"/>' for k in (1, 2, 3))


def _complex(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def write_frf(path: Path, lines: np.ndarray, H: np.ndarray) -> None:
    """Write responses as real and imaginary columns."""
    names = ["f", *(f"{part}{k + 1}" for k in range(H.shape[1]) for part in ("re", "im"))]
    columns = np.column_stack([lines, *(p for k in range(H.shape[1]) for p in (H[:, k].real, H[:, k].imag))])
    np.savetxt(path, columns, delimiter=",", header=",".join(names), comments="", fmt="%.9e")


def frf_text(file: str, role: str, source: str, outputs: list[str], form: str = "receptance", extra: str = "") -> str:
    """Return the [[frf]] table of a file by `write_frf`."""
    out = [
        f'[[frf]]\nfile = "{file}"\nrole = "{role}"\nform = "{form}"\ninput = "{source}"\noutputs = {outputs!r}'.replace(
            "'", '"'
        )
    ]
    out += [extra] if extra else []
    out += [
        f'[[frf.channel]]\ncolumn = "re{k + 1}"\nimaginary = "im{k + 1}"\nat = "{at}"' for k, at in enumerate(outputs)
    ]
    return "\n".join(out)


# ---- the beam -------------------------------------------------------------------------------------------------------

BEAM_EFFECTS = {
    "none": Hidden(effect="none", place="", values={}),
    "added-mass": Hidden(effect="added-mass", place="30in", values={"mass": 0.12}),
    "grounded-spring": Hidden(effect="stiffness-to-ground", place="40in", values={"stiffness": 120.0}),
    "lost-stiffness": Hidden(effect="lost-stiffness", place="beam:40in-50in", values={"share": 0.6}),
}
POINTS = ("base", "10in", "20in", "30in", "40in", "50in", "60in", "70in", "top")


def beam_model(hidden: Hidden, rng: np.random.Generator, benign: float):
    """Return the beam's FE model with something hidden in it, and the rows of its points."""
    from vlab.diagnose.parameters.structure import edited, structure_parameters

    structure = load_structure("beam")
    parameters = [p for p in structure_parameters(structure, {}, (), ()) if p.kind in ("stiffness", "mass", "tension")]
    off = np.array([0.3 * p.sd * benign * rng.standard_normal() for p in parameters])
    fe = build_fe_model(edited(structure, parameters, off))
    linear, rows = fe.linear, fe.deflections(POINTS)
    M, K = linear.M.copy(), linear.K.copy()
    if hidden.effect == "added-mass":
        row = fe.deflections([hidden.place])[0]
        M += hidden.values["mass"] * np.outer(row, row)
    elif hidden.effect == "stiffness-to-ground":
        row = fe.deflections([hidden.place])[0]
        K += hidden.values["stiffness"] * np.outer(row, row)
    elif hidden.effect == "lost-stiffness":  # one element of the mesh softer, not the rotation between two points
        start, stop = (float(p.removesuffix("in")) for p in hidden.place.removeprefix("beam:").split("-"))
        K -= hidden.values["share"] * _element(linear, start, stop, structure)
    zeta = linear.zeta * np.exp(0.1 * benign * rng.standard_normal(linear.n))
    whole = type(linear)(M=M, C=np.zeros_like(M), K=K, coordinates=linear.coordinates).with_modal_damping(zeta)
    return whole, rows


def _element(linear, start: float, stop: float, structure) -> np.ndarray:
    """Return the bending stiffness of one Hermite element of the beam between two points."""
    length, bar = (stop - start) * 0.0254, next(b for b in structure.bar if b.name == "beam")
    names = [f"v:{start:.0f}in", f"rx:{start:.0f}in", f"v:{stop:.0f}in", f"rx:{stop:.0f}in"]
    places = [list(linear.coordinates).index(n) for n in names]
    turn = length * np.sign(linear.K[places[0], places[3]])  # the sense in which the model counts rotations
    k = np.array(
        [
            [12, 6 * turn, -12, 6 * turn],
            [6 * turn, 4 * turn**2, -6 * turn, 2 * turn**2],
            [-12, -6 * turn, 12, -6 * turn],
            [6 * turn, 2 * turn**2, -6 * turn, 4 * turn**2],
        ]
    )
    out = np.zeros_like(linear.K)
    out[np.ix_(places, places)] = structure.section[bar.section].bending_stiffness / length**3 * k
    return out


def write_beam(folder: Path, hidden: Hidden, *, kind: str = "frf", seed: int = 0, benign: float = 1.0) -> None:
    """Write a case of the beam: mobilities from two coils at three points (the other coil held out), or modal tables."""
    rng = np.random.default_rng([seed, 11])
    folder.mkdir(parents=True, exist_ok=True)
    linear, rows = beam_model(hidden, rng, benign)
    text = ['title = "Beam"', '[model]\nstructure = "beam"']
    if kind == "frf":
        lines = np.arange(0.5, 26.0, 0.05)
        outputs = ["base", "20in", "40in"]
        own = [POINTS.index(o) for o in outputs]
        for source, role in (("base", "fit"), ("40in", "fit"), ("20in", "holdout")):
            H = linear.frequency_response(lines, rows[[POINTS.index(source)]].T, rows[own]).H[:, :, 0]
            H = H * np.exp(0.005 * benign * rng.standard_normal(3))
            size = NOISE * np.median(np.abs(H), axis=0)
            write_frf(folder / f"{source}.csv", lines, H + size * _complex(rng, H.shape))
            text.append(frf_text(f"{source}.csv", role, source, outputs, "mobility"))
    else:
        freq, zeta = linear.freq[:6], linear.zeta[:6]
        shapes = rows @ linear.eigen[1][:, :6]
        shapes = shapes / np.abs(shapes).max(axis=0)
        for role in ("fit", "holdout"):
            f = freq * np.exp(0.001 * rng.standard_normal(6))
            z = zeta * np.exp(0.1 * rng.standard_normal(6))
            p = shapes + 0.01 * rng.standard_normal(shapes.shape)
            part = [f'[[modal]]\nrole = "{role}"', f"frequency_hz = {f.tolist()}", f"zeta = {z.tolist()}"]
            part += [f"frequency_sd_hz = {(0.001 * freq).tolist()}", f"zeta_sd = {(0.1 * zeta).tolist()}"]
            part += [f"at = {list(POINTS)!r}".replace("'", '"'), f"shape = {p.T.tolist()}", f"shape_sd = {[0.01] * 6}"]
            text.append("\n".join(part))
    (folder / "case.toml").write_text("\n".join(text) + "\n", encoding="utf-8")
