"""Environments of reinforcement learning on the two structures, for Gymnasium."""

from vlab.environments.structure import StructureEnv, register

__all__ = ["StructureEnv", "register"]
