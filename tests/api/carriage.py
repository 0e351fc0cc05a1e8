"""Runs of a carriage on a spring, exact between samples, and its MuJoCo model with too little damping."""

import numpy as np
from scipy.signal import cont2discrete

MODEL = """<mujoco model="carriage">
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody><body name="carriage">
    <joint name="slide" type="slide" axis="1 0 0" stiffness="400" damping="1"/>
    <geom name="block" type="box" size="0.05 0.05 0.05" mass="1"/>
  </body></worldbody>
  <actuator><motor name="motor" joint="slide"/></actuator>
  <sensor><jointpos name="encoder" joint="slide"/><jointvel name="tacho" joint="slide"/></sensor>
</mujoco>"""
STEP, SAMPLES = 0.002, 2000
MASS, STIFFNESS, KNOWN, HIDDEN = 1.0, 400.0, 1.0, 5.0
"""HIDDEN [N s/m]: viscous damping that the model lacks, beside KNOWN."""


def run(seed, damping=KNOWN + HIDDEN, noise=1e-6):
    """Return times [s], force [N] and position [m]; the force is held between samples, and the solution exact."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(SAMPLES)
    force = sum(np.cos(2 * np.pi * hz * t + rng.uniform(0, 2 * np.pi)) for hz in np.arange(0.5, 8.0, 0.25))
    A, B = np.array([[0, 1], [-STIFFNESS / MASS, -damping / MASS]]), np.array([[0], [1 / MASS]])
    A, B, C, _, _ = cont2discrete((A, B, np.array([[1, 0]]), np.zeros((1, 1))), STEP)
    x, position = np.zeros(2), np.empty(SAMPLES)
    for k in range(SAMPLES):
        position[k] = (C @ x)[0]
        x = A @ x + B[:, 0] * force[k]
    return t, force, position + noise * rng.standard_normal(SAMPLES)
