"""LZF, the compression of binary_compressed PCD files (Lehmann, LibLZF)."""

from __future__ import annotations

from planewise.kernels.jit import in_order


@in_order
def unpack(packed, out):  # type: ignore[no-untyped-def]
    """Unpack into `out`; returns how many bytes were written, or -1 where the data is damaged.

    A control byte below 32 is followed by that many bytes and one more, as they are. Any other
    holds a length (3 bits) and, with the byte or bytes after it, how far back to copy from.
    """
    read, write = 0, 0
    while read < packed.size:
        control = int(packed[read])
        read += 1
        if control < 32:
            length = control + 1
            if read + length > packed.size or write + length > out.size:
                return -1
            for _ in range(length):
                out[write] = packed[read]
                read += 1
                write += 1
            continue
        length = control >> 5
        if length == 7:
            if read >= packed.size:
                return -1
            length += int(packed[read])
            read += 1
        if read >= packed.size:
            return -1
        source = write - ((control & 31) << 8) - int(packed[read]) - 1
        read += 1
        length += 2
        if source < 0 or write + length > out.size:
            return -1
        for _ in range(length):  # may overlap what it writes: one byte after the other
            out[write] = out[source]
            source += 1
            write += 1
    return write
