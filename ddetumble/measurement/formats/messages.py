"""Messages of robots: MCAP with JSON, and what ROS 2 records (rosbag2 in SQLite or MCAP)."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..._errors import InputError
from ..._settings import refuse_memory
from .channel import Channel


NUMBER = 200  # bytes of memory that a number of a message takes while it is collected, with its time
OFTEN = 100_000  # numbers after which the memory is looked at again


def read_messages(path: Path) -> list[Channel]:
    """A channel for every number in the messages of every topic, called `field.field`, with the topic as its group.

    Time is the stamp in the header of the messages where all have one, and when they were recorded elsewhere; it counts
    from the first message of the file.
    """
    numbers: dict[tuple[str, str], list[tuple[int, int | None, float]]] = {}
    count = 0
    for topic, logged, message in (_read_json(path) if _is_json(path) else _read_ros(path)):
        stamp, fields = _find_stamp(message), list(_flatten(message, ""))
        for name, value in fields:
            numbers.setdefault((topic, name), []).append((logged, stamp, value))
        count += len(fields)
        if count % OFTEN < len(fields):
            refuse_memory(NUMBER * count, f"reading {path}")
    stamped = all(entry[1] for entries in numbers.values() for entry in entries)
    start = min((entry[1 if stamped else 0] or 0 for entries in numbers.values() for entry in entries), default=0)
    return [Channel(name, np.array([entry[2] for entry in entries], dtype=float), None, topic,
                    np.array([(entry[1 if stamped else 0] or 0) - start for entry in entries]) / 1e9)
            for (topic, name), entries in numbers.items()]


def _is_json(path: Path) -> bool:
    from mcap.reader import make_reader

    if path.suffix.lower() != ".mcap":
        return False
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        return summary is None or any(one.message_encoding == "json" for one in summary.channels.values())


def _read_json(path: Path) -> Iterator[tuple[str, int, Any]]:
    from mcap.reader import make_reader

    with path.open("rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            if channel.message_encoding == "json":
                yield channel.topic, message.log_time, json.loads(message.data)


def _read_ros(path: Path) -> Iterator[tuple[str, int, Any]]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        count = 0
        for connection, logged, data in reader.messages():
            count += 1
            yield connection.topic, logged, reader.deserialize(data, connection.msgtype)
        if count != reader.message_count:  # a damaged data base may lose some without a word
            raise InputError(f"the recording states {reader.message_count} messages and {count} can be read; copy it "
                             "again, or index it anew with ros2 bag reindex", file=path)


def _list_fields(message: Any) -> dict[str, Any]:
    return message if isinstance(message, dict) else getattr(message, "__dict__", {})


def _find_stamp(message: Any) -> int | None:
    """Time in the header of a message [ns]; None where there is none or nought, as of a header left empty."""
    stamp = _list_fields(_list_fields(_list_fields(message).get("header")).get("stamp"))
    return int(stamp["sec"]) * 10**9 + int(stamp["nanosec"]) or None if {"sec", "nanosec"} <= set(stamp) else None


def _flatten(message: Any, above: str) -> Iterator[tuple[str, float]]:
    for name, value in _list_fields(message).items():
        name = f"{above}.{name}" if above else name
        if isinstance(value, int | float):
            yield name, float(value)
        elif isinstance(value, list | np.ndarray):
            yield from ((f"{name}[{i}]", float(x)) for i, x in enumerate(value)
                        if isinstance(x, int | float | np.number))
        elif name != "header" and not name.startswith("__"):
            yield from _flatten(value, name)
