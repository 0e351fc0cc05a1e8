"""Score tests, least squares and evidence of hypotheses."""
