"""Recordings from files and back: one strict reader per format behind one guarded opener.

`open_table` opens any accepted file as named columns and never executes anything from it; `assemble.to_recording` labels
the columns and converts them to SI; `write_recording` and `read_recording` are vlab's own exact form of a recording;
`sep005` takes and gives the dictionaries of the SDyPy packages, `responses.to_frequency_response` labels columns of
frequency responses; `quality.findings` says what looks wrong with a recording and repairs nothing.
"""

from vlab.recordings.stored import read_recording, write_recording
from vlab.recordings.table import open_table

__all__ = ["open_table", "read_recording", "write_recording"]
