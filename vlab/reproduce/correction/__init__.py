"""Correction of a reduced model by a simulated modal test."""
