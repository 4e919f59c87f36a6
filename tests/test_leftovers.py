"""Small planes that local prices leave over."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import planewise as pw
from planewise import scenes
from planewise.kernels import forms
from planewise.kernels.cells import COUNT
from planewise.metrics import evaluate
from planewise.spatial import search, solution
from planewise.spatial.cells import cells_of
from planewise.spatial.frame import frame_of
from planewise.spatial.leftovers import WHITE, flat_leftovers
from planewise.spatial.segments import Segments
from planewise.workspace import Workspace

CAMERA = pw.PinholeCamera(fx=300, fy=300, cx=95.5, cy=23.5)
SENSOR = pw.Sensor(max_depth=10, noise=0.002)


def segments_of(depth, of_column):
    """Cells of an image, and segments that are bands of columns."""
    observation = pw.observe(depth, CAMERA, SENSOR)
    frame = frame_of(observation, Workspace())
    cells = cells_of(frame, observation.pixel_size, Workspace())
    there = cells.grid >= 0
    of_unit = np.zeros(len(cells.rows), np.int32)
    of_unit[cells.grid[there]] = np.broadcast_to(of_column, cells.grid.shape)[there]
    count = of_column.max() + 1
    rows = np.array([cells.rows[of_unit == k].sum(axis=0) for k in range(count)])
    segments = Segments(
        rows=rows,
        forms=np.ones((count, forms.FORM)),
        drift=cells.drift[:count],
        offset_prior=cells.offset_prior[:count],
        slope_prior=cells.slope_prior[:count],
        home=np.zeros(count, np.int32),
        of_unit=of_unit,
    )
    return segments, cells, frame.sectors


def test_large_ones_with_white_residuals_are_planes():
    """A plane is one, a bent surface is none, nor is what has too few readings."""
    rng, x = np.random.default_rng(0), np.arange(192.0)
    z = np.where(x < 96, 1 / (0.5 - 0.0005 * x), 2.0 + 0.005 * ((x - 144) / 48) ** 2)
    z = z + rng.normal(0, 0.002, (48, 192))
    of_column = np.repeat([0, 1, 2], [28, 4, 32])  # cells of 3 pixels
    segments, cells, sectors = segments_of(z, of_column)
    assert segments.rows[1, COUNT] < 700 < segments.rows[[0, 2], COUNT].min()
    flat, planes = flat_leftovers(segments, np.array([2, 1, 0]), cells, sectors)
    assert_array_equal(flat, [0])
    assert_array_equal(planes, segments.rows[None, flat])
    none, planes = flat_leftovers(segments, np.empty(0, np.int64), cells, sectors)
    assert (len(none), planes.shape) == (0, (1, 0, 13))


@pytest.mark.parametrize("seed", [4, 14])
def test_small_faces_of_a_room_are_found(monkeypatch, seed):
    scene = scenes.room(seed)

    def scored(**options):
        model = pw.detect_planes(scene.depth, scene.camera, scene.sensor, **options)
        assert all(plane.significance > 0 for plane in model.planes)
        row = evaluate(model.labels, scene.labels).row()
        return row["recall@0.5"], row["precision@0.5"], row["voi_labelled"]

    with_small, asked = scored(), scored(significance=1e-9)
    monkeypatch.setattr(
        search, "flat_leftovers", lambda s, left, c, k: (left[:0], s.rows[None, :0])
    )
    without = scored()
    assert with_small[0] > without[0] + 0.05
    assert with_small[1] >= without[1]
    assert with_small[2] < without[2]
    assert asked == without  # all of these have to pay


@pytest.mark.parametrize("seed", [1, 11])
def test_planes_whose_residuals_are_not_white_have_to_save_more(monkeypatch, seed):
    scene = scenes.room(seed)

    def found():
        model = pw.detect_planes(scene.depth, scene.camera, scene.sensor)
        return model, evaluate(model.labels, scene.labels).row()

    model, row = found()
    monkeypatch.setattr(solution, "_DEAR", 1.0)
    more, row_of_more = found()
    bent = [sum(p.residual_correlation > WHITE for p in each.planes) for each in (model, more)]
    assert bent[0] < bent[1]
    assert len(more) - len(model) == bent[1] - bent[0]
    assert row["precision@0.5"] > row_of_more["precision@0.5"]
    assert row["recall@0.5"] == row_of_more["recall@0.5"]
