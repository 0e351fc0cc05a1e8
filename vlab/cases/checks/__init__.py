"""Checks of a case's files before any fit.

`check_recordings` compares the recordings with the nominal model. The check finds wrong signs, units, columns and time
stamps, and proposes edits of the case. The check edits nothing.
"""

from vlab.cases.checks.clock import check_clock
from vlab.cases.checks.correction import FileCheck, Found
from vlab.cases.checks.recordings import check_recordings

__all__ = ["FileCheck", "Found", "check_clock", "check_recordings"]
