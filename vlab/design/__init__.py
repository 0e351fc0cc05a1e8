"""Design of control laws: weights, Riccati equations, performance.

The package is also the function `vlab.api.design.design`: ``vlab.design("beam", "lqg")``.
"""

import sys

from vlab import CallablePackage

sys.modules[__name__].__class__ = CallablePackage
