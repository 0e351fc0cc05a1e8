"""Kinds of nominal models: MJCF files and meshed structures."""
