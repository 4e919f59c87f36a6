"""Names of the files that runs write, and which of them a new run takes away."""

from __future__ import annotations

from pathlib import Path

PARAMETERS = "planes.json"
"""What a folder of results is known by."""

LABELS = "labels.png"
"""Beside it, for whoever reads labels."""

FILES = (LABELS, PARAMETERS, "overlay.png", "curve.png")
"""What `planewise.results.image.write_results` writes."""

CLOUD_FILES = ("labelled.ply", PARAMETERS, "preview.png", "curve.png")
"""What `planewise.results.cloud.write_cloud_results` writes in any case."""

LAS_FILES = ("labelled.las", "labelled.laz")
"""Of which it writes one where that is asked for."""

OUTLINE_FILES = ("outlines.json", "planes.obj", "planes.mtl", "planes.ply")
"""What `planewise.results.outlines.write_outlines` writes."""

PICTURES = frozenset(name for name in (*FILES, *CLOUD_FILES) if name.endswith(".png"))
"""Of these, what is no depth image, though its name is that of one."""


def stale_files(folder: Path) -> tuple[str, ...]:
    """Names of files that go when new results come: those of an earlier run are of other planes.

    Without its ``planes.json`` there was no run, and files of these names are somebody's own.

    Parameters
    ----------
    folder : Path
        Where the results go.
    """
    ran = (folder / PARAMETERS).exists()
    return (*FILES, *CLOUD_FILES, *LAS_FILES, *OUTLINE_FILES) if ran else ()
