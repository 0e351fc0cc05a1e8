"""Reproduction of published tables, and cross-check of FE model and plants."""

from vlab.reproduce.cross_check import cross_check
from vlab.reproduce.tables.registry import reproduce_tables

__all__ = ["cross_check", "reproduce_tables"]
