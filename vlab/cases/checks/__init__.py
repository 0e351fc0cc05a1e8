"""Checks of a case's files, in seconds, before anything is fitted or sought.

`check_recordings` puts the recordings beside the model as given and says where a sign, a unit, a column or the time is not what the case
says, with the lines that mend it. Nothing is mended here.
"""

from vlab.cases.checks.clock import check_clock
from vlab.cases.checks.correction import FileCheck, Found
from vlab.cases.checks.recordings import check_recordings

__all__ = ["FileCheck", "Found", "check_clock", "check_recordings"]
