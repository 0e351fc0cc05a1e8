"""Catalogue of physical effects that a model can lack."""
