"""Sparse frames: readings too far apart for cells of pixels, whose planes are those of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.density import cell_counts, usual_count
from planewise.observation import RayObservation
from planewise.ranks import ranks
from planewise.spatial.frame import Frame
from planewise.spatial.search import Segmentation

Array = NDArray[np.float64]

_CELL = 6  # pixels
_MOST = 12  # readings of a cell, which four planes explain: it cannot tell one plane from several
_FEWEST = 100  # readings that could show a plane
_NEAREST = 1e-6  # metres from the sensor: no ray meets a plane through it


def is_sparse(frame: Frame, readings: int) -> bool:
    """Whether the median cell of 6 x 6 pixels that has some of these readings has but a few."""
    # With so many the median has more, even where all others are full.
    if (
        frame.sectors.column is not None
        or not _FEWEST <= readings < (_MOST / _CELL**2 + 1) / 2 * frame.p.size
    ):
        return False
    return usual_share(frame) <= _MOST / _CELL**2


def usual_share(frame: Frame) -> float:
    """Share of the pixels that have a reading, in the median cell that has any."""
    return usual_count(cell_counts(frame.sectors.image(frame.p) > 0, _CELL)) / _CELL**2


def segment_points(
    observation: RayObservation,
    frame: Frame,
    *,
    significance: float,
) -> Segmentation:
    """Planes and labels that the search in space finds, under the image's noise.

    Parameters
    ----------
    observation, frame
        The readings, of a pinhole camera.
    significance
        As `spatial.search.segment` takes it.
    """
    # Its compiled loops are loaded only where they are used.
    from planewise.clouds.model import cloud_model

    readings = observation.tame
    w, p = (image.reshape(-1)[readings.index].astype(np.float64) for image in (frame.w, frame.p))
    longer = np.linalg.norm(readings.rays, axis=0) / readings.rays[2]  # than depth along z
    along = longer / (w * w * np.sqrt(p))  # with quantisation
    model = cloud_model(
        readings.positions(),
        readings.sensor,
        along,
        np.zeros(3),
        instances=False,
        max_planes=readings.count,
        significance=significance,
        settings={},
        workers=1,
        rng=np.random.default_rng(0),
    )
    rows = np.array([plane.coefficients for plane in model.planes]).reshape(-1, 4)
    kept = np.flatnonzero(rows[:, 3] > _NEAREST)
    place = ranks(kept, len(rows))
    labels, rows = readings.unflatten(place[model.labels]), rows[kept]
    return Segmentation(
        information=_information(frame, labels, len(rows)),
        labels=labels,
        significance=np.array([each.significance for each in model.planes])[kept],
        affine=frame.sectors.affine(-rows[:, :3] / rows[:, 3:]),
        residual_correlation=np.array([each.residual_correlation for each in model.planes])[kept],
    )


def _information(frame: Frame, labels: NDArray[np.uint16], planes: int) -> Array:
    """Information (N, 3, 3) of the readings of every label, as if they erred apart."""
    there = labels > 0
    which = labels[there] - 1
    p, x, y = (image[there].astype(np.float64) for image in (frame.p, frame.x, frame.y))
    coordinates = np.ones_like(x), x, y
    sums = [[np.bincount(which, p * a * b, planes) for b in coordinates] for a in coordinates]
    return np.array(sums).transpose(2, 0, 1)
