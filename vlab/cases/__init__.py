"""Cases: a model with measurements, simulated and compared.

`load_case` reads ``case.toml`` strictly and checks every name against the model. `simulate` runs the model under the
recorded inputs. `compare_case` measures the residual per channel, in time and in frequency.
"""

from vlab.cases.case import Case, load_case
from vlab.cases.compare import Comparison, compare_case
from vlab.cases.simulate import Simulation, simulate

__all__ = ["Case", "Comparison", "Simulation", "compare_case", "load_case", "simulate"]
