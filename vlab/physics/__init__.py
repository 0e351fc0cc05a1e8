"""The catalogue of physics that a model can have left out."""
