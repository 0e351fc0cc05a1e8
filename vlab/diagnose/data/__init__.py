"""Data quality, noise and what recordings show without a model."""
