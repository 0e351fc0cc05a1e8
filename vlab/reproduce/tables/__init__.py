"""Published tables beside computed ones."""
