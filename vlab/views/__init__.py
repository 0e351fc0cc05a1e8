"""Figures, reports and scenes; imports the other rooms."""
