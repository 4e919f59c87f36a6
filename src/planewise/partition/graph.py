"""Graph-based segmentation of colour and depth, after Felzenszwalb and Huttenlocher (2004).

Neighbouring pixels are joined where they differ by little against how much their regions vary. The
algorithm is scikit-image's; here are the channels it compares: normals, log depth, and colour where
there is any.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import is_finite, make_counts
from planewise.errors import needs
from planewise.partition.regions import Regions
from planewise.runtime.foreign_warnings import without_warnings
from planewise.wording import unusual

if TYPE_CHECKING:
    from planewise.partition.partitioner import View

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Graph:
    """Graph-based regions of colour, normals and depth; needs the extra ``partition``.

    Parameters
    ----------
    scale : float
        The larger, the larger regions are.
    smoothing : float
        Pixels by which channels are smoothed before.
    least : int
        Pixels of the smallest region.
    colour, normals, depth : float
        Weights: of a colour from black to white, of normals at right angles, of a step of depth by
        its whole.
    reach : int
        Pixels about a pixel from which its normal is fitted.
    """

    scale: float = 1000.0
    smoothing: float = 0.8
    least: int = 300
    colour: float = 0.5
    normals: float = 1.0
    depth: float = 1.0
    reach: int = 5

    def __post_init__(self) -> None:
        if not (is_finite(self.scale) and self.scale > 0):
            raise ValueError(f"scale must be a positive number, got {self.scale!r}")
        for name in ("smoothing", "colour", "normals", "depth"):
            value = getattr(self, name)
            if not (is_finite(value) and value >= 0):
                raise ValueError(f"{name} must be a number that is not negative, got {value!r}")
        make_counts(self, "least", "reach")

    def __call__(self, view: View) -> Regions:
        """Region of every pixel, from 1."""
        felzenszwalb = self.load()
        # It expects colours; more channels are what is meant here.
        with without_warnings(RuntimeWarning, message="Got image with third dimension"):
            regions = felzenszwalb(
                self.channels(view),
                scale=self.scale,
                sigma=self.smoothing,
                min_size=self.least,
                channel_axis=-1,
            )
        return np.asarray(regions + 1, np.int32)

    @staticmethod
    def load() -> Callable[..., NDArray[Any]]:
        """Import the algorithm, or say which extra has it."""
        with needs("scikit-image", "the partition 'graph'", "partition"):
            from skimage.segmentation import felzenszwalb
        found: Callable[..., NDArray[Any]] = felzenszwalb
        return found

    def channels(self, view: View) -> Array:
        """What is compared, shape (H, W, 4 or 7): normals, log depth, colour, each weighted."""
        there = np.isfinite(view.depth)
        z = np.where(there, view.depth, 1.0)
        parts = [
            self.normals * normals(view, self.reach),
            self.depth * np.where(there, np.log(z), 0.0)[..., None],
        ]
        if view.rgb is not None:
            parts.append(self.colour * view.rgb.astype(np.float64) / 255.0)
        return np.concatenate(parts, axis=-1)

    def describe(self) -> str:
        """Say what it is."""
        said = f"graph, scale {self.scale:.15g}, regions of at least {self.least} pixels"
        return said + unusual(self, but=("scale", "least"))


def normals(view: View, reach: int) -> Array:
    """Unit normals facing the camera, shape (H, W, 3); zeros where there is no reading.

    The plane 1 / depth = theta . r, r the ray, fitted to the readings of a square about each pixel
    by least squares; where they determine none, towards the camera.
    """
    from scipy import ndimage

    there = np.isfinite(view.depth)
    camera, shape = view.camera, view.depth.shape
    rays = np.moveaxis(camera.rays(shape), -1, 0)
    w = np.where(there, 1.0 / np.where(there, view.depth, 1.0), 0.0)
    around: dict[str, Any] = {
        "size": 2 * reach + 1,
        "mode": ("reflect", "wrap" if camera.wraps else "reflect"),
    }
    share = ndimage.uniform_filter(there.astype(np.float64), **around)

    def mean(image: NDArray[Any]) -> Array:
        """Of the readings about every pixel."""
        total = ndimage.uniform_filter(np.where(there, image, 0.0), **around)
        out: Array = np.divide(total, share, np.zeros_like(total), where=share > 1e-9)
        return out

    # In axes of which the last points outwards, by column: r = (u, v, c), c = 1 in pinhole images.
    sectors = camera.sectors(shape)
    axes = sectors.axes[sectors.home]
    square = np.empty((3, 3, *shape))
    for i, j in zip(*np.triu_indices(3), strict=True):
        square[i, j] = square[j, i] = mean(rays[i] * rays[j])
    square = np.swapaxes(axes, -1, -2) @ np.moveaxis(square, (0, 1), (-2, -1)) @ axes
    product = np.stack([mean(each * w) for each in rays], axis=-1)[..., None, :] @ axes
    (uu, uv, uc), (_, vv, vc), (_, _, cc) = np.moveaxis(square, (-2, -1), (0, 1))
    uw, vw, cw = np.moveaxis(product[..., 0, :], -1, 0)
    cc = np.where(there, cc, 1.0)
    # c is eliminated first, which takes away the means.
    mean_u, mean_v, mean_w = uc / cc, vc / cc, cw / cc
    uu, uv, vv = uu - uc * mean_u, uv - uc * mean_v, vv - vc * mean_v
    uw, vw = uw - uc * mean_w, vw - vc * mean_w
    determinant = uu * vv - uv * uv
    told = there & (determinant > 1e-6 * uu * vv)
    one = np.where(told, determinant, 1.0)
    along_u = np.where(told, (vv * uw - uv * vw) / one, 0.0)
    along_v = np.where(told, (uu * vw - uv * uw) / one, 0.0)
    theta = np.stack((along_u, along_v, mean_w - along_u * mean_u - along_v * mean_v), axis=-1)
    theta = (axes @ theta[..., None])[..., 0]
    size = np.linalg.norm(theta, axis=-1, keepdims=True)
    unit: Array = np.divide(-theta, size, np.zeros_like(theta), where=size > 0)
    return np.asarray(np.where(there[..., None], unit, 0.0))
