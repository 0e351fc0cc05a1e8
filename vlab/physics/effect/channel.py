"""Effects in one channel: from signal to signal."""

from abc import abstractmethod

from vlab.physics.effect.base import Effect
from vlab.physics.effect.parameter import Values
from vlab.signals import Array


class ChannelEffect(Effect):
    """A change of a command or of a recorded motion."""

    @abstractmethod
    def transfer(self, x: Array, p: Values, h: float, t: Array) -> Array:
        """Return the signal after the effect.

        Parameters
        ----------
        x : array
            Signals before the effect, time along the first axis.
        p : Values
            Parameter values.
        h : float
            Sample period [s].
        t : (n,) array
            Time stamps from the start of the recording [s].

        Returns
        -------
        array
            Signals, shape of `x`.
        """
