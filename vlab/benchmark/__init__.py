"""Benchmarks against the usual tools."""
