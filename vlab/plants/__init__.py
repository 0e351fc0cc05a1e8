"""Plants in MuJoCo behind one interface: composite, FE, linear, modal, MJCF."""

from vlab.plants.base import Plant
from vlab.plants.build import PLANTS, build_plant

__all__ = ["PLANTS", "Plant", "build_plant"]
