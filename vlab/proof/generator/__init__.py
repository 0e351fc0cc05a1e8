"""The independent generator: things as built, their hardware, what can be hidden in them, recordings of it.

Nothing here imports MuJoCo, `vlab.physics` or `vlab.plants`; a test asserts it.
"""
