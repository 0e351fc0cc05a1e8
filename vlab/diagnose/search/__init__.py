"""Screening, selection and confirmation of hypotheses."""
