"""Groups and their nats against plain NumPy versions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from planewise.kernels import group_data, groups
from planewise.kernels.cells import COUNT, STRIP, cell_moments
from planewise.spatial import cells as cells_module

from . import oracles, spatial_oracles

SIGMA, EPS, WHITE = 1e-3, 1e-3, 1.7
PLANES = np.array([[0.0, 0, 0], [0.50, 0.03, -0.02], [0.53, -0.05, 0.04], [0.47, 0.08, 0.06]])


def patches(rng, shape):
    """Labels 0 ... 3 in patches, and w, p, x, y near their planes, with holes."""
    tall, wide = -(-shape[0] // 5), -(-shape[1] // 13)
    labels = np.repeat(np.repeat(rng.integers(0, 4, (tall, wide)), 5, 0), 13, 1)
    labels = labels[: shape[0], : shape[1]].astype(np.uint16)
    i, j = np.indices(shape)
    x, y = (j - 0.4 * shape[1]) / 100, (i - 0.7 * shape[0]) / 100
    t = PLANES[np.where(labels == 0, 1, labels)]
    w = t[..., 0] + t[..., 1] * x + t[..., 2] * y + rng.normal(0, SIGMA, shape)
    p = rng.uniform(0.7, 1.4, shape) / SIGMA**2
    hole = rng.random(shape) < 0.1
    hole[:9, :9] = hole[10:16, 18:30] = True
    p[hole], w[hole], labels[hole] = 0, 0, 0
    return labels, [np.float32(image) for image in (w, p, x, y)]


def grouped(labels, images):
    """Moments and label of every group, and where those of blocks with several begin."""
    w, p, x, y = images
    shape, half = ([-(-n // side) for n in labels.shape] for side in (3, 9))
    halved = -(-shape[0] // 2), -(-shape[1] // 2)
    cells = np.empty(shape, np.uint8), np.empty(shape)
    blocks, tiles = np.empty((halved[0], 11, halved[1])), np.empty((half[0], 12, half[1]))
    strips = -(-shape[0] // STRIP)
    cell_moments(w, p, x, y, False, 0, strips, *cells, blocks, np.empty(halved), tiles)
    block, work = np.full(half, 9, np.int32), np.empty((6, 9 * half[1]), np.uint16)
    several = groups.label_blocks(labels, p, block, work)
    assert several == (block == groups.SEVERAL).sum()
    constant, readings = np.log(2 * np.pi * WHITE / EPS**2), np.full(4, 9)
    first, of_blocks = np.full(several + 1, 9, np.int32), np.empty((12, block.size))
    means, one = np.empty((3, block.size)), np.ones(block.size)
    groups.tile_means(tiles, means)
    there = tiles[:, 0] > 0
    for mean, e in zip(means.reshape(3, *half), (1, 2, 6), strict=True):
        exact = np.where(there, tiles[:, e] / np.where(there, tiles[:, 0], 1.0), 1.0)
        assert_allclose(mean, exact, rtol=1e-12)
    groups.correct_tiles(tiles, WHITE, constant, one, one[:0], of_blocks)
    # Of a straight image, one row of x and one column of y will do.
    x, y = (x[:1], y[:, :1].copy()) if shape[0] % 2 else (x, y)

    def summed(room):
        moments = np.full((12, room), 9.0)
        moments[:, : block.size] = of_blocks
        label = np.full(room, 9, np.uint16)
        end = groups.sum_groups(
            labels, w, p, x, y, block, WHITE, constant, first, moments, label, readings
        )
        return end, moments, label

    end, moments, label = summed(block.size + 81 * several)
    assert end == first[-1]
    assert summed(end - 1)[0] == -1
    assert summed(end)[0] == end
    assert_array_equal(readings, np.bincount(labels[p > 0], minlength=4))
    return moments, label, first


@pytest.mark.parametrize("shape", [(27, 45), (31, 50), (5, 64)])
def test_groups_are_the_readings_of_one_block_and_label(shape):
    labels, images = patches(np.random.default_rng(5), shape)
    moments, label, first = grouped(labels, images)
    blocks = [(i, j) for i in range(0, shape[0], 9) for j in range(0, shape[1], 9)]
    assert first[0] == len(blocks)
    several = 0
    for b, (i, j) in enumerate(blocks):
        part = spatial_oracles.block([*images, labels], i, j, 9)
        w, p, x, y, mine = (np.float64(values) for values in part)
        names = list(dict.fromkeys(mine))
        if len(names) == 1:
            at = [b]
        else:
            assert moments[COUNT, b] == 0
            at = np.arange(first[several], first[several + 1]) if names else []
            several += bool(names)
        assert sorted(label[at]) == sorted(names)
        for g in at:
            on = mine == label[g]
            exact = spatial_oracles.moments(w[on], p[on] / WHITE, x[on], y[on])
            assert_allclose(moments[:11, g], exact, rtol=1e-9)
            norm = 0.5 * np.log(2 * np.pi * WHITE / (p[on] * w[on] ** 4 * EPS**2)).sum()
            assert moments[11, g] == pytest.approx(norm, rel=1e-9)
    assert several == len(first) - 1 > 0


def test_merged_groups_are_those_of_the_merged_labels():
    labels, images = patches(np.random.default_rng(9), (45, 60))
    place = np.array([0, 2, 1, 1], np.uint16)
    merged, exact = grouped(labels, images), grouped(place[labels], images)
    before = (merged[0][COUNT, : merged[2][-1]] > 0).sum()
    groups.merge_groups(*merged, place)
    told = []
    for moments, label, first in (merged, exact):
        there = np.flatnonzero(moments[COUNT, : first[-1]] > 0)
        rows = np.vstack((label[there], moments[:12, there]))
        told.append(rows[:, np.lexsort(rows[[2, 1, 0]])])
    assert_allclose(*told, rtol=1e-9)
    assert told[0].shape[1] < before


def test_cells_are_those_of_the_search():
    assert groups.SIDE == cells_module.SIDE


@pytest.mark.parametrize("oblique", [(0.0, 0.0), (0.3, 0.1)])
@pytest.mark.parametrize("levels", [1, 4])
@pytest.mark.parametrize("off", [0.0, 1e-3, 0.02])
def test_nats_of_groups(off, levels, oblique):
    """Readings on their planes, a little off, and so far that they are surfaces of their own.

    In the right half they err five times as much as told.
    """
    labels, images = patches(np.random.default_rng(6), (90, 120))
    loud = np.random.default_rng(8).normal(0, 5 * SIGMA, (90, 60)).astype(np.float32)
    images[0][:, 60:] += np.where(images[1][:, 60:] > 0, loud, 0)
    moments, label, first = grouped(labels, images)
    end = first[-1]
    # And the side of a square as large, longer by distortion, and as it is.
    planes = np.vstack((PLANES.T, [0.0, 0.4, 0.3, 0.5], [0.0, 0.3, 0.3, 0.4]))
    planes[0] += off
    rng = np.random.default_rng(7)
    table = np.cumsum(SIGMA**2 * rng.uniform(0, 0.01, (3, 400)), axis=1)
    error, prior = (0.8, 0.1, 60.0, 9.0, 0.3, 0.5 * SIGMA), (0.05, 8.0, 9.0)
    alone, white, *data = np.empty((2 + levels, moments.shape[1]))
    data, worth = np.array(data), np.full((levels, 4), 5.0)
    saved, leaving = np.full((2, 4), 5.0)
    arguments = (*table, (120.0, *oblique), error, prior)
    total = group_data.group_data(
        moments, label, first, planes, *arguments, alone, white, data, worth, saved, leaving
    )
    there = np.flatnonzero(moments[COUNT, :end] > 0)
    m, name = moments[:, there], label[there]
    on_plane = np.array([0, 1, 1, 1])
    for k in reversed(range(levels)):
        expected_alone, expected = oracles.group_data(m, planes[:, name], *arguments, 4.0**k)
        expected = np.where(name > 0, expected, expected_alone)
        assert_allclose(data[k, there], expected, rtol=1e-9)
        shorter = np.bincount(name, expected - expected_alone, 4) * on_plane
        assert_allclose(worth[k], 5 + shorter, rtol=1e-9)
    assert_allclose(alone[there], expected_alone, rtol=1e-9)
    assert set(white[there]) >= {1.0, 0.125}
    # Of the first level:
    assert total == pytest.approx(expected.sum(), rel=1e-12)
    shorter = np.bincount(name, expected - m[COUNT] * prior[2], 4) * on_plane
    assert_allclose(saved, 5 + shorter, rtol=1e-9)
    whole = there < first[0]
    lost = np.bincount(name[whole], (expected_alone - expected)[whole], 4) * on_plane
    assert_allclose(leaving, 5 + lost, rtol=1e-9)
