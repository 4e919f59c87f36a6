"""What `partition=` may be, and the regions that it makes of a frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import unmasked
from planewise.camera import Camera
from planewise.observation import RayObservation
from planewise.partition.blocks import Blocks
from planewise.partition.graph import Graph
from planewise.partition.regions import Regions, regions_of_labels, regions_of_masks
from planewise.partition.segment_anything import SegmentAnything
from planewise.wording import counted


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """What a partitioner sees of a frame.

    Attributes
    ----------
    depth : ndarray of float, shape (H, W)
        Metres; NaN where there is no reading.
    camera : Camera
        What took it.
    rgb : ndarray of uint8, shape (H, W, 3), optional
        Picture of the same view.
    """

    depth: NDArray[np.float64]
    camera: Camera
    rgb: NDArray[np.uint8] | None = None


def view_of(observation: RayObservation, rgb: ArrayLike | None = None) -> View:
    """View of a depth image.

    Parameters
    ----------
    observation : RayObservation
        Of the depth image.
    rgb : array_like of uint8, shape (H, W, 3), optional
        Picture of the same view.

    Raises
    ------
    ValueError
        If the picture is of another shape or type.
    """
    depth = np.full(observation.shape, np.nan)
    depth.reshape(-1)[observation.index] = observation.depth
    picture = None
    if rgb is not None:
        picture = np.asarray(rgb)
        if picture.shape != (*observation.shape, 3) or picture.dtype != np.uint8:
            raise ValueError(
                f"rgb must be uint8 of shape {(*observation.shape, 3)}, got {picture.dtype} of "
                f"shape {picture.shape}"
            )
    return View(depth=depth, camera=observation.camera, rgb=picture)


@runtime_checkable
class Partitioner(Protocol):
    """Anything that makes regions of a frame; a function will do."""

    def __call__(self, view: View, /) -> ArrayLike | Sequence[ArrayLike]:
        """Return a label image (H, W), 0 for the remainder, or masks that may overlap."""
        ...


Partition = Partitioner | str | ArrayLike | Sequence[ArrayLike]
"""A name, a partitioner, a label image (H, W) or masks (N, H, W)."""

_NAMED: dict[str, Callable[[], Partitioner]] = {
    "auto": Graph,
    "graph": Graph,
    "blocks": Blocks,
    "sam": SegmentAnything,
}


NAMES = tuple(_NAMED)
"""Partitions that go by a name."""


@dataclass(frozen=True, eq=False)
class GivenRegions:
    """The same regions for every frame.

    Parameters
    ----------
    regions : ndarray
        Label image (H, W) of whole numbers, or masks (N, H, W).
    """

    regions: NDArray[Any] | tuple[NDArray[Any], ...]

    def __call__(self, view: View) -> NDArray[Any] | tuple[NDArray[Any], ...]:
        """Return what was given."""
        return self.regions

    def describe(self) -> str:
        """Say what it is."""
        if isinstance(self.regions, np.ndarray) and self.regions.ndim == 2:
            return "label image"
        return counted(len(self.regions), "mask")


def as_partitioner(partition: Partition) -> Partitioner:
    """Partitioner of a name, labels or masks, or the one given.

    Parameters
    ----------
    partition : str, callable, array_like or sequence of array_like
        "auto" and "graph" (`Graph`), "blocks" (`Blocks`), "sam" (`SegmentAnything`); a function of
        a `View`; a label image (H, W); or masks (N, H, W).

    Raises
    ------
    ValueError
        If it is none of these.
    """
    if isinstance(partition, str):
        if partition not in _NAMED:
            known = ", ".join(map(repr, _NAMED))
            raise ValueError(
                f"partition must be {known}, a label image, masks or a function of a view, "
                f"got {partition!r}"
            )
        return _NAMED[partition]()
    if callable(partition):
        made: Partitioner = partition
        return made
    if not _is_array(partition) and not (isinstance(partition, Sequence) and len(partition)):
        raise ValueError(
            "partition must be a name, a label image (H, W), masks (N, H, W) or a function of a "
            f"view, got {'an empty list' if partition == [] else type(partition).__name__}"
        )
    regions = _arrays(partition)
    # Copies, which nobody changes.
    if isinstance(regions, np.ndarray):
        return GivenRegions(regions.copy())
    return GivenRegions(tuple(mask.copy() for mask in regions))


def _arrays(given: Any) -> NDArray[Any] | tuple[NDArray[Any], ...]:
    """One array of labels or masks, or masks one by one, of arrays and of nested lists."""
    if _is_array(given):
        return _given(unmasked("partition", given))
    parts = tuple(unmasked("partition", part) for part in given)
    if parts and all(part.ndim == 1 for part in parts):
        return _given(unmasked("partition", parts))
    return parts


def _is_array(given: object) -> bool:
    """Whether it is one array, such as one of NumPy or a tensor, and no list of them."""
    return isinstance(given, memoryview) or hasattr(given, "__array__")


def _given(array: NDArray[Any]) -> NDArray[Any]:
    if array.ndim not in (2, 3):
        raise ValueError(
            "partition must be a label image of shape (H, W) or masks of shape (N, H, W), got "
            f"shape {array.shape}"
        )
    return array


def describe(partitioner: Partitioner) -> str:
    """Say in plain text what a partitioner is: its `describe()`, else its name."""
    if hasattr(partitioner, "describe"):
        return str(partitioner.describe())
    return str(getattr(partitioner, "__name__", type(partitioner).__name__))


def tells_itself(partitioner: Partitioner) -> bool:
    """Whether `describe` tells a partitioner from all others: no function, nor given regions."""
    return hasattr(partitioner, "describe") and not isinstance(partitioner, GivenRegions)


def regions_of(partitioner: Partitioner, view: View) -> Regions:
    """Regions that a partitioner makes of a frame, checked.

    Parameters
    ----------
    partitioner : Partitioner
        From `as_partitioner`.
    view : View
        The frame.

    Returns
    -------
    Regions
        Shape (H, W): 0 for the remainder, every number up to the largest occurs.

    Raises
    ------
    ValueError
        If it makes neither a label image nor masks of the frame's shape.
    """
    height, width = view.depth.shape
    made = partitioner(view)
    if not (_is_array(made) or isinstance(made, Iterable)):
        raise ValueError(
            "partition must return a label image (H, W) or masks (N, H, W), "
            f"got {type(made).__name__}"
        )
    regions = _arrays(made)
    if isinstance(regions, np.ndarray) and regions.ndim == 2:
        return regions_of_labels(regions, (height, width))
    return regions_of_masks(regions, (height, width))
