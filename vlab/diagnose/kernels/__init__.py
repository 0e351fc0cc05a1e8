"""Compiled loops over samples, and parallel work."""
