"""Control laws, one per file. They know nothing of the simulator: `step` takes samples and gives commands.

A law is any object of the form `Controller`; `vlab experiment` puts it into the loop, and the same object runs outside.
"""

from controllers.base import Controller
from controllers.direct_rate_feedback import DirectRateFeedback
from controllers.linear import LinearController, LinearLaw
from controllers.observer_feedback import ObserverFeedback

__all__ = ["Controller", "DirectRateFeedback", "LinearController", "LinearLaw", "ObserverFeedback"]
