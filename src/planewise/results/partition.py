"""Read the regions of a frame from a file or a folder."""

from __future__ import annotations

from pathlib import Path

from planewise.errors import PlanewiseError
from planewise.files.depth import MAX_PIXELS, natural_order, read_array
from planewise.files.labels import read_labels
from planewise.partition import Partitioner, as_partitioner

_LABELS = (".png", ".npy", ".npz")
_MASKS = (".png", ".npy")
_STACK = 3  # largest images that a file of masks may hold


def read_partition(path: str | Path, frame: str, *, many: bool = False) -> Partitioner:
    """Regions of one frame.

    Parameters
    ----------
    path : path
        A label image (PNG, ``.npy``, ``.npz`` with ``labels`` or ``gt``), an ``.npy`` of masks (N,
        H, W), or a folder. In a folder, the label image or the folder of masks named like the
        frame; else the folder's pictures and ``.npy`` are the masks.
    frame : str
        Name of the frame without ending.
    many : bool
        Whether there are other frames: then every one needs what is named like it.

    Raises
    ------
    PlanewiseError
        If there is no such file, or it is none of these.
    """
    path = Path(path)
    if path.is_dir():
        own = [path / (frame + suffix) for suffix in _LABELS]
        file = next((each for each in own if each.is_file()), None)
        if file is not None:
            return _read(file)
        if (path / frame).is_dir():
            return _masks(path / frame)
        if many:
            raise PlanewiseError(
                f"partition: {path} holds no label image and no folder of masks named {frame}"
            )
        return _masks(path)
    if many:
        raise PlanewiseError(
            f"partition: for a folder of frames, {path} has to be a folder, too, with a label "
            "image or a folder of masks for each"
        )
    return _read(path)


def _read(path: Path) -> Partitioner:
    if path.suffix.lower() == ".npy" and path.is_file():
        try:
            with path.open("rb") as stream:
                return as_partitioner(read_array(stream, _STACK * MAX_PIXELS))
        except PlanewiseError as error:
            raise PlanewiseError(f"partition: {path.name} {error}") from None
        except (OSError, ValueError) as error:
            raise PlanewiseError(f"partition: {path.name} cannot be used: {error}") from None
    return as_partitioner(read_labels(path, name="partition").labels)


def _masks(folder: Path) -> Partitioner:
    files = [
        path
        for path in sorted(folder.iterdir(), key=natural_order)
        if path.suffix.lower() in _MASKS and not path.name.startswith(".")
    ]
    if not files:
        raise PlanewiseError(f"partition: {folder} holds no masks ({', '.join(_MASKS)})")
    return as_partitioner([read_labels(path, name="partition").labels for path in files])
