"""A depth frame for the spatial search: images of inverse depth, and its error by depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import FINEST, MOST_LENGTH
from planewise.kernels.frame_error import noise_bias
from planewise.kernels.images import fill_between
from planewise.noise import NOTHING, ErrorParts, evaluated
from planewise.observation import RayObservation
from planewise.runtime.workspace import Workspace
from planewise.sectors import Sectors
from planewise.waves import Waves

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_SPAN = 0.05  # of depth, to either side, over which the course of the noise is read
_UNKNOWN_SHARED, _UNKNOWN_DRIFT = 2 / 3, 7 / 3  # of the noise, as the Kinect's, where not known


@dataclass(frozen=True)
class ErrorTable:
    """Variances of inverse depth, in 1 / m^2, by depth; linear between the depths that occur.

    Where depth is range, they are those of inverse range; of w = 1 / (c range) they are these over
    c^2, 1 / c^2 = 1 + a X^2 + b Y^2 in the direction of a reading.

    Attributes
    ----------
    ranging : (float, float, float)
        Rows per metre of depth, a and b, which are 0 where depth is z: inverse depth w lies at row
        ranging[0] / (c w).
    ratio : float
        Usual c.
    first : int
        Row of the nearest depth that occurs.
    white, shared, drift, step : ndarray, shape (L,)
        What is new in every reading, quantisation apart; what near readings share; how far that
        drifts over 100 pixels; and quantisation.
    """

    ranging: tuple[float, float, float]
    ratio: float
    first: int
    white: Array
    shared: Array
    drift: Array
    step: Array

    def at(self, w: float) -> tuple[float, float, float, float]:
        """White, shared, drift and step at inverse depth w > 0 in a usual direction."""
        row = min(self.ranging[0] / (self.ratio * w), self.white.size - 2.0)
        below = int(row)

        def linear(table: Array) -> float:
            near, far = table[below : below + 2].tolist()
            return float(near + (row - below) * (far - near)) / self.ratio**2

        return linear(self.white), linear(self.shared), linear(self.drift), linear(self.step)

    def noise_bias(self, w: Array) -> Array:
        """Share by which white noise makes weighted means of inverse depth too small.

        With E[z] = z0 and precisions p(z) of w = 1 / z that are those of the
        readings themselves, sum p w / sum p tends to w0 - (sigma^2 / z0^3) (d ln p / d ln z - 1): a
        reading that is too far has the larger weight. d ln p / d ln z is that of the white part,
        and 4 for a sensor whose sigma is the same everywhere. w: inverse range, where depth is.
        """
        w = np.asarray(w)
        out = np.empty(w.size)
        noise_bias(self.white, self.ranging[0], self.first, _SPAN, w.reshape(-1), out)
        return out.reshape(w.shape)


@dataclass(frozen=True)
class Frame:
    """Images (H, W) of an observation; where there is no reading `w` and `p` are zero.

    With several sectors they lie side by side, with gaps between them.

    Attributes
    ----------
    w, p : ndarray of float32
        Inverse depth in 1 / m, and one over the variance of what is new in every reading.
    x, y : ndarray of float32
        Undistorted pixel coordinates about the principal point, divided by 100.
    straight : bool
        Whether `x` is the same in every row and `y` in every column.
    table : ErrorTable
        All parts of the error.
    known : bool
        Whether shared and drift are what the sensor shows at most; else only their course over
        depth is taken from them, and their size from the frame.
    measured : bool
        Whether the white part is what frames showed, these or others, and no data sheet's.
    resolution : float
        Step between two readings in metres.
    sectors : Sectors
        What `x` and `y` are coordinates of.
    wild : float
        Nats of the readings that were set aside as wild (`planewise.wild`) and of waves that were
        taken off `w`, the same on any planes.
    waves : Waves, optional
        Which these are.
    """

    w: Image
    p: Image
    x: Image
    y: Image
    straight: bool
    table: ErrorTable
    known: bool
    measured: bool
    resolution: float
    sectors: Sectors
    wild: float = 0.0
    waves: Waves | None = None


def frame_of(
    observation: RayObservation, workspace: Workspace | None = None, wild: float = 0.0
) -> Frame:
    """Images of the readings in inverse depth; wild: nats of those that were set aside."""
    workspace = workspace or Workspace()
    image, parts = observation.image, observation.sensor.parts
    z = image.depth
    square = z * z  # z**4 is ten times as dear
    quarter = 1.0 / (square * square)
    if parts is None or (not parts.bounds and parts.drift == NOTHING):
        white = (
            observation.level_sigma if parts is None else evaluated("parts.white", parts.white, z)
        )
        shared, drift = _UNKNOWN_SHARED * white, _UNKNOWN_DRIFT * white
    else:
        white, shared, drift = _parts(parts, z)
    by_level = np.empty((4, z.size))
    for row, deviation in zip(by_level, (white, shared, drift, image.steps()), strict=True):
        np.multiply(deviation * deviation, quarter, out=row)
    by_level[3] /= 12
    w: Image = workspace.kept(image.shape, np.float32)
    p: Image = workspace.kept(image.shape, np.float32)
    image.spread(1.0 / (by_level[0] + by_level[3]), w, p)

    sectors = observation.camera.sectors(image.shape)
    w, p = sectors.spread(w, p)
    table = workspace.kept((4, int(image.levels[-1]) + 2))
    fill_between(image.levels, by_level, table)
    ranging = image.per_metre, *sectors.oblique
    return Frame(
        w=w,
        p=p,
        x=sectors.x,
        y=sectors.y,
        straight=sectors.straight,
        table=ErrorTable(ranging, sectors.mean_ratio, int(image.levels[0]), *table),
        known=parts is not None and parts.bounds,
        measured=parts is not None,
        resolution=observation.resolution,
        sectors=sectors,
        wild=wild,
    )


def _parts(parts: ErrorParts, z: Array) -> Array:
    """White, shared and drift at depths z, in metres, checked: shape (3, levels)."""
    every = np.empty((3, z.size))
    for row, name in zip(every, ("white", "shared", "drift"), strict=True):
        row[:] = evaluated(f"parts.{name}", getattr(parts, name), z)
    sound = (every[0] >= FINEST * z).all() and every.min() >= 0 and every.max() <= MOST_LENGTH
    if not sound:  # as NaN is
        raise ValueError(
            "the parts of a sensor's noise must be finite and not negative (metres), and white "
            "positive; they are not at all depths that occur"
        )
    return every
