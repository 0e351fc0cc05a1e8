"""Predictors of recordings for every model class."""
