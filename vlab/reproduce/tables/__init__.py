"""Reproduction of published tables."""
