"""Validation on hold-out data."""
