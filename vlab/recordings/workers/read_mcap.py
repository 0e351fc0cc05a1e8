"""Isolated reader of MCAP logs: messages in JSON and of ROS 2."""

import io
from typing import Any

import lz4.frame  # noqa: F401  # loaded while files can be opened
import zstandard  # noqa: F401
from mcap.exceptions import McapError
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from messages import Topics  # type: ignore[import-not-found]


def read(data: bytes, options: dict[str, Any]) -> dict[str, Any]:
    """Return the topics of a log in memory.

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
        The file is truncated, damaged or too large.
    """
    topics = Topics(options["limit"])
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, Any]] = {}
    try:
        for record in StreamReader(io.BytesIO(data), record_size_limit=options["limit"]).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.id not in channels:
                decode = topics.decoder(record.topic, record.message_encoding, schemas.get(record.schema_id))
                channels[record.id] = (record.topic, decode)
            elif isinstance(record, Message):
                topic, decode = channels.get(record.channel_id, ("", None))
                if decode is not None:
                    topics.add(topic, record.log_time, decode(record.data))
    except McapError as error:
        raise ValueError(f"not a whole MCAP file: {type(error).__name__} {error}") from error
    return dict(topics.answer())
