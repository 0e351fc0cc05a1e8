"""Diagnosis of models that are far from linear over the recorded motion: pendulums that swing far, arms.

The road is the one of `vlab.diagnose`, on a twin that is linear about the recorded motion instead of about rest:
an extended Kalman filter on MuJoCo's own steps finds the motion, finite differences of the same steps along it give a
linear system that varies with time, and what the model lacks is sought in the deviations from that motion.
"""
