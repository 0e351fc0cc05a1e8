"""Answers of a diagnosis as plain MuJoCo files: a patched model and a law module without vlab."""
