"""Independent generator: benches as built, hardware, hidden effects, recordings.

The generator imports neither MuJoCo nor `vlab.physics`, `vlab.plants` and `vlab.diagnose`. Only `laboratory` imports
`vlab.fe`, because sealed cases were made that way. A test asserts these rules.
"""
