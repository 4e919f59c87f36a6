"""Messages of one topic of a ROS 1 or ROS 2 bag or an MCAP file, read one at a time.

Opening lists the times of the messages from the bag's index; their data is read when asked for.
Frames are mostly read in order, so the place after the last one is kept.
"""

from __future__ import annotations

import re
import sys
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from struct import iter_unpack, unpack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.datasets.paths import LARGEST_TEXT, inside
from planewise.errors import PlanewiseError, in_one_line, needs
from planewise.runtime.forks import in_child, lock_of_module

LARGEST_CHUNK = 1 << 28
"""Bytes that a compressed piece of a bag may unpack to; recorders use a few million."""

_METADATA = "metadata.yaml"
_MAGIC = (b"#ROSBAG V2.0", b"\x89MCAP0\r\n")
_SQLITE = b"SQLite format 3\0"
_WHOLE = re.compile(r"compression_mode:\s*[\"']?file", re.IGNORECASE)
_READ = (  # messages, and what they are made of
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/RegionOfInterest",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/PointField",
    "std_msgs/msg/Header",
    "builtin_interfaces/msg/Time",
)
_FORWARD = 16  # messages that are passed over rather than looked for
_MOST_OPEN = 8  # bags that stay open; a process may have some hundred files


def is_bag(path: Path) -> bool:
    """Whether a file begins like a bag, or a folder has the metadata of one.

    SQLite, which holds anything, has to be called ``.db3``.
    """
    if path.is_dir():
        return (path / _METADATA).is_file()
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        start = stream.read(16)
    return start.startswith(_MAGIC) or (start == _SQLITE and path.suffix == ".db3")


class Bag:
    """A bag that is open; use it as a context manager.

    Parameters
    ----------
    path : Path
        A ``.bag``, ``.mcap`` or ``.db3`` file, or the folder of a ROS 2 bag.

    Attributes
    ----------
    path : Path
        As given.
    types : dict of str to str
        Type of each topic's messages, such as ``sensor_msgs/msg/Image``.

    Raises
    ------
    PlanewiseError
        If it is damaged, or compressed as a whole, or defines messages otherwise than ROS does.
    MissingExtraError
        If rosbags is not installed.
    """

    def __init__(self, path: Path) -> None:
        with needs("rosbags", f"reading {path.name}", "ros"):
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        self.path = path
        _bound_decoders()
        _check_files(path)
        # Of ROS 2 also where an old bag does not hold its own types.
        store = get_typestore(Stores.ROS1_NOETIC if path.suffix == ".bag" else Stores.ROS2_HUMBLE)
        try:
            self._reader = AnyReader([path], default_typestore=store)
            self._reader.open()
        except Exception as error:  # the library raises whatever its decoders do
            raise PlanewiseError(
                f"data: the bag {path.name} cannot be opened; it is damaged, or lacks its index "
                f"({in_one_line(error)})"
            ) from error
        own = self._reader.typestore.fielddefs
        # All versions of ROS define what is read in one way, but for the header of ROS 1; the
        # library would follow any other definition, whatever that repeats.
        odd = [name for name in _READ if name in own and own[name][1] != store.fielddefs[name][1]]
        if odd:
            self.close()
            raise PlanewiseError(
                f"data: the bag {path.name} defines {odd[0]} otherwise than ROS does; record it "
                "with the messages of ROS"
            )
        self.types = {each.topic: each.msgtype for each in self._reader.connections}
        storage = getattr(self._reader.readers[0], "storage", self._reader.readers[0])
        self._unpack = _unpacker(storage)
        self._storages: Sequence[Any] = getattr(storage, "storages", [storage])

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        with suppress(Exception):  # what is damaged may not close either
            self.close()
        if isinstance(error, Exception) and not isinstance(error, PlanewiseError):
            raise PlanewiseError(
                f"data: the bag {self.path.name} is damaged ({in_one_line(error)})"
            ) from error

    def close(self) -> None:
        """Close its files."""
        if self._reader.stack is not None:
            self._reader.close()

    def index(self, topic: str) -> NDArray[np.int64]:
        """Times of a topic's messages and the files they are in, in order of time.

        Returns
        -------
        ndarray, shape (n, 2)
            Nanoseconds; number of the file.
        """
        rows = [
            (time, number)
            for number, storage in enumerate(self._storages)
            for time in _times(storage, _connections(storage, topic))
        ]
        return np.array(sorted(rows), np.int64).reshape(-1, 2)

    def messages(self, topic: str, storage: int, start: int) -> Iterator[tuple[int, bytes]]:
        """Times and data of a topic's messages in one file, from a time on."""
        file = self._storages[storage]
        connections = _connections(file, topic)
        for _, time, data in file.messages(connections, start=start) if connections else ():
            yield time, self._unpack(data)

    def parsed(self, topic: str, data: bytes) -> Any:
        """Message of its bytes."""
        return self._reader.deserialize(data, self.types[topic])

    def first(self, topic: str) -> Any | None:
        """First message of a topic; ``None`` where it has none."""
        streams = (self.messages(topic, n, 0) for n in range(len(self._storages)))
        found = next(chain.from_iterable(streams), None)
        return None if found is None else self.parsed(topic, found[1])


_topics: weakref.WeakSet[Topic] = weakref.WeakSet()
_LOCK = lock_of_module()  # of the set
_clock = count()


def _close_some() -> None:
    """Close the bags that were read least recently, so that one more may be opened."""
    with _LOCK:
        opened = [each for each in _topics if each._bag is not None]
        for topic in sorted(opened, key=lambda each: each._used)[: 1 - _MOST_OPEN]:
            if topic._lock.acquire(blocking=False):  # else a thread is reading it
                topic._close()
                topic._lock.release()


def _open_anew() -> None:
    """In a forked process: it shares the places in open files, and has none who let go of locks."""
    for topic in _topics:
        topic._forget()


in_child(_open_anew)


class Topic:
    """Messages of one topic by number; may be copied to other processes, where it opens anew.

    Parameters
    ----------
    path : Path
        Of the bag.
    name : str
        Of the topic.
    index : ndarray, shape (n, 2)
        As `Bag.index` gives it.
    """

    _bag: Bag | None = None
    _stream: Iterator[tuple[int, bytes]] | None = None
    _next: int = 0
    _storage: int = 0
    _used: int = 0  # when, by the clock

    def __init__(self, path: Path, name: str, index: NDArray[np.int64]) -> None:
        self.path, self.name, self.index = path, name, index
        self._forget()
        with _LOCK:
            _topics.add(self)

    def __reduce__(self) -> tuple[type[Topic], tuple[Path, str, NDArray[np.int64]]]:
        """As it was made, for other processes."""
        return type(self), (self.path, self.name, self.index)

    def __del__(self) -> None:
        self._close()

    def __len__(self) -> int:
        return len(self.index)

    def message(self, number: int) -> Any:
        """Read a message; may raise anything if it is damaged."""
        with self._lock:
            self._used = next(_clock)
            try:
                data = self._forward(number)
            except Exception:  # what lies between may be damaged: go there directly
                self._close()
                data = self._afresh(number)
            assert self._bag is not None
            return self._bag.parsed(self.name, data)

    def _forward(self, number: int) -> bytes:
        """Data of a message a little after the last one, or of any other."""
        near = 0 <= number - self._next <= _FORWARD
        if self._stream is None or not near or self.index[number, 1] != self._storage:
            return self._afresh(number)
        return self._pass_to(number, self._stream)

    def _afresh(self, number: int) -> bytes:
        if self._bag is None:
            _close_some()
            self._bag = Bag(self.path)
        time, self._storage = self.index[number].tolist()
        self._next = self._before(number)
        self._stream = self._bag.messages(self.name, self._storage, time)
        try:
            return self._pass_to(number, self._stream)
        except BaseException:
            self._close()  # the library's reader may be left in the middle of a chunk
            raise

    def _pass_to(self, number: int, stream: Iterator[tuple[int, bytes]]) -> bytes:
        found, data = -1, b""
        for at in range(self._next, number + 1):
            if self.index[at, 1] == self._storage:
                found, data = next(stream, (-1, b""))
        if found != self.index[number, 0]:
            raise PlanewiseError("the bag's index is damaged: the message is not in its place")
        self._next = number + 1
        return data

    def _before(self, number: int) -> int:
        """First message of the same time in the same file."""
        while number and (self.index[number - 1] == self.index[number]).all():
            number -= 1
        return number

    def _forget(self) -> None:
        self._lock = threading.Lock()
        self._bag = self._stream = None

    def _close(self) -> None:
        bag, self._bag, self._stream = self._bag, None, None
        if bag is not None:
            with suppress(Exception):
                bag.close()


def _connections(storage: Any, topic: str) -> list[Any]:
    return [each for each in storage.connections if each.topic == topic]


def _times(storage: Any, connections: Sequence[Any]) -> Iterator[int]:
    """Times of messages from a file's index, nanoseconds; without index, from the messages."""
    numbers = {each.id for each in connections}
    if not numbers:
        return
    if hasattr(storage, "indexes"):  # ROS 1
        yield from (entry.time for each in numbers for entry in storage.indexes[each])
    elif hasattr(storage, "dbconn"):  # SQLite
        marks = ",".join("?" * len(numbers))
        query = f"SELECT timestamp FROM messages WHERE topic_id IN ({marks})"
        yield from (row[0] for row in storage.dbconn.execute(query, tuple(numbers)))
    elif storage.chunks:  # MCAP
        for piece in storage.chunks:
            for number in numbers & piece.message_index_offsets.keys():
                yield from _indexed(storage.bio, piece.message_index_offsets[number])
    else:
        yield from (time for _, time, _ in storage.messages(connections))


def _indexed(stream: Any, offset: int) -> Iterator[int]:
    """Times of a record "message index" of MCAP: code 7, length, channel, pairs of time, place."""
    stream.seek(offset)
    code, _, _, size = unpack("<BQHI", stream.read(15))
    pairs = stream.read(min(size, LARGEST_CHUNK))
    if code != 7 or len(pairs) < size or size % 16:
        raise PlanewiseError("the bag's index is damaged")
    yield from (time for time, _ in iter_unpack("<QQ", pairs))


def _unpacker(storage: Any) -> Callable[[bytes], bytes]:
    """How messages are unpacked that a ROS 2 recorder compressed one by one."""
    metadata = getattr(storage, "metadata", None)
    if getattr(metadata, "compression_mode", None) != "message":
        return bytes
    make = _zstd()
    return lambda data: _bounded(make(), data, LARGEST_CHUNK)


def _bound_decoders() -> None:
    """Put a limit on what chunks unpack to; the library has none, and looks its decoders up here.

    The limits hold for every user of rosbags in the process; no recorder makes chunks that large.
    """
    from bz2 import BZ2Decompressor

    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped, unused-ignore]
    from rosbags.rosbag1.reader import decompressors
    from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

    def limited(make: Callable[[], Any]) -> Callable[..., bytes]:
        return lambda data, size=LARGEST_CHUNK: _bounded(make(), data, min(size, LARGEST_CHUNK))

    decompressors.update(bz2=limited(BZ2Decompressor), lz4=limited(LZ4FrameDecompressor))
    DECOMPRESSORS.update(lz4=limited(LZ4FrameDecompressor), zstd=limited(_zstd()))


def _zstd() -> Callable[[], Any]:
    if sys.version_info >= (3, 14):
        from compression.zstd import ZstdDecompressor
    else:
        from backports.zstd import ZstdDecompressor
    return ZstdDecompressor


def _bounded(decoder: Any, data: bytes, size: int) -> bytes:
    out: bytes = decoder.decompress(data, size + 1)
    if len(out) > size:
        raise PlanewiseError(f"a chunk of the bag holds more than its {size:,} bytes")
    if not decoder.eof:
        raise PlanewiseError("a chunk of the bag is cut short")
    return out


def _check_files(path: Path) -> None:
    """Refuse links out of the folder of a bag, and bags that unpack into a second file."""
    if not path.is_dir():
        path.open("rb").close()  # what the system refuses is no damage
        return
    for each in path.iterdir():
        inside(path, each.name)
    metadata = path / _METADATA
    if metadata.stat().st_size > LARGEST_TEXT:
        raise PlanewiseError(f"data: {_METADATA} of {path.name} is too large")
    if _WHOLE.search(metadata.read_text(encoding="utf-8", errors="replace")):
        raise PlanewiseError(
            f"data: the files of {path.name} are compressed as a whole, so that no frame can be "
            "read alone; convert the bag without compression (ros2 bag convert)"
        )
