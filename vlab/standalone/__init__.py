"""Answers of a diagnosis as plain MuJoCo files."""
