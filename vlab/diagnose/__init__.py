"""From a mismatch between simulation and recordings to the named, placed, modelled and verified missing physics.

The way goes: signals of all runs on one clock -> the model's linear twin -> which physics, where (screening) -> fits in
simulation with everything uncertain refitted -> choice -> verdict in MuJoCo on recordings that were never used.
"""
