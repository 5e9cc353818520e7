"""Bags of ROS 1 (.bag), ROS 2 (a folder with metadata.yaml, .db3) and MCAP as tables: a topic, its fields as columns.

A field of a message is a column under its dotted path, ``twist.twist.linear.x``; one entry of a short array has its
number there, ``twist.covariance.0``. ``header.stamp`` is one whole number of nanoseconds, and ``bag_time`` the time the
message was recorded. Needs the package `rosbags`, in the extra ``ros``.
"""

import os
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from models.algebra import Array
from models.errors import GraphFileError
from nls.io.files import refuse_absent
from nls.missions.importing.text_log import Log, Missing, blanked

SUFFIXES = (".bag", ".mcap", ".db3")
RECORDED = "bag_time"


def is_bag(path: str | Path) -> bool:
    """Whether a path is that of a bag, by its name; of a folder by the file that every bag of ROS 2 has.

    Examples
    --------
    >>> is_bag("dive.bag"), is_bag("dive.csv")
    (True, False)
    """
    return Path(path).suffix.lower() in SUFFIXES or os.path.isfile(os.path.join(path, "metadata.yaml"))


def refuse_no_log(paths: Sequence[str | Path]) -> None:
    """Refuse paths of nothing, and folders that are no bags.

    Raises
    ------
    GraphFileError
    """
    refuse_absent(paths)
    for path in paths:
        if os.path.isdir(path) and not is_bag(path):
            cure = f"give its files: nls import {shlex.quote(os.fspath(path))}/*"
            raise GraphFileError(f"is a folder and no bag; expected a log; {cure}", os.fspath(path))


class BagLog(Log):
    """The messages of one topic as a table.

    Parameters
    ----------
    path : of the bag.
    topic : its name.
    names : of its columns, dotted paths.
    rows : the cells of each message.
    """

    noun = "message"

    def __init__(self, path: str, topic: str, names: list[str], rows: list[list[Any]]) -> None:
        super().__init__(path, f"{Path(path).name} {topic}", names, rows, np.arange(len(rows)))
        self.units = {name: "ns" for name in names if name == RECORDED or name.split(".")[-1] == "stamp"}

    def cells(self, name: str) -> list[Any]:
        """Cells (n,) of a column as they stand."""
        place = self.names.index(self.column(name))
        return [row[place] for row in self.rows]

    def words(self, name: str, missing: Missing = ()) -> list[str]:
        """See `Log`."""
        values = self.cells(name)
        return blanked([str(v).lower() if isinstance(v, bool | np.bool_) else str(v) for v in values], missing)

    def numbers(self, name: str, missing: Missing = ()) -> Array:
        """See `Log`."""
        values = self.cells(name)
        try:
            if missing:
                values = [v if word else np.nan for v, word in zip(values, self.words(name, missing), strict=True)]
            return np.array(values, dtype=float)
        except ValueError as error:
            raise GraphFileError(f"{self.title}: {name} is no number: {error}", self.path) from error

    def error(self, row: int, message: str) -> GraphFileError:
        """See `Log`."""
        return GraphFileError(f"{self.title.split(' ', 1)[1]}, message {self.number(row)}: {message}", self.path)


class Bag:
    """A bag, whose topics are read when they are asked for.

    Parameters
    ----------
    path : a file, or the folder of a bag of ROS 2.

    Attributes
    ----------
    topics : type and number of messages by name; of those that have messages.

    Raises
    ------
    GraphFileError
        No bag, a damaged one; the package that reads it is not installed.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = str(path)
        with _reading(self.path) as reader:
            topics = [(name, topic) for name, topic in sorted(reader.topics.items()) if topic.msgcount]
            self.topics = {name: (topic.msgtype or "several types", topic.msgcount) for name, topic in topics}

    def log(self, topic: str, most: int | None = None) -> BagLog:
        """All messages of one of its topics as a table, or the first of them.

        Raises
        ------
        GraphFileError
            Messages that cannot be read, or are not all of one form.
        """
        names, rows = [RECORDED], list[list[Any]]()
        with _reading(self.path) as reader:
            connections = [connection for connection in reader.connections if connection.topic == topic]
            for k, (connection, recorded, raw) in enumerate(reader.messages(connections)):
                if most is not None and k == most:
                    break
                row = dict(_fields(reader.deserialize(raw, connection.msgtype), ""))
                row[RECORDED] = recorded
                names = names if rows else list(row)
                if row.keys() != set(names):
                    other = sorted(row.keys() ^ set(names))[0]
                    reason = f"message {k + 1} has other fields than the first: {other}"
                    raise GraphFileError(f"{topic}: {reason}", self.path)
                rows.append([row[name] for name in names])
        return BagLog(self.path, topic, names, rows)


def _fields(message: Any, path: str) -> Iterator[tuple[str, Any]]:
    """The numbers, flags and words of a message with their dotted paths."""
    if hasattr(message, "nanosec") and hasattr(message, "sec"):
        yield path, int(message.sec) * 1_000_000_000 + int(message.nanosec)
        return
    names = getattr(message, "__dataclass_fields__", None)
    parts: Any = ()
    if names is not None:
        parts = [(name, getattr(message, name)) for name in names if not name.startswith("__")]
    elif isinstance(message, np.ndarray | list | tuple):
        parts = enumerate(message) if len(message) <= 36 else ()  # a covariance, but no scan and no picture
    elif isinstance(message, bool | int | float | str | np.generic):
        yield path, message.item() if isinstance(message, np.generic) else message
    for name, part in parts:
        yield from _fields(part, f"{path}.{name}" if path else str(name))


@contextmanager
def _reading(path: str) -> Iterator[Any]:
    """An open reader; what goes wrong in the package becomes an error of this one."""
    import sqlite3
    import struct

    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.rosbag1 import ReaderError as Reader1Error
        from rosbags.rosbag2 import ReaderError as Reader2Error
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        cure = 'install it with pip install "leadline[ros]"'
        raise GraphFileError(f"is a bag, which the package rosbags reads; {cure}", path) from error
    ours = (AnyReaderError, Reader1Error, Reader2Error, sqlite3.Error, struct.error)
    failures = (*ours, OSError, ValueError, IndexError, AssertionError)  # of no bag, or a damaged one
    try:
        store = get_typestore(Stores.ROS1_NOETIC if path.endswith(".bag") else Stores.ROS2_HUMBLE)
        reader = AnyReader([Path(path)], default_typestore=store)
        reader.open()
    except failures as error:
        raise GraphFileError(f"cannot be read as a bag: {error}", path) from error
    try:
        yield reader
    except GraphFileError:
        raise
    except failures as error:
        raise GraphFileError(f"is a damaged bag: {error}", path) from error
    finally:
        reader.close()
