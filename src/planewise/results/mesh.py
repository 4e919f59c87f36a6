"""Surfaces as triangles, and files of them: OBJ with its materials, and PLY."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.drawing.palette import distinct_colours
from planewise.files.cloud_columns import COLOUR
from planewise.files.ply import vertex_header
from planewise.outlines.outlines import Surface, as_shapely, load_shapely

Array = NDArray[np.float64]

_FLAT = 1e-12  # area, against the largest, below which three corners are in a line


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """Triangles of one surface.

    Attributes
    ----------
    vertices : ndarray, shape (n, 3)
        Metres, on the plane.
    triangles : ndarray of int, shape (m, 3)
        Rows of `vertices`, counter-clockwise seen from the side that the normal points to.
    """

    vertices: Array
    triangles: NDArray[np.int64]


def triangulate(surface: Surface) -> Mesh:
    """Cut a surface, its holes left out, into triangles between its corners.

    The triangulation is Delaunay's, constrained to the borders.
    """
    shapely = load_shapely()
    if not surface.polygons:
        return Mesh(vertices=np.empty((0, 3)), triangles=np.empty((0, 3), np.int64))
    parts = _triangles(shapely, as_shapely(surface))
    rings = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    corners, index = np.unique(rings.reshape(-1, 2), axis=0, return_inverse=True)
    triangles = index.reshape(-1, 3)
    a, b, c = np.moveaxis(corners[triangles], 1, 0)
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]  # the signed area
    triangles = np.where(twice[:, None] < 0, triangles[:, ::-1], triangles)
    triangles = triangles[np.abs(twice) > _FLAT * np.abs(twice).max()]
    return Mesh(vertices=surface.frame.to_space(corners), triangles=triangles)


def _triangles(shapely: Any, shape: Any, cuts: int = 12) -> NDArray[Any]:
    """Triangles of a shape; one whose holes touch in a way that GEOS fails on is cut in halves."""
    try:
        return np.asarray(shapely.get_parts(shapely.constrained_delaunay_triangles(shape)))
    except shapely.GEOSException:
        if not cuts:
            raise
    left, low, right, high = shape.bounds
    if right - left > high - low:
        middle = (left + right) / 2
        halves = (left, low, middle, high), (middle, low, right, high)
    else:
        middle = (low + high) / 2
        halves = (left, low, right, middle), (left, middle, right, high)
    pieces = [shapely.intersection(shape, shapely.box(*half)) for half in halves]
    areas = [part for piece in pieces for part in shapely.get_parts(piece) if part.area > 0]
    found = [_triangles(shapely, area, cuts - 1) for area in areas]
    return np.concatenate(found) if found else np.empty(0, object)


def write_obj(path: Path, surfaces: Sequence[Surface], offset: Array) -> None:
    """Write surfaces as OBJ, an object each, with their colours in an MTL file beside it.

    Parameters
    ----------
    path : Path
        New file; the materials go to the same name with the ending ``.mtl``.
    surfaces : sequence of Surface
        What to write; those without polygons are left out.
    offset : ndarray, shape (3,)
        What to add to all coordinates.
    """
    materials = path.with_suffix(".mtl")
    lines, first, normal = [f"mtllib {materials.name}"], 1, 0
    for surface in surfaces:
        mesh = triangulate(surface)
        if not len(mesh.triangles):
            continue
        piece = f"_surface_{surface.surface}" if surface.surface else ""
        lines += [f"o plane_{surface.plane}{piece}", f"usemtl plane_{surface.plane}"]
        # repr: every digit, for coordinates may be in the millions.
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in (mesh.vertices + offset).tolist()]
        lines += ["vn {!r} {!r} {!r}".format(*surface.frame.normal.tolist())]
        normal += 1
        lines += [
            "f " + " ".join(f"{corner + first}//{normal}" for corner in triangle)
            for triangle in mesh.triangles.tolist()
        ]
        first += len(mesh.vertices)
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    planes = sorted({surface.plane for surface in surfaces})
    colours = distinct_colours(max(planes, default=0)) / 255
    materials.write_text(
        "".join(
            "newmtl plane_{}\nKd {:.4f} {:.4f} {:.4f}\n".format(plane, *colours[plane - 1])
            for plane in planes
        ),
        encoding="ascii",
    )


def write_mesh_ply(path: Path, surfaces: Sequence[Surface], offset: Array) -> None:
    """Write surfaces as one binary PLY mesh with colours, and plane and surface of every face.

    Parameters
    ----------
    path, surfaces, offset
        As in `write_obj`.
    """
    meshes = [triangulate(surface) for surface in surfaces]
    colours = distinct_colours(max((surface.plane for surface in surfaces), default=0))
    corner = np.dtype([*((name, "<f8") for name in "xyz"), *((name, "u1") for name in COLOUR)])
    face = np.dtype([("n", "u1"), ("corners", "<i4", (3,)), ("plane", "<u2"), ("surface", "<u2")])
    vertices = np.empty(sum(len(mesh.vertices) for mesh in meshes), corner)
    faces = np.empty(sum(len(mesh.triangles) for mesh in meshes), face)
    faces["n"] = 3
    v = f = 0
    for surface, mesh in zip(surfaces, meshes, strict=True):
        here = vertices[v : v + len(mesh.vertices)]
        for k, name in enumerate("xyz"):
            here[name] = mesh.vertices[:, k] + offset[k]
        for k, name in enumerate(COLOUR):
            here[name] = colours[surface.plane - 1, k]
        those = faces[f : f + len(mesh.triangles)]
        those["corners"] = mesh.triangles + v
        those["plane"], those["surface"] = surface.plane, surface.surface
        v, f = v + len(mesh.vertices), f + len(mesh.triangles)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *vertex_header(len(vertices), corner),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "property ushort plane",
        "property ushort surface",
        "end_header\n",
    ]
    with path.open("wb") as stream:
        stream.write("\n".join(header).encode())
        vertices.tofile(stream)
        faces.tofile(stream)
