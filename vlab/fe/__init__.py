"""Finite element model of a structure: matrices, modes, state space.

The model is independent of MuJoCo.
"""

from vlab.fe.assembly import build_fe_model
from vlab.fe.model import FeModel
from vlab.fe.second_order import SecondOrderModel

__all__ = ["FeModel", "SecondOrderModel", "build_fe_model"]
