"""Checks of recordings beside their model, before anything is fitted."""
