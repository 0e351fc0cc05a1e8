"""Messages of robot logs as columns, by topic.

A topic ``/joint_states`` has the columns ``/joint_states/time`` (time of logging) and ``/joint_states/position[2]``.
Times count from the first message of the file, because a double does not hold nanoseconds since 1970. Stamps in
headers count from the first stamp of the file. Message definitions are interpreted, never compiled to code.
"""

import json
import types
from typing import Any

import numpy as np
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rows import LONGEST_LIST, Rows  # type: ignore[import-not-found]
from sandbox import Skip  # type: ignore[import-not-found]

HEADER = """std_msgs/Header header
"""
DEPENDENCIES = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
================================================================================
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
================================================================================
MSG: std_msgs/MultiArrayLayout
std_msgs/MultiArrayDimension[] dim
uint32 data_offset
================================================================================
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""
STANDARD = {
    "sensor_msgs/msg/JointState": HEADER + "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    "sensor_msgs/msg/Imu": HEADER
    + "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
    + "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
    + "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
    "geometry_msgs/msg/WrenchStamped": HEADER + "geometry_msgs/Wrench wrench\n",
    "geometry_msgs/msg/TwistStamped": HEADER + "geometry_msgs/Twist twist\n",
    "geometry_msgs/msg/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
    "geometry_msgs/msg/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "std_msgs/msg/Float64": "float64 data\n",
    "std_msgs/msg/Float32": "float32 data\n",
    "std_msgs/msg/Float64MultiArray": "std_msgs/MultiArrayLayout layout\nfloat64[] data\n",
    "std_msgs/msg/Float32MultiArray": "std_msgs/MultiArrayLayout layout\nfloat32[] data\n",
}
"""STANDARD: definitions of common messages, for bags that hold none. Source: common_interfaces of ROS 2."""
_NANO = 1e-9
_DEEPEST = 10


class Topics:
    """Columns of all topics of a log.

    Parameters
    ----------
    limit : int
        Largest size of all columns [bytes].
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.rows: dict[str, Rows] = {}
        self.times: dict[str, list[int]] = {}
        self.stamps: dict[str, list[int]] = {}
        self.names: dict[str, Any] = {}
        self.skipped: dict[str, str] = {}
        self.factory = DecoderFactory()

    def decoder(self, topic: str, encoding: str, schema: Schema | None) -> Any:
        """Return the function that decodes the messages of a topic, or None.

        Parameters
        ----------
        topic : str
            Topic.
        encoding : str
            Encoding of the messages: ``"json"`` or ``"cdr"``.
        schema : Schema or None
            Definition of the messages.

        Returns
        -------
        callable or None
            None for an encoding that is not read; `skipped` then holds the reason.
        """
        if encoding == "json":
            return json.loads
        decode = None
        try:
            decode = self.factory.decoder_for(encoding, schema)
        except Exception as error:  # the parser of definitions raises many kinds of error
            self.skipped[topic] = f"its definition cannot be read: {str(error)[:200]}"
            return None
        if decode is None:
            kind = f"{encoding or 'unknown'} of {schema.encoding if schema else 'no definition'}"
            self.skipped[topic] = f"messages in {kind}; json and cdr of ros2msg are read"
        return decode

    def add(self, topic: str, time_ns: int, message: Any) -> None:
        """Add a decoded message.

        Parameters
        ----------
        topic : str
            Topic.
        time_ns : int
            Time of logging [ns].
        message : object
            Decoded message.
        """
        value = _plain(message, 0)
        value = value if isinstance(value, dict) else {"data": value}
        rows = self.rows.setdefault(topic, Rows(self.limit))
        self.times.setdefault(topic, []).append(time_ns)
        stamp = _stamp(value)
        if stamp is not None:
            self.stamps.setdefault(topic, []).append(stamp)
        names = value.get("name")
        if isinstance(names, list) and all(isinstance(n, str) for n in names):
            known = self.names.setdefault(topic, names)
            if known != names:
                self.names[topic] = None
        before = 8 * sum(r.count * len(r.columns) for r in self.rows.values())
        if before > self.limit:
            raise ValueError(f"more than {self.limit} bytes of values")
        rows.add(value)

    def answer(self) -> dict[str, Any]:
        """Return the columns for `vlab.recordings.formats.topics`."""
        found: list[tuple[str, Any]] = []
        units: dict[str, str] = {}
        first = min((times[0] for times in self.times.values()), default=0)
        first = min((min(times) for times in self.times.values()), default=first)
        stamps = [min(values) for values in self.stamps.values()]
        names: dict[str, list[str]] = {}
        for topic, rows in self.rows.items():
            found.append((f"{topic}/time", (np.array(self.times[topic], dtype=np.int64) - first) * _NANO))
            units[f"{topic}/time"] = "s"
            if len(self.stamps.get(topic, ())) == rows.count:
                stamp = np.array(self.stamps[topic], dtype=np.int64) - min(stamps)
                found.append((f"{topic}/header.stamp", stamp * _NANO))
                units[f"{topic}/header.stamp"] = "s"
            found += [
                (f"{topic}/{name}", values)
                for name, values in rows.arrays().items()
                if not name.startswith("header.stamp.")
            ]
            found += [
                (f"{topic}/{name}", Skip(why.removeprefix("it is ")))
                for name, why in rows.refused.items()
                if "text" not in why
            ]
            if self.names.get(topic):
                names[topic] = self.names[topic]
        found += [(topic, Skip(why)) for topic, why in self.skipped.items()]
        notes = [f"times count from {first} ns since 1970, the first message"] if self.rows else []
        return {"variables": found, "units": units, "meta": {}, "notes": notes, "names": names}


def _stamp(value: dict[str, Any]) -> int | None:
    """Return the stamp of a message's header [ns]."""
    header = value.get("header")
    stamp = header.get("stamp") if isinstance(header, dict) else None
    if not isinstance(stamp, dict) or not {"sec", "nanosec"} <= set(stamp):
        return None
    if not all(isinstance(stamp[key], int) for key in ("sec", "nanosec")):
        return None
    return int(stamp["sec"]) * 10**9 + int(stamp["nanosec"])


def _plain(value: Any, depth: int) -> Any:
    """Return a message as dicts, lists, numbers and text."""
    if depth > _DEEPEST or value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, dict):
        return {str(key): _plain(part, depth + 1) for key, part in value.items()}
    if isinstance(value, bytes | bytearray | memoryview):
        return [0] * min(len(value), LONGEST_LIST + 1) if len(value) > LONGEST_LIST else list(value)
    if isinstance(value, list | tuple) or hasattr(value, "tolist"):
        parts = value.tolist() if hasattr(value, "tolist") else list(value)
        return parts if len(parts) > LONGEST_LIST else [_plain(part, depth + 1) for part in parts]
    if isinstance(value, types.SimpleNamespace) or hasattr(value, "__slots__") or hasattr(value, "__dict__"):
        slots = getattr(value, "__slots__", None) or vars(value)
        return {name.lstrip("_"): _plain(getattr(value, name), depth + 1) for name in slots}
    return str(value)
