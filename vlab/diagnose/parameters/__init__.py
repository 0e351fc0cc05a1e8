"""Parametrised model: uncertain parameters, locations, observed channels."""
