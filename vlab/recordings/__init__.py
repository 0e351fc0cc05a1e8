"""Reading and writing of recordings in several file formats.

`open_table` opens any accepted file as named columns and executes no content. `assemble.to_recording` labels the
columns and converts them to SI. `write_recording` and `read_recording` store a recording exactly. `sep005` converts
dictionaries of the SDyPy packages. `responses.to_frequency_response` labels columns of frequency responses.
`quality.findings` reports data-quality defects and repairs none.
"""

from vlab.recordings.stored import read_recording, write_recording
from vlab.recordings.table import open_table

__all__ = ["open_table", "read_recording", "write_recording"]
