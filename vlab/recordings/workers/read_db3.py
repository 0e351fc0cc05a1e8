"""Isolated reader of ROS 2 bags in SQLite (.db3)."""

import sqlite3
from typing import Any

from mcap.records import Schema
from messages import DEPENDENCIES, STANDARD, Topics  # type: ignore[import-not-found]

_ALLOWED = {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION}


def read(data: bytes, options: dict[str, Any]) -> dict[str, Any]:
    """Return the topics of a bag in memory.

    Parameters
    ----------
    data : bytes
        Bytes of the file.
    options : dict of str to object
        ``limit`` [bytes].

    Returns
    -------
    dict of str to object
        See `messages.Topics.answer`.

    Raises
    ------
    ValueError
        The file is no bag, or too large.
    """
    size = int.from_bytes(data[16:18], "big")
    pages, size = int.from_bytes(data[28:32], "big"), 65536 if size == 1 else size  # the database header of SQLite
    if len(data) < pages * size:
        raise ValueError(f"not a whole ROS 2 bag: {len(data)} of {pages * size} bytes")
    bag = sqlite3.connect(":memory:")
    try:
        bag.deserialize(data)
        bag.execute("PRAGMA trusted_schema = OFF")
        bag.set_authorizer(lambda action, *_: sqlite3.SQLITE_OK if action in _ALLOWED else sqlite3.SQLITE_DENY)
        tables = {name for (name,) in bag.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not {"topics", "messages"} <= tables:
            raise ValueError("not a ROS 2 bag: its tables 'topics' and 'messages' are missing")
        given: dict[str, str] = {}
        if "message_definitions" in tables:
            query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            given = {
                str(kind): str(text) for kind, encoding, text in bag.execute(query) if encoding == "ros2msg" and text
            }
        topics = Topics(options["limit"])
        decoders: dict[int, tuple[str, Any]] = {}
        for number, name, kind, encoding in bag.execute("SELECT id, name, type, serialization_format FROM topics"):
            text = given.get(kind) or (STANDARD[kind] + DEPENDENCIES if kind in STANDARD else "")
            if not text:
                topics.skipped[str(name)] = f"messages of type {kind}, whose definition is not in the bag"
                continue
            schema = Schema(id=int(number) + 1, name=str(kind), encoding="ros2msg", data=text.encode())
            decoders[number] = (str(name), topics.decoder(str(name), str(encoding), schema))
        for number, time_ns, content in bag.execute(
            "SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp"
        ):
            name, decode = decoders.get(number, ("", None))
            if decode is not None:
                topics.add(name, int(time_ns), decode(bytes(content)))
    except sqlite3.Error as error:
        raise ValueError(f"not a whole ROS 2 bag: {error}") from error
    finally:
        bag.close()
    return dict(topics.answer())
