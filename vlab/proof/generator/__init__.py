"""Independent generator: benches as built, hardware, hidden effects, recordings.

The generator imports neither MuJoCo nor `vlab.physics` nor `vlab.plants`; a test asserts it.
"""
