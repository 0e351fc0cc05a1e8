"""Check of a case in seconds, before a diagnosis."""

from vlab.diagnose.precheck.precheck import ChannelCheck, Precheck, Remark, precheck_case

__all__ = ["ChannelCheck", "Precheck", "Remark", "precheck_case"]
