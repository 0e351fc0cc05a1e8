"""Demonstration on the beam."""
