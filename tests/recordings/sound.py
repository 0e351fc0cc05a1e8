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


def npy(array=None):
    """NPY of a matrix or of a given array."""
    stream = io.BytesIO()
    np.save(stream, np.column_stack([TIMES, np.sin(TIMES)]) if array is None else array, allow_pickle=False)
    return stream.getvalue()


LVM = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t.
X_Columns\tOne
***End_of_Header***\t
\t
Channels\t2\t\t
Samples\t3\t3\t
X0\t0.5\t0.5\t
Delta_X\t0.100000\t0.100000\t
***End_of_Header***\t\t\t
X_Value\tForce\tAcceleration\tComment
0.500000\t1.0\t2.0\tstart
0.600000\t1.5\t2.5
0.700000\t1.6\t2.6
"""
"""LabVIEW measurement file with two channels, times and a comment."""


def xlsx(rows=None):
    """Workbook of two sheets."""
    import openpyxl

    book, stream = openpyxl.Workbook(), io.BytesIO()
    book.active.title = "Run"
    for row in rows or [["t [s]", "x"], *[[float(t), float(np.sin(t))] for t in TIMES]]:
        book.active.append(row)
    book.create_sheet("Notes").append(["nothing"])
    book.save(stream)
    return stream.getvalue()


JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
START = 1_700_000_000


def joint_state(k):
    """Message of two joints, 10 ms apart."""
    return {
        "header": {"stamp": {"sec": START, "nanosec": k * 10_000_000}, "frame_id": ""},
        "name": ["elbow", "wrist"],
        "position": [0.1 * k, -0.2 * k],
        "velocity": [10.0, -20.0],
        "effort": [],
    }


def mcap(count=7):
    """MCAP log of joint states at 100 Hz and of JSON commands at 50 Hz, 2 ms later."""
    import json

    from mcap_ros2.writer import Writer

    stream = io.BytesIO()
    writer = Writer(stream)
    schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
    start = START * 10**9
    for k in range(count):
        at = start + k * 10_000_000
        writer.write_message("/joint_states", schema, joint_state(k), log_time=at, publish_time=at, sequence=k)
    inner = writer._writer
    kind = inner.register_schema(name="command", encoding="jsonschema", data=b"{}")
    topic = inner.register_channel(topic="/command", message_encoding="json", schema_id=kind)
    for k in range(0, count, 2):
        at = start + k * 10_000_000 + 2_000_000
        inner.add_message(topic, log_time=at, publish_time=at, data=json.dumps({"target": [0.5 * k]}).encode())
    writer.finish()
    return stream.getvalue()


def db3(count=7, *, definition=""):
    """ROS 2 bag of joint states in SQLite, as rosbag2 lays it out, without message definitions by default."""
    import sqlite3

    from mcap_ros2._dynamic import serialize_dynamic

    encode = serialize_dynamic("sensor_msgs/msg/JointState", JOINT_STATE)["sensor_msgs/msg/JointState"]
    bag = sqlite3.connect(":memory:")
    bag.execute(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
        "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
    )
    bag.execute(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
    )
    bag.execute("INSERT INTO topics VALUES(1, '/joint_states', 'sensor_msgs/msg/JointState', 'cdr', '')")
    bag.execute("INSERT INTO topics VALUES(2, '/odd', 'my_msgs/msg/Odd', 'cdr', '')")
    if definition:
        bag.execute(
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT, "
            "encoded_message_definition TEXT, type_description_hash TEXT)"
        )
        bag.execute(
            "INSERT INTO message_definitions VALUES(1, 'sensor_msgs/msg/JointState', 'ros2msg', ?, '')", [definition]
        )
    for k in range(count):
        data = bytes(encode(joint_state(k)))
        bag.execute("INSERT INTO messages VALUES(?, 1, ?, ?)", [k + 1, START * 10**9 + k * 10_000_000, data])
    bag.commit()
    return bag.serialize()


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
