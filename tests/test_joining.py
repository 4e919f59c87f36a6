"""Planes that turn out to be one."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise import scenes
from planewise.spatial import solution
from planewise.spatial.information import ledger
from planewise.spatial.joining import _parts
from tests.test_lidar import CAMERA, SENSOR, room


@pytest.mark.parametrize("seed", [0, 8])
def test_pieces_of_a_floor_are_one_plane(monkeypatch, seed):
    """What no longer stands apart lowers Phi; what does not touch is told apart, if wanted."""
    ranges, truth = room(CAMERA, np.random.default_rng(seed))
    model = pw.detect_planes(ranges, CAMERA, SENSOR)
    surfaces = pw.detect_planes(ranges, CAMERA, SENSOR, instances=True)
    monkeypatch.setattr(solution, "joined", lambda *given: (*given[:2], None))
    apart = pw.detect_planes(ranges, CAMERA, SENSOR)
    assert len(model) == 6 <= len(surfaces) < len(apart)
    assert model.information < apart.information - 2 * 3 * np.log(60 / 0.002)
    for label in range(1, 7):
        mine = truth == label
        share = np.bincount(model.labels[mine], minlength=7)[1:].max() / mine.sum()
        assert share > 0.97
    # The same readings are on planes; only whose they are has changed.
    assert_array_equal(model.labels > 0, apart.labels > 0)


@pytest.mark.parametrize("seed", [143, 265])
def test_pieces_of_a_face_in_a_room_are_one_plane(monkeypatch, seed):
    """Every true face has one plane, with no more readings on planes, and Phi is lower."""
    scene = scenes.room(seed)
    model = pw.detect_planes(scene.depth, scene.camera, scene.sensor)
    monkeypatch.setattr(solution, "joined", lambda *given: (*given[:2], None))
    apart = pw.detect_planes(scene.depth, scene.camera, scene.sensor)
    assert model.information < apart.information

    def faces(labels):
        most = [np.bincount(scene.labels[labels == j]).argmax() for j in range(1, labels.max() + 1)]
        return [face for face in most if face > 0]

    assert len(faces(apart.labels)) > len(set(faces(apart.labels)))
    assert len(faces(model.labels)) == len(set(faces(model.labels)))
    assert set(faces(model.labels)) == set(faces(apart.labels))


def test_groups_of_joined_planes_are_those_of_their_labels(monkeypatch):
    """Phi with all planes and with none, and the worth of each, as if groups were made anew."""
    scene, seen, real = scenes.room(143), [], solution.groups_of

    def groups_of(frame, *others):
        seen[:] = [frame, *others]
        return real(frame, *others)

    def judge(*given, **options):
        result = judged(*given, **options)
        frame, cells, _, _, *limits, workspace, _ = seen
        labels, order = result.found.labels, result.book.order
        again = ledger(frame, cells, result.affine, labels, *limits, workspace)
        back = np.argsort(again.order)
        assert_allclose(again.worth[back], result.book.worth[np.argsort(order)], rtol=1e-9)
        assert again.curve[[0, -1]] == pytest.approx(result.book.curve[[0, -1]], rel=1e-12)
        counts.append((seen[3], len(order)))
        return result

    judged, counts = solution.judged, []
    monkeypatch.setattr(solution, "groups_of", groups_of)
    monkeypatch.setattr(solution, "judged", judge)
    pw.detect_planes(scene.depth, scene.camera, scene.sensor)
    assert any(left < found for found, left in counts)


def _touch(a, b):
    """Whether pixels of two masks are side by side."""
    across = (a[:, 1:] & b[:, :-1]) | (b[:, 1:] & a[:, :-1])
    return across.any() or ((a[1:] & b[:-1]) | (b[1:] & a[:-1])).any()


@pytest.mark.parametrize("seed", [143, 265])
def test_touching_pieces_of_a_face_are_one_surface(monkeypatch, seed):
    scene = scenes.room(seed)
    model = pw.detect_planes(scene.depth, scene.camera, scene.sensor, instances=True)
    monkeypatch.setattr(solution, "joined", lambda *given: (*given[:2], None))
    apart = pw.detect_planes(scene.depth, scene.camera, scene.sensor, instances=True)
    assert model.information < apart.information

    def touching(found):
        most = [
            np.bincount(scene.labels[found.labels == j + 1]).argmax() for j in range(len(found))
        ]
        return sum(
            most[i] == most[j] > 0 and _touch(found.labels == i + 1, found.labels == j + 1)
            for i in range(len(found))
            for j in range(i)
        )

    assert touching(model) < touching(apart)


def test_surfaces_that_do_not_touch_stay_apart():
    """One wall, and a wall behind a beam whose two parts are one plane or two surfaces."""
    depth = np.full((240, 320), 2.0)
    depth[:, 140:180] = 1.2
    camera = pw.PinholeCamera(fx=260, fy=260, cx=160, cy=120)
    sensor = pw.Sensor(max_depth=5, noise=0.004)
    depth += np.random.default_rng(0).normal(0, 0.004, depth.shape)
    assert len(pw.detect_planes(depth, camera, sensor)) == 2
    assert len(pw.detect_planes(depth, camera, sensor, instances=True)) == 3


def test_what_saves_most_is_joined_first():
    assert_array_equal(_parts(3, np.empty(0, int), np.empty(0, int), np.empty(0)), [0, 1, 2])
    # 1 and 2 are both part of 0; what is not shorter there stays.
    one = np.array([1, 2, 3]), np.array([0, 0, 0]), np.array([-9.0, -3.0, 0.0])
    assert_array_equal(_parts(4, *one), [0, 0, 0, 3])
    # 2 would save on 1 what it saved, which is gone by then.
    gone = np.array([2, 1]), np.array([1, 0]), np.array([-1.0, -2.0])
    assert_array_equal(_parts(3, *gone), [0, 0, 2])
    # Part of what is part of another.
    chain = np.array([0, 1]), np.array([1, 2]), np.array([-2.0, -1.0])
    assert_array_equal(_parts(3, *chain), [2, 2, 2])


def test_planes_that_become_parts_are_found_as_in_a_table_of_all_pairs():
    rng = np.random.default_rng(0)
    for _ in range(200):
        planes = int(rng.integers(1, 12))
        small = np.flatnonzero(rng.random(planes) < 0.7)
        large = (small + rng.integers(1, planes, len(small))) % planes if planes > 1 else small
        small, large = (small, large) if planes > 1 else (small[:0], large[:0])
        more = rng.integers(-5, 3, len(small)).astype(float) + rng.random(len(small))
        table = np.full((planes, planes), np.inf)
        table[small, large] = more
        expected = np.arange(planes)
        while table.min() < 0.0:
            a, b = np.unravel_index(table.argmin(), table.shape)
            expected[expected == a] = b
            table[a] = table[:, a] = np.inf
        assert_array_equal(_parts(planes, small, large, more), expected)
