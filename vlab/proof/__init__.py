"""Proof with concealed effects: generation, sealing, diagnosis, scoring.

`vlab.proof.generator` makes the recordings, without MuJoCo, the plants and the catalogue of physics. Its meshes,
integration, hardware and force laws are its own. The other modules seal the truth, diagnose many cases, freeze the
answers and count.
"""
