"""Readings in steps much coarser than their noise, as where depth is kept in 8 bits."""

import numpy as np
import pytest

import planewise as pw
from planewise.kernels import frame_error
from planewise.spatial.cells import cells_of
from planewise.spatial.frame import frame_of

SIZE, FOCAL = (480, 640), 525.0
STEP, SIGMA = 0.02, 0.002
CAMERA = pw.PinholeCamera(fx=FOCAL, fy=FOCAL, cx=319.5, cy=239.5)


def corner_and_board(lean):
    """Depth of two steep walls and of a board before them that leans a little, and where it is."""
    x, y, _ = np.moveaxis(CAMERA.rays(SIZE), -1, 0)
    floor, side = 1.2 / np.maximum(y + 0.75, 0.001), 1.1 / np.maximum(x + 0.75, 0.001)
    walls = np.minimum(np.minimum(floor, side), 6.0)
    board = 1.5 / (1.0 - lean * x - 0.5 * lean * y)
    row, column = np.indices(SIZE)
    on = (abs(column - 350) < 200) & (abs(row - 270) < 170) & (board < walls)
    return np.where(on, board, walls), on


@pytest.mark.parametrize("noise", [SIGMA, "auto"])
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("lean", [0.08, 0.16, 0.25])
def test_planes_do_not_fall_apart_at_steps(lean, seed, noise):
    z, on = corner_and_board(lean)
    z = z + SIGMA * np.random.default_rng(seed).standard_normal(SIZE)
    depth = np.round(z / STEP) * STEP
    model = pw.detect_planes(depth, CAMERA, pw.Sensor(noise=noise))
    assert len(model) == 3
    assert np.bincount(model.labels[on]).max() > 0.97 * np.count_nonzero(on)


@pytest.mark.parametrize(("step", "either"), [(STEP, True), (SIGMA, False), (0.0005, False)])
def test_either_may_be_where_readings_do_not_show_steps(step, either):
    z, _ = corner_and_board(0.08)
    z = z + SIGMA * np.random.default_rng(0).standard_normal(SIZE)
    sensor = pw.Sensor(noise=SIGMA)
    frame = frame_of(pw.observe(np.round(z / step) * step, CAMERA, sensor))
    cells = cells_of(frame, CAMERA.pixel_size)
    assert (cells.other is not None) == either
    if either:
        assert cells.other.error == cells.error
        known, less = cells.rows[:, 0], cells.other.rows[:, 0]  # how well each offset is
        assert (less <= known).all()
        of_board = np.median(less[np.unique(cells.grid[36:90, 53:103])])
        assert of_board == pytest.approx(1.5**4 / (STEP**2 / 12), rel=0.5)  # as one reading alone


def test_readings_that_are_all_on_one_step_share_its_error():
    """What a cell's readings do not show of quantisation is an error of all of them."""
    step, white = STEP**2 / 12, SIGMA**2
    planes, count = np.zeros((10, 3)), np.full(3, 36.0)
    planes[2], planes[6] = 1.0, count / (white + step)  # at 1 m, where w errs as z does
    planes[5] = [0.0, 11.0, 40.0]  # chi^2 with 33 degrees of freedom
    tables = [np.full(4, value) for value in (white, 0.0, 0.0, step)]
    out = np.empty((6, 3))
    frame_error.unit_errors(
        planes, count, np.full(3, 2.0), *tables, (1.0, 0.0, 0.0), 1.0, 0.0, np.zeros(3), out
    )
    undithered = step * np.exp(-2 * np.pi**2 * SIGMA**2 / STEP**2) ** 2
    np.testing.assert_allclose(out[3], undithered, rtol=1e-6)
    np.testing.assert_allclose(out[4], [1.0, 1.0, 40 / 33])
    np.testing.assert_allclose(out[5], [undithered, undithered * 2 / 3, 0.0], rtol=1e-6)
