"""Proof with the effect concealed: cases made by an independent generator, sealed, diagnosed, opened and scored.

`vlab.proof.generator` makes the recordings. It knows nothing of MuJoCo, of the plants and of the catalogue of physics:
meshes, integration, hardware and force laws are its own. The other modules seal the truth, run the diagnosis over many
cases, freeze the answers and count.
"""
