"""Loop over the pieces of labels: pixels of one label that hang together."""

from __future__ import annotations

from planewise.kernels.jit import compiled, internal
from planewise.kernels.roots import root_of


@internal
def _unite(parent, one, other):  # type: ignore[no-untyped-def]
    one, other = root_of(parent, one), root_of(parent, other)
    parent[max(one, other)] = min(one, other)


@compiled
def label_pieces(labels, reach, wraps, parent, label, out):  # type: ignore[no-untyped-def]
    """Number the pieces of every label, by their first pixel: from 1 in raster order.

    Two pixels of one label hang together if they are at most `reach` rows and columns apart.
    labels (H, W): 0 for none; wraps: whether the last column is beside the first; parent (H W,)
    int32: room to work in. Writes label (most,): of every piece, and out (H, W): pieces, 0 where
    labels are. Returns how many there are; more than `most` are left out.

    Only pixels whose neighbour to the left or above has another label look farther: from another
    one, one of these two is nearer to what they reach.
    """
    height, width = labels.shape
    for k in range(parent.size):
        parent[k] = k
    for i in range(height):
        for j in range(width):
            mine = labels[i, j]
            if mine == 0:
                continue
            at = i * width + j
            if i > 0 and j > 0 and labels[i, j - 1] == mine and labels[i - 1, j] == mine:
                if parent[at] == at:
                    parent[at] = root_of(parent, at - 1)
                else:  # across the end of the row
                    _unite(parent, at, at - 1)
                if labels[i - 1, j - 1] != mine:
                    _unite(parent, at, at - width)
                continue
            for row in range(max(i - reach, 0), i + 1):
                for step in range(-reach, 0 if row == i else reach + 1):
                    column = j + step
                    if wraps:
                        column %= width
                    if 0 <= column < width and labels[row, column] == mine:
                        _unite(parent, at, row * width + column)
    found = 0
    for i in range(height):
        for j in range(width):
            out[i, j] = 0
            if labels[i, j] == 0:
                continue
            at = i * width + j
            first = root_of(parent, at)
            if first == at:
                if found < label.size:
                    label[found] = labels[i, j]
                found += 1
                number = found
            else:
                number = out[first // width, first % width]
            out[i, j] = number if number <= label.size else 0
    return found
