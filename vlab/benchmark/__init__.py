"""Benchmarks: speed beside the tools that a user would use instead."""
