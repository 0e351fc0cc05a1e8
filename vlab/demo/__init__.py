"""The demonstration: the whole story on the beam."""
