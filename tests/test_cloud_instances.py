"""Surfaces of one plane that do not touch are planes of their own with instances=True."""

import numpy as np
import pytest
from benchmarks.building import building
from numpy.testing import assert_array_equal

import planewise as pw
from planewise.detect_in_cloud import detect_planes_in_cloud
from planewise.kernels.cloud_instances import pieces

SENSOR = pw.Sensor(max_depth=20.0, resolution=0.001, noise=0.01)


def walls(gap, density=250, turn=0.0):
    """Two walls of 4 x 3 m in one plane, and the floor under them."""
    rng = np.random.default_rng(0)
    wall = rng.uniform(0, 1, (int(24 * density), 2)) * (8, 3)
    wall[:, 0] += np.where(wall[:, 0] < 4, 0, gap)
    floor = rng.uniform(0, 1, (int(40 * density), 2)) * (8 + gap, 5)
    points = np.vstack(
        (
            np.column_stack((wall[:, 0], 0 * wall[:, 0], wall[:, 1])),
            np.column_stack((floor, 0 * floor[:, 0])),
        )
    )
    truth = np.where(np.arange(len(points)) < len(wall), 1 + (points[:, 0] > 4 + gap / 2), 3)
    c, s = np.cos(turn), np.sin(turn)
    points = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return points + rng.normal(0, 0.01, points.shape), truth


@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_walls_a_hand_apart_are_two_surfaces_of_one_plane(turn):
    points, truth = walls(0.22, turn=turn)
    together = pw.detect_planes_in_points(points, SENSOR)
    assert len(together) == 2
    apart = pw.detect_planes_in_points(points, SENSOR, instances=True)
    assert len(apart) == 3
    for j in (1, 2, 3):
        mine = truth[apart.labels == j]
        assert np.bincount(mine).max() > 0.98 * len(mine)
    assert [p.information for p in apart.planes] == sorted(p.information for p in apart.planes)
    area = {round(plane.area / 4) for plane in apart.planes}
    assert area <= {2, 3, 4, 9, 10, 11}
    whole = pw.detect_planes_in_points(walls(0.0)[0], SENSOR, instances=True)
    assert len(whole) == 2


def test_no_more_planes_than_asked_for():
    points, _ = walls(0.4)
    found = pw.detect_planes_in_points(points, SENSOR, instances=True, max_planes=2)
    assert len(found) == 2
    assert found.labels.max() == 2
    assert "max_planes = 2" in found.curve.reason


def test_tiles_tell_the_same_apart():
    points = building(60_000, floors=1).points
    whole = pw.detect_planes_in_points(points, SENSOR, instances=True)
    cloud = pw.PointCloud(points=points)
    tiled = detect_planes_in_cloud(cloud, SENSOR, instances=True, tile_points=9_000)
    assert_array_equal(tiled.labels, whole.labels)
    assert len(whole) > len(pw.detect_planes_in_points(points, SENSOR))


def test_lines_of_a_scanner_are_no_surfaces_of_their_own():
    rng = np.random.default_rng(0)
    # A floor in rings: dense along them, and farther apart the farther they are.
    radius = np.repeat(1.5 * 1.04 ** np.arange(60), 400)
    angle = rng.uniform(0, 2 * np.pi, len(radius))
    floor = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), 0 * angle))
    points = floor + rng.normal(0, 0.01, floor.shape)
    found = pw.detect_planes_in_points(points, SENSOR, instances=True)
    assert (found.labels == 1).mean() > 0.9


def labelled(rows):
    """Pieces of a grid that is drawn with # and blanks."""
    grid = np.array([[c == "#" for c in row] for row in rows], np.int32)
    found = pieces(flat := grid.ravel().copy(), *grid.shape)
    return found, flat.reshape(grid.shape)


def test_pieces_of_a_grid():
    found, grid = labelled(["#### ###", "#### ###", "#### ###", "####    "])
    assert found == 2
    assert grid[0, 0] == 1  # the larger one
    assert grid[0, 6] == 2
    # A single point between joins nothing: it is part of the first piece near it.
    assert labelled(["####   ####", "####   ####", "####  # ###", "####   ####"])[0] == 2
    assert labelled(["####     ####", "####  #  ####", "####     ####"])[0] == 2
    # A narrow piece of some size does.
    found, grid = labelled(["####       ####", "#### ##### ####", "####       ####"])
    assert (found, set(grid.ravel())) == (1, {0, 1})
    # Narrow lines alone are one.
    found, grid = labelled(["#######", "       ", "#######", "       ", "#######"])
    assert (found, set(grid.ravel())) == (1, {0, 1})


def test_pieces_are_those_of_a_flood():
    rng = np.random.default_rng(0)
    for _ in range(30):
        grid = np.zeros((40, 50), bool)
        for _ in range(rng.integers(1, 9)):
            y, x = rng.integers(0, 34), rng.integers(0, 44)
            grid[y : y + rng.integers(3, 12), x : x + rng.integers(3, 12)] = True
        piece, found = np.zeros(grid.shape, int), 0
        for start in zip(*np.nonzero(grid), strict=True):
            if piece[start]:
                continue
            found, stack = found + 1, [start]
            while stack:
                y, x = stack.pop()
                if not (0 <= y < 40 and 0 <= x < 50) or not grid[y, x] or piece[y, x]:
                    continue
                piece[y, x] = found
                stack += [(y + dy, x + dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
        number, told = labelled([["# "[not c] for c in row] for row in grid])
        assert number == found
        pairs = set(zip(piece[grid], told[grid], strict=True))
        assert len(pairs) == found
        sizes = np.bincount(told[grid])[1:]
        assert_array_equal(sizes, np.sort(sizes)[::-1])
