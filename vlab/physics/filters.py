"""Delays and first-order lags of sampled signals."""

from collections import deque

import numpy as np
from scipy import signal

from vlab.physics.effect import ActuatorStep
from vlab.signals import Array


def delayed(x: Array, delay: float, h: float) -> Array:
    """Return signals delayed by a time.

    The delay need not be a whole number of samples. The signal is linear between samples and zero before the start.

    Parameters
    ----------
    x : array
        Signals, time along the first axis.
    delay : float
        Delay [s].
    h : float
        Sample period [s].

    Returns
    -------
    array
        Delayed signals, shape of `x`.
    """
    index = np.arange(len(x)) - delay / h
    whole = np.floor(index).astype(int)
    part = (index - whole).reshape(-1, *(1,) * (x.ndim - 1))
    low = np.where((whole >= 0).reshape(part.shape), x[np.maximum(whole, 0)], 0.0)
    high = np.where((whole + 1 >= 0).reshape(part.shape), x[np.clip(whole + 1, 0, len(x) - 1)], 0.0)
    return np.asarray(low * (1 - part) + high * part)


def delay_line(delay: float, h: float) -> ActuatorStep:
    """Return a sample-by-sample form of `delayed`.

    Parameters
    ----------
    delay : float
        Delay [s].
    h : float
        Sample period [s].

    Returns
    -------
    ActuatorStep
        One input sample to one delayed sample.
    """
    whole = int(np.floor(delay / h))
    part = delay / h - whole
    past = deque([0.0] * (whole + 2), maxlen=whole + 2)

    def step(x: float) -> float:
        past.append(x)
        return part * past[0] + (1 - part) * past[1]

    return step


def lag_weights(time_constant: float, h: float) -> tuple[float, float, float]:
    """Return the weights (new input, old input, old output) of `lagged`.

    With a = exp(-h/tau), the output is y[k] = b0 x[k] + b1 x[k-1] + a y[k-1], b0 = 1 - (1 - a) tau/h, b1 = (1 - a) -
    b0. This recursion is the ramp-invariant (first-order hold) discretisation of 1/(1 + s tau).

    Parameters
    ----------
    time_constant : float
        Time constant tau [s].
    h : float
        Sample period [s].

    Returns
    -------
    tuple of (float, float, float)
        b0, b1 and a.
    """
    a = float(np.exp(-h / time_constant))
    new = 1.0 - (1.0 - a) * time_constant / h  # response to a ramp
    return new, (1.0 - a) - new, a


def recursion(new: float, old: float, kept: float, x: float = 0.0, y: float = 0.0) -> ActuatorStep:
    """Return the first-order filter y+ = new x+ + old x + kept y.

    Parameters
    ----------
    new : float
        Weight of the present input.
    old : float
        Weight of the preceding input.
    kept : float
        Weight of the preceding output.
    x, y : float
        Input and output before the first sample; zero means a start from rest.

    Returns
    -------
    ActuatorStep
        One input sample to one output sample.
    """

    def step(sample: float) -> float:
        nonlocal x, y
        y = new * sample + old * x + kept * y
        x = sample
        return y

    return step


def lagged(x: Array, time_constant: float, h: float) -> Array:
    """Return signals behind a first-order low-pass.

    The discretisation is exact for inputs that run straight between samples.
    """
    new, old, a = lag_weights(time_constant, h)
    return np.asarray(signal.lfilter([new, old], [1.0, -a], x, axis=0))
