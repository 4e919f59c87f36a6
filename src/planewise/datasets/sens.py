"""ScanNet's recordings: one ``.sens`` file a scene, version 4 of the format.

Layout, little-endian, after ScanNet's ``SensorData``: version; length and letters of the sensor's
name; four 4 x 4 matrices of float32 (intrinsics and extrinsics of colour, then of depth); codes of
the compressions; widths and heights; depth_shift, the units in a metre; the number of frames. Each
frame: 4 x 4 pose from camera to world; times of colour and depth in microseconds; bytes of both;
the bytes.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, ClassVar

import numpy as np
from numpy.typing import NDArray

from planewise import sensors
from planewise.camera import PinholeCamera
from planewise.datasets.frames import Dataset, DatasetFrame, numbered
from planewise.datasets.paths import inside, listed
from planewise.datasets.picture_folder import known_pose
from planewise.datasets.scannet import camera_of
from planewise.errors import PlanewiseError
from planewise.files.colour import read_colour
from planewise.files.depth import check_size
from planewise.wording import counted

VERSION = 4

_LONGEST_NAME = 1024
_MOST_FRAMES = 1_000_000  # nine hours; more is a damaged header
_OVERHEAD = 1 << 16  # bytes that a packed image may take beyond 4 a pixel
_MATRICES = struct.Struct("<64f")
_HEADER = struct.Struct("<iiIIIIfQ")
_FRAME = struct.Struct("<16f4Q")
_RAW, _ZLIB = 0, 1  # compressions of depth
_PNG, _JPEG = 1, 2  # of colour


@dataclass(frozen=True, kw_only=True)
class SensHeader:
    """What a recording says about all its frames.

    Attributes
    ----------
    camera : PinholeCamera
        Of the depth images.
    colour, depth : int
        Codes of their compressions.
    depth_shift : float
        Units in a metre.
    colour_shape, shape : (height, width)
        Of the pictures and depth images.
    frames : int
        How many there should be.
    start : int
        Where the first begins, bytes.
    """

    camera: PinholeCamera
    colour: int
    depth: int
    depth_shift: float
    colour_shape: tuple[int, int]
    shape: tuple[int, int]
    frames: int
    start: int


class SensFile(Dataset):
    """One ``.sens`` recording. Ids are the numbers of its frames, ``000000`` and so on.

    To open it, the head of each frame is read, not the frame. Where the file ends early, or a head
    makes no sense, this frame and the following ones are there by name, and raise when they are
    read. Pictures are larger than depth images. The timestamp is the depth image's.

    Parameters
    ----------
    path : path
        The file, or a folder that holds one such file.
    camera : PinholeCamera, optional
        Of the depth images, instead of the one in the file.
    """

    kind: ClassVar[str] = "sens"
    holds: ClassVar[str] = "a .sens file, or a folder with one (ScanNet)"
    sensor = sensors.STRUCTURE

    def __init__(self, path: str | Path, *, camera: PinholeCamera | None = None) -> None:
        self.path = _file(Path(path))
        if not self.path.is_file():
            raise PlanewiseError(f"data: there is no file {path}")
        with self.path.open("rb") as stream:
            try:
                self.header = _read_header(stream)
            except PlanewiseError as error:
                raise PlanewiseError(f"data: {self.path.name} {error}") from None
            self._starts = _frame_starts(stream, self.header)
        self.camera = camera or self.header.camera
        super().__init__(self.path.name, numbered(self.header.frames))

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether it begins like a recording, or is a folder with one .sens file."""
        path = _file(path)
        if not path.is_file():
            return False
        if path.suffix.lower() == ".sens":
            return True  # opening it says what is wrong, if anything is
        with path.open("rb") as stream:
            try:
                _read_header(stream)
            except PlanewiseError:
                return False
        return True

    def _read(self, frame: str) -> DatasetFrame:
        number = int(frame)
        if number >= len(self._starts):
            raise PlanewiseError(
                f"is not in the file, which is cut short or damaged after {len(self._starts)} of "
                + counted(self.header.frames, "frame")
            )
        with self.path.open("rb") as stream:
            stream.seek(int(self._starts[number]))
            *pose, _, time, colour_size, depth_size = _FRAME.unpack(stream.read(_FRAME.size))
            rgb = None
            if self.pictures and colour_size:
                rgb = self._colour(stream.read(colour_size))
            else:
                stream.seek(colour_size, 1)
            depth = self._depth(stream.read(depth_size))
        return DatasetFrame(
            id=frame,
            depth=depth,
            camera=self.camera,
            depth_scale=1 / self.header.depth_shift,
            rgb=rgb,
            timestamp=time / 1e6,
            pose=known_pose(np.array(pose, np.float64).reshape(4, 4)) if self.poses else None,
        )

    def _colour(self, data: bytes) -> NDArray[np.uint8]:
        if self.header.colour in (_PNG, _JPEG):
            return read_colour(BytesIO(data))
        height, width = self.header.colour_shape
        if len(data) != 3 * height * width:
            raise PlanewiseError(f"the picture has {len(data)} bytes, not {3 * height * width}")
        return np.frombuffer(data, np.uint8).reshape(height, width, 3).copy()

    def _depth(self, data: bytes) -> NDArray[np.uint16]:
        height, width = self.header.shape
        size = 2 * height * width
        if self.header.depth == _ZLIB:
            unpack = zlib.decompressobj()
            data = unpack.decompress(data, size + 1)  # no more than that, whatever it holds
            if len(data) == size and not unpack.eof:
                raise PlanewiseError("the depth image is damaged: its end is missing")
        if len(data) != size:
            more = "more than " if len(data) > size else ""
            raise PlanewiseError(
                f"the depth image is damaged: it has {more}{min(len(data), size):,} bytes, "
                f"expected {size:,}"
            )
        return np.frombuffer(data, "<u2").reshape(height, width).astype(np.uint16)


def _file(path: Path) -> Path:
    """Return the file, or the only .sens file of the folder."""
    if not path.is_dir():
        return path
    files = listed(path, lambda each: each.suffix.lower() == ".sens")
    return inside(path, files[0].name) if len(files) == 1 else path


def _read_header(stream: IO[bytes]) -> SensHeader:
    def read(layout: struct.Struct) -> tuple[float, ...]:
        data = stream.read(layout.size)
        if len(data) < layout.size:
            raise PlanewiseError("is cut short: not even its header is whole")
        return layout.unpack(data)

    version, length = read(struct.Struct("<IQ"))
    if version != VERSION or length > _LONGEST_NAME:
        raise PlanewiseError(f"is no recording of ScanNet of version {VERSION}")
    stream.seek(int(length), 1)
    matrices = np.array(read(_MATRICES)).reshape(4, 4, 4)
    colour, depth, wide, high, width, height, shift, frames = read(_HEADER)
    if colour not in (_RAW, _PNG, _JPEG) or depth not in (_RAW, _ZLIB):
        raise PlanewiseError(
            f"has compressions {colour} (colour) and {depth} (depth); known are raw, PNG and JPEG, "
            "and raw and zlib"
        )
    if not 0 < shift < np.inf or not 0 < frames <= _MOST_FRAMES or min(width, height) < 1:
        raise PlanewiseError(
            f"has a damaged header: {frames:,} frames of {width} x {height}, {shift} units a metre"
        )
    check_size(int(width * height))
    check_size(int(wide * high))
    shape = int(height), int(width)
    return SensHeader(
        camera=camera_of(matrices[2], width=shape[1], height=shape[0]),
        colour=int(colour),
        depth=int(depth),
        depth_shift=shift,
        colour_shape=(int(high), int(wide)),
        shape=shape,
        frames=int(frames),
        start=stream.tell(),
    )


def _frame_starts(stream: IO[bytes], header: SensHeader) -> NDArray[np.int64]:
    """Where the frames begin, as far as their heads make sense and the file goes."""
    end = stream.seek(0, 2)
    shapes = (header.colour_shape, header.shape)
    most_colour, most_depth = (4 * rows * columns + _OVERHEAD for rows, columns in shapes)
    starts: list[int] = []
    at = header.start
    while len(starts) < header.frames and at + _FRAME.size <= end:
        stream.seek(at)
        colour, depth = _FRAME.unpack(stream.read(_FRAME.size))[-2:]
        if colour > most_colour or depth > most_depth or at + colour + depth + _FRAME.size > end:
            break
        starts.append(at)
        at += _FRAME.size + colour + depth
    return np.array(starts, np.int64)
