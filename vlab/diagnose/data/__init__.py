"""Data quality, noise and responses of the recordings, before any model."""
