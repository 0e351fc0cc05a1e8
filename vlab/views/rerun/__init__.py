"""Rerun scenes and the viewer."""
