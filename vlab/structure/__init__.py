"""Description of a structure: points, bars, cables, masses, transducers, origins."""

from vlab.structure.model import Structure
from vlab.structure.places import Location, locate
from vlab.structure.reader import load_structure

__all__ = ["Location", "Structure", "load_structure", "locate"]
