"""Cases: a model and what was measured on the thing it is a model of, simulated beside each other and compared.

`load_case` reads ``case.toml`` strictly and checks every name in it against the model; `simulate` runs the model as the
recording was made; `compare_case` says how far they are apart, per channel, in time and in frequency.
"""

from vlab.cases.case import Case, load_case
from vlab.cases.compare import Comparison, compare_case
from vlab.cases.simulate import Simulation, simulate

__all__ = ["Case", "Comparison", "Simulation", "compare_case", "load_case", "simulate"]
