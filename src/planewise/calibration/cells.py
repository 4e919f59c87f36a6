"""Small cells of a frame about planes of their own: what shows the noise of a sensor.

On a plane inverse depth w = 1 / z is affine in the image. What remains of the readings of a cell
about its own affine fit is noise, unless the cell lies on an edge or a curved surface. Readings
come in steps of q. On a plane, with noise s,

    E V = s^2 + q^2 / 12 - sum over k of A(k m) D_k(s)
    D_k(s) = q^2 / (2 pi^2 k^2) exp(-(2 pi k s / q)^2)

with V the variance about the fit. Rounding errs by a sawtooth of the depth; noise blurs it, so that
D_k is left of the variance of its k-th harmonic, and the fit follows the share A of that when the
plane crosses m steps within the cell: all of it on a wall seen face-on, none on a steep one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planewise.density import LEAST_READINGS, usual_count
from planewise.observation import RayObservation
from planewise.waves import Waves

Array = NDArray[np.float64]

FEWEST = 12
"""Flat cells of a bin of depths, and of a frame that can tell."""

_SIDES = (8, 4)  # pixels of a cell in a large image, and in one of few cells
_FEW_CELLS = 3000  # of the larger side, below which the smaller is taken
_FILLED = 0.75  # least readings of a cell against what is usual in the frame
_NO_PLANE = 0.1  # of its depth: a cell that is rougher is none of a sensor's planes
_HARMONICS = np.arange(1, 6)
_MOST_CROSSED = 20.0  # steps within a cell; there is no difference beyond
_BLOCK = 8  # cells along the side of a block, which the bootstrap draws


@dataclass(frozen=True, kw_only=True)
class NoiseCells:
    """Cells of one frame, in raster order; arrays have shape (cells,) unless stated.

    Attributes
    ----------
    depth : ndarray
        Harmonic mean of the readings, metres; NaN where there is no plane.
    variance : ndarray
        Of the readings about the cell's own plane, square metres.
    count : ndarray
        Readings.
    step : ndarray
        Quantisation step there in metres; 0 where readings are not quantised.
    followed, mean : ndarray, shape (cells, harmonics)
        A(k m) / (2 pi^2 k^2): variance of the rounding error, in units of step^2, that the cell's
        fit follows, and that its mean has, where nothing blurs it.
    centroid : ndarray, shape (2, cells)
        Undistorted pixel coordinates about the principal point.
    inverse : ndarray
        w at the centroid, 1 / m; of a LiDAR along the axis of its sector.
    slope : ndarray, shape (2, cells)
        Of w along these coordinates, 1 / m.
    usable : ndarray of bool
        Whether the cell has enough readings and is not rougher than any sensor.
    pixel_size : (float, float)
        Of a pixel along x and y, metres at one metre.
    grid : (int, int)
        Rows and columns.
    side : int
        Pixels of a cell along either side.
    """

    depth: Array
    variance: Array
    count: Array
    step: Array
    followed: Array
    mean: Array
    centroid: Array
    inverse: Array
    slope: Array
    usable: NDArray[np.bool_]
    pixel_size: tuple[float, float]
    grid: tuple[int, int]
    side: int

    @property
    def freedom(self) -> Array:
        """Degrees of freedom of each variance."""
        return self.count - 3.0

    @property
    def block(self) -> NDArray[np.intp]:
        """Number of the block of 8 x 8 cells that each cell lies in."""
        rows, columns = self.grid
        i, j = np.arange(rows) // _BLOCK, np.arange(columns) // _BLOCK
        return np.asarray(i[:, None] * (j[-1] + 1) + j[None]).reshape(-1)

    def without(self, waves: Waves) -> NoiseCells:
        """The same where waves were left in: within a cell these are as good as straight."""
        x, y = self.centroid[:, self.usable] * np.array(self.pixel_size)[:, None]
        inverse = self.inverse.copy()
        left = waves.taken_off(1.0 / inverse[self.usable], np.stack((x, y, np.ones_like(x))))
        inverse[self.usable] = 1.0 / left
        return replace(self, inverse=inverse)


def noise_cells(observation: RayObservation, waves: Waves | None = None) -> NoiseCells:
    """Cells of a depth image, with their planes and what is left about them.

    Parameters
    ----------
    observation : RayObservation
        Of a depth image; its sigma is not looked at.
    waves : Waves, optional
        Systematic error that is taken off.
    """
    observation = observation.tame
    height, width = observation.shape
    large = (height // _SIDES[0]) * (width // _SIDES[0])
    side = _SIDES[0] if large >= _FEW_CELLS else _SIDES[1]
    cells = small = _cells_of(observation, waves, side)
    # Readings may lie far apart, as on every fourth pixel: wider cells hold enough of them.
    while cells.usable.sum() < FEWEST <= (height // (2 * side)) * (width // (2 * side)):
        side *= 2
        cells = _cells_of(observation, waves, side)
    return cells if cells.usable.sum() >= FEWEST else small


def _cells_of(observation: RayObservation, waves: Waves | None, side: int) -> NoiseCells:
    """Cells of so many pixels along either side."""
    from planewise.kernels import noise as kernels  # loads Numba

    height, width = observation.shape
    rows, columns = -(-height // side), -(-width // side)
    planes = np.empty((rows * columns, kernels.PLANE))
    pixel_size = np.array(observation.pixel_size)
    rays, z = observation.in_sectors()
    in_range = z is not observation.depth
    if waves is not None:
        z = waves.taken_off(z, rays)
    kernels.cell_planes(
        observation.index,
        z,
        rays,
        1.0 / pixel_size,
        width,
        side,
        columns,
        np.empty((rows * columns, kernels.SUMS)),
        planes,
    )
    count, x, y, inverse, *slope, squares = planes.T
    with np.errstate(invalid="ignore", divide="ignore"):
        # Where readings are ranges, z along the axis of a sector is that much shorter.
        across = (x * pixel_size[0]) ** 2 + (y * pixel_size[1]) ** 2 if in_range else 0.0
        longer = np.sqrt(1.0 + across)
        along = 1.0 / inverse
        depth = longer * along
        variance = squares / (count - 3.0) * along**4 * longer**2
        usable = (count >= max(_FILLED * usual_count(count), LEAST_READINGS)) & (
            np.sqrt(variance) < _NO_PLANE * depth
        )
        step = np.zeros(usable.shape)
        if usable.any():
            image = observation.image
            step[usable] = np.interp(depth[usable], image.depth, image.steps())
        crossed = np.abs(slope) * side * along**2 * longer / step
    quantised = usable & (step > 0)
    followed, mean = _harmonics(np.minimum(crossed, _MOST_CROSSED), quantised)
    return NoiseCells(
        depth=depth,
        variance=variance,
        count=count,
        step=step,
        followed=followed,
        mean=mean,
        centroid=np.stack((x, y)),
        inverse=inverse,
        slope=np.stack(slope),
        usable=usable,
        pixel_size=observation.pixel_size,
        grid=(rows, columns),
        side=side,
    )


def _harmonics(crossed: Array, quantised: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Shares of step^2 by harmonic k of the rounding error: A(k m) / (2 pi^2 k^2), and the mean's.

    Of shape (cells, harmonics); zero where readings are not quantised.
    """
    followed = np.zeros((crossed.shape[1], len(_HARMONICS)))
    mean = np.zeros(followed.shape)
    place = np.flatnonzero(quantised)
    m = crossed[:, place, None] * _HARMONICS
    flat, tilted = np.sinc(m) ** 2, _linear_share(m)
    size = 1.0 / (2 * np.pi**2 * _HARMONICS**2)
    mean[place] = size * flat[0] * flat[1]
    followed[place] = mean[place] + size * (tilted[0] * flat[1] + flat[0] * tilted[1])
    return followed, mean


def _linear_share(periods: Array) -> Array:
    """Share of a sinusoid's variance, averaged over phases, that a straight line follows."""
    a = np.pi * np.maximum(periods, 1e-3)
    return np.asarray(12 * ((np.sin(a) - a * np.cos(a)) / (2 * a**2)) ** 2)


def blurred(ratio: Array | float) -> Array:
    """Variance that is left of every harmonic under noise of `ratio` steps, shape (..., harmonics).

    exp(-(2 pi k s / q)^2)
    """
    # Beyond the bound nothing is left; numbers too small to be told from 0 are errors to some.
    exponent = np.minimum((2 * np.pi * np.multiply.outer(ratio, _HARMONICS)) ** 2, 300.0)
    return np.asarray(np.exp(-exponent))
