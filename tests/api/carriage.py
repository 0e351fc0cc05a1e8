"""Runs of a carriage with dry friction, integrated without MuJoCo, and its model, which knows nothing of the friction."""

import numpy as np

MODEL = """<mujoco model="carriage">
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody><body name="carriage">
    <joint name="slide" type="slide" axis="1 0 0" stiffness="800" damping="6"/>
    <geom name="block" type="box" size="0.05 0.05 0.05" mass="2"/>
  </body></worldbody>
  <actuator><motor name="motor" joint="slide"/></actuator>
  <sensor><jointpos name="encoder" joint="slide"/><jointvel name="tacho" joint="slide"/></sensor>
</mujoco>"""
STEP, SAMPLES, EVERY = 0.001, 4000, 20
"""STEP [s] of a sample; EVERY [1]: steps of the integration in a sample."""
MASS, STIFFNESS, DAMPING, FRICTION = 2.0, 800.0, 6.0, 1.5
"""FRICTION [N]: hidden in the slide."""


def run(seed, friction=FRICTION, noise=2e-6):
    """Return times [s], force [N] and position [m]; the force is held between samples."""
    rng = np.random.default_rng(seed)
    t, h = STEP * np.arange(SAMPLES), STEP / EVERY
    force = sum(np.cos(2 * np.pi * hz * t + rng.uniform(0, 2 * np.pi)) for hz in np.arange(0.25, 8.0, 0.25))
    force = force * (6.0 / np.std(force))
    x = v = 0.0
    position, slip = np.empty(SAMPLES), h * friction / MASS
    for k, u in enumerate(force.tolist()):
        position[k] = x
        for _ in range(EVERY):
            v += h * (u - DAMPING * v - STIFFNESS * x) / MASS
            v = 0.0 if abs(v) <= slip else v - (slip if v > 0 else -slip)
            x += h * v
    return t, force, position + noise * rng.standard_normal(SAMPLES)
