"""Parameter vectors, least squares, evidence."""
