"""TDMS: channels, units and clocks; what npTDMS only warns of is refused."""

import struct

import numpy as np
import pytest
import sound

from vlab.errors import BadRecording
from vlab.recordings import open_table
from vlab.recordings.assemble import ColumnSpec, to_recording


def opened(tmp_path, content, **options):
    (tmp_path / "run.tdms").write_bytes(content)
    return open_table(tmp_path / "run.tdms", **options)


def test_channels_are_columns_with_their_clock_and_unit(tmp_path):
    table = opened(tmp_path, sound.tdms())
    np.testing.assert_array_equal(table["g/x"], [0.0, 1.0, 2.0, 3.0, 4.0] * 2)
    np.testing.assert_array_equal(table["g/n"], [0.0, 1.0, 2.0, 3.0, 4.0] * 2)
    np.testing.assert_array_equal(table["g/time"], 0.5 + np.arange(10) * 0.01)
    run = to_recording(table, [ColumnSpec(column="g/x", kind="displacement", unit="mm")], time="g/time")
    np.testing.assert_array_equal(run.data[:, 0], table["g/x"] * 1e-3)
    with pytest.raises(ValueError, match="states 'mm' and the description 'm'"):
        to_recording(table, [ColumnSpec(column="g/x", kind="displacement", unit="m")], time="g/time")
    with pytest.raises(BadRecording, match="'g/when' cannot be a column"):
        table["g/when"]


def lying(at, value, form="<Q"):
    data = bytearray(sound.tdms())
    struct.pack_into(form, data, at, value)
    return bytes(data)


COUNT = sound.tdms().index(b"/'g'/'x'") + 8 + 12  # after index length, type and dimension of the first channel


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (sound.tdms()[:-4], "a segment of .* bytes in the .* that are left"),
        (sound.tdms() + b"TDSm", "no whole head of a segment"),
        (b"TDSm", "no whole head of a segment"),
        (b"no such thing" * 20, "no whole head of a segment"),
        (lying(12, 2**40), "a segment of 1099511627804 bytes"),
        (lying(COUNT, 2**40), "declares|warns|memory"),
        (lying(8, 9999, "<I"), "npTDMS warns: Unrecognised version"),
    ],
)
def test_what_lies_or_is_cut_is_refused(tmp_path, content, match):
    with pytest.raises(BadRecording, match=match):
        opened(tmp_path, content)


def test_names_are_not_for_tdms_files(tmp_path):
    with pytest.raises(BadRecording, match="names its own channels"):
        opened(tmp_path, sound.tdms(), names=["x"])
