"""The limit cycle near 41 Hz: harmonic balance, odds of explanations, simulations."""
