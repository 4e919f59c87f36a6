"""Regions of a label image as polygons, by the borders between them.

Regions share their borders: each border line is simplified once, so that neighbours still meet and
do not overlap.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.outlines.outlines import load_shapely

Labels = NDArray[np.integer]

_MOST_LINES = 10_000  # that are simplified together, which takes the square of their number: 1 s
_APART = 0.49  # pixels: lines that move by less do not meet, each for itself


def regions(labels: Labels, tolerance: float) -> dict[int, list[Any]]:
    """Polygons of every label but 0; pieces are connected by the sides of pixels.

    Parameters
    ----------
    labels : ndarray of int, shape (H, W)
        0 for no region.
    tolerance : float
        How far a simplified border may be from that of the pixels, in pixels; 0 keeps it exactly.
        Above 0, pieces and holes that are nowhere wider than a pixel are left out. From 1.5 on a
        straight border at any angle becomes one line. Labels of more than 10,000 lines, such as
        those of frames half of whose readings are missing here and there, keep to half a pixel.

    Returns
    -------
    dict of int to list of shapely.Polygon
        In pixel coordinates: pixel (row i, column j) is the square around x = j, y = i.
    """
    shapely = load_shapely()
    lines = shapely.line_merge(shapely.multilinestrings(_lines(shapely, labels)))
    sides = _sides(shapely, shapely.get_parts(lines), labels)
    if tolerance:
        if shapely.get_num_geometries(lines) > _MOST_LINES:
            lines = shapely.simplify(lines, min(tolerance, _APART), preserve_topology=False)
        else:
            lines = shapely.simplify(lines, tolerance, preserve_topology=True)
    borders = shapely.get_parts(lines)
    faces = shapely.orient_polygons(shapely.get_parts(shapely.polygonize(borders)))
    within = _within(shapely, faces, borders, sides, labels.shape[1])
    found: dict[int, list[Any]] = {}
    for face, label in zip(faces, within.tolist(), strict=True):
        if label:
            found.setdefault(label, []).append(face)
    if tolerance:
        found = {
            label: [_open(shapely, piece) for piece in pieces if _wide(piece)]
            for label, pieces in found.items()
        }
    return found


def _sides(shapely: Any, borders: Any, labels: Labels) -> Labels:
    """Labels to the left and right of every border, shape (n, 2); left of x is y."""
    start, then = (shapely.get_coordinates(shapely.get_point(borders, i)) for i in (0, 1))
    ahead = np.sign(then - start)
    left = ahead[:, ::-1] * (-1, 1)
    pixels = np.stack([start + (ahead + side) / 2 for side in (left, -left)])
    columns, rows = np.rint(pixels + 1).astype(int).T
    return np.asarray(np.pad(labels, 1)[rows, columns])


def _within(shapely: Any, faces: Any, borders: Any, sides: Labels, width: int) -> Labels:
    """Label of every face: that to the left of the borders that its shell is made of.

    No pixel is sure to tell it, for a border may have passed over any by up to the tolerance.
    """

    def corner(places: Any) -> NDArray[np.int64]:
        return np.asarray(np.rint(places + 0.5).astype(np.int64) @ (1, width + 1))

    first, second = (corner(shapely.get_coordinates(shapely.get_point(borders, i))) for i in (0, 1))
    places, face = shapely.get_coordinates(shapely.get_exterior_ring(faces), return_index=True)
    shell = corner(places)
    many = shell.max(initial=0) + 1
    known = np.concatenate((first * many + second, second * many + first))
    step = shell[:-1] * many + shell[1:]
    order = np.argsort(known)
    found = order[np.searchsorted(known, step, sorter=order) % max(len(known), 1)]
    same = (known[found] == step) & (face[1:] == face[:-1])
    out = np.zeros(len(faces), sides.dtype)
    out[face[:-1][same]] = sides.T.ravel()[found[same]]
    return out


def _wide(piece: Any) -> bool:
    """Whether a piece is somewhere wider than a pixel."""
    return piece.area > 1 and not piece.buffer(-0.501).is_empty


def _open(shapely: Any, piece: Any) -> Any:
    """Fill the holes that are no wider than a pixel."""
    kept = [hole for hole in piece.interiors if _wide(shapely.Polygon(hole))]
    return piece if len(kept) == len(piece.interiors) else shapely.Polygon(piece.exterior, kept)


def _lines(shapely: Any, labels: Labels) -> Any:
    """Straight pieces of all borders, between the corners where borders turn or meet."""
    padded = np.pad(labels, 1)
    upright = padded[1:-1, 1:] != padded[1:-1, :-1]  # (H, W + 1): left of pixel j
    level = padded[1:, 1:-1] != padded[:-1, 1:-1]  # (H + 1, W): above pixel i
    # A lattice point is a node where lines of both directions end or cross.
    vertical = np.pad(upright, ((1, 0), (0, 0))) | np.pad(upright, ((0, 1), (0, 0)))
    horizontal = np.pad(level, ((0, 0), (1, 0))) | np.pad(level, ((0, 0), (0, 1)))
    nodes = vertical & horizontal
    runs = [_runs(level, nodes), _runs(upright.T, nodes.T)[:, [1, 0, 3, 2]]]
    ends = np.concatenate(runs).reshape(-1, 2, 2)[:, :, ::-1] - 0.5  # rows, columns -> x, y
    return shapely.linestrings(ends)


def _runs(edges: NDArray[np.bool_], nodes: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Rows (i, first, i, last) of runs of edges along axis 1, broken at nodes."""
    before = np.pad(edges, ((0, 0), (1, 0)))[:, :-1]
    after = np.pad(edges, ((0, 0), (0, 1)))[:, 1:]
    starts = np.argwhere(edges & (~before | nodes[:, :-1]))
    stops = np.argwhere(edges & (~after | nodes[:, 1:]))
    return np.column_stack((starts, stops[:, 0], stops[:, 1] + 1)).astype(np.float64)
