"""Write outlines: `outlines.json`, and the surfaces as meshes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise._version import __version__
from planewise.outlines.outlines import Polygon, Surface
from planewise.results.mesh import write_mesh_ply, write_obj

Array = NDArray[np.float64]

OUTLINES_SCHEMA_VERSION = 1
"""Version of the layout of ``outlines.json``; raised when a reader has to change."""

OUTLINES_SCHEMA_FILE = Path(__file__).with_name("outlines.schema.json")
"""JSON Schema of ``outlines.json``."""


def write_outlines(
    folder: Path, surfaces: Sequence[Surface], *, frame: str, offset: Array | None = None
) -> None:
    """Write ``outlines.json``, ``planes.obj`` with ``planes.mtl``, and ``planes.ply``.

    Parameters
    ----------
    folder : Path
        Existing folder.
    surfaces : sequence of Surface
        What to write.
    frame : str
        What the coordinates are, in words.
    offset : ndarray, shape (3,), optional
        What to add to coordinates in space.
    """
    offset = np.zeros(3) if offset is None else offset
    record = describe_outlines(surfaces, frame=frame, offset=offset)
    text = json.dumps(record, allow_nan=False) + "\n"
    (folder / "outlines.json").write_text(text, encoding="utf-8")
    write_obj(folder / "planes.obj", surfaces, offset)
    write_mesh_ply(folder / "planes.ply", surfaces, offset)


def describe_outlines(surfaces: Sequence[Surface], *, frame: str, offset: Array) -> dict[str, Any]:
    """Say in plain types where surfaces lie: the content of ``outlines.json``.

    Laid out like GeoJSON, but in metres of the given frame instead of degrees: one feature a
    surface, polygons in space as its geometry, the same in plane coordinates as a property. Rings
    are closed: the first point is repeated.

    Parameters
    ----------
    surfaces, frame, offset
        As in `write_outlines`.
    """
    return {
        "type": "FeatureCollection",
        "schema": "planewise/outlines",
        "schema_version": OUTLINES_SCHEMA_VERSION,
        "planewise_version": __version__,
        "units": {"length": "metre", "area": "square metre", "angle": "radian"},
        "frame": frame,
        "features": [_feature(surface, offset) for surface in surfaces],
    }


def _feature(surface: Surface, offset: Array) -> dict[str, Any]:
    frame, extent = surface.frame, surface.extent
    return {
        "type": "Feature",
        "properties": {
            "plane": surface.plane,
            "surface": surface.surface,
            "area": surface.area,
            "extent": None
            if extent is None
            else {
                "length": extent.length,
                "width": extent.width,
                "angle": extent.angle,
                "centre": extent.centre.tolist(),
                "corners": (surface.corners + offset).tolist(),
            },
            "origin": (frame.origin + offset).tolist(),
            "u": frame.u.tolist(),
            "v": frame.v.tolist(),
            "normal": frame.normal.tolist(),
            "plane_coordinates": [_rings(polygon) for polygon in surface.polygons],
        },
        "geometry": {
            "type": "MultiPolygon",
            "coordinates": [[_closed(ring + offset) for ring in rings] for rings in surface.rings],
        },
    }


def _rings(polygon: Polygon) -> list[list[list[float]]]:
    return [_closed(ring) for ring in (polygon.shell, *polygon.holes)]


def _closed(ring: Array) -> list[list[float]]:
    return np.vstack((ring, ring[:1])).tolist()  # type: ignore[no-any-return]
