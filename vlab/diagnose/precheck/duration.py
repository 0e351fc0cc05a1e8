"""Rough time of a diagnosis, from one simulation's time."""

from collections.abc import Sequence

from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.diagnose.settings import PRECHECK


def expected_seconds(case: Case, runs: Sequence[Run], simulated_s: float) -> float:
    """Return the rough time of a diagnosis [s].

    A diagnosis simulates the recordings to be fitted many times, once for each hypothesis, parameter and iteration. The
    processor time of one simulation on the present machine therefore gives the scale.

    Parameters
    ----------
    case : Case
        Case.
    runs : sequence of Run
        Recordings of the case.
    simulated_s : float
        Processor time of one simulation of all recordings [s].

    Returns
    -------
    float
        Time [s], an order of magnitude only: the number of hypotheses that need a fit is not known before.
    """
    fitted = sum(len(run.measured) for run in runs if run.role == "fit")
    share = fitted / sum(len(run.measured) for run in runs)
    passes = PRECHECK.simulations_per_freedom * int(case.plant.model.nv)
    return PRECHECK.least_seconds + share * simulated_s * passes
