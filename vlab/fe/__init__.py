"""The finite element model of a structure, independent of MuJoCo: mass, damping, stiffness, modes, state space."""

from vlab.fe.assembly import build_fe_model
from vlab.fe.model import FeModel
from vlab.fe.second_order import SecondOrderModel

__all__ = ["FeModel", "SecondOrderModel", "build_fe_model"]
