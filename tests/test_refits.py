"""Planes refitted to groups: against dense normal densities, and what they are good for."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import planewise as pw
from planewise import scenes
from planewise.kernels.frame_error import TILT
from planewise.kernels.groups import BLOCK
from planewise.kernels.refits import refit_sums
from planewise.sectors import turn_to_theta
from planewise.spatial.cells import cells_of
from planewise.spatial.frame import frame_of
from planewise.spatial.information import book_of, groups_of, ledger, mask_of
from planewise.spatial.refit import refitted
from planewise.spatial.search import segment

from .oracles import group_level, group_level_nats

PARTS = pw.noise.ErrorParts(
    white=pw.noise.constant(0.003),
    shared=pw.noise.constant(0.002),
    drift=pw.noise.constant(0.004),
)
SENSOR = pw.Sensor(max_depth=8, noise=0.003, parts=PARTS)
RANGE, RESOLUTION = 8.0, 0.001


def described(values, covariance, change):
    return (
        0.5
        * (
            values @ np.linalg.solve(covariance, values)
            + np.linalg.slogdet(2 * np.pi * covariance)[1]
        )
        + change
    )


def oracle(frame, error, affine, labels, pixel_size):
    """P and P t of every plane from all readings of every group."""
    L = math.log(RANGE / RESOLUTION)
    slope = 100 * math.sqrt(pixel_size[0] * pixel_size[1])
    out = np.zeros((len(affine) + 1, 9))
    for top in range(0, labels.shape[0], BLOCK):
        for left in range(0, labels.shape[1], BLOCK):
            window = np.s_[top : top + BLOCK, left : left + BLOCK]
            if not frame.p[window].any():
                continue
            of_block = np.average(frame.w[window].astype(float), weights=frame.p[window])
            for label in range(1, len(affine) + 1):
                mine = (labels[window] == label) & (frame.p[window] > 0)
                if not mine.any():
                    continue
                w, p, x, y = (
                    np.asarray(getattr(frame, name)[window][mine], float) for name in "wpxy"
                )
                v, t = error.white / p, affine[label - 1]
                cx, cy, mean = (np.average(each, weights=p) for each in (x, y, w))
                change = np.sum(-2 * np.log(w)) - w.size * math.log(RESOLUTION)
                unbiased = 1 + error.seen * frame.table.noise_bias(of_block)
                w, mean = unbiased * w, unbiased * mean
                J = np.column_stack((np.ones_like(x), x - cx, y - cy))
                _, shared, drift, step = frame.table.at(mean)
                drift = error.drift * drift
                steep = 1 + error.lateral * np.mean(p / error.white) * (t[1:] @ t[1:]) / 100**2
                count = np.sum((labels == label) & (frame.p > 0))
                extent = math.sqrt(count) / 100 * (1 + count / error.distorted)
                offset = steep * (error.near * (shared + step) + 0.113 * extent * drift)
                tilt = steep * (TILT**2 * error.bent * shared + 0.9 / 0.09 * drift)
                slopes = J @ np.diag([0, 1, 1]) @ J.T * (slope * mean) ** 2
                misfit = (w - mean) @ np.linalg.solve(np.diag(v) + slopes, w - mean)
                level = group_level(misfit, w.size)
                change += group_level_nats(level)
                own = np.diag(v * 2.0**level)
                C, wide = own + J @ np.diag([offset, tilt, tilt]) @ J.T, own + slopes
                on = described(w - t[0] - t[1] * x - t[2] * y, C, change)
                alone = math.log(0.05) - min(L + described(w - mean, wide, change), w.size * L)
                if on >= w.size * L:
                    continue
                together = math.log(0.95) - on
                weight = math.exp(together - np.logaddexp(together, alone))
                G = np.column_stack((np.ones_like(x), x, y))
                P = weight * G.T @ np.linalg.solve(C, G)
                out[label, :6] += P[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
                out[label, 6:] += weight * G.T @ np.linalg.solve(C, w)
    return out


@pytest.fixture
def scene(roof, camera):
    """A frame, its cells, planes a little off, labels with strays, and their groups."""
    depth, planes, labels = roof
    depth, labels = depth.copy(), labels.astype(np.uint16)
    depth[5:12, 8:20] = 0
    depth[30:36, 40:44] = 5.0  # labelled as the plane about it
    labels[14:25, 20:31] = 2
    labels[depth == 0] = 0
    seen = pw.observe(depth, camera, SENSOR)
    theta = -planes[:, :3] / planes[:, 3:]
    affine = theta @ np.linalg.inv(turn_to_theta(seen.pixel_size)).T + 0.002
    frame = frame_of(seen)
    cells = cells_of(frame, seen.pixel_size)
    error = replace(cells.error, near=0.5, bent=0.7, lateral=0.4, drift=0.6, distorted=3e3)
    cells = replace(cells, error=error)
    groups = groups_of(frame, cells, labels, 2, RANGE, RESOLUTION, seen.pixel_size)
    return frame, cells, affine, labels, groups, seen.pixel_size


def test_sums_are_those_of_dense_normal_densities(scene):
    frame, cells, affine, labels, groups, pixel_size = scene
    groups.data(affine)
    sums = np.empty((3, 9))
    label = groups.label[: groups.first[-1]]
    planes, sizes = groups.planes(affine), groups.sizes
    refit_sums(
        groups.moments, label, planes, *groups.table, sizes, groups.prior[2], *groups.nats, sums
    )
    expected = oracle(frame, cells.error, affine, labels, pixel_size)
    assert_allclose(sums, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    assert (expected[1:, 0] > 0).all()


def test_data_are_those_of_the_planes_returned(scene):
    frame, cells, affine, labels, groups, pixel_size = scene
    before = ledger(frame, cells, affine, labels, RANGE, RESOLUTION, pixel_size).curve[-1]
    moved, data = refitted(groups, affine, groups.data(affine))
    assert (moved != affine).all()
    found = book_of(groups, data, mask_of(frame, labels), RANGE, RESOLUTION)
    again = ledger(frame, cells, moved, labels, RANGE, RESOLUTION, pixel_size)
    assert_allclose(found.curve, again.curve, rtol=1e-12)
    assert_allclose(found.worth, again.worth, rtol=1e-12)
    assert found.curve[-1] < before - 10


def test_no_plane_gets_worse(scene):
    groups, affine = scene[4], scene[2]
    rng = np.random.default_rng(0)
    for _ in range(30):
        start = affine + rng.normal(0, rng.choice([1e-5, 1e-3, 0.1]), affine.shape)
        before = groups.data(start)
        moved, data = refitted(groups, start, before)
        assert (data.worth <= before.worth).all()
        stayed = data.worth == before.worth
        assert_allclose(moved[stayed], start[stayed], rtol=1e-6)


def test_planes_without_groups_stay(scene):
    frame, cells, affine, labels, _, pixel_size = scene
    more = np.vstack((affine, affine[:1]))
    groups = groups_of(frame, cells, labels, 3, RANGE, RESOLUTION, pixel_size)
    moved, data = refitted(groups, more, groups.data(more))
    assert (moved[2] == more[2]).all()
    assert data.worth[2] == 0
    none = groups_of(frame, cells, 0 * labels, 0, RANGE, RESOLUTION, pixel_size)
    assert len(refitted(none, affine[:0], none.data(affine[:0]))[0]) == 0


def test_planes_of_rooms_come_nearer_to_the_truth():
    """Angle between normals, over planes of three rooms: its mean falls by more than a third."""
    angles = []
    for seed in range(3):
        scene = scenes.room(seed)
        seen = pw.observe(scene.depth, scene.camera, scene.sensor)
        frame = frame_of(seen)
        cells = cells_of(frame, seen.pixel_size)
        found = segment(seen, frame, cells)
        limits = seen.range, seen.resolution, seen.pixel_size
        groups = groups_of(frame, cells, found.labels, len(found.affine), *limits)
        turn = turn_to_theta(seen.pixel_size).T
        moved, _ = refitted(groups, found.affine, groups.data(found.affine))
        both = found.affine @ turn, moved @ turn
        for label, thetas in enumerate(zip(*both, strict=True), start=1):
            truth = np.bincount(scene.labels[found.labels == label], minlength=2)
            if truth[0] < truth.sum() / 5 and truth.max() > 0.8 * truth.sum() > 400:
                normal = scene.planes[truth.argmax() - 1, :3]
                cosine = [abs(t @ normal) / np.linalg.norm(t) for t in thetas]
                angles.append(np.degrees(np.arccos(np.minimum(cosine, 1))))
    before, after = np.mean(angles, axis=0)
    assert len(angles) > 30
    assert after < before / 1.5


def bounds(scene, variance):
    """Cramer-Rao bounds of (normal, distance) of every plane of a scene: traces, square roots."""
    rays = scene.camera.rays(scene.depth.shape)
    for label, (*normal, distance) in enumerate(scene.planes, start=1):
        r, theta = rays[scene.labels == label], -np.array(normal) / distance
        slope = -r / (r @ theta)[:, None] ** 2  # dz / d theta of z = 1 / (theta . r)
        covariance = np.linalg.inv(slope.T @ slope / variance)
        size = np.linalg.norm(theta)
        turn = (np.eye(3) - np.outer(theta, theta) / size**2) / size
        yield (
            math.sqrt(np.trace(turn @ covariance @ turn)),
            math.sqrt(theta @ covariance @ theta) / size**3,
        )


@pytest.mark.parametrize("angle", [75, 150, 175])
@pytest.mark.parametrize("assumed", [0.002, 0.005, 0.010])
def test_planes_are_as_near_to_the_truth_as_the_bound_lets_them(angle, assumed):
    """Ten seeds of white noise; weighted means without their bias would be off by 2 to 4."""
    errors, step = [], 0.001
    for seed in range(10):
        scene = scenes.two_planes(angle, size=(240, 320), rng=seed)
        sensor = replace(scene.sensor, noise=pw.noise.constant(assumed))
        model = pw.detect_planes((scene.depth + 0.5) * step, scene.camera, sensor)
        assert len(model) == 2
        rows = model.coefficients
        for plane, bound in zip(scene.planes, bounds(scene, 0.005**2 + step**2 / 12), strict=True):
            found = rows[np.argmax(rows[:, :3] @ plane[:3])]
            off = np.linalg.norm(found[:3] - plane[:3]), abs(found[3] - plane[3])
            errors.append(np.divide(off, bound))
    assert (np.sqrt(np.mean(np.square(errors), axis=0)) < 1.3).all()
