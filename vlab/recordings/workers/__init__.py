"""Readers for isolated processes, without imports from vlab.

See `vlab.recordings.isolated`.
"""
