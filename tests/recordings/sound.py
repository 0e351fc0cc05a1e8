"""Small sound files of every format, as bytes, for tests that damage them."""

import io
import tempfile
from pathlib import Path

import h5py
import numpy as np
import pyuff
from nptdms import ChannelObject, TdmsWriter

TIMES = np.arange(7) / 3.0


def hdf5(**options):
    """HDF5 with packed, complex, text and nested data sets, and everything that must not be followed."""
    stream = io.BytesIO()
    with h5py.File(stream, "w", **options) as file:
        file.attrs["operator"] = "me"
        x = file.create_dataset("run/inner/x", data=TIMES, compression="gzip", chunks=(2,))
        x.attrs["unit"] = "mm"
        file["H"] = np.exp(1j * TIMES)
        file["m"] = np.arange(12.0).reshape(6, 2)
        file["i"] = np.arange(4, dtype="i2")
        file["s"] = "hello"
        file["ext"] = h5py.ExternalLink("secret.h5", "/x")
        file["soft"] = h5py.SoftLink("/H")
        file["loop"] = file["run"]
        file["run/back"] = file["/"]
        file.create_dataset(
            "packed", data=np.arange(8, dtype="f4"), fletcher32=True, shuffle=True, compression="lzf", chunks=(4,)
        )
        file.create_dataset("part", (10,), chunks=(2,), dtype="f8")[0:2] = 1.0
        file.create_dataset("never", (10,), dtype="f8")
        file.create_dataset("outside", (10,), dtype="u1", external=[("/etc/passwd", 0, 10)])
        layout = h5py.VirtualLayout(shape=(7,), dtype="f8")
        layout[:] = h5py.VirtualSource("secret.h5", "x", shape=(7,))
        file.create_virtual_dataset("view", layout)
    return stream.getvalue()


def matlab_73():
    """MAT 7.3 as MATLAB lays it out: user block, classes as attributes, reversed dimensions, references."""
    stream = io.BytesIO()

    def put(group, name, values, matlab_class, **options):
        made = group.create_dataset(name, data=values, **options)
        made.attrs["MATLAB_class"] = np.bytes_(matlab_class)
        return made

    def text(words):
        return np.frombuffer(words.encode("utf-16-le"), "u2")[:, None]

    with h5py.File(stream, "w", userblock_size=512) as file:
        put(file, "t", TIMES[None, :], "double")
        put(file, "Y", np.array([TIMES, -TIMES]), "double", chunks=(1, 4), compression="gzip")
        pairs = np.zeros((1, 7), dtype=[("real", "f8"), ("imag", "f8")])
        pairs["real"], pairs["imag"] = np.cos(TIMES), np.sin(TIMES)
        put(file, "H", pairs, "double")
        put(file, "name", text("héllo"), "char")
        put(file, "none", np.array([0, 0], "u8"), "double").attrs["MATLAB_empty"] = 1
        struct = file.create_group("s")
        struct.attrs["MATLAB_class"] = np.bytes_("struct")
        put(struct, "u", np.ones((1, 3)), "double")
        sparse = file.create_group("A")
        sparse.attrs["MATLAB_sparse"] = 3
        references = file.create_group("#refs#")
        parts = [put(references, "a", np.arange(3.0)[None], "double"), put(references, "b", text("xy"), "char")]
        cell = file.create_dataset("c", (1, 2), dtype=h5py.ref_dtype)
        cell[0, 0], cell[0, 1] = (part.ref for part in parts)
        cell.attrs["MATLAB_class"] = np.bytes_("cell")
    raw = bytearray(stream.getvalue())
    raw[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    return bytes(raw)


def npz(*, is_packed=True, **more):
    """NPZ of vectors, matrices, complex numbers and text."""
    stream = io.BytesIO()
    arrays = {"t": TIMES, "H": np.exp(1j * TIMES), "m": np.arange(12, dtype=">i4").reshape(6, 2), "who": "me"} | more
    (np.savez_compressed if is_packed else np.savez)(stream, **arrays)
    return stream.getvalue()


def uff(*, is_binary, is_even=True, is_complex=True, values=None):
    """Two functions of data set 58 and one of data set 151, as pyuff writes them."""
    x = TIMES if is_even else TIMES**2
    values = np.exp(1j * TIMES) if values is None else values
    common = {
        "binary": int(is_binary),
        "func_type": 4 if is_complex else 1,
        "rsp_node": 12,
        "ref_node": 1,
        "ref_dir": -1,
        "x": x,
        "abscissa_spacing": int(is_even),
        "abscissa_spec_data_type": 18 if is_complex else 17,
        "ordinate_spec_data_type": 12,
        "orddenom_spec_data_type": 13,
        "z_axis_spec_data_type": 0,
        "ordinate_axis_units_lab": "m/s^2",
        "orddenom_axis_units_lab": "N" if is_complex else "NONE",
        "id1": "beam",
    }
    head = pyuff.prepare_151(
        model_name="rig", description="beam", db_app="x", date_db_created="1", time_db_created="1", program="p"
    )
    sets = [head] + [
        pyuff.prepare_58(rsp_dir=way, data=values if is_complex else values.real.copy(), **common) for way in (2, 3)
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.uff"
        pyuff.UFF(str(path)).write_sets(sets, "add")
        return path.read_bytes()


def tdms():
    """TDMS of two segments with a waveform of 100 Hz, in millimetres."""
    stream = io.BytesIO()
    clock = {"unit_string": "mm", "wf_increment": 0.01, "wf_start_offset": 0.5}
    with TdmsWriter(stream) as writer:
        for _ in range(2):
            writer.write_segment(
                [
                    ChannelObject("g", "x", np.arange(5.0), properties=clock),
                    ChannelObject("g", "n", np.arange(5, dtype="i2")),
                    ChannelObject("g", "when", np.array(["a", "b"])),
                ]
            )
    return stream.getvalue()
