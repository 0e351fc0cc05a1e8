"""Check of a case in seconds, before a diagnosis."""

from vlab.diagnose.precheck.precheck import precheck_case
from vlab.diagnose.precheck.result import ChannelCheck, Precheck, Remark

__all__ = ["ChannelCheck", "Precheck", "Remark", "precheck_case"]
