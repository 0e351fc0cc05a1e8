"""Stepped-sine responses of two masses at several levels, by direct integration of their equations of motion.

A leapfrog scheme of its own integrates all lines and levels at once, from rest to the steady state. Dry friction is an
impulse that stops a port at most. The last cycles give the first harmonic.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from frequency_rigs import frf_text, write_frf

TWO = """<mujoco model="two masses">
  <option timestep="0.0005" gravity="0 0 0"/>
  <worldbody>
    <body name="mass1"><joint name="mass1" type="slide" axis="1 0 0" stiffness="2000" damping="1.0"/>
      <geom type="box" size=".05 .05 .05" mass="1"/></body>
    <body name="mass2" pos="0.3 0 0"><joint name="mass2" type="slide" axis="1 0 0"/>
      <geom type="box" size=".05 .05 .05" mass="1"/></body>
  </worldbody>
  <tendon><fixed name="spring" stiffness="1500" damping="1.0">
    <joint joint="mass1" coef="-1"/><joint joint="mass2" coef="1"/></fixed></tendon>
  <actuator><motor name="motor" joint="mass1"/></actuator>
  <sensor><jointpos name="sensor1" joint="mass1"/><jointpos name="sensor2" joint="mass2"/></sensor>
</mujoco>
"""
ROWS = {"joint:mass1": (1.0, 0.0), "joint:mass2": (0.0, 1.0), "tendon:spring": (-1.0, 1.0)}
LINES = np.concatenate([np.linspace(3.0, 6.5, 30), np.linspace(8.6, 11.5, 24)])
PER_CYCLE, CYCLES, LAST = 200, 100, 4


@dataclass(frozen=True, kw_only=True)
class Law:
    """A law at a port: name in the catalogue, place and parameters."""

    effect: str = "none"
    place: str = "joint:mass2"
    values: tuple[float, ...] = ()


LAWS = {
    "none": Law(),
    "coulomb": Law(effect="coulomb-friction", values=(0.2,)),
    "drag": Law(effect="quadratic-drag", values=(6.0,)),
    "hardening": Law(effect="cubic-stiffness", values=(1.5e5,)),
    "softening": Law(effect="cubic-stiffness", values=(-6e4,)),
    "jenkins": Law(effect="jenkins-slip", place="tendon:spring", values=(1.2, 0.004)),
}


def steady_response(law: Law, lines: np.ndarray, amplitude, matrices) -> np.ndarray:
    """Return the first harmonic of both masses per unit force, (n, 2); the amplitude may differ from line to line."""
    M, C, K = matrices
    h = 1.0 / lines / PER_CYCLE
    n, row = len(lines), np.array(ROWS[law.place])
    x, v, memory = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(n)
    left = np.linalg.inv(M[None] + 0.5 * h[:, None, None] * C[None])
    right = M[None] - 0.5 * h[:, None, None] * C[None]
    mobility = left @ row  # velocity per unit impulse
    out, amplitude = np.zeros((n, 2), dtype=complex), np.broadcast_to(amplitude, n)
    for k in range(PER_CYCLE * CYCLES):
        phase = 2 * np.pi * k / PER_CYCLE
        load = np.zeros((n, 2)) - x @ K
        load[:, 0] += amplitude * np.cos(phase)
        z, rate = x @ row, v @ row
        p = law.values
        if law.effect == "cubic-stiffness":
            load -= (p[0] * z**3)[:, None] * row
        elif law.effect == "quadratic-drag":
            load -= (p[0] * rate * np.abs(rate))[:, None] * row
        elif law.effect == "jenkins-slip":
            memory = np.clip(memory + h * rate / p[1], -1.0, 1.0)
            load -= (p[0] * memory)[:, None] * row
        v = (left @ ((right @ v[..., None]) + h[:, None, None] * load[..., None]))[..., 0]
        if law.effect == "coulomb-friction":
            stop = (v @ row) / (mobility @ row)
            v = v - np.clip(stop, -h * p[0], h * p[0])[:, None] * mobility
        x = x + h[:, None] * v
        if k >= PER_CYCLE * (CYCLES - LAST):
            out += x * np.exp(-1j * (phase + 2 * np.pi / PER_CYCLE))
    return 2 * out / (PER_CYCLE * LAST) / amplitude[:, None]


def two_matrices(rng: np.random.Generator, benign: float):
    """Return M, C and K of the two masses with nominal numbers a little off."""
    one, two = np.array([2000.0, 1500.0]) * np.exp(0.01 * benign * rng.standard_normal(2))
    c = np.exp(0.1 * benign * rng.standard_normal(2))
    relative = np.array([[1.0, 0.0], [-1.0, 1.0]])
    return np.eye(2), relative.T @ np.diag(c) @ relative, relative.T @ np.diag([one, two]) @ relative


def write_levels(
    folder: Path, law: Law, *, levels=(0.5, 1.0, 2.0, 4.0), held=(1.0,), seed: int = 0, noise: float = 0.005
) -> None:
    """Write a case of two masses with responses at several levels [N rms], some of them held out."""
    rng = np.random.default_rng([seed, 23])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.xml").write_text(TWO, encoding="utf-8")
    matrices = two_matrices(rng, 1.0)
    known = "[model.uncertain]\nstiffness = 0.03\nmass = 0.02\ndamping = 0.3"
    text = ['title = "Two masses"', '[model]\nmjcf = "rig.xml"', known]
    every = steady_response(law, np.tile(LINES, len(levels)), np.sqrt(2) * np.repeat(levels, len(LINES)), matrices)
    for k, (level, H) in enumerate(zip(levels, np.split(every, len(levels)), strict=True)):
        size = noise * np.median(np.abs(H), axis=0)
        H = H * (1 + noise * _complex(rng, H.shape)) + size * _complex(rng, H.shape)
        write_frf(folder / f"level{k}.csv", LINES, H)
        role = "holdout" if level in held else "fit"
        text.append(frf_text(f"level{k}.csv", role, "motor", ["sensor1", "sensor2"], extra=f"level = {level}"))
    (folder / "case.toml").write_text("\n".join(text) + "\n", encoding="utf-8")


def _complex(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def write_noise(folder: Path, friction: float, *, levels=(1.0, 2.0, 4.0, 8.0), held=(2.0,), seed: int = 0) -> None:
    """Write responses to noise of several levels [N rms], with dry friction on the second mass.

    The noise is periodic. The second period is recorded, and averages over realisations give H1.
    """
    rng = np.random.default_rng([seed, 29])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.xml").write_text(TWO, encoding="utf-8")
    M, C, K = two_matrices(rng, 1.0)
    h, n, each = 1 / 400, 8000, 24
    lines = np.fft.rfftfreq(n, h)
    band = (lines >= 2.0) & (lines <= 14.0)
    spectrum = np.where(band, 1.0, 0.0) * _complex(rng, (len(levels) * each, len(lines)))
    force = np.fft.irfft(spectrum, n, axis=1)
    force *= (np.repeat(levels, each) / force.std(axis=1))[:, None]
    left = np.linalg.inv(M + 0.5 * h * C)
    step, mobility = left @ (M - 0.5 * h * C), left[1, 1]
    x, v = np.zeros((len(force), 2)), np.zeros((len(force), 2))
    motion = np.zeros((len(force), n, 2))
    for k in range(2 * n):
        load = -x @ K
        load[:, 0] += force[:, k % n]
        v = v @ step.T + h * load @ left.T
        v = v - np.clip(v[:, 1] / mobility, -h * friction, h * friction)[:, None] * left[:, 1]
        x = x + h * v
        motion[:, k % n] = x
    F = np.split(np.fft.rfft(force, axis=1)[:, band], len(levels))
    X = np.split(np.fft.rfft(motion, axis=1)[:, band], len(levels))
    text = ['[model]\nmjcf = "rig.xml"\n[model.uncertain]\nstiffness = 0.03\nmass = 0.02\ndamping = 0.3']
    for i, level in enumerate(levels):
        H = np.einsum("rfo,rf->fo", X[i], F[i].conj()) / np.sum(np.abs(F[i]) ** 2, axis=0)[:, None]
        H = H * np.exp(-2j * np.pi * lines[band] * h)[:, None]  # the motion belongs to the end of a step
        write_frf(folder / f"level{i}.csv", lines[band], H)
        role = "holdout" if level in held else "fit"
        extra = f'level = {level}\nexcitation = "random"'
        text.append(frf_text(f"level{i}.csv", role, "motor", ["sensor1", "sensor2"], extra=extra))
    (folder / "case.toml").write_text("\n".join(text) + "\n", encoding="utf-8")
