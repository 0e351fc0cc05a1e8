"""The experiment: plant, hardware, control law and excitation in one 2 kHz loop, and the recording that comes out."""

from vlab.lab.experiment import Experiment, run_experiment

__all__ = ["Experiment", "run_experiment"]
