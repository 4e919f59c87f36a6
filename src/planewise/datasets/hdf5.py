"""Arrays of an HDF5 file that nobody has vouched for, whole or one row at a time.

HDF5 can do more than hold arrays: links into other files, arrays spread over others, filters that
are loaded as programs, compressed pieces that swell beyond their size. No dataset here has any of
these, and a file that does is refused.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError, in_one_line, needs
from planewise.files.depth import check_size

_DEFLATE, _SHUFFLE, _CHECKSUM = 1, 2, 3  # registered numbers of filters
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_MOST_ROWS = 1_000_000


def is_hdf5(path: Path) -> bool:
    """Whether a file begins like HDF5, or does so after the 512 bytes that MATLAB puts before."""
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        start = stream.read(512 + len(_SIGNATURE))
    return start.startswith(_SIGNATURE) or start[512:] == _SIGNATURE


def load_h5py(reading: str) -> Any:
    """Module h5py; `reading` says what for.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    with needs("h5py", f"reading {reading}", "datasets"):
        import h5py  # type: ignore[import-untyped, import-not-found, unused-ignore]
    return h5py


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open an HDF5 file to read; yields a ``h5py.File``.

    Raises
    ------
    PlanewiseError
        If it is missing or no HDF5 file.
    MissingExtraError
        If h5py is not installed.
    """
    h5py = load_h5py(path.name)
    if not path.is_file():
        raise PlanewiseError(f"data: there is no file {path}")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        old = "; files of MATLAB before version 7.3 are of another kind"
        raise PlanewiseError(
            f"data: {path.name} is no HDF5 file, or is cut short ({in_one_line(error)})"
            + old * (path.suffix == ".mat")
        ) from None
    with file:
        yield file


def array_of(file: Any, name: str, dimensions: int, kinds: str) -> Any:
    """The array of that name, checked but not read; a ``h5py.Dataset``.

    Parameters
    ----------
    file : h5py.File
        Open file.
    name : str
        Of the array.
    dimensions : int
        It must have; the first are rows, read one at a time.
    kinds : str
        Kinds of dtype it may have, as in ``numpy.dtype.kind``.

    Raises
    ------
    PlanewiseError
        If it is missing or something else.
    """
    import h5py

    link = file.get(name, getlink=True)
    found = file[name] if isinstance(link, h5py.HardLink) else None
    if not isinstance(found, h5py.Dataset):
        names = ", ".join(sorted(map(str, file.keys()))[:20]) or "nothing"
        raise PlanewiseError(f"has no array {name!r}; it holds {names}")
    if found.external or found.is_virtual:
        raise PlanewiseError(f"keeps the array {name!r} in other files, which are not read")
    if len(found.shape) != dimensions or found.dtype.kind not in kinds:
        raise PlanewiseError(
            f"has an array {name!r} of {found.dtype} and shape {found.shape}; expected "
            f"{dimensions} dimensions"
        )
    if found.shape[0] > _MOST_ROWS:
        raise PlanewiseError(f"claims {found.shape[0]:,} frames; at most {_MOST_ROWS:,} are read")
    check_size(math.prod(found.shape[-2:]))
    if dimensions > 3:
        check_size(math.prod(found.shape[1:]) // 3)
    return found


def row_of(array: Any, row: int) -> NDArray[Any]:
    """One row along the first axis, after a look at the pieces it is stored in."""
    return np.asarray(rows_of(array, slice(row, row + 1))[0])


def rows_of(array: Any, rows: slice) -> NDArray[Any]:
    """Rows along the first axis, start to stop, after a look at the pieces they are stored in."""
    if array.chunks is not None:
        check_size(math.prod(array.chunks))
        _check_pieces(array, rows)
    out = np.asarray(array[rows])
    return out.astype(out.dtype.newbyteorder("="), copy=False)


def _check_pieces(array: Any, rows: slice) -> None:
    """Refuse compressed pieces that hold more than their size, and filters that are not usual."""
    properties = array.id.get_create_plist()
    filters = [properties.get_filter(i)[0] for i in range(properties.get_nfilters())]
    if len(set(filters)) < len(filters) or not {_DEFLATE, _SHUFFLE, _CHECKSUM}.issuperset(filters):
        raise PlanewiseError(f"is packed in an unusual way (filters {filters})")
    if _DEFLATE not in filters:
        return
    size = math.prod(array.chunks) * array.dtype.itemsize
    selection = (rows, *(slice(0, n) for n in array.shape[1:]))
    for piece in array.iter_chunks(selection):
        at = tuple(part.start // n * n for part, n in zip(piece, array.chunks, strict=True))
        stored = array.id.get_chunk_info_by_coord(at)
        # Beyond its own size a piece is no deflated piece of that size, whatever it holds.
        if stored.byte_offset is None:
            continue
        if stored.size > 2 * size + 1024:
            raise PlanewiseError(f"is damaged: a piece of {size} bytes is stored in {stored.size}")
        skipped, packed = array.id.read_direct_chunk(at)
        if skipped & 1 << filters.index(_DEFLATE):
            continue
        unpacked = zlib.decompressobj().decompress(packed, size + 1)
        if len(unpacked) > size:
            raise PlanewiseError(f"is damaged: a piece holds more than its {size} bytes")
