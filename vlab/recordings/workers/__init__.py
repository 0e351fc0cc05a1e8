"""Readers that run in a process of their own, see `vlab.recordings.isolated`; they import nothing of vlab."""
