"""Diagnosis of missing physics from recordings and a model.

The package is also the function `vlab.api.diagnosis.diagnose`: ``vlab.diagnose(case)``.

1. The runs are resampled to one clock.
2. The model is reduced to its modes.
3. A score test screens effects and locations (Rao 1948).
4. Least squares fits hypotheses with all uncertain parameters.
5. Scores with priors select a hypothesis.
6. MuJoCo simulates hold-out recordings for the verdict.

References
----------
C. R. Rao, Large sample tests of statistical hypotheses concerning several parameters, Proc. Camb. Phil. Soc. 44 (1948)
50-57.
"""

import sys

from vlab import CallablePackage

sys.modules[__name__].__class__ = CallablePackage
