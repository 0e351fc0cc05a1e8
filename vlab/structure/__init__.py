"""What is on the bench: points, bars, cables, clamps, masses, coils, sensors and where each number comes from."""

from vlab.structure.model import Structure
from vlab.structure.places import Location, locate
from vlab.structure.reader import load_structure

__all__ = ["Location", "Structure", "load_structure", "locate"]
