"""Control laws, one per file.

No law knows the simulator: `step` takes samples and gives commands.

A law is any object of the form `Controller`; `vlab experiment` puts it into the loop, and the same object runs outside.

The laws lie in the folder ``controllers`` at the top of the repository. A wheel carries them beside this file; in a checkout
the search path of this package leads to that folder. The folder itself is no package, so it hides nobody's ``controllers``.
"""

from pathlib import Path

if not (Path(__file__).parent / "base.py").is_file():
    __path__.append(str(Path(__file__).parents[2] / "controllers"))

from vlab.controllers.base import Controller
from vlab.controllers.direct_rate_feedback import DirectRateFeedback
from vlab.controllers.linear import LinearController, LinearLaw
from vlab.controllers.observer_feedback import ObserverFeedback

__all__ = ["Controller", "DirectRateFeedback", "LinearController", "LinearLaw", "ObserverFeedback"]
