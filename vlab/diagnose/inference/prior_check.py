"""Check of fitted parameters against what a case states."""

import numpy as np
from scipy import stats

from vlab.diagnose.parameters.terms import Fit
from vlab.diagnose.settings import VERDICT


def has_plausible_parameters(fit: Fit) -> bool:
    """Return whether a fit's uncertain parameters agree with what the case states.

    The squared deviations over their prior variances are chi-squared if the statement is right. Directions that the
    recordings do not identify stay at their means and do not count.

    Parameters
    ----------
    fit : Fit
        Fit.

    Returns
    -------
    bool
        Whether the test accepts the parameters at the false-alarm rate of the verdict.
    """
    return _accepts(fit, fit.prior_cost)


def is_plausible_beside_noise(fit: Fit) -> bool:
    """Return whether parameters are plausible beside noise of any colour.

    Coloured noise moves the fitted parameters by more than white noise of the same size. The test adds this sampling
    variance to the prior variance.

    Parameters
    ----------
    fit : Fit
        Fit.

    Returns
    -------
    bool
        Whether the test accepts the parameters at the false-alarm rate of the verdict.
    """
    return _accepts(fit, fit.departure)


def _accepts(fit: Fit, departure: float) -> bool:
    """Return whether squared deviations agree with the stated prior.

    The mode deviates by the variance that the data remove from the prior. The sum of squares is a weighted sum of
    chi-squared variables. A scaled chi-squared distribution of the same mean and variance approximates it [1]_.

    References
    ----------
    .. [1] F. E. Satterthwaite, An approximate distribution of estimates of variance components, Biometrics Bull. 2 (1946)
       110-114.
    """
    mean, square = float(np.sum(fit.information)), float(np.sum(fit.information**2))
    if not square > 0.0:
        return True
    quantile = stats.chi2.ppf(1.0 - VERDICT.false_alarm_rate, mean**2 / square)
    return bool(departure <= square / mean * quantile)
