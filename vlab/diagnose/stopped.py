"""A diagnosis that ends before its search: the case does not say of its files what they are."""

from dataclasses import dataclass

from vlab.cases.case import Case
from vlab.cases.checks import FileCheck
from vlab.diagnose.diagnosis import Diagnosis

AGAIN = "none yet: mend the case as its quality says, and diagnose it again"


@dataclass(frozen=True, kw_only=True, eq=False)
class Stopped:
    """A diagnosis without a search; nothing was fitted.

    Parameters
    ----------
    diagnosis : Diagnosis
        Whose verdict is ``bad-recording``, and whose quality says why.
    case : Case
        As given.
    """

    diagnosis: Diagnosis
    case: Case


def stopped(case: Case, check: FileCheck, seconds: float) -> Stopped:
    """Return the diagnosis of a case whose files are not what it says.

    Parameters
    ----------
    seconds : float
        That it took.
    """
    diagnosis = Diagnosis(
        title=case.table.title,
        verdict="bad-recording",
        findings=(),
        alternatives=(),
        checked=(),
        mismatch={"where_frequency_hz": [], "where_channel": [], "where_time_s": []},
        not_excluded=(),
        next_measurement=AGAIN,
        quality=check.lines,
        seconds=seconds,
    )
    return Stopped(diagnosis=diagnosis, case=case)
