"""Experiment: plant, hardware, law and excitation in one 2 kHz loop."""

from vlab.lab.experiment import Experiment, run_experiment

__all__ = ["Experiment", "run_experiment"]
