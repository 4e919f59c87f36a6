"""Phi under the spatial objective: a code length for any planes and labels of a depth image.

    Phi = mask + N * 3 ln(R / eps) + sum over groups of their data

A group is the readings of one label in one cell of 8 x 8 pixels. Its data are normal with the white
variance of each reading, and

- on a plane, with a random offset and tilt that the whole group shares: the marginal likelihood
  with these integrated out,
- on none, on a smooth surface whose depth there takes ln(R / eps) nats and whose slopes are drawn
  from a broad prior,
- in either case anything at all where that is shorter, ln(R / eps) nats a reading; ln 2 says which.

A group labelled with a plane is a smooth surface of its own with probability 1/20: books on a table
may be labelled as the table, which costs nats, but not without bound.

Both are closed forms of the group's moments. The mask is the adaptive code of `mask_code`.
"""

from __future__ import annotations

import builtins
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.cells import TILT
from planewise.frame import Frame
from planewise.frame_error import FrameError
from planewise.information import coordinate_information, plane_information
from planewise.kernels import cells as kernels
from planewise.mask_code import spatial_mask_information

Array = NDArray[np.float64]

GROUP_SIDE = 8  # pixels of a cell whose readings share an offset and a tilt
_APART = 0.05  # probability that a group labelled with a plane is a surface of its own
_SLOPE_PRIOR = 1.0  # inclination of a surface about which nothing is known
_NORM, _NEAR, _DRIFT, _SHARED = (kernels.MOMENTS + i for i in range(4))


@dataclass(frozen=True)
class Ledger:
    """What a model costs.

    Attributes
    ----------
    order : ndarray of int, shape (N,)
        Planes by worth, best first.
    worth : ndarray, shape (N,)
        Nats by which each plane's readings, in this order, are shorter on it than on none;
        negative.
    curve : ndarray, shape (N + 1,)
        Phi in nats if only the first 0 ... N planes in this order were there and the readings of
        the others on none; the last is Phi of the model.
    """

    order: NDArray[np.intp]
    worth: Array
    curve: Array


def ledger(
    frame: Frame,
    error: FrameError,
    affine: Array,
    labels: NDArray[np.int32],
    range: float,
    resolution: float,
    pixel_size: tuple[float, float],
) -> Ledger:
    """Rank planes, with exact Phi of them all and of every shorter list of the best.

    Parameters
    ----------
    frame : Frame
        The readings.
    error : FrameError
        Size of the frame's error against the sensor's description.
    affine : ndarray, shape (N, 3)
        (t0, t1, t2) of w = t0 + t1 x + t2 y.
    labels : ndarray of int32, shape (H, W)
        0 for none, j for row j - 1.
    range, resolution : float
        R and eps in metres.
    pixel_size : (float, float)
        Of a pixel on the plane z = 1, in metres.
    """
    planes, there = len(affine), frame.p > 0
    coordinate = coordinate_information(range, resolution)
    moments, cell, label = _groups(frame, error, labels, planes, resolution)
    slope_prior = (kernels.UNIT * np.sqrt(pixel_size[0] * pixel_size[1]) * _SLOPE_PRIOR) ** 2

    def on_none(m: Array) -> Array:
        return _surface_data(m, slope_prior, coordinate)

    on_plane = label > 0
    data = on_none(moments)
    alone = data[on_plane].copy()
    extent = np.sqrt(np.bincount(labels[there], minlength=planes + 1)) / kernels.UNIT
    on = _plane_data(
        moments[on_plane],
        affine[label[on_plane] - 1],
        extent[label[on_plane]],
        error.lateral,
        coordinate,
    )
    data[on_plane] = -np.logaddexp(np.log(1 - _APART) - on, np.log(_APART) - alone)
    worth = np.bincount(label[on_plane], data[on_plane] - alone, planes + 1)[1:]
    order: NDArray[np.intp] = np.argsort(worth, kind="stable")
    place = np.zeros(planes + 1, np.int32)
    place[order + 1] = np.arange(1, planes + 1)
    ranked = place[labels]

    # Readings on none, cell by cell, while planes are taken away from the last on.
    rest = np.zeros((int(cell.max(initial=-1)) + 1, moments.shape[1]))
    rest[cell[~on_plane]] = moments[~on_plane]
    total = float(data.sum())
    curve = [total]
    for plane in order[::-1]:
        mine = label == plane + 1
        where = cell[mine]
        occupied = rest[where, kernels.COUNT] > 0
        before = float(on_none(rest[where][occupied]).sum())
        rest[where] += moments[mine]
        total += float(on_none(rest[where]).sum()) - before - float(data[mine].sum())
        curve.append(total)
    parameters = plane_information(3, range, resolution)
    structure = [
        n * parameters + spatial_mask_information(ranked, there, n)
        for n in builtins.range(planes + 1)
    ]
    phi = np.array(curve[::-1]) + np.array(structure)
    return Ledger(order=order, worth=np.asarray(worth[order]), curve=phi)


def _groups(
    frame: Frame,
    error: FrameError,
    labels: NDArray[np.int32],
    planes: int,
    resolution: float,
) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Moments of every group, its cell and its label."""
    height, width = labels.shape
    rows, columns = -(-height // GROUP_SIDE), -(-width // GROUP_SIDE)
    p = frame.p / error.white
    place = np.empty((rows * columns, planes + 1), np.int32)
    found = kernels.label_groups(labels, p, GROUP_SIDE, columns, planes, place)
    # 1/2 ln(2 pi sigma_z^2 / eps^2) with sigma_z = sigma_w z^2
    norm = np.zeros(labels.shape)
    there = p > 0
    w = frame.w[there].astype(np.float64)
    norm[there] = 0.5 * np.log(2 * np.pi / (p[there] * w**4 * resolution**2))
    row, table = frame.table.rows(w), frame.table
    extra = np.zeros((4, *labels.shape))
    extra[0] = norm
    extra[1, there] = error.near * (table.shared + table.step)[row]
    extra[2, there] = error.drift * table.drift[row]
    extra[3, there] = error.bent * table.shared[row]
    moments = np.empty((found, kernels.MOMENTS + len(extra)))
    kernels.group_moments(
        labels, frame.w, p, frame.x, frame.y, extra, GROUP_SIDE, columns, place, moments
    )
    cell, label = np.nonzero(place >= 0)
    return moments, cell, label


def _centred(m: Array) -> tuple[Array, ...]:
    """Centroid, mean, and second moments about them."""
    cx, cy, mean = m[:, 1] / m[:, 0], m[:, 2] / m[:, 0], m[:, 6] / m[:, 0]
    xx, xy, yy = m[:, 3] - cx * m[:, 1], m[:, 4] - cx * m[:, 2], m[:, 5] - cy * m[:, 2]
    xw, yw = m[:, 7] - cx * m[:, 6], m[:, 8] - cy * m[:, 6]
    return cx, cy, mean, xx, xy, yy, xw, yw, m[:, 9] - mean * m[:, 6]


def _integrated_slopes(
    variance: Array, xx: Array, xy: Array, yy: Array, xw: Array, yw: Array
) -> tuple[Array, Array]:
    """What random slopes of a variance explain of chi^2, and ln det(I + variance A)."""
    a, b, c = 1 + variance * xx, variance * xy, 1 + variance * yy
    determinant = a * c - b * b
    explained = variance * (c * xw * xw - 2 * b * xw * yw + a * yw * yw) / determinant
    return explained, np.log(determinant)


def _plane_data(m: Array, t: Array, extent: Array, lateral: float, coordinate: float) -> Array:
    """Nats of groups on planes t, offset and tilt integrated out, or anything at all if shorter.

    The offset's variance is what near readings share and what the drift leaves about a plane of an
    extent in units of 100 pixels; both grow where the plane is steep.
    """
    cx, cy, mean, xx, xy, yy, xw, yw, square = _centred(m)
    off = mean - (t[:, 0] + t[:, 1] * cx + t[:, 2] * cy)
    chi2 = square + m[:, 0] * off**2 - 2 * (t[:, 1] * xw + t[:, 2] * yw)
    chi2 += t[:, 1] ** 2 * xx + 2 * t[:, 1] * t[:, 2] * xy + t[:, 2] ** 2 * yy
    count = m[:, kernels.COUNT]
    steep = 1 + lateral * (t[:, 1] ** 2 + t[:, 2] ** 2) / kernels.UNIT**2 * m[:, 0] / count
    drift = steep * m[:, _DRIFT] / count
    offset = steep * m[:, _NEAR] / count + kernels.PLANE_RESIDUAL * extent * drift
    tilt = steep * TILT**2 * m[:, _SHARED] / count
    tilt += kernels.PLANE_BEND[0] / (GROUP_SIDE / kernels.UNIT) * drift
    slopes, determinant = _integrated_slopes(
        tilt, xx, xy, yy, xw - t[:, 1] * xx - t[:, 2] * xy, yw - t[:, 1] * xy - t[:, 2] * yy
    )
    spread = 1 + offset * m[:, 0]
    chi2 -= offset * (m[:, 0] * off) ** 2 / spread + slopes
    fitted = 0.5 * (chi2 + np.log(spread) + determinant) + m[:, _NORM]
    return np.asarray(np.log(2) + np.minimum(fitted, m[:, kernels.COUNT] * coordinate))


def _surface_data(m: Array, slope_prior: float, coordinate: float) -> Array:
    """Nats of groups on none: a smooth surface or anything at all, whichever is shorter."""
    _, _, mean, xx, xy, yy, xw, yw, square = _centred(m)
    slopes, determinant = _integrated_slopes(slope_prior * mean**2, xx, xy, yy, xw, yw)
    smooth = coordinate + 0.5 * (square - slopes + determinant) + m[:, _NORM]
    return np.asarray(np.log(2) + np.minimum(smooth, m[:, kernels.COUNT] * coordinate))
