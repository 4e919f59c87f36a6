"""A file of records to which is only added: a record is there whole, or it is not there.

A line is the checksum of a record, a space, the record and a line feed. A process that is killed
while it writes leaves the beginning of a line at the end of the file, which no reader takes.
"""

from __future__ import annotations

import os
import zlib
from pathlib import Path

from planewise.batch.staging import sync_folder

_NO_LINK = getattr(os, "O_NOFOLLOW", 0)  # which Windows lacks


def read_records(path: Path) -> list[bytes]:
    """Records of a file, up to the first damaged line; none where there is no file."""
    return _whole_records(path)[0]


class Journal:
    """File that is open for more records.

    Parameters
    ----------
    path : Path
        Made if need be; what a killed process left at its end is cut off.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        records, whole = _whole_records(path)
        self.count = len(records)
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | _NO_LINK, 0o666)
        try:
            os.ftruncate(self._file, whole)
            os.lseek(self._file, 0, os.SEEK_END)
            os.fsync(self._file)
            sync_folder(path.parent)
        except OSError:
            self.close()
            raise

    def add(self, records: list[bytes]) -> None:
        """Add records; when this returns, they survive a loss of power.

        Raises
        ------
        OSError
            If there is no room; then none of them counts.
        """
        end = os.lseek(self._file, 0, os.SEEK_CUR)
        try:
            rest = memoryview(b"".join(map(line_of, records)))
            while rest:
                rest = rest[os.write(self._file, rest) :]
            os.fsync(self._file)
        except OSError:
            os.ftruncate(self._file, end)
            os.lseek(self._file, end, os.SEEK_SET)
            raise
        self.count += len(records)

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._file)


def line_of(record: bytes) -> bytes:
    """Line of a record."""
    return b"%08x %b\n" % (zlib.crc32(record), record)


def _whole_records(path: Path) -> tuple[list[bytes], int]:
    """Records, and the bytes they take."""
    records: list[bytes] = []
    whole = 0
    try:
        lines = path.read_bytes().splitlines(keepends=True)
    except FileNotFoundError:
        return records, whole
    for line in lines:
        record = line[9:-1]
        if line != line_of(record):
            break
        records.append(record)
        whole += len(line)
    return records, whole
